"""Convex pieces on disk, by the content of the mesh they belong to."""

from __future__ import annotations

import hashlib
import io
import logging
import os
import tempfile
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from tominpmp.arrays import Array
from tominpmp.collision import decomposition
from tominpmp.collision.decomposition import Pieces

logger = logging.getLogger(__name__)

# Where pieces are kept instead of the user's cache folder.
FOLDER_VARIABLE = "TOMINPMP_CACHE"
# To be raised when the same mesh is cut in another way.
VERSION = 1
# Larger files are not ours [bytes].
MAX_BYTES = 20_000_000


def cache_folder() -> Path:
    """Folder in which convex pieces are kept."""
    given = os.environ.get(FOLDER_VARIABLE)
    if given:
        # Unlike Path.expanduser, this takes the home of nobody as it is.
        return Path(os.path.expanduser(given))
    if os.name == "nt" and os.environ.get("LOCALAPPDATA"):
        return Path(os.environ["LOCALAPPDATA"]) / "tominpmp" / "cache"
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "tominpmp"


class Content:
    """A mesh that is known by what it is made of."""

    def __init__(self, mesh: Any) -> None:
        self.mesh = mesh
        content = hashlib.sha256(f"tominpmp pieces {VERSION}".encode())
        content.update(np.ascontiguousarray(mesh.vertices(), np.float64).tobytes())
        for index in range(mesh.num_tris):
            triangle = mesh.tri_indices(index)
            content.update(b"%d %d %d " % (triangle[0], triangle[1], triangle[2]))
        self.key = content.hexdigest()

    def __eq__(self, other: object) -> bool:
        """Whether it is made of the same."""
        return isinstance(other, Content) and self.key == other.key

    def __hash__(self) -> int:
        """Hash of what it is made of."""
        return hash(self.key)


def pieces_of(mesh: Any) -> Pieces | None:
    """Convex pieces of a mesh of Coal, from the disk if it was cut before.

    Args:
        mesh: The mesh.

    Returns:
        The pieces; None if the mesh is flat.
    """
    return _known_pieces(Content(mesh), cache_folder())


# A mesh that cannot be kept on disk is still cut only once.
@lru_cache(maxsize=256)
def _known_pieces(content: Content, folder: Path) -> Pieces | None:
    path = folder / f"{content.key}.npz"
    found = _read(path)
    if found is not None:
        return found
    pieces = decomposition.decompose(content.mesh)
    if pieces is not None:
        logger.info(
            "a mesh of %d triangles became %d convex pieces",
            content.mesh.num_tris,
            len(pieces.corners),
        )
        _write(path, pieces)
    return pieces


def _read(path: Path) -> Pieces | None:
    try:
        if not path.is_file() or path.stat().st_size > MAX_BYTES:
            return None
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as data:
            points, counts = data["points"], data["counts"]
            outward, inward = data["deviation"].tolist()
    except Exception as error:  # whatever a broken file may raise
        logger.warning("the cached pieces %s cannot be read: %s", path, error)
        return None
    good = (
        points.ndim == 2
        and points.shape[1] == 3
        and np.issubdtype(points.dtype, np.floating)
        and bool(np.all(np.isfinite(points)))
        and int(np.sum(counts)) == len(points)
        and bool(np.all(counts >= 4))
    )
    if not good:
        logger.warning("the cached pieces %s make no sense", path)
        return None
    corners: list[Array] = np.split(points, np.cumsum(counts)[:-1])
    return Pieces(tuple(corners), outward, inward)


def _write(path: Path, pieces: Pieces) -> None:
    """Write a file that is either whole or not there; failing is no misfortune."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(
            dir=path.parent, prefix=path.stem[:8], suffix=".tmp", delete=False
        ) as file:
            try:
                np.savez_compressed(
                    file,
                    points=np.concatenate(pieces.corners),
                    counts=np.array([len(piece) for piece in pieces.corners]),
                    deviation=np.array([pieces.outward, pieces.inward]),
                )
                file.close()
                Path(file.name).replace(path)
            except BaseException:
                file.close()
                Path(file.name).unlink(missing_ok=True)
                raise
    except OSError as error:
        logger.warning("convex pieces cannot be kept in %s: %s", path.parent, error)
