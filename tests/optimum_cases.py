"""Planning problems of one joint whose minimum time is known without the library.

Each case has its robot, made from a description, and the same mechanism as equations
written by hand (reference_optima.py), which give T and replay the motion.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from bang_bang import Extremal, Structure, find_extremal
from reference_optima import (
    Mechanism,
    Separate,
    Task,
    friction_time,
    rail_time,
)
from sample_arms import DOWNWARD, GRAVITY, make_arm, rod, slide

from tominpmp.goals.joints import JointGoal
from tominpmp.problem.problem import Problem
from tominpmp.robot.robot import Robot

HANGING = -0.5 * math.pi
UPRIGHT = 0.5 * math.pi
REST = (0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Case:
    """A problem with a known minimum time.

    Attributes:
        name: Name of the case.
        robot: Function that makes the robot.
        task: The same problem with equations written by hand.
        reference: Minimum time in closed form [s]; None if the first extremal has it.
        structures: Switches of the known extremals, the fastest first.
    """

    name: str
    robot: Callable[[], Robot]
    task: Task
    reference: float | None = None
    structures: tuple[Structure, ...] = ()

    def __str__(self) -> str:
        return self.name

    def problem(self) -> Problem:
        """The problem for the library."""
        q_start, v_start = np.split(self.task.ends[0], 2)
        goal = JointGoal(*np.split(self.task.ends[1], 2))
        return Problem(self.robot(), q_start, goal, v_start=v_start)

    @cached_property
    def extremals(self) -> tuple[Extremal, ...]:
        """The known extremals, the fastest first."""
        return tuple(find_extremal(self.task, item) for item in self.structures)

    @cached_property
    def minimum(self) -> float:
        """Minimum time [s]."""
        if self.reference is not None:
            return self.reference
        return find_extremal(self.task, self.structures[0]).T


def switches(first: str, order: str, *times: float) -> Structure:
    """Switches of a motion; see :class:`~bang_bang.Structure`."""
    return Structure(first, order, times)


# -- one mass on a rail ----------------------------------------------------------------

MASS, FORCE = 2.0, 10.0
PUSH = FORCE / MASS
WEAK = 0.3
# A brake of less force than the drive.
ONE_SIDED = (-WEAK * FORCE, FORCE)


def rail_case(
    name: str,
    minimum: float,
    distance: float = 1.0,
    speeds: tuple[float, float] = (0.0, 0.0),
    effort: tuple[float, float] = (-FORCE, FORCE),
    mechanism: Mechanism | None = None,
    **changes: Any,
) -> Case:
    """A case of one mass on a rail along x."""
    task = Task(
        Separate((MASS,)) if mechanism is None else mechanism,
        [effort],
        (0.0, speeds[0]),
        (distance, speeds[1]),
    )
    return Case(
        name,
        lambda: make_arm(slide(MASS), effort=np.array([effort]), **changes),
        task,
        minimum,
    )


def rail_cases() -> list[Case]:
    """Masses on level rails without friction, in closed form."""
    return [
        rail_case("rail", rail_time(1.0, PUSH)),
        rail_case(
            "rail, speed limit", rail_time(1.0, PUSH, top_speed=1.0), velocity=1.0
        ),
        rail_case(
            "rail, weak brake", rail_time(1.0, PUSH, WEAK * PUSH), effort=ONE_SIDED
        ),
        rail_case(
            "rail, weak brake, speed limit",
            rail_time(1.0, PUSH, WEAK * PUSH, top_speed=1.0),
            effort=ONE_SIDED,
            velocity=1.0,
        ),
        rail_case(
            "rail, moving ends",
            rail_time(1.0, PUSH, start_speed=1.2, end_speed=0.6),
            speeds=(1.2, 0.6),
        ),
        rail_case(
            "rail, moving away",
            rail_time(1.0, PUSH, start_speed=-1.5, end_speed=0.4),
            speeds=(-1.5, 0.4),
        ),
        rail_case(
            "rail, past the goal and back",
            rail_time(0.2, PUSH, start_speed=2.5),
            distance=0.2,
            speeds=(2.5, 0.0),
        ),
        rail_case(
            "rail, start at full speed",
            rail_time(1.0, PUSH, start_speed=1.0, top_speed=1.0),
            speeds=(1.0, 0.0),
            velocity=1.0,
        ),
        rail_case(
            "rail, rotor inertia",
            rail_time(1.0, FORCE / (MASS + 3.0)),
            mechanism=Separate((MASS + 3.0,)),
            armature=3.0,
        ),
    ]


def weight_cases() -> list[Case]:
    """A mass on an upright rail, and two rails of which the second takes longer."""

    def upright(name: str, distance: float, up: float, down: float) -> Case:
        return Case(
            name,
            lambda: make_arm(
                slide(MASS, (0.0, 1.0, 0.0)), effort=30.0, gravity=DOWNWARD
            ),
            Task(
                Separate((MASS,), force=(MASS * GRAVITY,)),
                [(-30.0, 30.0)],
                (0.0, 0.0),
                (distance, 0.0),
            ),
            rail_time(abs(distance), up, down),
        )

    force = 30.0 / MASS
    return [
        upright("rail, upwards", 1.0, force - GRAVITY, force + GRAVITY),
        upright("rail, downwards", -1.0, force + GRAVITY, force - GRAVITY),
        Case(
            "two rails",
            lambda: make_arm(
                slide(1.0), slide(2.0, (0.0, 1.0, 0.0)), effort=np.array([20.0, 10.0])
            ),
            # The first rail carries the second.
            Task(
                Separate((3.0, 2.0)),
                [(-20.0, 20.0), (-10.0, 10.0)],
                (0.0, 0.0, *REST),
                (0.5, 1.0, *REST),
            ),
            rail_time(1.0, 5.0),
        ),
    ]


def friction_cases() -> list[Case]:
    """Masses with viscous friction, from little to a time constant of 0.4 ms."""

    def damped(name: str, friction: float, **changes: Any) -> Case:
        effort = changes.get("effort", (-FORCE, FORCE))
        return rail_case(
            name,
            friction_time(1.0, MASS, friction, effort[1], -effort[0]),
            mechanism=Separate((MASS,), (friction,)),
            damping=friction,
            **changes,
        )

    return [
        damped("rail, friction 1", 1.0),
        damped("rail, friction 5", 5.0),
        damped("rail, friction 5, weak brake", 5.0, effort=ONE_SIDED),
        damped("rail, friction 50", 50.0),
        damped("rail, friction 5000", 5000.0),
    ]


# -- pendulum: a rod of 1 kg and 1 m ---------------------------------------------------

ROD = rod(1.0, 1.0)
ROD_INERTIA = 1.0 / 3.0
ROD_WEIGHT = 0.5 * GRAVITY


def pendulum_case(
    name: str,
    effort: float,
    structure: Structure,
    start: tuple[float, float] = (HANGING, 0.0),
    goal: tuple[float, float] = (UPRIGHT, 0.0),
    friction: float = 0.0,
) -> Case:
    """A case of one rod in the vertical plane."""
    mechanism = Separate((ROD_INERTIA,), (friction,), (ROD_WEIGHT,))
    return Case(
        name,
        lambda: make_arm(ROD, effort=effort, gravity=DOWNWARD, damping=friction),
        Task(mechanism, [(-effort, effort)], start, goal),
        structures=(structure,),
    )


def pendulum_cases() -> list[Case]:
    """Pendulums whose torque lifts the rod without a swing: one switch."""
    lift, damped = switches("+", "1", 0.24287, 0.39449), {"friction": 1.0}
    upright = switches("+", "1", 0.48037, 0.75093)
    return [
        pendulum_case("pendulum, lift", 12.0, lift, goal=(0.0, 0.0)),
        pendulum_case(
            "pendulum, lift, friction",
            12.0,
            switches("+", "1", 0.32972, 0.43041),
            goal=(0.0, 0.0),
            **damped,
        ),
        pendulum_case("pendulum, upright", 8.0, upright),
        pendulum_case(
            "pendulum, upright, friction",
            9.0,
            switches("+", "1", 0.74615, 0.88773),
            **damped,
        ),
        pendulum_case(
            "pendulum, moving ends",
            12.0,
            switches("+", "1", 0.32515, 0.47216),
            start=(HANGING, -2.0),
            goal=(0.3, 1.0),
        ),
    ]


def swing_cases() -> list[Case]:
    """Pendulums that must swing before they reach the top: two and three switches."""
    return [
        pendulum_case(
            "pendulum, one swing",
            0.6 * ROD_WEIGHT,
            switches("-", "11", 0.4384365, 1.4087792, 1.7456367),
        ),
        pendulum_case(
            "pendulum, one swing, friction",
            0.5 * ROD_WEIGHT,
            switches("-", "11", 0.7902346, 2.035291, 2.273117),
            friction=0.1,
        ),
        pendulum_case(
            "pendulum, two swings",
            0.35 * ROD_WEIGHT,
            switches("+", "111", 0.4904283, 1.3501771, 2.421687, 2.7959197),
        ),
    ]
