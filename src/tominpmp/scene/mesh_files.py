"""Reading triangle meshes from files: STL and OBJ, others by trimesh."""

from __future__ import annotations

import struct
import warnings
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from tominpmp.arrays import Array, IntArray

# A mesh with more would take minutes and gigabytes [bytes].
MAX_BYTES = 200_000_000
STL_HEADER = 84
STL_TRIANGLE = 50


class MeshFileError(ValueError):
    """A file is no mesh that can be read; the message says why."""


def read_mesh(path: Path) -> tuple[Array, IntArray]:
    """Read a mesh.

    Args:
        path: STL or OBJ file, or another that the package trimesh knows.

    Returns:
        Vertices, shape (k, 3), in the units of the file, and corners of the triangles,
        shape (l, 3).

    Raises:
        MeshFileError: If it cannot be read.
    """
    try:
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise MeshFileError(f"it has {size} bytes, more than {MAX_BYTES}")
        data = path.read_bytes()
    except OSError as error:
        raise MeshFileError(error.strerror or str(error)) from error
    suffix = path.suffix.lower()
    if suffix == ".stl":
        return _read_stl(data)
    if suffix == ".obj":
        return _read_obj(data)
    return _read_other(path)


def _read_stl(data: bytes) -> tuple[Array, IntArray]:
    if len(data) >= STL_HEADER:
        count = struct.unpack("<I", data[80:STL_HEADER])[0]
        if len(data) == STL_HEADER + STL_TRIANGLE * count:
            kind = np.dtype([("normal", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])
            table = np.frombuffer(data, kind, count, STL_HEADER)
            return _merged(table["v"].astype(np.float64).reshape(-1, 3))
    if not data.lstrip().startswith(b"solid"):
        raise MeshFileError(
            "it is no STL file: it neither begins with 'solid' nor has as many bytes "
            "as a binary one with its number of triangles"
        )
    numbers = []
    for number, line in enumerate(data.splitlines(), 1):
        words = line.split()
        if words and words[0] == b"vertex":
            numbers.append(_floats(words[1:4], number))
    if len(numbers) % 3:
        raise MeshFileError("the number of vertices is not a multiple of three")
    return _merged(np.array(numbers, dtype=np.float64).reshape(-1, 3))


def _merged(points: Array) -> tuple[Array, IntArray]:
    vertices, corners = np.unique(points, axis=0, return_inverse=True)
    return vertices, corners.reshape(-1, 3).astype(np.int64)


def _floats(words: list[bytes], number: int) -> list[float]:
    try:
        found = [float(word) for word in words]
    except ValueError:
        found = []
    if len(found) != 3:
        raise MeshFileError(f"line {number}: expected three numbers")
    return found


def _read_obj(data: bytes) -> tuple[Array, IntArray]:
    vertices: list[list[float]] = []
    triangles: list[tuple[int, int, int]] = []
    for number, line in enumerate(data.splitlines(), 1):
        words = line.split()
        if not words:
            continue
        if words[0] == b"v":
            vertices.append(_floats(words[1:4], number))
        elif words[0] == b"f":
            try:
                corners = [int(word.split(b"/")[0]) for word in words[1:]]
            except ValueError as error:
                raise MeshFileError(f"line {number}: a corner is no number") from error
            face = [c - 1 if c > 0 else len(vertices) + c for c in corners]
            if len(face) < 3:
                raise MeshFileError(f"line {number}: a face has three corners or more")
            if not all(0 <= corner < len(vertices) for corner in face):
                raise MeshFileError(f"line {number}: there is no such vertex")
            triangles += [(face[0], a, b) for a, b in pairwise(face[1:])]
    return (
        np.array(vertices, dtype=np.float64).reshape(-1, 3),
        np.array(triangles, dtype=np.int64).reshape(-1, 3),
    )


def _read_other(path: Path) -> tuple[Array, IntArray]:
    try:
        import trimesh
    except ImportError as error:
        raise MeshFileError(
            f"files ending in {path.suffix or 'nothing'} need the package 'trimesh': "
            "python -m pip install 'tominpmp[viz]'"
        ) from error
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of files that break their standard
            mesh: Any = trimesh.load(path, force="mesh", process=False)
            vertices = np.array(mesh.vertices, dtype=np.float64)
            return vertices, np.array(mesh.faces, dtype=np.int64)
    except Exception as error:  # whatever a mesh reader may raise
        raise MeshFileError(" ".join(str(error).split()) or repr(error)) from error
