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
)
from tominpmp.checks import FARTHEST, HUGE, TINY, array, choice, wrong
from tominpmp.description.paths import checked_path
from tominpmp.exceptions import ProblemError, SceneError, naming
from tominpmp.scene.mesh_files import read_mesh
from tominpmp.scene.obstacles import Obstacle, obstacle


def _scale(value: Any, name: str) -> Array:
    """Check a caller's scale, one factor or one for each axis; shape (3,)."""
    size = np.abs(scale := array_or_nan(value))
    if scale.shape not in ((), (3,)) or not np.all(size == np.clip(size, TINY, HUGE)):
        raise wrong(value, name, f"one or three numbers, {TINY:g} to {HUGE:g} in size")
    return frozen_array(np.broadcast_to(scale, 3))


Scale: TypeAlias = Annotated[Converted[ArrayLike, Array], _scale]
MeshPathOrNone: TypeAlias = Annotated[
    Converted[str | Path | None, Path | None],
    partial(checked_path, error=SceneError),
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
        choice(self.convex, ("auto", "hull", "none"), "convex")
        given = self.vertices is not None, self.triangles is not None
        if given[0] != given[1] or (self.path is None and not given[0]):
            raise ProblemError("it needs a path, or vertices and triangles")
        if self.path is not None and not given[0]:
            path = self.path.absolute()
            with naming(f"the mesh {path} cannot be read"):
                vertices, triangles = read_mesh(path)
            self._keep(path=path, vertices=vertices, triangles=triangles)
        self._check_triangles()

    def _check_triangles(self) -> None:
        """Check vertices and triangles."""
        with naming("the mesh" if self.path is None else f"the mesh {self.path}"):
            vertices = array(self.vertices, "vertices", (None, 3), "coordinates [m]")
            content = "numbers of vertices, integers"
            array(self.triangles, "triangles", (None, 3), content)
            triangles, count = np.array(self.triangles), len(vertices)
            if not np.all(np.abs(vertices) < FARTHEST / np.abs(self.scale)):
                most = f"{FARTHEST:g} m away"
                raise ProblemError(f"it has vertices that are not finite, or {most}")
            if triangles.dtype.kind not in "iu":
                raise wrong(triangles.tolist(), "triangles", content)
            if not len(triangles):
                raise ProblemError("it has no triangles")
            if triangles.min() < 0 or triangles.max() >= count:
                fault = f"corners that are not among its {count} vertices"
                raise ProblemError(f"its triangles have {fault}")
        triangles = triangles.astype(np.int64)
        triangles.setflags(write=False)
        self._keep(vertices=frozen_array(vertices), triangles=triangles)

    @property
    def points(self) -> Array:
        """Scaled vertices in the axes of the obstacle [m], shape (k, 3)."""
        return np.asarray(self.vertices * self.scale)
