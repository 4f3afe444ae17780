"""MoveIt's planning scenes and motion plan requests (YAML): obstacles, start and goal.

Scenes may be in its text format, too (:mod:`~tominpmp.files.scene_text`). Both ways
of writing the messages are read: short (``type: box``, ``position: [x, y, z]``) and as
ROS prints them (``type: 1``, ``position: {x: .., y: .., z: ..}``).

A tolerance that stands for accuracy gives a goal at the middle of what is tolerated; a
wider one is a freedom, and gives a goal region. No region is larger than what the
request tolerates.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import NoneType
from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array
from tominpmp.checks import instance
from tominpmp.description.fields import Field
from tominpmp.description.files import missing_resource, resolve_resource
from tominpmp.description.paths import checked_path
from tominpmp.description.srdf import (
    SemanticDescription,
    rest_position,
    warn_of_group,
)
from tominpmp.description.tree import UrdfDescription
from tominpmp.description.yaml_reader import MAX_BYTES, parse_yaml, read_bytes
from tominpmp.exceptions import (
    ProblemError,
    RobotLoadError,
    ScenarioError,
    brief,
    warn_caller,
)
from tominpmp.files.limits import MoveItLimits, load_joint_limits, load_limited_robot
from tominpmp.files.records import blaming, warn_of_keys
from tominpmp.files.scene_text import is_scene_text, parse_scene_text
from tominpmp.goals.base import Goal
from tominpmp.goals.frames import AxisGoal, PoseGoal, PositionGoal, RegionGoal
from tominpmp.goals.joints import JointGoal, JointRegionGoal
from tominpmp.goals.sets import AllGoals, AnyGoal
from tominpmp.problem.problem import Problem
from tominpmp.robot.robot import Robot, RobotSource, read_source
from tominpmp.scene.meshes import Mesh
from tominpmp.scene.obstacles import Box, Cylinder, Obstacle, Sphere
from tominpmp.scene.rotations import rotation_matrix
from tominpmp.scene.scene import Scene

# What a MotionPlanRequest and a PlanningScene have: read, refused, or without effect on
# the motion (bounds for bases that move, and how MoveIt is to look for a motion).
REQUEST = """
    start_state goal_constraints path_constraints trajectory_constraints
    workspace_parameters pipeline_id planner_id group_name num_planning_attempts
    allowed_planning_time max_velocity_scaling_factor max_acceleration_scaling_factor
    cartesian_speed_limited_link cartesian_speed_end_effector_link max_cartesian_speed
""".split()
# Links are watched as the SRDF says; of entries about objects, and of padding, a
# warning of its own tells.
SCENE = """
    name robot_model_name robot_state world object_colors fixed_frame_transforms
    allowed_collision_matrix link_padding link_scale is_diff
""".split()
# Tables in them, and lists of tables, that are looked through for further keys.
TABLES = """
    start_state robot_state joint_state multi_dof_joint_state goal_constraints
    joint_constraints position_constraints orientation_constraints constraint_region
    world collision_objects
""".split()
# What else such tables have: read, refused, or without effect on the motion.
INSIDE = """
    header name position velocity effort joint_names transforms wrench
    attached_collision_objects is_diff joint_name tolerance_above tolerance_below weight
    link_name target_point_offset orientation visibility_constraints
    absolute_x_axis_tolerance absolute_y_axis_tolerance absolute_z_axis_tolerance
    primitives primitive_poses meshes mesh_poses planes plane_poses subframe_names
    subframe_poses id type pose operation octomap
