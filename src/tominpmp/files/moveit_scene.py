"""MoveIt planning scenes (YAML): obstacles, and the frames they are given in.

Both ways of writing the messages are read: short (``type: box``, ``position: [x, y,
z]``) and as ROS prints them (``type: 1``, ``position: {x: .., y: .., z: ..}``).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import NoneType
from typing import Any

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array
from tominpmp.checks import instance
from tominpmp.description.fields import Field
from tominpmp.description.files import LONGEST_PATH, resolve_resource
from tominpmp.description.paths import checked_path
from tominpmp.description.yaml_reader import read_yaml
from tominpmp.exceptions import (
    RobotLoadError,
    ScenarioError,
    brief,
    shortened,
    warn_caller,
)
from tominpmp.files.records import blaming
from tominpmp.robot import Robot
from tominpmp.scene import (
    Box,
    Cylinder,
    Mesh,
    Obstacle,
    Scene,
    Sphere,
    rotation_matrix,
)

# What is below a key: nothing to look at (read, or without effect on the motion),
# something that is not read where it is given, a table, or a list of tables.
KNOWN = "known"
UNREAD = "unread"
# Beyond as many keys a warning names no more.
MOST = 20


def _table(known: str = "", *, unread: str = "", **below: Any) -> dict[str, Any]:
    """The keys of a message.

    Args:
        known: Keys below which there is nothing to look at.
        unread: Keys that are not read where they are given.
        **below: What else is there: a table, or a list of tables.
    """
    return {
        **dict.fromkeys(known.split(), KNOWN),
        **dict.fromkeys(unread.split(), UNREAD),
        **below,
    }


# Keys of shapes are checked where they are read.
SHAPES = "primitives primitive_poses meshes mesh_poses"
ROBOT_STATE = _table(
    "attached_collision_objects is_diff",  # the first is refused
    joint_state=_table("header name position velocity effort"),
    multi_dof_joint_state=_table(
        "header joint_names transforms wrench", unread="twist"
    ),
)
CONSTRAINTS = _table(
    "name visibility_constraints",  # the second is refused
    joint_constraints=[
        _table("joint_name position tolerance_above tolerance_below weight")
    ],
    position_constraints=[
        _table(
            "header link_name target_point_offset weight",
            constraint_region=_table(SHAPES),
        )
    ],
    orientation_constraints=[
        _table(
            "header orientation link_name absolute_x_axis_tolerance "
            "absolute_y_axis_tolerance absolute_z_axis_tolerance weight",
            unread="parameterization",
        )
    ],
)
REQUEST = _table(
    # Bounds for bases that move; ours stand still.
    "workspace_parameters "
    # How MoveIt is to look for a motion.
    "pipeline_id planner_id group_name num_planning_attempts allowed_planning_time "
    "max_velocity_scaling_factor max_acceleration_scaling_factor "
    # Links of a speed that is refused, as are constraints on the way.
    "cartesian_speed_limited_link cartesian_speed_end_effector_link "
    "max_cartesian_speed path_constraints trajectory_constraints",
    unread="reference_trajectories",
    start_state=ROBOT_STATE,
    goal_constraints=[CONSTRAINTS],
)
SCENE = _table(
    # Entries of the matrix about objects cause a warning, and so does padding other
    # than zero; links are watched as the SRDF says.
    "name robot_model_name fixed_frame_transforms allowed_collision_matrix "
    "link_padding link_scale object_colors is_diff",
    robot_state=ROBOT_STATE,
    world=_table(
        "octomap",  # refused, as are planes
        collision_objects=[
            _table(
                f"header pose id type {SHAPES} planes plane_poses subframe_names "
                "subframe_poses operation"
            )
        ],
    ),
)


def warn_of_unread(message: Field, known: Mapping[str, Any]) -> None:
    """Warn of what a message says beyond :data:`REQUEST` or :data:`SCENE`."""
    unread = list(dict.fromkeys(_unread(message, known)))
    if unread:
        shown = ", ".join(brief(key).strip("'\"") for key in unread[:MOST])
        warn_caller(f"{message.path}: not read: {shown}")


def _unread(table: Field, known: Mapping[str, Any]) -> list[str]:
    found: list[str] = []
    if table.value is None:
        return found
    for name, item in table.table().items():
        below = known.get(name, UNREAD) if isinstance(name, str) else UNREAD
        if below == UNREAD and _says_something(item.value):
            found.append(item.key)
        elif isinstance(below, Mapping):
            found += _unread(item, below)
        elif isinstance(below, list):
            for entry in item.items():
                found += _unread(entry, below[0])
    return found


def _says_something(value: Any) -> bool:
    """Whether a value is other than what the message has by default."""
    if isinstance(value, Mapping):
        return any(_says_something(item) for item in value.values())
    if isinstance(value, list):
        return any(_says_something(item) for item in value)
    return value not in (None, "", 0, False)


# Numbers of the shapes in the message SolidPrimitive.
_SHAPES = {1: "box", 2: "sphere", 3: "cylinder", 4: "cone", 5: "prism"}
_SIZES = {"box": "x, y and z", "sphere": "the radius", "cylinder": "height and radius"}
# Keys of the message of which there is one at least.
SCENE_KEYS = ("world", "robot_state", "fixed_frame_transforms", "robot_model_name")
# Places beyond this are a mistake [m].
FARTHEST = 1e6
# Keys under which tools write the file of a mesh.
MESH_FILES = ("resource", "mesh_path", "filename", "path")
# Frames that are the world whatever the file is about.
_WORLD = ("", "world", "/world")


@dataclass(frozen=True)
class Frames:
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
        path: YAML file with a ``PlanningScene`` message.
        robot: The robot, whose first link is then known as a frame.

    Returns:
        The scene; an object of several shapes becomes several obstacles, ``NAME.0``,
        ``NAME.1`` and so on.

    Raises:
        ScenarioError: If the file is wrong, or holds what cannot be read: attached
            objects, an octree, planes, cones.
    """
    instance(robot, (Robot, NoneType), "robot", "a Robot or None")
    message = read_message(path)
    return read_scene(message, read_frames(message, robot))


