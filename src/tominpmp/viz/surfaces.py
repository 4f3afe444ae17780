"""Triangulated surfaces: the common representation of bodies in viewers and plots.

Solids of revolution, boxes, tubes and meshes all become meshes of trimesh here, so that
drawing code needs no case for each shape. The bodies of a robot are surfaces on its
joints; a surface has colours by triangle, or the colour of its body.
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
from trimesh.util import concatenate
from trimesh.visual import ColorVisuals

from tominpmp.arrays import Array, IntArray
from tominpmp.collision.bodies import obstacle_shape
from tominpmp.collision.shapes import is_mesh
from tominpmp.description.model import mesh_arrays
from tominpmp.exceptions import RobotLoadError, quiet, warn_caller
from tominpmp.robot.robot import Robot
from tominpmp.scene.grids import HeightField, OcTree
from tominpmp.scene.meshes import Mesh
from tominpmp.scene.obstacles import Obstacle

# Facets around an axis: an inscribed 40-gon is 0.3 % of the radius off a circle.
AROUND = 40

# Colour of uncoloured surfaces that are joined with coloured ones.
LIGHT = (230, 230, 230, 255)

# Least angle between triangles at a sharp edge; others are shaded smoothly [rad].
CREASE = np.radians(35.0)

# Collision geometry is not coloured; the bodies of a robot without visuals are steel.
STEEL = (0.52, 0.58, 0.66, 1.0)

UPWARDS = np.array([0.0, 0.0, 1.0])
# Largest difference between a mesh file and Pinocchio's mesh, as a share of its size.
MESH_AGREEMENT = 1e-3


# Arrays of graphics hardware by the names of three.js: "position" [m], "normal" (unit
# vectors times 127) and, with colours, "color" (0 to 255), shape (m, 3) each with a row
# for each vertex; "index" of the vertices of the triangles, shape (k, 3).
Buffers: TypeAlias = dict[str, NDArray[Any]]


def _lathe(profile: ArrayLike) -> Trimesh:
    """Surface of revolution of a profile about the z axis.

    Args:
        profile: Points with radius and height from the bottom up, shape (k, 2) [m]; the
            first and the last lie on the axis.
    """
    points = np.asarray(profile, dtype=np.float64)
    # trimesh drops triangles of less than 1e-8, whatever the size of the body.
    unit = 1e-4 * float(np.abs(points).max())
    mesh = trimesh.creation.revolve(points / unit, sections=AROUND)
    mesh.apply_scale(unit)
    return mesh


def capsule(radius: float, length: float) -> Trimesh:
    """Capsule along z about the origin; the length excludes the caps [m]."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, AROUND // 2 + 2)
    cap = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    half = np.array([0.0, length / 2])
    middle = [[radius, -length / 2], [radius, length / 2]] if length > 0.0 else []
    return _lathe([*(cap[angle < 0.0] - half), *middle, *(cap[angle >= 0.0] + half)])


def sphere(radius: float) -> Trimesh:
    """Sphere about the origin."""
    return capsule(radius, 0.0)


def cylinder(radius: float, length: float) -> Trimesh:
    """Cylinder along z about the origin."""
    half = length / 2
    return _lathe([[0.0, -half], [radius, -half], [radius, half], [0.0, half]])


def cone(radius: float, length: float) -> Trimesh:
    """Cone along z with its apex up; the origin is halfway between base and apex."""
    half = length / 2
    return _lathe([[0.0, -half], [radius, -half], [0.0, half]])


def tube(points: Array, radius: float, around: int = 8) -> Trimesh:
    """A tube along a polyline.

    Args:
        points: Points of the line, shape (m, 3) [m]; consecutive points differ.
        radius: Radius [m].
        around: Number of facets around it.
    """
    along = np.gradient(points, axis=0)
    lengths = np.linalg.norm(along, axis=1, keepdims=True)
    # Where the line turns back on itself the central difference vanishes.
    chord = np.diff(points, axis=0, append=2 * points[-1:] - points[-2:-1])
    along = np.where(lengths > 1e-12, along, chord)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    side = np.cross(along[0], np.eye(3)[np.argmin(np.abs(along[0]))])
    frames = np.empty((len(points), 2, 3))
    for i, direction in enumerate(along):
        # The side vector is transported along the line without twist.
        rest = side - direction * (side @ direction)
        if np.linalg.norm(rest) < 1e-9:
            rest = np.cross(direction, np.eye(3)[np.argmin(np.abs(direction))])
        side = rest / np.linalg.norm(rest)
        frames[i] = side, np.cross(direction, side)
    angle = np.linspace(0.0, 2.0 * np.pi, around, endpoint=False)
    circle = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    rings = points[:, None] + circle @ frames
    this = np.arange(around)
    after = np.roll(this, -1)
    # Two triangles for each facet between the first ring and the second one.
    corners = [[this, after, around + after], [this, around + after, around + this]]
    first = around * np.arange(len(points) - 1)[:, None, None, None]
    faces = first + np.array(corners).swapaxes(1, 2)
    return Trimesh(rings.reshape(-1, 3), faces.reshape(-1, 3), process=False)


