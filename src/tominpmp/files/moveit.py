"""MoveIt's planning scenes and motion plan requests (YAML): obstacles, start and goal.

Scenes may also be in MoveIt's text format (:mod:`~tominpmp.files.scene_text`). Both
notations of the messages are read: the short one (``type: box``, ``position: [x, y,
z]``) and the one that ROS prints (``type: 1``, ``position: {x: .., y: .., z: ..}``).

A tolerance that only expresses accuracy gives a point goal at the middle of its
interval; a wider one is a freedom, and gives a goal region. No region exceeds the
tolerances of the request.
"""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import NoneType
from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array
from tominpmp.checks import instance, wrong
from tominpmp.constraints.path import PathConstraint
from tominpmp.description.fields import Field
from tominpmp.description.files import missing_resource, resolve_resource
from tominpmp.description.paths import checked_path, read_bytes
from tominpmp.description.srdf import SemanticDescription, warn_of_group
from tominpmp.description.tree import UNREAD, warn_of
from tominpmp.description.yaml_reader import MAX_BYTES, parse_yaml
from tominpmp.exceptions import (
    ProblemError,
    RobotLoadError,
    ScenarioError,
    brief,
    unknown,
    warn_caller,
)
from tominpmp.files.limits import load_limited_robot
from tominpmp.files.records import blaming, keys_in_brief
from tominpmp.files.scene_text import is_scene_text, parse_scene_text
from tominpmp.goals.base import Goal
from tominpmp.goals.frames import AxisGoal, PoseGoal, PositionGoal, RegionGoal
from tominpmp.goals.joints import JointGoal, JointRegionGoal
from tominpmp.goals.sets import AllGoals, AnyGoal
from tominpmp.motion_limits import MotionLimits
from tominpmp.problem.problem import Problem
from tominpmp.robot.robot import Robot, RobotSource, read_source
from tominpmp.scene.meshes import Mesh
from tominpmp.scene.obstacles import Box, Cylinder, Obstacle, Sphere
from tominpmp.scene.rotations import rotation_matrix
from tominpmp.scene.scene import Scene

# Known keys of a MotionPlanRequest and a PlanningScene: read, refused, or without
# effect on the motion (workspace bounds of mobile bases, and settings of MoveIt's
# planners).
REQUEST = """
    start_state goal_constraints path_constraints trajectory_constraints
    workspace_parameters pipeline_id planner_id group_name num_planning_attempts
    allowed_planning_time max_velocity_scaling_factor max_acceleration_scaling_factor
    cartesian_speed_limited_link cartesian_speed_end_effector_link max_cartesian_speed
""".split()
# Link pairs are checked as the SRDF says; entries about objects, and padding, cause a
# separate warning.
SCENE = """
    name robot_model_name robot_state world object_colors fixed_frame_transforms
    allowed_collision_matrix link_padding link_scale is_diff
""".split()
# Tables in them, and lists of tables, whose keys are checked as well.
TABLES = """
    start_state robot_state joint_state multi_dof_joint_state goal_constraints
    joint_constraints position_constraints orientation_constraints constraint_region
    world collision_objects
""".split()
# Further known keys of these tables: read, refused, or without effect on the motion.
INSIDE = """
    header name position velocity effort joint_names transforms wrench
    attached_collision_objects is_diff joint_name tolerance_above tolerance_below weight
    link_name target_point_offset orientation visibility_constraints
    absolute_x_axis_tolerance absolute_y_axis_tolerance absolute_z_axis_tolerance
    primitives primitive_poses meshes mesh_poses planes plane_poses subframe_names
    subframe_poses id type pose operation octomap
""".split()


def _unread(table: Field, known: Collection[str]) -> Iterator[str]:
    """Unknown keys of a table and of its inner tables that have a value."""
    for name, item in table.table().items():
        if name not in known and item.is_filled_in:
            yield item.key
        elif name in TABLES and item.given:
            parts = item.items() if isinstance(item.value, list) else (item,)
            for part in parts:
                yield from _unread(part, (*TABLES, *INSIDE))


# Shapes by their numbers in the message SolidPrimitive.
_SHAPES = {1: "box", 2: "sphere", 3: "cylinder", 4: "cone", 5: "prism"}
# Supported shapes, with the number and the meaning of their dimensions.
_SIZES = {
    "box": (3, "x, y and z"),
    "sphere": (1, "the radius"),
    "cylinder": (2, "height and radius"),
}
# Keys of the lists of shapes of an object, by kind.
PLURALS = {"primitive": "primitives", "mesh": "meshes", "plane": "planes"}
# A plane becomes a board with these edges, the last one its thickness [m].
BOARD = (50.0, 50.0, 0.1)
# Keys of the message, at least one of which must be present.
SCENE_KEYS = ("world", "robot_state", "fixed_frame_transforms", "robot_model_name")
# Keys under which tools write the path of a mesh file.
MESH_FILES = ("resource", "mesh_path", "filename", "path")


