"""Directions of joints and their reversals, which determine the sign of dry friction.

Velocities are polynomials between nodes. Where a joint reverses at a node, rounding (of
floats, and of the programs that plan motions) leaves a velocity at the node that is not
exactly zero, and the polynomial passes through zero slightly before or after the node,
or not at all; the acceleration jumps at the node itself. The sign of the velocity at
each instant would combine, between the zero and the node, the acceleration of one side
with the friction of the other: a torque that was never planned. Therefore sections
between two zeros in which a joint stays slower than the limit of standstill are not
movements of their own: they belong to the adjacent movement.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial.polynomial import polyval
from scipy.linalg import pascal

from tominpmp.arrays import Array, BoolArray, IntArray
from tominpmp.dynamics import RESTING, STANDSTILL, STEADY

if TYPE_CHECKING:
    from scipy.interpolate import PPoly

# Distance of two instants up to which they count as one, as a share of the duration:
# floats can hardly resolve it.
SAME = 1e-12
# Time below STANDSTILL from which a joint is at rest, and its acceleration is rounding
# [s].
PAUSE = 2e-3
# Number of bisections of an interval until a zero is known to the last bit.
HALVINGS = 54


@dataclass(frozen=True, eq=False)
class Turns:
    """Directions of motion of the joints at all times.

    Attributes:
        t: Times of the nodes [s], shape (N + 1,).
        first: Direction of each joint at the beginning of each interval: 1, -1, or 0
            for joints that rest during the whole interval, shape (N, n).
        times: Times of reversals between the nodes [s], ascending, shape (m,).
        joint: Joint of each reversal, shape (m,).
    """

    t: Array
    first: Array
    times: Array
    joint: IntArray

    @classmethod
    def of(cls, curve: PPoly) -> Turns:
        """Find the directions of a motion.

        Args:
            curve: Velocities over time, as polynomials between the nodes [rad/s or
                m/s].
        """
        t, h = curve.x, np.diff(curve.x)
        # Coefficients of 1, x, x^2, ..., where x is the elapsed share of an interval.
        terms = [c * h[:, None] ** k for k, c in enumerate(curve.c[::-1])]
        velocity = np.stack(terms, axis=2)
        bounds = _bernstein(velocity)
        low, high = bounds.min(axis=-1), bounds.max(axis=-1)
        # NaN for joints that may reverse.
        first = np.where(low >= 0.0, 1.0, np.where(high <= 0.0, -1.0, np.nan))
        slow = np.abs(bounds).max(axis=-1) <= STANDSTILL
        rests = _rests(velocity, h, slow)
        first[rests] = 0.0
        k, joint = np.nonzero(np.isnan(first))
        begins, sign, moves = _sections(velocity[k, joint], SAME * t[-1] / h[k])
        # Sections that are not movements get the direction of the last movement, or of
        # the first one.
        latest = np.maximum.accumulate(moves * np.arange(moves.shape[1]), axis=1)
        latest = np.maximum(latest, np.argmax(moves, axis=1)[:, None])
        way = np.take_along_axis(sign, latest, axis=1)
        last = first.copy()
        first[k, joint], last[k, joint] = way[:, 0], way[:, -1]
        slow_only = _adopt_directions(first, last, slow & ~rests)
        reverses = (way[:, 1:] != way[:, :-1]) & ~slow_only[k, joint, None]
        row, after = np.nonzero(reverses)
        times = t[k[row]] + h[k[row]] * begins[row, after + 1]
        order = np.argsort(times, kind="stable")
        times = _merged(times[order], SAME * t[-1])
        return cls(t, first, times, joint[row][order])

    def of_joints(self, included: BoolArray) -> Array:
        """Distinct times of reversals of some joints between the nodes [s].

        Args:
            included: Whether each joint is included, shape (n,).
        """
        return np.unique(self.times[included[self.joint]])

    def at(self, times: Array) -> Array:
        """Directions at times, just after a node or reversal, and just before the end.

        Args:
            times: Times within the motion [s], shape (m,).

        Returns:
            1, -1, or 0 for joints that rest, shape (m, n).
        """
        k = np.searchsorted(self.t, times, "right") - 1
        k = np.clip(k, 0, len(self.first) - 1)
        way: Array = self.first[k]
        for joint in np.unique(self.joint).tolist():
            reversals = self.times[self.joint == joint]
            before = np.searchsorted(reversals, self.t[k], "right")
            count = np.searchsorted(reversals, times, "right") - before
            way[:, joint] *= 1.0 - 2.0 * (count % 2)
        return way


def _bernstein(c: Array) -> Array:
    """Bernstein coefficients of polynomials on [0, 1], which bound their values."""
    # b_i = sum over j <= i of C(i, j) / C(K - 1, j) c_j.
    binomials = pascal(c.shape[-1], kind="lower", exact=False)
    return np.asarray(c @ (binomials / binomials[-1]).T)


def _rests(velocity: Array, h: Array, slow: BoolArray) -> BoolArray:
    """Which joints rest during whole intervals, shape (N, n).

    Slow joints rest if they do not accelerate, or stay slow for a while: then the small
    velocities at the nodes may have any sign. Before and after a rest a joint may stop
    or start as slowly as its jerk limit requires.
    """
    slope = velocity[..., 1:] * np.arange(1.0, velocity.shape[-1])
    a = np.abs(_bernstein(slope)).max(axis=-1) / h[:, None]
    rests: BoolArray = slow & (a <= STEADY)
    for joint, begin, end in _runs(slow):
        pause = _pause(velocity[:, joint], begin, end)
        rests[pause, joint] |= h[pause].sum() >= PAUSE
    return rests


def _adopt_directions(first: Array, last: Array, slow: BoolArray) -> BoolArray:
    """Let slow intervals, which are not movements, adopt an adjacent direction.

    Between movements of opposite directions a slow interval contains the reversal, and
    remains unchanged.

    Args:
        first: Direction of each joint at the beginning of each interval, modified in
            place, shape (N, n).
        last: Direction at the end of each interval, shape (N, n).
        slow: Which joints are slow during whole intervals without resting, shape
            (N, n).

    Returns:
        Which intervals adopted a direction, shape (N, n).
    """
    adopted = np.zeros_like(slow)
    for joint, begin, end in _runs(slow):
        before = last[begin - 1, joint] if begin > 0 else 0.0
        after = first[end, joint] if end < len(slow) else 0.0
        if before * after >= 0.0 and before + after != 0.0:
            first[begin:end, joint] = before or after
            adopted[begin:end, joint] = True
    return adopted


def _runs(mask: BoolArray) -> Iterator[tuple[int, int, int]]:
    """Runs of marked intervals of each joint: joint, first and end index.

    Args:
        mask: Whether each interval is marked, shape (N, n).
    """
    for joint in np.flatnonzero(mask.any(axis=0)).tolist():
        edges = np.flatnonzero(np.diff(mask[:, joint].astype(int), prepend=0, append=0))
        for begin, end in edges.reshape(-1, 2).tolist():
            yield joint, begin, end


def _pause(velocity: Array, begin: int, end: int) -> slice:
    """Slow intervals without those in which a movement decays to rest or starts.

    Args:
        velocity: Velocity polynomials of one joint, shape (N, K).
        begin: Index of the first slow interval.
        end: Index after the last slow interval.
    """
    first, last = velocity[:, 0], velocity.sum(axis=1)
    x = np.linspace(0.0, 0.5, 6)

    def decays(k: int, near: Array, far: Array, sign: float) -> bool:
        return bool(sign * near[k] > sign * far[k] >= 0.0)

    if begin > 0:
        sign = _sign_of_largest(_values(velocity[begin - 1 : begin], 1.0 - x[None]))
        while begin < end and decays(begin, first, last, sign):
            begin += 1
    if end < len(velocity):
        sign = _sign_of_largest(_values(velocity[end : end + 1], x[None]))
        while begin < end and decays(end - 1, last, first, sign):
            end -= 1
    return slice(begin, end)


def _sign_of_largest(values: Array) -> float:
    """Sign of the value with the largest absolute value."""
    return float(np.sign(values.flat[np.argmax(np.abs(values))]))


def _sections(c: Array, least: Array) -> tuple[Array, Array, BoolArray]:
    """Sections of polynomials on [0, 1] between their zeros.

    Args:
        c: Coefficients of 1, x, x^2, ..., shape (m, K).
        least: Length that a movement has to exceed, shape (m,).

    Returns:
        Beginning and sign of each section, and whether it is a movement: longer than
        ``least``, and faster than standstill. If a polynomial has no movement by this
        rule, sections faster than rounding count as movements; without sections faster
        than rounding, the fastest section. Shape (m, K) each; surplus sections have
        length 0.
    """
    zeros = _sign_changes(c)
    extrema = _sign_changes(c[:, 1:] * np.arange(1.0, c.shape[1]))
    begins = np.column_stack([np.zeros(len(c)), zeros])
    ends = np.column_stack([zeros, np.ones(len(c))])
    at = np.column_stack([np.zeros(len(c)), extrema, np.ones(len(c))])
    values = _values(c, at)
    inside = (at[:, None] >= begins[..., None]) & (at[:, None] <= ends[..., None])
    sizes = np.where(inside, np.abs(values)[:, None], -1.0)
    fastest, size = np.argmax(sizes, axis=2), np.max(sizes, axis=2)
    sign = np.where(np.take_along_axis(values, fastest, axis=1) < 0.0, -1.0, 1.0)
    long = ends - begins > least[:, None]
    moves = (size > STANDSTILL) & long
    slower = (size > RESTING) & long
    moves = np.where(moves.any(axis=1)[:, None], moves, slower)
    still = ~moves.any(axis=1)
    moves[still, np.argmax(size[still], axis=1)] = True
    return begins, sign, moves


def _sign_changes(c: Array) -> Array:
    """Sign changes of polynomials in [0, 1], in order, padded with ones.

    Between two zeros of its derivative a polynomial is monotonic, and has at most one
    zero, which is located by bisection.

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
    return np.asarray(polyval(x, c.T[:, :, None], tensor=False))


def _merged(times: Array, apart: float) -> Array:
    """Merge increasing times that are closer than a distance into the earliest."""
    first = np.diff(times, prepend=-np.inf) > apart
    return np.asarray(times[first][np.cumsum(first) - 1])
