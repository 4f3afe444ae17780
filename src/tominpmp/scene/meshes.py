"""Obstacles as triangle meshes."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from tominpmp.arrays import (
    Array,
    Converted,
    IntArray,
    array_or_nan,
    default,
    frozen_array,
    real_array,
)
from tominpmp.checks import FARTHEST, choice, optional, wrong
from tominpmp.description.paths import checked_path
from tominpmp.exceptions import ProblemError, SceneError, brief, naming
from tominpmp.scene.mesh_files import read_mesh
from tominpmp.scene.obstacles import Obstacle, obstacle


def _scale(value: Any, name: str) -> Array:
    """Check a caller's scale, one factor or one for each axis; shape (3,)."""
    scale = array_or_nan(value)
    if scale.shape not in ((), (3,)) or not np.all(np.isfinite(scale) & (scale != 0)):
        raise wrong(value, name, "one or three numbers other than zero")
    return frozen_array(np.broadcast_to(scale, 3))


Scale: TypeAlias = Annotated[Converted[ArrayLike, Array], _scale]
MeshPathOrNone: TypeAlias = Annotated[
    Converted[str | Path | None, Path | None],
    optional(partial(checked_path, error=SceneError)),
]


@obstacle
class Mesh(Obstacle):
    """A triangle mesh, from a file or from arrays.

    In distance queries the mesh is represented by convex pieces that cover it, see
    ``convex``.

    Attributes:
        path: File to read (STL, OBJ, DAE, GLB, glTF, OFF or PLY); None
            if vertices and triangles are given.
        vertices: Vertices before scaling [m], shape (k, 3).
        triangles: Vertex indices of the corners of each triangle, shape (l, 3).
        scale: Factors of the coordinates along x, y and z, shape (3,).
        convex: "auto" for convex pieces, "hull" for the convex hull, "none" for the
            triangles themselves: triangles add no volume, but queries are slow, the
            depth of an overlap is not known, and bodies inside have no contact.

    Raises:
        SceneError: If the file cannot be read or is not a mesh: the message names the
            file and the fault.
    """

    path: MeshPathOrNone = default(None)
    vertices: Converted[ArrayLike, Array] = default(None)
    triangles: Converted[ArrayLike, IntArray] = default(None)
    scale: Scale = default(1.0)
    convex: Literal["auto", "hull", "none"] = "auto"

    def _check_shape(self) -> None:
        """Read the file, if there is one, and check the triangles."""
        known, expected = ("auto", "hull", "none"), "'auto', 'hull' or 'none'"
        choice(self.convex, known, "convex", expected)
        given = self.vertices is not None, self.triangles is not None
        if given[0] != given[1] or (self.path is None and not given[0]):
            raise ProblemError("it needs a path, or vertices and triangles")
        if not given[0]:
            self._read()
        self._check_triangles()

    def _read(self) -> None:
        """Read vertices and triangles from the file."""
        assert self.path is not None  # noqa: S101
        path = self.path.absolute()
        if path.is_dir():
            raise ProblemError(f"the mesh {path} is a folder, expected a file")
        if not path.is_file():
            why = "has no such file" if path.parent.is_dir() else "does not exist"
            raise ProblemError(
                f"the mesh {brief(str(self.path))} does not exist: the folder "
                f"{path.parent} {why}"
            )
        with naming(f"the mesh {path} cannot be read"):
            vertices, triangles = read_mesh(path)
        self._keep(path=path, vertices=vertices, triangles=triangles)

    def _check_triangles(self) -> None:
        """Check vertices and triangles."""
        mesh = "the mesh" if self.path is None else f"the mesh {self.path}"
        try:
            vertices = real_array(self.vertices)
            corners = np.array(self.triangles)
        except ValueError as error:
            raise ProblemError(
                f"vertices or triangles of {mesh} are not numbers: {error}"
            ) from error
        if vertices.ndim != 2 or vertices.shape[1] != 3:
            fault = f"vertices of shape {vertices.shape}, not (k, 3)"
        elif not np.all(np.abs(vertices) < FARTHEST):
            fault = f"vertices that are not finite, or {FARTHEST:g} m away"
        elif corners.dtype.kind not in "iu" or corners.shape[1:] != (3,):
            fault = "triangles that are not of shape (l, 3), of integers"
        elif not len(corners):
            fault = "no triangles"
        elif corners.min() < 0 or corners.max() >= len(vertices):
            count = len(vertices)
            fault = f"triangles with corners that are not among its {count} vertices"
        else:
            triangles = corners.astype(np.int64)
            triangles.setflags(write=False)
            self._keep(vertices=vertices, triangles=triangles)
            return
        raise ProblemError(f"{mesh} has {fault}")

    @property
    def points(self) -> Array:
        """Scaled vertices in the axes of the obstacle [m], shape (k, 3)."""
        return np.asarray(self.vertices * self.scale)