""".split()


def _unread(table: Field, known: Collection[str]) -> Iterator[str]:
    """Keys of a table and of those in it that say something and are not known."""
    for name, item in table.table().items():
        if name not in known and item.says_something:
            yield item.key
        elif name in TABLES and item.given:
            parts = item.items() if isinstance(item.value, list) else (item,)
            for part in parts:
                yield from _unread(part, (*TABLES, *INSIDE))


# Numbers of the shapes in the message SolidPrimitive.
_SHAPES = {1: "box", 2: "sphere", 3: "cylinder", 4: "cone", 5: "prism"}
# Those that are read, with their dimensions.
_SIZES = {
    "box": (3, "x, y and z"),
    "sphere": (1, "the radius"),
    "cylinder": (2, "height and radius"),
}
# Shapes of an object by their kind.
PLURALS = {"primitive": "primitives", "mesh": "meshes", "plane": "planes"}
# A plane becomes a board that is so wide and thick [m].
BOARD = (50.0, 50.0, 0.1)
# Keys of the message of which there is one at least.
SCENE_KEYS = ("world", "robot_state", "fixed_frame_transforms", "robot_model_name")
# Places beyond this are a mistake [m].
FARTHEST = 1e6
# Keys under which tools write the file of a mesh.
MESH_FILES = ("resource", "mesh_path", "filename", "path")
# Frames that are the world whatever the file is about.
_WORLD = ("", "world", "/world")


@dataclass(frozen=True)
class _Frames:
    """The frames in which poses of a file may be given.

    Attributes:
        base: Placement base_to_world of the robot's first link.
        root: Name of that link, empty if no robot is given.
        fixed: Placements child_to_world of further frames.
        package_dirs: Folders in which to look for the packages of mesh files.
    """

    base: pin.SE3 = field(default_factory=pin.SE3.Identity)
    root: str = ""
    fixed: Mapping[str, pin.SE3] = field(default_factory=dict)
    package_dirs: tuple[Path, ...] = ()

    def to_base(self, header: Field) -> pin.SE3:
        """Placement frame_to_base of the frame that a header names, else of the world.

        Raises:
            ScenarioError: If the frame is not known.
        """
        frame_id = header.get("frame_id")
        name = frame_id.text() if frame_id.given else ""
        if name in _WORLD:
            return self.base.inverse()
        if name.lstrip("/") == self.root:
            return pin.SE3.Identity()
        if name in self.fixed:
            return self.base.actInv(self.fixed[name])
        known = ["world", *([self.root] if self.root else []), *self.fixed]
        frame_id.fail(
            f"there is no frame {brief(name)} that stands still; there are: "
            f"{', '.join(dict.fromkeys(known))}"
        )


def load_moveit_scene(path: str | Path, robot: Robot | None = None) -> Scene:
    """Load the obstacles of a MoveIt planning scene.

    Poses become those in the frame of the robot's first link, which the scene may have
    put elsewhere in the world (a joint of several freedoms in its robot state).

    Args:
        path: YAML file with a ``PlanningScene`` message, or one in MoveIt's text format
            (``.scene``), as RViz exports it.
        robot: The robot, whose first link is then known as a frame.

    Returns:
        The scene; an object of several shapes becomes several obstacles, ``NAME.0``,
        ``NAME.1`` and so on.

    Raises:
        ScenarioError: If the file is wrong, or holds what cannot be read: attached
            objects, an octree, cones.
    """
    instance(robot, (Robot, NoneType), "robot", "a Robot or None")
    message = _read_message(path)
    return _read_scene(message, _read_frames(message, robot))


def _read_message(path: str | Path) -> Field:
    """Read a message from a YAML file, or a scene in text; it must be a table.

    Raises:
        ScenarioError: If it is no YAML file with a table.
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
        *states: Robot states that say more about where the base is.
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
    fixed: dict[str, pin.SE3] = {}
    for item in message.get("fixed_frame_transforms").items():
        name = item.need("child_frame_id").text()
        parent = item.get("header").get("frame_id")
        if parent.given and parent.value not in (*_WORLD, *fixed, name):
            # Frames may hang on frames that are said later or not at all.
            continue
        above = fixed.get(str(parent.value), pin.SE3.Identity())
        fixed[name] = above * _read_pose(item.need("transform"))
    if robot is None:
        return _Frames(base, "", fixed)
    urdf = robot.description
    # Packages are often found beside that of the robot.
    return _Frames(base, urdf.links[0], fixed, urdf.package_dirs)


def _read_pose(value: Field) -> pin.SE3:
    """Read a pose or transform; what is left out is zero.

    Args:
        value: A message ``Pose`` (position, orientation) or ``Transform`` (translation,
            rotation).

    Raises:
        ScenarioError: If it is none.
    """
    place, turn = value.get("position"), value.get("orientation")
    if not place.given and not turn.given:
        place, turn = value.get("translation"), value.get("rotation")
    position = place.vector("xyz") if place.given else np.zeros(3)
    if np.any(np.abs(position) > FARTHEST):
        place.fail(f"is {position.tolist()}, expected a place within {FARTHEST:g} m")
    return pin.SE3(_read_rotation(turn), position)


