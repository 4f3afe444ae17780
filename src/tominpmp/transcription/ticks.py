"""Knots on the clock of a controller.

A controller takes a motion as samples at its period and joins them by polynomials:
cubic ones through positions and velocities, of degree 5 through accelerations too. A
motion that is a polynomial of such a degree between ticks is joined exactly, so that
what was planned is what is run. That is so if all knots are ticks.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from tominpmp.arrays import Array, IntArray
from tominpmp.motion.samples import multiples
from tominpmp.motion.trajectory import Trajectory

# Durations that are a multiple of the period but for this share of it are one.
ROUNDING = 1e-6


def ticks_of(duration: float, period: float) -> int:
    """Least number of periods that last as long as a duration, up to rounding."""
    return int(np.ceil(duration / period - ROUNDING))


def whole_periods(duration: float, period: float | None) -> float:
    """The least time on a clock that is as long as a duration, up to rounding [s].

    Args:
        duration: The duration [s].
        period: The period of the clock [s]; None where there is no clock.
    """
    if period is None:
        return duration
    return float(multiples(np.array(ticks_of(duration, period)), period))


def at_ticks(times: ArrayLike, period: float) -> Array:
    """Times that are at ticks but for rounding, to the last bit [s].

    Args:
        times: The times [s].
        period: The period of the clock [s].
    """
    return multiples(np.rint(np.asarray(times) / period), period)


@dataclass(frozen=True, eq=False)
class Ticks:
    """Knots of a motion as multiples of a period.

    Attributes:
        period: The period [s].
        knots: Increasing from 0, shape (N + 1,).
    """

    period: float
    knots: IntArray

    @classmethod
    def near(cls, period: float, count: int, nodes: Array, intervals: int = 0) -> Ticks:
        """Knots near the nodes of a motion that is stretched to so many periods.

        Nodes that come to lie on one tick are one knot. Where that leaves fewer
        intervals than are wanted, the longest are split, as far as there are ticks.

        Args:
            period: The period [s].
            count: Number of periods of the motion.
            nodes: Times of its nodes from 0, shape (M,), in any unit.
            intervals: Number of intervals that are wanted at least.
        """
        knots = np.unique(np.rint(nodes / nodes[-1] * count).astype(np.int64))
        while knots.size - 1 < min(intervals, count):
            gaps = np.diff(knots)
            k = int(np.argmax(gaps))
            knots = np.insert(knots, k + 1, knots[k] + gaps[k] // 2)
        return cls(period, knots)

    def __str__(self) -> str:
        """Say how many there are."""
        return f"{self.intervals} intervals on {self.count} ticks of {self.period:g} s"

    @property
    def count(self) -> int:
        """Number of periods."""
        return int(self.knots[-1])

    @property
    def intervals(self) -> int:
        """Number of intervals."""
        return self.knots.size - 1

    @property
    def duration(self) -> float:
        """Time of the last knot [s]."""
        return float(self.times[-1])

    @property
    def times(self) -> Array:
        """Times of the knots [s], shape (N + 1,)."""
        return multiples(self.knots, self.period)

    @property
    def shares(self) -> Array:
        """Shares of the duration that the intervals take, shape (N, 1)."""
        return np.asarray(np.diff(self.knots) / self.count)[:, None]

    def timed(self, motion: Trajectory) -> Trajectory:
        """A motion on these knots, its nodes on the ticks to the last bit."""
        return replace(motion, t=self.times)
