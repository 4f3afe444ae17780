"""Obstacles: plain data, no geometry library.

Poses are given in the world frame [m]; rotations as a 3x3 matrix or a quaternion in the
order x, y, z, w.
"""

from __future__ import annotations

from tominpmp.scene.grids import HeightField, OcTree
from tominpmp.scene.meshes import Mesh
from tominpmp.scene.obstacles import (
    Box,
    Capsule,
    Cylinder,
    Obstacle,
    Sphere,
    is_rotation,
    rotation_matrix,
)
from tominpmp.scene.scene import Scene

__all__ = [
    "Box",
    "Capsule",
    "Cylinder",
    "HeightField",
    "Mesh",
    "Obstacle",
    "OcTree",
    "Scene",
    "Sphere",
    "is_rotation",
    "rotation_matrix",
]