def _read_rotation(value: Field) -> np.ndarray:
    """Read a quaternion (x, y, z, w); all zeros, the ROS default, is no rotation."""
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
        message.fail(f"is no planning scene: it has none of {', '.join(SCENE_KEYS)}")
    _refuse_attached(message.get("robot_state"))
    world = message.get("world")
    unread = dict.fromkeys((*_unread_precautions(message), *_unread(message, SCENE)))
    warn_of_keys(message.path, "not read", tuple(unread))
    octree = world.get("octomap").get("octomap").get("data")
    if octree.given:
        octree.fail("octrees are not read")
    obstacles: list[Obstacle] = []
    for item in world.get("collision_objects").items():
        obstacles += _read_object(item, frames)
    with blaming(world.get("collision_objects")):
        return Scene(obstacles)


def _refuse_attached(state: Field) -> None:
    """Refuse a robot state in which the robot holds something.

    Raises:
        ScenarioError: If it does.
    """
    attached = state.get("attached_collision_objects")
    if attached.given:
        names = [item.get("object").get("id").value for item in attached.items()]
        attached.fail(
            "objects attached to the robot are not read: "
            f"{', '.join(str(name) for name in names)}"
        )


def _unread_precautions(message: Field) -> Iterator[str]:
    """Keys of a scene that would make a motion safer or freer, and are not read."""
    for name, key, neutral in (
        ("link_padding", "padding", 0.0),
        ("link_scale", "scale", 1.0),
    ):
        for item in message.get(name).items():
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
    found: list[tuple[Field, pin.SE3]] = []
    for kind in PLURALS:
        shapes, poses = _shapes_and_poses(item, kind, optional="poses")
        within = [place * _read_pose(pose) for pose in poses] or [place] * len(shapes)
        found += zip(shapes, within, strict=True)
    if not found:
        item.fail(f"the object {brief(name)} has no shapes")
    return [
        _obstacle(name if len(found) == 1 else f"{name}.{index}", *shape, frames)
        for index, shape in enumerate(found)
    ]


def _shapes_and_poses(
    item: Field, kind: str, *, optional: str
) -> tuple[list[Field], list[Field]]:
    """Shapes of a kind, and their poses.

    Args:
        item: What has them as lists.
        kind: The kind, one of ``PLURALS``.
        optional: "shapes" or "poses": there may be none of these at all.

    Raises:
        ScenarioError: If there are more of one than of the other.
    """
    plural = PLURALS[kind]
    shapes, poses = list(item.get(plural).items()), item.get(f"{kind}_poses")
    places = list(poses.items())
    if {"shapes": shapes, "poses": places}[optional] and len(shapes) != len(places):
        poses.fail(f"holds {len(places)} poses for {len(shapes)} {plural}")
    return shapes, places


def _obstacle(name: str, shape: Field, place: pin.SE3, frames: _Frames) -> Obstacle:
    where: dict[str, Any] = {"position": place.translation, "rotation": place.rotation}
    with blaming(shape):
        if "coef" in shape.table():
            placed = place * _board(shape.need("coef"))
            return Box(name, size=np.array(BOARD), position=placed.homogeneous)
        if "type" not in shape.table():
            return Mesh(name, **_mesh(shape, frames), **where)
        kind, size = _read_primitive(shape)
        if kind == "box":
            return Box(name, size=np.array(size), **where)
        if kind == "sphere":
            return Sphere(name, radius=size[0], **where)
        return Cylinder(name, radius=size[1], length=size[0], **where)