def read_message(path: str | Path) -> Field:
    """Read a message from a YAML file; it must be a table.

    Raises:
        ScenarioError: If it is no YAML file with a table.
    """
    path = checked_path(path, "path", ScenarioError)
    message = Field(read_yaml(path), path)
    message.table()
    return message


def read_frames(
    message: Field, robot: Robot | None, start_state: Field | None = None
) -> Frames:
    """Collect the frames of a planning scene.

    Args:
        message: The planning scene.
        robot: The robot, if there is one.
        start_state: A robot state that says more about where the base is.
    """
    base = pin.SE3.Identity()
    for state in (message.get("robot_state"), start_state):
        joints = None if state is None else state.get("multi_dof_joint_state")
        if joints is None or not joints.get("transforms").given:
            continue
        placements = [read_pose(item) for item in joints.get("transforms").items()]
        if len(placements) > 1:
            joints.get("transforms").fail(
                f"holds {len(placements)} transforms, expected that of the base only"
            )
        base = placements[0]
    fixed: dict[str, pin.SE3] = {}
    for item in message.get("fixed_frame_transforms").items():
        name = item.need("child_frame_id").text()
        parent = item.get("header").get("frame_id")
        if parent.given and parent.value not in (*_WORLD, *fixed, name):
            # Frames may hang on frames that are said later or not at all.
            continue
        above = fixed.get(str(parent.value), pin.SE3.Identity())
        fixed[name] = above * read_pose(item.need("transform"))
    if robot is None:
        return Frames(base, "", fixed)
    urdf = robot.description
    # Packages are often found beside that of the robot.
    return Frames(base, urdf.links[0], fixed, urdf.package_dirs)


def read_pose(value: Field) -> pin.SE3:
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
    return pin.SE3(read_rotation(turn), position)


def read_rotation(value: Field) -> np.ndarray:
    """Read a quaternion (x, y, z, w); all zeros, the ROS default, is no rotation."""
    quaternion = value.vector("xyzw") if value.given else np.zeros(4)
    if not np.any(quaternion):
        return np.eye(3)
    with blaming(value):
        return np.array(rotation_matrix(quaternion))


def read_scene(message: Field, frames: Frames) -> Scene:
    """Read the obstacles of a planning scene message.

    Raises:
        ScenarioError: As :func:`load_moveit_scene`.
    """
    if not any(key in message.table() for key in SCENE_KEYS):
        message.fail(f"is no planning scene: it has none of {', '.join(SCENE_KEYS)}")
    refuse_attached(message.get("robot_state"))
    world = message.get("world")
    _warn_of_unread(message)
    warn_of_unread(message, SCENE)
    octree = world.get("octomap").get("octomap").get("data")
    if octree.given:
        octree.fail("octrees are not read")
    obstacles: list[Obstacle] = []
    for item in world.get("collision_objects").items():
        obstacles += _read_object(item, frames)
    with blaming(world.get("collision_objects")):
        return Scene(obstacles)


def refuse_attached(state: Field) -> None:
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


def _warn_of_unread(message: Field) -> None:
    """Warn of what would make a motion safer or freer, and is not read."""
    unread = []
    for name, key in (("link_padding", "padding"), ("link_scale", "scale")):
        neutral = 0.0 if key == "padding" else 1.0
        for item in message.get(name).items():
            if item.get(key).given and item.get(key).number() != neutral:
                unread.append(item.get(key).key)
    objects = [
        item.get("id").value
        for item in message.get("world").get("collision_objects").items()
    ]
    allowed = message.get("allowed_collision_matrix")
    names = [item.value for item in allowed.get("entry_names").items()]
    if any(isinstance(name, str) and name in objects for name in names):
        unread.append("allowed_collision_matrix (its entries about objects)")
    if unread:
        warn_caller(f"{message.path}: not read: {', '.join(unread)}")


