"""MoveIt motion plan requests (YAML): start and goal of a problem."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from tominpmp.arrays import Array
from tominpmp.description.fields import Field
from tominpmp.description.groups import (
    JointGroup,
    rest_position,
    warn_of_group,
)
from tominpmp.description.srdf import SemanticDescription
from tominpmp.description.tree import JointDescription, UrdfDescription
from tominpmp.exceptions import ProblemError, brief, warn_caller
from tominpmp.files.moveit_goals import APART, read_goal
from tominpmp.files.moveit_scene import (
    REQUEST,
    Frames,
    load_moveit_scene,
    read_frames,
    read_message,
    read_scene,
    refuse_attached,
    warn_of_unread,
)
from tominpmp.problem import Problem
from tominpmp.robot import Robot, RobotSource, load_robot, read_source

__all__ = ["load_moveit", "load_moveit_scene"]

# A joint that follows may be this far from where its leader puts it [rad or m].
TOGETHER = 1e-9


def _start_positions(request: Field) -> dict[str, float]:
    """Joint positions of the start state by name [rad or m].

    Raises:
        ScenarioError: If there are none, or a joint is there twice.
    """
    state = request.get("start_state").get("joint_state")
    return joint_values(state, "name", "position")


def joint_values(state: Field, names: str, values: str) -> dict[str, float]:
    """Values by joint name of a JointState.

    Raises:
        ScenarioError: If there are more or fewer values than names, or a name twice.
    """
    joints = [item.text() for item in state.need(names).items()]
    found = state.need(values)
    numbers = found.numbers()
    if len(numbers) != len(joints):
        found.fail(f"holds {len(numbers)} numbers for {len(joints)} joints")
    if len(set(joints)) != len(joints):
        twice = next(name for name in joints if joints.count(name) > 1)
        state.get(names).fail(f"the joint {brief(twice)} is there twice")
    return dict(zip(joints, numbers, strict=True))


def unmoved(request: Field, start: Mapping[str, float]) -> dict[str, float]:
    """Joints of the start state of which a goal of joint positions says nothing.

    Returns:
        Their positions [rad or m]; none for goals of other kinds.
    """
    moved = _goal_joints(request)
    if not moved or _goal_links(request):
        return {}  # any joint may move to bring a link to its place
    return {name: value for name, value in start.items() if name not in moved}


def _goal_joints(request: Field) -> set[str]:
    """Joints that the goal names."""
    return {
        item.need("joint_name").text()
        for goal in request.get("goal_constraints").items()
        for item in goal.get("joint_constraints").items()
    }


def _goal_links(request: Field) -> list[str]:
    """Links that the goal names."""
    found = [
        str(item.get("link_name").value)
        for goal in request.get("goal_constraints").items()
        for kind in ("position", "orientation")
        for item in goal.get(f"{kind}_constraints").items()
    ]
    return list(dict.fromkeys(found))


def group_locks(
    request: Field,
    start: Mapping[str, float],
    description: UrdfDescription,
    semantics: SemanticDescription | None,
) -> dict[str, float]:
    """Find the joints outside the group of a request, and where they are held.

    Where the SRDF file lacks the group, its joints are those that the goal names, or
    that carry the links that it names.

    Args:
        request: A message ``MotionPlanRequest``.
        start: Positions of its start state by joint [rad or m].
        description: The robot.
        semantics: Its SRDF file, if there is one.

    Returns:
        Positions by joint name [rad or m]: of the start state, else of a group state,
        else zero; empty if the request names no group.
    """
    name = request.get("group_name")
    if not name.given:
        return {}
    group = _group(name, semantics)
    moving = set(group.joints)
    if not moving:
        moving = _goal_joints(request)
        for link in _goal_links(request):
            moving |= description.joints_above(link)
    joints = description.joints
    outside = [j for j in joints if j.name not in moving and not j.mimic]
    if not group.joints and _goal_links(request) and outside:
        _warn_of_unknown_group(name, semantics, [j.name for j in outside])
    states = {} if semantics is None else semantics.group_states
    lacking = [joint.name for joint in outside if joint.name not in start]
    if lacking:
        warn_caller(
            f"{request.path}: start_state says nothing about {', '.join(lacking)}, "
            "outside the group; held where the robot's SRDF file has them, else at 0"
        )
    return {j.name: start.get(j.name, rest_position(j, states)) for j in outside}


def followers(
    start: Mapping[str, float],
    joints: Sequence[JointDescription],
    locks: Mapping[str, float],
) -> dict[str, float]:
    """Positions of joints that follow locked ones, where the start state has them so.

    Others are left out with a warning: where they are follows from their leaders.
    """
    found = {}
    for joint in joints:
        mimic = joint.mimic
        if mimic is None or mimic.leader not in locks or joint.name not in start:
            continue
        there = mimic.multiplier * locks[mimic.leader] + mimic.offset
        if abs(there - start[joint.name]) <= TOGETHER:
            found[joint.name] = start[joint.name]
    return found


def _warn_of_unknown_joints(
    state: Field, start: Mapping[str, float], known: Sequence[str]
) -> None:
    """Warn of joints of the start state that the robot lacks, as those of a gripper."""
    unknown = [name for name in start if name not in known]
    if unknown:
        shown = ", ".join(brief(name) for name in unknown[:20])
        warn_caller(
            f"{state.path}: {state.key}: the robot has no joints {shown}; what they "
            "move is not part of it"
        )


def _group(name: Field, semantics: SemanticDescription | None) -> JointGroup:
    """The group that is asked for; an empty one if it is not known."""
    groups = None if semantics is None else semantics.groups
    found = None if groups is None else groups.find(name.text())
    if groups is None or found is None:
        return JointGroup(())
    if groups.groups[found].joints:
        warn_of_group(found, groups.groups[found])
    return groups.groups[found]


def _warn_of_unknown_group(
    name: Field, semantics: SemanticDescription | None, held: Sequence[str]
) -> None:
    known = [] if semantics is None else list(semantics.groups.groups)
    warn_caller(
        f"{name.path}: {name.key}: the robot has no group {brief(name.text())} (it "
        f"has: {', '.join(known) or 'none'}); planned are the joints that carry the "
        f"links of the goal, and {', '.join(held)} are held"
    )


def load_moveit(
    robot: Robot | str | os.PathLike[str],
    scene_path: str | Path,
    request_path: str | Path,
    *,
    margin: float = 0.0,
    self_collision: bool | None = None,
) -> Problem:
    """Load a problem from a MoveIt planning scene and a motion plan request.

    Tolerances up to 0.01 rad or m are taken for accuracy, and the goal is the middle of
    what they leave; wider ones make a goal region. Several sets of goal constraints are
    alternatives, of which any will do. All poses become those in the frame of the
    robot's first link. Scaling factors below 1 scale the robot's limits of speeds and
    of accelerations, if it has any. What the files say and is not read causes a
    warning.

    Args:
        robot: The robot, or its name or path. Planned is the group of its SRDF file
            that the request names; the other joints are locked where they start.
            Joints of the group of which a goal of joint positions says nothing stay
            where they start, too.
        scene_path: YAML file with a ``PlanningScene`` message.
        request_path: YAML file with a ``MotionPlanRequest`` message.
        margin: Distance to keep from obstacles [m].
        self_collision: Whether the links keep clear of each other; None as for
            :class:`~tominpmp.problem.Problem`.

    Returns:
        The problem. Joints of the start state that the robot lacks, and locked ones
        outside their limits, cause a warning.

    Raises:
        ScenarioError: If a file is wrong, or the problem in it, as by a start in
            collision; with the file and the key in it.
        RobotLoadError: If the robot cannot be loaded.
        ProblemError: If the margin is wrong.
    """
    scene_message, request = read_message(scene_path), read_message(request_path)
    state, start = request.get("start_state"), _start_positions(request)
    arm = _grouped_robot(robot, request, start)
    _check_state(arm, state.get("joint_state"), start)
    _refuse_unread(request)
    warn_of_unread(request, REQUEST)
    refuse_attached(state)
    frames = read_frames(scene_message, arm, state)
    _check_upright(frames, arm, scene_message)
    scene = read_scene(scene_message, frames)
    goal = read_goal(request, arm, frames, start)
    try:
        return Problem(
            _scaled(arm, request),
            np.array([start[name] for name in arm.joint_names]),
            goal,
            scene=scene,
            margin=margin,
            v_start=_start_velocity(arm, state.get("joint_state")),
            self_collision=self_collision,
        )
    except ProblemError as error:
        blamed = (error.field or "").split(".")[0]
        places = {"q_start": "start_state", "v_start": "start_state"}
        if blamed == "margin":
            raise
        request.get(places.get(blamed, "goal_constraints")).fail(str(error))


def request_locks(source: RobotSource, request_path: str | Path) -> dict[str, float]:
    """Find the joints to lock where a robot is loaded for a request in a YAML file.

    Positions by joint name [rad or m]: of those outside its group, and of those of
    which a goal of joint positions says nothing.

    Raises:
        ScenarioError: If the file is wrong.
    """
    request = read_message(request_path)
    return _locks(request, _start_positions(request), source)


def _locks(
    request: Field, start: Mapping[str, float], source: RobotSource
) -> dict[str, float]:
    description, semantics = source.description, source.semantics
    joints = {joint.name: joint for joint in description.joints}
    locks = group_locks(request, start, description, semantics)
    for name, position in unmoved(request, start).items():
        if name in joints and joints[name].mimic is None:
            locks[name] = position
    return locks | followers(start, description.joints, locks)


def _grouped_robot(
    robot: Robot | str | os.PathLike[str], request: Field, start: Mapping[str, float]
) -> Robot:
    """The robot with the joints locked that the request does not move."""
    if not isinstance(robot, Robot):
        source = read_source(robot)
        return load_robot(robot, locked_joints=_locks(request, start, source))
    locks = group_locks(request, start, robot.description, robot.srdf)
    further = {k: v for k, v in locks.items() if k in robot.joint_names}
    return robot.with_locked(further) if further else robot


def _check_state(robot: Robot, state: Field, start: Mapping[str, float]) -> None:
    """Check the joints of the start state against those of the robot."""
    known = [joint.name for joint in robot.description.joints]
    lacking = [name for name in robot.joint_names if name not in start]
    if lacking:
        unknown = [brief(name) for name in start if name not in known][:10]
        hint = ""
        if unknown:
            hint = f", and there is no joint {', '.join(unknown)}"
        state.get("name").fail(
            f"says nothing about the joints {', '.join(lacking)}{hint}; the robot "
            f"has: {', '.join(sorted(known))}"
        )
    _warn_of_unknown_joints(state.get("name"), start, known)
    for name, position in robot.locked_joints.items():
        asked = start.get(name, position)
        if abs(asked - position) > APART:
            warn_caller(
                f"{state.path}: joint {name} is at {asked:g} at the start, but the "
                f"robot has it locked at {position:g}"
            )


def _start_velocity(robot: Robot, state: Field) -> Array | None:
    if not state.get("velocity").given:
        return None
    velocity = joint_values(state, "name", "velocity")
    held = [name for name in robot.locked_joints if velocity.get(name, 0.0) != 0.0]
    if held:
        warn_caller(
            f"{state.path}: {', '.join(held)} move at the start, but are locked"
        )
    return np.array([velocity[name] for name in robot.joint_names])


def _refuse_unread(request: Field) -> None:
    """Refuse constraints on the way, which a motion would silently break."""
    for key in ("path_constraints", "trajectory_constraints"):
        for name, item in (request.get(key).value or {}).items():
            if isinstance(item, list) and item:
                request.get(key).get(name).fail("constraints on the way are not read")
    speed = request.get("max_cartesian_speed")
    # MoveIt takes zero, and what is below it, for no limit.
    if speed.given and speed.number() > 0.0:
        speed.fail(f"is {speed.number():g}: speeds of links are not limited here")


def _check_upright(frames: Frames, robot: Robot, message: Field) -> None:
    """Refuse a base that stands askew: gravity would have another direction."""
    turned = frames.base.rotation.T @ robot.gravity
    if not np.allclose(turned, robot.gravity, atol=1e-6 * (1.0 + np.abs(turned).max())):
        message.get("robot_state").get("multi_dof_joint_state").fail(
            "the base of the robot is tilted: leave that out here and load the robot "
            f"with the gravity that its base sees, {np.round(turned, 6).tolist()}"
        )


def _scaled(robot: Robot, request: Field) -> Robot:
    """Scale limits of speeds and accelerations, as MoveIt does."""
    speed = _factor(request.get("max_velocity_scaling_factor"))
    if speed < 1.0:
        robot = robot.with_changes(velocity=speed * robot.limits.velocity)
    factor = request.get("max_acceleration_scaling_factor")
    share, limits = _factor(factor), robot.motion_limits
    if share == 1.0:
        return robot
    if limits is None or limits.acceleration is None:
        warn_caller(
            f"{factor.path}: {factor.key} is {share:g}, but the robot has no limits of "
            "accelerations; give some, as by limits='datasheet'"
        )
        return robot
    accelerations = share * limits.by_joint("acceleration", robot.joint_names)
    return replace(robot, motion_limits=replace(limits, acceleration=accelerations))


def _factor(field: Field) -> float:
    """A factor; MoveIt takes whatever is not in (0, 1] for 1."""
    value = field.number() if field.given else 1.0
    return value if 0.0 < value < 1.0 else 1.0
