"""Piecewise polynomials fitted to a curve, for the replay.

The replay evaluates torques at thousands of instants that the integrator chooses.
Between two nodes a trajectory is smooth: a polynomial through Chebyshev points, which
are inside the piece and so never on a jump, approximates it up to rounding.

SciPy's ``PPoly`` was measured in comparison: it agrees to 6e-16 and is 1.3 times faster
at thousands of instants at once, but takes 8.5 us instead of 3.2 us for a single
instant, the case of an integration, where a whole evaluation of the dynamics takes 9.7
us; and it does not fit curves.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tominpmp.arrays import Array, IntArray

# Chebyshev points of a piece, and the tolerated relative deviation between them.
POINTS = 10
DEVIATION = 1e-10
# Size of a coefficient, relative to the largest value, below which it is dropped.
ROUNDING = 1e-14
# Largest number of halvings of the pieces to reach the tolerated deviation.
HALVINGS = 5
# Abscissae in [-1, 1] at which the deviation is measured: far from the points.
PROBES = (-0.999, 0.16, 0.93)
# Number of times at which a curve is evaluated at once, which limits the memory.
CHUNK = 10_000


@dataclass(frozen=True, eq=False)
class Pieces:
    """A curve of n components as polynomials of s in [-1, 1], one for each time piece.

    Attributes:
        t: Ends of the pieces [s], shape (P + 1,).
        coefficients: Coefficients of 1, s, s^2, ..., shape (P, n, K); for a curve at a
            single time, which has no piece, the value, shape (1, n, 1).
    """

    t: Array
    coefficients: Array

    @classmethod
    def of(cls, curve: Callable[[Array], Array], t: Array) -> Pieces:
        """Fit a curve: a function from times of shape (m,) to values of shape (m, n).

        The curve is smooth between the times t, shape (P + 1,) [s]; pieces are halved
        until they follow the curve.
        """
        if t.size == 1:
            return cls(t, curve(t)[:, :, None])
        for _ in range(HALVINGS + 1):
            pieces, deviation = cls._fit(curve, t)
            if not deviation > DEVIATION:
                break
            t = np.sort(np.concatenate([t, 0.5 * (t[1:] + t[:-1])]))
        return pieces

    @classmethod
    def _fit(cls, curve: Callable[[Array], Array], t: Array) -> tuple[Pieces, float]:
        """Fit a curve, and measure the deviation as a share of its largest value."""
        s = np.cos(np.pi * (np.arange(POINTS) + 0.5) / POINTS)
        probes = np.array(PROBES)
        middle, half = 0.5 * (t[1:] + t[:-1]), 0.5 * np.diff(t)
        times = middle[:, None] + half[:, None] * np.concatenate([s, probes])
        values = curve(times.ravel()).reshape(*times.shape, -1)  # (P, K + 3, n)
        scale = max(float(np.max(np.abs(values), initial=0.0)), 1e-300)
        fitted = np.linalg.solve(np.vander(s, increasing=True), values[:, :POINTS])
        at_probes = np.vander(probes, POINTS, increasing=True) @ fitted
        deviation = float(np.max(np.abs(at_probes - values[:, POINTS:]))) / scale
        # Negligible powers are dropped: each power costs time in every evaluation.
        relevant = np.max(np.abs(fitted), axis=(0, 2)) > ROUNDING * scale
        terms = int(np.max(np.flatnonzero(relevant), initial=0)) + 1
        fitted = np.ascontiguousarray(np.swapaxes(fitted[:, :terms], 1, 2))
        return cls(t, fitted), deviation

    @property
    def count(self) -> int:
        """Number of pieces."""
        return self.t.size - 1

    def ends(self) -> Array:
        """Values just after the beginning and just before the end of each piece.

        Returns:
            Shape (P, 2, n).
        """
        signs = np.vander([-1.0, 1.0], self.coefficients.shape[2], increasing=True)
        return np.swapaxes(self.coefficients[: self.count] @ signs.T, 1, 2)

    def means(self) -> Array:
        """Mean values of the pieces over time, shape (P, n)."""
        power = np.arange(self.coefficients.shape[2])
        # Odd powers of s in [-1, 1] have the mean zero.
        weights = np.where(power % 2 == 0, 1.0 / (power + 1.0), 0.0)
        return np.asarray(self.coefficients[: self.count] @ weights)

    def on(self, piece: int | IntArray, times: Array) -> Array:
        """Values of pieces at times of shape (m,), ends of the pieces included.

        Args:
            piece: Index of the piece, for all times or for each, shape (m,).
            times: The times [s].

        Returns:
            Shape (m, n).
        """
        piece = np.broadcast_to(piece, times.shape)
        begin, end = self.t[piece], self.t[piece + 1]
        s = (2.0 * times - begin - end) / (end - begin)
        powers = np.vander(s, self.coefficients.shape[2], increasing=True)
        return np.asarray(np.einsum("mnk,mk->mn", self.coefficients[piece], powers))

    def __call__(self, times: Array) -> Array:
        """Values at times of shape (m,), shape (m, n); just after a jump."""
        if not self.count:
            return np.repeat(self.coefficients[:, :, 0], times.size, axis=0)
        piece = np.searchsorted(self.t, times, side="right") - 1
        piece = np.clip(piece, 0, self.count - 1)
        out = np.empty((times.size, self.coefficients.shape[1]))
        for first in range(0, times.size, CHUNK):
            chunk = slice(first, first + CHUNK)
            out[chunk] = self.on(piece[chunk], times[chunk])
        return out
