"""Bodies of links and of obstacles, between which distances are measured."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import coal
import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array
from tominpmp.collision.decomposition_cache import pieces_of
from tominpmp.collision.shapes import Body, convex_hull, hull_of, is_mesh
from tominpmp.description.model import triangle_mesh
from tominpmp.exceptions import SceneError
from tominpmp.scene.grids import HeightField, OcTree
from tominpmp.scene.meshes import Mesh
from tominpmp.scene.obstacles import Box, Capsule, Cylinder, Obstacle, Sphere

if TYPE_CHECKING:
    from tominpmp.robot.robot import Robot
    from tominpmp.scene.scene import Scene

# Representation of meshes: convex pieces, a single convex hull, or triangles.
Geometry = Literal["convex", "hull", "mesh"]
# Representation for each value of the option ``convex`` of an obstacle.
MESHES: dict[str, Geometry] = {"auto": "convex", "hull": "hull", "none": "mesh"}


def part_bodies(robot: Robot, part: int, geometry: Geometry) -> list[Body]:
    """Bodies of one of the collision geometries of a robot."""
    item = robot.collision_model.geometryObjects[part]
    name, joint = part_link(robot, part), int(item.parentJoint)
    shapes = _pieces(item.geometry, geometry, name)
    return [Body(name, joint, item.placement, shape) for shape in shapes]


def part_link(robot: Robot, part: int) -> str:
    """Name of the link to which one of the collision geometries of a robot belongs."""
    item = robot.collision_model.geometryObjects[part]
    return str(robot.model.frames[item.parentFrame].name)


def _pieces(shape: Any, geometry: Geometry, name: str) -> list[Any]:
    """Shapes that represent a shape; meshes as the geometry requires."""
    if geometry == "mesh" or not is_mesh(shape):
        return [shape]
    pieces = pieces_of(shape, name) if geometry == "convex" else ()
    return list(pieces) or [convex_hull(shape)]


def scene_bodies(scene: Scene, first: int) -> list[Body]:
    """Bodies of the obstacles; moving obstacles are joints from ``first`` on."""
    bodies = []
    for obstacle in scene:
        place = pin.SE3(np.array(obstacle.rotation), np.array(obstacle.position))
        joint = 0
        if obstacle.motion is not None:
            joint, place = first + scene.moving.index(obstacle), pin.SE3.Identity()
        for offset, shape in _obstacle_parts(obstacle):
            at = place * pin.SE3(np.eye(3), offset)
            bodies.append(Body(obstacle.name, joint, at, shape))
    return bodies


def _obstacle_parts(obstacle: Obstacle) -> list[tuple[Array, Any]]:
    """Shapes of which an obstacle consists, each with its position on it [m].

    Coal computes no distances to its own height fields, and no depths in its octrees;
    the convex cells of both give distances and depths.
    """
    origin = np.zeros(3)
    if isinstance(obstacle, HeightField):
        return [(origin, hull_of(corners)) for corners in obstacle.cells]
    if isinstance(obstacle, OcTree):
        return [
            (centre, coal.Box(*size))
            for centre, size in zip(*obstacle.boxes, strict=True)
        ]
    geometry = MESHES[obstacle.convex] if isinstance(obstacle, Mesh) else "mesh"
    pieces = _pieces(obstacle_shape(obstacle), geometry, obstacle.name)
    return [(origin, piece) for piece in pieces]


def obstacle_shape(obstacle: Obstacle) -> Any:
    """Shape of an obstacle for Coal.

    Raises:
        SceneError: If Coal has no shape for the type of the obstacle.
    """
    if isinstance(obstacle, Sphere):
        return coal.Sphere(obstacle.radius)
    if isinstance(obstacle, Box):
        return coal.Box(*obstacle.size)
    if isinstance(obstacle, Cylinder):
        return coal.Cylinder(obstacle.radius, obstacle.length)
    if isinstance(obstacle, Capsule):
        return coal.Capsule(obstacle.radius, obstacle.length)
    if isinstance(obstacle, Mesh):
        return triangle_mesh(obstacle.points, obstacle.triangles)
    raise SceneError(
        f"obstacle {obstacle.name!r}: there is no collision shape for a "
        f"{type(obstacle).__name__}",
        obstacle.name,
    )
