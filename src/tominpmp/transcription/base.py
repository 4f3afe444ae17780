"""Interfaces of transcriptions, and of the programs that solvers see, with their rows.

A transcription is a parameterisation of motions by a vector z: it evaluates states at
instants, and pulls derivatives with respect to states back to z. Together with
constraints at instants it forms a nonlinear program
(:mod:`~tominpmp.transcription.program`), whose objective (the duration) is linear in z
and whose rows lower <= g(z) <= upper are scaled so that a violation of 1 means about
"by 100 %". Solvers see a robot only through this program.
"""

from __future__ import annotations

import itertools
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Generic, NamedTuple, Protocol, TypeVar

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array, IntArray
from tominpmp.constraints.base import Partials, States
from tominpmp.constraints.joint_limits import JointLimit
from tominpmp.motion.trajectory import Trajectory
from tominpmp.transcription.instants import Instants

if TYPE_CHECKING:
    from tominpmp.transcription.problem_functions import ProblemFunctions

# Value of all rows of a motion that could not be integrated to its end, and of the
# defects of an interval whose inner stage could not be solved for.
NOT_INTEGRATED = 1e3
# Largest relative change of the lengths of intervals in one step.
LENGTH_STEP = 0.3


class StepBounds(NamedTuple):
    """Box for the step of one linear program.

    Attributes:
        lower: Shape (size,), <= 0.
        upper: Shape (size,), >= 0.
    """

    lower: Array
    upper: Array


class Linearization(NamedTuple):
    """Jacobian of the rows that enter a linear program.

    Attributes:
        rows: Indices of the rows that can become active in the step, shape (k,).
        matrix: Their Jacobian, shape (k, size).
        steps: Box for the step.
        units: Units of the steps in programs, a number or of shape (size,), see
            :meth:`Transcription.units`.
    """

    rows: IntArray
    matrix: sp.csr_matrix
    steps: StepBounds
    units: Array | float = 1.0


class Variation(NamedTuple):
    """Differences of neighbouring controls in full ranges, G z + offset.

    Attributes:
        matrix: G, shape (k, size).
        offset: Shape (k,).
    """

    matrix: sp.csr_matrix
    offset: Array

    def at(self, z: Array) -> Array:
        """The differences, shape (k,)."""
        return np.asarray(self.matrix @ z + self.offset)

    def total(self, z: Array) -> float:
        """Sum of the absolute differences."""
        return float(np.abs(self.at(z)).sum())

    def squares(self, z: Array) -> float:
        """Sum of their squares."""
        return float(np.sum(self.at(z) ** 2))


@dataclass(frozen=True)
class Rows:
    """Bounds, kinds and groups of the rows of a program.

    Attributes:
        lower: Lower bounds, shape (m,).
        upper: Upper bounds, shape (m,); equal to the lower ones for equations.
        kind: Index of each row's kind in ``kinds``, shape (m,).
        group: Index of each row's group, whose rows share an elastic variable, (m,).
        kinds: Names of the kinds, for reports.
    """

    lower: Array
    upper: Array
    kind: IntArray
    group: IntArray
    kinds: tuple[str, ...]

    @property
    def size(self) -> int:
        """Number of rows."""
        return self.lower.size

    @property
    def not_integrated(self) -> Array:
        """Values of all rows of a motion that could not be integrated to its end."""
        return np.full(self.size, NOT_INTEGRATED)

    @cached_property
    def group_count(self) -> int:
        """Number of groups."""
        return int(self.group.max()) + 1 if self.size else 0

    def violation(self, values: Array) -> Array:
        """Violation of each row, >= 0, shape (m,)."""
        excess = np.maximum(values - self.upper, self.lower - values)
        return np.maximum(excess, 0.0)

    def largest_violation(self, values: Array) -> float:
        """Largest violation of any row; 0 without rows."""
        return float(np.max(self.violation(values), initial=0.0))

    def violation_by_kind(self, values: Array) -> dict[str, float]:
        """Largest violation of the rows of each kind, by its name."""
        excess = self.violation(values)
        return {
            kind: float(np.max(excess[self.kind == index], initial=0.0))
            for index, kind in enumerate(self.kinds)
        }

    def group_violation(self, values: Array) -> Array:
        """Largest violation in each group, shape (number of groups,)."""
        excess, out = self.violation(values), np.zeros(self.group_count)
        over = np.flatnonzero(excess)  # few of the rows, most of which are clearances
        np.maximum.at(out, self.group[over], excess[over])
        return out

    @cached_property
    def group_kind(self) -> IntArray:
        """Kind of each group, shape (number of groups,)."""
        out = np.zeros(self.group_count, dtype=np.int64)
        out[self.group] = self.kind
        return out

    def carried(self, former: Rows, values: Array) -> Array:
        """Transfer values of former rows to these rows; zero for rows that joined.

        Args:
            former: Rows of the program before an exchange: within each kind, rows that
                joined come last.
            values: Value of each former row.
        """
        out = np.zeros(self.size)
        for index, kind in enumerate(self.kinds):
            if kind in former.kinds:
                mine = np.flatnonzero(self.kind == index)
                known = values[former.kind == former.kinds.index(kind)]
                count = min(mine.size, known.size)
                out[mine[:count]] = known[:count]
        return out