@dataclass(frozen=True)
class _Frames:
    """Frames in which poses of a file may be given.

    Attributes:
        fixed: Placements frame_to_base by the name of the frame: of the world, of links
            that are fixed to the base, and of further frames in the file.
        package_dirs: Folders in which the packages of mesh files are searched.
    """

    fixed: Mapping[str, pin.SE3]
    package_dirs: tuple[Path, ...] = ()

    def to_base(self, header: Field) -> pin.SE3:
        """Placement frame_to_base of the frame of a header; by default of the world.

        Raises:
            ScenarioError: If the frame is not known.
        """
        frame_id = header.get("frame_id")
        name = frame_id.text() if frame_id.given else "world"
        place = self.fixed.get(name, self.fixed.get(name.lstrip("/")))
        if place is None:
            frame_id.fail(unknown("fixed frame", name, list(self.fixed)))
        return place


def load_moveit_scene(path: str | Path, robot: Robot | None = None) -> Scene:
    """Load the obstacles of a MoveIt planning scene.

    Poses are transformed into the frame of the robot's root link, which the scene may
    have placed elsewhere in the world (a multi-DOF joint in its robot state).

    Args:
        path: YAML file with a ``PlanningScene`` message, or a file in MoveIt's text
            format (``.scene``), as RViz exports it.
        robot: The robot, which makes its root link known as a frame.

    Returns:
        The scene; an object with several shapes becomes several obstacles, ``NAME.0``,
        ``NAME.1`` and so on.

    Raises:
        ScenarioError: If the file is wrong, or contains unsupported parts: attached
            objects, an octree, cones.
    """
    instance(robot, (Robot, NoneType), "robot", "a Robot or None")
    message = _read_message(path)
    return _read_scene(message, _read_frames(message, robot))


def _read_message(path: str | Path) -> Field:
    """Read a message from a YAML file, or a scene in text format, as a table.

    Raises:
        ScenarioError: If the file is neither, or its document is not a table.
    """
    path = checked_path(path, "path", ScenarioError)
    content = read_bytes(path, MAX_BYTES)
    parse = parse_scene_text if is_scene_text(content) else parse_yaml
    message = Field(parse(content, path), path)
    message.table()
    return message


def _read_frames(message: Field, robot: Robot | None, *states: Field) -> _Frames:
    """Collect the frames of a planning scene.

    Args:
        message: The planning scene.
        robot: The robot, if there is one.
        *states: Further robot states, whose placement of the base takes precedence.
    """
    base = pin.SE3.Identity()
    for state in (message.get("robot_state"), *states):
        transforms = state.get("multi_dof_joint_state").get("transforms")
        placements = [_read_pose(item) for item in transforms.items()]
        if len(placements) > 1:
            transforms.fail(
                f"holds {len(placements)} transforms, expected that of the base only"
            )
        base = placements[0] if placements else base
    own = {"world": base.inverse()}
    for frame in () if robot is None else robot.model.frames:
        if frame.type == pin.FrameType.BODY and not frame.parentJoint:
            own.setdefault(frame.name, frame.placement.copy())
    fixed = dict(own)
    for item in message.get("fixed_frame_transforms").items():
        name = item.need("child_frame_id").text()
        frame_id = item.get("header").get("frame_id")
        parent = str(frame_id.value) if frame_id.given else "world"
        root = own["world"] if parent == name else None
        above = fixed.get(parent, fixed.get(parent.lstrip("/"), root))
        # Parents that are defined later or not at all are not supported.
        if above is not None:
            fixed[name] = above * _read_pose(item.need("transform"))
    # Packages of meshes are often next to that of the robot.
    folders = () if robot is None else robot.description.package_dirs
    return _Frames(fixed | own, folders)


def _read_pose(value: Field) -> pin.SE3:
    """Read a pose or transform; omitted parts are zero.

    Args:
        value: A message ``Pose`` (position, orientation) or ``Transform`` (translation,
            rotation).

    Raises:
        ScenarioError: If it is neither.
    """
    place, turn = value.get("position"), value.get("orientation")
    if not place.given and not turn.given:
        place, turn = value.get("translation"), value.get("rotation")
    position = place.vector("xyz") if place.given else np.zeros(3)
    return pin.SE3(_read_rotation(turn), position)


def _read_rotation(value: Field) -> np.ndarray:
    """Read a quaternion (x, y, z, w); all zeros, the ROS default, mean no rotation."""
    quaternion = value.vector("xyzw") if value.given else np.zeros(4)
    if not np.any(quaternion):
        return np.eye(3)
    with blaming(value):
        return np.array(rotation_matrix(quaternion))


