"""Distances between a robot and its surroundings, by Coal.

Distances are signed: negative in penetration, where the value is the depth. Meshes of
the links are replaced by their convex hulls, which makes a query about a hundred times
faster.
"""

from __future__ import annotations

from typing import Any, NamedTuple, TypeAlias

import coal
import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array, IntArray
from tominpmp.exceptions import SceneError
from tominpmp.robot import Robot
from tominpmp.scene import Box, Capsule, Cylinder, Obstacle, Scene, Sphere

# Relative tolerances of the algorithms of Gilbert, Johnson and Keerthi (distances) and
# of the expanding polytope (depths). Coal's 1e-6 for the first leaves errors of 2e-6 m
# in distances and 1e-3 m/rad in gradients on a UR5; this one leaves 1e-10 m and
# 3e-6 m/rad at the same cost. Below 1e-7 the second fails on cylinders.
GJK_TOLERANCE = 1e-11
EPA_TOLERANCE = 1e-6
# Distances beyond this are how Coal says that an algorithm failed [m].
FAILED = 1e100
# Flat meshes get this thickness [m]; Coal crashes on hulls without volume.
THINNEST = 1e-4

# Joint that carries a body (0 for the world), placement on it, shape.
Body: TypeAlias = tuple[int, pin.SE3, Any]


class Contact(NamedTuple):
    """The pair that comes closest in a configuration.

    Attributes:
        link: Name of the link.
        obstacle: Name of what it comes close to.
        distance: Signed distance [m].
    """

    link: str
    obstacle: str
    distance: float


def obstacle_shape(obstacle: Obstacle) -> coal.ShapeBase:
    """Shape of an obstacle for Coal.

    Raises:
        SceneError: If there is no shape for its type.
    """
    if isinstance(obstacle, Sphere):
        return coal.Sphere(obstacle.radius)
    if isinstance(obstacle, Box):
        return coal.Box(*obstacle.size)
    if isinstance(obstacle, Cylinder):
        return coal.Cylinder(obstacle.radius, obstacle.length)
    if isinstance(obstacle, Capsule):
        return coal.Capsule(obstacle.radius, obstacle.length)
    raise SceneError(
        f"obstacle {obstacle.name!r}: there is no collision shape for a "
        f"{type(obstacle).__name__}",
        obstacle.name,
    )


def _convex(geometry: Any) -> Any:
    """Convex hull of a mesh; other shapes as they are."""
    if not isinstance(geometry, coal.BVHModelBase):
        return geometry
    if geometry.convex is None:  # else it was made for an earlier checker
        vertices = np.array(geometry.vertices(), dtype=np.float64)
        points = _thickened(vertices)
        if len(points) > len(vertices):
            return _hull(points)
        # Not buildConvexRepresentation: it takes a mesh with dents for convex as it
        # is, and the distances come out too large.
        geometry.buildConvexHull(True, "Qt")
    return geometry.convex


def _hull(points: Array) -> coal.ConvexBase:
    vector = coal.StdVec_Vec3s()
    for point in points:
        vector.append(point)
    return coal.Convex.convexHull(vector, True, "Qt")


def _thickened(points: Array) -> Array:
    """Points of a mesh, with copies to both sides of it if it is flat."""
    centred = points - points.mean(axis=0)
    axes = np.linalg.eigh(centred.T @ centred)[1].T
    extents = np.ptp(points @ axes.T, axis=0)
    for axis in axes[extents < THINNEST]:
        shift = 0.5 * THINNEST * axis
        points = np.concatenate([points - shift, points + shift])
    return points


def _geometry_model(bodies: list[Body], links: int) -> pin.GeometryModel:
    """Pair each of the first bodies, which are links, with each of the others."""
    with_cylinders = any(isinstance(body[2], coal.Cylinder) for body in bodies)
    model = pin.GeometryModel()
    for index, (joint, placement, shape) in enumerate(bodies):
        if with_cylinders and isinstance(shape, coal.Sphere):
            # Coal measures the depth of a ball in a cylinder to the side only.
            shape = coal.Capsule(shape.radius, 0.0)
        # By number, as a link and an obstacle may have the same name.
        model.addGeometryObject(pin.GeometryObject(str(index), joint, placement, shape))
    for index in range(links, len(bodies)):
        for link in range(links):
            model.addCollisionPair(pin.CollisionPair(link, index))
    return model


