"""Narrow phase: exact distances of pairs of shapes, by Coal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import coal
import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array
from tominpmp.collision.broad import Pairs
from tominpmp.collision.shapes import Body
from tominpmp.stopping import check

if TYPE_CHECKING:
    from tominpmp.collision.placements import MovingObstacles

# Relative tolerances of the algorithms of Gilbert, Johnson and Keerthi (GJK, distances)
# and of the expanding polytope (EPA, depths). Coal's 1e-6 for GJK leaves errors of
# 2e-6 m in distances and 1e-3 m/rad in gradients on a UR5; 1e-11 leaves 1e-10 m and
# 3e-6 m/rad at the same cost. Below 1e-7 EPA fails on cylinders.
GJK_TOLERANCE = 1e-11
EPA_TOLERANCE = 1e-6
# Coal returns distances beyond this if an algorithm failed [m].
FAILED = 1e100


class NarrowPhase:
    """Distances of pairs at one configuration after the other.

    Results do not depend on former queries: each query starts cold. A warm start from
    the query before is no faster, even along a motion.

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
        obstacles: MovingObstacles | None = None,
    ) -> None:
        round_pairs = any(isinstance(body.shape, coal.Cylinder) for body in bodies)
        geometry = pin.GeometryModel()
        for index, body in enumerate(bodies):
            shape = body.shape
            if round_pairs and isinstance(shape, coal.Sphere):
                # Coal measures the depth of a ball in a cylinder only radially.
                shape = coal.Capsule(shape.radius, 0.0)
            joint = body.joint if body.joint < model.njoints else 0
            # By number, as a link and an obstacle may have the same name.
            geometry.addGeometryObject(
                pin.GeometryObject(str(index), joint, body.placement, shape)
            )
        for one, other in pairs.tolist():
            geometry.addCollisionPair(pin.CollisionPair(one, other))
        self.model, self.data, self.geometry = model, model.createData(), geometry
        self._pairs = pairs
        self._results = _results(geometry)
        self._obstacles = obstacles
        self._moving = [
            (
                geometry.geometryObjects[index],
                body.joint - model.njoints,
                body.placement,
            )
            for index, body in enumerate(bodies)
            if body.joint >= model.njoints
        ]
        self._time: float | None = None

    def place(self, q: Array, time: float, obstacles: tuple[Array, Array]) -> None:
        """Place the bodies at a configuration of the model.

        Args:
            q: Configuration of the model, shape (nv,).
            time: Time [s], for moving obstacles.
            obstacles: Placements of these obstacles at the time, shapes (count, 3, 3)
                and (count, 3); computing them for many instants at once is faster.
        """
        self.shift(time, obstacles)
        pin.updateGeometryPlacements(
            self.model, self.data, self.geometry, self._results, q
        )

    def shift(self, time: float, known: tuple[Array, Array] | None = None) -> None:
        """Place moving obstacles at a time [s]; placements are computed if unknown."""
        check()
        if self._obstacles is None or not self._moving or time == self._time:
            return
        R, p = self._obstacles.placements(np.array([time])) if known is None else known
        R, p = R.reshape(-1, 3, 3), p.reshape(-1, 3)
        placements = [pin.SE3(*place) for place in zip(R, p, strict=True)]
        for item, number, offset in self._moving:
            item.placement = placements[number] * offset
        self._time = time

    def distances(self, pairs: Sequence[int]) -> list[float]:
        """Signed distances of some pairs [m]."""
        return [self._measure(index).min_distance for index in pairs]

    def witnesses(self, pairs: Sequence[int]) -> Array:
        """Witness points of some pairs.

        Returns:
            Unit normals from the first bodies to the second, and the nearest points of
            the first and of the second bodies in the world [m], shape (3, k, 3).
        """
        found = np.empty((3, len(pairs), 3))
        for k, index in enumerate(pairs):
            result = self._measure(index)
            points = result.getNearestPoint1(), result.getNearestPoint2()
            found[:, k] = self._normal(index, result), *points
        return found

    def _measure(self, index: int) -> Any:
        """Result of a pair; after a failure, with the default tolerances of Coal."""
        geometry, results = self.geometry, self._results
        result = pin.computeDistance(geometry, results, index)
        if abs(result.min_distance) > FAILED:
            results.distanceRequests[index] = coal.DistanceRequest()
            result = pin.computeDistance(geometry, results, index)
            results.distanceRequests[index] = _request(coal.DistanceRequest())
        return result

    def overlaps(self, q: Array, trace: float = 0.0) -> list[bool]:
        """Whether each pair overlaps, or nearly, at a configuration of the model.

        Args:
            q: The configuration.
            trace: Distance that counts as an overlap, too [m].
        """
        for request in self._results.collisionRequests:
            request.security_margin = trace
        pin.computeCollisions(
            self.model, self.data, self.geometry, self._results, q, False
        )
        return [result.isCollision() for result in self._results.collisionResults]

    def _normal(self, index: int, result: Any) -> Array:
        """Unit normal of a pair after a query, from the first body to the second."""
        normal = np.array(result.normal)
        if normal @ normal > 0.5:
            return normal
        # Coal gives no normal if axes cross. Moving the centres apart ends the overlap.
        first, second = (
            self._results.oMg[body].translation for body in self._pairs[index].tolist()
        )
        length = np.linalg.norm(second - first)
        if length < 1e-9:
            return np.array([1.0, 0.0, 0.0])
        return np.asarray((second - first) / length)


def _request(request: Any) -> Any:
    """A request of Coal, with the tolerances of all queries."""
    request.gjk_tolerance = GJK_TOLERANCE
    request.epa_tolerance = EPA_TOLERANCE
    return request


def _results(geometry: pin.GeometryModel) -> pin.GeometryData:
    """Data with cold-started requests, unlike the warm-started ones of Pinocchio.

    Whether a pair keeps a margin is decided by its signed distance too, which Coal
    computes if a contact is requested. Else it takes cylinders as free that overlap by
    millimetres, where the residual distance of GJK is not quite zero.
    """
    results = geometry.createData()
    distance = _request(coal.DistanceRequest())
    contact = _request(coal.CollisionRequest(coal.CollisionRequestFlag.CONTACT, 1))
    for index in range(len(geometry.collisionPairs)):
        results.distanceRequests[index] = distance
        results.collisionRequests[index] = contact
    return results


class Guard:
    """Check whether all pairs keep their margins, in agreement with the distances.

    Boxes decide most pairs, GJK stops where a pair is surely farther apart than its
    margin, and the first pair below its margin ends the query.
    """

    def __init__(self, narrow: NarrowPhase, margin: Array) -> None:
        """Set up the check for margins by pair, shape (pairs,) [m]."""
        self._narrow = narrow
        self._results = _results(narrow.geometry)
        for request, value in zip(
            self._results.collisionRequests, margin.tolist(), strict=True
        ):
            request.security_margin = value
        # The plain list of boxes: trees cost more to update than they save here.
        self._manager = pin.BroadPhaseManager_NaiveCollisionManager(
            narrow.model, narrow.geometry, self._results
        )

    def is_free(self, q: Array, time: float = 0.0) -> bool:
        """Whether the margins are kept at a configuration of the model."""
        narrow = self._narrow
        narrow.shift(time)
        return not pin.computeCollisions(
            narrow.model, narrow.data, self._manager, q, True
        )
