"""Shapes of Pinocchio's geometry, written as those of a URDF file.

Shapes that no file holds, and those that URDF does not know, become meshes that the
description carries itself, as STL files.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array, IntArray
from tominpmp.description.urdf_syntax import write_numbers, write_origin
from tominpmp.exceptions import RobotLoadError, brief

# How names of meshes begin that a description carries itself.
CARRIED = "carried:"
# Corners of what is round and becomes a mesh.
CORNERS = 48

# Triangles: corners (k, 3), and indices of three of them each (m, 3).
Triangles = tuple[Array, IntArray]


def add_shapes(
    root: Element,
    tag: str,
    geometry: pin.GeometryModel,
    placed: Callable[[pin.GeometryObject], tuple[str, pin.SE3]],
    path: Path,
) -> dict[str, bytes]:
    """Add shapes to the links of a robot element.

    Args:
        root: The robot element, with its links.
        tag: "collision" or "visual".
        geometry: The shapes.
        placed: What says on which link a shape is, and where.
        path: Where they come from, for messages.

    Returns:
        Meshes that no file holds, as STL files, by their names.

    Raises:
        RobotLoadError: If a shape is none that a link can have.
    """
    links = {link.get("name", ""): link for link in root.iter("link")}
    meshes: dict[str, bytes] = {}
    for item in geometry.geometryObjects:
        name, placement = placed(item)
        link = links[name]
        element = SubElement(link, tag)
        if tag == "collision":
            element.set("name", str(len(link.findall("collision")) - 1))
        write_origin(element, placement)
        shape = SubElement(element, "geometry")
        if not _add_primitive(shape, item.geometry, link, element):
            meshes |= _add_mesh(shape, item, path)
        if tag == "visual":
            _add_colour(element, item, f"{name} {len(link.findall('visual'))}")
    return meshes


def _add_primitive(shape: Element, solid: Any, link: Element, element: Element) -> bool:
    """Add a shape that URDF knows; capsules are cylinders that are said to be some."""
    kind = type(solid).__name__
    if kind == "Box":
        size = (2.0 * np.asarray(solid.halfSide)).tolist()
        write_numbers(SubElement(shape, "box"), "size", size)
    elif kind == "Sphere":
        write_numbers(SubElement(shape, "sphere"), "radius", [solid.radius])
    elif kind in ("Cylinder", "Capsule"):
        round_one = SubElement(shape, "cylinder")
        write_numbers(round_one, "radius", [solid.radius])
        write_numbers(round_one, "length", [2.0 * solid.halfLength])
        if kind == "Capsule" and element.tag == "collision":
            checking = link.find("collision_checking")
            if checking is None:
                checking = SubElement(link, "collision_checking")
            SubElement(checking, "capsule", name=element.get("name", ""))
    else:
        return False
    return True


def _add_mesh(shape: Element, item: pin.GeometryObject, path: Path) -> dict[str, bytes]:
    """Add a mesh: the file of the shape, or what the description carries."""
    mesh = SubElement(shape, "mesh")
    kind, file = type(item.geometry).__name__, Path(item.meshPath)
    if kind.startswith("BVHModel") and item.meshPath and file.is_file():
        mesh.set("filename", str(file.absolute()))
        write_numbers(mesh, "scale", np.asarray(item.meshScale).tolist())
        return {}
    triangles = _triangles(item.geometry)
    if triangles is None:
        raise RobotLoadError(
            f"{path}: the shape {brief(item.name)} is a {kind}, expected a box, "
            "sphere, cylinder, capsule, cone, ellipsoid, mesh or convex one",
            path,
        )
    content = _stl(*triangles)
    name = f"{CARRIED}{hashlib.sha256(content).hexdigest()[:32]}.stl"
    mesh.set("filename", name)
    return {name: content}


def _add_colour(element: Element, item: pin.GeometryObject, name: str) -> None:
    from_file = bool(item.meshPath) and not item.overrideMaterial
    if not from_file:
        colour = SubElement(SubElement(element, "material", name=name), "color")
        write_numbers(colour, "rgba", np.clip(item.meshColor, 0.0, 1.0).tolist())


def _triangles(solid: Any) -> Triangles | None:
    """Triangles of a shape, which they enclose where it is round; None if unknown."""
    kind = type(solid).__name__
    if kind.startswith("BVHModel"):
        faces = [solid.tri_indices(i) for i in range(solid.num_tris)]
        return np.array(solid.vertices()), np.array([[f[0], f[1], f[2]] for f in faces])
    if kind.startswith("Convex"):
        return _hull(np.array(solid.points()))
    turn = 2.0 * np.pi * (np.arange(CORNERS) + 0.5) / CORNERS
    ring = np.stack([np.cos(turn), np.sin(turn)], axis=1) / np.cos(np.pi / CORNERS)
    if kind == "Cone":
        base = np.full((CORNERS, 1), -solid.halfLength)
        top = [[0.0, 0.0, solid.halfLength]]
        return _hull(np.vstack([np.hstack([solid.radius * ring, base]), top]))
    if kind == "Ellipsoid":
        tilt = np.linspace(0.0, np.pi, CORNERS // 2 + 1)[:, None, None]
        # Outwards, so that the faces and not the corners touch it.
        ball = np.concatenate(
            [
                np.sin(tilt) * ring,
                np.broadcast_to(np.cos(tilt), (tilt.size, CORNERS, 1)),
            ],
            axis=2,
        ).reshape(-1, 3)
        ball /= np.cos(np.pi / CORNERS)
        return _hull(ball * np.asarray(solid.radii))
    return None


def _hull(points: Array) -> Triangles:
    """Triangles of the convex hull of points."""
    from scipy.spatial import ConvexHull

    hull = ConvexHull(points)
    corners = points[hull.simplices]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = np.einsum("ij,ij->i", normals, hull.equations[:, :3]) < 0.0
    faces = hull.simplices.astype(np.int64)
    faces[inward] = faces[inward][:, ::-1]
    return points, faces


def _stl(corners: Array, faces: IntArray) -> bytes:
    """A binary STL file of triangles."""
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("z", "<u2")])
    rows = np.zeros(len(faces), dtype=record)
    rows["corners"] = corners[faces]
    return bytes(80) + len(faces).to_bytes(4, "little") + bytes(rows.tobytes())
