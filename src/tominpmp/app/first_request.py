"""The first request for a robot: a start and a goal, and an obstacle in examples."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from tominpmp.app.request import (
    MODERATE,
    Request,
    RobotChoice,
    group_names,
    loaded,
    rounded,
)
from tominpmp.arrays import Array
from tominpmp.exceptions import ProblemError, RobotLoadError, quiet
from tominpmp.goals.joints import JointGoal
from tominpmp.motion_limits import MotionLimits
from tominpmp.problem.problem import Problem
from tominpmp.robot.robot import Robot
from tominpmp.scene.obstacles import Box, Cylinder, Sphere
from tominpmp.viz.skeleton import last_frame

# Joints such as fingers that are locked, with their positions, by robot [rad or m].
LOCKED: dict[str, tuple[tuple[str, float], ...]] = {
    "panda": (("panda_finger_joint1", 0.04),),
    "z1": (("jointGripper", 0.0),),
}
# Names of group states for the start, in order of preference.
START_NAMES = ("ready", "default", "home", "start", "neutral", "half_sitting", "arm_up")
# Suffixes of the names of tool frames, in order of preference.
TOOLS = "hand_tcp tcp tool0 tip tool tool_link eef ee_link hand".split()
# Displacement of a joint from the start to a default goal [rad or m].
SWING = 1.2
# Number of random configurations tried for a start, and for a goal.
TRIALS = 60


def known(source: str, **others: Any) -> RobotChoice:
    """The choice of a robot by its name, with joints such as fingers locked.

    Args:
        source: Name of the robot, or path of a URDF file.
        **others: Further fields of the choice.
    """
    return RobotChoice(source, **{"locked": LOCKED.get(source, ())} | others)


def first_request(choice: RobotChoice) -> Request:
    """The first request for a robot.

    A robot with too many joints for the page moves those of the first group that fits.

    Raises:
        TominpmpError: If the robot cannot be loaded, or no start and goal are found.
    """
    try:
        robot = loaded(choice)
    except RobotLoadError:
        for group in () if choice.group else group_names(choice.source):
            with suppress(RobotLoadError):
                return first_request(replace(choice, group=group, locked=()))
        raise
    own = robot.motion_limits
    # A kinematic robot needs acceleration limits.
    free = robot.kinematic and (own is None or own.acceleration is None)
    fields = EXAMPLES.get(choice.source, {})
    if len(fields.get("q_start", ())) != robot.n:
        start = _first_free(robot, _starts(robot))
        goal = _first_free(robot, _goals(robot, start))
        fields = {"q_start": start, "q_goal": goal, "margin": 0.01}
    frame, acceleration = tool_frame(robot), MODERATE if free else None
    return Request(robot=choice, frame=frame, acceleration=acceleration, **fields)


def tool_frame(robot: Robot) -> str:
    """The frame that handles move: a tool frame, or else the last of the chain."""
    carried = [str(item.name) for item in robot.model.frames if item.parentJoint]
    tools = (name for end in TOOLS for name in carried if name.endswith(end))
    return next(tools, last_frame(robot))


def _starts(robot: Robot) -> Iterator[Array]:
    """Candidates for the start: group states, the middle of the limits, random ones."""
    low, high = robot.limits.position_lower, robot.limits.position_upper
    states = robot.group_states
    spare = np.where(np.isfinite(high - low), 0.1 * (high - low), 0.0)
    middle = np.clip(0.0, low + spare, high - spare)
    for name in START_NAMES:
        if name in states:
            state = [states[name].get(joint, np.nan) for joint in robot.joint_names]
            yield np.where(np.isfinite(state), state, middle)
    yield middle
    rng = np.random.default_rng(0)
    for share in np.linspace(0.2, 1.0, TRIALS):
        yield np.clip(middle + share * rng.uniform(-2.0, 2.0, robot.n), low, high)


def _goals(robot: Robot, start: tuple[float, ...]) -> Iterator[Array]:
    """Candidates for the goal: all joints turned a little, the first one more."""
    low, high = robot.limits.position_lower, robot.limits.position_upper
    turn = 0.5 * SWING * np.array([(-1.0) ** i for i in range(robot.n)])
    turn[0] = SWING
    steps = [share * turn for share in (1.0, -1.0, 0.6, -0.6, 0.3, -0.3)]
    rng = np.random.default_rng(1)
    for share in np.linspace(1.0, 0.1, TRIALS):
        steps.append(share * SWING * rng.uniform(-1.0, 1.0, robot.n))
    for step in steps:
        yield np.clip(start + step, low, high)


@quiet()
def _first_free(robot: Robot, candidates: Iterator[Array]) -> tuple[float, ...]:
    """The first candidate that is inside the limits and free of collisions.

    Raises:
        RobotLoadError: If no candidate is.
    """
    for q in candidates:
        with suppress(ProblemError):
            start: tuple[float, ...] = rounded(q)
            limits = MotionLimits(acceleration=MODERATE)
            Problem(robot, start, JointGoal(start), motion_limits=limits)
            return start
    raise RobotLoadError(
        f"no configuration of {robot.name} without self-collision was found",
        robot.urdf_path,
    )


# Fields of requests for well-known robots, with an obstacle between start and goal.
EXAMPLES: dict[str, dict[str, Any]] = {
    "panda": {
        "q_start": (-0.6, -0.3, 0.0, -2.2, 0.0, 2.0, 0.8),
        "q_goal": (0.9, -0.2, 0.0, -2.0, 0.0, 1.8, 0.8),
        "items": (Box("post", size=(0.1, 0.1, 1.0), position=(0.5, 0.1, 0.5)),),
    },
    "ur5": {
        "q_start": (-0.8, -1.2, 1.4, -1.8, -1.57, 0.0),
        "q_goal": (1.1, -1.0, 1.2, -1.8, -1.57, 0.0),
        "items": (
            Cylinder("post", radius=0.06, length=0.9, position=(0.55, 0.1, 0.45)),
        ),
    },
    "planar3r": {
        "q_start": (0.5, 1.7, -1.7),
        "q_goal": (0.9, -1.2, -0.9),
        "items": (Sphere("O", radius=0.8, position=(4.0, 0.0, 0.0)),),
        "margin": 0.0,
    },
}
