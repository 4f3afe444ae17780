"""Least time of an arm with two joints: the longest time that no motion takes."""

from __future__ import annotations

import math

from tominpmp.bounds.narrowing import Halfway, Narrowing
from tominpmp.bounds.two_joints import TwoJoints
from tominpmp.stopping import check

# Steps of the search for the time.
BISECTIONS = 8
# How much longer times are that are looked at with ranges halfway, at first and at
# last, how many ranges, and how often one is cut in halves at most.
FIRST_STRIDE = 1.16
LAST_STRIDE = 1.02
MOST_PARTS = 60
MOST_SPLITS = 8
# Longest time looked at [s].
LONGEST = 1e4
# Relative rounding, and errors of quadrature, that are granted.
ROUNDING = 1e-5


def two_joints_time(arm: TwoJoints, *, quick: bool = False) -> float:
    """Time that no motion can beat, or a little less.

    Args:
        arm: The arm.
        quick: Whether not to tell motions apart by where they are halfway.
    """
    low, high = 0.0, 1e-2
    while excluded(arm, high):
        low, high = high, 2.0 * high
        if high > LONGEST:
            return low
    for _ in range(BISECTIONS):
        T = 0.5 * (low + high)
        low, high = (T, high) if excluded(arm, T) else (low, T)
    # Beyond that, motions are told apart by where they are halfway.
    stride = 1.0 if quick else FIRST_STRIDE
    while low > 0.0 and stride > LAST_STRIDE:
        if excluded(arm, stride * low, MOST_PARTS):
            low *= stride
        else:
            stride = math.sqrt(stride)
    return low * (1.0 - ROUNDING)


def excluded(arm: TwoJoints, T: float, parts: int = 1) -> bool:
    """Whether no motion takes so little time, nor less.

    All bounds allow to wait, so that shorter motions are among the longer ones.

    Args:
        arm: The arm.
        T: The time.
        parts: How many ranges of the state halfway are looked at one by one.
    """
    left = [Halfway()]
    for _ in range(parts):
        check()
        halfway = left.pop()
        narrowing = Narrowing(arm, T, halfway)
        if not narrowing.empty():
            if parts == 1 or halfway.splits >= MOST_SPLITS:
                return False
            left += narrowing.split()
        if not left:
            return True
    return False
