"""What changes from segment to segment, as it is drawn: loads, obstacles, ends.

A load stands where it is picked up until then, goes with its frame while it is carried,
and stays where it was put down. Loads of one name and shape are one body, whoever
carries it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tominpmp.arrays import Array, BoolArray
from tominpmp.kinematics import FrameMotions
from tominpmp.motion.trajectory import Trajectory
from tominpmp.problem import Problem
from tominpmp.problem.segments import Segment
from tominpmp.robot import Robot
from tominpmp.robot.payload import Payload
from tominpmp.scene import Obstacle, Scene
from tominpmp.viz.surfaces import obstacle_placement, placed


@dataclass(frozen=True, eq=False)
class Load:
    """A load of some segments.

    Attributes:
        name: Its name.
        shapes: Its shapes, with placements in the frame that carries it first.
        placements: Where that frame is at instants, or would be if it had gone on to
            carry the load, homogeneous, shape (m, 4, 4).
        carried: Whether it is carried at these instants, shape (m,).
    """

    name: str
    shapes: tuple[Obstacle, ...]
    placements: Array
    carried: BoolArray


def loads(problem: Problem, trajectory: Trajectory, times: Array) -> list[Load]:
    """The loads of all segments that have shapes.

    Args:
        problem: The problem.
        trajectory: Its motion.
        times: Instants [s], shape (m,).
    """
    found: dict[tuple[str, tuple[Obstacle, ...]], list[tuple[int, Payload]]] = {}
    for number, segment in enumerate(_asked(problem, trajectory)):
        payload = segment.payload
        if payload is not None and payload.geometry:
            # However it is held, it is one body.
            bare = tuple(
                replace(item, position=np.zeros(3), rotation=np.eye(3))
                for item in payload.geometry
            )
            found.setdefault((payload.name, bare), []).append((number, payload))
    return [_load(problem, trajectory, times, runs) for runs in found.values()]


def _asked(problem: Problem, trajectory: Trajectory) -> Sequence[Segment]:
    """The segments of a motion that has their ends; none else."""
    ends = trajectory.segment_ends
    known = ends is not None and ends.size == len(problem.segments)
    return problem.segments if known else ()


def _load(
    problem: Problem,
    trajectory: Trajectory,
    times: Array,
    runs: Sequence[tuple[int, Payload]],
) -> Load:
    """A load that is carried on some segments, given by number and as it is there."""
    ends = np.asarray(trajectory.segment_ends)
    begins = np.concatenate([[0.0], ends[:-1]])
    first = runs[0][1]
    # Of the first shape in the frame that carries it first.
    before = obstacle_placement(first.geometry[0])
    carried = np.zeros(times.size, dtype=bool)
    places = np.empty((times.size, 4, 4))
    known = np.zeros(times.size, dtype=bool)
    for number, payload in reversed(runs):
        begin, end = begins[number], ends[number]
        carried |= (times >= begin) & (times <= end)
        # It is where it was put down last, or where it will be picked up first.
        mine = ~known & ((times >= begin) | (number == runs[0][0]))
        held = trajectory(np.clip(times[mine], begin, end)).q
        frames = frame_places(problem.robot, held, payload.frame)
        grip = obstacle_placement(payload.geometry[0]) @ np.linalg.inv(before)
        places[mine], known = frames @ grip, known | mine
    return Load(first.name, tuple(first.geometry), places, carried)


def frame_places(robot: Robot, q: Array, frame: str) -> Array:
    """Placements of a frame, homogeneous, shape (m, 4, 4), at positions (m, n)."""
    found = FrameMotions(robot, frame).placements(q)
    return placed(found.origin, found.rotation)


def obstacles(
    problem: Problem, trajectory: Trajectory
) -> Iterator[tuple[str, Obstacle, Array]]:
    """All obstacles of the segments, and when they are there.

    Yields:
        A name of its own, the obstacle, and the times between which it is there, rows
        of begin and end [s], shape (k, 2).
    """
    known: list[tuple[Obstacle, list[tuple[float, float]]]] = []
    for scene, begin, end in _scenes(problem, trajectory):
        for obstacle in scene:
            spans = next((spans for one, spans in known if one == obstacle), None)
            if spans is None:
                known.append((obstacle, [(begin, end)]))
            elif spans[-1][1] == begin:
                spans[-1] = spans[-1][0], end
            else:
                spans.append((begin, end))
    names: dict[str, int] = {}
    for obstacle, spans in known:
        count = names[obstacle.name] = names.get(obstacle.name, 0) + 1
        name = obstacle.name if count == 1 else f"{obstacle.name} ({count})"
        yield name, obstacle, np.array(spans)


def _scenes(
    problem: Problem, trajectory: Trajectory
) -> list[tuple[Scene, float, float]]:
    """The scene of each segment, from when to when."""
    if not _asked(problem, trajectory):
        return [(problem.scene, 0.0, trajectory.duration)]
    ends = np.asarray(trajectory.segment_ends).tolist()
    scenes = [phase.scene for phase in problem.phases]
    return list(zip(scenes, [0.0, *ends[:-1]], ends, strict=True))


def there(spans: Array, times: Array) -> BoolArray:
    """Whether times are in one of some spans, shape (m,)."""
    inside = (times >= spans[:, :1]) & (times <= spans[:, 1:])
    return np.asarray(inside.any(axis=0))


def ends_on_the_way(trajectory: Trajectory) -> Array:
    """Times at which segments end that others follow [s], shape (k,)."""
    if trajectory.segment_ends is None:
        return np.zeros(0)
    return np.asarray(trajectory.segment_ends[:-1])