def _read_object(item: Field, frames: Frames) -> list[Obstacle]:
    """Read a CollisionObject: one obstacle for each of its shapes."""
    name = item.need("id").text()
    operation = item.get("operation")
    if operation.given and operation.value not in (0, "add", "ADD"):
        operation.fail("only objects that are added can be read (operation 0)")
    if item.get("planes").given:
        item.get("planes").fail("planes are not read; use a large box")
    place = frames.to_base(item.get("header"))
    if item.get("pose").given:
        place = place * read_pose(item.get("pose"))
    shapes = [*_shapes(item, "primitive"), *_shapes(item, "mesh")]
    if not shapes:
        item.fail(f"the object {brief(name)} has no shapes")
    obstacles = []
    for index, (shape, pose) in enumerate(shapes):
        label = name if len(shapes) == 1 else f"{name}.{index}"
        within = place if pose is None else place * read_pose(pose)
        obstacles.append(_obstacle(label, shape, within, frames))
    return obstacles


def _shapes(item: Field, kind: str) -> Iterator[tuple[Field, Field | None]]:
    """Shapes of one kind with their poses, None where there are no poses at all."""
    plural = {"primitive": "primitives", "mesh": "meshes"}[kind]
    shapes = list(item.get(plural).items())
    poses: list[Field | None] = [*item.get(f"{kind}_poses").items()]
    if not poses:
        poses = [None] * len(shapes)
    if len(poses) != len(shapes):
        item.get(f"{kind}_poses").fail(
            f"holds {len(poses)} poses for {len(shapes)} {plural}"
        )
    yield from zip(shapes, poses, strict=True)


def _obstacle(name: str, shape: Field, place: pin.SE3, frames: Frames) -> Obstacle:
    where: dict[str, Any] = {"position": place.translation, "rotation": place.rotation}
    with blaming(shape):
        if "type" not in shape.table():
            return Mesh(name, **_mesh(shape, frames), **where)
        kind, size = read_primitive(shape)
        if kind == "box":
            return Box(name, size=np.array(size), **where)
        if kind == "sphere":
            return Sphere(name, radius=size[0], **where)
        return Cylinder(name, radius=size[1], length=size[0], **where)


def read_primitive(shape: Field) -> tuple[str, list[float]]:
    """Read a SolidPrimitive.

    Returns:
        "box", "sphere" or "cylinder", and the dimensions in the order of MoveIt: edges;
        radius; height and radius [m].

    Raises:
        ScenarioError: If it is none of these.
    """
    kind = shape.need("type")
    name = kind.value.lower() if isinstance(kind.value, str) else kind.value
    if isinstance(name, int):
        name = _SHAPES.get(name, name)
    if not isinstance(name, str) or name not in _SIZES:
        kind.fail(
            f"there is no shape {brief(name)} here; there are: {', '.join(_SIZES)}, "
            "and meshes"
        )
    size = shape.need("dimensions")
    count = {"box": 3, "sphere": 1, "cylinder": 2}[name]
    if not isinstance(size.value, list) or len(size.value) != count:
        size.fail(f"is {brief(size.value)}, expected {_SIZES[name]} of a {name} [m]")
    return name, size.numbers(count)


def read_mesh_corners(shape: Field, frames: Frames) -> Array:
    """Read the corners of a mesh [m], shape (k, 3).

    Raises:
        ScenarioError: If it is no mesh or cannot be read.
    """
    with blaming(shape):
        return Mesh("region", **_mesh(shape, frames)).points


def _mesh(shape: Field, frames: Frames) -> dict[str, Any]:
    """Read a mesh: corners and triangles, or the name of a file."""
    named = [shape.get(key) for key in MESH_FILES if shape.get(key).given]
    if named:
        scale = shape.get("dimensions" if shape.get("dimensions").given else "scale")
        values: dict[str, Any] = {"path": _mesh_file(named[0], frames)}
        if scale.given:
            values["scale"] = np.array(scale.numbers(3))
        return values
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
    indices = triangle
    if isinstance(triangle.value, dict):
        indices = triangle.need("vertex_indices")
    numbers = indices.numbers(3)
    if not all(number.is_integer() and 0 <= number < 2**31 for number in numbers):
        indices.fail(f"is {brief(indices.value)}, expected three numbers of vertices")
    return [int(number) for number in numbers]


def _mesh_file(name: Field, frames: Frames) -> Path:
    """Find the file of a mesh: relative to the scene, or in a package."""
    try:
        path, tried = resolve_resource(name.text(), name.path, frames.package_dirs)
    except RobotLoadError as error:
        name.fail(str(error).removeprefix(f"{name.path}: "))
    if path is None:
        places = [shortened(str(place), LONGEST_PATH) for place in tried[:10]]
        file = shortened(repr(name.value))
        name.fail(f"there is no file {file}; tried: {', '.join(places)}")
    return path