def path_tube(points: Array, radius: float, size: float) -> Trimesh | None:
    """A tube along the path of a frame; None if the frame does not move.

    Args:
        points: Points of the path, which may rest, shape (m, 3) [m].
        radius: Radius as a share of the size.
        size: Size of the scene [m].
    """
    apart = np.linalg.norm(np.diff(points, axis=0), axis=1) > 1e-6 * size
    points = points[np.concatenate([[True], apart])]
    return tube(points, radius * size) if len(points) > 1 else None


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
    solid = obstacle_shape(obstacle)
    return SOLIDS[type(solid).__name__](solid)


def _prisms(corners: Array) -> Trimesh:
    """Prisms, each from four corners around the top and the four below: (k, 8, 3)."""
    faces = [[0, 1, 2], [0, 2, 3], [4, 6, 5], [4, 7, 6]]
    for here, there in ((0, 1), (1, 2), (2, 3), (3, 0)):
        faces += [[here, here + 4, there + 4], [here, there + 4, there]]
    every = 8 * np.arange(len(corners))[:, None, None] + faces
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


def triangle_colors(surface: Trimesh) -> NDArray[np.uint8] | None:
    """Colours of the triangles, 0 to 255, shape (k, 3); None for one of the body."""
    visual: Any = surface.visual
    return visual.face_colors[:, :3] if visual.kind == "face" else None


def plain(surface: Trimesh) -> Trimesh:
    """A surface without colours of its own."""
    return Trimesh(surface.vertices, surface.faces, process=False)


def shaded(surface: Trimesh) -> Buffers:
    """Buffers of a surface, with normals: smooth ones, except at sharp edges.

    Args:
        surface: The surface; its corners may be shared between triangles or not.
    """
    # Adding zero turns -0.0 into 0.0, as rows are compared by their bytes.
    exact = np.array(surface.vertices, dtype=np.float32) + np.float32(0.0)
    first, back = _distinct_rows(exact.view(np.uint8))
    points, faces = exact[first], back[surface.faces]
    corners = points[faces].astype(np.float64)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    double_area = np.linalg.norm(cross, axis=1)
    solid = double_area > 1e-9 * double_area.max(initial=0.0)
    faces, cross, double_area = faces[solid], cross[solid], double_area[solid]
    unit = cross / double_area[:, None]
    normals = _corner_normals(faces, unit, cross, np.cos(CREASE))
    parts = [
        points[faces.reshape(-1)].view(np.uint8).reshape(-1, 12),
        np.rint(127.0 * normals).astype(np.int8).view(np.uint8),
    ]
    colors = triangle_colors(surface)
    if colors is not None:
        parts.append(np.repeat(colors[solid], 3, axis=0))
    # Corners with equal position, normal and colour become one vertex.
    rows = np.concatenate(parts, axis=1)
    first, back = _distinct_rows(rows)
    distinct = rows[first]
    buffers: Buffers = {
        "position": np.ascontiguousarray(distinct[:, :12]).view(np.float32),
        "normal": np.ascontiguousarray(distinct[:, 12:15]).view(np.int8),
        "index": back.reshape(-1, 3).astype(np.uint32),
    }
    return buffers if colors is None else buffers | {"color": distinct[:, 15:18]}


def _distinct_rows(rows: NDArray[np.uint8]) -> tuple[IntArray, IntArray]:
    """Index of the first occurrence of each distinct row, and the inverse mapping."""
    words = np.pad(rows, ((0, 0), (0, -rows.shape[1] % 4))).view(np.uint32)
    unique: Any = trimesh.grouping.unique_rows
    first, back = unique(words)
    return first.astype(np.int64), back.astype(np.int64)


def _corner_normals(
    faces: IntArray, unit: Array, weighted: Array, cosine: float
) -> Array:
    """Normals of corners: averages over adjacent triangles without a sharp edge.

    Args:
        faces: Corners of the triangles, shape (k, 3).
        unit: Unit normals of the triangles, shape (k, 3).
        weighted: Normals weighted by area, shape (k, 3).
        cosine: Cosine of the least angle at a sharp edge.

    Returns:
        Unit normals, shape (3 k, 3).
    """
    count = faces.size
    owner = np.repeat(np.arange(len(faces)), 3)
    at = sparse.csr_array((np.ones(count), (np.arange(count), faces.reshape(-1))))
    # All pairs of a corner and a triangle that share a point.
    pairs = (at @ at.T).tocoo()
    corner, other = pairs.row, owner[pairs.col]
    level = np.einsum("ij,ij->i", unit[owner[corner]], unit[other]) >= cosine
    sums = sparse.csr_array(
        (level.astype(np.float64), (corner, other)), (count, len(faces))
    )
    normals = np.asarray(sums @ weighted)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.where(length > 0.0, normals / np.maximum(length, 1e-300), unit[owner])


