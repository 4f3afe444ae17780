r"""Which way joints with dry friction move at the instants of torque rows.

The torque of a motor is :math:`w + F s` with the torque w that friction leaves, which
is a smooth function of the motion, and the sign s of the velocity. A program is solved
with signs that are given, so that it is as smooth as without friction; then they are
compared with those of the motion, and where they differ and matter the program is
solved once more. A joint whose sign differs again turns there: its rows then hold for
either way, which is never too little.

A joint that rests is not helped by its friction: its motor is to hold it alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tominpmp.arrays import Array, BoolArray, IntArray
from tominpmp.dynamics import STANDSTILL

# Loads this close to their limits would change if the sign did.
NEAR = 1e-2
# Relative excess of torques between the rows that is let pass.
OVERLOAD = 2e-3
# Signs that change this often are taken either way.
TURNS = 2


@dataclass(frozen=True, eq=False)
class Ways:
    """Signs of the velocities at m instants.

    Attributes:
        friction: Dry friction of the joints in shares of their torque limits, shape
            (n,).
        sign: Assumed signs, 0 for joints at rest or either way, shape (m, n).
        both: Where rows hold for either way, shape (m, n).
        turns: How often an assumption was wrong, shape (m, n).
    """

    friction: Array
    sign: Array
    both: BoolArray
    turns: IntArray

    @classmethod
    def of(cls, friction: Array, sign: Array) -> Ways:
        """Take signs for granted."""
        none = np.zeros(sign.shape, dtype=np.int64)
        return cls(friction, sign, none.astype(bool), none)

    @property
    def load(self) -> Array:
        """What friction adds to torques, in shares of their limits, shape (m, n)."""
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

    def wrong(self, sign: Array, share: Array, overload: float) -> BoolArray:
        """Where other signs make a difference, shape (m, n).

        Args:
            sign: Signs of the motion, shape (m, n).
            share: Torques without friction as shares of their limits, shape (m, n).
            overload: Relative excess of torques that is let pass.
        """
        apart = (sign != self.sign) & ~self.both & (self.friction > 0.0)
        beyond = np.abs(share + self.friction * sign) > 1.0 + overload
        bound = np.abs(share + self.load) > 1.0 - NEAR
        return np.asarray(apart & (beyond | bound))

    def turned(self, sign: Array, wrong: BoolArray) -> Ways:
        """Take over the signs of a motion, but where they keep changing either."""
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

    Velocities a little aside of them count where a joint stops.
    """
    still = np.abs(v) <= STANDSTILL
    aside = np.where(np.abs(beside) > STANDSTILL, np.sign(beside), 0.0)
    return np.where(still, aside, np.sign(v))


def interval_signs(v: Array) -> tuple[Array, BoolArray]:
    """Signs on intervals, 0 where they change within, and whether they do, (N, n) each.

    From the velocities at the nodes, shape (N + 1, n) [rad/s or m/s].
    """
    first, last = signs(v[:-1], v[1:]), signs(v[1:], v[:-1])
    change = first * last < 0.0
    return np.where(change, 0.0, first), change