class ProgramInterface(Protocol):
    """Interface of a nonlinear program for records of its iterates and solutions."""

    @property
    def system(self) -> ProblemFunctions:
        """Functions of the problem."""

    @property
    def rows(self) -> Rows:
        """Bounds, kinds and groups of the rows."""

    @property
    def cost(self) -> Array:
        """Gradient of the duration, which is cost @ z, shape (size,)."""

    def evaluate(self, z: Array, attention: float = np.inf) -> Array:
        """Row values g(z), shape (m,).

        Values of gradual constraints whose margin to their bound is larger than
        ``attention`` may be returned too large, but with no smaller margin than
        ``attention``.
        """

    def time_scale(self, z: Array, factor: float) -> Array:
        """Iterate for the same path, slower by a factor."""

    def trajectory(self, z: Array) -> Trajectory:
        """The motion of an iterate."""


class Motion(Protocol):
    """A motion of a transcription, from which states are evaluated."""

    @property
    def h(self) -> Array:
        """Lengths of the intervals [s], shape (N,)."""

    @property
    def finite(self) -> bool:
        """Whether all states are finite: an integration may fail."""


M = TypeVar("M", bound=Motion)


@dataclass(frozen=True, eq=False)
class HullRows(Generic[M]):
    """Rows that keep a derivative of the positions within bounds at all times.

    Most bound the control points of the derivative, in whose convex hull it stays. The
    equations of motion of a transcription are such rows as well, whose values are its
    defects.

    Attributes:
        name: Name of the kind of rows.
        bounds: Lower and upper bounds, shape (1, m) each.
        of_motion: Function from a motion to the row values, m numbers in any shape.
        by_unknowns: Function from a motion to their Jacobian, shape (m, size).
    """

    name: str
    bounds: tuple[Array, Array]
    of_motion: Callable[[M], Array]
    by_unknowns: Callable[[M], sp.csr_matrix]

    def groups(self, by_component: bool) -> IntArray:
        """Group of each row: all rows are in one group, shape (m,)."""
        return np.zeros(self.bounds[0].size, dtype=np.int64)

    def values(self, motion: M, attention: float = np.inf) -> Array:
        """Row values, shape (m,)."""
        return self.of_motion(motion).ravel()

    def jacobian(self, motion: M, chosen: IntArray) -> sp.csr_matrix:
        """Jacobian of some of the rows, shape (k, size)."""
        whole = self.by_unknowns(motion)
        return whole if chosen.size == whole.shape[0] else whole[chosen]

    def informed(self, motion: M) -> HullRows[M]:
        """The same rows: they make no assumptions about a motion."""
        return self


