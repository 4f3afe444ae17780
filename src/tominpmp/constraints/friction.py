r"""Directions of joints with dry friction at the instants of torque rows.

The torque of a motor is :math:`w + F s` with the torque w without friction, which is a
smooth function of the motion, and the sign s of the velocity. A program is solved with
given signs, so that it is as smooth as without friction; then they are compared with
the signs of the motion, and where they differ and affect a limit the program is solved
once more. A joint whose sign differs again reverses there: its rows then hold for both
directions, which is conservative.

The friction of a joint at rest is not counted on: its motor is to hold the joint alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tominpmp.arrays import Array, BoolArray, IntArray
from tominpmp.dynamics import STANDSTILL

# Loads this close to their limits may depend on the sign.
NEAR = 1e-2
# Tolerated relative excess of torques between the rows.
EFFORT_TOLERANCE = 2e-3
# After this number of changes of a sign, its row holds for both directions.
TURNS = 2


@dataclass(frozen=True, eq=False)
class Ways:
    """Signs of the velocities at m instants.

    Attributes:
        friction: Dry friction of the joints in shares of their torque limits, shape
            (n,).
        sign: Assumed signs, 0 for joints at rest or both directions, shape (m, n).
        both: Whether rows hold for both directions, shape (m, n).
        turns: Number of changes of each assumed sign, shape (m, n).
    """

    friction: Array
    sign: Array
    both: BoolArray
    turns: IntArray

    @classmethod
    def of(cls, friction: Array, sign: Array) -> Ways:
        """Assume signs."""
        none = np.zeros(sign.shape, dtype=np.int64)
        return cls(friction, sign, none.astype(bool), none)

    @property
    def load(self) -> Array:
        """Torques of dry friction, in shares of their limits, shape (m, n)."""
        return self.friction * self.sign

    @property
    def bound(self) -> Array:
        """Largest share of the torque limits, shape (m, n)."""
        return np.maximum(1.0 - np.where(self.both, self.friction, 0.0), 0.0)

    @property
    def lower(self) -> Array:
        """Lower bounds of torques without friction, as shares, shape (m, n)."""
        return -self.bound - self.load

    @property
    def upper(self) -> Array:
        """Upper bounds of torques without friction, as shares, shape (m, n)."""
        return self.bound - self.load

    def wrong(self, sign: Array, share: Array, effort_tolerance: float) -> BoolArray:
        """Whether other signs affect a torque limit, shape (m, n).

        Args:
            sign: Signs of the motion, shape (m, n).
            share: Torques without friction as shares of their limits, shape (m, n).
            effort_tolerance: Tolerated relative excess of torques.
        """
        apart = (sign != self.sign) & ~self.both & (self.friction > 0.0)
        beyond = np.abs(share + self.friction * sign) > 1.0 + effort_tolerance
        bound = np.abs(share + self.load) > 1.0 - NEAR
        return np.asarray(apart & (beyond | bound))

    def turned(self, sign: Array, wrong: BoolArray) -> Ways:
        """Take over the signs of a motion, and both where they keep changing."""
        turns = self.turns + wrong
        both = self.both | (turns >= TURNS)
        return Ways(self.friction, np.where(both, 0.0, sign), both, turns)

    def joined(self, other: Ways) -> Ways:
        """These instants and others."""
        return Ways(
            self.friction,
            np.concatenate([self.sign, other.sign]),
            np.concatenate([self.both, other.both]),
            np.concatenate([self.turns, other.turns]),
        )


def signs(v: Array, beside: Array) -> Array:
    """Signs of velocities at instants, shape (m, n).

    Where a joint stops, velocities near the instants decide.
    """
    still = np.abs(v) <= STANDSTILL
    aside = np.where(np.abs(beside) > STANDSTILL, np.sign(beside), 0.0)
    return np.where(still, aside, np.sign(v))


def interval_signs(v: Array) -> tuple[Array, BoolArray]:
    """Signs on intervals, 0 where they change within, and whether they do, (N, n) each.

    Args:
        v: Velocities at the nodes, shape (N + 1, n) [rad/s or m/s].
    """
    first, last = signs(v[:-1], v[1:]), signs(v[1:], v[:-1])
    change = first * last < 0.0
    return np.where(change, 0.0, first), change
