"""Compressed sparse matrices as arrays: selected and stacked without SciPy's checks.

A plan builds thousands of programs of a few hundred rows. Each operation on such a
matrix takes SciPy 20 to 150 us, most of it for checks of properties that are known
here. Masks and cumulative sums of the entries take a few us, and only the result is
made a SciPy matrix.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from tominpmp.arrays import Array, BoolArray, IntArray

# Index type that SciPy and the solvers accept without a copy.
Index = np.int32
Indices = NDArray[np.int32]


class Compressed(NamedTuple):
    """Compressed sparse matrix whose lines are either its rows or its columns.

    Attributes:
        data: The entries, line by line, shape (k,).
        places: Index of each entry on its line, shape (k,).
        starts: Index of the first entry of each line, and k, shape (m + 1,).
        width: Number of places on a line.
    """

    data: Array
    places: Indices
    starts: Indices
    width: int

    @classmethod
    def of(cls, matrix: sp.csr_matrix | sp.csc_matrix) -> Compressed:
        """A matrix of SciPy: lines are rows in format CSR, columns in format CSC."""
        width = matrix.shape[1] if matrix.format == "csr" else matrix.shape[0]
        places, starts = matrix.indices, matrix.indptr
        return cls(matrix.data, places.astype(Index, copy=False), starts, width)

    @classmethod
    def of_table(cls, data: Array, places: IntArray, width: int) -> Compressed:
        """Lines with up to w entries each; zeros are left out.

        Args:
            data: Entries, shape (m, w).
            places: Their places in ascending order, shape (m, w); -1 to leave an entry
                out.
            width: Number of places on a line.
        """
        used = (data != 0.0) & (places >= 0)
        starts = _ends(used.sum(axis=1))
        return cls(data[used], places[used].astype(Index), starts, width)

    @property
    def lines(self) -> IntArray:
        """The line of each entry, shape (k,)."""
        counts = np.diff(self.starts)
        return np.repeat(np.arange(counts.size), counts)

    def chosen(
        self, places: BoolArray | None = None, lines: BoolArray | None = None
    ) -> Compressed:
        """The matrix of chosen lines and places, by masks; None for all of them."""
        used, starts, width, where = None, self.starts, self.width, self.places
        if places is not None:
            used = places[where]
            where = (np.cumsum(places, dtype=Index) - Index(1))[where]
            width = int(np.count_nonzero(places))
        if lines is not None:
            chosen = np.repeat(lines, np.diff(starts))
            used = chosen if used is None else used & chosen
        if used is None:
            return self
        starts = _ends(used)[starts]
        if lines is not None:
            starts = np.append(starts[:-1][lines], starts[-1])
        return Compressed(self.data[used], where[used], starts, width)

    def followed_by(self, *others: Compressed) -> Compressed:
        """The matrix with the lines of others appended."""
        blocks = (self, *others)
        counts = np.concatenate([np.diff(block.starts) for block in blocks])
        return Compressed(
            np.concatenate([block.data for block in blocks]),
            np.concatenate([block.places for block in blocks]),
            _ends(counts),
            self.width,
        )

    def times(self, factors: Array) -> Compressed:
        """The matrix with the entries at each place multiplied by a factor."""
        return self._replace(data=self.data * factors[self.places])

    def reach(self, most: Array) -> Array:
        """Largest products of the lines with a bounded vector, shape (m,).

        Args:
            most: Largest absolute values of the components of the vector, shape
                (width,).
        """
        sizes = np.abs(self.data) * most[self.places]
        sums = np.bincount(self.lines, sizes, minlength=self.starts.size - 1)
        return np.asarray(sums, dtype=np.float64)

    def largest(self) -> Array:
        """Largest absolute value of the entries at each place, shape (width,)."""
        out = np.zeros(self.width)
        np.maximum.at(out, self.places, np.abs(self.data))
        return out

    def rows(self) -> sp.csr_matrix:
        """The matrix whose rows are the lines."""
        shape = self.starts.size - 1, self.width
        return sp.csr_matrix((self.data, self.places, self.starts), shape=shape)

    def columns(self) -> sp.csc_matrix:
        """The matrix whose columns are the lines."""
        shape = self.width, self.starts.size - 1
        return sp.csc_matrix((self.data, self.places, self.starts), shape=shape)


def sorted_in(
    lines: IntArray, places: IntArray, data: Array, count: int, width: int
) -> Compressed:
    """Sort entries into lines; on each line they are already in order.

    Args:
        lines: The line of each entry, shape (k,).
        places: Place of each entry, ascending among the entries of a line, shape (k,).
        data: The entries, shape (k,).
        count: Number of lines.
        width: Number of places on a line.
    """
    order = np.argsort(lines, kind="stable")
    counts = np.bincount(lines, minlength=count)
    return Compressed(data[order], places[order].astype(Index), _ends(counts), width)


def _ends(counts: NDArray[Any]) -> Indices:
    """Zero, followed by the cumulative sums of the counts, shape (m + 1,)."""
    out = np.zeros(counts.size + 1, dtype=Index)
    np.cumsum(counts, out=out[1:])
    return out
