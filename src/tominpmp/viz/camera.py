"""Where to look at a motion from: the side from which nothing hides it.

Directions all around are tried. What counts is how much of the path of the end, and of
the arm, is seen past obstacles and past the arm's own bodies, and how long they look
from there. Bodies are taken as the boxes around them, which is enough to choose a side.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tominpmp.arrays import Array, BoolArray
from tominpmp.robot import Robot
from tominpmp.scene import Obstacle
from tominpmp.viz.bodies import Body
from tominpmp.viz.skeleton import Skeleton, View, best_view
from tominpmp.viz.surfaces import Surface, obstacle_placements, obstacle_surface

INSTANTS = 9  # of the motion that are looked at
AZIMUTHS = np.radians(np.arange(0.0, 360.0, 15.0))
ELEVATIONS = np.radians([14.0, 27.0, 40.0])
# The side that is looked from where all serve alike: right, in front and above.
PREFERRED = np.array([0.62, -1.0, 0.5])
# What counts how much: the end in sight, the arm in sight, their length in the picture.
END, ARM, LENGTH, HABIT = 3.0, 1.0, 1.5, 0.25
# Share of the room of the robot by which the picture goes beyond it; what stands
# farther off, as the rest of a table, may be cut.
BEYOND = 0.12


@dataclass(frozen=True, eq=False)
class Boxes:
    """Boxes at several instants.

    Attributes:
        low: Lower corners in their own axes, shape (k, 3) [m].
        high: Upper corners, shape (k, 3) [m].
        placements: Placements box_to_world, shape (m, k, 4, 4).
        joints: Joint that carries each, shape (k,); -1 for none.
    """

    low: Array
    high: Array
    placements: Array
    joints: Array

    def hide(self, points: Array, direction: Array, own: Array) -> BoolArray:
        """Whether a point at an instant is hidden from a direction by another's box.

        Args:
            points: By instant, shape (m, p, 3) [m].
            direction: Unit vector towards the viewer, shape (3,).
            own: Joint that carries each point, shape (p,).

        Returns:
            Truth values, shape (m, p).
        """
        if not len(self.low):
            return np.zeros(points.shape[:2], dtype=bool)
        turn = self.placements[..., :3, :3]
        offset = points[:, :, None] - self.placements[:, None, :, :3, 3]
        local = np.einsum("mkij,mpki->mpkj", turn, offset)
        ray = np.einsum("mkij,i->mkj", turn, direction)[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            one = (self.low - local) / ray
            other = (self.high - local) / ray
        enter = np.nanmax(np.minimum(one, other), axis=-1)
        leave = np.nanmin(np.maximum(one, other), axis=-1)
        # A point in a box is seen all the same: it may be a hollow one.
        crossed = (enter < leave) & (enter > 1e-9)
        alien = self.joints[None, :] != own[:, None]
        return np.asarray(np.any(crossed & alien, axis=-1))


def camera_view(
    robot: Robot,
    obstacles: Sequence[Obstacle],
    motion: Skeleton,
    bodies: list[Body],
    times: Array,
) -> View:
    """Find the side from which a motion is seen best.

    A flat arm is looked at squarely, any other from the side on which least hides it.

    Args:
        robot: The robot.
        obstacles: The obstacles.
        motion: The arm at the times.
        bodies: Bodies of the robot.
        times: Times of the motion, shape (m,) [s].
    """
    plane = best_view(motion.points)
    extent = _extent(motion, bodies)
    flat = float(np.abs(plane.normal) @ extent) < 0.2 * float(extent.max())
    if plane.planar and flat:
        return plane
    chosen = np.unique(np.linspace(0, len(times) - 1, INSTANTS).astype(int))
    boxes = _boxes(obstacles, motion, bodies, times, chosen)
    points, own = _points(robot, motion, chosen)
    habit = PREFERRED / np.linalg.norm(PREFERRED)
    views = [_looking_from(normal) for normal in _directions()]
    scores = []
    for view in views:
        hidden = boxes.hide(points, view.normal, own)
        scores.append(
            END * float(np.mean(~hidden[:, 0]))
            + ARM * float(np.mean(~hidden))
            + LENGTH * _length_seen(view, motion)
            + HABIT * float(view.normal @ habit)
        )
    best = max(scores)
    # Rounding must not choose between sides that serve alike.
    return next(v for v, s in zip(views, scores, strict=True) if s >= best - 1e-6)


def _extent(motion: Skeleton, bodies: list[Body]) -> Array:
    """Extent of the room that joints and bodies take, about, shape (3,) [m]."""
    room = np.ptp(motion.points.reshape(-1, 3), axis=0)
    sizes = [np.ptp(body.surface.vertices, axis=0).min() for body in bodies]
    return np.asarray(room + max(sizes, default=0.0))


def _directions() -> list[Array]:
    return [
        np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
        for a in AZIMUTHS
        for e in ELEVATIONS
    ]


def _looking_from(normal: Array) -> View:
    right = np.cross([0.0, 0.0, 1.0], normal)
    right /= np.linalg.norm(right)
    return View(right, np.cross(normal, right), ("", ""), False)


def _points(robot: Robot, motion: Skeleton, chosen: Array) -> tuple[Array, Array]:
    """The end and the joints at some instants, and which joint carries each."""
    joints = motion.placements.shape[1]
    origins = motion.placements[chosen, 1:, :3, 3]
    points = np.concatenate([motion.end[chosen][:, None], origins], axis=1)
    carrier = int(robot.model.frames[robot.frame_id(motion.end_frame)].parentJoint)
    return points, np.concatenate([[carrier], np.arange(1, joints)])


def _boxes(
    obstacles: Sequence[Obstacle],
    motion: Skeleton,
    bodies: list[Body],
    times: Array,
    chosen: Array,
) -> Boxes:
    """Boxes around obstacles and bodies at some instants."""
    corners: list[tuple[Array, Array]] = []
    placements, joints = [], []
    for obstacle in obstacles:
        corners.append(_corners(obstacle_surface(obstacle)))
        placements.append(obstacle_placements(obstacle, times[chosen]))
        joints.append(-1)
    for body in bodies:
        corners.append(_corners(body.surface))
        placements.append(motion.placements[chosen, body.joint] @ body.placement)
        joints.append(body.joint)
    low = np.array([item[0] for item in corners]).reshape(-1, 3)
    high = np.array([item[1] for item in corners]).reshape(-1, 3)
    stacked = np.array(placements).reshape(-1, len(chosen), 4, 4).swapaxes(0, 1)
    return Boxes(low, high, stacked, np.array(joints, dtype=np.int64))


def _corners(surface: Surface) -> tuple[Array, Array]:
    return surface.vertices.min(axis=0), surface.vertices.max(axis=0)


def _length_seen(view: View, motion: Skeleton) -> float:
    """Length of the path of the end and of the arm in a picture, over the true one."""
    shares = []
    for line in (motion.end, *motion.chains):
        steps = np.diff(line, axis=-2)
        length = float(np.linalg.norm(steps, axis=-1).sum())
        if length > 0.0:
            seen = float(np.linalg.norm(view.project(steps), axis=-1).sum())
            shares.append(seen / length)
    return float(np.mean(shares)) if shares else 0.0


def points_in_view(robot: Array, obstacles: list[Array]) -> Array:
    """What a picture has to hold: the robot, and of obstacles what is near it.

    A table or a floor that goes on beyond the room of the robot on every side is no
    part of it: it is seen anyway, and would make the robot small.

    Args:
        robot: Points that enclose the robot all along its motion, shape (m, 3) [m].
        obstacles: Points of each obstacle, shape (k, 3) [m].
    """
    low, high = robot.min(axis=0), robot.max(axis=0)
    spare = BEYOND * float(np.linalg.norm(high - low))
    kept = []
    for points in obstacles:
        first, last = points.min(axis=0), points.max(axis=0)
        # One that is wholly beside the room would shrink to a side of it.
        beside = np.any(first > high + spare) or np.any(last < low - spare)
        around = np.all((first <= low - spare)[:2] & (last >= high + spare)[:2])
        if not (beside or around):
            kept.append(np.clip(points, low - spare, high + spare))
    return np.concatenate([robot, *kept])
