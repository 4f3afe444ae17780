"""The motion of a file, read and evaluated without the library."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from benchmarks.exact_geometry import Array


@dataclass(frozen=True)
class Movement:
    """The motion of a file, as polynomials between its nodes.

    Torques are polynomials between separate breaks, which include the nodes: a joint
    with dry friction may reverse very close to a node, and polynomials of positions on
    this short interval would consist of rounding errors.

    Attributes:
        t: Times of the nodes, shape (N + 1,).
        q: Positions there, shape (N + 1, n).
        v: Velocities there.
        a: Accelerations of the intervals (N, n) or at the nodes (N + 1, n), or None.
        breaks: Times between which torques are smooth, shape (P + 1,).
        share: Shares of a piece at which torques are given, shape (k,).
        u: Torques there, shape (P, k, n).
        held: Whether the torques are given, constant on the intervals.
    """

    t: Array
    q: Array
    v: Array
    a: Array | None
    breaks: Array
    share: Array
    u: Array
    held: bool

    @property
    def pieces(self) -> range:
        """Pieces with smooth torques."""
        return range(len(self.breaks) - 1)

    def interval(self, p: int) -> int:
        """The interval between nodes that contains a piece."""
        middle = 0.5 * (self.breaks[p] + self.breaks[p + 1])
        return int(np.searchsorted(self.t, middle)) - 1

    def state(self, p: int, s: Array) -> tuple[Array, Array, Array, Array]:
        """Position, velocity, acceleration, jerk at shares s of piece p."""
        begin, end = self.breaks[p], self.breaks[p + 1]
        k = self.interval(p)
        first, last = (np.array([begin, end]) - self.t[k]) / (self.t[k + 1] - self.t[k])
        return self.between(k, first + s * (last - first))

    def velocity(self, times: Array) -> Array:
        """Velocities at times, constant beyond the ends, shape (m, n)."""
        times = np.clip(times, self.t[0], self.t[-1])
        at = np.searchsorted(self.t, times, side="right") - 1
        at = np.minimum(at, len(self.t) - 2)
        s = (times - self.t[at]) / np.diff(self.t)[at]
        rows = [
            self.between(int(k), np.array([x]))[1][0]
            for k, x in zip(at, s, strict=True)
        ]
        return np.array(rows)

    def between(self, k: int, s: Array) -> tuple[Array, Array, Array, Array]:
        """Position, velocity, acceleration, jerk at shares s of interval k."""
        if k not in self._derivatives:
            self._derivatives[k] = self._differentiated(k)
        polynomials = self._derivatives[k]
        basis = s[:, None] ** np.arange(len(polynomials[0]))
        out = [basis[:, : len(poly)] @ poly for poly in polynomials]
        return out[0], out[1], out[2], out[3]

    @cached_property
    def _derivatives(self) -> dict[int, list[Array]]:
        """Coefficients of some intervals, by derivative."""
        return {}

    def _differentiated(self, k: int) -> list[Array]:
        h = self.t[k + 1] - self.t[k]
        poly, out = self._powers(k, h), []
        for order in range(4):
            out.append(poly / h**order)
            poly = poly[1:] * np.arange(1, len(poly))[:, None]
            if not len(poly):
                poly = np.zeros((1, self.q.shape[1]))
        return out

    def _powers(self, k: int, h: float) -> Array:
        q0, q1 = self.q[k], self.q[k + 1]
        v0, v1 = self.v[k] * h, self.v[k + 1] * h
        if self.a is not None and len(self.a) == len(self.t) - 1:
            return np.array([q0, v0, 0.5 * self.a[k] * h * h])
        if self.a is None:
            ends, count = np.array([q0, v0, q1, v1]), 4
            rows = [(0, 0.0), (1, 0.0), (0, 1.0), (1, 1.0)]
        else:
            a0, a1 = self.a[k] * h * h, self.a[k + 1] * h * h
            ends, count = np.array([q0, v0, a0, q1, v1, a1]), 6
            rows = [(0, 0.0), (1, 0.0), (2, 0.0), (0, 1.0), (1, 1.0), (2, 1.0)]
        matrix = np.zeros((count, count))
        for row, (order, at) in enumerate(rows):
            for power in range(order, count):
                factor = np.prod(np.arange(power - order + 1, power + 1))
                matrix[row, power] = factor * at ** (power - order)
        return np.asarray(np.linalg.solve(matrix, ends))

    def torque(self, p: int, s: Array) -> Array:
        """Torques at shares s of piece p, interpolated from the given ones."""
        if len(self.share) == 1:
            return np.repeat(self.u[p], len(s), axis=0)
        x = self.share
        # Lagrange's polynomials, in their barycentric form.
        weights = 1.0 / np.prod(
            np.where(np.eye(len(x), dtype=bool), 1.0, x[:, None] - x[None]), axis=1
        )
        apart = s[:, None] - x[None]
        hit = np.abs(apart) < 1e-14
        share = weights / np.where(hit, 1.0, apart)
        share = np.where(hit.any(axis=1)[:, None], hit.astype(float), share)
        share /= share.sum(axis=1, keepdims=True)
        return np.asarray(share @ self.u[p])


def read_movement(path: Path) -> Movement:
    """Read the file of a motion."""
    with np.load(path, allow_pickle=False) as data:
        a = data["a"] if data["a"].size else None
        return Movement(
            data["t"],
            data["q"],
            data["v"],
            a,
            data["breaks"],
            data["share"],
            data["u"],
            bool(data["held"]),
        )
