"""The exact geometry of an arm and its surroundings, read without the library.

Links are the unmodified triangle meshes of the description; scenes are MoveIt's.
"""

from __future__ import annotations

import heapq
import itertools
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import yaml
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Accuracy of the smallest clearance, except near contact [m].
CLEARANCE_TOLERANCE = 1e-4
# Larger distances are Coal's sign that an algorithm failed [m].
FAILED = 1e100
# A motion in deep contact is not measured to the end.
MAX_CONTACTS = 2000


@dataclass(frozen=True)
class Body:
    """A rigid shape.

    Attributes:
        name: Name of the link or of the obstacle.
        joint: Joint that carries it; 0 for the world.
        shape: Coal's shape: a triangle mesh or a primitive.
        placement: Its pose relative to the joint, or in the world.
    """

    name: str
    joint: int
    shape: Any
    placement: pin.SE3


@dataclass(frozen=True)
class ExactArm:
    """An arm according to its description.

    Attributes:
        model: Pinocchio model of the movable joints.
        names: Their names.
        links: Shapes of the links, meshes as triangles.
        disabled: Pairs of links that may touch, each as a frozen set.
        damping: Viscous friction, shape (n,) [N m s/rad].
    """

    model: Any
    names: tuple[str, ...]
    links: tuple[Body, ...]
    disabled: frozenset[frozenset[str]]
    damping: Array

    @classmethod
    def load(cls, urdf: Path, srdf: Path, locked: Mapping[str, float]) -> ExactArm:
        """Read an arm.

        Args:
            urdf: Its URDF file; meshes are searched in the folders above it.
            srdf: Its SRDF file.
            locked: Positions of the joints that do not move [rad or m].
        """
        folders = [str(folder) for folder in urdf.resolve().parents]
        full = pin.buildModelFromUrdf(str(urdf))
        shapes = pin.buildGeomFromUrdf(
            full, str(urdf), pin.GeometryType.COLLISION, package_dirs=folders
        )
        q = pin.neutral(full)
        for name, value in locked.items():
            q[full.joints[full.getJointId(name)].idx_q] = value
        ids = [full.getJointId(name) for name in locked]
        model, reduced = pin.buildReducedModel(full, [shapes], ids, q)
        links = tuple(
            Body(
                model.frames[item.parentFrame].name,
                item.parentJoint,
                item.geometry,
                item.placement.copy(),
            )
            for item in reduced[0].geometryObjects
        )
        names = tuple(str(name) for name in list(model.names)[1:])
        friction = {
            joint.get("name"): float(node.get("damping", "0"))
            for joint in ET.parse(urdf).getroot().iter("joint")
            for node in joint.findall("dynamics")
        }
        disabled = frozenset(
            frozenset((str(item.get("link1")), str(item.get("link2"))))
            for item in ET.parse(srdf).getroot().iter("disable_collisions")
        )
        damping = np.array([friction.get(name, 0.0) for name in names])
        return cls(model, names, links, disabled, damping)

    def vector(self, values: Mapping[str, float]) -> Array:
        """Joint positions in the order of the model."""
        return np.array([values[name] for name in self.names])


def read_obstacles(path: Path, root: str = "") -> list[Body]:
    """Read the primitives of a MoveIt planning scene.

    Args:
        path: The scene.
        root: Link in whose frame poses may be given, in addition to the world.

    Raises:
        ValueError: If the scene has shapes other than boxes, cylinders and spheres, or
            shapes in the frame of another link.
    """
    scene = yaml.load(path.read_text(encoding="utf-8"), Loader=yaml.CSafeLoader)
    bodies = []
    for item in scene["world"]["collision_objects"]:
        strange = set(item) - {"id", "header", "primitives", "primitive_poses"}
        if strange:
            raise ValueError(f"{path}: {item['id']} has {', '.join(sorted(strange))}")
        frame = item.get("header", {}).get("frame_id", root)
        if frame not in ("", root):
            raise ValueError(f"{path}: {item['id']} is in the frame of {frame}")
        for shape, pose in zip(
            item["primitives"], item["primitive_poses"], strict=True
        ):
            x, y, z, w = pose["orientation"]
            rotation = pin.Quaternion(w, x, y, z).normalized().toRotationMatrix()
            placement = pin.SE3(rotation, np.array(pose["position"], dtype=float))
            sizes = [float(value) for value in shape["dimensions"]]
            bodies.append(Body(item["id"], 0, _primitive(shape, sizes), placement))
    return bodies


