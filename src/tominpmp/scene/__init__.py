"""Obstacles, at rest or moving: plain data, no geometry library.

Poses are given in the world frame [m]; rotations as a 3x3 matrix or a quaternion in the
order x, y, z, w.
"""

from __future__ import annotations

from tominpmp.scene.grids import HeightField, OcTree
from tominpmp.scene.meshes import Mesh
from tominpmp.scene.motion import ConstantVelocity, Motion, PoseFunction, Waypoints
from tominpmp.scene.obstacles import Box, Capsule, Cylinder, Obstacle, Sphere
from tominpmp.scene.rotations import is_rotation, rotation_matrix
from tominpmp.scene.scene import Scene

__all__ = [
    "Box",
    "Capsule",
    "ConstantVelocity",
    "Cylinder",
    "HeightField",
    "Mesh",
    "Motion",
    "Obstacle",
    "OcTree",
    "PoseFunction",
    "Scene",
    "Sphere",
    "Waypoints",
    "is_rotation",
    "rotation_matrix",
]
