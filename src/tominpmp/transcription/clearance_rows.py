"""Rows of clearances on a spline: at shares of intervals, and at instants of real time.

An obstacle that begins to move at once, or turns a corner, makes a kink in the time
that the arm may be somewhere. A row at a share of an interval jumps over it when the
duration changes; a row at that very instant stays there, and the path shifts under it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array, BoolArray, IntArray
from tominpmp.constraints import PathConstraint
from tominpmp.transcription.spline import Spline, SplineDerivatives
from tominpmp.transcription.spline_rows import (
    Columns,
    Entries,
    Instants,
    StateDerivatives,
)

# Instants of each interval at which clearances are rows: its middle and its end.
SHARES = (0.5, 1.0)


@dataclass(frozen=True, eq=False)
class ClearanceRows:
    """Clearances at instants of a spline.

    Attributes:
        constraint: The clearances of a configuration, p of them.
        fixed: Instants at shares of intervals.
    """

    constraint: PathConstraint
    fixed: Instants

    @classmethod
    def on(
        cls, constraint: PathConstraint, intervals: int, extra: Instants
    ) -> ClearanceRows:
        """The regular instants of so many intervals, and extra ones."""
        every, count = np.arange(intervals), len(SHARES)
        regular = Instants(np.repeat(every, count), np.tile(SHARES, intervals))
        return cls(constraint, regular.joined(extra))

    @property
    def size(self) -> int:
        """Number of instants."""
        return self.fixed.size + self.constraint.kinks.size

    def instants(self, h: Array) -> Instants:
        """The instants on intervals of given lengths [s], shape (N,).

        Those that are due after the end of the motion are at its end.
        """
        kinks, ends = self.constraint.kinks, np.cumsum(h)
        if not kinks.size:
            return self.fixed
        interval = np.minimum(np.searchsorted(ends, kinks), h.size - 1)
        share = (kinks - (ends - h)[interval]) / h[interval]
        return self.fixed.joined(Instants(interval, np.clip(share, 0.0, 1.0)))

    def values(self, spline: Spline, attention: float) -> Array:
        """Values at the instants, shape (m, p); see :class:`PathConstraint`."""
        at = self.instants(spline.h)
        return self.constraint.values(
            at.states(spline)[0], attention, self._times(at, spline)
        )

    def _times(self, at: Instants, spline: Spline) -> Array | None:
        return at.times(spline.h) if self.constraint.moving else None

    def jacobian(
        self,
        chosen: IntArray,
        spline: Spline,
        coefficients: SplineDerivatives,
        columns: Columns,
    ) -> sp.csr_matrix:
        """Jacobian of some of the values.

        Args:
            chosen: Indices into the m p values of all instants, shape (k,), ascending.
            spline: The motion.
            coefficients: Its derivatives.
            columns: Where the unknowns stand.

        Returns:
            Shape (k, columns).
        """
        at, constraint = self.instants(spline.h), self.constraint
        by = StateDerivatives.of(at, coefficients)
        entries = Entries(chosen.size, columns.count)
        instants, which = np.divmod(chosen, max(constraint.count, 1))
        configurations, velocities, _ = at.states(spline)
        places, valid = columns.around(at.interval)
        times = self._times(at, spline)
        gradients, rates = constraint.derivatives_at(
            configurations, instants, which, times
        )
        if times is not None:
            # Where time is fixed, it is the path that shifts as intervals grow.
            shift = np.einsum("kj,kj->k", gradients, velocities[instants])
            pinned = self._pinned(spline.h)[instants]
            slope = np.where(pinned, -shift, rates)
            self._add_times(entries, at, instants, slope, columns)
        for instant in np.unique(instants):
            rows = np.flatnonzero(instants == instant)
            gradient = gradients[rows]
            by_point = by.q_points[instant][None, :, None] * gradient[:, None, :]
            by_length = gradient @ by.q_lengths[instant].T
            data = np.concatenate([by_point.reshape(rows.size, -1), by_length], axis=1)
            entries.add(rows[:, None], places[instant], data, valid[instant])
            if at.interval[instant] == columns.intervals - 1:
                last = at.share[instant] ** 2 * gradient
                entries.add(rows[:, None], columns.final_position, last)
        return entries.matrix()

    def _pinned(self, h: Array) -> BoolArray:
        """Which of the instants are fixed in time, shape (m,)."""
        due = self.constraint.kinks < h.sum()
        return np.concatenate([np.zeros(self.fixed.size, dtype=bool), due])

    @staticmethod
    def _add_times(
        entries: Entries,
        at: Instants,
        instants: IntArray,
        slope: Array,
        columns: Columns,
    ) -> None:
        """Add how values depend on time, the sum of the lengths before an instant."""
        lengths = np.arange(columns.intervals)
        interval = at.interval[instants, None]
        over = np.where(interval > lengths, 1.0, 0.0)
        over += np.where(interval == lengths, at.share[instants, None], 0.0)
        rows = np.arange(instants.size)[:, None]
        entries.add(rows, columns.lengths, slope[:, None] * over)
