"""Instants beside those at which joints with dry friction turn.

The torque of such a joint jumps there, by twice its friction. Where it turns inside an
interval the torque may be largest just then, between all rows.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tominpmp.arrays import BoolArray
from tominpmp.transcription.base import Motion, Transcription
from tominpmp.transcription.instants import Instants

# Velocities are looked at so often an interval.
LOOKS = 8
# How far beside a turn torques are looked at, in shares of the interval.
BESIDE = 0.02


def turning(
    of: Transcription[Any], motion: Motion, joints: BoolArray, within: tuple[int, int]
) -> Instants:
    """Instants before and after each turn, the same for joints that turn together.

    Args:
        of: The parameterisation.
        motion: The motion.
        joints: Which joints have dry friction, shape (n,).
        within: First interval that is looked at, and the one after the last.
    """
    first, end = within
    shares = np.linspace(0.0, 1.0, LOOKS + 1)
    at = Instants.spread(of.intervals, shares.tolist()).within(first, end)
    v = of.states(motion, at, 1).v[:, joints].reshape(end - first, LOOKS + 1, -1)
    before, after = v[:, :-1], v[:, 1:]
    interval, look, joint = np.nonzero(before * after < 0.0)
    v0, v1 = before[interval, look, joint], after[interval, look, joint]
    # A velocity is all but linear over so short a time.
    share = (look + v0 / (v0 - v1)) / LOOKS
    beside = np.concatenate([share - BESIDE, share + BESIDE])
    found = np.stack([np.tile(first + interval, 2), np.clip(beside, 0.0, 1.0)], axis=1)
    found = np.unique(found, axis=0)
    return Instants(found[:, 0].astype(np.int64), found[:, 1])
