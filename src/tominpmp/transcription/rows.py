"""Rows of nonlinear programs: their bounds, kinds and groups."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tominpmp.arrays import Array, BoolArray, IntArray


@dataclass(frozen=True)
class Rows:
    """Bounds, kinds and groups of the rows of a program.

    Attributes:
        lower: Lower bounds, shape (m,).
        upper: Upper bounds, shape (m,); equal to the lower ones for equations.
        kind: Index of each row's kind in ``kinds``, shape (m,).
        group: Index of each row's group, whose rows share an elastic variable, (m,).
        kinds: Names of the kinds, for reports.
        curable: Whether a slower motion along the same path violates rows of each kind
            less, shape (kinds,).
    """

    lower: Array
    upper: Array
    kind: IntArray
    group: IntArray
    kinds: tuple[str, ...]
    curable: BoolArray

    @property
    def size(self) -> int:
        """Number of rows."""
        return self.lower.size

    @cached_property
    def group_count(self) -> int:
        """Number of groups."""
        return int(self.group.max()) + 1 if self.size else 0

    def violation(self, values: Array) -> Array:
        """Violation of each row, >= 0, shape (m,)."""
        excess, below = values - self.upper, self.lower - values
        np.maximum(excess, below, out=excess)
        return np.maximum(excess, 0.0, out=excess)

    def largest_violation(self, values: Array) -> float:
        """Largest violation of any row; 0 without rows."""
        return float(np.max(self.violation(values), initial=0.0))

    def group_violation(self, values: Array) -> Array:
        """Largest violation in each group, shape (number of groups,)."""
        excess, out = self.violation(values), np.zeros(self.group_count)
        over = np.flatnonzero(excess)  # few of the rows, most of which are clearances
        np.maximum.at(out, self.group[over], excess[over])
        return out

    @cached_property
    def group_kind(self) -> IntArray:
        """Kind of each group, shape (number of groups,)."""
        out = np.zeros(self.group_count, dtype=np.int64)
        out[self.group] = self.kind
        return out

    def carried(self, former: Rows, values: Array) -> Array:
        """Transfer values of former rows to these rows; zero for rows that joined.

        Args:
            former: Rows of the program before an exchange: within each kind, rows that
                joined come last.
            values: Value of each former row.
        """
        out = np.zeros(self.size)
        for index, kind in enumerate(self.kinds):
            if kind in former.kinds:
                mine = np.flatnonzero(self.kind == index)
                known = values[former.kind == former.kinds.index(kind)]
                count = min(mine.size, known.size)
                out[mine[:count]] = known[:count]
        return out

    @staticmethod
    def stack(
        parts: list[tuple[str, Array, Array, IntArray]],
        curable: Collection[str] = frozenset(),
    ) -> Rows:
        """Join blocks of rows.

        Args:
            parts: For each block, the name of its kind, the lower and upper bounds, and
                the groups, counted from 0 within the block.
            curable: Names of the kinds of rows that a slower motion violates less.

        Returns:
            The rows of all blocks, in order.
        """
        kinds, lower, upper, groups = zip(*parts, strict=True)
        sizes = [group.size for group in groups]
        counts = [int(group.max(initial=-1)) + 1 for group in groups]
        first = np.cumsum([0, *counts[:-1]])
        return Rows(
            np.concatenate(lower),
            np.concatenate(upper),
            np.repeat(np.arange(len(kinds)), sizes),
            np.concatenate(groups) + np.repeat(first, sizes),
            kinds,
            np.array([kind in curable for kind in kinds], dtype=bool),
        )
