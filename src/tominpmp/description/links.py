"""The links of a description as every parser reads them: with meshes that are there."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tominpmp.description.files import resolve_resource
from tominpmp.description.xml_reader import XmlContext
from tominpmp.exceptions import shortened, warn_caller

# A mesh beyond this would take minutes and gigabytes.
MAX_MESH_BYTES = 512 * 2**20
# Characters of a path that a message shows.
LONGEST_PATH = 400

# Finds a file that a description refers to: the file, and the paths tried.
Finder = Callable[[str], tuple[Path | None, tuple[Path, ...]]]


def simplified_links(
    links: Sequence[Any], context: XmlContext, folders: Sequence[Path]
) -> list[Any]:
    """Make links of yourdfpy such that every parser reads them in the same way.

    Meshes to look at that are not there are left out, with a warning: motions are the
    same without them. Those to collide with have to be there.

    Raises:
        RobotLoadError: If a mesh to collide with is not there, or one is too large.
    """
    unseen: list[str] = []

    def find(name: str) -> tuple[Path | None, tuple[Path, ...]]:
        return resolve_resource(name, context.path, folders)

    found = [_simplified_link(link, context, find, unseen) for link in links]
    if unseen:
        more = f" and {len(unseen) - 1} more" if len(unseen) > 1 else ""
        warn_caller(
            f"{context.path}: not shown, as their meshes are not there: {unseen[0]}"
            f"{more}; folders that hold packages are given in package_dirs"
        )
    return found


def _simplified_link(
    link: Any, context: XmlContext, find: Finder, unseen: list[str]
) -> Any:
    """One link; its visual meshes that are not there are told in ``unseen``."""
    inertial = link.inertial
    if inertial is not None and inertial.inertia is None:
        inertial = replace(inertial, inertia=np.zeros((3, 3)))
    collisions, visuals = [], []
    for i, shape in enumerate(link.collisions):
        where = f"link {link.name}, collision {i + 1}"
        geometry = _with_file(shape.geometry, where, context, find)
        collisions.append(replace(shape, name=str(i), geometry=geometry))
    for i, shape in enumerate(link.visuals):
        where, mesh = f"link {link.name}, visual {i + 1}", shape.geometry.mesh
        if mesh is not None and find(mesh.filename)[0] is None:
            unseen.append(f"{where} ({shortened(repr(mesh.filename))})")
            continue
        geometry = _with_file(shape.geometry, where, context, find)
        # Parsers take materials of one name for the same, whatever their colours.
        material = _with_texture(shape.material, f"{link.name} {i}", find)
        visuals.append(replace(shape, name=None, geometry=geometry, material=material))
    return replace(link, inertial=inertial, collisions=collisions, visuals=visuals)


def _with_file(geometry: Any, where: str, context: XmlContext, find: Finder) -> Any:
    """A shape; a mesh with the absolute path of its file."""
    mesh = geometry.mesh
    if mesh is None:
        return geometry
    path, tried = find(mesh.filename)
    if path is None:
        remedy = "; give the folder that holds the package in package_dirs"
        context.fail(
            f"{where}: the mesh {shortened(repr(mesh.filename))} is not there; tried "
            + ", ".join(shortened(str(place), LONGEST_PATH) for place in tried)
            + (remedy if mesh.filename.startswith(("package://", "model://")) else "")
        )
    if path.stat().st_size > MAX_MESH_BYTES:
        context.fail(f"{where}: the mesh {path} has more than {MAX_MESH_BYTES} bytes")
    return replace(geometry, mesh=replace(mesh, filename=str(path.absolute())))


def _with_texture(material: Any, name: str, find: Finder) -> Any:
    """Colour and texture; these are looks, so a texture not found is left out."""
    if material is None:
        return None
    texture = material.texture
    if texture is not None:
        path = find(texture.filename)[0]
        texture = None if path is None else replace(texture, filename=str(path))
    if material.color is None and texture is None:
        return None
    return replace(material, name=name, texture=texture)
