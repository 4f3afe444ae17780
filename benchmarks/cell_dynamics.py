"""Dynamics of the arms of a cell under torques, without the library."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from benchmarks.cell_arms import Member, inverse
from benchmarks.cell_movement import Movement
from benchmarks.exact_geometry import Array

# Slower joints have the direction of their piece of the motion; if their acceleration
# is below STANDING too [rad/s and rad/s^2], dry friction holds them.
SLOW, STANDING = 1e-9, 2e-6
# Joints slower than STANDING for at least this time count as at rest [s]: they have
# moved by some 1e-9 rad, which may be rounding.
PAUSE = 1e-3
# If a joint reverses within this time of an instant, its dry friction is that of either
# direction, or in between, like that of a joint at rest [s].
ASIDE = 1e-7


class Plant:
    """All arms of a cell on a movement, whose direction sets the sign of dry friction.

    Attributes:
        members: The arms.
        movement: Their planned movement.
        friction: Dry friction of all joints, shape (n,) [N m or N].
        way: Direction of the joints in each piece of the movement, shape (P, n).
    """

    def __init__(self, members: Sequence[Member], movement: Movement) -> None:
        self.members, self.movement = members, movement
        self.friction = np.concatenate([m.friction for m in members])
        self.way = np.array([self._goes(p) for p in movement.pieces])
        self._scratch = [member.arm.model.createData() for member in members]
        self.rests = self._rests()
        # Faster joints do not reverse within ASIDE.
        s = np.linspace(0.0, 1.0, 21)
        fastest = [np.abs(movement.state(p, s)[2]).max(0) for p in movement.pieces]
        self._close = SLOW + 2.0 * ASIDE * np.max(fastest, axis=0)

    def _rests(self) -> NDArray[np.bool_]:
        """Pieces that belong to pauses of joints, shape (P, n)."""
        move, s = self.movement, np.linspace(0.0, 1.0, 21)
        fastest = [np.abs(move.state(p, s)[1]).max(axis=0) for p in move.pieces]
        slow, lasts = np.array(fastest) < STANDING, np.diff(move.breaks)
        out = np.zeros_like(slow)
        for joint in range(slow.shape[1]):
            begin = 0
            for p in range(len(slow) + 1):
                if p < len(slow) and slow[p, joint]:
                    continue
                out[begin:p, joint] = lasts[begin:p].sum() >= PAUSE
                begin = p + 1
        return out

    def _goes(self, p: int) -> Array:
        """Direction of joints in a piece; in its interval if the piece is too short."""
        move, s = self.movement, np.linspace(0.0, 1.0, 21)
        own = _way(move.state(p, s)[1])
        v = move.between(move.interval(p), s)[1]
        turns = (v.max(axis=0) > SLOW) & (v.min(axis=0) < -SLOW)
        return np.where((own == 0.0) & ~turns, _way(v), own)

    def dry(
        self, p: int, s: Array, state: tuple[Array, Array, Array], u: Array
    ) -> Array:
        """Dry friction at shares s of a piece.

        It opposes the movement, or holds joints at rest; where a joint reverses, it is
        the value between the two that the torques require.
        """
        _, v, a = state
        way = np.where(np.abs(v) > SLOW, np.sign(v), self.way[p])
        stands = (np.abs(v) < STANDING) & (np.abs(a) < STANDING) | (way == 0.0)
        stands |= self.rests[p]
        low, high = np.where(stands, -1.0, way), np.where(stands, 1.0, way)
        close = (np.abs(v) <= self._close) & (self.friction > 0.0)
        if np.any(close):
            begin, end = self.movement.breaks[p], self.movement.breaks[p + 1]
            times = begin + s * (end - begin)
            for aside in (times - ASIDE, times + ASIDE):
                there = np.where(close, np.sign(self.movement.velocity(aside)), way)
                low, high = np.minimum(low, there), np.maximum(high, there)
        dry = self.friction * way
        if np.any((low < high) & (self.friction > 0.0)):
            left = u - inverse(self.members, *state)
            dry = np.clip(left, self.friction * low, self.friction * high)
        return np.asarray(dry)

    def mass_times(self, q: Array, pull: Array) -> Array:
        """Product of the mass matrix of the arms and a vector."""
        out, begin = np.empty_like(pull), 0
        for member, data in zip(self.members, self._scratch, strict=True):
            part = slice(begin, begin + member.n)
            place = member.configuration(q[part])
            inertia = np.triu(pin.crba(member.arm.model, data, place))
            out[part] = (inertia + np.triu(inertia, 1).T) @ pull[part]
            begin += member.n
        return out

    def forward(self, x: Array, left: Array, pull: Array, planned: Array) -> Array:
        """Accelerations by the torques minus dry friction."""
        n, begin = len(left), 0
        force = left + self.mass_times(x[:n], pull)
        out = np.empty(n)
        for member, data in zip(self.members, self._scratch, strict=True):
            part = slice(begin, begin + member.n)
            q, v = member.configuration(x[:n][part]), x[n:][part]
            own = force[part] - member.arm.damping * v
            out[part] = pin.aba(member.arm.model, data, q, v, own)
            begin += member.n
        resting = (self.friction > 0.0) & (planned == 0.0)
        return np.where(resting, pull, out)


def _way(v: Array) -> Array:
    """Signs of the largest velocities of columns, 0 where all are slow."""
    fastest = np.take_along_axis(v, np.abs(v).argmax(axis=0)[None], axis=0)[0]
    return np.where(np.abs(fastest) > SLOW, np.sign(fastest), 0.0)
