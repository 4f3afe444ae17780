"""The bodies that distances are measured between: links first, then the rest."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import pinocchio as pin

from tominpmp.collision.shapes import convex_hull, is_mesh, obstacle_shape
from tominpmp.robot import Robot
from tominpmp.scene import Scene

Geometry = Literal["convex", "mesh"]


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid shape.

    Attributes:
        name: Name of the link or of the obstacle.
        joint: Index in the model of the joint that carries it; 0 for the world.
        placement: Placement body_to_joint.
        shape: Coal's shape.
        part: Which of the geometries of the robot it belongs to; -1 for obstacles.
    """

    name: str
    joint: int
    placement: pin.SE3
    shape: Any
    part: int = -1


def robot_bodies(robot: Robot, geometry: Geometry) -> list[Body]:
    """Shapes of all links, also of those that do not move.

    Args:
        robot: The robot.
        geometry: "convex" for convex pieces, "mesh" for the triangles of meshes.
    """
    bodies = []
    for part, item in enumerate(robot.collision_model.geometryObjects):
        name = robot.model.frames[item.parentFrame].name
        for shape in _pieces(item.geometry, geometry):
            bodies.append(
                Body(name, int(item.parentJoint), item.placement, shape, part)
            )
    return bodies


def _pieces(shape: Any, geometry: Geometry) -> list[Any]:
    if geometry == "convex" and is_mesh(shape):
        return [convex_hull(shape)]
    return [shape]


def scene_bodies(scene: Scene) -> list[Body]:
    """Shapes of the obstacles."""
    bodies = []
    for obstacle in scene:
        placement = pin.SE3(np.array(obstacle.rotation), np.array(obstacle.position))
        bodies.append(Body(obstacle.name, 0, placement, obstacle_shape(obstacle)))
    return bodies
