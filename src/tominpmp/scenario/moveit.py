"""MoveIt motion plan requests (YAML): start and goal of a problem."""

from __future__ import annotations

import os
import warnings
from pathlib import Path

import numpy as np

from tominpmp.arrays import Array
from tominpmp.description.fields import Field
from tominpmp.exceptions import JointNotFound, ProblemError, TominpmpWarning, brief
from tominpmp.problem import Problem
from tominpmp.robot import Robot, load_robot
from tominpmp.scenario.moveit_goals import APART, read_goal
from tominpmp.scenario.moveit_scene import (
    Frames,
    load_moveit_scene,
    read_frames,
    read_message,
    read_scene,
    refuse_attached,
)

__all__ = ["load_moveit", "load_moveit_scene"]


def load_moveit(
    robot: Robot | str | os.PathLike[str],
    scene_path: str | Path,
    request_path: str | Path,
    *,
    margin: float = 0.0,
) -> Problem:
    """Load a problem from a MoveIt planning scene and a motion plan request.

    Tolerances up to 0.01 rad or m are taken for accuracy, and the goal is the middle of
    what they leave; wider ones make a goal region. Several sets of goal constraints are
    alternatives, of which any will do. All poses become those in the frame of the
    robot's first link. A velocity scaling factor below 1 scales the
    robot's speed limits.

    Args:
        robot: The robot. Joints of which the goal says nothing stay where they start.
            Given by its name or path, it is loaded with those joints locked.
        scene_path: YAML file with a ``PlanningScene`` message.
        request_path: YAML file with a ``MotionPlanRequest`` message.
        margin: Distance to keep from obstacles [m].

    Returns:
        The problem.

    Raises:
        ScenarioError: If a file is wrong, or the problem in it, as by a start in
            collision; with the file and the key in it.
        RobotLoadError: If the robot cannot be loaded.
        ProblemError: If the margin is wrong.
    """
    scene_message, request = read_message(scene_path), read_message(request_path)
    state = request.get("start_state")
    start = _joint_values(state.get("joint_state"), "name", "position")
    if not isinstance(robot, Robot):
        try:
            robot = load_robot(robot, locked_joints=_unmoved(request, start))
        except JointNotFound as error:
            state.get("joint_state").get("name").fail(str(error))
    _check_state(robot, state.get("joint_state"), start)
    _refuse_unread(request)
    refuse_attached(state)
    frames = read_frames(scene_message, robot, state)
    _check_upright(frames, robot, scene_message)
    scene = read_scene(scene_message, frames)
    goal = read_goal(request, robot, frames, start)
    try:
        return Problem(
            _scaled(robot, request.get("max_velocity_scaling_factor")),
            np.array([start[name] for name in robot.joint_names]),
            goal,
            scene=scene,
            margin=margin,
            v_start=_start_velocity(robot, state.get("joint_state")),
        )
    except ProblemError as error:
        blamed = (error.field or "").split(".")[0]
        places = {"q_start": "start_state", "v_start": "start_state"}
        if blamed == "margin":
            raise
        request.get(places.get(blamed, "goal_constraints")).fail(str(error))


def _joint_values(state: Field, names: str, values: str) -> dict[str, float]:
    """Values by joint name of a JointState."""
    joints = [item.text() for item in state.need(names).items()]
    found = state.need(values)
    numbers = found.numbers()
    if len(numbers) != len(joints):
        found.fail(f"holds {len(numbers)} numbers for {len(joints)} joints")
    return dict(zip(joints, numbers, strict=True))


def resting_joints(request_path: str | Path) -> dict[str, float]:
    """Find the joints that a request does not move.

    Args:
        request_path: YAML file with a ``MotionPlanRequest`` message.

    Returns:
        Joints of the start state of which a goal of joint positions says nothing, with
        their positions [rad or m]; none for goals of other kinds.

    Raises:
        ScenarioError: If the file is wrong.
    """
    request = read_message(request_path)
    state = request.get("start_state").get("joint_state")
    return _unmoved(request, _joint_values(state, "name", "position"))


def _unmoved(request: Field, start: dict[str, float]) -> dict[str, float]:
    moved = set()
    for goal in request.get("goal_constraints").items():
        if any(goal.get(f"{k}_constraints").given for k in ("position", "orientation")):
            return {}  # any joint may move to bring a link to its place
        for item in goal.get("joint_constraints").items():
            moved.add(item.need("joint_name").text())
    return {k: v for k, v in start.items() if k not in moved} if moved else {}


def _check_state(robot: Robot, state: Field, start: dict[str, float]) -> None:
    """Check the joints of the start state against those of the robot."""
    known = {joint.name for joint in robot.description.joints}
    for name in start:
        if name not in known:
            state.get("name").fail(
                f"there is no joint {brief(name)}; the robot has: "
                f"{', '.join(sorted(known))}"
            )
    lacking = [name for name in robot.joint_names if name not in start]
    if lacking:
        state.get("name").fail(f"says nothing about the joints {', '.join(lacking)}")
    for name, position in robot.locked_joints.items():
        asked = start.get(name, position)
        if abs(asked - position) > APART:
            warnings.warn(
                f"{state.path}: joint {name} is at {asked:g} at the start, but the "
                f"robot has it locked at {position:g}",
                TominpmpWarning,
                stacklevel=3,
            )


def _start_velocity(robot: Robot, state: Field) -> Array | None:
    if not state.get("velocity").given:
        return None
    velocity = _joint_values(state, "name", "velocity")
    return np.array([velocity[name] for name in robot.joint_names])


def _refuse_unread(request: Field) -> None:
    """Refuse constraints on the way, which a motion would silently break."""
    for key in ("path_constraints", "trajectory_constraints"):
        for name, item in (request.get(key).value or {}).items():
            if isinstance(item, list) and item:
                request.get(key).get(name).fail("constraints on the way are not read")


def _check_upright(frames: Frames, robot: Robot, message: Field) -> None:
    """Refuse a base that stands askew: gravity would have another direction."""
    turned = frames.base.rotation.T @ robot.gravity
    if not np.allclose(turned, robot.gravity, atol=1e-6 * (1.0 + np.abs(turned).max())):
        message.get("robot_state").get("multi_dof_joint_state").fail(
            "the base of the robot is tilted: leave that out here and load the robot "
            f"with the gravity that its base sees, {np.round(turned, 6).tolist()}"
        )


def _scaled(robot: Robot, factor: Field) -> Robot:
    """Scale the speed limits; MoveIt takes whatever is not in (0, 1] for 1."""
    value = factor.number() if factor.given else 1.0
    if not 0.0 < value < 1.0:
        return robot
    return robot.with_changes(velocity=value * robot.limits.velocity)
