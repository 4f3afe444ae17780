"""Enclosure: points that a frame cannot reach without a collision of its link."""

from __future__ import annotations

import coal
import numpy as np

from tominpmp.arrays import Array
from tominpmp.collision.checker import CollisionChecker, Contact
from tominpmp.collision.shapes import Body, is_convex

# Radius of the ball that represents a point [m].
POINT = 1e-6
# Tolerated overlap, as by default in the verification [m].
TOUCHING = 1e-5


def enclosure(
    checker: CollisionChecker, frame: str, point: Array, tolerance: float
) -> Contact | None:
    """Obstacle that a link certainly overlaps when a frame is at a point.

    The nearest point of the link is at a known distance from the frame. If a ball of
    this radius around the point is inside an obstacle, the link overlaps the obstacle
    in every orientation. Moving obstacles, and pairs that are not checked, are ignored.

    Args:
        checker: Collision checker with the robot, the obstacles and the pairs.
        frame: Name of the frame.
        point: The point in the world, shape (3,) [m].
        tolerance: Largest distance of the frame from the point [m].

    Returns:
        Link and obstacle, with the depth of the point in the obstacle as a negative
        distance; None if no overlap is certain.
    """
    item = checker.robot.model.frames[checker.robot.frame_id(frame)]
    origin = np.asarray(item.placement.translation)
    away = {
        i: max(_distance(body, origin), 0.0)
        for i, body in enumerate(checker.links)
        if body.joint == item.parentJoint and is_convex(body.shape)
    }
    nearest: dict[int, int] = {}
    bodies, pairs = checker.watched
    for link, other in pairs[: checker.obstacle_pairs].tolist():
        if link in away and away[link] < away.get(nearest.get(other, -1), np.inf):
            nearest[other] = link
    for other, link in nearest.items():
        body = bodies[other]
        if body.joint or not is_convex(body.shape):
            continue
        depth = -_distance(body, point)
        if depth > away[link] + tolerance + TOUCHING:
            return Contact(bodies[link].name, body.name, -depth)
    return None


def _distance(body: Body, point: Array) -> float:
    """Signed distance of a point from a body [m]."""
    ball, at = coal.Sphere(POINT), coal.Transform3s(np.eye(3), np.asarray(point))
    place = coal.Transform3s(body.placement.rotation, body.placement.translation)
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    distance = coal.distance(ball, at, body.shape, place, request, result)
    return float(distance) + POINT
