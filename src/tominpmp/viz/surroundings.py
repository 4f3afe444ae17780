"""Obstacles and loads around a robot during a motion, for drawing.

An obstacle is drawn as furniture or as a hazard, during the segments whose scenes
contain it. A load rests at its place of pick-up until it is picked up, moves with its
frame while it is carried, and rests where it is put down. A load that is picked up
where one of equal name and shape was put down is the same body, whichever arm carries
it; at another place it is another body.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tominpmp.arrays import Array, BoolArray
from tominpmp.kinematics import FrameMotions
from tominpmp.motion.trajectory import Trajectory
from tominpmp.problem.problem import Problem
from tominpmp.scene.grids import HeightField
from tominpmp.scene.meshes import Mesh
from tominpmp.scene.obstacles import Box, Obstacle
from tominpmp.verification.stages import Stage, stages_of
from tominpmp.viz.surfaces import obstacle_surface, transform

# Least ratio of width to thickness of a board, in both directions.
BOARD = 3.0
# Points of the path of a frame; and more of them for each further segment.
PATH_POINTS, SEGMENT_POINTS = 300, 60

FURNITURE_RGB, HAZARD_RGB = (0.553, 0.596, 0.647), (0.839, 0.271, 0.227)
# Colours of start, goal, via points, and path of the end of an arm.
START_RGB, GOAL_RGB = (0.35, 0.47, 0.65), (0.13, 0.62, 0.36)
VIA_RGB, PATH_RGB = (0.55, 0.27, 0.80), (0.95, 0.64, 0.10)


def obstacle_color(obstacle: Obstacle) -> tuple[float, float, float]:
    """Colour of an obstacle: red, green and blue from 0 to 1.

    Tables, walls, boards and ground at rest are grey; all other obstacles are red:
    posts, balls, crates, and moving obstacles.
    """
    board = False
    if isinstance(obstacle, Box | Mesh):
        least, middle, _ = sorted(obstacle_surface(obstacle).extents.tolist())
        board = middle >= BOARD * least
    furniture = board or isinstance(obstacle, HeightField)
    rests = obstacle.motion is None
    return FURNITURE_RGB if furniture and rests else HAZARD_RGB


@dataclass(frozen=True, eq=False)
class SceneItem:
    """An obstacle, or a shape of a load, at instants of a motion.

    Attributes:
        name: Its name, unique among obstacles or the shapes of a load.
        shape: The shape; its placement is ignored.
        placements: Placements shape_to_world, homogeneous, shape (m, 4, 4).
        present: Whether the item is in the scene, shape (m,).
        load: Name of the load that the shape belongs to, unique among the loads; None
            for an obstacle.
    """

    name: str
    shape: Obstacle
    placements: Array
    present: BoolArray
    load: str | None = None

    @property
    def moves(self) -> bool:
        """Whether the item may move during the motion."""
        return self.load is not None or self.shape.motion is not None


def scene_items(problem: Problem, motion: Trajectory, times: Array) -> list[SceneItem]:
    """All obstacles and loads of all segments.

    Args:
        problem: The problem.
        motion: Its motion.
        times: Instants [s], shape (m,), possibly after the end of the motion.
    """
    stages = stages_of(problem, motion)
    inside = np.minimum(times, motion.duration)
    shown: dict[Obstacle, SceneItem] = {}
    names: Counter[str] = Counter()
    for stage in stages:
        for obstacle in stage.problem.scene:
            if obstacle not in shown:
                name = _distinct(obstacle.name, names)
                rotations, positions = obstacle.poses(times)
                places = transform(positions, rotations)
                present = np.zeros(times.size, dtype=bool)
                shown[obstacle] = SceneItem(name, obstacle, places, present)
            now = (stage.begin <= inside) & (inside <= stage.end)
            shown[obstacle].present[now] = True
    return [*shown.values(), *_loads(problem, motion, stages, inside)]


def _loads(
    problem: Problem, trajectory: Trajectory, stages: Sequence[Stage], times: Array
) -> Iterator[SceneItem]:
    """The shapes of all loads."""
    # The last two instants are the begin and the end of the segment that carries.
    loads: list[tuple[tuple[str, tuple[Obstacle, ...]], Array]] = []
    segments = problem.segments if len(stages) == len(problem.segments) else ()
    for stage, segment in zip(stages, segments, strict=False):
        payload = segment.payload
        if payload is None or not payload.geometry:
            continue
        # The body does not depend on the placement in which it is held.
        bare = tuple(
            replace(item, position=np.zeros(3), rotation=np.eye(3))
            for item in payload.geometry
        )
        instants = np.append(times, [stage.begin, stage.end])
        q = trajectory(np.clip(instants, stage.begin, stage.end)).q
        frames = FrameMotions(problem.robot, payload.frame).placements(q)
        every = [transform(item.position, item.rotation) for item in payload.geometry]
        held = transform(frames.origin, frames.rotation) @ np.array(every)[:, None]
        now = instants >= stage.begin
        for body, places in loads:
            if body == (payload.name, bare) and _meet(bare[0], places[0], held[0]):
                places[:, now] = held[:, now]
                break
        else:
            loads.append(((payload.name, bare), held))
    always, names = np.ones(times.size, dtype=bool), Counter[str]()
    for (name, bare), places in loads:
        load = _distinct(name, names)
        for shape, rows in zip(bare, places, strict=True):
            yield SceneItem(shape.name, shape, rows[:-2], always, load)


def _meet(shape: Obstacle, earlier: Array, later: Array) -> bool:
    """Whether a load is picked up where one was put down: two bodies would overlap."""
    surface = obstacle_surface(shape)
    center = np.append(surface.bounds.mean(axis=0), 1.0)
    apart = np.linalg.norm((later[-2] - earlier[-1]) @ center)
    return bool(apart <= 0.5 * surface.extents.min())


def _distinct(name: str, names: Counter[str]) -> str:
    """A name with its number if it was used before; ``names`` counts the uses."""
    names[name] += 1
    return name if names[name] == 1 else f"{name} ({names[name]})"


def drawn_path(problem: Problem, motion: Trajectory, frame: str) -> tuple[Array, Array]:
    """Positions of a frame along a motion, and at the ends of its inner segments.

    Returns:
        Shapes (m, 3) and (k, 3) [m].
    """
    ends = motion._ends[:-1]
    count = PATH_POINTS + SEGMENT_POINTS * ends.size
    times = np.append(np.linspace(0.0, motion.duration, count), ends)
    points = FrameMotions(problem.robot, frame).placements(motion(times).q).origin
    return points[:count], points[count:]
