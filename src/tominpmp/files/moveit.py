"""MoveIt motion plan requests (YAML): start and goal of a problem.

A tolerance that stands for accuracy gives a goal at the middle of what is tolerated; a
wider one is a freedom, and gives a goal region. No region is larger than what the
request tolerates.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array
from tominpmp.description.fields import Field
from tominpmp.description.groups import (
    rest_position,
    warn_of_group,
)
from tominpmp.description.srdf import SemanticDescription
from tominpmp.description.tree import JointDescription, UrdfDescription
from tominpmp.exceptions import ProblemError, brief, warn_caller
from tominpmp.files.moveit_scene import (
    REQUEST,
    Frames,
    load_moveit_scene,
    read_frames,
    read_mesh_corners,
    read_message,
    read_pose,
    read_primitive,
    read_rotation,
    read_scene,
    refuse_attached,
    warn_of_unread,
)
from tominpmp.files.records import blaming
from tominpmp.goals import (
    AllGoals,
    AnyGoal,
    AxisGoal,
    Goal,
    JointGoal,
    JointRegionGoal,
    PoseGoal,
    PositionGoal,
    RegionGoal,
)
from tominpmp.problem import Problem
from tominpmp.robot import Robot, RobotSource, load_robot, read_source

__all__ = ["load_moveit", "load_moveit_scene"]

# A joint that follows may be this far from where its leader puts it [rad or m].
TOGETHER = 1e-9
# A joint that does not move may be this far from where the request has it
# [rad or m].
APART = 1e-3
# Tolerances up to this are the accuracy that MoveIt's tools ask for, not a freedom
# [m or rad].
ACCURACY = 0.0101
# Alternatives beyond this are a mistake: each is planned for.
MOST = 64


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
    groups = None if semantics is None else semantics.groups
    found = None if groups is None else groups.find(name.text())
    moving = set[str]()
    if groups is not None and found is not None:
        moving = set(groups.groups[found].joints)
        if moving:
            warn_of_group(found, groups.groups[found])
    links, named = _goal_links(request), bool(moving)
    if not named:
        moving = _goal_joints(request)
        for link in links:
            moving |= description.joints_above(link)
    joints = description.joints
    outside = [j for j in joints if j.name not in moving and not j.mimic]
    if not named and links and outside:
        known = "none" if groups is None else ", ".join(groups.groups) or "none"
        warn_caller(
            f"{name.path}: {name.key}: the robot has no group {brief(name.text())} (it "
            f"has: {known}); planned are the joints that carry the links of the goal, "
            f"and {', '.join(j.name for j in outside)} are held"
        )
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
    goal = _read_goal(request, arm, frames, start)
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
    unknown = [brief(name) for name in start if name not in known]
    names = state.get("name")
    if lacking:
        hint = f", and there is no joint {', '.join(unknown[:10])}" if unknown else ""
        names.fail(
            f"says nothing about the joints {', '.join(lacking)}{hint}; the robot "
            f"has: {', '.join(sorted(known))}"
        )
    if unknown:  # as those of a gripper
        warn_caller(
            f"{names.path}: {names.key}: the robot has no joints "
            f"{', '.join(unknown[:20])}; what they move is not part of it"
        )
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


@dataclass(frozen=True)
class _Turn:
    """An orientation that is asked for.

    Attributes:
        rotation: Rotation of the link in the frame of the base, shape (3, 3).
        tolerance: Tolerances about its axes, 0 to pi [rad], shape (3,).
    """

    rotation: Array
    tolerance: Array

    @property
    def exact(self) -> bool:
        return not np.any(self.tolerance)


@dataclass(frozen=True)
class _Region:
    """Where a point is to be.

    Attributes:
        kind: "point", "sphere" or "box".
        size: Radius, or half edges, shape (3,) [m]; zero for a point.
        pose: Placement in the frame of the base.
    """

    kind: str
    size: Array
    pose: pin.SE3


def _read_goal(
    request: Field, robot: Robot, frames: Frames, start: Mapping[str, float]
) -> Goal:
    """Read the goal of a request; several sets of constraints are alternatives.

    Args:
        request: A message ``MotionPlanRequest``.
        robot: The robot.
        frames: Frames in which its poses may be given.
        start: Start, by joint; joints stay there of which a goal of joint positions
            says nothing.

    Raises:
        ScenarioError: If there is no goal or a constraint is wrong, or of a kind that
            is not read: visibility.
    """
    constraints = request.need("goal_constraints")
    goals: list[Goal] = []
    for item in constraints.items():
        if any(value.given for value in item.table().values()):
            goals += _alternatives(item, robot, frames, start)
    if not goals:
        constraints.fail("is empty, expected a goal")
    if len(goals) > MOST:
        constraints.fail(f"holds {len(goals)} alternatives, expected {MOST} at most")
    return goals[0] if len(goals) == 1 else AnyGoal(goals)


def _alternatives(
    item: Field, robot: Robot, frames: Frames, start: Mapping[str, float]
) -> list[Goal]:
    """Goals of which each meets one set of constraints."""
    joints = list(item.get("joint_constraints").items())
    places = list(item.get("position_constraints").items())
    turns = _turns(item, robot, frames)
    if item.get("visibility_constraints").given:
        item.get("visibility_constraints").fail("visibility goals are not read")
    with blaming(item):
        if joints and not places and not turns:
            return [_joint_goal(joints, robot, start)]
        fixed = [_joint_region(joints, robot)] if joints else []
        choices = [_regions(place, turns, robot, frames) for place in places]
        if np.prod([len(regions) for regions in choices]) > MOST:
            item.fail(f"holds more than {MOST} combinations of regions")
        found = []
        for regions in itertools.product(*choices):
            parts: list[Goal] = [*fixed, *_frame_goals(places, regions, turns)]
            if not parts:
                item.fail("asks for nothing: every orientation will do")
            found.append(parts[0] if len(parts) == 1 else AllGoals(parts))
    return found


def _joints(
    constraints: Sequence[Field], robot: Robot
) -> dict[str, tuple[float, float]]:
    """Middle and half width of what is tolerated, by joints that move."""
    asked: dict[str, tuple[float, float]] = {}
    seen = set()
    for item in constraints:
        name = item.need("joint_name").text()
        position = item.need("position").number()
        above, below = (
            _tolerance(item.get(f"tolerance_{side}")) for side in ("above", "below")
        )
        if name in seen:
            item.get("joint_name").fail(f"the joint {brief(name)} is there twice")
        seen.add(name)
        if name in robot.joint_names:
            loose = max(above, below) > ACCURACY
            middle, half = 0.5 * (above - below), 0.5 * (above + below)
            asked[name] = (position + middle, half) if loose else (position, 0.0)
            continue
        if name not in robot.locked_joints:
            item.get("joint_name").fail(
                f"there is no joint {brief(name)} that moves; the robot has: "
                f"{', '.join(robot.joint_names)}"
            )
        at = robot.locked_joints[name]
        if not -max(below, APART) <= at - position <= max(above, APART):
            item.get("position").fail(
                f"is {position:g}, but joint {brief(name)} is locked at {at:g}"
            )
    return asked


def _tolerance(item: Field) -> float:
    value = 0.0 if item.value is None else item.number()
    if value < 0.0:
        item.fail(f"is {value:g}, expected a number >= 0")
    return value


def _joint_goal(
    constraints: Sequence[Field], robot: Robot, start: Mapping[str, float]
) -> Goal:
    asked = _joints(constraints, robot)
    rows = [asked.get(name, (start[name], 0.0)) for name in robot.joint_names]
    q, tolerance = np.array(rows).reshape(-1, 2).T
    return JointRegionGoal(q, tolerance) if np.any(tolerance) else JointGoal(q)


def _joint_region(constraints: Sequence[Field], robot: Robot) -> Goal:
    """Goal for some joints beside goals for frames."""
    asked = _joints(constraints, robot)
    if not asked:
        constraints[0].get("joint_name").fail("is of a joint that does not move")
    q, tolerance = np.array(list(asked.values())).T
    return JointRegionGoal(q, tolerance, tuple(asked))


def _turns(item: Field, robot: Robot, frames: Frames) -> dict[str, _Turn]:
    """Orientations that are asked for, by link."""
    found: dict[str, _Turn] = {}
    for turn in item.get("orientation_constraints").items():
        link = _link(turn, robot)
        if link in found:
            turn.get("link_name").fail(f"the link {brief(link)} is there twice")
        rotation = read_rotation(turn.need("orientation"))
        widths = [
            _tolerance(turn.get(f"absolute_{axis}_axis_tolerance")) for axis in "xyz"
        ]
        tolerance = np.minimum(widths, np.pi)
        tolerance[tolerance <= ACCURACY] = 0.0
        base = frames.to_base(turn.get("header")).rotation
        found[link] = _Turn(base @ rotation, tolerance)
    return found


def _regions(
    place: Field, turns: Mapping[str, _Turn], robot: Robot, frames: Frames
) -> list[_Region]:
    """Regions for the origin of a link, any of which will do."""
    turn = turns.get(_link(place, robot))
    region = place.need("constraint_region")
    base = frames.to_base(place.get("header"))
    offset = place.get("target_point_offset")
    shift = offset.vector("xyz") if offset.given else np.zeros(3)
    if np.any(shift):
        if turn is None or not turn.exact:
            offset.fail("an offset without an exact orientation is not read")
        base = pin.SE3(np.eye(3), -turn.rotation @ shift) * base
    shapes = list(region.get("primitives").items())
    poses = list(region.get("primitive_poses").items())
    # A pose without a shape is a point.
    if shapes and len(shapes) != len(poses):
        region.get("primitive_poses").fail(
            f"holds {len(poses)} poses for {len(shapes)} primitives"
        )
    found = [
        _region(shapes[index] if shapes else None, base * read_pose(pose))
        for index, pose in enumerate(poses)
    ]
    found += _mesh_centres(region, base, frames)
    if not found:
        region.fail("holds 0 regions, expected one or more")
    if len(found) > MOST:
        region.fail(f"holds {len(found)} regions, expected {MOST} at most")
    return found


def _mesh_centres(region: Field, base: pin.SE3, frames: Frames) -> list[_Region]:
    """Middles of meshes: within what is tolerated, which is their convex hull."""
    meshes = list(region.get("meshes").items())
    poses = list(region.get("mesh_poses").items())
    if len(meshes) not in (len(poses), 0):
        region.get("mesh_poses").fail(
            f"holds {len(poses)} poses for {len(meshes)} meshes"
        )
    found = []
    for index, pose in enumerate(poses):
        centre = np.zeros(3)
        if meshes:
            centre = read_mesh_corners(meshes[index], frames).mean(axis=0)
        place = base * read_pose(pose) * pin.SE3(np.eye(3), centre)
        found.append(_Region("point", np.zeros(3), place))
    return found


def _region(shape: Field | None, pose: pin.SE3) -> _Region:
    kind, size = ("point", [0.0]) if shape is None else read_primitive(shape)
    half = np.array(size)
    if shape is not None and not np.all(half > 0.0):
        shape.get("dimensions").fail(f"is {size}, expected positive lengths [m]")
    if kind == "box":
        half = 0.5 * half
    elif kind == "cylinder":
        # The largest box in it that is as long.
        kind, radius = "box", size[1] * 0.5**0.5
        half = np.array([radius, radius, 0.5 * size[0]])
    else:
        half = np.full(3, size[0])
    if np.all(half <= ACCURACY):
        return _Region("point", np.zeros(3), pose)
    return _Region(kind, half, pose)


def _frame_goals(
    places: Sequence[Field], regions: Sequence[_Region], turns: Mapping[str, _Turn]
) -> list[Goal]:
    """Goals for the links, one region each."""
    left = dict(turns)
    parts: list[Goal] = []
    for place, region in zip(places, regions, strict=True):
        link = place.need("link_name").text()
        turn = left.get(link)
        pose, half = region.pose, region.size
        if region.kind == "point":
            if turn is not None and turn.exact:
                parts.append(PoseGoal(link, pin.SE3(turn.rotation, pose.translation)))
                del left[link]
            else:
                parts.append(PositionGoal(link, pose.translation))
        elif region.kind == "sphere":
            parts.append(PositionGoal(link, pose.translation, tolerance=half[0]))
        else:
            parts.append(RegionGoal(link, -half, half, pose))
    for link, turn in left.items():
        if np.any(turn.tolerance < np.pi):
            parts.append(_turn_goal(link, turn))
    return parts


def _turn_goal(link: str, turn: _Turn) -> Goal:
    free = np.flatnonzero(turn.tolerance >= np.pi)
    if free.size == 1:
        # The direction of the free axis is within the other two tolerances if it is
        # within the smaller one, however the angles are counted.
        axis = np.eye(3)[free[0]]
        return AxisGoal(
            link,
            axis,
            turn.rotation @ axis,
            angle_tolerance=float(np.delete(turn.tolerance, free).min()),
        )
    most = np.full(3, np.inf)
    pose = pin.SE3(turn.rotation, np.zeros(3))
    return RegionGoal(link, -most, most, pose, turn.tolerance)


def _link(item: Field, robot: Robot) -> str:
    link = item.need("link_name")
    with blaming(link):
        robot.frame_id(link.text())
    return link.text()