def _read_scene(message: Field, frames: _Frames) -> Scene:
    """Read the obstacles of a planning scene message.

    Raises:
        ScenarioError: As :func:`load_moveit_scene`.
    """
    if not any(key in message.table() for key in SCENE_KEYS):
        message.fail(f"is not a planning scene: it has none of {', '.join(SCENE_KEYS)}")
    _refuse_attached(message.get("robot_state"))
    world = message.get("world")
    unread = dict.fromkeys((*_unread_precautions(message), *_unread(message, SCENE)))
    warn_of({UNREAD: keys_in_brief(unread)}, message.path)
    octree = world.get("octomap").get("octomap").get("data")
    if octree.given:
        octree.fail("octrees are not read")
    obstacles: list[Obstacle] = []
    for item in world.get("collision_objects").items():
        obstacles += _read_object(item, frames)
    with blaming(world.get("collision_objects")):
        return Scene(obstacles)


def _refuse_attached(state: Field) -> None:
    """Refuse a robot state with attached objects.

    Raises:
        ScenarioError: If the state has attached objects.
    """
    attached = state.get("attached_collision_objects")
    if attached.given:
        names = [str(item.get("object").get("id").value) for item in attached.items()]
        attached.fail(f"objects attached to the robot are not read: {', '.join(names)}")


def _unread_precautions(message: Field) -> Iterator[str]:
    """Unread keys of a scene that would make a motion safer or less restricted."""
    for key, neutral in {"padding": 0.0, "scale": 1.0}.items():
        for item in message.get(f"link_{key}").items():
            if item.get(key).number(default=neutral) != neutral:
                yield item.get(key).key
    objects = message.get("world").get("collision_objects").items()
    known = [item.get("id").value for item in objects]
    allowed = message.get("allowed_collision_matrix")
    names = [item.value for item in allowed.get("entry_names").items()]
    if any(isinstance(name, str) and name in known for name in names):
        yield "allowed_collision_matrix (its entries about objects)"


def _read_object(item: Field, frames: _Frames) -> list[Obstacle]:
    """Read a CollisionObject: one obstacle for each of its shapes."""
    name = item.need("id").text()
    operation = item.get("operation")
    if operation.given and operation.value not in (0, "add", "ADD"):
        operation.fail("only objects that are added can be read (operation 0)")
    place = frames.to_base(item.get("header"))
    if item.get("pose").given:
        place = place * _read_pose(item.get("pose"))
    placed = [
        shape
        for kind in PLURALS
        for shape in _placed_shapes(item, kind, place, optional="poses")
    ]
    if not placed:
        item.fail(f"the object {brief(name)} has no shapes")
    return [
        _obstacle(name if len(placed) == 1 else f"{name}.{index}", *shape, frames)
        for index, shape in enumerate(placed)
    ]


def _placed_shapes(
    item: Field, kind: str, place: pin.SE3, *, optional: str
) -> Iterator[tuple[Any, pin.SE3]]:
    """Shapes of one kind, each with its placement shape_to_base.

    Args:
        item: Table that contains the lists of the shapes and of their poses.
        kind: The kind, one of ``PLURALS``.
        place: Placement frame_to_base of the frame of the poses.
        optional: List that may be empty: "shapes" (a pose without a shape comes with
            None) or "poses" (the shapes are at the origin of the frame).

    Raises:
        ScenarioError: If the lists have different lengths.
    """
    plural = PLURALS[kind]
    shapes, poses = list(item.get(plural).items()), item.get(f"{kind}_poses")
    places = list(poses.items())
    if {"shapes": shapes, "poses": places}[optional] and len(shapes) != len(places):
        poses.fail(f"holds {len(places)} poses for {len(shapes)} {plural}")
    within = [place * _read_pose(pose) for pose in places] or [place] * len(shapes)
    return itertools.zip_longest(shapes, within)


def _obstacle(name: str, shape: Field, place: pin.SE3, frames: _Frames) -> Obstacle:
    where: dict[str, Any] = {"position": place.translation, "rotation": place.rotation}
    with blaming(shape):
        if "coef" in shape.table():
            placed = place * _board_placement(shape.need("coef"))
            return Box(name, size=np.array(BOARD), position=placed.homogeneous)
        if "type" not in shape.table():
            return Mesh(name, **_mesh(shape, frames), **where)
        kind, size = _read_primitive(shape)
        if kind == "box":
            return Box(name, size=np.array(size), **where)
        if kind == "sphere":
            return Sphere(name, radius=size[0], **where)
        return Cylinder(name, radius=size[1], length=size[0], **where)


def _board_placement(coefficients: Field) -> pin.SE3:
    """Placement of a board whose top is the plane a x + b y + c z + d = 0."""
    *normal, offset = coefficients.numbers(4)
    norm = float(np.linalg.norm(normal))
    if not norm > 0.0:
        coefficients.fail(f"is {coefficients.value}, expected a normal and an offset")
    z = np.array(normal) / norm
    turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), z)
    return pin.SE3(turn.matrix(), -(offset / norm + 0.5 * BOARD[2]) * z)


