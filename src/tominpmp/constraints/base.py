r"""Constraints along a motion (the paper's equation 6).

.. math:: b(x(\tau), \tau, T) \le 0 \quad \text{for all } \tau \in [0, 1]

A constraint gives values and partial derivatives at states; it depends neither on the
parameterisation of the motion nor on the solver. A transcription provides the states
and pulls the partial derivatives back to its unknowns (by the chain rule, or by the
paper's costates).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.checks import whole
from tominpmp.motion_limits import LimitKind

# Tolerated excess of a value over its bound between rows, in units of the scale.
USABLE = 2e-3
NO_TIMES = np.zeros(0)


class States(NamedTuple):
    """States of a motion at m instants.

    Attributes:
        t: Times [s], shape (m,).
        q: Positions, shape (m, n) [rad or m].
        v: Velocities, shape (m, n); of size zero if they are not needed.
        a: Accelerations, shape (m, n); of size zero if they are not needed.
        u: Torques less dry friction, shape (m, n), if they are unknowns of the motion;
            None if they follow from the accelerations.
    """

    t: Array
    q: Array
    v: Array
    a: Array
    u: Array | None = None


class Partials(NamedTuple):
    """Partial derivatives of k values with respect to the states at their instants.

    Attributes:
        at: Index of the instant of each value, shape (k,).
        by_q: Derivatives by positions, shape (k, n); None means zero, here and below.
        by_v: Derivatives by velocities, shape (k, n).
        by_a: Derivatives by accelerations, shape (k, n).
        by_u: Derivatives by torques, shape (k, n), if torques are unknowns.
        by_t: Derivatives by time, shape (k,).
        row: Index of the row to which each value is added, shape (k,); None if each
            value is a separate row.
    """

    at: IntArray
    by_q: Array | None = None
    by_v: Array | None = None
    by_a: Array | None = None
    by_u: Array | None = None
    by_t: Array | None = None
    row: IntArray | None = None

    def times(self, factor: Array) -> Partials:
        """Partial derivatives of the values times factors, shape (k,)."""
        by = (None if part is None else (factor * part.T).T for part in self[1:6])
        return Partials._make([self.at, *by, self.row])

    @staticmethod
    def both_instants(pairs: IntArray) -> IntArray:
        """Indices of the first instants of pairs, followed by the second instants."""
        return np.concatenate([2 * pairs, 2 * pairs + 1])

    def slopes(self, t: Array, pairs: IntArray, slope: Array) -> Partials:
        """Partial derivatives of slopes in time between the two instants of pairs.

        These are the partial derivatives of the k quantities at the first instants of
        their pairs, followed by the second instants.

        Args:
            t: Times of all instants [s], shape (m,).
            pairs: Index of the pair of each quantity, shape (k,).
            slope: Slope of each quantity, shape (k,).
        """
        span = np.tile(np.diff(t)[::2][pairs], 2)
        sides = np.repeat([-1.0, 1.0], pairs.size)
        by_t = -sides * np.tile(slope, 2) / span
        row = np.tile(np.arange(pairs.size), 2)
        return self.times(sides / span)._replace(by_t=by_t, row=row)


class Constraint(ABC):
    """A constraint at all times of a motion, or during a part of it.

    Values are scaled so that a violation of 1 means about "by 100 %".

    Attributes:
        order: Order of the highest derivative of the positions in it: 0, 1, 2 (torques,
            too), or 3 for rates between pairs of instants.
        field: "q", "v", "a", "j" or "u" if it bounds positions, velocities,
            accelerations, jerks or torques joint by joint; empty otherwise.
        moving: Whether the values depend explicitly on time.
        gradual: Whether values far below their bounds may be left out of a linear
            program, as a step cannot bring them near the bounds. Each instant has an
            elastic variable then; otherwise one elastic variable relaxes all values.
        curable: Whether a slower motion along the same path violates it less.
    """

    order: int = 0
    field: str = ""
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
        """Name of the constraint, in reports and messages."""

    @property
    @abstractmethod
    def count(self) -> int:
        """Number p of values at an instant."""

    @abstractmethod
    def evaluate(self, states: States, attention: float = np.inf) -> Array:
        """Values, shape (m, p).

        Args:
            states: The states at m instants.
            attention: Values whose margin to their bound is larger than this need not
                be exact, as long as their margin stays larger than this and they depend
                on the states alone.
        """

    @abstractmethod
    def differentiate(self, states: States, at: IntArray, which: IntArray) -> Partials:
        """Partial derivatives of some values.

        Args:
            states: The states at m instants.
            at: Row of each value in the result of :meth:`evaluate`, shape (k,).
            which: Column of each value in this result, shape (k,).
        """

    def bend(self, states: States, at: IntArray, which: IntArray) -> Partials | None:
        """Second-order term of convex values, which linearised values lack.

        The values are convex functions of quantities that are linearised. The term is
        given by one vector for each value: half of its squared length is the
        second-order change of the value in a step (Gauss-Newton).

        Args:
            states: The states at m instants.
            at: Row of each value in the result of :meth:`evaluate`, shape (k,).
            which: Column of each value in this result, shape (k,).

        Returns:
            Partial derivatives of the components of the vectors; ``row`` is the index
            of the value of each component. None without a second-order term.
        """
        return None

    def bounds(self, instants: int) -> tuple[Array, Array]:
        """Lower and upper bounds of the values at a number of instants."""
        shape = whole(instants, "instants"), self.count
        return np.full(shape, -np.inf), np.zeros(shape)

    @property
    def kinks(self) -> Array:
        """Times at which any motion has rows in addition [s], shape (k,).

        Values may have a kink there, or a time window has its rows.
        """
        return NO_TIMES

    def rises(self, duration: float) -> Array:
        """Largest partial derivatives by time up to a duration [1/s], shape (p,)."""
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


@dataclass(frozen=True, eq=False)
class LimitOfJoints(Constraint):
    """A limit of joints or their motors, each of which has values of its own.

    Attributes:
        kind: The kind of limit.
        of_joints: Joint of each value at an instant, shape (count,).
    """

    kind: LimitKind
    of_joints: IntArray

    @property
    def name(self) -> str:
        """Name of the kind of limit, with "torque" in place of "effort"."""
        return self.kind.name.replace("effort", "torque")

    @property
    def count(self) -> int:
        """Number of values at an instant."""
        return int(self.of_joints.size)
