"""The scene of a motion for the Meshcat viewer: what is shown, and from where."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array
from tominpmp.goals import PoseGoal, PositionGoal
from tominpmp.output.bodies import Body, robot_bodies
from tominpmp.output.commands import (
    Command,
    columns,
    geometry,
    material,
    node_name,
    set_object,
    set_property,
    set_transform,
    solid,
)
from tominpmp.output.skeleton import Skeleton, View, best_view, end_frame, skeleton
from tominpmp.output.surfaces import (
    cylinder,
    moved,
    obstacle_placement,
    obstacle_surface,
    sphere,
    tube,
)
from tominpmp.problem import Problem
from tominpmp.robot import Robot
from tominpmp.scene import Obstacle
from tominpmp.trajectory import Trajectory

OBSTACLE_COLOR = (0.84, 0.27, 0.22, 0.62)
GOAL_COLOR = (0.13, 0.62, 0.36, 0.75)
TRAIL_COLOR = (0.95, 0.64, 0.10, 1.0)
TRIAD_COLORS = ((0.85, 0.2, 0.2), (0.2, 0.65, 0.25), (0.2, 0.35, 0.85))
GHOST_OPACITY = 0.16

# Sizes of markers as shares of the size of the scene.
TRAIL_RADIUS = 0.0022
GOAL_RADIUS = 0.012
TRIAD_LENGTH = 0.06

TRAIL_POINTS = 240
FIELD_OF_VIEW = 40.0  # vertical [deg]
ASPECT = 1.5  # of the window that the camera is placed for
MARGIN = 1.3  # share by which the camera stands further off than it must


@dataclass(frozen=True)
class Appearance:
    """How a motion is shown.

    Attributes:
        fps: Key frames a second; the viewer interpolates between them.
        ghosts: Number of translucent copies of the robot along the motion.
        frame: Frame whose path is drawn; None for that of the goal, else the last.
    """

    fps: float = 60.0
    ghosts: int = 0
    frame: str | None = None


def stage_commands(
    problem: Problem, trajectory: Trajectory, appearance: Appearance
) -> list[Command]:
    """Build the commands that show a motion.

    Args:
        problem: The problem, for robot, obstacles and goal.
        trajectory: The motion.
        appearance: How it is shown.

    Returns:
        The commands, in order; the animation is the last one.
    """
    robot = problem.robot
    frame = appearance.frame or end_frame(problem)
    times = frame_times(trajectory.duration, appearance.fps)
    motion = skeleton(robot, trajectory(times).q, frame)
    bodies = robot_bodies(robot)
    robot_points = _robot_points(motion, bodies)
    points = np.concatenate([robot_points, *_obstacle_points(problem, times[[0, -1]])])
    size = float(np.linalg.norm(np.ptp(points, axis=0))) or 1.0
    view = _camera_view(best_view(motion.points), np.ptp(robot_points, axis=0))
    commands = _surroundings(view, points, size)
    commands += _robot(robot.model, bodies, motion)
    for obstacle in problem.scene:
        path = _obstacle_path(obstacle)
        commands.append(solid(path, obstacle_surface(obstacle), OBSTACLE_COLOR))
        commands.append(set_transform(path, obstacle_placement(obstacle)))
    commands += _goal(problem, size)
    commands += _trail(robot, trajectory, frame, size)
    if appearance.ghosts:
        commands.append(_ghosts(problem, trajectory, frame, bodies, appearance.ghosts))
    moving = [_moving_obstacle(item, times) for item in problem.scene.moving]
    commands.append(_animation(robot.model, motion, times, moving))
    return commands


def frame_times(duration: float, fps: float) -> Array:
    """Times of the key frames [s]: evenly spaced, with both ends, shape (m,)."""
    count = max(2, int(np.ceil(duration * fps - 1e-9)) + 1)
    return np.linspace(0.0, duration, count)


def _obstacle_path(obstacle: Obstacle) -> str:
    return f"/meshcat/obstacles/{node_name(obstacle.name)}"


def _moving_obstacle(obstacle: Obstacle, times: Array) -> tuple[str, Array]:
    """Path of an obstacle that moves, and its placements at times, (m, 4, 4)."""
    placements = np.tile(np.eye(4), (times.size, 1, 1))
    placements[:, :3, :3], placements[:, :3, 3] = obstacle.poses(times)
    return _obstacle_path(obstacle), placements


def _joint_path(model: pin.Model, joint: int) -> str:
    return f"/meshcat/robot/{node_name(str(model.names[joint]))}"


def _robot(model: pin.Model, bodies: list[Body], motion: Skeleton) -> list[Command]:
    commands = []
    for body in bodies:
        path = f"{_joint_path(model, body.joint)}/{node_name(body.name)}"
        commands.append(solid(path, body.surface, body.color))
        commands.append(set_transform(path, body.placement))
    for joint in sorted({body.joint for body in bodies}):
        place = motion.placements[0, joint]
        commands.append(set_transform(_joint_path(model, joint), place))
    return commands


def _animation(
    model: pin.Model,
    motion: Skeleton,
    times: Array,
    moving: list[tuple[str, Array]],
) -> Command:
    clips = []
    seconds = [float(time) for time in times]
    joints = [
        (_joint_path(model, joint), motion.placements[:, joint])
        for joint in range(1, model.njoints)
    ]
    for path, placements in [*joints, *moving]:
        quaternions = np.array(
            [pin.Quaternion(place[:3, :3].copy()).coeffs() for place in placements]
        )
        # q and -q are one rotation; neighbours must be on one side to be interpolated.
        flips = np.einsum("ij,ij->i", quaternions[1:], quaternions[:-1]) < 0.0
        quaternions[1:] *= np.where(np.cumsum(flips) % 2, -1.0, 1.0)[:, None]
        tracks = [
            _track(".position", "vector3", seconds, placements[:, :3, 3]),
            _track(".quaternion", "quaternion", seconds, quaternions),
        ]
        # With one frame a second the times of the keys are in seconds.
        clip = {"fps": 1.0, "name": "motion", "tracks": tracks}
        clips.append({"path": path, "clip": clip})
    return {
        "type": "set_animation",
        "path": "",
        "animations": clips,
        "options": {"play": True, "repetitions": 1},
    }


def _track(name: str, kind: str, seconds: list[float], values: Array) -> Command:
    keys = [
        {"time": time, "value": row}
        for time, row in zip(seconds, values.tolist(), strict=True)
    ]
    return {"name": name, "type": kind, "keys": keys}


def _goal(problem: Problem, size: float) -> list[Command]:
    goal = problem.goal
    path = "/meshcat/goal"
    if isinstance(goal, PositionGoal):
        place = np.eye(4)
        place[:3, 3] = goal.position
        marker = solid(path, sphere(GOAL_RADIUS * size), GOAL_COLOR)
        return [marker, set_transform(path, place)]
    if not isinstance(goal, PoseGoal):
        return []
    length = TRIAD_LENGTH * size
    rod = moved(cylinder(0.05 * length, length), _shift(length / 2))
    commands = []
    for axis, color in enumerate(TRIAD_COLORS):
        turn = np.eye(4)
        turn[:3, :3] = np.roll(np.eye(3), axis + 1, axis=0)
        name = f"{path}/{'xyz'[axis]}"
        commands.append(solid(name, moved(rod, turn), (*color, 1.0)))
    return [*commands, set_transform(path, np.array(goal.pose.homogeneous))]


def _shift(height: float) -> Array:
    placement = np.eye(4)
    placement[2, 3] = height
    return placement


def _trail(
    robot: Robot, trajectory: Trajectory, frame: str, size: float
) -> list[Command]:
    times = np.linspace(0.0, trajectory.duration, TRAIL_POINTS)
    points = skeleton(robot, trajectory(times).q, frame).end
    apart = np.linalg.norm(np.diff(points, axis=0), axis=1) > 1e-6 * size
    points = points[np.concatenate([[True], apart])]
    if len(points) < 2:
        return []
    line = tube(points, TRAIL_RADIUS * size)
    return [solid(f"/meshcat/path of {node_name(frame)}", line, TRAIL_COLOR)]


def _ghosts(
    problem: Problem, trajectory: Trajectory, frame: str, bodies: list[Body], count: int
) -> Command:
    """Copies of the robot between start and end, which share their geometry."""
    path = "/meshcat/ghosts"
    times = np.linspace(0.0, trajectory.duration, count)
    poses = skeleton(problem.robot, trajectory(times).q, frame).placements
    shapes, children = [], []
    for i, body in enumerate(body for body in bodies if body.joint):
        color = (*body.color[:3], GHOST_OPACITY * body.color[3])
        shapes.append(geometry(f"{path}#g{i}", body.surface))
        shapes.append(material(f"{path}#m{i}", color, body.surface.colors is not None))
        children += [
            {
                "uuid": f"{path}#{i}.{k}",
                "type": "Mesh",
                "geometry": f"{path}#g{i}",
                "material": f"{path}#m{i}",
                "matrix": columns(pose[body.joint] @ body.placement),
            }
            for k, pose in enumerate(poses)
        ]
    root = {"uuid": path, "type": "Group", "children": children}
    return set_object(path, shapes, root)


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


def _obstacle_points(problem: Problem, times: Array) -> list[Array]:
    """Points of the obstacles where they are at times."""
    found = []
    for obstacle in problem.scene:
        surface = obstacle_surface(obstacle)
        for placement in _moving_obstacle(obstacle, times)[1]:
            found.append(moved(surface, placement).vertices)
            if obstacle.motion is None:
                break
    return found


def _camera_view(view: View, extent: Array) -> View:
    """Look at a flat arm squarely, at any other from the side and above."""
    flat = float(np.abs(view.normal) @ extent) < 0.2 * float(extent.max())
    if view.planar and flat:
        return view
    normal = np.array([0.62, -1.0, 0.5])
    normal /= np.linalg.norm(normal)
    right = np.cross([0.0, 0.0, 1.0], normal)
    right /= np.linalg.norm(right)
    return View(right, np.cross(normal, right), ("", ""), False)


def _surroundings(view: View, points: Array, size: float) -> list[Command]:
    """Background, floor, lights, and a camera that has all points in view."""
    low, high = points.min(axis=0), points.max(axis=0)
    center = (low + high) / 2
    slope = np.tan(np.radians(FIELD_OF_VIEW / 2))
    across = np.abs(view.project(points - center)) / (slope * np.array([ASPECT, 1.0]))
    distance = float(((points - center) @ view.normal + across.max(axis=1)).max())
    distance = MARGIN * distance or 1.0
    offset = distance * view.normal
    camera = {
        "uuid": "camera",
        "type": "PerspectiveCamera",
        "fov": FIELD_OF_VIEW,
        "aspect": ASPECT,
        "near": distance / 200.0,
        "far": 40.0 * distance + 100.0,
    }
    # The viewer looks at its origin; so the world is moved, not the camera.
    world, floor = np.eye(4), np.eye(4)
    world[:3, 3] = floor[:3, 3] = -center
    floor[2, 3] = low[2] - center[2] - 1e-3 * size
    # Its floor has 40 cells of half a metre each way.
    floor[:3, :3] *= _round_length(size / 12.0) / 0.5
    # The camera's own axes have y upwards.
    place = [float(offset[0]), float(offset[2]), float(-offset[1])]
    path = "/Cameras/default/rotated"
    commands = [
        set_property("/Background", "top_color", [0.96, 0.97, 0.98]),
        set_property("/Background", "bottom_color", [0.78, 0.82, 0.87]),
        set_property("/Grid/<object>", "color", [1.0, 1.0, 1.0, 0.25]),
        set_property("/Axes", "visible", False),
        set_transform("/meshcat", world),
        set_transform("/Grid", floor),
        {"type": "set_object", "path": path, "object": {"object": camera}},
        set_property(f"{path}/<object>", "position", place),
    ]
    for light in ("PointLightNegativeX", "PointLightPositiveX"):
        # These reach 10 m otherwise, which lights half of a large arm.
        commands.append(set_property(f"/Lights/{light}/<object>", "distance", 0.0))
        commands.append(set_property(f"/Lights/{light}/<object>", "intensity", 0.22))
    commands.append(set_property("/Lights/AmbientLight/<object>", "intensity", 0.5))
    commands.append(set_property("/Lights/FillLight/<object>", "intensity", 0.3))
    return commands


def _round_length(length: float) -> float:
    """Largest of 1, 2, 5, 10, ... (and tenths of them) that is not above a length."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(power * max(step for step in (1, 2, 5) if step * power <= length))