def _read_primitive(shape: Field) -> tuple[str, list[float]]:
    """Read a SolidPrimitive.

    Returns:
        "box", "sphere" or "cylinder", and the dimensions in the order of MoveIt: edges;
        radius; height and radius [m].

    Raises:
        ScenarioError: If it is another shape.
    """
    kind = shape.need("type")
    named = isinstance(kind.value, int) and _SHAPES.get(kind.value)
    given = named or kind.value
    name = str(given).lower()
    if name not in _SIZES:
        kind.fail(unknown("shape", given, [*_SIZES], "beside meshes there are"))
    size, (count, words) = shape.need("dimensions"), _SIZES[name]
    if not isinstance(size.value, list) or len(size.value) != count:
        size.fail(f"is {brief(size.value)}, expected {words} of a {name} [m]")
    return name, size.numbers(count)


def _mesh(shape: Field, frames: _Frames) -> dict[str, Any]:
    """Read a mesh: vertices and triangles, or the name of a file."""
    named = [shape.get(key) for key in MESH_FILES if shape.get(key).given]
    if named:
        scale = shape.get("dimensions" if shape.get("dimensions").given else "scale")
        factors = {"scale": np.array(scale.numbers(3))} if scale.given else {}
        return {"path": _mesh_file(named[0], frames), **factors}
    if not (shape.get("vertices").given and shape.get("triangles").given):
        shape.fail(
            "has neither a type, as primitives have, nor vertices and triangles, nor "
            f"the file of a mesh ({', '.join(MESH_FILES)})"
        )
    rows = [item.vector("xyz") for item in shape.get("vertices").items()]
    return {
        "vertices": np.array(rows),
        "triangles": np.array([_corners(t) for t in shape.get("triangles").items()]),
    }


def _corners(triangle: Field) -> list[int]:
    named = isinstance(triangle.value, dict)
    indices = triangle.need("vertex_indices") if named else triangle
    numbers = indices.numbers(3)
    if not all(number.is_integer() and 0 <= number < 2**31 for number in numbers):
        indices.fail(f"is {brief(indices.value)}, expected three numbers of vertices")
    return [int(number) for number in numbers]


def _mesh_file(name: Field, frames: _Frames) -> Path:
    """Find the file of a mesh: relative to the scene file, or in a package."""
    try:
        path, tried = resolve_resource(name.text(), name.path, frames.package_dirs)
    except RobotLoadError as error:
        name.fail(str(error).removeprefix(f"{name.path}: "))
    if path is None:
        name.fail(f"the file {missing_resource(name.text(), tried)}")
    return path


# Largest deviation of a locked joint from its position in the request [rad or m].
LOCK_OFFSET = 1e-3
# Tolerances up to this express the accuracy that MoveIt's tools set, not a freedom [m
# or rad].
ACCURACY = 0.0101
# Most alternative goals, each of which is planned; more are taken for a mistake.
MOST_GOALS = 64


def _start_values(request: Field, key: str = "position") -> dict[str, float]:
    """Positions or velocities of the start state by joint [SI units].

    Raises:
        ScenarioError: If there are no values, their number differs from the joints, or
            a joint name is repeated.
    """
    state = request.get("start_state").get("joint_state")
    joints = [item.text() for item in state.need("name").items()]
    found = state.need(key)
    numbers = found.numbers()
    if len(numbers) != len(joints):
        found.fail(f"holds {len(numbers)} numbers for {len(joints)} joints")
    if len(set(joints)) != len(joints):
        twice = next(name for name in joints if joints.count(name) > 1)
        state.get("name").fail(f"the joint {brief(twice)} occurs twice")
    return dict(zip(joints, numbers, strict=True))


def _goal_names(request: Field, *kinds: str) -> list[str]:
    """Names in the goal constraints of the kinds: of joints, or of links."""
    names = [
        item.need("joint_name" if kind == "joint" else "link_name").text()
        for goal in request.get("goal_constraints").items()
        for kind in kinds
        for item in goal.get(f"{kind}_constraints").items()
    ]
    return list(dict.fromkeys(names))


