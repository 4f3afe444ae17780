"""Meshcat scene of a motion: bodies, animation and camera.

Scenes are drawn with Meshcat's ``Visualizer``, which needs no server. Meshcat's
triangle meshes have no normals, and take four bytes for every number; the geometry of
this module has normals, which keep sharp edges sharp, and packed numbers, which keep
pages small.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation
from trimesh import Trimesh, transform_points
from trimesh.bounds import corners

from tominpmp.arrays import Array, BoolArray
from tominpmp.exceptions import optional
from tominpmp.motion.trajectory import Trajectory
from tominpmp.problem.problem import Problem
from tominpmp.robot.robot import Robot
from tominpmp.viz import surroundings
from tominpmp.viz.skeleton import (
    Skeleton,
    View,
    camera_view,
    end_frame,
    points_in_view,
    skeleton,
)
from tominpmp.viz.surfaces import (
    Body,
    Buffers,
    cylinder,
    obstacle_surface,
    path_tube,
    robot_bodies,
    shaded,
    sphere,
    transform,
)

OBSTACLE_OPACITY = 0.62
TWIN_COLOR = (0.62, 0.67, 0.76, 0.34)
GOAL_COLOR = (*surroundings.GOAL_RGB, 0.75)
LOAD_COLOR = (0.80, 0.60, 0.35, 1.0)
END_COLOR = (0.25, 0.30, 0.38, 1.0)
TRAIL_COLOR = (*surroundings.PATH_RGB, 1.0)
TRIAD_COLORS = ((0.85, 0.2, 0.2), (0.2, 0.65, 0.25), (0.2, 0.35, 0.85))
GHOST_OPACITY = 0.16

# Sizes of markers, as shares of the size of the scene.
TRAIL_RADIUS = 0.0022
GOAL_RADIUS = 0.012
END_RADIUS = 0.006
TRIAD_LENGTH = 0.06

FIELD_OF_VIEW = 40.0  # vertical [deg]
ASPECT = 1.3  # aspect ratio of the window that the camera is placed for
MARGIN = 1.06  # factor of the least distance at which the camera sees all points

Command = dict[str, Any]

# Properties that every JavaScript object has, which names of nodes must not hide.
RESERVED = frozenset(
    "constructor hasOwnProperty isPrototypeOf propertyIsEnumerable toLocaleString "
    "toString valueOf __proto__ __defineGetter__ __defineSetter__ __lookupGetter__ "
    "__lookupSetter__".split()
)


def draw(
    viewer: Any,
    problem: Problem,
    trajectory: Trajectory,
    *,
    fps: float = 60.0,
    ghosts: int = 0,
    frame: str | None = None,
    twins: Sequence[Trajectory] = (),
) -> None:
    """Draw a motion.

    Args:
        viewer: The ``meshcat.Visualizer`` to draw in; the animation is sent last.
        problem: The problem, for robot, obstacles and goal.
        trajectory: The motion.
        fps: Key frames a second; the viewer interpolates between them.
        ghosts: Number of translucent copies of the robot along the motion.
        frame: Frame whose path is drawn; None for the frame of the goal or the last
            one.
        twins: Other motions of the same robot, shown by pale copies of it.
    """
    robot = problem.robot
    frame = frame or end_frame(problem)
    duration = max(item.duration for item in (trajectory, *twins))
    times = frame_times(duration, fps)
    motion = _poses(robot, trajectory, times, frame)
    bodies = robot_bodies(robot)
    shown = surroundings.scene_items(problem, trajectory, times)
    # Moving obstacles count at their first and last placements.
    obstacles = [
        transform_points(obstacle_surface(item.shape).vertices, placement)
        for item in shown
        if item.load is None
        for placement in item.placements[[0, -1] if item.moves else [0]]
    ]
    trail, stops = surroundings.drawn_path(problem, trajectory, frame)
    points = points_in_view(_robot_points(motion, bodies, trail), obstacles)
    size = float(np.linalg.norm(np.ptp(points, axis=0))) or 1.0
    depths = [body.surface.extents.min() for body in bodies]
    view = camera_view(motion.points, max(depths, default=0.0), obstacles)
    _surroundings(viewer, view, points, size)
    moving = _robot(viewer, robot, bodies, motion.placements, "/meshcat/robot")
    seen = {}
    for item in shown:
        color, kind = LOAD_COLOR, f"loads/{node_name(item.load or '')}"
        if item.load is None:
            color = (*surroundings.obstacle_color(item.shape), OBSTACLE_OPACITY)
            kind = "obstacles"
        path = f"/meshcat/{kind}/{node_name(item.name)}"
        surface = obstacle_surface(item.shape)
        put_body(viewer[path], surface, color, item.placements[0])
        if item.moves:
            moving[path] = item.placements
        if not item.present.all():
            seen[path] = item.present
    _mark_goal(viewer["/meshcat/goal"], problem, size)
    line = path_tube(trail, TRAIL_RADIUS, size)
    if line is not None:
        put_body(viewer[f"/meshcat/path of {node_name(frame)}"], line, TRAIL_COLOR)
    for number, point in enumerate(stops, start=1):
        node = viewer[f"/meshcat/ends of segments/{number}"]
        put_body(node, sphere(END_RADIUS * size), END_COLOR, transform(point))
    movable = [body for body in bodies if body.joint]
    if ghosts:
        instants = np.linspace(0.0, trajectory.duration, ghosts)
        poses = _poses(robot, trajectory, instants, frame).placements
        copies = _copies("/meshcat/ghosts", movable, GHOST_OPACITY, poses)
        viewer.window.send(copies)
    for number, twin in enumerate(twins):
        poses = _poses(robot, twin, times, frame).placements
        path = f"/meshcat/twins/{number}"
        moving |= _robot(viewer, robot, movable, poses, path, TWIN_COLOR)
    _animate(viewer, times, moving, seen)


def _poses(robot: Robot, trajectory: Trajectory, times: Array, frame: str) -> Skeleton:
    """Poses of the arm at times [s], shape (m,); after its end the motion holds."""
    return skeleton(robot, trajectory(times, hold=True).q, frame)


def frame_times(duration: float, fps: float) -> Array:
    """Times of the key frames [s]: evenly spaced, both ends included, shape (m,)."""
    count = max(2, int(np.ceil(duration * fps - 1e-9)) + 1)
    return np.linspace(0.0, duration, count)


def _robot(
    viewer: Any,
    robot: Robot,
    bodies: list[Body],
    poses: Array,
    path: str,
    tint: Sequence[float] | None = None,
) -> dict[str, Array]:
    """Draw bodies of a robot on its joints.

    Args:
        viewer: The viewer.
        robot: The robot.
        bodies: Its bodies.
        poses: Placements joint_to_world of all joints, shape (m, joints, 4, 4).
        path: Path of the robot in the tree of the scene.
        tint: Colour of all bodies; None for the colour of each body.

    Returns:
        Placements of the moving joints by their paths, shape (m, 4, 4).
    """
    joints = sorted({body.joint for body in bodies})
    paths = {i: f"{path}/{node_name(str(robot.model.names[i]))}" for i in joints}
    for body in bodies:
        node = viewer[f"{paths[body.joint]}/{node_name(body.name)}"]
        put_body(node, body.surface, tint or body.color, body.placement)
    for joint in joints:
        viewer[paths[joint]].set_transform(poses[0, joint])
    return {paths[joint]: poses[:, joint] for joint in joints if joint}


def _animate(
    viewer: Any,
    times: Array,
    moving: Mapping[str, Array],
    seen: Mapping[str, BoolArray],
) -> None:
    """Animate the nodes at paths.

    Args:
        viewer: The viewer.
        times: Times of the key frames [s], shape (m,).
        moving: Placements of moving nodes by their paths, shape (m, 4, 4).
        seen: Visibility of nodes that appear or disappear, by their paths, shape (m,).
    """
    meshcat = import_meshcat().animation
    tracks: defaultdict[str, dict[str, Any]] = defaultdict(dict)

    def add(path: str, name: str, kind: str, t: Array, values: Any) -> None:
        keys = t.tolist(), values.tolist()
        tracks[path][name] = meshcat.AnimationTrack(name, kind, *keys)

    for path, placements in moving.items():
        quaternions = Rotation.from_matrix(placements[:, :3, :3]).as_quat()
        # q and -q are the same rotation; interpolation needs neighbours of equal sign.
        flips = np.einsum("ij,ij->i", quaternions[1:], quaternions[:-1]) < 0.0
        quaternions[1:] *= np.where(np.cumsum(flips) % 2, -1.0, 1.0)[:, None]
        add(path, "position", "vector3", times, placements[:, :3, 3])
        add(path, "quaternion", "quaternion", times, quaternions)
    for path, flags in seen.items():
        # One key for each change; the viewer holds the value in between.
        changes = np.flatnonzero(np.append(True, np.diff(flags.astype(int)) != 0))
        add(path, "visible", "bool", times[changes], flags[changes])
    # With one frame a second the times of the keys are in seconds.
    clips = {
        viewer[path].path: meshcat.AnimationClip(track, fps=1.0, name="motion")
        for path, track in tracks.items()
    }
    viewer.set_animation(meshcat.Animation(clips))


def _mark_goal(node: Any, problem: Problem, size: float) -> None:
    """Draw the goal: a ball at a point, or the axes of a pose."""
    target = problem.goal.target
    if isinstance(target, np.ndarray):
        put_body(node, sphere(GOAL_RADIUS * size), GOAL_COLOR, transform(target))
    elif target is not None:
        length = TRIAD_LENGTH * size
        rod = cylinder(0.05 * length, length).apply_translation([0.0, 0.0, length / 2])
        for axis, color in enumerate(TRIAD_COLORS):
            turn = transform(np.zeros(3), np.roll(np.eye(3), axis + 1, axis=0))
            put_body(node["xyz"[axis]], rod.copy().apply_transform(turn), (*color, 1.0))
        node.set_transform(np.array(target.homogeneous))


def _robot_points(motion: Skeleton, bodies: list[Body], path: Array) -> Array:
    """Points that enclose the robot and the path of a frame, shape (m, 3) [m]."""
    clouds = [motion.points.reshape(-1, 3), path]
    instants = np.unique(np.linspace(0, len(motion.placements) - 1, 25).astype(int))
    for body in bodies:
        cuboid = corners(body.surface.bounds)
        for pose in motion.placements[instants, body.joint] @ body.placement:
            clouds.append(transform_points(cuboid, pose))
    return np.concatenate(clouds)


def _surroundings(viewer: Any, view: View, points: Array, size: float) -> None:
    """Set background, floor, lights, and a camera that has all points in view."""
    low, high = points.min(axis=0), points.max(axis=0)
    center = (low + high) / 2
    slope = np.tan(np.radians(FIELD_OF_VIEW / 2))
    distance = MARGIN * view.distance(points - center, slope, ASPECT) or 1.0
    offset = distance * view.normal
    camera = import_meshcat().geometry.PerspectiveCamera(
        fov=FIELD_OF_VIEW,
        aspect=ASPECT,
        near=distance / 200.0,
        far=40.0 * distance + 100.0,
    )
    camera.uuid = "camera"
    # The viewer looks at the origin, so the world is moved instead of the target.
    world, floor = transform(-center), transform(-center)
    floor[2, 3] = low[2] - center[2] - 1e-3 * size
    # Meshcat's floor has cells of half a metre; they are scaled to 1, 2, 5, 10 ... m.
    power = 10.0 ** np.floor(np.log10(size / 12.0))
    cell = power * max(step for step in (1, 2, 5) if step * power <= size / 12.0)
    floor[:3, :3] *= cell / 0.5
    # The axes of the camera have y upwards.
    place = [float(offset[0]), float(offset[2]), float(-offset[1])]
    viewer["/Background"].set_property("top_color", [0.96, 0.97, 0.98])
    viewer["/Background"].set_property("bottom_color", [0.78, 0.82, 0.87])
    viewer["/Grid/<object>"].set_property("color", [1.0, 1.0, 1.0, 0.25])
    viewer["/Axes"].set_property("visible", False)
    viewer["/meshcat"].set_transform(world)
    viewer["/Grid"].set_transform(floor)
    viewer["/Cameras/default/rotated"].set_object(camera)
    viewer["/Cameras/default/rotated/<object>"].set_property("position", place)
    lights = viewer["/Lights"]
    for light in ("PointLightNegativeX", "PointLightPositiveX"):
        # The default reach of 10 m would light only half of a large arm.
        lights[f"{light}/<object>"].set_property("distance", 0.0)
        lights[f"{light}/<object>"].set_property("intensity", 0.22)
    lights["AmbientLight/<object>"].set_property("intensity", 0.5)
    lights["FillLight/<object>"].set_property("intensity", 0.3)


def import_meshcat() -> Any:
    """Import Meshcat on demand, as it imports a server and much of IPython.

    Raises:
        MissingDependency: If Meshcat is not installed.
    """
    with optional("meshcat", "viz", "playback"):
        import meshcat
    return meshcat


class Recorder:
    """Window of a ``meshcat.Visualizer`` that records commands instead of sending them.

    Attributes:
        commands: The commands in the form that the viewer reads, in order.
    """

    def __init__(self) -> None:
        self.commands: list[Command] = []

    def send(self, command: Any) -> None:
        """Record a command of Meshcat."""
        self.commands.append(command.lower())


def node_name(name: str) -> str:
    """Escape a name for a path of the viewer."""
    escaped = name.replace("%", "%25").replace("/", "%2F")
    return f"{escaped}_" if escaped in RESERVED else escaped


@dataclass(frozen=True)
class ShadedGeometry:
    """A geometry of Meshcat: triangles with normals.

    Attributes:
        uuid: Identifier in the references of meshes.
        buffers: Its arrays.
    """

    uuid: str
    buffers: Buffers

    def intrinsic_transform(self) -> Array:
        """Placement of the geometry in its mesh."""
        return np.eye(4)

    def lower_in_object(self, data: Command) -> None:
        """Add the geometry to the geometries of an object."""
        attributes = {name: _packed(values) for name, values in self.buffers.items()}
        index = attributes.pop("index")
        buffers = {"attributes": attributes, "index": index}
        geometry = {"uuid": self.uuid, "type": "BufferGeometry", "data": buffers}
        data["geometries"].append(geometry)


def _packed(values: np.ndarray[Any, Any]) -> Command:
    """Pack a buffer as a typed array, one row for each vertex or triangle."""
    import umsgpack

    if values.itemsize > 1:
        packed: Command = import_meshcat().geometry.pack_numpy_array(values.T)
        return packed
    # Bytes, which Meshcat does not pack, are shares of their largest value.
    array = umsgpack.Ext(0x11, np.ascontiguousarray(values).tobytes())
    size = int(values.shape[1])
    return {"itemSize": size, "type": "Int8Array", "array": array, "normalized": True}


def put_body(
    viewer: Any,
    surface: Trimesh,
    color: Sequence[float],
    placement: Array | None = None,
) -> None:
    """Put a surface into the scene as a body; the colour is RGBA from 0 to 1."""
    viewer.set_object(_mesh(viewer.path.lower(), surface, color))
    if placement is not None:
        viewer.set_transform(placement)


def _mesh(path: str, surface: Trimesh, color: Sequence[float]) -> Any:
    """A ``meshcat.geometry.Mesh`` with a fixed identifier, for repeatable pages."""
    geometry = import_meshcat().geometry
    *rgb, opacity = np.clip(color, 0.0, 1.0).tolist()
    red, green, blue = (round(255 * value) for value in rgb)
    material = geometry.MeshPhongMaterial(
        color=red << 16 | green << 8 | blue,
        opacity=opacity,
        specular=0x222222,
        shininess=25,
        depthWrite=opacity >= 1.0,
    )
    material.uuid = f"{path}#m"
    body = geometry.Mesh(ShadedGeometry(f"{path}#g", shaded(surface)), material)
    body.uuid = path
    return body


def _copies(path: str, bodies: Sequence[Body], opacity: float, poses: Array) -> Any:
    """A command that shows copies of bodies, which share geometry and material.

    Args:
        path: Path of the copies in the tree of the scene.
        bodies: The bodies.
        opacity: Opacity of the copies, as a share of the opacity of the bodies.
        poses: Placements joint_to_world of all joints for each copy, shape
            (m, joints, 4, 4).
    """
    data: Command = {"geometries": [], "materials": []}
    children = []
    for i, body in enumerate(bodies):
        color = (*body.color[:3], opacity * body.color[3])
        mesh = _mesh(f"{path}#{i}", body.surface, color).lower()
        data["geometries"] += mesh["geometries"]
        data["materials"] += mesh["materials"]
        for k, place in enumerate(poses[:, body.joint] @ body.placement):
            # The viewer reads matrices column by column.
            matrix = place.T.ravel().tolist()
            copy = {"uuid": f"{path}#{i}.{k}", "matrix": matrix}
            children.append({**mesh["object"], **copy})
    group = {"uuid": path, "type": "Group", "children": children}
    metadata = {"version": 4.5, "type": "Object"}
    scene_object = {"metadata": metadata, **data, "object": group}
    command = {"type": "set_object", "path": path, "object": scene_object}
    return SimpleNamespace(lower=lambda: command)
