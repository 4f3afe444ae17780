"""Obstacles made of triangles."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NoReturn

import numpy as np
from numpy.typing import ArrayLike

from tominpmp.arrays import Array, IntArray, array_or_nan, frozen_array, real_array
from tominpmp.checks import choice, wrong
from tominpmp.description.paths import checked_path
from tominpmp.exceptions import SceneError, brief
from tominpmp.scene.mesh_files import MeshFileError, read_mesh
from tominpmp.scene.obstacles import Obstacle, Placed

if TYPE_CHECKING:
    from typing_extensions import Unpack

# Coordinates beyond this are a mistake [m].
FARTHEST = 1e6


@dataclass(frozen=True, kw_only=True, eq=False)
class Mesh(Obstacle):
    """Triangles, from a file or from arrays.

    For distances it is taken as convex pieces that cover it, see ``convex``.

    Attributes:
        path: File to read (STL, OBJ, DAE, GLB, glTF, OFF or PLY); None
            where vertices and triangles are given.
        vertices: Vertices without the scale [m], shape (k, 3).
        triangles: Indices of the corners of each triangle, shape (l, 3).
        scale: What coordinates are multiplied with, along x, y and z, shape (3,).
        convex: "auto" for convex pieces, "hull" for the convex hull, "none" for the
            triangles themselves: nothing is added then, but queries are slow, the depth
            of an overlap is not known, and what is inside touches nothing.

    Raises:
        SceneError: If the file cannot be read or is no mesh: the message says which
            file, and what is wrong with it.
    """

    path: Path | None = None
    vertices: Array = None  # type: ignore[assignment]
    triangles: IntArray = None  # type: ignore[assignment]
    scale: Array = 1.0  # type: ignore[assignment]
    convex: Literal["auto", "hull", "none"] = "auto"

    if TYPE_CHECKING:

        def __init__(
            self,
            name: str,
            *,
            path: str | Path | None = ...,
            vertices: ArrayLike = ...,
            triangles: ArrayLike = ...,
            scale: ArrayLike = ...,
            convex: Literal["auto", "hull", "none"] = ...,
            **given: Unpack[Placed],
        ) -> None: ...

    def __post_init__(self) -> None:
        """Read the file, check what was read."""
        super().__post_init__()
        ways, expected = ("auto", "hull", "none"), "'auto', 'hull' or 'none'"
        choice(self.convex, ways, "convex", expected, self._error)
        object.__setattr__(self, "scale", self._checked_scale())
        given = self.vertices is not None, self.triangles is not None
        if given[0] != given[1] or (self.path is None and not given[0]):
            self._fail("it needs a path, or vertices and triangles")
        if self.path is not None:
            self._set_path()
        if not given[0]:
            self._read()
        self._check_triangles()

    def _fail(self, message: str) -> NoReturn:
        raise self._error(message)

    def _checked_scale(self) -> Array:
        scale = array_or_nan(self.scale)
        if scale.shape == ():
            scale = np.full(3, float(scale))
        if scale.shape != (3,) or not np.all(np.isfinite(scale) & (scale != 0.0)):
            expected = "one number or three, none zero"
            raise wrong(self.scale, "scale", expected, self._error)
        return frozen_array(scale)

    def _set_path(self) -> None:
        try:
            path = checked_path(self.path, "path", SceneError)
        except SceneError as error:
            self._fail(str(error))
        object.__setattr__(self, "path", path)

    def _read(self) -> None:
        assert self.path is not None  # noqa: S101
        path = self.path.absolute()
        if not path.is_file():
            why = "has no such file" if path.parent.is_dir() else "does not exist"
            self._fail(
                f"the mesh {brief(str(self.path))} is not there: the folder "
                f"{path.parent} {why}"
            )
        try:
            vertices, triangles = read_mesh(path)
        except MeshFileError as error:
            self._fail(f"the mesh {path} cannot be read: {error}")
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "triangles", triangles)

    def _check_triangles(self) -> None:
        what = "the mesh" if self.path is None else f"the mesh {self.path}"
        try:
            vertices = real_array(self.vertices)
            corners = np.array(self.triangles)
        except ValueError as error:
            parts = f"vertices or triangles of {what}"
            self._fail(f"{parts} are not made of numbers: {error}")
        if vertices.ndim != 2 or vertices.shape[1] != 3:
            self._fail(f"{what} has vertices of shape {vertices.shape}, not (k, 3)")
        if not np.all(np.abs(vertices) < FARTHEST):
            self._fail(
                f"{what} has vertices that are not finite, or {FARTHEST:g} m off"
            )
        if corners.dtype.kind not in "iu" or corners.ndim != 2 or corners.shape[1] != 3:
            self._fail(
                f"{what} has triangles that are not of shape (l, 3), of integers"
            )
        if not len(corners):
            self._fail(f"{what} has no triangles")
        if corners.min() < 0 or corners.max() >= len(vertices):
            self._fail(
                f"{what} has triangles with corners that are not among its "
                f"{len(vertices)} vertices"
            )
        triangles = corners.astype(np.int64)
        triangles.setflags(write=False)
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "triangles", triangles)

    @property
    def points(self) -> Array:
        """Vertices in the axes of the obstacle, scaled [m], shape (k, 3)."""
        return np.asarray(self.vertices * self.scale)
