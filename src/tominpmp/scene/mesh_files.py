"""Reading of triangle meshes from files: STL and OBJ, other formats by trimesh.

Files come from downloads, so they are read in bounded time and memory: the size of a
file and the numbers of vertices and triangles are limited, and archives are refused.

STL and OBJ files are read here, because an incomplete obstacle is worse than an error.
trimesh silently drops a truncated solid, does not say which line is wrong, splits
vertices at the seams of textures, and takes six times the size of a file in memory
instead of three; it is four times as fast.
"""

from __future__ import annotations

import re
from array import array
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from tominpmp.arrays import Array, IntArray, to_number
from tominpmp.description.mesh_sizes import check_expanded
from tominpmp.description.paths import read_bytes
from tominpmp.exceptions import ProblemError, quiet

# Largest mesh: a larger one would take minutes and gigabytes, also in a collision
# checker.
MAX_BYTES = 100_000_000
MAX_TRIANGLES = 1_000_000
# Largest file of a format that other packages read: they need a multiple of its size.
MAX_OTHER_BYTES = 20_000_000
OTHERS = (".dae", ".glb", ".gltf", ".off", ".ply")
# Magic bytes of archives: a small archive may hold any amount of data.
ARCHIVES = (b"PK", b"\x1f\x8b", b"BZh", b"\xfd7zXZ", b"7z\xbc\xaf", b"Rar!")
# Largest length of a line of a mesh file [bytes].
LONGEST_LINE = 100_000
# Matches lines that are not empty, as there may be millions of empty lines.
_LINE = re.compile(rb"[^\s][^\r\n]*")
# Corner of a face in an OBJ file: a vertex, and its texture and normal, if it has any.
_CORNER = re.compile(rb"([-+]?[0-9]{1,18})(/.*)?")
STL_HEADER = 84
STL_TRIANGLE = 50


def read_mesh(path: Path) -> tuple[Array, IntArray]:
    """Read a mesh.

    Returns:
        Vertices, shape (k, 3), in the units of the file, and vertex indices of the
        triangles, shape (l, 3).

    Raises:
        ProblemError: If the file cannot be read; the message has the reason.
    """
    suffix = path.suffix.lower()
    largest = MAX_BYTES if suffix in (".stl", ".obj") else MAX_OTHER_BYTES
    data = read_bytes(path, largest, lambda message, _: ProblemError(message))
    # A binary STL file begins with any text.
    binary = suffix == ".stl" and len(data) == _binary_size(data)
    if data.startswith(ARCHIVES) and not binary:
        raise ProblemError("it is an archive, expected a mesh")
    if suffix == ".stl":
        return _read_stl(data)
    if suffix == ".obj":
        return _read_obj(data)
    return _read_other(path, suffix, data)