def _primitive(shape: Mapping[str, Any], sizes: Sequence[float]) -> Any:
    if shape["type"] == "box":
        return coal.Box(*sizes)
    if shape["type"] == "cylinder":
        height, radius = sizes
        return coal.Cylinder(radius, height)
    if shape["type"] == "sphere":
        return coal.Sphere(*sizes)
    raise ValueError(f"there is no judge for the shape {shape['type']}")


@dataclass(frozen=True)
class Clearance:
    """The closest approach of a motion.

    Attributes:
        distance: Distance [m]; zero or negative in contact.
        first: Name of one body.
        second: Name of the other.
        sample: Number of the configuration.
        queries: Number of exact distances that were measured.
    """

    distance: float
    first: str
    second: str
    sample: int
    queries: int


class Surroundings:
    """Exact distances of an arm to obstacles and to itself.

    Args:
        arm: The arm.
        obstacles: The obstacles.
    """

    def __init__(self, arm: ExactArm, obstacles: Sequence[Body]) -> None:
        self._arm = arm
        self._data = arm.model.createData()
        self._bodies = [*arm.links, *obstacles]
        self._pairs = [
            (i, j)
            for i, j in itertools.combinations(range(len(self._bodies)), 2)
            if self._watched(self._bodies[i], self._bodies[j])
        ]
        boxes = [_local_box(body.shape) for body in self._bodies]
        self._centres = np.array([0.5 * (low + high) for low, high in boxes])
        self._halves = np.array([0.5 * (high - low) for low, high in boxes])
        self._radii = np.linalg.norm(self._halves, axis=1)
        self._first, self._second = np.array(self._pairs, dtype=int).reshape(-1, 2).T
        self._signs = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
        self._build_manager()

    @property
    def model(self) -> Any:
        """Pinocchio model of the arm."""
        return self._arm.model

    def _watched(self, one: Body, other: Body) -> bool:
        if one.joint == other.joint:
            return False  # they do not move against each other
        return frozenset((one.name, other.name)) not in self._arm.disabled

    def _place(self, q: Array) -> tuple[Array, Array]:
        """Rotations and positions of all bodies, at configurations of shape (m, n)."""
        rotations = np.empty((len(q), len(self._bodies), 3, 3))
        positions = np.empty((len(q), len(self._bodies), 3))
        for k, row in enumerate(q):
            pin.forwardKinematics(self._arm.model, self._data, row)
            for b, body in enumerate(self._bodies):
                placement = self._data.oMi[body.joint] * body.placement
                rotations[k, b] = placement.rotation
                positions[k, b] = placement.translation
        return rotations, positions

    def _lower_bounds(self, rotations: Array, positions: Array) -> Array:
        """Bounds from the ball about one body and the box about the other."""
        bounds = np.full((len(positions), len(self._pairs)), -np.inf)
        for ball, box in ((self._first, self._second), (self._second, self._first)):
            centre = positions[:, ball] + np.einsum(
                "kpij,pj->kpi", rotations[:, ball], self._centres[ball]
            )
            local = np.einsum(
                "kpji,kpj->kpi", rotations[:, box], centre - positions[:, box]
            )
            outside = np.abs(local - self._centres[box]) - self._halves[box]
            apart = np.linalg.norm(np.maximum(outside, 0.0), axis=2)
            bounds = np.maximum(bounds, apart - self._radii[ball])
        return bounds

    def _travel(self, rotations: Array, positions: Array) -> Array:
        """Largest displacement of the points of each body, shape (m, bodies).

        The displacement of a rigid body is affine in the point, so that a corner of
        the box about it has the largest one.
        """
        corners = self._centres[:, None] + self._signs * self._halves[:, None]
        world = positions[:, :, None] + np.einsum("kbij,bcj->kbci", rotations, corners)
        steps = np.linalg.norm(np.diff(world, axis=0), axis=3).max(axis=2)
        return np.concatenate([np.zeros((1, steps.shape[1])), np.cumsum(steps, axis=0)])

    def _distance(self, pair: int, rotation: Array, position: Array) -> float:
        i, j = self._pairs[pair]
        request, result = coal.DistanceRequest(), coal.DistanceResult()
        one, other = (coal.Transform3s(rotation[b], position[b]) for b in (i, j))
        shapes = self._bodies[i].shape, self._bodies[j].shape
        distance = float(
            coal.distance(shapes[0], one, shapes[1], other, request, result)
        )
        if abs(distance) > FAILED or not np.isfinite(distance):
            names = f"{self._bodies[i].name} and {self._bodies[j].name}"
            raise ArithmeticError(f"Coal found no distance between {names}")
        return distance

    def closest(self, q: Array) -> Clearance:
        """Find the smallest distance of all pairs over a motion.

        A distance at one configuration, minus the displacement of the bodies since,
        is a lower bound at the configurations before and after it; where the bound
        exceeds the smallest distance so far, no distance is measured.

        Args:
            q: Configurations along the motion, shape (m, n).
        """
        rotations, positions = self._place(q)
        bounds = self._lower_bounds(rotations, positions)
        travel = self._travel(rotations, positions)
        travel = travel[:, self._first] + travel[:, self._second]
        queue = [(float(low), p) for p, low in enumerate(bounds.min(axis=0))]
        heapq.heapify(queue)
        best, where, queries, contacts = np.inf, (0, 0), 0, 0
        while queue and contacts < MAX_CONTACTS:
            low, p = heapq.heappop(queue)
            if low >= best or (low >= best - CLEARANCE_TOLERANCE and low > 0.0):
                break
            k = int(np.argmin(bounds[:, p]))
            distance = self._distance(p, rotations[k], positions[k])
            queries += 1
            contacts += distance <= 0.0
            if distance < best:
                best, where = distance, (p, k)
            moved = np.abs(travel[:, p] - travel[k, p])
            bounds[:, p] = np.maximum(bounds[:, p], distance - moved)
            bounds[k, p] = np.inf
            heapq.heappush(queue, (float(bounds[:, p].min()), p))
        i, j = self._pairs[where[0]] if self._pairs else (0, 0)
        names = self._bodies[i].name, self._bodies[j].name
        return Clearance(best, *names, where[1], queries)

    def is_free(self, q: Array) -> bool:
        """Whether a configuration of shape (n,) is collision-free."""
        return not pin.computeCollisions(
            self._arm.model, self._data, self._manager, q, True
        )

    def _build_manager(self) -> None:
        """Make the collision test of all pairs at once, which takes microseconds."""
        geometry = pin.GeometryModel()
        for index, body in enumerate(self._bodies):
            item = pin.GeometryObject(
                str(index), body.joint, body.placement, body.shape
            )
            geometry.addGeometryObject(item)
        for i, j in self._pairs:
            geometry.addCollisionPair(pin.CollisionPair(i, j))
        self._geometry, self._geometry_data = geometry, geometry.createData()
        self._manager = pin.BroadPhaseManager_DynamicAABBTreeCollisionManager(
            self._arm.model, self._geometry, self._geometry_data
        )


def _local_box(shape: Any) -> tuple[Array, Array]:
    shape.computeLocalAABB()
    box = shape.aabb_local
    return np.array(box.min_), np.array(box.max_)