def _board(coefficients: Field) -> pin.SE3:
    """Placement of a board behind the plane a x + b y + c z + d = 0, at its origin."""
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
        ScenarioError: If it is none of these.
    """
    kind = shape.need("type")
    named = isinstance(kind.value, int) and _SHAPES.get(kind.value)
    name = str(named or kind.value).lower()
    if name not in _SIZES:
        kind.fail(
            f"there is no shape {brief(named or kind.value)} here; there are: "
            f"{', '.join(_SIZES)}, and meshes"
        )
    size, (count, words) = shape.need("dimensions"), _SIZES[name]
    if not isinstance(size.value, list) or len(size.value) != count:
        size.fail(f"is {brief(size.value)}, expected {words} of a {name} [m]")
    return name, size.numbers(count)


def _mesh(shape: Field, frames: _Frames) -> dict[str, Any]:
    """Read a mesh: corners and triangles, or the name of a file."""
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
    """Find the file of a mesh: relative to the scene, or in a package."""
    try:
        path, tried = resolve_resource(name.text(), name.path, frames.package_dirs)
    except RobotLoadError as error:
        name.fail(str(error).removeprefix(f"{name.path}: "))
    if path is None:
        name.fail(f"the file {missing_resource(name.text(), tried)}")
    return path


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


def _start_values(request: Field, key: str) -> dict[str, float]:
    """Positions or velocities of the start state by joint [SI units].

    Raises:
        ScenarioError: If there are none, or more or fewer than joints, or a joint is
            there twice.
    """
    state = request.get("start_state").get("joint_state")
    joints = [item.text() for item in state.need("name").items()]
    found = state.need(key)
    numbers = found.numbers()
    if len(numbers) != len(joints):
        found.fail(f"holds {len(numbers)} numbers for {len(joints)} joints")
    if len(set(joints)) != len(joints):
        twice = next(name for name in joints if joints.count(name) > 1)
        state.get("name").fail(f"the joint {brief(twice)} is there twice")
    return dict(zip(joints, numbers, strict=True))


def _goal_names(request: Field, key: str, *kinds: str) -> list[str]:
    """Joints ("joint_name") or links ("link_name") of constraints of the goal."""
    found = [
        item.need(key).text()
        for goal in request.get("goal_constraints").items()
        for kind in kinds
        for item in goal.get(f"{kind}_constraints").items()
    ]
    return list(dict.fromkeys(found))


def _goal_joints(request: Field) -> list[str]:
    return _goal_names(request, "joint_name", "joint")


def _goal_links(request: Field) -> list[str]:
    return _goal_names(request, "link_name", "position", "orientation")


def _outside_group(
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
    said = SemanticDescription() if semantics is None else semantics
    found, states = said.find_group(name.text()), said.group_states
    links = _goal_links(request)
    moving = set[str]() if found is None else set(said.groups[found].joints)
    named = bool(moving)
    if found is not None and named:
        warn_of_group(found, said.groups[found])
    if not named:
        above = map(description.joints_above, links)
        moving = set(_goal_joints(request)).union(*above)
    outside = [j for j in description.joints if j.name not in moving and not j.mimic]
    if not named and links and outside:
        warn_caller(
            f"{name.path}: {name.key}: the robot has no group {brief(name.text())} (it "
            f"has: {', '.join(said.groups) or 'none'}); planned are the joints that "
            "carry the links of the goal, "
            f"and {', '.join(j.name for j in outside)} are held"
        )
    lacking = [joint.name for joint in outside if joint.name not in start]
    if lacking:
        warn_caller(
            f"{request.path}: start_state says nothing about {', '.join(lacking)}, "
            "outside the group; held where the robot's SRDF file has them, else at 0"
        )
    return {j.name: start.get(j.name, rest_position(j, states)) for j in outside}


def load_moveit(
    robot: Robot | str | os.PathLike[str],
    scene_path: str | Path,
    request_path: str | Path,
    *,
    margin: float = 0.0,
    self_collision: bool | None = None,
    kinematic: bool = False,
    joint_limits: str | Path | None = None,
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
        scene_path: YAML file with a ``PlanningScene`` message, or one in MoveIt's text
            format (``.scene``).
        request_path: YAML file with a ``MotionPlanRequest`` message.
        margin: Distance to keep from obstacles [m].
        self_collision: Whether the links keep clear of each other; None as for
            :class:`~tominpmp.Problem`.
        kinematic: Whether the robot is loaded without its dynamics, as by
            :func:`~tominpmp.load_robot`; one that is loaded has to be so already.
        joint_limits: MoveIt's ``joint_limits.yaml``, whose limits go before those of
            the robot's files; accelerations that a kinematic robot needs are there. The
            request says how they are scaled.

    Returns:
        The problem. Joints of the start state that the robot lacks, and locked ones
        outside their limits, cause a warning.

    Raises:
        ScenarioError: If a file is wrong, or the problem in it, as by a start in
            collision; with the file and the key in it.
        RobotLoadError: If the robot cannot be loaded.
        ProblemError: If the margin is wrong, or limits are given for a robot that is
            loaded.
    """
    scene_message, request = _read_message(scene_path), _read_message(request_path)
    state, start = request.get("start_state"), _start_values(request, "position")
    moveit = None if joint_limits is None else load_joint_limits(joint_limits)
    arm = _grouped_robot(robot, request, start, kinematic, moveit)
    _check_state(arm, state.get("joint_state"), start)
    _refuse_unread(request)
    warn_of_keys(request.path, "not read", tuple(_unread(request, REQUEST)))
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
    request = _read_message(request_path)
    return _locks(request, _start_values(request, "position"), source)