def _outside_group(request: Field, source: RobotSource) -> dict[str, float]:
    """Find the joints outside the group of a request, and where to lock them.

    If the SRDF file lacks the group, the moving joints are those that the goal names,
    and those that carry the links that it names.

    Args:
        request: A message ``MotionPlanRequest``.
        source: Descriptions of the robot.

    Returns:
        Positions by joint name [rad or m]: from the start state, else the rest
        position; empty if the request names no group.
    """
    name, start = request.get("group_name"), _start_values(request)
    if not name.given:
        return {}
    description, srdf = source.description, source.semantics or SemanticDescription()
    group, links = srdf.find_group(name.text()), list[str]()
    moving = set[str]() if group is None else set(srdf.groups[group].joints)
    if group is not None and moving:
        warn_of_group(group, srdf.groups[group])
    else:
        links = _goal_names(request, "position", "orientation")
        above = map(description.joints_above, links)
        moving = set(_goal_names(request, "joint")).union(*above)
    outside = srdf.rest_positions(description.joints, moving)
    if links and outside:
        warn_caller(
            f"{name.path}: {name.key}: the robot has no group {brief(name.text())} (it "
            f"has: {', '.join(srdf.groups) or 'none'}); planned are the joints that "
            "carry the links of the goal, "
            f"and {', '.join(outside)} are held"
        )
    lacking = [joint for joint in outside if joint not in start]
    remark = (
        "start_state has no value for {}, outside the group; held where the robot's "
        "SRDF file has them, else at 0"
    )
    warn_of({remark: lacking}, request.path)
    return {joint: start.get(joint, rest) for joint, rest in outside.items()}


def load_moveit(
    robot: Robot | str | os.PathLike[str],
    scene_path: str | Path,
    request_path: str | Path,
    *,
    margin: float = 0.0,
    self_collision: bool | None = None,
    kinematic: bool = False,
    joint_limits: str | Path | None = None,
    motion_limits: MotionLimits | None = None,
    constraints: Sequence[PathConstraint] = (),
) -> Problem:
    """Load a problem from a MoveIt planning scene and a motion plan request.

    Tolerances up to 0.01 rad or m count as accuracy, and the goal is the middle of
    their interval; wider ones make a goal region. Several sets of goal constraints are
    alternatives, of which any suffices. All poses are transformed into the frame of the
    robot's root link. Scaling factors below 1 scale the robot's limits of speeds and
    of accelerations, if it has any. Parts of the files that are not read cause a
    warning.

    Args:
        robot: The robot, or its name or path. The motion is planned for the group of
            its SRDF file that the request names; all other joints are locked at their
            start, as are joints of the group that a goal of joint positions does not
            name, unless the robot is loaded already: then these end at their start.
        scene_path: YAML file with a ``PlanningScene`` message, or one in MoveIt's text
            format (``.scene``).
        request_path: YAML file with a ``MotionPlanRequest`` message.
        margin: Distance to keep from obstacles [m].
        self_collision: Whether to check the links against each other; None for the
            default of :class:`~tominpmp.Problem`.
        kinematic: Whether the robot is loaded without its dynamics, see
            :func:`~tominpmp.load_robot`; a robot that is loaded already must then
            be kinematic.
        joint_limits: MoveIt's ``joint_limits.yaml``, whose limits take precedence over
            those of the robot's files; it provides the accelerations that a kinematic
            robot needs. The request sets their scaling.
        motion_limits: Limits that take precedence over those of the robot, without
            scaling.
        constraints: Constraints at all times.

    Returns:
        The problem. Joints of the start state that the robot lacks, and locked ones
        outside their limits, cause a warning.

    Raises:
        ScenarioError: If a file is wrong, or the problem in it, for example a start in
            collision; names the file and the key in it.
        RobotLoadError: If the robot cannot be loaded.
        ProblemError: If the margin, a limit or another argument is wrong, or if a robot
            that is loaded already comes with joint limits, or with ``kinematic`` and is
            not kinematic.
    """
    scene_message, request = _read_message(scene_path), _read_message(request_path)
    state, start = request.get("start_state"), _start_values(request)
    arm = _grouped_robot(robot, request, kinematic, joint_limits)
    _check_state(arm, state.get("joint_state"), start)
    _refuse_unread(request)
    warn_of({UNREAD: keys_in_brief(_unread(request, REQUEST))}, request.path)
    _refuse_attached(state)
    frames = _read_frames(scene_message, arm, state)
    _check_upright(frames, arm, scene_message)
    scene = _read_scene(scene_message, frames)
    goal = _GoalReader(arm, frames, start).read(request)
    try:
        return Problem(
            _scaled(arm, request),
            np.array([start[name] for name in arm.joint_names]),
            goal,
            scene=scene,
            margin=margin,
            v_start=_start_velocity(arm, request),
            motion_limits=motion_limits,
            self_collision=self_collision,
            constraints=constraints,
        )
    except ProblemError as error:
        blamed = (error.field or "").partition(".")[0].partition("[")[0]
        places = {"q_start": "start_state", "v_start": "start_state"}
        if blamed in ("margin", "motion_limits", "constraints", "self_collision"):
            raise
        request.get(places.get(blamed, "goal_constraints")).fail(str(error))


def request_locks(source: RobotSource, request_path: str | Path) -> dict[str, float]:
    """Find the joints to lock when a robot is loaded for a request in a YAML file.

    Positions by joint name [rad or m]: of joints outside its group, and of joints that
    a goal of joint positions does not name.

    Raises:
        ScenarioError: If the file is wrong.
    """
    return _locks(_read_message(request_path), source)


