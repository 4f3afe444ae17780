"""Distances between a robot and its surroundings, by Coal.

Distances are signed: negative in penetration, where the value is the depth. Meshes of the
links are replaced by their convex hulls, which makes a query about a hundred times faster.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array, IntArray
from tominpmp.exceptions import SceneError
from tominpmp.robot import Robot
from tominpmp.scene import Box, Capsule, Cylinder, Obstacle, Scene, Sphere


class Contact(NamedTuple):
    """The pair that comes closest in a configuration.

    Attributes:
        link: Name of the link's collision geometry.
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
    if isinstance(geometry, coal.BVHModelBase):
        geometry.buildConvexRepresentation(False)
        return geometry.convex
    return geometry


class CollisionChecker:
    """Distances of the links of a robot to the obstacles of a scene.

    Attributes:
        robot: The robot.
        scene: The obstacles.
        pairs: Names (link geometry, obstacle) of the pairs that are watched.
    """

    def __init__(self, robot: Robot, scene: Scene) -> None:
        self.robot, self.scene = robot, scene
        model = pin.GeometryModel()
        for item in robot.collision_model.geometryObjects if len(scene) else []:
            if item.parentJoint == 0:
                continue  # what does not move cannot be steered clear
            model.addGeometryObject(
                pin.GeometryObject(
                    item.name, item.parentJoint, item.placement, _convex(item.geometry)
                )
            )
        links = model.ngeoms
        for obstacle in scene:
            placement = pin.SE3(obstacle.rotation, obstacle.position)
            index = model.addGeometryObject(
                pin.GeometryObject(obstacle.name, 0, placement, obstacle_shape(obstacle))
            )
            for link in range(links):
                model.addCollisionPair(pin.CollisionPair(link, index))
        self._geometry = model
        self._geometry_data = model.createData()
        self._data = robot.model.createData()
        names = [item.name for item in model.geometryObjects]
        self.pairs: tuple[tuple[str, str], ...] = tuple(
            (names[pair.first], names[pair.second]) for pair in model.collisionPairs
        )
        if len(scene) and not links:
            raise SceneError(
                f"the robot {robot.name!r} has no collision geometry on its moving "
                "links, so that its clearance from the scene cannot be told"
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
            self._query(row)
            out[i] = [r.min_distance for r in self._geometry_data.distanceResults]
        return out

    def _query(self, q_model: Array) -> None:
        pin.computeDistances(
            self.robot.model, self._data, self._geometry, self._geometry_data, q_model
        )

    def gradients(self, q: Array, pairs: IntArray) -> Array:
        r"""Gradients of some distances at one configuration.

        With the witness points p1, p2 and the unit normal n from the first body to the
        second, :math:`d_q = n^T (J_2(p_2) - J_1(p_1))`. In penetration and at contact the
        normal stays defined, so that the gradient is finite there too.

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
                normal = np.asarray(result.normal)
                out[i] += sign * (
                    normal @ jacobian[:3] + np.cross(arm, normal) @ jacobian[3:]
                )
        return self.robot.reduce_tangent(out)

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
