"""The cache of convex pieces on disk is used only if its pieces belong to the mesh."""

from __future__ import annotations

import errno
import os
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pytest

from tominpmp.collision import decomposition_cache

Arrays = dict[str, np.ndarray]


def bowl() -> Any:
    """A mesh that is cut into several pieces: two boxes side by side."""
    x = np.array([0.0, 0.1, 0.5, 0.6])
    corners, triangles = [], []
    quads = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4))
    quads = (*quads, (1, 5, 7, 3))
    for low, high in ((x[0], x[1]), (x[2], x[3])):
        first = len(corners)
        corners += [(a, b, c) for a in (low, high) for b in (0, 0.1) for c in (0, 0.1)]
        for a, b, c, d in quads:
            triangles += [[first + i for i in t] for t in ((a, b, c), (a, c, d))]
    mesh = coal.BVHModelOBBRSS()
    mesh.beginModel(len(triangles), len(corners))
    for triangle in triangles:
        mesh.addTriangle(*(np.array(corners[i], float) for i in triangle))
    mesh.endModel()
    return mesh


@pytest.fixture
def cache_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The cache file of the pieces of the mesh."""
    monkeypatch.setenv(decomposition_cache.FOLDER_VARIABLE, str(tmp_path))
    decomposition_cache._known_pieces.cache_clear()
    assert len(decomposition_cache.pieces_of(bowl())) == 2
    decomposition_cache._known_pieces.cache_clear()
    (path,) = tmp_path.iterdir()
    return path


def scaled(arrays: Arrays) -> None:
    arrays["points"] = 0.5 * arrays["points"]


def moved(arrays: Arrays) -> None:
    arrays["points"] = arrays["points"] + 1e-3


def with_further_array(arrays: Arrays) -> None:
    arrays["more"] = np.zeros(2)


def with_counts_as_floats(arrays: Arrays) -> None:
    arrays["counts"] = arrays["counts"].astype(float)


def in_single_precision(arrays: Arrays) -> None:
    arrays["points"] = arrays["points"].astype(np.float32)


@pytest.mark.parametrize(
    "spoil",
    [scaled, moved, with_further_array, with_counts_as_floats, in_single_precision],
)
def test_invalid_cached_pieces_are_computed_anew_and_replaced(
    spoil: Callable[[Arrays], None],
    cache_file: Path,
    caplog: pytest.LogCaptureFixture,
) -> None:
    mesh = bowl()
    with np.load(cache_file) as data:
        sound = dict(data)
    wrong = dict(sound)
    spoil(wrong)
    np.savez(cache_file, **wrong)
    pieces = decomposition_cache.pieces_of(mesh)
    assert "are invalid" in caplog.text
    found = np.concatenate([hull.points() for hull in pieces])
    both = np.unique(found, axis=0), np.unique(sound["points"], axis=0)
    np.testing.assert_array_equal(*both)
    # The file has been replaced by a valid one.
    decomposition_cache._known_pieces.cache_clear()
    caplog.clear()
    decomposition_cache.pieces_of(mesh)
    assert not caplog.text


def test_reordered_corners_in_the_cache_are_detected(
    cache_file: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with np.load(cache_file) as data:
        arrays = dict(data)
    arrays["points"] = arrays["points"][::-1]
    np.savez(cache_file, **arrays)
    assert len(decomposition_cache.pieces_of(bowl())) == 2
    assert "are invalid" in caplog.text


def test_cache_file_larger_than_allowed_is_not_read(
    cache_file: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with zipfile.ZipFile(cache_file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("points.npy", bytes(2 * decomposition_cache.MAX_BYTES))
    assert len(decomposition_cache.pieces_of(bowl())) == 2
    assert "cannot be read" in caplog.text


@pytest.mark.parametrize("step", ["write", "close", "replace"])
def test_full_disk_leaves_no_partial_cache_file(
    step: str,
    cache_file: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    cache_file.unlink()

    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    if step == "write":
        monkeypatch.setattr(np, "savez_compressed", full)
    elif step == "replace":
        monkeypatch.setattr(Path, "replace", full)
    else:
        opened = Path.open

        def closing(path: Path, mode: str) -> Any:
            file = opened(path, mode, buffering=0)

            class File:
                def __enter__(self) -> Any:
                    return file

                def __exit__(self, *_: object) -> None:
                    file.close()
                    full()

            return File()

        monkeypatch.setattr(Path, "open", closing)
    assert len(decomposition_cache.pieces_of(bowl())) == 2
    assert "cannot be kept" in caplog.text
    assert not list(cache_file.parent.iterdir())