def _locks(request: Field, source: RobotSource) -> dict[str, float]:
    """Positions of joints to lock for a request, without those that follow [rad or m].

    Joints that follow them are locked with them; if the request has them elsewhere, a
    warning says so later.
    """
    start, moved = _start_values(request), _goal_names(request, "joint")
    locks = _outside_group(request, source)
    names = [joint.name for joint in source.description.joints if joint.mimic is None]
    # A goal for a link may move any joint.
    if moved and not _goal_names(request, "position", "orientation"):
        locks |= {k: start[k] for k in names if k in start and k not in moved}
    # If no joint were left, the reader of the goal says what is wrong with it.
    return locks if len(locks) < len(names) else {}


def _grouped_robot(
    robot: Robot | str | os.PathLike[str],
    request: Field,
    kinematic: bool,
    joint_limits: str | Path | None,
) -> Robot:
    """The robot with the joints locked that the request does not move."""
    if not isinstance(robot, Robot):
        source = read_source(robot)
        more = {"locked_joints": _locks(request, source), "kinematic": kinematic}
        return load_limited_robot(joint_limits, source, **more)
    if joint_limits is not None:
        expected = (
            "None for a robot that is loaded: load_joint_limits reads them for "
            "load_robot and motion_limits"
        )
        raise wrong(joint_limits, "joint_limits", expected)
    if kinematic and not robot.kinematic:
        expected = "False or a robot that is kinematic: load_robot(..., kinematic=True)"
        raise wrong(kinematic, "kinematic", expected)
    source = RobotSource(robot.name, robot.description, robot.srdf)
    locks = _outside_group(request, source)
    further = {k: v for k, v in locks.items() if k in robot.joint_names}
    return robot.with_locked(further) if further else robot


def _check_state(robot: Robot, state: Field, start: Mapping[str, float]) -> None:
    """Check that the start state names the joints of the robot."""
    known = [joint.name for joint in robot.description.joints]
    lacking = [name for name in robot.joint_names if name not in start]
    others = [brief(name) for name in start if name not in known]
    names = state.get("name")
    if lacking:
        hint = f", and there is no joint {', '.join(others[:10])}" if others else ""
        names.fail(
            f"has no values for the joints {', '.join(lacking)}{hint}; the robot "
            f"has: {', '.join(sorted(known))}"
        )
    # For example joints of a gripper.
    remark = "the robot has no joints {}: their positions are ignored"
    warn_of({f"{names.key}: {remark}": others}, names.path)
    for name, position in robot.locked_joints.items():
        requested = start.get(name, position)
        if abs(requested - position) > LOCK_OFFSET:
            warn_caller(
                f"{state.path}: joint {name} is at {requested:g} at the start, but the "
                f"robot has it locked at {position:g}"
            )


def _start_velocity(robot: Robot, request: Field) -> Array | None:
    if not request.get("start_state").get("joint_state").get("velocity").given:
        return None
    velocity = _start_values(request, "velocity")
    held = [name for name in robot.locked_joints if velocity.get(name, 0.0) != 0.0]
    warn_of({"{} move at the start, but are locked": held}, request.path)
    return np.array([velocity[name] for name in robot.joint_names])


def _refuse_unread(request: Field) -> None:
    """Refuse path constraints, which a motion would silently violate."""
    for key in ("path_constraints", "trajectory_constraints"):
        kinds = request.get(key)
        for item in kinds.table().values() if kinds.given else ():
            if isinstance(item.value, list) and item.value:
                item.fail("path constraints are not read")
    speed = request.get("max_cartesian_speed")
    # MoveIt takes zero and negative values for no limit.
    if speed.number(default=0.0) > 0.0:
        speed.fail(f"is {speed.number():g}: speeds of links are not limited here")


def _check_upright(frames: _Frames, robot: Robot, message: Field) -> None:
    """Refuse a tilted base: the direction of gravity in its frame would change."""
    turned = frames.fixed["world"].rotation @ robot.gravity
    if not np.allclose(turned, robot.gravity, atol=1e-6 * (1.0 + np.abs(turned).max())):
        message.get("robot_state").get("multi_dof_joint_state").fail(
            "the base of the robot is tilted: leave that out here and load the robot "
            f"with the gravity that its base sees, {np.round(turned, 6).tolist()}"
        )