def _read_stl(data: bytes) -> tuple[Array, IntArray]:
    """Read an STL file, binary or text."""
    if len(data) == _binary_size(data):
        _check_count((len(data) - STL_HEADER) // STL_TRIANGLE)
        kind = np.dtype([("normal", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])
        table = np.frombuffer(data, kind, offset=STL_HEADER)
        return _merged(table["v"].astype(np.float64).reshape(-1, 3))
    if not data.lstrip().startswith(b"solid"):
        raise ProblemError(
            "it is not an STL file: it neither begins with 'solid' nor has the size "
            "of a binary STL file with its number of triangles"
        )
    numbers = array("d")
    for line, words in _lines(data):
        if words[0] == b"vertex":
            numbers.extend(_floats(words[1:4], line))
            _check_count(len(numbers) // 9)
    if len(numbers) % 9:
        raise ProblemError("the number of vertices is not a multiple of three")
    return _merged(np.array(numbers, dtype=np.float64).reshape(-1, 3))


def _binary_size(data: bytes) -> int:
    """Size of a binary STL file with the number of triangles that its header gives."""
    return STL_HEADER + STL_TRIANGLE * int.from_bytes(data[80:STL_HEADER], "little")


def _lines(data: bytes) -> Iterator[tuple[re.Match[bytes], list[bytes]]]:
    """Each line that is not empty, as a match, and its words."""
    for line in _LINE.finditer(data):
        if line.end() - line.start() > LONGEST_LINE:
            raise ProblemError(f"{_named(line)} is longer than {LONGEST_LINE} bytes")
        yield line, line.group().split()


def _named(line: re.Match[bytes]) -> str:
    """Name a line by its number, which is only counted for a message."""
    number = line.string.count(b"\n", 0, line.start()) + 1
    return f"line {number}"


def _check_count(triangles: int) -> None:
    """Check the number of triangles."""
    if triangles > MAX_TRIANGLES:
        raise ProblemError(f"it has more than {MAX_TRIANGLES} triangles")


def _merged(points: Array) -> tuple[Array, IntArray]:
    """Vertices and triangles from the corners of all triangles, shape (3 l, 3)."""
    vertices, corners = np.unique(points, axis=0, return_inverse=True)
    return vertices, corners.reshape(-1, 3).astype(np.int64)


def _floats(words: list[bytes], line: re.Match[bytes]) -> list[float]:
    """Three numbers of a line."""
    try:
        numbers = [to_number(word.decode("ascii")) for word in words]
    except ValueError:
        numbers = []
    if len(numbers) != 3:
        raise ProblemError(f"{_named(line)}: expected three numbers")
    return numbers


def _read_obj(data: bytes) -> tuple[Array, IntArray]:
    """Read an OBJ file; faces with more than three corners become triangle fans."""
    vertices, corners = array("d"), array("q")
    for line, words in _lines(data):
        if words[0] == b"v":
            vertices.extend(_floats(words[1:4], line))
            # A triangle has at most three vertices, so that more are too many.
            _check_count(len(vertices) // 9)
        elif words[0] == b"f":
            face = _face(words[1:], len(vertices) // 3, line)
            for a, b in pairwise(face[1:]):
                corners.extend((face[0], a, b))
            _check_count(len(corners) // 3)
    return (
        np.array(vertices, dtype=np.float64).reshape(-1, 3),
        np.array(corners, dtype=np.int64).reshape(-1, 3),
    )


def _face(words: list[bytes], vertices: int, line: re.Match[bytes]) -> list[int]:
    """Vertex indices of the corners of a face, which refers to earlier vertices."""
    corners = [_CORNER.fullmatch(word) for word in words]
    if not all(corners):
        raise ProblemError(f"{_named(line)}: a corner is not a whole number")
    numbers = (int(corner[1]) for corner in corners if corner)
    face = [c - 1 if c > 0 else vertices + c for c in numbers]
    if len(face) < 3:
        raise ProblemError(f"{_named(line)}: expected a face of three corners or more")
    if not all(0 <= corner < vertices for corner in face):
        fault = "a corner refers to a vertex that is not defined"
        raise ProblemError(f"{_named(line)}: {fault}")
    return face


def _read_other(path: Path, suffix: str, data: bytes) -> tuple[Array, IntArray]:
    """Read a file of another format by trimesh."""
    if suffix not in OTHERS:
        known = ", ".join((".stl", ".obj", *OTHERS))
        raise ProblemError(
            f"meshes are not read from {path.suffix or 'files without ending'}; there "
            f"are: {known}"
        )
    import trimesh  # heavy, and few scenes need it

    try:
        check_expanded(path, data)
        with quiet(Warning):  # trimesh warns of files that violate their standard
            options: Any = {"process": False, "skip_materials": True}
            mesh = trimesh.load_scene(path, **options).to_mesh()
            _check_count(max(len(mesh.faces), len(mesh.vertices) // 3))
            vertices = np.array(mesh.vertices, dtype=np.float64)
            return vertices, np.array(mesh.faces, dtype=np.int64)
    except Exception as error:  # whatever a mesh reader may raise
        raise ProblemError(" ".join(str(error).split()) or repr(error)) from error
