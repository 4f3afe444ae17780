"""Numbers and names as people read them, and as lines of Python have them.

Numbers are rounded where they are set, so that the lines are short and exact.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

# Digits after the point of positions [m] and of configurations [rad or m].
DIGITS = 4


def rounded(values: ArrayLike, digits: int = DIGITS) -> Any:
    """Numbers of Python with so many digits after the point, as a tuple."""
    numbers = np.round(np.asarray(values, dtype=np.float64).ravel(), digits) + 0.0
    return tuple(numbers.tolist())


def tuple_text(values: Iterable[float]) -> str:
    """Numbers as a tuple of Python."""
    found = ", ".join(repr(value) for value in values)
    return f"({found})" if "," in found else f"({found},)"


def list_text(values: Iterable[float]) -> str:
    """Numbers as a list of Python."""
    return f"[{', '.join(repr(value) for value in values)}]"


def plain_name(name: str) -> str:
    """A name that any file system takes."""
    plain = "".join(c if c.isalnum() or c in "-_" else "_" for c in name)
    return plain[:60] or "robot"
