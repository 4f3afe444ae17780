"""Meshcat scene of a motion: what is shown, and from where."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from tominpmp.arrays import Array, BoolArray
from tominpmp.motion.trajectory import Trajectory
from tominpmp.problem import Problem
from tominpmp.robot import Robot
from tominpmp.scene import Obstacle
from tominpmp.viz.bodies import Body, robot_bodies
from tominpmp.viz.camera import camera_view, points_in_view
from tominpmp.viz.roles import GOAL_RGB, PATH_RGB, obstacle_color, rgb
from tominpmp.viz.segments import Load, ends_on_the_way, loads, obstacles, there
from tominpmp.viz.skeleton import Skeleton, View, end_frame, end_of, skeleton
from tominpmp.viz.surfaces import (
    cylinder,
    moved,
    obstacle_placement,
    obstacle_placements,
    obstacle_surface,
    path_tube,
    placed,
    sphere,
)
from tominpmp.viz.viewer import SetCopies, import_meshcat, node_name, put_body

OBSTACLE_OPACITY = 0.62
TWIN_COLOR = (0.62, 0.67, 0.76, 0.34)
GOAL_COLOR = (*GOAL_RGB, 0.75)
LOAD_COLOR = (0.80, 0.60, 0.35, 1.0)
END_COLOR = (0.25, 0.30, 0.38, 1.0)
TRAIL_COLOR = (*PATH_RGB, 1.0)
TRIAD_COLORS = ((0.85, 0.2, 0.2), (0.2, 0.65, 0.25), (0.2, 0.35, 0.85))
GHOST_OPACITY = 0.16

# Sizes of markers as shares of the size of the scene.
TRAIL_RADIUS = 0.0022
GOAL_RADIUS = 0.012
END_RADIUS = 0.006
TRIAD_LENGTH = 0.06

TRAIL_POINTS = 240
FIELD_OF_VIEW = 40.0  # vertical [deg]
ASPECT = 1.3  # of the window that the camera is placed for
MARGIN = 1.06  # share by which the camera stands further off than it must


@dataclass(frozen=True)
class Appearance:
    """How a motion is shown.

    Attributes:
        fps: Key frames a second; the viewer interpolates between them.
        ghosts: Number of translucent copies of the robot along the motion.
        frame: Frame whose path is drawn; None for that of the goal, else the last.
        twins: Other motions of the same robot, which pale copies of it show.
    """

    fps: float = 60.0
    ghosts: int = 0
    frame: str | None = None
    twins: Sequence[Trajectory] = ()


def draw(
    viewer: Any, problem: Problem, trajectory: Trajectory, appearance: Appearance
) -> None:
    """Draw a motion.

    Args:
        viewer: The ``meshcat.Visualizer`` to draw it in; the animation comes last.
        problem: The problem, for robot, obstacles and goal.
        trajectory: The motion.
        appearance: How it is shown.
    """
    robot = problem.robot
    frame = appearance.frame or end_frame(problem)
    duration = max(item.duration for item in (trajectory, *appearance.twins))
    times = frame_times(duration, appearance.fps)
    on_the_way = np.minimum(times, trajectory.duration)
    motion = skeleton(robot, trajectory(on_the_way).q, frame)
    bodies = robot_bodies(robot)
    robot_points = _robot_points(motion, bodies)
    shown = list(obstacles(problem, trajectory))
    around = [item for _, item, _ in shown]
    points = points_in_view(robot_points, _obstacle_points(around, times[[0, -1]]))
    size = float(np.linalg.norm(np.ptp(points, axis=0))) or 1.0
    view = camera_view(robot, around, motion, bodies, times)
    _surroundings(viewer, view, points, size)
    joints = _robot(viewer, robot, bodies, motion.placements, "/meshcat/robot")
    for name, obstacle, _ in shown:
        color = (*rgb(obstacle_color(obstacle)), OBSTACLE_OPACITY)
        _obstacle(viewer[_obstacle_path(name)], obstacle, color)
    carried = loads(problem, trajectory, on_the_way)
    for load in carried:
        _load(viewer[_load_path(load)], load)
    _goal(viewer["/meshcat/goal"], problem, size)
    _trail(viewer, robot, trajectory, frame, size)
    _ends(viewer["/meshcat/ends of segments"], robot, trajectory, frame, size)
    if appearance.ghosts:
        viewer.window.send(
            _ghosts(problem, trajectory, frame, bodies, appearance.ghosts)
        )
    moving = [
        (_obstacle_path(name), obstacle_placements(item, times))
        for name, item, _ in shown
        if item.motion is not None
    ]
    moving += [(_load_path(load), load.placements) for load in carried]
    movable = [body for body in bodies if body.joint]
    for number, twin in enumerate(appearance.twins):
        q = twin(np.minimum(times, twin.duration)).q
        poses = skeleton(robot, q, end_of(robot)).placements
        path = f"/meshcat/twins/{number}"
        joints += _robot(viewer, robot, movable, poses, path, TWIN_COLOR)
    seen = {
        _obstacle_path(name): there(spans, on_the_way)
        for name, _, spans in shown
        if not np.array_equal(spans, [[0.0, trajectory.duration]])
    }
    _animate(viewer, times, [*joints, *moving], seen)


def frame_times(duration: float, fps: float) -> Array:
    """Times of the key frames [s]: evenly spaced, with both ends, shape (m,)."""
    count = max(2, int(np.ceil(duration * fps - 1e-9)) + 1)
    return np.linspace(0.0, duration, count)


def _obstacle_path(name: str) -> str:
    return f"/meshcat/obstacles/{node_name(name)}"


def _load_path(load: Load) -> str:
    return f"/meshcat/loads/{node_name(load.name)}"


def _obstacle(node: Any, obstacle: Obstacle, color: Sequence[float]) -> None:
    surface, place = obstacle_surface(obstacle), obstacle_placement(obstacle)
    put_body(node, surface, color, place)


def _load(node: Any, load: Load) -> None:
    """A load, where it is first."""
    for shape in load.shapes:
        _obstacle(node[node_name(shape.name)], shape, LOAD_COLOR)
    node.set_transform(load.placements[0])


def _robot(
    viewer: Any,
    robot: Robot,
    bodies: list[Body],
    poses: Array,
    path: str,
    tint: Sequence[float] | None = None,
) -> list[tuple[str, Array]]:
    """Draw bodies of a robot on its joints.

    Args:
        viewer: The viewer.
        robot: The robot.
        bodies: Its bodies.
        poses: Placements joint_to_world of all joints, shape (m, joints, 4, 4).
        path: Where in the tree of the scene.
        tint: Colour of all bodies; None for that of each.

    Returns:
        Paths of the joints that move, and their placements, shape (m, 4, 4).
    """
    joints = sorted({body.joint for body in bodies})
    paths = {i: f"{path}/{node_name(str(robot.model.names[i]))}" for i in joints}
    for body in bodies:
        node = viewer[f"{paths[body.joint]}/{node_name(body.name)}"]
        surface = body.surface if tint is None else body.surface.plain
        put_body(node, surface, tint or body.color, body.placement)
    for joint in joints:
        viewer[paths[joint]].set_transform(poses[0, joint])
    return [(paths[joint], poses[:, joint]) for joint in joints if joint]


def _animate(
    viewer: Any,
    times: Array,
    moving: list[tuple[str, Array]],
    seen: Mapping[str, BoolArray],
) -> None:
    """Animate what is at paths.

    Args:
        viewer: The viewer.
        times: Times of the key frames [s], shape (m,).
        moving: Paths of what moves, and its placements, shape (m, 4, 4).
        seen: Whether what comes and goes is there, shape (m,), by path.
    """
    meshcat = import_meshcat().animation
    clips = {}
    tracks: dict[str, Any]
    for path, flags in seen.items():
        # Once for each change: in between it is as it was before.
        keys = np.flatnonzero(np.append(True, np.diff(flags.astype(int)) != 0))
        values = times[keys].tolist(), flags[keys].tolist()
        tracks = {"visible": meshcat.AnimationTrack("visible", "bool", *values)}
        clip = meshcat.AnimationClip(tracks, fps=1.0, name="motion")
        clips[viewer[path].path] = clip
    for path, placements in moving:
        quaternions = Rotation.from_matrix(placements[:, :3, :3]).as_quat()
        # q and -q are one rotation; neighbours must be on one side to be interpolated.
        flips = np.einsum("ij,ij->i", quaternions[1:], quaternions[:-1]) < 0.0
        quaternions[1:] *= np.where(np.cumsum(flips) % 2, -1.0, 1.0)[:, None]
        tracks = {
            name: meshcat.AnimationTrack(name, kind, times.tolist(), values.tolist())
            for name, kind, values in (
                ("position", "vector3", placements[:, :3, 3]),
                ("quaternion", "quaternion", quaternions),
            )
        }
        # With one frame a second the times of the keys are in seconds.
        clip = meshcat.AnimationClip(tracks, fps=1.0, name="motion")
        known = clips.get(viewer[path].path)
        if known is not None:
            clip.tracks |= known.tracks
        clips[viewer[path].path] = clip
    viewer.set_animation(meshcat.Animation(clips))


def _goal(node: Any, problem: Problem, size: float) -> None:
    target = problem.goal.target
    if isinstance(target, np.ndarray):
        put_body(node, sphere(GOAL_RADIUS * size), GOAL_COLOR, placed(target))
    elif target is not None:
        length = TRIAD_LENGTH * size
        rod = moved(cylinder(0.05 * length, length), placed([0.0, 0.0, length / 2]))
        for axis, color in enumerate(TRIAD_COLORS):
            turn = placed(np.zeros(3), np.roll(np.eye(3), axis + 1, axis=0))
            put_body(node["xyz"[axis]], moved(rod, turn), (*color, 1.0))
        node.set_transform(np.array(target.homogeneous))


def _trail(
    viewer: Any, robot: Robot, trajectory: Trajectory, frame: str, size: float
) -> None:
    times = np.linspace(0.0, trajectory.duration, TRAIL_POINTS)
    points = skeleton(robot, trajectory(times).q, frame).end
    line = path_tube(points, TRAIL_RADIUS, size)
    if line is not None:
        put_body(viewer[f"/meshcat/path of {node_name(frame)}"], line, TRAIL_COLOR)


def _ends(
    node: Any, robot: Robot, trajectory: Trajectory, frame: str, size: float
) -> None:
    """A bead on the path where each segment ends that another follows."""
    times = ends_on_the_way(trajectory)
    if not times.size:
        return
    points = skeleton(robot, trajectory(times).q, frame).end
    for number, point in enumerate(points, start=1):
        bead = sphere(END_RADIUS * size)
        put_body(node[str(number)], bead, END_COLOR, placed(point))


def _ghosts(
    problem: Problem, trajectory: Trajectory, frame: str, bodies: list[Body], count: int
) -> SetCopies:
    """Copies of the robot between start and end."""
    times = np.linspace(0.0, trajectory.duration, count)
    poses = skeleton(problem.robot, trajectory(times).q, frame).placements
    moving = [body for body in bodies if body.joint]
    return SetCopies(
        "/meshcat/ghosts",
        [(b.surface, (*b.color[:3], GHOST_OPACITY * b.color[3])) for b in moving],
        [poses[:, body.joint] @ body.placement for body in moving],
    )


def _robot_points(motion: Skeleton, bodies: list[Body]) -> Array:
    """Points that enclose the robot all along its motion, shape (m, 3) [m]."""
    clouds = [motion.points.reshape(-1, 3), motion.end]
    instants = np.unique(np.linspace(0, len(motion.placements) - 1, 25).astype(int))
    corners = np.array(list(np.ndindex(2, 2, 2)))
    for body in bodies:
        vertices = body.surface.vertices
        ends = np.stack([vertices.min(axis=0), vertices.max(axis=0)])
        cuboid = np.take_along_axis(ends, corners, axis=0)
        local = cuboid @ body.placement[:3, :3].T + body.placement[:3, 3]
        poses = motion.placements[instants, body.joint]
        world = local @ poses[:, :3, :3].transpose(0, 2, 1) + poses[:, None, :3, 3]
        clouds.append(world.reshape(-1, 3))
    return np.concatenate(clouds)


def _obstacle_points(shown: Sequence[Obstacle], times: Array) -> list[Array]:
    """Points of obstacles where they are at times."""
    found = []
    for obstacle in shown:
        surface = obstacle_surface(obstacle)
        for placement in obstacle_placements(obstacle, times):
            found.append(moved(surface, placement).vertices)
            if obstacle.motion is None:
                break
    return found


def _surroundings(viewer: Any, view: View, points: Array, size: float) -> None:
    """Background, floor, lights, and a camera that has all points in view."""
    low, high = points.min(axis=0), points.max(axis=0)
    center = (low + high) / 2
    slope = np.tan(np.radians(FIELD_OF_VIEW / 2))
    across = np.abs(view.project(points - center)) / (slope * np.array([ASPECT, 1.0]))
    distance = float(((points - center) @ view.normal + across.max(axis=1)).max())
    distance = MARGIN * distance or 1.0
    offset = distance * view.normal
    camera = import_meshcat().geometry.PerspectiveCamera(
        fov=FIELD_OF_VIEW,
        aspect=ASPECT,
        near=distance / 200.0,
        far=40.0 * distance + 100.0,
    )
    camera.uuid = "camera"
    # The viewer looks at its origin; so the world is moved, not the camera.
    world, floor = placed(-center), placed(-center)
    floor[2, 3] = low[2] - center[2] - 1e-3 * size
    # Its floor has 40 cells of half a metre each way.
    floor[:3, :3] *= _round_length(size / 12.0) / 0.5
    # The camera's own axes have y upwards.
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
        # These reach 10 m otherwise, which lights half of a large arm.
        lights[f"{light}/<object>"].set_property("distance", 0.0)
        lights[f"{light}/<object>"].set_property("intensity", 0.22)
    lights["AmbientLight/<object>"].set_property("intensity", 0.5)
    lights["FillLight/<object>"].set_property("intensity", 0.3)


def _round_length(length: float) -> float:
    """Largest of 1, 2, 5, 10, ... (and tenths of them) that is not above a length."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(power * max(step for step in (1, 2, 5) if step * power <= length))
