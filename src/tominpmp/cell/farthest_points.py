"""Farthest-point sampling: few points that are spread over all."""

from __future__ import annotations

import numpy as np

from tominpmp.arrays import Array, IntArray


def spread_out(rows: Array, first: int, count: int, norm: float) -> IntArray:
    """Farthest-point sampling: each row is as far as possible from all before it.

    Args:
        rows: The rows, shape (m, n).
        first: Index of the first one.
        count: Number of rows to choose, m at most.
        norm: Order of the norm that measures distances.

    Returns:
        Indices of the chosen rows, in the order of the choice.
    """
    chosen, away = [first], np.full(len(rows), np.inf)
    while len(chosen) < count:
        apart = np.linalg.norm(rows - rows[chosen[-1]], norm, axis=1)
        away = np.minimum(away, apart)
        away[chosen] = -1.0
        chosen.append(int(np.argmax(away)))
    return np.array(chosen)