def _locks(
    request: Field, start: Mapping[str, float], source: RobotSource
) -> dict[str, float]:
    """Joints to lock for a request, and those that follow them, by name [rad or m]."""
    description, moved = source.description, _goal_joints(request)
    locks = _outside_group(request, start, description, source.semantics)
    # Any joint may move to bring a link to its place.
    if moved and not _goal_links(request):
        still = (j.name for j in description.joints if j.mimic is None)
        locks |= {k: start[k] for k in still if k in start and k not in moved}
    for joint in description.joints:
        mimic = joint.mimic
        if mimic is not None and mimic.leader in locks and joint.name in start:
            there = mimic.multiplier * locks[mimic.leader] + mimic.offset
            # Where others are follows from their leaders; a warning tells. A lock that
            # was typed must not contradict one that is told here.
            if abs(there - start[joint.name]) <= TOGETHER:
                locks[joint.name] = start[joint.name]
    return locks


def _grouped_robot(
    robot: Robot | str | os.PathLike[str],
    request: Field,
    start: Mapping[str, float],
    kinematic: bool,
    limits: MoveItLimits | None,
) -> Robot:
    """The robot with the joints locked that the request does not move."""
    if not isinstance(robot, Robot):
        source = read_source(robot)
        more = {"locked_joints": _locks(request, start, source), "kinematic": kinematic}
        return load_limited_robot(limits, source, {}, **more)
    if limits is not None:
        raise ProblemError(
            "joint_limits is given, expected None for a robot that is loaded",
            "joint_limits",
        )
    if kinematic and not robot.kinematic:
        raise ProblemError(
            "kinematic is True, expected False or a robot that is kinematic: "
            "load_robot(..., kinematic=True)",
            "kinematic",
        )
    locks = _outside_group(request, start, robot.description, robot.srdf)
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


