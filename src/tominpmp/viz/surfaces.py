"""Triangulated surfaces: the common representation of bodies in viewers and plots.

Solids of revolution, boxes, tubes and meshes all become meshes of trimesh here, so that
drawing code needs no case for each shape. The bodies of a robot are surfaces on its
joints, of one colour each.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias, cast

import numpy as np
import pinocchio as pin
import trimesh
from numpy.typing import ArrayLike, NDArray
from scipy import sparse
from trimesh import Trimesh
from trimesh.util import append_faces, concatenate

from tominpmp.arrays import Array
from tominpmp.collision.bodies import obstacle_shape
from tominpmp.collision.shapes import is_mesh
from tominpmp.description.model import mesh_arrays, stick_ends
from tominpmp.exceptions import RobotLoadError, quiet, warn_caller
from tominpmp.robot.robot import Robot
from tominpmp.scene.grids import HeightField, OcTree
from tominpmp.scene.meshes import Mesh
from tominpmp.scene.obstacles import Obstacle

# Facets around an axis: an inscribed 40-gon is 0.3 % of the radius off a circle; and
# around the path of a frame.
AROUND, FACETS = 40, 5

# Colour of uncoloured parts of coloured meshes.
LIGHT = (230, 230, 230, 255)

# Most colours of a mesh; of more colours each component is rounded to 0, 0.5 or 1.
MOST_COLORS = 32

# Least angle between triangles at a sharp edge; others are shaded smoothly [rad].
CREASE = np.radians(35.0)

# Collision geometry is not coloured; the bodies of a robot without visuals are steel.
STEEL = (0.52, 0.58, 0.66, 1.0)

# Largest difference between a mesh file and Pinocchio's mesh, as a share of its size.
MESH_AGREEMENT = 1e-3


# Arrays of graphics hardware by the names of three.js: "position" [m] and "normal"
# (unit vectors times 127) have a row for each vertex, shape (m, 3), and "index" has the
# vertices of each triangle, shape (k, 3).
Buffers: TypeAlias = dict[str, NDArray[Any]]


def _turned(
    make: Callable[..., Trimesh], radius: float, length: float, **facets: Any
) -> Trimesh:
    """A solid of revolution of trimesh about the z axis."""
    # trimesh drops triangles of less than 1e-8, whatever the size of the body.
    unit = 1e-4 * max(radius, length)
    mesh = make(radius=radius / unit, height=length / unit, **facets)
    mesh.apply_scale(unit)
    return mesh


def capsule(radius: float, length: float) -> Trimesh:
    """Capsule along z about the origin; the length excludes the caps [m]."""
    count = (AROUND // 2, AROUND)
    return _turned(trimesh.creation.capsule, radius, length, count=count)


def sphere(radius: float) -> Trimesh:
    """Sphere about the origin."""
    return capsule(radius, 0.0)


def cylinder(radius: float, length: float) -> Trimesh:
    """Cylinder along z about the origin."""
    return _turned(trimesh.creation.cylinder, radius, length, sections=AROUND)


def path_tube(points: Array, radius: float, size: float) -> Trimesh | None:
    """A tube along the path of a frame; None if the frame does not move.

    Each chord of the path is a prism: gaps at bends are smaller than the radius.

    Args:
        points: Points of the path, which may rest, shape (m, 3) [m].
        radius: Radius as a share of the size.
        size: Size of the scene [m].
    """
    chords = np.diff(points, axis=0)
    moved = np.linalg.norm(chords, axis=1) > 1e-6 * size
    begins, chords = points[:-1][moved], chords[moved]
    if not len(chords):
        return None
    side = np.cross(chords, np.eye(3)[np.argmin(np.abs(chords), axis=1)])
    across = np.stack([side, np.cross(chords, side)], axis=1)
    across /= np.linalg.norm(across, axis=2, keepdims=True)
    angle = np.linspace(0.0, 2.0 * np.pi, FACETS, endpoint=False)
    circle = radius * size * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    rings = begins[:, None] + circle @ across
    return _prisms(np.concatenate([rings + chords[:, None], rings], axis=1))


def obstacle_surface(obstacle: Obstacle) -> Trimesh:
    """Surface of an obstacle in the axes of the obstacle.

    Raises:
        SceneError: If the type of the obstacle has no shape.
    """
    if isinstance(obstacle, Mesh):
        return Trimesh(obstacle.points, obstacle.triangles, process=False)
    if isinstance(obstacle, HeightField):
        return _prisms(obstacle.cells)
    if isinstance(obstacle, OcTree):
        places = zip(*obstacle.boxes, strict=True)
        cubes = [trimesh.creation.box(size, transform(at)) for at, size in places]
        return cast("Trimesh", concatenate(cubes))
    return _native_surface(obstacle_shape(obstacle))


def _prisms(corners: Array) -> Trimesh:
    """Prisms, each from n corners around the top and the n below: (k, 2 n, 3)."""
    n = corners.shape[1] // 2
    around = [(i, (i + 1) % n) for i in range(n)]
    faces = [face for i, j in around for face in ([i, i + n, j + n], [i, j + n, j])]
    for i, j in around[1:-1]:
        faces += [[0, i, j], [n, n + j, n + i]]
    every = 2 * n * np.arange(len(corners))[:, None, None] + faces
    return Trimesh(corners.reshape(-1, 3), every.reshape(-1, 3), process=False)


def transform(position: ArrayLike, rotation: ArrayLike | None = None) -> Array:
    """Homogeneous matrices of placements.

    Args:
        position: Origins, shape (..., 3) [m].
        rotation: Rotation matrices, shape (..., 3, 3); None for the identity.

    Returns:
        Matrices, shape (..., 4, 4).
    """
    origin = np.asarray(position, dtype=np.float64)
    placements = np.tile(np.eye(4), (*origin.shape[:-1], 1, 1))
    placements[..., :3, 3] = origin
    if rotation is not None:
        placements[..., :3, :3] = rotation
    return placements


def shaded(surface: Trimesh) -> Buffers:
    """Buffers of a surface, with normals: smooth ones, except at sharp edges.

    Args:
        surface: The surface; its corners may be shared between triangles or not.
    """
    unique: Any = trimesh.grouping.unique_rows
    # Adding zero turns -0.0 into 0.0, as rows are compared by their bytes.
    exact = np.array(surface.vertices, dtype=np.float32) + np.float32(0.0)
    first, back = unique(exact.view(np.int32))
    points = exact[first]
    mesh = Trimesh(points, back[surface.faces], process=False)
    mesh.update_faces(mesh.area_faces > 1e-9 * mesh.area_faces.max(initial=0.0))
    corner = mesh.faces.reshape(-1)
    normal = np.rint(127.0 * _corner_normals(mesh)).astype(np.int8)
    # Corners with equal position and normal become one vertex.
    first, back = unique(np.column_stack([corner, normal]))
    index = back.reshape(-1, 3).astype(np.uint32)
    return {"position": points[corner[first]], "normal": normal[first], "index": index}


def _corner_normals(mesh: Trimesh) -> Array:
    """Normals of corners: averages over adjacent triangles without a sharp edge.

    Args:
        mesh: The mesh, of k triangles, none of them without an area.

    Returns:
        Unit normals, shape (3 k, 3).
    """
    corners, owner = mesh.faces.reshape(-1), np.repeat(np.arange(len(mesh.faces)), 3)
    weighted = mesh.triangles_cross  # by area
    unit = weighted / np.linalg.norm(weighted, axis=1, keepdims=True)
    at = sparse.csr_array((np.ones(owner.size), (np.arange(owner.size), corners)))
    # All pairs of a corner and a triangle that share a point.
    pairs = (at @ at.T).tocoo()
    corner, other = pairs.row, owner[pairs.col]
    level = np.einsum("ij,ij->i", unit[owner[corner]], unit[other]) >= np.cos(CREASE)
    sums = sparse.csr_array((level, (corner, other)), (owner.size, len(unit)))
    # The sum contains the own triangle, and no triangle across from it: it is not zero.
    normals = np.asarray(sums @ weighted)
    return np.asarray(normals / np.linalg.norm(normals, axis=1, keepdims=True))


# Solids by the names of Coal's classes, so that nothing depends on the release of Coal.
SOLIDS: dict[str, Callable[[Any], Trimesh]] = {
    "Box": lambda shape: trimesh.creation.box(2.0 * np.asarray(shape.halfSide)),
    "Sphere": lambda shape: sphere(shape.radius),
    "Capsule": lambda shape: capsule(shape.radius, 2.0 * shape.halfLength),
    "Cylinder": lambda shape: cylinder(shape.radius, 2.0 * shape.halfLength),
}


def _native_surface(geometry: Any) -> Trimesh:
    """Surface of a geometry of Coal in its axes.

    Descriptions of robots contain no other shapes than obstacles do: cones, ellipsoids
    and convex bodies of models and MJCF files are meshes in them.
    """
    if is_mesh(geometry):
        return Trimesh(*mesh_arrays(geometry), process=False)
    return SOLIDS[type(geometry).__name__](geometry)


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid part of a robot, of one colour.

    Attributes:
        name: Name, unique in its robot.
        joint: Index in the model of the joint that carries it; 0 for the world.
        placement: Placement body_to_joint, homogeneous, shape (4, 4).
        surface: Surface in the axes of the body.
        color: Red, green, blue and opacity from 0 to 1.
    """

    name: str
    joint: int
    placement: Array
    surface: Trimesh
    color: tuple[float, float, float, float]


