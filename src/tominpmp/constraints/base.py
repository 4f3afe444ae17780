r"""Constraints along a motion (the paper's equation 6).

.. math:: b(x(\tau), \tau, T) \le 0 \quad \text{for all } \tau \in [0, 1]

A constraint gives values and partial derivatives at states; it is independent of the
parameterisation of the motion and of the solver. A transcription gives the states and
pulls the partial derivatives back to its unknowns (the chain rule, or the paper's
costates).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.checks import whole

NO_TIMES = np.zeros(0)


class States(NamedTuple):
    """States of a motion at m instants.

    Attributes:
        t: Times [s], shape (m,).
        q: Positions, shape (m, n) [rad or m].
        v: Velocities, shape (m, n); zero-sized where they are not needed.
        a: Accelerations, shape (m, n); zero-sized likewise.
        u: Torques less dry friction, shape (m, n), where they are unknowns of the
            motion; None where they follow from the accelerations.
    """

    t: Array
    q: Array
    v: Array
    a: Array
    u: Array | None = None


class Partials(NamedTuple):
    """Partial derivatives of k values by the states at their instants.

    Attributes:
        at: Index of the instant of each value, shape (k,).
        by_q: Shape (k, n); None for zero, here and below.
        by_v: Shape (k, n).
        by_a: Shape (k, n).
        by_u: Shape (k, n), where torques are unknowns.
        by_t: Shape (k,).
        row: Index of the row that each value is added to, shape (k,); None for a row
            for each value.
    """

    at: IntArray
    by_q: Array | None = None
    by_v: Array | None = None
    by_a: Array | None = None
    by_u: Array | None = None
    by_t: Array | None = None
    row: IntArray | None = None

    def times(self, factor: Array) -> Partials:
        """Values times factors, shape (k, 1)."""

        def product(part: Array | None) -> Array | None:
            return None if part is None else factor * part

        by_t = None if self.by_t is None else factor[:, 0] * self.by_t
        by_x = (product(part) for part in (self.by_q, self.by_v, self.by_a, self.by_u))
        by_q, by_v, by_a, by_u = by_x
        return Partials(self.at, by_q, by_v, by_a, by_u, by_t, self.row)


def both_instants(pairs: IntArray) -> IntArray:
    """The first instants of some pairs of instants, and then the second ones."""
    return np.concatenate([2 * pairs, 2 * pairs + 1])


def slope_partials(by: Partials, t: Array, pairs: IntArray, slope: Array) -> Partials:
    """Partial derivatives of slopes over time between both instants of pairs.

    Args:
        by: Partial derivatives of k quantities at the first instants of their pairs,
            and then at the second ones.
        t: Times of all instants [s], shape (m,).
        pairs: Index of the pair of each quantity, shape (k,).
        slope: Their slopes, shape (k,).
    """
    span = np.tile(np.diff(t)[::2][pairs], 2)
    sides = np.repeat([-1.0, 1.0], pairs.size)
    by_t = -sides * np.tile(slope, 2) / span
    row = np.tile(np.arange(pairs.size), 2)
    return by.times((sides / span)[:, None])._replace(by_t=by_t, row=row)


class Constraint(ABC):
    """A constraint at all times of a motion, or at some.

    Values are scaled so that a violation of 1 means about "by 100 %".

    Attributes:
        order: Highest derivative of the positions that it depends on: 0, 1, or 2, which
            is for torques too.
        field: "q", "v", "a", "j" or "u" if it bounds positions, velocities,
            accelerations, jerks or torques joint by joint; empty else.
        shared: Whether all its values together are relaxed by one elastic variable of a
            linear program; else each instant has an elastic variable.
        moving: Whether the values depend explicitly on time.
        gradual: Whether values far below their bounds may be left out of a linear
            program, as a step cannot bring them near the bounds.
        curable: Whether a slower motion along the same path violates it less.
    """

    order: int = 0
    field: str = ""
    shared: bool = True
    moving: bool = False
    gradual: bool = False
    curable: bool = False

    @property
    def bends(self) -> bool:
        """Whether values are convex functions of vectors; see :meth:`bend`."""
        return False

    @property
    @abstractmethod
    def name(self) -> str:
        """Its name, in reports and messages."""

    @property
    @abstractmethod
    def count(self) -> int:
        """Number p of values at an instant."""

    @abstractmethod
    def evaluate(self, states: States, attention: float = np.inf) -> Array:
        """Values, shape (m, p).

        Args:
            states: The states at m instants.
            attention: Values below their bound by more than this need not be exact, as
                long as they stay below it by that much and depend on the states alone.
        """

    @abstractmethod
    def differentiate(self, states: States, at: IntArray, which: IntArray) -> Partials:
        """Partial derivatives of some values.

        Args:
            states: The states at m instants.
            at: Row of each value in the result of :meth:`evaluate`, shape (k,).
            which: Its column, shape (k,).
        """

    def bend(self, states: States, at: IntArray, which: IntArray) -> Partials | None:
        """Second-order term of convex values, which linearised values lack.

        The term is given as vectors: half of their squared lengths is the second-order
        change of the values in a step (Gauss-Newton), as the values are convex
        functions of quantities that are linearised.

        Args:
            states: The states at m instants.
            at: Row of each value in the result of :meth:`evaluate`, shape (k,).
            which: Its column, shape (k,).

        Returns:
            Partial derivatives of the components of the vectors; ``row`` has the index
            of the value of each component. None without a second-order term.
        """
        return None

    def bounds(self, instants: int) -> tuple[Array, Array]:
        """Lower and upper bounds of the values at a number of instants."""
        shape = whole(instants, "instants"), self.count
        return np.full(shape, -np.inf), np.zeros(shape)

    @property
    def kinks(self) -> Array:
        """Times at which values may have a kink for any motion [s], shape (k,)."""
        return NO_TIMES

    def rises(self, duration: float) -> Array:
        """Largest partial derivatives by time before a time [1/s], shape (p,)."""
        return np.zeros(self.count)

    @property
    def room(self) -> Array:
        """Padding of the bounds beyond the limits of the problem, shape (p,)."""
        return np.zeros(self.count)

    @property
    def usable(self) -> Array | None:
        """Tolerated excess of values over their bounds between rows, shape (p,).

        None for constraints that are not inspected between rows.
        """
        return None

    # -- assumptions about a motion ----------------------------------------------------

    @property
    def assumes(self) -> bool:
        """Whether it makes assumptions about a motion."""
        return False

    @property
    def informed(self) -> bool:
        """Whether its assumptions are set."""
        return True

    def assumed(self, states: States, beside: Array) -> Constraint:
        """The constraint with its assumptions from a motion, at given instants.

        Args:
            states: The states at its instants.
            beside: Velocities near these instants, shape (m, n).
        """
        return self

    def corrected(
        self, states: States, beside: Array, tolerance: float
    ) -> tuple[Constraint, int]:
        """The constraint with assumptions from another motion, and their changes.

        Args:
            states: The states of the other motion.
            beside: Velocities near the instants, shape (m, n).
            tolerance: Tolerated relative excess.

        Returns:
            The constraint, and the number of values that the changes affect.
        """
        return self, 0

    def joined(self, other: Constraint) -> Constraint:
        """The constraint with its assumptions at these instants and at others."""
        return self
