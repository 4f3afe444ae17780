"""Narrow phase: exact distances of collision pairs, by Coal."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from functools import partial
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array
from tominpmp.collision.broad import Pairs
from tominpmp.collision.shapes import Body
from tominpmp.stopping import check

# Relative tolerances of the algorithms of Gilbert, Johnson and Keerthi (GJK, distances)
# and of the expanding polytope (EPA, depths). Coal's 1e-6 for GJK leaves errors of
# 2e-6 m in distances and 1e-3 m/rad in gradients on a UR5; 1e-11 leaves 1e-10 m and
# 3e-6 m/rad at the same cost. Below 1e-7 EPA fails on cylinders.
GJK_TOLERANCE = 1e-11
EPA_TOLERANCE = 1e-6
# If an algorithm failed, Coal returns distances beyond this [m], or zero, although the
# bodies are far apart.
FAILED = 1e100


def _make_first_query_of_a_box() -> None:
    """Query a box in a direction without zero components, before any other query.

    In the first query of a box Coal decides, for the whole process, whether it enlarges
    the sides of boxes by 1e-10: it does if a component of the direction is zero.
    Without this query, distances and plans would depend on the problems before.
    """
    turned = coal.Transform3s(pin.exp3(np.array([0.3, 0.5, 0.7])), np.ones(3))
    pair = coal.Capsule(0.1, 0.1), coal.Transform3s(), coal.Box(0.1, 0.1, 0.1), turned
    coal.distance(*pair, coal.DistanceRequest(), coal.DistanceResult())


_make_first_query_of_a_box()


class NarrowPhase(threading.local):
    """Exact distances of pairs, at one configuration at a time.

    Each thread has its own bodies, as it places them before it measures distances.

    Results do not depend on former queries: each query is a cold start. A warm start
    from the previous query is not faster, even along a motion.

    Attributes:
        model: The model.
        data: Data of the model.
        geometry: The bodies and the pairs, for Pinocchio.
    """

    def __init__(
        self,
        model: pin.Model,
        bodies: Sequence[Body],
        pairs: Pairs,
    ) -> None:
        round_pairs = any(isinstance(body.shape, coal.Cylinder) for body in bodies)
        geometry = pin.GeometryModel()
        for index, body in enumerate(bodies):
            shape = body.shape
            if round_pairs and isinstance(shape, coal.Sphere):
                # Coal computes the depth of a sphere in a cylinder only radially.
                shape = coal.Capsule(shape.radius, 0.0)
            joint = body.joint if body.joint < model.njoints else 0
            # Named by number, as a link and an obstacle may have the same name.
            item = pin.GeometryObject(str(index), joint, body.placement, shape)
            geometry.addGeometryObject(item)
        for one, other in pairs.tolist():
            geometry.addCollisionPair(pin.CollisionPair(one, other))
        self.model, self.data, self.geometry = model, model.createData(), geometry
        self._pairs = pairs
        self._results = _results(geometry)
        each = zip(geometry.geometryObjects, bodies, strict=True)
        self._moving = [pair for pair in each if pair[1].joint >= model.njoints]

    def place(self, q: Array, R: Array, p: Array) -> None:
        """Place the bodies at a configuration of the model.

        Args:
            q: Configuration of the model, shape (nv,).
            R: Rotations of the moving obstacles, shape (count, 3, 3).
            p: Positions of the moving obstacles, shape (count, 3) [m].
        """
        check()
        self.place_obstacles(R, p)
        pin.updateGeometryPlacements(
            self.model, self.data, self.geometry, self._results, q
        )

    def place_obstacles(self, R: Array, p: Array) -> None:
        """Place the moving obstacles, see :meth:`place`."""
        for item, body in self._moving:
            number = body.joint - self.model.njoints
            item.placement = pin.SE3(R[number], p[number]) * body.placement

    def distances(self, pairs: Sequence[int]) -> list[float]:
        """Signed distances of some pairs [m]."""
        return [self._measure(index).min_distance for index in pairs]

    def witnesses(self, pairs: Sequence[int]) -> Array:
        """Normals and witness points of some pairs.

        Returns:
            Unit normals from the first body to the second, and the nearest points of
            the first and of the second body, in the world [m], shape (3, k, 3).
        """
        found = np.empty((3, len(pairs), 3))
        for k, index in enumerate(pairs):
            result = self._measure(index)
            points = result.getNearestPoint1(), result.getNearestPoint2()
            found[:, k] = self._normal(index, result), *points
        return found

    def _measure(self, index: int) -> Any:
        """Query of a pair; a failed one is repeated with Coal's default tolerances."""
        geometry, results = self.geometry, self._results
        result = pin.computeDistance(geometry, results, index)
        if not 0.0 < abs(result.min_distance) <= FAILED:
            results.distanceRequests[index] = coal.DistanceRequest()
            result = pin.computeDistance(geometry, results, index)
            results.distanceRequests[index] = _request(coal.DistanceRequest())
        return result

    def overlaps(self, q: Array, trace: float = 0.0) -> list[bool]:
        """Whether each pair overlaps, or almost, at a configuration of the model.

        Args:
            q: Configuration of the model, shape (nv,).
            trace: Distance up to which a pair counts as overlapping [m].
        """
        for request in self._results.collisionRequests:
            request.security_margin = trace
        pin.computeCollisions(
            self.model, self.data, self.geometry, self._results, q, False
        )
        return [result.isCollision() for result in self._results.collisionResults]

    def _normal(self, index: int, result: Any) -> Array:
        """Unit normal of a pair, (3,), from the first body to the second."""
        normal = np.array(result.normal)
        if normal @ normal > 0.5:
            return normal
        # Coal returns no normal if the axes of two shapes cross; use the direction
        # between their centres, along which the overlap ends.
        (first, second), places = self._pairs[index].tolist(), self._results.oMg
        way = places[second].translation - places[first].translation
        length = np.linalg.norm(way)
        if length < 1e-9:
            return np.array([1.0, 0.0, 0.0])
        return np.asarray(way / length)


