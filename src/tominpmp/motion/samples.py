"""Motions as samples, with a row for each time: their times and interpolation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

import numpy as np

from tominpmp.arrays import Array, IntArray, Record, frozen_array
from tominpmp.checks import array, choice, names, wrong
from tominpmp.exceptions import brief, counted, naming

# Interpolation of samples, see the attribute of Samples.
Interpolation: TypeAlias = Literal["auto", "controller", "linear", "cubic", "quintic"]
INTERPOLATIONS = get_args(Interpolation)
# Nanoseconds in a second: the clocks of controllers count nanoseconds.
BILLION = 10**9

# Shortest last interval of a clock, in periods: in a shorter one the differences of
# rounded positions and speeds would be accelerations.
SHORTEST = 1e-3


class TimedRows(Record):
    """Base of records with joint names, and a row of numbers for each time."""

    joint_names: tuple[str, ...]
    t: Array
    segment_ends: Array | None

    def _take(self, name: str, shape: tuple[int | None, ...], content: str) -> Array:
        """Check a field as an array of numbers, and keep a read-only copy.

        Args:
            name: Name of the field.
            shape: Expected shape, as of :func:`~tominpmp.checks.array`.
            content: Description of the array in messages.

        Returns:
            The copy.
        """
        kept = frozen_array(array(getattr(self, name), name, shape, content))
        self._keep(**{name: kept})
        return kept

    def _take_rows(self, row: str, columns: str) -> None:
        """Check joint names, times, and fields with a column for each joint.

        Args:
            row: Name of a row in messages.
            columns: Names of the fields, a letter each.
        """
        self._keep(joint_names=names(self.joint_names))
        times = self._take("t", (None,), f"numbers, one time for each {row}")
        layout = f"numbers, one for each joint, in a row for each {row}"
        for name in columns:
            self._take(name, (times.size, len(self.joint_names)), layout)

    def _take_ends(self, expected: str, *, nodes: bool = False) -> None:
        """Check that the ends of segments are times in order, within the motion.

        Args:
            expected: Description of valid ends.
            nodes: Whether they have to be times of rows, up to the last.
        """
        ends = self._take("segment_ends", (None,), expected)
        valid = ends.size > 0 and bool(np.all(np.diff(ends, prepend=0.0) >= 0.0))
        valid = valid and self.t.size > 0 and bool(ends[-1] <= self.t[-1])
        if nodes and valid:
            valid = ends[-1] == self.t[-1] and bool(np.all(np.isin(ends, self.t)))
        if not valid:
            raise wrong(self.segment_ends, "segment_ends", expected)

    def _in_brief(self, row: str, span: str) -> str:
        """Show the joints, the number of rows, and their times, on one line."""
        kind, joints = type(self).__name__, brief(", ".join(self.joint_names))[1:-1]
        n, rows = counted(len(self.joint_names), "joint"), counted(self.t.size, row)
        return f"<{kind} of {n} ({joints}): {rows}, {span}>"

    @property
    def _ends(self) -> Array:
        """Ends of the segments [s]; the last time for one segment, shape (k,)."""
        return self.t[-1:] if self.segment_ends is None else self.segment_ends

    def _segments_at(self, times: Array) -> IntArray:
        """Index of the segment at each time; at an end the later segment."""
        return np.searchsorted(self._ends[:-1], times, side="right")


@dataclass(frozen=True, eq=False)
class Samples(TimedRows):
    """A trajectory sampled at many times, with a row for each time.

    Attributes:
        joint_names: Names of the joints, in column order.
        t: Times [s], shape (m,).
        q: Positions [rad or m], shape (m, n).
        v: Velocities [rad/s or m/s], shape (m, n).
        a: Accelerations [rad/s^2 or m/s^2], shape (m, n).
        u: Torques [N m or N], shape (m, n).
        interpolation: Interpolation between the times: "controller" joins samples like
            ROS's joint trajectory controller, by straight lines if there are only
            positions, by cubics with velocities, by polynomials of degree 5 with
            accelerations; "linear", "cubic" and "quintic" select one of the three;
            "auto" recovers the motion from which the samples were taken, see
            :mod:`~tominpmp.motion.joining`.
        segment_ends: Times at which the segments of the motion end [s], in order, with
            two equal times where a segment takes no time, shape (k,); None for one
            segment, or if the ends are not known. Ends from a file may be late by the
            time between two rows.
    """

    joint_names: tuple[str, ...]
    t: Array
    q: Array
    v: Array
    a: Array
    u: Array
    interpolation: Interpolation = "auto"
    segment_ends: Array | None = None

    def __post_init__(self) -> None:
        """Check the shapes and make the arrays read-only."""
        with naming("samples"):
            self._take_rows("time", "qvau")
            if self.segment_ends is not None:
                self._take_ends("times in order, up to that of the last row")
        choice(self.interpolation, INTERPOLATIONS, "interpolation")

    @property
    def segment_numbers(self) -> IntArray:
        """Number of the segment of each row, from 1; at an end the later segment."""
        return 1 + self._segments_at(self.t)

    def __repr__(self) -> str:
        """Show joints, rows and times on one line."""
        span = f"{self.t[0]:g} to {self.t[-1]:g} s" if self.t.size else "none"
        return self._in_brief("row", span)


def clock(duration: float, period: float) -> Array:
    """Times of a clock over a motion [s]: 0, period, 2 period, ..., duration.

    Each time is a multiple of the period, not a sum of periods, and a whole number of
    nanoseconds if the period is: the number that a user would type. If the duration is
    no multiple of the period, the last interval is shorter, or up to SHORTEST longer.
    """
    count = int(np.ceil(duration / period * (1.0 - 1e-9) - SHORTEST))
    count = max(count, int(duration > 0.0))
    return np.append(multiples(np.arange(count), period), duration)


def multiples(ticks: Array | IntArray, period: float) -> Array:
    """Times of clock ticks [s], shape (m,); whole nanoseconds if the period is."""
    # For a longer period a double cannot hold the nanoseconds, or overflows.
    whole = round(period * BILLION) if period < BILLION else 0
    if whole > 0 and whole / BILLION == period:
        return np.asarray(ticks * float(whole) / BILLION)
    return np.asarray(ticks * period, dtype=np.float64)


def subdivided(nodes: Array, time_step: float) -> Array:
    """Subdivide the intervals between nodes into equal parts.

    Args:
        nodes: Times of the nodes [s], increasing, shape (N + 1,).
        time_step: Largest time between two of the resulting times [s].

    Returns:
        The nodes and the times between them [s].
    """
    counts = np.maximum(np.ceil(np.diff(nodes) / time_step - 1e-9), 1.0)
    places = np.append(0.0, np.cumsum(counts))
    return np.interp(np.arange(places[-1] + 1.0), places, nodes)
