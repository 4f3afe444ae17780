"""Obstacles on grids: terrain as height fields, and occupied space from sensors."""

from __future__ import annotations

from typing import Annotated, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from tominpmp.arrays import Array, BoolArray, Converted, frozen_array
from tominpmp.checks import array, number, wrong
from tominpmp.exceptions import ProblemError
from tominpmp.scene.motion import finite_numbers
from tominpmp.scene.obstacles import Length, Obstacle, obstacle

# Limits of size, above which checks would take minutes.
MAX_CELLS = 2_500
MAX_POINTS = 5_000_000


def _points(value: Any, name: str) -> Array:
    """Check a caller's points, shape (k, 3)."""
    points = frozen_array(array(value, name, (None, 3), "coordinates of each point"))
    if not 0 < len(points) <= MAX_POINTS or not np.all(np.isfinite(points)):
        raise wrong(value, name, f"1 to {MAX_POINTS} points, all of them finite")
    return points


Numbers: TypeAlias = Annotated[Converted[ArrayLike, Array], finite_numbers]
Points: TypeAlias = Annotated[Converted[ArrayLike, Array], _points]


@obstacle
class HeightField(Obstacle):
    """Ground with heights on a grid and a flat base; centred in x and y.

    Every cell of the grid is the convex hull of its four corners and of the base below
    them, which contains the surface between the corners.

    Attributes:
        heights: Heights of the grid points above the position [m], shape (ny, nx), rows
            along y and columns along x, both ascending.
        size: Extent along x and y [m], shape (2,).
        base: Height of the base above the position [m]; None for a base below the
            lowest point, by a hundredth of the larger extent.
    """

    heights: Numbers
    size: Numbers
    base: float | None = None

    def _check_shape(self) -> None:
        """Check grid and extent."""
        heights, size = self.heights, self.size
        cells = np.array(heights.shape) - 1
        if cells.size != 2 or min(cells) < 1 or np.prod(cells) > MAX_CELLS:
            raise ProblemError(
                f"heights has shape {heights.shape}, expected (ny, nx) with at least "
                f"two rows and two columns, and at most {MAX_CELLS} cells"
            )
        if size.shape != (2,) or not np.all(size > 0.0):
            expected = "two positive extents, along x and y [m]"
            raise wrong(size.tolist(), "size", expected)
        lowest = float(heights.min())
        base = lowest - 0.01 * float(size.max()) if self.base is None else self.base
        most = float(np.nextafter(lowest, -np.inf))
        expected = f"a height below all others, of which the lowest is {lowest:g} m"
        self._keep(base=number(base, "base", expected, most=most))

    @property
    def grid(self) -> tuple[Array, Array]:
        """Coordinates of the grid points along x, (nx,), and along y, (ny,) [m]."""
        ny, nx = self.heights.shape
        half = 0.5 * self.size
        return np.linspace(-half[0], half[0], nx), np.linspace(-half[1], half[1], ny)

    @property
    def cells(self) -> Array:
        """Corners of the cells, four at the top and four at the base, (c, 8, 3) [m]."""
        x, y = self.grid
        X, Y = np.meshgrid(x, y)
        top = np.stack([X, Y, self.heights], axis=2)
        each = [top[:-1, :-1], top[:-1, 1:], top[1:, 1:], top[1:, :-1]]
        corners = np.stack(each, axis=2).reshape(-1, 4, 3)
        below = corners.copy()
        below[:, :, 2] = self.base
        return np.concatenate([corners, below], axis=1)


@obstacle
class OcTree(Obstacle):
    """Occupied space: cubic cells that contain points.

    The cells have the size of the resolution and are aligned with the axes of the
    obstacle. Neighbouring cells are merged into a smaller number of boxes.

    Attributes:
        points: Points in the axes of the obstacle [m], shape (k, 3).
        resolution: Edge length of the cells [m].
    """

    points: Points
    resolution: Length

    def _check_shape(self) -> None:
        """Check the number of cells."""
        cells = np.prod(np.ptp(self.points, axis=0) / self.resolution + 2.0)
        if cells > 50.0 * MAX_POINTS:
            raise ProblemError(
                f"a resolution of {self.resolution:g} m is too fine for the extent of "
                "the points"
            )

    @property
    def boxes(self) -> tuple[Array, Array]:
        """Occupied boxes: centres and edge lengths, shapes (b, 3) [m]."""
        # Far away only the differences of the numbers of cells fit into integers.
        cells = np.floor(self.points / self.resolution)
        origin = cells.min(axis=0)
        cells = (cells - origin).astype(np.int64)
        occupied = np.zeros(cells.max(axis=0) + 1, dtype=bool)
        occupied[tuple(cells.T)] = True
        low, high = _boxes(occupied)
        low, high = (low + origin) * self.resolution, (high + origin) * self.resolution
        return 0.5 * (low + high), high - low


def _boxes(occupied: BoolArray) -> tuple[Array, Array]:
    """Disjoint boxes that cover the occupied cells, grown axis by axis.

    Returns:
        Indices of the first cell of each box, and indices after its last cell, shape
        (b, 3) each.
    """
    uncovered = occupied.copy()
    low, high = [], []
    for cell in np.argwhere(occupied):
        if not uncovered[tuple(cell)]:
            continue
        end = cell + 1
        for axis in range(3):
            while end[axis] < uncovered.shape[axis]:
                layer = [slice(a, b) for a, b in zip(cell, end, strict=True)]
                layer[axis] = slice(end[axis], end[axis] + 1)
                if not np.all(uncovered[tuple(layer)]):
                    break
                end[axis] += 1
        uncovered[tuple(slice(a, b) for a, b in zip(cell, end, strict=True))] = False
        low.append(cell)
        high.append(end)
    return np.array(low, dtype=np.float64), np.array(high, dtype=np.float64)
