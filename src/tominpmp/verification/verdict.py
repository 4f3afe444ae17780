"""Verification: what a motion does when its torques are replayed.

The replay is judged, not the plan: where it ends, and by how much it passes limits and
margins on the way, every millisecond.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np

from tominpmp.arrays import Array, frozen_array
from tominpmp.collision import CollisionChecker
from tominpmp.exceptions import ProblemError
from tominpmp.goals import FrameGoal, JointGoal
from tominpmp.kinematics import RobotKinematics, prismatic_joints
from tominpmp.options import Tolerances
from tominpmp.problem import Problem
from tominpmp.trajectory import Trajectory
from tominpmp.verification.excess import Excess, limit_excesses
from tominpmp.verification.replay import (
    Integration,
    Integrator,
    Replay,
    torque_pieces,
)

# Instants at which all distances are measured first, and what two measurements of one
# distance may differ by [m].
GLANCES = 8
GLANCE_ROUNDING = 1e-6
# Instants whose distances are asked for at once; those of long motions take memory.
CHUNK = 2000


@dataclass(frozen=True, eq=False)
class Verification:
    """What a motion does when its torques are replayed.

    Attributes:
        ok: Whether it reaches the goal and keeps all limits, within the tolerances.
        goal_error: Distance of the end from the goal: of the worst joint, or of the
            frame in position and angle [rad or m].
        speed_error: Difference of the velocity at the end to the one asked for: of the
            worst joint or direction [rad/s or m/s].
        worst: The worst of each kind ("position", "velocity", "effort", "clearance",
            ...) with joint or pair, time and amount, also where it is allowed.
        violations: Those that are not within the tolerances, the goal among them.
        min_clearance: Smallest distance to obstacles and between links [m], every
            millisecond; infinite without pairs.
        deviation: Largest distance of each joint from the plan, shape (n,).
        defect: Largest distance in position by which an interval that begins at its own
            node misses the next one; None if the motion is all right. Where this is
            small and the goal missed, the motion is unstable, or errors added up.
        integrator: What integrated the torques.
        complete: Whether the replay came to the end.
        tolerances: What was tolerated.
        seconds: Time it took [s].
        replay: The replayed motion.
    """

    ok: bool
    goal_error: float
    speed_error: float
    worst: dict[str, Excess]
    violations: tuple[Excess, ...]
    min_clearance: float
    deviation: Array
    defect: float | None
    integrator: str
    complete: bool
    tolerances: Tolerances
    seconds: float
    replay: Replay = field(repr=False)

    @property
    def message(self) -> str:
        """What is wrong with the motion, or that nothing is, in a sentence."""
        if self.ok:
            return f"The replay reaches the goal within {self.goal_error:.1e}."
        return "; ".join(map(str, self.violations)) + "."


def verify(
    problem: Problem,
    trajectory: Trajectory,
    tolerances: Tolerances | None = None,
    *,
    checker: CollisionChecker | None = None,
    integrator: Integrator | None = None,
) -> Verification:
    """Replay the torques of a motion and judge what they bring about.

    Args:
        problem: What the motion is to solve.
        trajectory: The motion: its torques are used, and its nodes, where they may
            jump.
        tolerances: What is tolerated.
        checker: Distances to use, for example those of the exact meshes; None makes
            the usual ones.
        integrator: See :func:`~tominpmp.verification.replay.replay`.

    Returns:
        What was found.

    Raises:
        ProblemError: If the motion is one of other joints.
    """
    begin = time.perf_counter()
    tolerances = Tolerances() if tolerances is None else tolerances
    robot = problem.robot
    if trajectory.joint_names != robot.joint_names:
        raise ProblemError(
            f"the motion is one of {', '.join(trajectory.joint_names)}, expected "
            f"{', '.join(robot.joint_names)}",
            "trajectory",
        )
    if not all(np.all(np.isfinite(x)) for x in (trajectory.q, trajectory.u)):
        raise ProblemError("the motion has positions or torques that are no numbers")
    torque = torque_pieces(trajectory)
    integration = Integration(robot, trajectory, torque, integrator)
    v_start = np.zeros(robot.n) if problem.v_start is None else problem.v_start
    replayed = integration.run(np.concatenate([problem.q_start, v_start]))
    found = limit_excesses(problem, replayed, torque, tolerances.limits)
    if checker is None:
        checker = CollisionChecker(robot, problem.scene)
    nearest = closest(problem, replayed, checker, tolerances.contact)
    if nearest is not None:
        found.append(nearest)
    end = arrival(problem, replayed, tolerances)
    violations = tuple(item for item in (*end, *found) if item.violated)
    defect = None
    if violations:
        gaps = np.abs(integration.defects()[:, : robot.n])
        defect = float(np.max(np.where(np.isfinite(gaps), gaps, np.inf)))
    return Verification(
        ok=not violations,
        goal_error=end[0].amount,
        speed_error=end[1].amount,
        worst={item.kind: item for item in found},
        violations=violations,
        min_clearance=(np.inf if nearest is None else problem.margin - nearest.amount),
        deviation=frozen_array(
            np.max(np.abs(replayed.q - trajectory(replayed.t).q), axis=0)
        ),
        defect=defect,
        integrator=replayed.integrator,
        complete=replayed.complete,
        tolerances=tolerances,
        seconds=time.perf_counter() - begin,
        replay=replayed,
    )


def closest(
    problem: Problem, replay: Replay, checker: CollisionChecker, tolerance: float
) -> Excess | None:
    """The pair that comes closest; None without pairs."""
    if not checker.pairs:
        return None
    # The closest of a few instants tells how far the others need to be looked at.
    last = replay.t.size - 1
    some = np.linspace(0, last, GLANCES).astype(np.int64)
    glance = checker.distances(replay.q[some])
    first, pair = np.unravel_index(int(np.argmin(glance)), glance.shape)
    row, distance = int(some[first]), float(glance[first, pair])
    for begin in range(0, last + 1, CHUNK):
        cutoff = max(distance, problem.margin) + GLANCE_ROUNDING
        part = checker.distances(replay.q[begin : begin + CHUNK], cutoff)
        k, other = np.unravel_index(int(np.argmin(part)), part.shape)
        if part[k, other] < distance:
            row, pair, distance = begin + int(k), other, float(part[k, other])
    lack = problem.margin - distance
    name = " and ".join(checker.pairs[int(pair)])
    time = float(replay.t[row])
    violated = not lack <= tolerance
    return Excess("clearance", name, time, lack, "m", lack, violated)


def arrival(
    problem: Problem, replay: Replay, tolerances: Tolerances
) -> tuple[Excess, Excess]:
    """Where the motion ends: place and velocity."""
    robot, goal = problem.robot, problem.goal
    kinematics = RobotKinematics(robot)
    value = goal.residual(kinematics, replay.q[-1], replay.v[-1]).value
    speeds = robot.n if goal.fixes_velocity else 3
    place, speed = np.abs(value[:-speeds]), np.abs(value[-speeds:])
    names = [f"joint {joint}" for joint in robot.joint_names]
    slides = prismatic_joints(robot)
    frame = goal.frame if isinstance(goal, FrameGoal) else "the arm"

    def worst(kind: str, error: Array, of_joints: bool, tolerance: float) -> Excess:
        k = int(np.argmax(error))
        name = names[k] if of_joints else f"frame {frame}"
        straight = slides[k] if of_joints else k < 3
        unit = ("m" if straight else "rad") + ("/s" if kind == "speed" else "")
        amount = float(error[k]) if replay.complete else np.inf
        time, violated = replay.duration, not amount <= tolerance
        return Excess(kind, name, time, amount, unit, amount, violated)

    return (
        worst("goal", place, isinstance(goal, JointGoal), tolerances.goal),
        worst("speed", speed, goal.fixes_velocity, tolerances.speed),
    )
