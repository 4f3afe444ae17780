"""At which times a motion is sampled, and how samples are joined again."""

from __future__ import annotations

from typing import Literal, TypeAlias

import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.checks import choice

# How samples are joined, see Samples in tominpmp.trajectory.
Interpolation: TypeAlias = Literal["auto", "controller", "linear", "cubic", "quintic"]
INTERPOLATIONS = ("auto", "controller", "linear", "cubic", "quintic")
# Nanoseconds in a second: clocks of controllers count them.
BILLION = 10**9


def check_interpolation(name: object) -> None:
    """Check the name of a way to join samples.

    Raises:
        ProblemError: If there is none of that name.
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
    # Of a period as long as this no double knows the nanoseconds, or it overflows.
    whole = round(period * BILLION) if period < BILLION else 0
    if whole > 0 and whole / BILLION == period:
        return np.asarray(ticks * float(whole) / BILLION)
    return np.asarray(ticks * period, dtype=np.float64)
