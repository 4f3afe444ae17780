"""Motions as samples, one row a time: their times and their interpolation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from tominpmp.arrays import Array, IntArray, Record, real_array
from tominpmp.checks import choice, names, wrong
from tominpmp.exceptions import ProblemError, brief, naming

# Interpolation of samples, see Samples.
Interpolation: TypeAlias = Literal["auto", "controller", "linear", "cubic", "quintic"]
INTERPOLATIONS = ("auto", "controller", "linear", "cubic", "quintic")
# Nanoseconds in a second: clocks of controllers count them.
BILLION = 10**9


class TimedRows(Record):
    """Base of records that have names of joints, and a row of numbers a time."""

    joint_names: tuple[str, ...]
    t: Array
    segment_ends: Array | None

    def _take(
        self, name: str, called: str, shape: tuple[int, ...] | None = None, of: str = ""
    ) -> Array:
        """Check a field as an array of numbers, of a shape described in words."""
        value, field_name = getattr(self, name), called.format(name)
        try:
            found = real_array(value)
        except ValueError as error:
            message = f"{field_name} is {brief(value)}, expected numbers"
            raise ProblemError(message, name) from error
        if shape is not None and found.shape != shape:
            message = f"{field_name} has shape {found.shape}, expected {shape}: {of}"
            raise ProblemError(message, name)
        self._keep(**{name: found})
        return found

    def _take_rows(self, called: str, row: str, columns: str) -> None:
        """Check names of joints, times, and fields with a column for each joint."""
        self._keep(joint_names=names(self.joint_names))
        times = self._take("t", called).ravel().size
        self._take("t", called, (times,), f"one time for each {row}")
        layout = f"one row a {row}, one column a joint"
        for name in columns:
            self._take(name, called, (times, len(self.joint_names)), layout)

    def _segments_at(self, times: Array) -> IntArray:
        """Index of the segment at times, the later segment at an end."""
        if self.segment_ends is None:
            return np.zeros(times.size, dtype=np.int64)
        return np.searchsorted(self.segment_ends[:-1], times, side="right")


@dataclass(frozen=True, eq=False)
class Samples(TimedRows):
    """A trajectory sampled at many times, one row a time.

    Attributes:
        joint_names: Names of the joints, in column order.
        t: Times [s], shape (m,).
        q: Positions [rad or m], shape (m, n).
        v: Velocities [rad/s or m/s], shape (m, n).
        a: Accelerations [rad/s^2 or m/s^2], shape (m, n).
        u: Torques [N m or N], shape (m, n).
        interpolation: Interpolation between their times: "controller" joins them as
            ROS's joint trajectory controller does, by straight lines where there are
            positions only, by cubics with velocities, by polynomials of degree 5 with
            accelerations; these three may be named too; "auto" recovers the motion that
            they were sampled from, see :mod:`~tominpmp.motion.joining`.
        segment_ends: Times at which the segments of the motion end [s], in order, two
            of them equal where a segment takes no time, shape (k,); None for one
            segment, or where the ends are not known. Ends from a file may be late by
            the time between two rows.
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
        self._take_rows("samples: {}", "time", "qvau")
        check_interpolation(self.interpolation)
        if self.segment_ends is not None:
            self._check_segments()

    def _check_segments(self) -> None:
        ends = self._take("segment_ends", "samples: {}")
        listed = ends.ndim == 1 and ends.size > 0 and self.t.size > 0
        rising = listed and bool(np.all(np.diff(ends, prepend=0.0) >= 0.0))
        if not (rising and ends[-1] <= self.t[-1]):
            expected = "times in order, up to that of the last row"
            with naming("samples"):
                raise wrong(self.segment_ends, "segment_ends", expected)

    @property
    def segment_numbers(self) -> IntArray:
        """Number of the segment of each row, from 1; the later segment at an end."""
        return 1 + self._segments_at(self.t)

    def __repr__(self) -> str:
        """Joints, rows and times, on one line."""
        joints = brief(", ".join(self.joint_names))[1:-1]
        span = f"{self.t[0]:g} to {self.t[-1]:g} s" if self.t.size else "none"
        return (
            f"<Samples of {len(self.joint_names)} joints ({joints}): {self.t.size} "
            f"rows, {span}>"
        )


def check_interpolation(name: object) -> None:
    """Check the name of an interpolation of samples.

    Raises:
        ProblemError: If no interpolation has that name.
    """
    choice(name, INTERPOLATIONS, "interpolation")


def clock(duration: float, period: float) -> Array:
    """Times of a clock over a motion [s]: 0, period, 2 period, ..., duration.

    Each is the multiple itself, not a sum of periods, and of whole nanoseconds where
    the period is: the number that one would type. The last interval is shorter where
    the duration is no multiple.
    """
    count = int(np.ceil(duration / period * (1.0 - 1e-9)))
    return np.append(multiples(np.arange(count), period), duration)


def multiples(ticks: Array | IntArray, period: float) -> Array:
    """Times of ticks, shape (m,) [s]: of whole nanoseconds where the period is."""
    # For a longer period a double cannot hold the nanoseconds, or overflows.
    whole = round(period * BILLION) if period < BILLION else 0
    if whole > 0 and whole / BILLION == period:
        return np.asarray(ticks * float(whole) / BILLION)
    return np.asarray(ticks * period, dtype=np.float64)
