"""Compressed sparse matrices as arrays: cut, stacked and split without SciPy's checks.

A plan builds thousands of programs of a few hundred rows. Each operation on such a
matrix takes SciPy 20 to 150 us, most of it for checks of what is known here; masks and
cumulative sums of its entries take a few, and SciPy gets the result alone.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from tominpmp.arrays import Array, BoolArray, IntArray

# What SciPy and solvers take without a copy.
Index = np.int32
Indices = NDArray[np.int32]


class Compressed(NamedTuple):
    """Entries of a sparse matrix, line after line: its rows, or else its columns.

    Attributes:
        data: The entries, shape (k,).
        places: Where each is on its line, shape (k,).
        starts: Where each line begins among the entries, and the end, shape (m + 1,).
        width: Number of places on a line.
    """

    data: Array
    places: Indices
    starts: Indices
    width: int

    @classmethod
    def of(cls, matrix: sp.csr_matrix | sp.csc_matrix) -> Compressed:
        """The entries of a matrix by its rows, or by its columns if it has them so."""
        width = matrix.shape[1] if matrix.format == "csr" else matrix.shape[0]
        places, starts = matrix.indices, matrix.indptr
        return cls(matrix.data, places.astype(Index, copy=False), starts, width)

    @classmethod
    def of_table(cls, data: Array, places: IntArray, width: int) -> Compressed:
        """Lines of as many entries each, those that are zero left out.

        Args:
            data: Entries, shape (m, w).
            places: Where they are, in ascending order, shape (m, w); -1 for nowhere.
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
        """Some of the places, of some of the lines; None for all."""
        used, starts, width, where = None, self.starts, self.width, self.places
        if places is not None:
            used = places[where]
            where = (np.cumsum(places, dtype=Index) - Index(1))[where]
            width = int(np.count_nonzero(places))
        if lines is not None:
            mine = np.repeat(lines, np.diff(starts))
            used = mine if used is None else used & mine
        if used is None:
            return self
        starts = _ends(used)[starts]
        if lines is not None:
            starts = np.append(starts[:-1][lines], starts[-1])
        return Compressed(self.data[used], where[used], starts, width)

    def followed_by(self, *others: Compressed) -> Compressed:
        """With further lines behind its own."""
        parts = (self, *others)
        counts = np.concatenate([np.diff(part.starts) for part in parts])
        return Compressed(
            np.concatenate([part.data for part in parts]),
            np.concatenate([part.places for part in parts]),
            _ends(counts),
            self.width,
        )

    def times(self, factors: Array) -> Compressed:
        """With the entries of each place multiplied by a factor."""
        return self._replace(data=self.data * factors[self.places])

    def reach(self, most: Array) -> Array:
        """Largest sums of the lines, shape (m,), where places have some size at most.

        Args:
            most: The sizes, shape (width,).
        """
        sizes = np.abs(self.data) * most[self.places]
        sums = np.bincount(self.lines, sizes, minlength=self.starts.size - 1)
        return np.asarray(sums, dtype=np.float64)

    def largest(self) -> Array:
        """Largest size of an entry at each place, shape (width,)."""
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
    """Entries in any order of their lines, and in the order of their places.

    Args:
        lines: The line of each entry, shape (k,).
        places: Where each is on it, ascending among those of one line, shape (k,).
        data: The entries, shape (k,).
        count: Number of lines.
        width: Number of places on a line.
    """
    order = np.argsort(lines, kind="stable")
    counts = np.bincount(lines, minlength=count)
    return Compressed(data[order], places[order].astype(Index), _ends(counts), width)


def _ends(counts: NDArray[Any]) -> Indices:
    """Zero, and the sums of all counts up to each, shape (m + 1,)."""
    out = np.zeros(counts.size + 1, dtype=Index)
    np.cumsum(counts, out=out[1:])
    return out
