"""What is around a robot in a motion, as it is drawn: obstacles and loads.

An obstacle is furniture, or something to beware of. It is there on the segments in
whose scenes it is. A load stands where it is picked up until then, goes with its frame
while it is carried, and stays where it was put down. Loads of one name and shape are
one body, whoever carries it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tominpmp.arrays import Array, BoolArray
from tominpmp.kinematics import FrameMotions
from tominpmp.motion.trajectory import Trajectory
from tominpmp.problem.problem import Problem
from tominpmp.robot.payload import Payload
from tominpmp.robot.robot import Robot
from tominpmp.scene.grids import HeightField
from tominpmp.scene.meshes import Mesh
from tominpmp.scene.obstacles import Box, Obstacle
from tominpmp.verification.stages import Stage, stages_of
from tominpmp.viz.surfaces import obstacle_surface, placed

# A board is at least so many times as wide as thick, in both directions.
BOARD = 3.0

FURNITURE_COLOR = "#8d98a5"
HAZARD_COLOR = "#d6453a"
# Start, goal, points on the way, and path of the end of an arm in space.
START_RGB, GOAL_RGB = (0.35, 0.47, 0.65), (0.13, 0.62, 0.36)
VIA_RGB, PATH_RGB = (0.55, 0.27, 0.80), (0.95, 0.64, 0.10)


def obstacle_color(obstacle: Obstacle) -> str:
    """Colour of an obstacle, as ``#rrggbb``.

    Tables, walls, boards and ground that stand still are grey, and red is what is left:
    posts, balls, crates, and whatever moves.
    """
    board = False
    if isinstance(obstacle, Box | Mesh):
        vertices = obstacle_surface(obstacle).vertices
        least, middle, _ = np.sort(np.ptp(vertices, axis=0))
        board = bool(middle >= BOARD * least)
    furniture = board or isinstance(obstacle, HeightField)
    rests = obstacle.motion is None
    return FURNITURE_COLOR if furniture and rests else HAZARD_COLOR


def rgb(color: str) -> tuple[float, float, float]:
    """Red, green and blue from 0 to 1 of a colour ``#rrggbb``."""
    red, green, blue = (int(color[i : i + 2], 16) / 255.0 for i in (1, 3, 5))
    return red, green, blue


@dataclass(frozen=True, eq=False)
class Thing:
    """An obstacle, or a shape of a load, at instants of a motion.

    Attributes:
        name: Its name, which no other of its kind has.
        shape: What it is, whatever its own placement.
        placements: Placements shape_to_world, homogeneous, shape (m, 4, 4).
        there: Whether it is there, shape (m,).
        load: Name of the load that it is of; None for an obstacle.
    """

    name: str
    shape: Obstacle
    placements: Array
    there: BoolArray
    load: str | None = None

    @property
    def moves(self) -> bool:
        """Whether it is not where it was all the time."""
        return self.load is not None or self.shape.motion is not None


def things(problem: Problem, trajectory: Trajectory, times: Array) -> list[Thing]:
    """All obstacles and loads of all segments.

    Args:
        problem: The problem.
        trajectory: Its motion.
        times: Instants, which may go on after its end [s], shape (m,).
    """
    stages = stages_of(problem, trajectory)
    inside = np.minimum(times, trajectory.duration)
    shown: list[Thing] = []
    names: Counter[str] = Counter()
    for stage in stages:
        now = (stage.begin <= inside) & (inside <= stage.end)
        for obstacle in stage.problem.scene:
            before = next((one for one in shown if one.shape == obstacle), None)
            if before is not None:
                before.there[now] = True
                continue
            names[obstacle.name] += 1
            count = names[obstacle.name]
            name = obstacle.name if count == 1 else f"{obstacle.name} ({count})"
            rotations, positions = obstacle.poses(times)
            places = placed(positions, rotations)
            shown.append(Thing(name, obstacle, places, now.copy()))
    return shown + _loads(problem, trajectory, stages, inside)


def _loads(
    problem: Problem, trajectory: Trajectory, stages: Sequence[Stage], times: Array
) -> list[Thing]:
    """The shapes of all loads."""
    runs: dict[tuple[str, tuple[Obstacle, ...]], list[tuple[Stage, Payload]]] = {}
    segments = problem.segments if len(stages) == len(problem.segments) else ()
    for stage, segment in zip(stages, segments, strict=False):
        payload = segment.payload
        if payload is not None and payload.geometry:
            # However it is held, it is one body.
            bare = tuple(
                replace(item, position=np.zeros(3), rotation=np.eye(3))
                for item in payload.geometry
            )
            runs.setdefault((payload.name, bare), []).append((stage, payload))
    found = []
    for (name, shapes), carried in runs.items():
        places = np.empty((len(shapes), times.size, 4, 4))
        for number, (stage, payload) in enumerate(carried):
            # It is where it was put down last, or where it will be picked up first.
            mine = (times >= stage.begin) | (number == 0)
            held = trajectory(np.clip(times[mine], stage.begin, stage.end)).q
            frames = frame_places(problem.robot, held, payload.frame)
            for shape, own in zip(payload.geometry, places, strict=True):
                own[mine] = frames @ placed(shape.position, shape.rotation)
        there = np.ones(times.size, dtype=bool)
        found += [
            Thing(shape.name, shape, own, there, name)
            for shape, own in zip(shapes, places, strict=True)
        ]
    return found


def frame_places(robot: Robot, q: Array, frame: str) -> Array:
    """Placements of a frame, homogeneous, shape (m, 4, 4), at positions (m, n)."""
    found = FrameMotions(robot, frame).placements(q)
    return placed(found.origin, found.rotation)


def ends_on_the_way(trajectory: Trajectory) -> Array:
    """Times at which segments end that others follow [s], shape (k,)."""
    ends = trajectory.segment_ends
    return np.zeros(0) if ends is None else np.asarray(ends[:-1])
