"""Rows of programs that tests make without constraints."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from tominpmp.transcription.base import Rows


def stacked(parts: Sequence[tuple[str, Any, Any, Any]]) -> Rows:
    """Join blocks of rows.

    Args:
        parts: For each block, the name of its kind, the lower and upper bounds, and the
            groups, which are counted from 0 within each block.
    """
    kinds, lower, upper, groups = zip(*parts, strict=True)
    first = np.cumsum([0, *(max(group, default=-1) + 1 for group in groups)])
    own = [begin + np.array(group) for begin, group in zip(first, groups, strict=False)]
    return Rows(
        np.concatenate(lower, dtype=float),
        np.concatenate(upper, dtype=float),
        np.repeat(np.arange(len(kinds)), list(map(len, groups))),
        np.concatenate(own).astype(int),
        kinds,
    )