class Transcription(ABC, Generic[M]):
    """A parameterisation of motions: gives states, pulls derivatives back to unknowns.

    The only constraints it knows are bounds of its unknowns, its equations of motion,
    and joint limits that it can keep between the instants as well (:meth:`hull`).

    Attributes:
        system: The functions of the problem.
        shares: Lengths of the intervals by the last unknowns, shape (N, m).
        intervals: Number N of intervals.
        bounded: Fields of the joint limits that bounds of the unknowns keep.
        by_component: Whether one elastic variable relaxes one component of a constraint
            at all instants (the paper's maximum over time); otherwise it relaxes all
            components at one instant.
        inspected: Shares of an interval at which values that may jump at the nodes, as
            torques do, are inspected between their rows; one tuple for each part of
            the interval, in which the largest violation becomes a row.
        highest_order: Highest order of constraints that motions can keep: 3 where
            accelerations are continuous.
        degree: Degree of the positions on an interval, as far as they are splines.
        segment_ends: Number of intervals up to the end of each segment.
        size: Number of unknowns.
        moving_attention: Margin within which steps of any size can make gradual
            constraints active that depend on time; see :meth:`attention`.
        cutoff: Margin above which the values of gradual constraints are not exact.
    """

    bounded: frozenset[str] = frozenset()
    by_component: bool = False
    inspected: tuple[tuple[float, ...], ...] = ()
    highest_order: int = 2
    degree: int = 2
    size: int
    moving_attention: float = np.inf
    cutoff: float = np.inf

    def __init__(
        self,
        system: ProblemFunctions,
        shares: Array,
        segment_ends: tuple[int, ...] = (),
    ) -> None:
        self.system, self.shares = system, shares
        self.segment_ends = segment_ends or (len(shares),)
        self.intervals, self._m = map(int, shares.shape)
        self._n = system.n

    @property
    def segments(self) -> list[tuple[int, int]]:
        """Half-open range (first, end) of the intervals of each segment."""
        return list(itertools.pairwise((0, *self.segment_ends)))

    @cached_property
    def delays(self) -> Array:
        """Total duration of the dwells before each interval [s], shape (N,)."""
        out = np.zeros(self.intervals)
        segments = self.system.problem.segments
        for end, segment in zip(self.segment_ends, segments, strict=False):
            out[end:] += segment.dwell
        return out

    @property
    def cost(self) -> Array:
        """Gradient of the duration, shape (size,)."""
        cost = np.zeros(self.size)
        cost[-self._m :] = self.shares.sum(axis=0)
        return cost

    @property
    def goal_scale(self) -> Array | None:
        """Scale of the residuals of the goal.

        None if the goal is a configuration: bounds of unknowns keep it, or the unknowns
        are eliminated.
        """
        fixed = self.system.final_configuration is not None
        return None if fixed else self.system.goal_scale

    @abstractmethod
    def motion(self, z: Array) -> M:
        """The motion of an iterate."""

    @abstractmethod
    def states(self, motion: M, at: Instants, order: int) -> States:
        """States at instants, with derivatives of the positions up to an order."""

    @abstractmethod
    def pull_back(self, motion: M, at: Instants, partials: Partials) -> sp.csr_matrix:
        """Derivatives by the unknowns from derivatives by states, shape (k, size)."""

    def pull_back_sum(
        self, motion: M, at: Instants, partials: Partials, weights: Array
    ) -> Array:
        """Gradient of a weighted sum of values, shape (size,)."""
        return np.asarray(weights @ self.pull_back(motion, at, partials))

    @abstractmethod
    def instants(self, order: int, field: str) -> Instants:
        """Initial instants of the rows of a constraint of an order and a field."""

    @property
    def torque_sequence(self) -> sp.csr_matrix | None:
        """Matrix from the initial torque rows to the torque sequence of a motion.

        None where torques are unknowns.
        """
        return None

    def hull(
        self, limit: JointLimit, name: str, within: tuple[int, int] | None = None
    ) -> HullRows[M] | None:
        """Rows that keep a joint limit at all times; None where it must be sampled.

        Args:
            limit: The limit.
            name: Name of the kind of rows.
            within: Half-open range of the intervals on which the limit holds; None for
                all.
        """
        return None

    @property
    def equations(self) -> tuple[HullRows[M], ...]:
        """Rows of the equations of motion; empty where they are eliminated."""
        return ()

    def attention(self, steps: StepBounds) -> float:
        """Margin within which steps of a box can make gradual constraints active."""
        return np.inf

    @abstractmethod
    def steps(self, z: Array, radius: float) -> tuple[Array, Array]:
        """Lower and upper bounds of the step of all unknowns but the durations.

        Args:
            z: Iterate.
            radius: Radius of the trust region [rad].

        Returns:
            Two arrays of any shape, with one entry for each of these unknowns in order.
        """

    def step_bounds(self, z: Array, radius: float) -> StepBounds:
        """Box of steps: the trust region of a radius [rad] within the bounds of z."""
        lower, upper = self.steps(z, radius)
        length = min(LENGTH_STEP, radius) * z[-self._m :]
        return StepBounds(np.append(lower, -length), np.append(upper, length))

    def units(self, z: Array) -> Array | float:
        """Units of steps in programs: 1, as torques are shares of their limits."""
        return 1.0

    @abstractmethod
    def variation(self, z: Array) -> Variation:
        """Differences of neighbouring controls, as a linear function near z."""

    @abstractmethod
    def time_scale(self, z: Array, factor: float) -> Array:
        """Iterate for the same path, slower by a factor."""

    @abstractmethod
    def trajectory(self, z: Array) -> Trajectory:
        """The motion of an iterate."""

    def scaled_at(self, z: Array) -> Transcription[M]:
        """The transcription with the scales of its controls taken from an iterate."""
        return self

    def centred_at(self, z: Array) -> Transcription[M]:
        """The transcription, faster to evaluate near z; motions differ by rounding."""
        return self

    def with_signs_of(self, z: Array) -> tuple[Transcription[M], Array] | None:
        """The transcription with torque bounds for the velocity signs of an iterate.

        Returns:
            The transcription, and the iterate clipped to its bounds; None if all joints
            with dry friction move in the assumed directions.
        """
        return None
