"""Time grids: shares of the duration."""

from __future__ import annotations

import numpy as np

from tominpmp.arrays import Array


def interval_shares(kind: str, intervals: int) -> Array:
    """Shares of the duration that the intervals take.

    Fast joints want to change speed at once when a motion begins and ends; with one
    acceleration an interval a uniform grid makes such a motion longer by about one
    interval, 1/(N - 1). The cosine grid has short intervals at both ends.

    Args:
        kind: "uniform" or "cosine" (nodes at (1 - cos(pi k / N)) / 2).
        intervals: Number N of intervals.

    Returns:
        Shares that add up to 1, shape (N, 1).
    """
    nodes = np.linspace(0.0, 1.0, intervals + 1)
    if kind == "cosine":
        nodes = 0.5 * (1.0 - np.cos(np.pi * nodes))
    return np.asarray(np.diff(nodes))[:, None]