def _request(request: Any) -> Any:
    """A request of Coal with the tolerances that all queries use."""
    request.gjk_tolerance = GJK_TOLERANCE
    request.epa_tolerance = EPA_TOLERANCE
    return request


def _results(geometry: pin.GeometryModel) -> pin.GeometryData:
    """Data with requests that start cold, unlike the default requests of Pinocchio.

    Collision requests ask for a contact, so that Coal decides by the signed distance
    whether a pair keeps its margin. Without this, it takes cylinders that overlap by
    millimetres as free, if the residual distance of GJK is not exactly zero.
    """
    results = geometry.createData()
    distance = _request(coal.DistanceRequest())
    contact = _request(coal.CollisionRequest(coal.CollisionRequestFlag.CONTACT, 1))
    for index in range(len(geometry.collisionPairs)):
        results.distanceRequests[index] = distance
        results.collisionRequests[index] = contact
    return results


class Guard(threading.local):
    """Check whether all pairs keep their margins, in agreement with the distances.

    Bounding boxes decide most pairs, GJK stops as soon as a pair is certainly farther
    apart than its margin, and the first pair that violates its margin ends the query.
    """

    def __init__(self, narrow: NarrowPhase, margin: Array) -> None:
        """Set up the check for margins by pair, shape (pairs,) [m].

        Pairs with the margin minus infinity are not checked.
        """
        self._narrow = narrow
        self._results = _results(narrow.geometry)
        for index, value in enumerate(margin.tolist()):
            self._results.collisionRequests[index].security_margin = value
            self._results.activeCollisionPairs[index] = value > -np.inf
        # Sorted boxes: a plain list takes up to four times as long for height maps and
        # occupancy grids, and the update of a tree costs more than it saves.
        self._manager = pin.BroadPhaseManager_SSaPCollisionManager(
            narrow.model, narrow.geometry, self._results
        )
        self._query = pin.CollisionCallBackDefault(narrow.geometry, self._results, True)
        # Pairs that violated their margins, the last one first.
        self._violated: list[int] = []
        self._free = True

    def is_free(self, q: Array, R: Array, p: Array) -> bool:
        """Whether all margins are kept, see :meth:`NarrowPhase.place`."""
        narrow, found = self._narrow, None
        narrow.place_obstacles(R, p)
        if not self._free:
            # Nearby configurations mostly violate the same margins: of those that a
            # path search for a Fetch in shelves checks, four pairs decide nearly all.
            at = narrow.model, narrow.data, narrow.geometry, self._results
            pin.updateGeometryPlacements(*at, q)
            violates = partial(pin.computeCollision, narrow.geometry, self._results)
            found = next(filter(violates, self._violated), None)
        if found is None:
            at = narrow.model, narrow.data, self._manager, self._query
            self._free = not pin.computeCollisions(*at, q)
            found = self._query.collisionPairIndex
        if not self._free:
            others = [pair for pair in self._violated if pair != found]
            self._violated = [found, *others[:3]]
        return self._free