def robot_bodies(robot: Robot) -> list[Body]:
    """List the bodies of a robot.

    They are its visuals, and the collision geometry of joints without visuals (or of
    all joints, if the visuals cannot be read); a robot without both has sticks from
    joint to joint.
    """
    try:
        bodies = geometry_bodies(robot.visual_model, color=None)
    except RobotLoadError as error:
        warn_caller(f"the collision geometry is shown instead: {error}")
        bodies = []
    # By joint, not by link: links for collisions only are fixed to visible links.
    seen = {body.joint for body in bodies}
    bodies += [
        body
        for body in geometry_bodies(robot.collision_model, color=STEEL)
        if body.joint not in seen
    ]
    if not any(body.joint for body in bodies):
        bodies += _sticks(robot)
    return bodies


def geometry_bodies(
    model: pin.GeometryModel, color: tuple[float, float, float, float] | None
) -> list[Body]:
    """The bodies of a model.

    Args:
        model: The model.
        color: Colour of all bodies; None for the colours in their files.
    """
    bodies = []
    for item in model.geometryObjects:
        surface = _native_surface(item.geometry)
        red, green, blue, opacity = color or map(float, item.meshColor)
        parts = [(surface, (red, green, blue))]
        if color is None and is_mesh(item.geometry) and not item.overrideMaterial:
            parts = _colored_parts(item, surface) or parts
        joint, place = int(item.parentJoint), np.array(item.placement.homogeneous)
        for number, (part, rgb) in enumerate(parts):
            name = f"{item.name}#{number}" if number else item.name
            bodies.append(Body(name, joint, place, part, (*rgb, opacity)))
    return bodies


