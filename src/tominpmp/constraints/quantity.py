"""Quantities that stay below a limit: their values at one state, and at many."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator

import numpy as np

from tominpmp.arrays import Array
from tominpmp.checks import JOINTS, array
from tominpmp.constraints.base import Constraint

# Values and their derivatives by q, v and a; empty where they do not depend on it.
Linear = tuple[Array, Array, Array, Array]


class Quantity(Constraint):
    """A quantity of the state with its limit.

    Most are the length of a :meth:`vector` that is a smooth function of the state; rows
    are made of it rounded off about zero, where a length has a kink, see
    :func:`rounded`. Those that are no length give their rows by :meth:`terms`, or by
    :meth:`value_rows` and :meth:`term_rows`, and their number by ``count``.
    """

    @property
    @abstractmethod
    def largest(self) -> float:
        """Largest value of the quantity that is allowed."""

    @property
    def scale(self) -> float:
        """What an excess of the quantity is measured by."""
        return self.largest

    @property
    def count(self) -> int:
        """One value."""
        return 1

    @abstractmethod
    def measure(self, q: Array, v: Array, a: Array) -> float:
        """The quantity at one state, shapes (n,); what is not asked for is empty."""

    def vector(self, q: Array, v: Array, a: Array) -> Linear:
        """A vector whose length is the quantity, and its derivatives.

        Returns:
            Vector, shape (k,), and derivatives by q, v and a, shape (k, n) each; empty
            for those that it does not depend on.
        """
        raise NotImplementedError(f"{type(self).__name__} is no length")

    @property
    def bends(self) -> bool:
        """Lengths are convex functions of their vectors; of others nothing is known."""
        return self._is_length and type(self).term_rows is Quantity.term_rows

    # -- many states at once: state by state, where nothing quicker is known -----------

    def measure_rows(self, q: Array, v: Array, a: Array) -> Array:
        """Those of :meth:`measure`, shapes (m, n) to (m,)."""
        found = [self.measure(*state) for state in _states(q, v, a)]
        return np.array(found, dtype=np.float64)

    def vector_rows(self, q: Array, v: Array, a: Array) -> Linear:
        """Those of :meth:`vector`: shapes (m, k), and (m, k, n) or empty."""
        every = [self.vector(*state) for state in _states(q, v, a)]
        vector, by_q, by_v, by_a = (np.array(part) for part in zip(*every, strict=True))
        return vector, by_q, by_v, by_a

    def value_rows(self, q: Array, v: Array, a: Array) -> Array:
        """Those of :meth:`values`, shape (m, count)."""
        if self._is_length:
            limit = self.largest / self.scale
            sizes = self.measure_rows(q, v, a) / self.scale
            return rounded(sizes, limit)[:, None]
        found = [self.values(*state) for state in _states(q, v, a)]
        return np.array(found).reshape(-1, self.count)

    def term_rows(self, q: Array, v: Array, a: Array) -> Linear:
        """Those of :meth:`terms`: shapes (m, count), and (m, count, n) or empty."""
        if not self._is_length:
            every = [self.terms(*state) for state in _states(q, v, a)]
            found = [np.array(part) for part in zip(*every, strict=True)]
            return found[0], found[1], found[2], found[3]
        vector, *by = self.vector_rows(q, v, a)
        length, limit = np.linalg.norm(vector, axis=1), self.largest
        values = rounded(length / self.scale, limit / self.scale)[:, None]
        size = np.sqrt(0.5 * (length**2 + limit**2)) * self.scale
        along = (vector / np.maximum(size, 1e-300)[:, None])[:, None, :]
        by_q, by_v, by_a = (along @ part if part.size else part for part in by)
        return values, by_q, by_v, by_a

    def bend_rows(
        self, q: Array, v: Array, a: Array
    ) -> tuple[Array, Array, Array] | None:
        """Slopes of vectors whose squared lengths values lack when linearised.

        Values are convex functions of the vectors of :meth:`vector_rows`: what a step
        of these does to them is known to second order.

        Returns:
            By q, v and a, shape (m, count, k, n) each or empty; None if nothing is
            known.
        """
        if not self.bends:
            return None
        vector, *by = self.vector_rows(q, v, a)
        root = length_bend(vector, self.largest) / np.sqrt(self.scale)
        by_q, by_v, by_a = (
            (root @ part)[:, None] if part.size else part for part in by
        )
        return by_q, by_v, by_a

    # -- one state ---------------------------------------------------------------------

    @property
    def _is_length(self) -> bool:
        return type(self).terms is Quantity.terms

    def values(self, q: Array, v: Array, a: Array) -> Array:
        """Those of :meth:`terms` alone, where that is quicker, shape (count,)."""
        return self.terms(q, v, a)[0]

    def terms(self, q: Array, v: Array, a: Array) -> Linear:
        """Smooth values at a state, and their derivatives.

        Returns:
            Values in units of the scale, <= 0 where the limit is kept, shape (count,),
            and their derivatives by q, v and a, shape (count, n) each; empty where
            there are none.
        """
        values, *by = self.term_rows(*one_row(q, v, a))
        by_q, by_v, by_a = (part[0] if part.size else np.zeros(0) for part in by)
        return values[0], by_q, by_v, by_a


def one_row(q: Array, v: Array, a: Array) -> tuple[Array, Array, Array]:
    """A state as rows of states; what is not asked for may be empty."""
    q, v, a = (array(x, k, (None,), JOINTS) for k, x in (("q", q), ("v", v), ("a", a)))
    return q[None], v[None], a[None]


def _states(q: Array, v: Array, a: Array) -> Iterator[tuple[Array, Array, Array]]:
    """States in rows, one after the other."""
    q = array(q, "q", (None, None), JOINTS)
    shape = len(q), None
    return zip(
        q, array(v, "v", shape, JOINTS), array(a, "a", shape, JOINTS), strict=True
    )


def rounded(length: Array, limit: float) -> Array:
    """Lengths beyond a limit, rounded off about zero where they have a kink.

    sqrt(2 x^2 + 2 L^2) - 2 L has the sign of x - L, and its slope there.
    """
    return np.asarray(np.sqrt(2.0 * (length**2 + limit**2)) - 2.0 * limit)


def length_bend(vector: Array, limit: float) -> Array:
    """Roots of the second derivative of rounded lengths by their vectors.

    That of s = sqrt(2 x^2 + 2 L^2) is (2 I - 4 x x^T / s^2) / s.

    Args:
        vector: The vectors x, shape (m, k).
        limit: The limit L.

    Returns:
        Symmetric matrices, shape (m, k, k).
    """
    square = np.sum(vector**2, axis=1)
    size = np.maximum(np.sqrt(2.0 * (square + limit**2)), 1e-300)
    # Along the vector there is less of it.
    along = 1.0 - np.sqrt(2.0) * limit / size
    outer = vector[:, :, None] * vector[:, None, :]
    outer *= (along / np.maximum(square, 1e-300))[:, None, None]
    root = np.eye(vector.shape[1]) - outer
    return np.asarray(np.sqrt(2.0 / size)[:, None, None] * root)
