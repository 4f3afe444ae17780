"""Checks that hold for every constraint along a motion."""

from __future__ import annotations

import numpy as np
import pytest


def check_terms_against_differences(item, count: int, size: float) -> None:
    """Derivatives of the rows of a constraint on a robot of six joints.

    Args:
        item: The constraint, on its robot.
        count: Number of random states.
        size: Error that is let pass, relative to the largest derivative or one.
    """
    rng, step = np.random.default_rng(4), 1e-6
    for _ in range(count):
        state = [rng.uniform(-2, 2, 6) for _ in range(3)]
        values, *parts = item.terms(*state)
        assert values.shape == (item.count,)
        for place, part in enumerate(parts):
            if place > item.order:
                assert part.size == 0 or not np.any(part)
                continue
            for j in range(6):
                ends = []
                for sign in (1.0, -1.0):
                    moved = [x.copy() for x in state]
                    moved[place][j] += sign * step
                    ends.append(item.terms(*moved)[0])
                slope = (ends[0] - ends[1]) / (2 * step)
                most = max(1.0, float(np.abs(slope).max()))
                assert part[:, j] == pytest.approx(slope, abs=size * most)
