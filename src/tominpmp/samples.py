"""Motions as samples: one row a time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tominpmp.arrays import Array, IntArray, Record, real_array
from tominpmp.checks import wrong
from tominpmp.exceptions import ProblemError, brief, told_of
from tominpmp.sampling import Interpolation, check_interpolation


def names(value: Any, called: str = "joint_names") -> tuple[str, ...]:
    """Names of joints as a tuple, if they are names, each its own."""
    listed = isinstance(value, Sequence | np.ndarray) and not isinstance(value, str)
    listed = listed and not (isinstance(value, np.ndarray) and value.ndim == 0)
    good = listed and all(isinstance(name, str) and name for name in value)
    names = tuple(str(name) for name in value) if good else ()
    if not names or len(set(names)) < len(names):
        raise wrong(value, called, "names of joints, each its own")
    return names


def _called(record: Any, name: str) -> str:
    whole = not isinstance(record, Samples)
    return f"trajectory field {name!r}" if whole else f"samples: {name}"


def numbers(name: str, record: Any) -> Array:
    """A field of samples or a trajectory as an array of numbers."""
    value = getattr(record, name)
    try:
        return real_array(value)
    except ValueError as error:
        raise ProblemError(
            f"{_called(record, name)} is {brief(value)}, expected numbers", name
        ) from error


def check_shape(
    record: Any,
    name: str,
    shape: tuple[int, ...],
    layout: str,
) -> None:
    """Check the shape of a field of samples or a trajectory."""
    found = getattr(record, name).shape
    if found != shape:
        raise ProblemError(
            f"{_called(record, name)} has shape {found}, expected {shape}: {layout}",
            name,
        )


@dataclass(frozen=True, eq=False)
class Samples(Record):
    """A trajectory sampled at many times, one row a time.

    Attributes:
        joint_names: Names of the joints, in column order.
        t: Times [s], shape (m,).
        q: Positions [rad or m], shape (m, n).
        v: Velocities [rad/s or m/s], shape (m, n).
        a: Accelerations [rad/s^2 or m/s^2], shape (m, n).
        u: Torques [N m or N], shape (m, n).
        interpolation: What becomes of them between their times: "controller" joins them
            as ROS's joint trajectory controller does, by straight lines where there are
            positions only, by cubics with velocities, by polynomials of degree 5 with
            accelerations; these three may be named too; "auto" looks for the motion
            that they were taken from, see :mod:`~tominpmp.sampled_motion`.
        segment_ends: Times at which the segments of the motion end [s], in order, two
            of them the same where a segment takes no time, shape (k,); None for one
            segment, or where that is not known. What was taken from a file may be late
            by the time between two rows.
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
        object.__setattr__(self, "joint_names", names(self.joint_names))
        for name in ("t", "q", "v", "a", "u"):
            object.__setattr__(self, name, numbers(name, self))
        rows, n = self.t.size, len(self.joint_names)
        check_shape(self, "t", (rows,), "one time a row")
        for name in ("q", "v", "a", "u"):
            layout = "one row a time, one column a joint"
            check_shape(self, name, (rows, n), layout)
        check_interpolation(self.interpolation)
        if self.segment_ends is not None:
            self._check_segments()

    def _check_segments(self) -> None:
        object.__setattr__(self, "segment_ends", numbers("segment_ends", self))
        ends = np.asarray(self.segment_ends)
        listed = ends.ndim == 1 and ends.size > 0 and self.t.size > 0
        rising = listed and bool(np.all(np.diff(ends, prepend=0.0) >= 0.0))
        if not (rising and ends[-1] <= self.t[-1]):
            expected = "times in order, up to that of the last row"
            with told_of("samples"):
                raise wrong(self.segment_ends, "segment_ends", expected)

    @property
    def segment_numbers(self) -> IntArray:
        """Number of the segment of each row, from 1; the later one where one ends."""
        if self.segment_ends is None:
            return np.ones(self.t.size, dtype=np.int64)
        return 1 + np.searchsorted(self.segment_ends[:-1], self.t, side="right")

    def __repr__(self) -> str:
        """Joints, rows and times, on one line."""
        joints = brief(", ".join(self.joint_names))[1:-1]
        span = f"{self.t[0]:g} to {self.t[-1]:g} s" if self.t.size else "none"
        return (
            f"<Samples of {len(self.joint_names)} joints ({joints}): {self.t.size} "
            f"rows, {span}>"
        )
