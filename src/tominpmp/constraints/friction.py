r"""Velocity signs of joints with dry friction at the instants of torque rows.

The torque of a motor is :math:`w + F s` with the torque w without friction, which is a
smooth function of the motion, and the sign s of the velocity. A program is solved with
assumed signs, so that it is as smooth as without friction. Then the assumed signs are
compared with the signs of the motion, and if they differ and affect a limit, the
program is solved once more. A joint whose sign differs repeatedly reverses there: its
rows then hold for both signs, which is conservative.

Friction does not help to hold a joint at rest: its motor must be able to hold it alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tominpmp.arrays import Array, BoolArray, IntArray
from tominpmp.dynamics import STANDSTILL

# The sign matters to torques this close to their limits, as shares of the limits.
NEAR = 1e-2
# Tolerated relative excess of torques over their limits between the rows.
EFFORT_TOLERANCE = 2e-3
# Number of changes of an assumed sign from which its row holds for both signs.
MOST_CHANGES = 2


@dataclass(frozen=True, eq=False)
class Signs:
    """Assumed velocity signs of joints with dry friction at m instants.

    Attributes:
        friction: Dry friction of the joints as shares of their torque limits, shape
            (n,).
        sign: Assumed signs, 0 for joints at rest or for both signs, shape (m, n).
        both: Whether rows hold for both signs, shape (m, n).
        changes: Number of changes of each assumed sign, shape (m, n).
    """

    friction: Array
    sign: Array
    both: BoolArray
    changes: IntArray

    @classmethod
    def of(cls, friction: Array, sign: Array) -> Signs:
        """Initial assumption, without changes."""
        changes = np.zeros(sign.shape, dtype=np.int64)
        return cls(friction, sign, changes.astype(bool), changes)

    @property
    def load(self) -> Array:
        """Torques of dry friction, as shares of the limits, shape (m, n)."""
        return self.friction * self.sign

    @property
    def bound(self) -> Array:
        """Bound of the motor torques, as a share of the limits, shape (m, n)."""
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
        """Whether assumed signs are wrong and affect a torque limit, shape (m, n).

        Args:
            sign: Signs of the motion, shape (m, n).
            share: Torques without friction as shares of their limits, shape (m, n).
            effort_tolerance: Tolerated relative excess of torques.
        """
        apart = (sign != self.sign) & ~self.both & (self.friction > 0.0)
        beyond = np.abs(share + self.friction * sign) > 1.0 + effort_tolerance
        bound = np.abs(share + self.load) > 1.0 - NEAR
        return np.asarray(apart & (beyond | bound))

    def corrected(self, sign: Array, wrong: BoolArray) -> Signs:
        """Adopt the signs of a motion; both signs for joints that keep reversing.

        Args:
            sign: Signs of the motion, shape (m, n).
            wrong: Whether each assumed sign is wrong, shape (m, n).
        """
        changes = self.changes + wrong
        both = self.both | (changes >= MOST_CHANGES)
        return Signs(self.friction, np.where(both, 0.0, sign), both, changes)

    def joined(self, other: Signs) -> Signs:
        """The assumptions at these instants, followed by other instants."""
        return Signs(
            self.friction,
            np.concatenate([self.sign, other.sign]),
            np.concatenate([self.both, other.both]),
            np.concatenate([self.changes, other.changes]),
        )


def velocity_signs(v: Array, nearby: Array) -> Array:
    """Signs of velocities at instants, shape (m, n).

    Args:
        v: Velocities at the instants, shape (m, n).
        nearby: Velocities near the instants, which decide where a joint stops, shape
            (m, n).
    """
    still = np.abs(v) <= STANDSTILL
    aside = np.where(np.abs(nearby) > STANDSTILL, np.sign(nearby), 0.0)
    return np.where(still, aside, np.sign(v))


def interval_signs(v: Array) -> tuple[Array, BoolArray]:
    """Signs on intervals, 0 for reversals, and whether joints reverse, (N, n) each.

    Args:
        v: Velocities at the nodes, shape (N + 1, n) [rad/s or m/s].
    """
    first, last = velocity_signs(v[:-1], v[1:]), velocity_signs(v[1:], v[:-1])
    change = first * last < 0.0
    return np.where(change, 0.0, first), change
