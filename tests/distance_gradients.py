"""Gradients of distances, or of clearances, at one configuration."""

from __future__ import annotations

import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.collision.checker import CollisionChecker
from tominpmp.constraints.clearance import ClearanceConstraint


def gradients(
    of: CollisionChecker | ClearanceConstraint, q: Array, pairs: IntArray
) -> Array:
    """Gradients of the distances of some pairs at a configuration, shape (k, n)."""
    first = np.zeros(pairs.size, dtype=np.int64)
    return of.derivatives_at(q[None], first, pairs).gradients
