"""Which way joints move, and when they turn: what decides the sign of dry friction.

Velocities are polynomials between nodes. Where a joint turns at a node, rounding (of
floats, and of the programs that motions come from) leaves a velocity there that is not
quite zero, and the polynomial passes through zero a hair before the node or after it,
or not at all; the acceleration jumps at the node itself. Signs taken instant by instant
would give that hair the acceleration of one side and the friction of the other, a
torque that nobody has planned. Stretches between two zeros in which a joint never
becomes faster than one at rest are no movements therefore: they belong to the movement
beside them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tominpmp.arrays import Array, BoolArray, IntArray

# Slower joints are at rest [rad/s or m/s] if they accelerate by less than STEADY
# [rad/s^2 or m/s^2]; with more they are starting or stopping.
STANDSTILL = 1e-6
STEADY = 1e-6
# Joints slower than this are at rest but for rounding [rad/s or m/s]: what comes
# afterwards tells which way they go.
RESTING = 1e-10
# Instants as close as this are one, as shares of the duration: floats can hardly tell
# what is between them.
SAME = 1e-12
# Halvings of an interval until a zero is known to the last bit.
HALVINGS = 54


def directions(v: Array, a: Array) -> Array:
    """Which way joints move, or are about to if they are at rest.

    Args:
        v: Velocities, shape (m, n) [rad/s or m/s].
        a: Accelerations just afterwards, shape (m, n).

    Returns:
        1, -1, or 0 for joints that remain at rest, shape (m, n).
    """
    way = np.where(np.abs(v) > RESTING, np.sign(v), np.sign(a))
    resting = (np.abs(v) <= STANDSTILL) & (np.abs(a) <= STEADY)
    return np.where(resting, 0.0, way)


@dataclass(frozen=True, eq=False)
class Turns:
    """Which way the joints of a motion go at all times.

    Attributes:
        t: Times of the nodes [s], shape (N + 1,).
        first: The way of each joint at the beginning of each interval: 1, -1, or 0 for
            those that rest all along it, shape (N, n).
        times: When joints turn between the nodes [s], in the order of time, shape (m,).
        joint: Which joint does, shape (m,).
    """

    t: Array
    first: Array
    times: Array
    joint: IntArray

    @classmethod
    def of(cls, t: Array, velocity: Array) -> Turns:
        """Look at a motion.

        Args:
            t: Times of the nodes [s], shape (N + 1,).
            velocity: Velocities as polynomials of the share x of each interval that has
                passed: coefficients of 1, x, x^2, ..., shape (N, n, K) [rad/s or m/s].
        """
        h = np.diff(t)
        first = _one_way(velocity)
        k, joint = np.nonzero(np.isnan(first))
        begins, sign, moves = _stretches(velocity[k, joint], SAME * t[-1] / h[k])
        # Stretches that are none have the way of the last one that is, or the next.
        way = np.where(moves, sign, 0.0)
        for i in range(1, way.shape[1]):
            way[:, i] = np.where(moves[:, i], way[:, i], way[:, i - 1])
        for i in range(way.shape[1] - 2, -1, -1):
            way[:, i] = np.where(way[:, i] == 0.0, way[:, i + 1], way[:, i])
        first[k, joint] = way[:, 0]
        _let_rest(first, velocity, h)
        row, after = np.nonzero(way[:, 1:] != way[:, :-1])
        times = t[k[row]] + h[k[row]] * begins[row, after + 1]
        order = np.argsort(times, kind="stable")
        times = _together(times[order], SAME * t[-1])
        return cls(t, first, times, joint[row][order])

    def of_joints(self, some: BoolArray) -> Array:
        """When some joints turn between the nodes [s], each time once.

        Args:
            some: Which joints are asked for, shape (n,).
        """
        return np.unique(self.times[some[self.joint]])

    def at(self, times: Array) -> Array:
        """Which way joints go: just after a node or a turn, and before the end.

        Args:
            times: Times within the motion [s], shape (m,).

        Returns:
            1, -1, or 0 for joints that rest, shape (m, n).
        """
        k = np.searchsorted(self.t, times, "right") - 1
        k = np.clip(k, 0, len(self.first) - 1)
        way: Array = self.first[k]
        for joint in np.unique(self.joint).tolist():
            turns = self.times[self.joint == joint]
            since = np.searchsorted(turns, self.t[k], "right")
            count = np.searchsorted(turns, times, "right") - since
            way[:, joint] *= 1.0 - 2.0 * (count % 2)
        return way


def _bernstein(c: Array) -> Array:
    """Coefficients of Bernstein's polynomials, between which the values lie."""
    K = c.shape[-1]
    binomial = np.cumprod([1.0, *((K - 1 - i) / (i + 1.0) for i in range(K - 1))])
    # b_i = sum over j <= i of C(i, j) / C(K - 1, j) c_j.
    pascal = np.zeros((K, K))
    pascal[:, 0] = 1.0
    for i in range(1, K):
        pascal[i, 1:] = pascal[i - 1, 1:] + pascal[i - 1, :-1]
    return np.asarray(c @ (pascal / binomial).T)


