"""Decomposition cache: convex pieces on disk, keyed by the content of the mesh."""

from __future__ import annotations

import hashlib
import logging
import os
import time
import zipfile
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from tominpmp.arrays import Array
from tominpmp.collision import decomposition
from tominpmp.collision.shapes import hull_of
from tominpmp.description.paths import write_file
from tominpmp.exceptions import ScenarioError, brief
from tominpmp.stopping import Stop

logger = logging.getLogger(__name__)

# Environment variable that names a folder to use instead of the user's cache folder.
FOLDER_VARIABLE = "TOMINPMP_CACHE"
# Version of the decomposition algorithm; changing it invalidates the cache.
VERSION = 3
# Largest size of a cache file, before and after decompression [bytes].
MAX_BYTES = 20_000_000


def cache_folder() -> Path:
    """Folder of the cache."""
    given = os.environ.get(FOLDER_VARIABLE)
    if given:
        # Unlike Path.expanduser, this does not fail for the home of an unknown user.
        return Path(os.path.expanduser(given))
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "tominpmp"


@dataclass(frozen=True)
class Content:
    """A mesh that is known by its content.

    Attributes:
        key: Hash of its vertices and triangles.
        mesh: The mesh, for Coal.
        name: Name of its link or obstacle; empty if the name is not known.
    """

    key: str
    mesh: Any = field(compare=False)
    name: str = field(compare=False)


def pieces_of(mesh: Any, name: str = "") -> tuple[Any, ...]:
    """Convex pieces of a mesh of Coal, from the cache if it was decomposed before.

    Returns:
        The pieces, for Coal; empty if the mesh is flat, or close to its hull.
    """
    content = hashlib.sha256(f"tominpmp pieces {VERSION}".encode())
    content.update(np.ascontiguousarray(mesh.vertices(), np.float64).tobytes())
    for index in range(mesh.num_tris):
        triangle = mesh.tri_indices(index)
        content.update(b"%d %d %d " % (triangle[0], triangle[1], triangle[2]))
    return _known_pieces(Content(content.hexdigest(), mesh, name), cache_folder())


# Cached in memory, too: a mesh that cannot be stored on disk is decomposed only once.
@lru_cache(maxsize=256)
def _known_pieces(content: Content, folder: Path) -> tuple[Any, ...]:
    path = folder / f"{content.key}.npz"
    corners = _read(path) or _decomposed(content, path)
    return tuple(map(hull_of, corners)) if len(corners) > 1 else ()


def _decomposed(content: Content, path: Path) -> list[Array]:
    """Corners of the pieces of a mesh, written to a file; empty if it is flat."""
    what = f"the mesh of {brief(content.name)}" if content.name else "a mesh"
    logger.info(
        "%s (%d triangles) is cut into convex pieces, once: they are kept in %s",
        what,
        content.mesh.num_tris,
        path.parent,
    )
    begin = time.perf_counter()
    try:
        pieces = decomposition.decompose(content.mesh)
    except Stop as stop:
        stop.prevented = (
            f"{what} was being cut into convex pieces, once; meshes that are cut are "
            "kept, and the next plan begins with this one, which may need more "
            f"planning time, or fewer than its {content.mesh.num_tris} triangles"
        )
        raise
    if pieces:
        seconds, count = time.perf_counter() - begin, len(pieces)
        logger.info("%s became %d convex pieces in %.1f s", what, count, seconds)
        _write(path, pieces)
    return pieces


def _read(path: Path) -> list[Array]:
    """Corners of pieces from a file; empty if the file is missing or damaged."""
    try:
        if not path.is_file() or path.stat().st_size > MAX_BYTES:
            return []
        with zipfile.ZipFile(path) as archive:
            if sum(item.file_size for item in archive.infolist()) > MAX_BYTES:
                raise ValueError(f"it is larger than {MAX_BYTES} bytes")
        with np.load(path, allow_pickle=False) as data:
            content = dict(data)
        checksum = content.pop("checksum")
        points, counts = content["points"], content["counts"]
    except Exception as error:  # a damaged file may raise any exception
        logger.warning("the cached pieces %s cannot be read: %s", path, brief(error))
        return []
    if bytes(checksum.tobytes()) != _checksum(*content.values()):
        logger.warning("the cached pieces %s are invalid", path)
        return []
    return np.split(points, np.cumsum(counts)[:-1])


def _checksum(*parts: Any) -> bytes:
    """Digest of arrays, their shapes and their types."""
    digest = hashlib.sha256()
    for part in parts:
        digest.update(f"{part.dtype.str} {part.shape} ".encode())
        digest.update(np.ascontiguousarray(part).tobytes())
    return digest.digest()


def _write(path: Path, pieces: list[Array]) -> None:
    """Write a file atomically; a failure is logged and ignored."""
    points = np.concatenate(pieces).astype(np.float64)
    counts = np.array([len(piece) for piece in pieces])
    content = dict[str, Any](points=points, counts=counts)
    content["checksum"] = np.frombuffer(_checksum(*content.values()), np.uint8)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_file(path, lambda file: np.savez_compressed(file, **content))
    except (OSError, ScenarioError) as error:
        logger.warning("convex pieces cannot be kept in %s: %s", path.parent, error)