# Solids by the names of Coal's classes, so that nothing depends on the release of Coal.
SOLIDS: dict[str, Callable[[Any], Trimesh]] = {
    "Box": lambda shape: trimesh.creation.box(2.0 * np.asarray(shape.halfSide)),
    "Sphere": lambda shape: sphere(shape.radius),
    "Capsule": lambda shape: capsule(shape.radius, 2.0 * shape.halfLength),
    "Cylinder": lambda shape: cylinder(shape.radius, 2.0 * shape.halfLength),
    "Cone": lambda shape: cone(shape.radius, 2.0 * shape.halfLength),
    "Ellipsoid": lambda shape: sphere(1.0).apply_scale(shape.radii),
}


def native_surface(geometry: Any) -> Trimesh | None:
    """Surface of a geometry of Coal in its axes; None for one of another kind.

    Half-spaces and planes, which are unbounded, have no surface here.
    """
    kind = type(geometry).__name__
    if kind in SOLIDS:
        return SOLIDS[kind](geometry)
    if is_mesh(geometry):
        return Trimesh(*mesh_arrays(geometry), process=False)
    if kind.startswith("Convex"):
        return cast("Trimesh", trimesh.convex.convex_hull(geometry.points()))
    return None


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid part of a robot.

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
        color: Colour of all bodies; None for the colour of each body.
    """
    bodies = []
    for item in model.geometryObjects:
        surface = _body_surface(item)
        if surface is None:
            continue
        red, green, blue, opacity = map(float, item.meshColor)
        shown = color or (red, green, blue, opacity)
        joint, place = int(item.parentJoint), np.array(item.placement.homogeneous)
        bodies.append(Body(item.name, joint, place, surface, shown))
    return bodies


def _body_surface(item: pin.GeometryObject) -> Trimesh | None:
    """Surface of a geometry object, with the colours in its file unless overridden."""
    surface = native_surface(item.geometry)
    if surface is None or item.overrideMaterial or not is_mesh(item.geometry):
        return surface
    colored = _colored_mesh(item.meshPath)
    if colored is None:
        return surface
    colored.apply_scale(item.meshScale)
    # Readers differ in units and axes; Pinocchio's mesh is authoritative, and colours
    # are not worth a link in the wrong place.
    apart = np.abs(surface.bounds - colored.bounds).max()
    agree = apart <= MESH_AGREEMENT * surface.extents.max()
    return colored if agree else surface


def _colored_mesh(path: str) -> Trimesh | None:
    """Read a mesh with its colours; None if it has no colours or cannot be read."""
    if Path(path).suffix.lower() not in (".dae", ".obj", ".ply", ".glb", ".gltf"):
        return None  # colours of STL files are not standard
    try:
        with quiet(Warning):  # trimesh warns of files that violate their standard
            scene: Any = trimesh.load(path, force="scene", process=False)
            parts = [mesh for mesh in scene.dump() if isinstance(mesh, Trimesh)]
            colors = [_colors(mesh) for mesh in parts]
    except Exception:  # a mesh reader may raise any error; the shape is known already
        return None
    if all(color is None for color in colors):
        return None
    for mesh, color in zip(parts, colors, strict=True):
        mesh.visual = ColorVisuals(mesh, LIGHT if color is None else color)
    return cast("Trimesh", concatenate(parts))


def _colors(mesh: Any) -> ArrayLike | None:
    """Colours of the triangles of a mesh, or the colour of all; None without any."""
    if mesh.visual.kind == "texture":
        return np.asarray(mesh.visual.material.main_color)
    return mesh.visual.face_colors if mesh.visual.kind else None


def _sticks(robot: Robot) -> list[Body]:
    """Capsules from every joint to the joints and frames that follow it."""
    model = robot.model
    ends: list[tuple[str, int, Array]] = []
    for joint in range(1, model.njoints):
        place = model.jointPlacements[joint].translation
        ends.append((str(model.names[joint]), int(model.parents[joint]), place))
    for frame in model.frames[1:]:
        if frame.type == pin.FrameType.BODY:
            place = frame.placement.translation
            ends.append((frame.name, int(frame.parentJoint), place))
    longest = max((float(np.linalg.norm(end)) for _, _, end in ends), default=0.0)
    radius = 0.02 * longest or 0.02
    bodies = []
    for name, joint, end in ends:
        length = float(np.linalg.norm(end))
        if length > 1e-6 * longest or joint:
            turn = pin.Quaternion.FromTwoVectors(UPWARDS, end).toRotationMatrix()
            surface = capsule(radius, length).apply_transform(transform(end / 2, turn))
            bodies.append(Body(f"{name}_stick", joint, np.eye(4), surface, STEEL))
    return bodies