def _one_way(velocity: Array) -> Array:
    """Ways on intervals where a bound tells them; NaN where joints may turn."""
    bounds = _bernstein(velocity)
    low, high = bounds.min(axis=-1), bounds.max(axis=-1)
    way = np.where(low >= 0.0, 1.0, np.where(high <= 0.0, -1.0, np.nan))
    # All along at rest, but that it may set out, stop or turn: as where it is fastest.
    slow = np.maximum(high, -low) <= STANDSTILL
    return np.where(slow, np.where(high >= -low, 1.0, -1.0), way)


def _let_rest(first: Array, velocity: Array, h: Array) -> None:
    """Note in ``first`` which joints rest all along their intervals."""
    slow = np.abs(_bernstein(velocity)).max(axis=-1) <= STANDSTILL
    slope = velocity[..., 1:] * np.arange(1.0, velocity.shape[-1])
    if slope.shape[-1]:
        a = np.abs(_bernstein(slope)).max(axis=-1) / h[:, None]
        slow &= a <= STEADY
    first[slow] = 0.0


def _stretches(c: Array, least: Array) -> tuple[Array, Array, BoolArray]:
    """Stretches of polynomials on [0, 1] between their zeros.

    Args:
        c: Coefficients of 1, x, x^2, ..., shape (m, K).
        least: Shortest stretch that counts, shape (m,).

    Returns:
        Where they begin, the sign of each, and whether it is a movement, longer than
        that and faster than rest, or the fastest of a polynomial that is at rest all
        along; shape (m, K) each. Of length 0 are those that a polynomial does not have.
    """
    zeros = _sign_changes(c)
    turning = _sign_changes(c[:, 1:] * np.arange(1.0, c.shape[1]))
    begins = np.column_stack([np.zeros(len(c)), zeros])
    ends = np.column_stack([zeros, np.ones(len(c))])
    look = np.column_stack([np.zeros(len(c)), turning, np.ones(len(c))])
    values = _values(c, look)
    inside = (look[:, None] >= begins[..., None]) & (look[:, None] <= ends[..., None])
    sizes = np.where(inside, np.abs(values)[:, None], -1.0)
    fastest, size = np.argmax(sizes, axis=2), np.max(sizes, axis=2)
    sign = np.where(np.take_along_axis(values, fastest, axis=1) < 0.0, -1.0, 1.0)
    long = ends - begins > least[:, None]
    moves = (size > STANDSTILL) & long
    none = ~moves.any(axis=1)
    moves[none, np.argmax(size[none], axis=1)] = True
    return begins, sign, moves


def _sign_changes(c: Array) -> Array:
    """Where polynomials change sign in [0, 1], in order, filled up with ones.

    Between two zeros of its derivative a polynomial rises or falls, and has one zero at
    most, which is found by halving.

    Args:
        c: Coefficients of 1, x, x^2, ..., shape (m, K).

    Returns:
        Shape (m, K - 1).
    """
    m, K = c.shape
    if K < 2:
        return np.ones((m, 0))
    slope = _sign_changes(c[:, 1:] * np.arange(1.0, K))
    edges = np.column_stack([np.zeros(m), slope, np.ones(m)])
    negative = _values(c, edges) < 0.0
    low, high = edges[:, :-1].copy(), edges[:, 1:].copy()
    for _ in range(HALVINGS if m else 0):
        middle = 0.5 * (low + high)
        early = (_values(c, middle) < 0.0) == negative[:, :-1]
        low, high = np.where(early, middle, low), np.where(early, high, middle)
    return np.sort(np.where(negative[:, :-1] != negative[:, 1:], high, 1.0), axis=1)


def _values(c: Array, x: Array) -> Array:
    """Values of polynomials of shape (m, K) at points of shape (m, p)."""
    out = np.zeros_like(x)
    for k in range(c.shape[1] - 1, -1, -1):
        out = c[:, k, None] + x * out
    return out


def _together(times: Array, apart: float) -> Array:
    """Increasing times, those that follow another within ``apart`` moved to it."""
    first = np.diff(times, prepend=-np.inf) > apart
    return np.asarray(times[first][np.cumsum(first) - 1])
