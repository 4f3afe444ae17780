"""Bases of B-splines on a fixed grid, and what their end states fix.

At an instant p + 1 control points matter. Their weights, in the curve and in its
derivatives, are worked out for all instants at once: SciPy's ``design_matrix`` takes
ten times as long, which is what iterations would take then.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from scipy.interpolate import BSpline

from tominpmp.arrays import Array, IntArray
from tominpmp.linear_programs.compressed import Compressed
from tominpmp.transcription.problem_functions import ProblemFunctions


@dataclass(frozen=True, eq=False)
class Basis:
    """Matrices of a clamped B-spline and its derivatives with respect to t / T.

    Attributes:
        degree: p.
        knots: With multiplicity at the ends, in [0, 1], shape (N + 2p + 1,).
    """

    degree: int
    knots: Array

    @classmethod
    def on(cls, nodes: Array, degree: int) -> Basis:
        """Basis on nodes that increase from 0, shape (N + 1,).

        At a node that is there twice a derivative less is continuous.
        """
        ends = np.zeros(degree), np.full(degree, nodes[-1])
        return cls(degree, np.concatenate([ends[0], nodes, ends[1]]))

    @property
    def count(self) -> int:
        """Number of control points."""
        return int(self.knots.size) - self.degree - 1

    @property
    def greville(self) -> Array:
        """Where each control point belongs: means of its inner knots, shape (M,)."""
        sums = np.cumsum(np.append(0.0, self.knots[1:-1]))
        means = (sums[self.degree :] - sums[: -self.degree]) / self.degree
        return np.asarray(np.clip(means, self.knots[0], self.knots[-1]))

    def derivative(self, order: int) -> sp.csr_matrix:
        """Control points of a derivative from those of the curve."""
        known = self._derivatives
        if order not in known:
            bands = self.bands(order)
            columns = places(np.arange(len(bands)), order + 1)
            known[order] = Compressed.of_table(bands, columns, self.count).rows()
        return known[order]

    def bands(self, order: int) -> Array:
        """Rows of that, from the diagonal on, shape (m, order + 1)."""
        if not order:
            return np.ones((self.count, 1))
        below = np.pad(self.bands(order - 1), ((0, 0), (1, 1)))
        return self.slopes(order)[:, None] * (below[1:, :-1] - below[:-1, 1:])

    def slopes(self, order: int) -> Array:
        """What differences of control points one order below are multiplied by.

        That makes the control points of a derivative; 0 where a curve jumps.
        """
        k = order - 1
        p, t = self.degree - k, self.knots[k : self.knots.size - k]
        m = t.size - p - 1
        spans = t[p + 1 : p + m] - t[1:m]
        wide = spans > 0.0
        return np.where(wide, p / np.where(wide, spans, 1.0), 0.0)

    @cached_property
    def _derivatives(self) -> dict[int, sp.csr_matrix]:
        """Those that were asked for: they are, again and again."""
        return {}

    def at(self, times: Array) -> sp.csr_matrix:
        """Values at times on the scale of the knots, from the control points."""
        inside = np.clip(times, self.knots[0], self.knots[-1])
        return sp.csr_matrix(BSpline.design_matrix(inside, self.knots, self.degree))

    def weights(self, times: Array, first: IntArray, order: int) -> Array:
        """Weights of the control points that matter in a derivative, shape (m, p + 1).

        Args:
            times: Instants, on the scale of the knots, shape (m,).
            first: The first control point that matters at each, shape (m,).
            order: Of the derivative.
        """
        found = self.functions(times, first, order)
        for k in range(order, 0, -1):
            # A control point of a derivative is a difference of two one order below.
            along = self.slopes(k)
            scaled = found * along[places(first, found.shape[1])]
            found = np.zeros((len(scaled), scaled.shape[1] + 1))
            found[:, 1:] = scaled
            found[:, :-1] -= scaled
        return found

    def functions(self, times: Array, first: IntArray, order: int) -> Array:
        """Basis functions of a derivative that are not zero, shape (m, p + 1 - order).

        By the recursion of Cox (1972) and de Boor (1972); arguments are as above.
        """
        p, t = self.degree - order, self.knots[order : self.knots.size - order]
        span = first + p
        left = [times - t[span + 1 - j] for j in range(p + 1)]
        right = [t[span + j] - times for j in range(p + 1)]
        found = [np.ones(times.size)]
        for j in range(1, p + 1):
            saved = np.zeros(times.size)
            for r in range(j):
                part = found[r] / (right[r + 1] + left[j - r])
                found[r] = saved + right[r + 1] * part
                saved = left[j - r] * part
            found.append(saved)
        return np.stack(found, axis=1)


def places(first: IntArray, width: int) -> IntArray:
    """Numbers of the control points that matter at instants, shape (m, width)."""
    return first[:, None] + np.arange(width)


def by_points(
    first: IntArray, parts: Sequence[tuple[Array, Array]], joints: int
) -> tuple[Array, IntArray]:
    """Derivatives of values by the coordinates of the control points that matter.

    Args:
        first: The first control point that matters for each value, shape (k,).
        parts: Weights of the control points in a derivative of the curve, shape
            (k, p + 1), and derivatives of the values by that, shape (k, n); none for
            values that depend on the time alone.
        joints: Number n of joints.

    Returns:
        The derivatives, shape (k, (p + 1) n), and which coordinates of all they are by.
    """
    if not parts:
        return np.zeros((first.size, 0)), np.zeros((first.size, 0), dtype=np.int64)
    total = sum(weights[:, :, None] * part[:, None, :] for weights, part in parts)
    data = np.reshape(total, (first.size, -1))
    return data, places(joints * first, data.shape[1])


def of_each_joint(bands: Array, joints: IntArray, n: int) -> tuple[Array, IntArray]:
    """What acts on control points, for each of some joints.

    Args:
        bands: Rows of a matrix from the diagonal on, shape (m, w).
        joints: The joints, shape (k,).
        n: Number of all joints.

    Returns:
        Its rows for the first point and all joints, for the second, ..., shape
        (m k, w), and the coordinates of control points that they act on.
    """
    m, width = bands.shape
    data = np.repeat(bands, joints.size, axis=0)
    first = n * np.arange(m)[:, None] + joints
    return data, first.reshape(-1, 1) + n * np.arange(width)


@dataclass(frozen=True, eq=False)
class Elimination:
    """Control points as A z + c, with z = (free points, T).

    At a known velocity v the second point from an end is C_0 + v T dt / p; the third
    follows where the acceleration has to begin at zero, as it must not jump.

    Attributes:
        matrix: A, shape (M n, free n + 1).
        offset: c, shape (M n,).
        free: Number of free points.
        fixed_end: Whether the final velocity is built in.
    """

    matrix: sp.csr_matrix
    offset: Array
    free: int
    fixed_end: bool

    @classmethod
    def of(cls, system: ProblemFunctions, basis: Basis) -> Elimination:
        """Elimination for the end states of a problem."""
        n, M, t, p = system.n, basis.count, basis.knots, basis.degree
        goal, v_end = system.final_configuration, system.final_velocity
        known, last = (2 if one.sudden else 3 for one in _ends(system))
        if v_end is None:
            last = int(goal is not None)
        inner = M - known - last
        # A free final configuration moves the points that hang on it together.
        free = inner + int(last > 0 and goal is None)
        size = free * n + 1
        base = np.zeros((M, n))
        slope = np.zeros((M, n))
        column: IntArray = np.full(M, -1)
        base[:known] = system.problem.q_start
        slope[:known] = np.outer(_reach(t, p, known), system.v_start)
        column[known : known + inner] = np.arange(inner)
        if last:
            column[M - last :] = -1 if goal is not None else free - 1
            if goal is not None:
                base[M - last :] = goal
            if v_end is not None:
                back = _reach((t[-1] - t)[::-1], p, last)
                slope[M - last :] = -np.outer(back, v_end)[::-1]
        moved = np.flatnonzero(column >= 0)
        joints = np.arange(n)
        rows = (moved[:, None] * n + joints).ravel()
        columns = (column[moved][:, None] * n + joints).ravel()
        every = np.arange(M * n)
        matrix = sp.csr_matrix(
            (
                np.concatenate([np.ones(rows.size), slope.ravel()]),
                (
                    np.concatenate([rows, every]),
                    np.concatenate([columns, np.full(M * n, size - 1)]),
                ),
            ),
            shape=(M * n, size),
        )
        return cls(matrix, base.ravel(), free, v_end is not None)


def _ends(system: ProblemFunctions) -> tuple[ProblemFunctions, ProblemFunctions]:
    """The functions of the first and of the last segment."""
    return system.segments[0], system.segments[-1]


def _reach(knots: Array, degree: int, count: int) -> Array:
    """How far the first control points lie from the end, per unit of velocity."""
    spans = [(knots[i + 1 + degree] - knots[i + 1]) / degree for i in range(count - 1)]
    return np.concatenate([[0.0], np.cumsum(spans)])