def _colored_parts(
    item: pin.GeometryObject, surface: Trimesh
) -> list[tuple[Trimesh, tuple[float, float, float]]]:
    """Parts of a mesh by the colours in its file: red, green and blue from 0 to 1.

    Args:
        item: The mesh.
        surface: Its surface as Pinocchio reads it. Readers differ in units and axes;
            Pinocchio's mesh is authoritative, and colours are not worth a link in the
            wrong place.

    Returns:
        The parts; empty if the mesh has no colours, cannot be read, or differs.
    """
    path = item.meshPath
    if Path(path).suffix.lower() not in (".dae", ".obj", ".ply", ".glb", ".gltf"):
        return []  # colours of STL files are not standard
    try:
        with quiet(Warning):  # trimesh warns of files that violate their standard
            scene: Any = trimesh.load(path, force="scene", process=False)
            meshes: list[Any] = [m for m in scene.dump() if isinstance(m, Trimesh)]
            found = [_colors(mesh) for mesh in meshes]
    except Exception:  # a mesh reader may raise any error; the shape is known already
        return []
    if not any(mesh.visual.kind for mesh in meshes):
        return []
    vertices, faces = append_faces(
        [mesh.vertices for mesh in meshes], [mesh.faces for mesh in meshes]
    )
    whole = Trimesh(vertices, faces, process=False)
    whole.apply_scale(item.meshScale)
    apart = np.abs(surface.bounds - whole.bounds).max()
    if apart > MESH_AGREEMENT * surface.extents.max():
        return []
    shares = np.round(np.concatenate(found)[:, :3] / 255.0, 2)
    if len(np.unique(shares, axis=0)) > MOST_COLORS:
        shares = np.round(2.0 * shares) / 2.0
    shown, which = np.unique(shares, axis=0, return_inverse=True)
    triangles = [np.flatnonzero(which.ravel() == k) for k in range(len(shown))]
    parts: Any = whole.submesh(triangles)
    return list(zip(parts, map(tuple, shown.tolist()), strict=True))


def _colors(mesh: Any) -> Array:
    """Colours of the triangles of a mesh, 0 to 255, shape (k, 4)."""
    color = LIGHT
    if mesh.visual.kind == "texture":
        color = mesh.visual.material.main_color
    elif mesh.visual.kind:
        color = mesh.visual.face_colors
    return np.broadcast_to(np.asarray(color), (len(mesh.faces), 4))


def _sticks(robot: Robot) -> list[Body]:
    """Capsules from every joint to the joints and frames that follow it."""
    ends, bodies = stick_ends(robot.model), list[Body]()
    lengths = [float(np.linalg.norm(end)) for _, end in ends]
    longest = max(lengths)
    for (joint, end), length in zip(ends, lengths, strict=True):
        if length > 1e-6 * longest or joint:
            name = f"stick {len(bodies)}"
            turn = pin.Quaternion.FromTwoVectors(np.eye(3)[2], end).toRotationMatrix()
            surface = capsule(0.02 * longest or 0.02, length)
            surface.apply_transform(transform(end / 2, turn))
            bodies.append(Body(name, joint, np.eye(4), surface, STEEL))
    return bodies