def _scaled(robot: Robot, request: Field) -> Robot:
    """Scale limits of speeds and accelerations, as MoveIt does."""
    factor = request.get("max_velocity_scaling_factor")
    speed = _factor(factor)
    if speed < 1.0:
        with blaming(factor):
            robot = robot.with_changes(velocity=speed * robot.limits.velocity)
    factor = request.get("max_acceleration_scaling_factor")
    share, limits = _factor(factor), robot.motion_limits
    if share < 1.0 and (limits is None or limits.acceleration is None):
        warn_caller(
            f"{factor.path}: {factor.key} is {share:g}, but the robot has no limits of "
            "accelerations; give some, as by limits='datasheet'"
        )
    elif share < 1.0 and limits is not None:
        slower = share * limits.by_joint("acceleration", robot.joint_names)
        with blaming(factor):
            robot = replace(robot, motion_limits=replace(limits, acceleration=slower))
    return robot


def _factor(field: Field) -> float:
    """A scaling factor; MoveIt replaces values outside (0, 1] by 1."""
    value = field.number(default=1.0)
    if not 0.0 <= value <= 1.0:  # zero is the default of messages of ROS
        warn_caller(
            f"{field.path}: {field.key} is {value:g}, outside (0, 1], and is ignored"
        )
    return value if 0.0 < value < 1.0 else 1.0


#: Rotation of a link in the frame of the base, shape (3, 3), and its tolerances about
#: the axes of the link, 0 to pi [rad], shape (3,).
_Turn: TypeAlias = "tuple[Array, Array]"


@dataclass(frozen=True)
class _GoalReader:
    """Reads the goals of requests.

    Attributes:
        robot: The robot.
        frames: Frames in which poses may be given.
        start: Start positions by joint; joints keep them if a goal of joint positions
            does not name them.
    """

    robot: Robot
    frames: _Frames
    start: Mapping[str, float]

    def read(self, request: Field) -> Goal:
        """Read the goal of a request; several sets of constraints are alternatives.

        Raises:
            ScenarioError: If there is no goal or a constraint is wrong, or of a kind
                that is not read: visibility.
        """
        constraints = request.need("goal_constraints")
        goals: list[Goal] = []
        for item in constraints.items():
            if any(value.given for value in item.table().values()):
                goals += self._alternatives(item)
        if not goals:
            constraints.fail("is empty, expected a goal")
        if len(goals) > MOST_GOALS:
            constraints.fail(
                f"holds {len(goals)} alternatives, expected {MOST_GOALS} at most"
            )
        return goals[0] if len(goals) == 1 else AnyGoal(goals)

    def _alternatives(self, item: Field) -> list[Goal]:
        """Alternative goals, each of which satisfies one set of constraints."""
        joints = list(item.get("joint_constraints").items())
        places = list(item.get("position_constraints").items())
        turns = self._orientations(item)
        if item.get("visibility_constraints").given:
            item.get("visibility_constraints").fail("visibility goals are not read")
        with blaming(item):
            alone = not places and not turns
            fixed = [self._joint_goal(joints, alone)] if joints else []
            choices = [self._place_goals(place, turns) for place in places]
            if math.prod(map(len, choices)) > MOST_GOALS:
                item.fail(f"holds more than {MOST_GOALS} combinations of regions")
            goals: list[Goal] = []
            for placed in itertools.product(*choices):
                poses = (goal for goal in placed if isinstance(goal.target, pin.SE3))
                posed = [goal.frame_name for goal in poses]
                free = {link: turn for link, turn in turns.items() if link not in posed}
                turned = (_orientation_goal(link, *turn) for link, turn in free.items())
                parts = [*fixed, *placed, *filter(None, turned)]
                if not parts:
                    item.fail("has no effect: every orientation satisfies it")
                goals.append(parts[0] if len(parts) == 1 else AllGoals(parts))
        return goals

    def _joint_goal(self, constraints: Sequence[Field], alone: bool) -> Goal:
        """Goal for joints, alone or combined with goals for frames."""
        ranges, every = self._joints(constraints), self.robot.joint_names
        if alone:
            ranges = {name: ranges.get(name, (self.start[name], 0.0)) for name in every}
        if not ranges:
            constraints[0].get("joint_name").fail("is of a joint that does not move")
        q, tolerance = np.array(list(ranges.values())).T
        if alone and not np.any(tolerance):
            return JointGoal(q)
        return JointRegionGoal(q, tolerance, None if alone else tuple(ranges))

    def _joints(self, constraints: Sequence[Field]) -> dict[str, tuple[float, float]]:
        """Middle and half width of the tolerance interval, by joint that moves."""
        ranges: dict[str, tuple[float, float]] = {}
        robot, seen = self.robot, set[str]()
        for item in constraints:
            name = item.need("joint_name").text()
            position = item.need("position").number()
            above, below = (
                _tolerance(item.get(f"tolerance_{side}")) for side in ("above", "below")
            )
            if name in seen:
                item.get("joint_name").fail(f"the joint {brief(name)} occurs twice")
            seen.add(name)
            if name in robot.joint_names:
                loose = max(above, below) > ACCURACY
                middle, half = 0.5 * (above - below), 0.5 * (above + below)
                ranges[name] = (position + middle, half) if loose else (position, 0.0)
                continue
            if name not in robot.locked_joints:
                joints = (*robot.joint_names, *robot.locked_joints)
                fault = unknown("joint", name, joints, "the robot has")
                item.get("joint_name").fail(fault)
            at = robot.locked_joints[name]
            if not -max(below, LOCK_OFFSET) <= at - position <= max(above, LOCK_OFFSET):
                item.get("position").fail(
                    f"is {position:g}, but joint {brief(name)} is locked at {at:g} "
                    "[rad or m]"
                )
        return ranges

    def _orientations(self, item: Field) -> dict[str, _Turn]:
        """Orientation constraints by link."""
        turns: dict[str, _Turn] = {}
        for turn in item.get("orientation_constraints").items():
            link = self._link(turn)
            if link in turns:
                turn.get("link_name").fail(f"the link {brief(link)} occurs twice")
            rotation = _read_rotation(turn.need("orientation"))
            keys = [f"absolute_{axis}_axis_tolerance" for axis in "xyz"]
            tolerance = np.minimum([_tolerance(turn.get(k)) for k in keys], np.pi)
            tolerance[tolerance <= ACCURACY] = 0.0
            base = self.frames.to_base(turn.get("header")).rotation
            turns[link] = base @ rotation, tolerance
        return turns

    def _place_goals(self, place: Field, turns: Mapping[str, _Turn]) -> list[Goal]:
        """Alternative goals for the origin of a link; poses orient the link, too."""
        link = self._link(place)
        exact = {link: turn for link, (turn, most) in turns.items() if not np.any(most)}
        rotation = exact.get(link)
        region = place.need("constraint_region")
        base = self.frames.to_base(place.get("header"))
        offset = place.get("target_point_offset")
        shift = offset.vector("xyz") if offset.given else np.zeros(3)
        if np.any(shift):
            if rotation is None:
                offset.fail("an offset without an exact orientation is not read")
            base = pin.SE3(np.eye(3), -rotation @ shift) * base
        goals: list[Goal] = []
        for kind in ("primitive", "mesh"):
            # A pose without a shape is a point.
            for shape, spot in _placed_shapes(region, kind, base, optional="shapes"):
                size: float | Array = 0.0
                if shape is not None and kind == "primitive":
                    size = _region_size(shape)
                elif shape is not None:
                    # The mean of the vertices is inside the region, their convex hull.
                    with blaming(shape):
                        mesh = Mesh("region", **_mesh(shape, self.frames))
                    spot = spot * pin.SE3(np.eye(3), mesh.points.mean(axis=0))
                if isinstance(size, np.ndarray):
                    goals.append(RegionGoal(link, -size, size, spot))
                elif size == 0.0 and rotation is not None:
                    goals.append(PoseGoal(link, pin.SE3(rotation, spot.translation)))
                else:
                    goals.append(PositionGoal(link, spot.translation, tolerance=size))
        if not 0 < len(goals) <= MOST_GOALS:
            region.fail(f"holds {len(goals)} regions, expected 1 to {MOST_GOALS}")
        return goals

    def _link(self, item: Field) -> str:
        link = item.need("link_name")
        with blaming(link):
            self.robot.frame_id(link.text())
        return link.text()


