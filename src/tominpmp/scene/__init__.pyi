"""Where the names of the package are; read by type checkers and at import."""

from .grids import (
    HeightField as HeightField,
    OcTree as OcTree,
)
from .meshes import Mesh as Mesh
from .motion import (
    ConstantVelocity as ConstantVelocity,
    Motion as Motion,
    PoseFunction as PoseFunction,
    Waypoints as Waypoints,
)
from .obstacles import (
    Box as Box,
    Capsule as Capsule,
    Cylinder as Cylinder,
    Obstacle as Obstacle,
    Sphere as Sphere,
)
from .rotations import (
    is_rotation as is_rotation,
    rotation_matrix as rotation_matrix,
)
from .scene import Scene as Scene