class CollisionChecker:
    """Distances of the links of a robot to the obstacles of a scene.

    A query begins where the one before it ended, which is faster along a motion; the
    answers depend on former queries within the tolerances above.

    Attributes:
        robot: The robot.
        scene: The obstacles.
        pairs: Names (link, obstacle) of the pairs that are watched; a link has a pair
            for each of its shapes.
    """

    def __init__(self, robot: Robot, scene: Scene) -> None:
        self.robot, self.scene = robot, scene
        names: list[str] = []
        bodies: list[Body] = []
        for item in robot.collision_model.geometryObjects if len(scene) else []:
            if item.parentJoint == 0:
                continue  # what does not move cannot be steered clear
            names.append(robot.model.frames[item.parentFrame].name)
            bodies.append((item.parentJoint, item.placement, _convex(item.geometry)))
        links = len(bodies)
        if len(scene) and not links:
            raise SceneError(
                f"the robot {robot.name!r} has no collision geometry on its moving "
                "links, so that its clearance from the scene cannot be told"
            )
        for obstacle in scene:
            names.append(obstacle.name)
            placement = pin.SE3(obstacle.rotation, obstacle.position)
            bodies.append((0, placement, obstacle_shape(obstacle)))
        self._geometry = _geometry_model(bodies, links)
        self._geometry_data = self._geometry.createData()
        self._data = robot.model.createData()
        for request in self._geometry_data.distanceRequests:
            request.gjk_tolerance = GJK_TOLERANCE
            request.epa_tolerance = EPA_TOLERANCE
        self.pairs: tuple[tuple[str, str], ...] = tuple(
            (names[pair.first], names[pair.second])
            for pair in self._geometry.collisionPairs
        )

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle without the geometry, which is built again."""
        return type(self), (self.robot, self.scene)

    def distances(self, q: Array) -> Array:
        """Signed distances at configurations.

        Args:
            q: Configurations, shape (m, n) [rad or m].

        Returns:
            Distances [m], shape (m, number of pairs).
        """
        out = np.empty((q.shape[0], len(self.pairs)))
        if not self.pairs:
            return out
        for i, row in enumerate(self.robot.expand(q)):
            out[i] = self._query(row)
        return out

    def _query(self, q_model: Array) -> Array:
        geometry, data = self._geometry, self._geometry_data
        pin.computeDistances(self.robot.model, self._data, geometry, data, q_model)
        distances = np.array([r.min_distance for r in data.distanceResults])
        for index in np.flatnonzero(np.abs(distances) > FAILED).tolist():
            distances[index] = self._query_loosely(index)
        return distances

    def _query_loosely(self, index: int) -> float:
        """Distance of a pair that failed, with the tolerances that Coal takes."""
        geometry, data = self._geometry, self._geometry_data
        request, default = data.distanceRequests[index], coal.DistanceRequest()
        request.gjk_tolerance = default.gjk_tolerance
        request.epa_tolerance = default.epa_tolerance
        result = pin.computeDistance(geometry, data, index)
        request.gjk_tolerance = GJK_TOLERANCE
        request.epa_tolerance = EPA_TOLERANCE
        return float(result.min_distance)

    def gradients(self, q: Array, pairs: IntArray) -> Array:
        r"""Gradients of some distances at one configuration.

        With the witness points p1, p2 and the unit normal n from the first body to the
        second, :math:`d_q = n^T (J_2(p_2) - J_1(p_1))`. In penetration and at contact
        the normal stays defined, so that the gradient is finite there too.

        Args:
            q: Configuration, shape (n,) [rad or m].
            pairs: Indices of the pairs, shape (k,).

        Returns:
            Gradients, shape (k, n) [m/rad or m/m].
        """
        model, data = self.robot.model, self._data
        row = self.robot.expand(q)
        pin.computeJointJacobians(model, data, row)
        self._query(row)
        out = np.zeros((pairs.size, model.nv))
        for i, index in enumerate(pairs):
            pair = self._geometry.collisionPairs[int(index)]
            result = self._geometry_data.distanceResults[int(index)]
            normal = self._normal(int(index))
            for body, point, sign in (
                (pair.first, result.getNearestPoint1(), -1.0),
                (pair.second, result.getNearestPoint2(), 1.0),
            ):
                joint = self._geometry.geometryObjects[body].parentJoint
                if joint == 0:
                    continue
                jacobian = pin.getJointJacobian(
                    model, data, joint, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
                )
                arm = point - data.oMi[joint].translation
                # n . (v + w x r) = n . v + (r x n) . w
                out[i] += sign * (
                    normal @ jacobian[:3] + np.cross(arm, normal) @ jacobian[3:]
                )
        return self.robot.reduce_tangent(out)

    def _normal(self, index: int) -> Array:
        """Unit normal of a pair after a query, from the link to the obstacle."""
        normal = np.asarray(self._geometry_data.distanceResults[index].normal)
        if np.linalg.norm(normal) > 0.5:
            return normal
        # Coal has none for axes that cross. Parting the centres will end the overlap.
        pair = self._geometry.collisionPairs[index]
        first, second = (
            self._geometry_data.oMg[body].translation
            for body in (pair.first, pair.second)
        )
        length = np.linalg.norm(second - first)
        if length < 1e-9:
            return np.array([1.0, 0.0, 0.0])
        return np.asarray((second - first) / length)

    def closest(self, q: Array) -> Contact | None:
        """The pair with the smallest distance at one configuration; None without pairs.

        Args:
            q: Configuration, shape (n,) [rad or m].
        """
        if not self.pairs:
            return None
        row = self.distances(q[None])[0]
        index = int(np.argmin(row))
        return Contact(*self.pairs[index], float(row[index]))
