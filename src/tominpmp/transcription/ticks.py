"""Knots on the clock of a controller, and programs whose duration is bounded below.

A controller takes a motion as samples at its period and joins them by polynomials:
cubic ones through positions and velocities, of degree 5 through accelerations too. A
motion that is a polynomial of such a degree between ticks is joined exactly, so that
what was planned is what is run. That is so if all knots are ticks.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.sampling import multiples
from tominpmp.trajectory import Trajectory
from tominpmp.transcription.base import Linearization, Rows, StepBounds, Variation
from tominpmp.transcription.exchange import exchanged
from tominpmp.transcription.program import NonlinearProgram

# Durations that are a multiple of the period but for this share of it are one.
ROUNDING = 1e-6
# Interior-point solvers leave the duration a trace above its bound: by up to this share
# of it, it is the bound.
TRACE = 1e-6


def ticks_of(duration: float, period: float) -> int:
    """Least number of periods that last as long as a duration, up to rounding."""
    return int(np.ceil(duration / period - ROUNDING))


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


@dataclass(frozen=True, eq=False)
class ClockedTranscription:
    """A program on ticks, whose duration must not fall below that of the ticks.

    Once the duration is there the iteration has nothing left to gain but quiet
    controls, and any iterate that keeps the constraints will do.

    Attributes:
        inner: The program, with the duration as its last unknown.
        ticks: The knots.
    """

    inner: NonlinearProgram
    ticks: Ticks

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return self.inner.size

    @property
    def rows(self) -> Rows:
        """What the rows are."""
        return self.inner.rows

    @property
    def cost(self) -> Array:
        """Gradient of the duration."""
        return self.inner.cost

    def timed(self, z: Array) -> Array:
        """An iterate with the duration of the ticks, where it is that but for a trace.

        Rows are evaluated there, so that constraints hold in the time that there is.
        """
        T = self.ticks.duration
        if abs(z[-1] - T) > TRACE * T:
            return z
        return np.append(z[:-1], T)

    def evaluate(self, z: Array) -> Array:
        """Row values."""
        return self.inner.evaluate(self.timed(z))

    def linearize(self, z: Array, values: Array, steps: StepBounds) -> Linearization:
        """Jacobian of the rows that can become active within a box of steps."""
        return self.inner.linearize(self.timed(z), values, steps)

    def step_bounds(self, z: Array, radius: float) -> StepBounds:
        """Trust region, with the duration at that of the ticks or above."""
        bounds = self.inner.step_bounds(z, radius)
        lower = bounds.lower.copy()
        lower[-1] = min(max(lower[-1], self.ticks.duration - z[-1]), 0.0)
        return bounds._replace(lower=lower)

    def near(self, z: Array) -> ClockedTranscription:
        """The same."""
        return self

    def variation(self, z: Array) -> Variation:
        """Differences of the controls."""
        return self.inner.variation(z)

    def stretch(self, z: Array, factor: float) -> Array:
        """The same path, slower by a factor."""
        return self.inner.stretch(z, factor)

    def on_clock(self, z: Array) -> Array | None:
        """The iterate with the duration of the ticks; None if it is slower."""
        timed = self.timed(z)
        return timed if timed[-1] == self.ticks.duration else None

    def with_more_rows(self, z: Array, room: float) -> ClockedTranscription | None:
        """The same with rows where an iterate breaks its limits between the rows.

        Args:
            z: The iterate.
            room: Relative excess of torques that is let pass; below zero, room that is
                let pass.

        Returns:
            The program; None if there is no need of more rows.
        """
        more = exchanged(self.inner, z, room)
        return None if more is None else replace(self, inner=more)

    def trajectory(self, z: Array) -> Trajectory:
        """The motion of an iterate."""
        return self.inner.trajectory(z)
