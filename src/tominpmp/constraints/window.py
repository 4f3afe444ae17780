"""Time windows: when a constraint holds, in seconds from the start of a motion.

Rows of such a constraint stand at times, not at shares of the motion: they remain where
they are when its duration changes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, TypeAlias

import numpy as np

from tominpmp.arrays import Array, BoolArray, pair_or_nan
from tominpmp.checks import wrong

# Rows to begin with, at least and at most, and how far apart they are [s]: what passes
# between two of them may be pushed to the other side by one that is put in later.
FIRST_TIMES, MOST_TIMES, FIRST_STEP = 21, 401, 0.1
# Times closer than this are one [s].
SAME = 1e-6


@dataclass(frozen=True, eq=False)
class Window:
    """From when until when a constraint holds.

    A motion that ends before is taken to rest at its goal until then, where the
    constraint is to hold, too.

    Attributes:
        begin: When it begins to hold [s].
        end: When it ends to hold [s]; infinity for never.
        times: Times of its rows [s], ascending, shape (k,).
    """

    begin: float
    end: float
    times: Array

    @classmethod
    def of(cls, during: tuple[float, float] | None) -> Window | None:
        """The window of checked times; None for all the time."""
        if during is None:
            return None
        begin, end = during
        last = end if np.isfinite(end) else begin + FIRST_STEP * (FIRST_TIMES - 1)
        asked = 1 + np.ceil((last - begin) / FIRST_STEP)
        count = int(np.clip(asked, FIRST_TIMES, MOST_TIMES))
        return cls(begin, end, np.linspace(begin, last, count))

    def asked(self, t: Array) -> BoolArray:
        """Whether it holds at times of a motion, shape (m,)."""
        return np.asarray((t >= self.begin - SAME) & (t <= self.end + SAME))

    def with_times(self, more: Array) -> Window:
        """The same with more rows."""
        times = np.unique(np.concatenate([self.times, more]))
        apart = np.concatenate([[True], np.diff(times) > SAME])
        return replace(self, times=times[apart])


def checked_during(given: object, name: str = "during") -> tuple[float, float] | None:
    """Check a caller's times.

    Raises:
        ProblemError: If they are none.
    """
    if given is None:
        return None
    begin, end = pair_or_nan(given)
    if not (0.0 <= begin < np.inf and begin < end):
        expected = "two times (begin, end) from the start of the motion, in order [s]"
        raise wrong(given, name, f"{expected}; the end may be infinite")
    return begin, end


#: The type of the field of a constraint that says when it holds.
TimesOrNone: TypeAlias = Annotated[tuple[float, float] | None, checked_during]