def _start_velocity(robot: Robot, request: Field) -> Array | None:
    if not request.get("start_state").get("joint_state").get("velocity").given:
        return None
    velocity = _start_values(request, "velocity")
    held = [name for name in robot.locked_joints if velocity.get(name, 0.0) != 0.0]
    if held:
        warn_caller(
            f"{request.path}: {', '.join(held)} move at the start, but are locked"
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
    if speed.number(default=0.0) > 0.0:
        speed.fail(f"is {speed.number():g}: speeds of links are not limited here")


def _check_upright(frames: _Frames, robot: Robot, message: Field) -> None:
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
    value = field.number(default=1.0)
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


#: Where a point is to be: a place in the frame of the base, and the radius of a sphere
#: about it, or half edges of a box, shape (3,) [m]; a radius of zero is a point.
_Region: TypeAlias = "tuple[pin.SE3, float | Array]"


@dataclass(frozen=True)
class _GoalReader:
    """Reads the goals of requests.

    Attributes:
        robot: The robot.
        frames: Frames in which poses may be given.
        start: Start, by joint; joints stay there of which a goal of joint positions
            says nothing.
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
        if len(goals) > MOST:
            constraints.fail(
                f"holds {len(goals)} alternatives, expected {MOST} at most"
            )
        return goals[0] if len(goals) == 1 else AnyGoal(goals)

    def _alternatives(self, item: Field) -> list[Goal]:
        """Goals of which each meets one set of constraints."""
        joints = list(item.get("joint_constraints").items())
        places = list(item.get("position_constraints").items())
        turns = self._turns(item)
        if item.get("visibility_constraints").given:
            item.get("visibility_constraints").fail("visibility goals are not read")
        with blaming(item):
            alone = not places and not turns
            fixed = [self._joint_goal(joints, alone)] if joints else []
            if joints and alone:
                return fixed
            choices = [self._regions(place, turns) for place in places]
            if np.prod([len(regions) for regions in choices]) > MOST:
                item.fail(f"holds more than {MOST} combinations of regions")
            found = []
            for regions in itertools.product(*choices):
                parts = [*fixed, *_frame_goals(places, regions, turns)]
                if not parts:
                    item.fail("asks for nothing: every orientation will do")
                found.append(parts[0] if len(parts) == 1 else AllGoals(parts))
        return found

    def _joint_goal(self, constraints: Sequence[Field], alone: bool) -> Goal:
        """Goal for joints, alone or beside goals for frames."""
        asked, every = self._joints(constraints), self.robot.joint_names
        if alone:
            asked = {name: asked.get(name, (self.start[name], 0.0)) for name in every}
        if not asked:
            constraints[0].get("joint_name").fail("is of a joint that does not move")
        q, tolerance = np.array(list(asked.values())).T
        if alone and not np.any(tolerance):
            return JointGoal(q)
        return JointRegionGoal(q, tolerance, None if alone else tuple(asked))

    def _joints(self, constraints: Sequence[Field]) -> dict[str, tuple[float, float]]:
        """Middle and half width of what is tolerated, by joints that move."""
        asked: dict[str, tuple[float, float]] = {}
        robot, seen = self.robot, set[str]()
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

    def _turns(self, item: Field) -> dict[str, _Turn]:
        """Orientations that are asked for, by link."""
        found: dict[str, _Turn] = {}
        for turn in item.get("orientation_constraints").items():
            link = self._link(turn)
            if link in found:
                turn.get("link_name").fail(f"the link {brief(link)} is there twice")
            rotation = _read_rotation(turn.need("orientation"))
            keys = [f"absolute_{axis}_axis_tolerance" for axis in "xyz"]
            tolerance = np.minimum([_tolerance(turn.get(k)) for k in keys], np.pi)
            tolerance[tolerance <= ACCURACY] = 0.0
            base = self.frames.to_base(turn.get("header")).rotation
            found[link] = _Turn(base @ rotation, tolerance)
        return found

    def _regions(self, place: Field, turns: Mapping[str, _Turn]) -> list[_Region]:
        """Regions for the origin of a link, any of which will do."""
        turn = turns.get(self._link(place))
        region = place.need("constraint_region")
        base = self.frames.to_base(place.get("header"))
        offset = place.get("target_point_offset")
        shift = offset.vector("xyz") if offset.given else np.zeros(3)
        if np.any(shift):
            if turn is None or not turn.exact:
                offset.fail("an offset without an exact orientation is not read")
            base = pin.SE3(np.eye(3), -turn.rotation @ shift) * base
        found: list[_Region] = []
        for kind in ("primitive", "mesh"):
            # A pose without a shape is a point.
            shapes, poses = _shapes_and_poses(region, kind, optional="shapes")
            for shape, pose in itertools.zip_longest(shapes, poses):
                size: float | Array = 0.0
                spot = base * _read_pose(pose)
                if shape is not None and kind == "primitive":
                    size = _region_size(shape)
                elif shape is not None:
                    # The middle of a mesh is within what is tolerated, its convex hull.
                    with blaming(shape):
                        mesh = Mesh("region", **_mesh(shape, self.frames))
                    spot = spot * pin.SE3(np.eye(3), mesh.points.mean(axis=0))
                found.append((spot, size))
        if not 0 < len(found) <= MOST:
            region.fail(f"holds {len(found)} regions, expected 1 to {MOST}")
        return found

    def _link(self, item: Field) -> str:
        link = item.need("link_name")
        with blaming(link):
            self.robot.frame_id(link.text())
        return link.text()


def _tolerance(item: Field) -> float:
    return item.number("a number >= 0", default=0.0, least=0.0)


def _region_size(shape: Field) -> float | Array:
    """Radius or half edges of a region [m], zero where it stands for accuracy."""
    kind, size = _read_primitive(shape)
    if not min(size) > 0.0:
        shape.get("dimensions").fail(f"is {size}, expected positive lengths [m]")
    half = 0.5 * np.array(size)
    if kind == "sphere":
        return size[0] if size[0] > ACCURACY else 0.0
    if kind == "cylinder":
        # The largest box in it that is as long.
        radius = size[1] * 0.5**0.5
        half = np.array([radius, radius, 0.5 * size[0]])
    return half if np.any(half > ACCURACY) else 0.0


def _frame_goals(
    places: Sequence[Field], regions: Sequence[_Region], turns: Mapping[str, _Turn]
) -> list[Goal]:
    """Goals for the links, one region each."""
    left = dict(turns)
    parts: list[Goal] = []
    for place, region in zip(places, regions, strict=True):
        link = place.need("link_name").text()
        turn = left.get(link)
        pose, size = region
        if isinstance(size, np.ndarray):
            parts.append(RegionGoal(link, -size, size, pose))
        elif size == 0.0 and turn is not None and turn.exact:
            parts.append(PoseGoal(link, pin.SE3(turn.rotation, pose.translation)))
            del left[link]
        else:
            parts.append(PositionGoal(link, pose.translation, tolerance=size))
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
