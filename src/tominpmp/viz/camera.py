"""Where to look at a motion from: the side from which nothing hides it.

Directions all around are tried. What counts is how much of the path of the end, and of
the arm, is seen past obstacles and past the arm's own bodies, and how long they look
from there. Bodies are taken as the boxes around them, which is enough to choose a side.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tominpmp.arrays import Array, BoolArray, IntArray
from tominpmp.robot import Robot
from tominpmp.viz.bodies import Body
from tominpmp.viz.skeleton import Skeleton, View, best_view
from tominpmp.viz.surfaces import obstacle_surface
from tominpmp.viz.surroundings import Thing

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


def camera_view(
    robot: Robot, around: Sequence[Thing], motion: Skeleton, bodies: list[Body]
) -> View:
    """Find the side from which a motion is seen best.

    A flat arm is looked at squarely, any other from the side on which least hides it.

    Args:
        robot: The robot.
        around: The obstacles at the m instants of the motion.
        motion: The arm at these instants.
        bodies: Bodies of the robot.
    """
    plane = best_view(motion.points)
    sizes = [np.ptp(body.surface.extent, axis=0).min() for body in bodies]
    extent = np.ptp(motion.points.reshape(-1, 3), axis=0) + max(sizes, default=0.0)
    flat = float(np.abs(plane.normal) @ extent) < 0.2 * float(extent.max())
    if plane.planar and flat:
        return plane
    chosen = np.unique(np.linspace(0, len(motion.end) - 1, INSTANTS).astype(int))
    boxes = _boxes(around, motion, bodies, chosen)
    # The end and the joints, and which joint carries each.
    origins = motion.placements[chosen, 1:, :3, 3]
    points = np.concatenate([motion.end[chosen][:, None], origins], axis=1)
    carrier = int(robot.model.frames[robot.frame_id(motion.end_frame)].parentJoint)
    own = np.concatenate([[carrier], np.arange(1, motion.placements.shape[1])])
    habit = PREFERRED / np.linalg.norm(PREFERRED)
    views, scores = [], []
    for a in AZIMUTHS:
        for e in ELEVATIONS:
            across = np.array([np.cos(a), np.sin(a), 0.0])
            normal = np.cos(e) * across + np.sin(e) * np.array([0.0, 0.0, 1.0])
            right = np.cross([0.0, 0.0, 1.0], normal)
            right /= np.linalg.norm(right)
            view = View(right, np.cross(normal, right), ("", ""), False)
            hidden = _hidden(points, own, view.normal, *boxes)
            views.append(view)
            scores.append(
                END * float(np.mean(~hidden[:, 0]))
                + ARM * float(np.mean(~hidden))
                + LENGTH * _length_seen(view, motion)
                + HABIT * float(view.normal @ habit)
            )
    best = max(scores)
    # Rounding must not choose between sides that serve alike.
    return next(v for v, s in zip(views, scores, strict=True) if s >= best - 1e-6)


def _boxes(
    around: Sequence[Thing], motion: Skeleton, bodies: list[Body], chosen: Array
) -> tuple[Array, Array, IntArray]:
    """Boxes around obstacles and bodies at some instants.

    Returns:
        Lower and upper corners in their own axes, shape (k, 2, 3) [m]; placements
        box_to_world, shape (m, k, 4, 4); joint that carries each, -1 for none,
        shape (k,).
    """
    found = [
        (obstacle_surface(thing.shape).extent, thing.placements[chosen], -1)
        for thing in around
    ]
    for body in bodies:
        places = motion.placements[chosen, body.joint] @ body.placement
        found.append((body.surface.extent, places, body.joint))
    corners = np.array([item[0] for item in found]).reshape(-1, 2, 3)
    placements = np.array([item[1] for item in found]).reshape(-1, len(chosen), 4, 4)
    joints: IntArray = np.array([item[2] for item in found], dtype=np.int64)
    return corners, placements.swapaxes(0, 1), joints


def _hidden(
    points: Array,
    own: Array,
    direction: Array,
    corners: Array,
    placements: Array,
    joints: IntArray,
) -> BoolArray:
    """Whether a point at an instant is hidden from a direction by another's box.

    Args:
        points: By instant, shape (m, p, 3) [m].
        own: Joint that carries each point, shape (p,).
        direction: Unit vector towards the viewer, shape (3,).
        corners: As of :func:`_boxes`.
        placements: Likewise.
        joints: Likewise.

    Returns:
        Truth values, shape (m, p).
    """
    if not len(corners):
        return np.zeros(points.shape[:2], dtype=bool)
    turn = placements[..., :3, :3]
    offset = points[:, :, None] - placements[:, None, :, :3, 3]
    local = np.einsum("mkij,mpki->mpkj", turn, offset)
    ray = np.einsum("mkij,i->mkj", turn, direction)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        one = (corners[:, 0] - local) / ray
        other = (corners[:, 1] - local) / ray
    enter = np.nanmax(np.minimum(one, other), axis=-1)
    leave = np.nanmin(np.maximum(one, other), axis=-1)
    # A point in a box is seen all the same: it may be a hollow one.
    crossed = (enter < leave) & (enter > 1e-9)
    alien = joints[None, :] != own[:, None]
    return np.asarray(np.any(crossed & alien, axis=-1))


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
