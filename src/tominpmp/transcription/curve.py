"""B-spline curves, on knots that move with the durations of a motion.

The curve at an instant depends on p + 1 control points. Their weights, in the curve and
in its derivatives, are computed for all instants at once: SciPy's ``design_matrix``
takes ten times as long, and would dominate the iterations.

With a single duration the proportions of the knots are constant, and all functions of
the proportions are computed once. Derivatives by further durations are taken by complex
steps (Squire and Trapp, 1998), which are exact to rounding. An instant depends on few
neighbouring durations: one step changes all durations that are far enough apart
(Curtis, Powell and Reid, 1974).

Derivatives at an instant have few entries, too: :func:`rows_of_table` makes a sparse
matrix of them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeAlias
from weakref import WeakKeyDictionary

import numpy as np
import scipy.sparse as sp
from scipy.interpolate import BSpline

from tominpmp.arrays import Array, IntArray
from tominpmp.transcription.instants import Instants

# Configurations at times, shape (k,) to (k, n) [rad or m].
PositionFunction: TypeAlias = Callable[[Array], Array]

# Imaginary step of a duration, too small to change any real part.
COMPLEX_STEP = 1e-30


class KnotVector:
    """Knots of a clamped B-spline on a grid, and functions of the knots alone.

    Args:
        h: Lengths of the intervals, shape (N,).
        degree: Degree p of the spline.
        breaks: See the attribute.

    Attributes:
        degree: Degree p of the spline.
        breaks: Nodes that are double knots, as the number of intervals before each: the
            derivative one order below the highest may jump there.
        knots: Knots from 0, repeated at the ends, shape (N + 2p + 1 + breaks,).
        first: Index of the first control point on which each interval depends, (N,).
    """

    def __init__(self, h: Array, degree: int, breaks: tuple[int, ...] = ()) -> None:
        self._h, self.degree, self.breaks = h, degree, breaks
        self._begins = nodes_of(h)[:-1]
        self.knots = clamped(h, degree, breaks)
        every = np.arange(h.size)
        self.first: IntArray = every + np.searchsorted(breaks, every, side="right")
        self._bands = {0: np.ones((self.count, 1))}
        self._known: WeakKeyDictionary[Instants, dict[tuple[str, int], Array]]
        self._known = WeakKeyDictionary()

    @property
    def count(self) -> int:
        """Number of control points."""
        return int(self.knots.size) - self.degree - 1

    @property
    def greville(self) -> Array:
        """Greville abscissae of the control points: means of p knots, shape (M,)."""
        sums = np.cumsum(np.append(0.0, self.knots[1:-1]))
        means = (sums[self.degree :] - sums[: -self.degree]) / self.degree
        return np.asarray(np.clip(means, self.knots[0], self.knots[-1]))

    def bands(self, order: int) -> Array:
        """Banded matrix from control points to control points of a derivative, cached.

        Each row holds the entries from the diagonal on, shape (M - order, order + 1).
        """
        if order not in self._bands:
            below = np.pad(self.bands(order - 1), ((0, 0), (1, 1)))
            steps = below[1:, :-1] - below[:-1, 1:]
            self._bands[order] = self.slopes(order)[:, None] * steps
        return self._bands[order]

    def slopes(self, order: int) -> Array:
        """Factors from differences of control points to control points of a derivative.

        The differences are taken one order below; the factor is 0 where the derivative
        one order below jumps.
        """
        k = order - 1
        p, t = self.degree - k, self.knots[k : self.knots.size - k]
        m = t.size - p - 1
        spans = t[p + 1 : p + m] - t[1:m]
        wide = spans.real > 0.0
        return np.where(wide, p / np.where(wide, spans, 1.0), 0.0)

    def design(self, times: Array) -> sp.csr_matrix:
        """Matrix from control points to values at times, in units of the knots."""
        inside = np.clip(times, self.knots[0], self.knots[-1])
        return sp.csr_matrix(BSpline.design_matrix(inside, self.knots, self.degree))

    def functions(self, at: Instants, order: int) -> Array:
        """Nonzero basis functions of a derivative, shape (m, p + 1 - order).

        Computed by the recursion of Cox (1972) and de Boor (1972), and cached as long
        as the instants exist.
        """
        known, key = self._known.setdefault(at, {}), ("functions", order)
        if key in known:
            return known[key]
        times = self._begins[at.interval] + at.share * self._h[at.interval]
        p, t = self.degree - order, self.knots[order : self.knots.size - order]
        span = self.first[at.interval] + p
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
        known[key] = np.stack(found, axis=1)
        return known[key]

    def weights(self, at: Instants, order: int) -> Array:
        """Weights of the control points in a derivative, (m, p + 1), cached as well."""
        known, key = self._known.setdefault(at, {}), ("weights", order)
        found = self.functions(at, order)
        if key not in known:
            first = self.first[at.interval]
            for k in range(order, 0, -1):
                # Each control point of a derivative is a scaled difference of two
                # control points one order below.
                along = self.slopes(k)
                scaled = found * along[places(first, found.shape[1])]
                found = np.pad(scaled, ((0, 0), (1, 0)))
                found[:, :-1] -= scaled
            known[key] = found
        return known[key]


@dataclass(frozen=True, eq=False)
class SplineMotion:
    """The B-spline of an iterate.

    Attributes:
        points: Control points relative to the base, shape (M, n): for motions of a few
            micrometres, differences of absolute points would suffer from rounding.
        base: Configuration that is added to the points, shape (n,).
        eta: Durations by which the shares are multiplied, shape (m,).
        shares: Lengths of the intervals by eta, shape (N, m).
        knots: Knots of the spline, in units of the last duration.
        near: Durations on which the spline depends where a control point is the first
            one, w consecutive ones, shape (M, w).
        finite: Whether all states are finite, which they always are.
    """

    points: Array
    base: Array
    eta: Array
    shares: Array
    knots: KnotVector
    near: IntArray
    finite: bool = True

    @cached_property
    def h(self) -> Array:
        """Lengths of the intervals [s], shape (N,)."""
        return np.asarray(self.shares @ self.eta)

    @property
    def unit(self) -> float:
        """Unit of the knots: the last duration [s]."""
        return float(self.eta[-1].real)

    def derivative(self, order: int) -> Array:
        """Control points of a derivative, shape (M - order, n)."""
        known = self._derivatives
        if order not in known:
            former = self.points if order == 1 else self.derivative(order - 1)
            steps = np.diff(former, axis=0)
            slopes = self.knots.slopes(order) / self.unit
            known[order] = slopes[:, None] * steps
        return known[order]

    @cached_property
    def _derivatives(self) -> dict[int, Array]:
        """Cache of control points of derivatives, by order."""
        return {0: self.points + self.base}

    def values(
        self, at: Instants, order: int, which: IntArray | slice = slice(None)
    ) -> Array:
        """Values of a derivative at some of the instants, shape (k, n)."""
        functions = self.knots.functions(at, order)[which]
        first = self.knots.first[at.interval[which]]
        points = self.derivative(order)[places(first, functions.shape[1])]
        return np.asarray(np.einsum("mk,mkn->mn", functions, points))

    def positions(self, times: Array) -> Array:
        """Positions at times [s], shape (k, n)."""
        return np.asarray(self.knots.design(times / self.unit) @ self.derivative(0))

    def by_durations(
        self, quantity: Callable[[SplineMotion], Array], order: int, near: IntArray
    ) -> Array:
        """Derivatives of a quantity by the durations alone, shape (r, n, w).

        Args:
            quantity: The quantity as a function of the curve, with values (r, n).
            order: Order k of the quantity, which is homogeneous of degree -k in the
                durations: by Euler's theorem one derivative follows from the others.
            near: Durations on which each row depends, as in ``self.near``, (r, w).
        """
        found = [quantity(one).imag / COMPLEX_STEP for one in self._stepped]
        step = near % near.shape[1]  # number of the step that changes a duration
        eta = np.take_along_axis(self.eta[near], np.argsort(step, axis=1), axis=1)
        rest = -order * quantity(self)
        for number, by in enumerate(found):
            rest = rest - eta[:, [number]] * by
        changes = np.stack([*found, rest / eta[:, [-1]]], axis=-1)
        return np.take_along_axis(changes, step[:, None], axis=-1)

    @cached_property
    def _stepped(self) -> list[SplineMotion]:
        """Curves with a complex step in every w-th duration, without the last step."""
        degree, breaks = self.knots.degree, self.knots.breaks
        out, width = [], self.near.shape[1]
        for first in range(width - 1):
            eta: Any = self.eta.astype(np.complex128)
            eta[first::width] += 1j * COMPLEX_STEP
            knots = KnotVector(self.shares @ (eta / self.unit), degree, breaks)
            out.append(replace(self, eta=eta, knots=knots))
        return out


def nodes_of(h: Array) -> Array:
    """Nodes between intervals, shape (N + 1, ...), from the lengths of intervals."""
    return np.concatenate([np.zeros((1, *h.shape[1:])), np.cumsum(h, axis=0)])


def clamped(h: Array, degree: int, breaks: tuple[int, ...]) -> Array:
    """Knots of a spline that begins and ends at its outermost control points.

    Args:
        h: Lengths of the intervals, shape (N, ...).
        degree: Degree of the spline.
        breaks: Nodes that are double knots, as the number of intervals before each.
    """
    nodes = nodes_of(h)
    if breaks:
        nodes = np.insert(nodes, breaks, nodes[list(breaks)], axis=0)
    first, last = (np.repeat(nodes[[end]], degree, axis=0) for end in (0, -1))
    return np.concatenate([first, nodes, last])


def places(first: IntArray, width: int) -> IntArray:
    """Indices of the control points with nonzero weights, shape (m, width)."""
    return first[:, None] + np.arange(width)


def rows_of_table(data: Array, places: IntArray, width: int) -> sp.csr_matrix:
    """Sparse matrix whose rows have up to w entries each; zeros are left out.

    The rows are written as they are stored: from coordinates SciPy would sort them.

    Args:
        data: Entries, shape (m, w).
        places: Their columns in ascending order, shape (m, w); -1 to leave an entry
            out.
        width: Number of columns.
    """
    used = (data != 0.0) & (places >= 0)
    # SciPy and the solvers accept this index type without a copy.
    starts = np.zeros(len(data) + 1, dtype=np.int32)
    np.cumsum(used.sum(axis=1), out=starts[1:])
    columns = places[used].astype(np.int32)
    return sp.csr_matrix((data[used], columns, starts), shape=(len(data), width))