def _tolerance(item: Field) -> float:
    return item.number("a number >= 0", default=0.0, least=0.0)


def _region_size(shape: Field) -> float | Array:
    """Radius or half edges of a region [m], zero if they only express accuracy."""
    kind, size = _read_primitive(shape)
    if not min(size) > 0.0:
        shape.get("dimensions").fail(f"is {size}, expected positive lengths [m]")
    half = 0.5 * np.array(size)
    if kind == "sphere":
        return size[0] if size[0] > ACCURACY else 0.0
    if kind == "cylinder":
        # The largest box inside the cylinder with its length.
        radius = size[1] * 0.5**0.5
        half = np.array([radius, radius, 0.5 * size[0]])
    return half if np.any(half > ACCURACY) else 0.0


def _orientation_goal(link: str, rotation: Array, tolerance: Array) -> Goal | None:
    """Goal for the orientation of a link; None if any orientation will do.

    Args:
        link: The link.
        rotation: Its rotation in the frame of the base, shape (3, 3).
        tolerance: Tolerances about its axes, 0 to pi [rad], shape (3,).
    """
    free = np.flatnonzero(tolerance >= np.pi)
    if free.size == 3:
        return None
    if free.size == 1:
        # The direction of the free axis satisfies both other tolerances if it satisfies
        # the smaller one, in any convention of angles.
        axis, least = np.eye(3)[free[0]], float(np.delete(tolerance, free).min())
        return AxisGoal(link, axis, rotation @ axis, angle_tolerance=least)
    most, pose = np.full(3, np.inf), pin.SE3(rotation, np.zeros(3))
    return RegionGoal(link, -most, most, pose, tolerance)
