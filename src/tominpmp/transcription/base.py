"""Interfaces of transcriptions, and of the programs that solvers see.

A transcription is a parameterisation of motions by a vector z: it gives states at
instants and pulls derivatives by them back to z. With constraints at instants it makes
a nonlinear program (:mod:`~tominpmp.transcription.program`), whose objective is linear
in z (the duration) and whose rows lower <= g(z) <= upper are scaled so that a violation
of 1 means about "by 100 %". Solvers see a robot only through this program.
"""

from __future__ import annotations

import itertools
from abc import ABC, abstractmethod
from functools import cached_property
from typing import TYPE_CHECKING, Generic, NamedTuple, Protocol, TypeVar

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array, IntArray
from tominpmp.constraints.base import Partials, States
from tominpmp.constraints.joint_limits import JointLimit
from tominpmp.motion.trajectory import Trajectory
from tominpmp.transcription.instants import Instants
from tominpmp.transcription.rows import Rows

if TYPE_CHECKING:
    from tominpmp.transcription.problem_functions import ProblemFunctions

# Value of the rows of a motion that could not be integrated to its end, or of those of
# an interval whose inner stage cannot be solved for.
NOT_INTEGRATED = 1e3
# Lengths of intervals change by this share at most in one step.
LENGTH_STEP = 0.3


class Linearization(NamedTuple):
    """Jacobian of some rows.

    Attributes:
        rows: Indices of the rows that can matter for the step, shape (k,).
        matrix: Their Jacobian, shape (k, size).
    """

    rows: IntArray
    matrix: sp.csr_matrix


class StepBounds(NamedTuple):
    """Box for the step of one linear program.

    Attributes:
        lower: Shape (size,), <= 0.
        upper: Shape (size,), >= 0.
    """

    lower: Array
    upper: Array


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


class Solved(Protocol):
    """A nonlinear program, as those see it who keep what it was solved to."""

    @property
    def rows(self) -> Rows:
        """Bounds, kinds and groups of the rows."""

    @property
    def cost(self) -> Array:
        """Gradient of the duration, which is cost @ z, shape (size,)."""

    def evaluate(self, z: Array, room: float = np.inf) -> Array:
        """Row values g(z), shape (m,).

        Values of gradual constraints that are below their bounds by more than ``room``
        may be returned too large, but never closer to the bounds than ``room``.
        """

    def time_scale(self, z: Array, factor: float) -> Array:
        """The same path, slower by a factor."""

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


class Hull(ABC, Generic[M]):
    """Rows that keep a derivative of the positions within bounds at all times.

    Equations of a transcription are such rows, too.

    Attributes:
        name: Name of the kind.
        lower: Lower bounds, shape (1, m).
        upper: Upper bounds, shape (1, m).
        curable: Whether a slower motion violates them less.
        gradual: Whether rows far below their bounds may be left out.
    """

    name: str
    lower: Array
    upper: Array
    curable: bool = False
    gradual: bool = False

    @abstractmethod
    def of_motion(self, motion: M) -> Array:
        """Row values, shape (m,)."""

    @abstractmethod
    def by_unknowns(self, motion: M) -> sp.csr_matrix:
        """Their Jacobian, shape (m, size)."""

    def groups(self, by_component: bool) -> IntArray:
        """One group."""
        return np.zeros(self.lower.size, dtype=np.int64)

    def values(self, of: Transcription[M], motion: M, room: float = np.inf) -> Array:
        """Row values, shape (m,)."""
        return self.of_motion(motion)

    def jacobian(
        self, of: Transcription[M], motion: M, chosen: IntArray
    ) -> sp.csr_matrix:
        """Jacobian of some of the rows, shape (k, size)."""
        whole = self.by_unknowns(motion)
        return whole if chosen.size == whole.shape[0] else whole[chosen]


class Transcription(ABC, Generic[M]):
    """A parameterisation of motions: gives states, pulls derivatives back to unknowns.

    Its only constraints are the bounds of its own unknowns.

    Attributes:
        system: The functions of the problem.
        shares: Lengths of the intervals by the last unknowns, shape (N, m).
        kept: Fields of joint limits that are kept by bounds of unknowns.
        by_component: Whether an elastic variable is for one value at all instants (the
            paper's maximum over time) instead of all values at one instant.
        inspected: Shares of intervals at which values that jump at the nodes are
            inspected between their rows, by parts of an interval.
        highest: Highest order of constraints that can be kept: 3 where accelerations
            do not jump.
        segment_ends: Number of intervals up to the end of each segment.
    """

    system: ProblemFunctions
    shares: Array
    kept: frozenset[str] = frozenset()
    by_component: bool = False
    inspected: tuple[tuple[float, ...], ...] = ()
    highest: int = 2
    segment_ends: tuple[int, ...]

    @property
    @abstractmethod
    def size(self) -> int:
        """Number of unknowns."""

    @property
    def segments(self) -> list[tuple[int, int]]:
        """First interval of each segment, and the one after its last."""
        return list(itertools.pairwise((0, *self.segment_ends)))

    @cached_property
    def delays(self) -> Array:
        """Sum of the dwells before each interval [s], shape (N,)."""
        out = np.zeros(self.intervals)
        segments = self.system.problem.segments
        for end, segment in zip(self.segment_ends, segments, strict=False):
            out[end:] += segment.dwell
        return out

    @property
    def intervals(self) -> int:
        """Number N of intervals."""
        return int(self.shares.shape[0])

    @property
    def cost(self) -> Array:
        """Gradient of the duration."""
        columns = self.shares.shape[1]
        cost = np.zeros(self.size)
        cost[-columns:] = self.shares.sum(axis=0)
        return cost

    @property
    def goal_scale(self) -> Array | None:
        """Scale of the residuals of the goal.

        None for a configuration, which is a bound or eliminated.
        """
        given = self.system.final_configuration is not None
        return None if given else self.system.goal_scale

    @abstractmethod
    def motion(self, z: Array) -> M:
        """The motion of an iterate."""

    @abstractmethod
    def states(self, motion: M, at: Instants, order: int) -> States:
        """States at instants, with derivatives up to an order."""

    def rates(self, motion: M, at: Instants) -> Array:
        """Derivatives by time of the positions that :meth:`states` gives, (m, n).

        These are the velocities where the defects of the dynamics are zero, and slopes
        of the polynomials between nodes elsewhere.
        """
        return self.states(motion, at, 1).v

    @abstractmethod
    def pull_back(self, motion: M, at: Instants, partials: Partials) -> sp.csr_matrix:
        """Derivatives by the unknowns, shape (k, size), from derivatives by states."""

    def pull_back_sum(
        self, motion: M, at: Instants, partials: Partials, weights: Array
    ) -> Array:
        """Gradient of a weighted sum of values, shape (size,)."""
        return np.asarray(weights @ self.pull_back(motion, at, partials))

    @abstractmethod
    def instants(self, order: int, field: str) -> Instants:
        """Instants at which a constraint of an order is a row at first."""

    @property
    def torque_sequence(self) -> sp.csr_matrix | None:
        """Matrix that picks a sequence of torques from the first rows of torques.

        None where torques are unknowns.
        """
        return None

    def sequence_times(self, z: Array) -> Array:
        """Instants of the torque sequence as shares of T; the middles of intervals."""
        t = np.concatenate([[0.0], np.cumsum(self.motion(z).h)])
        return np.asarray(0.5 * (t[1:] + t[:-1]) / t[-1])

    def hull(
        self, limit: JointLimit, name: str, within: tuple[int, int] | None = None
    ) -> Hull[M] | None:
        """Rows that keep a joint limit at all times; None without them.

        Args:
            limit: The limit.
            name: Name of the kind of rows.
            within: First interval of the segment on which it holds, and the one after
                its last; None for all.
        """
        return None

    @property
    def equations(self) -> Hull[M] | None:
        """Rows of the equations of motion, if they are not eliminated."""
        return None

    def attention(self, steps: StepBounds) -> float:
        """How far below their bounds gradual constraints matter to steps of a box."""
        return np.inf

    @property
    def moving_attention(self) -> float:
        """The same for constraints that depend on time, for steps of any size."""
        return np.inf

    @property
    def cutoff(self) -> float:
        """Values of gradual constraints further below their bounds are not exact."""
        return np.inf

    @abstractmethod
    def steps(self, z: Array, radius: float) -> tuple[Array, Array]:
        """Least and largest steps of all unknowns but the durations, in their order.

        Args:
            z: Iterate.
            radius: Radius of the trust region [rad].

        Returns:
            An entry for each of these unknowns, in any shape.
        """

    def step_bounds(self, z: Array, radius: float) -> StepBounds:
        """Box of steps: the trust region of a radius [rad] within the bounds of z."""
        lower, upper = self.steps(z, radius)
        length = min(LENGTH_STEP, radius) * z[-self.shares.shape[1] :]
        return StepBounds(np.append(lower, -length), np.append(upper, length))

    @abstractmethod
    def variation(self, z: Array) -> Variation:
        """Differences of the controls, as a linear function near z."""

    @abstractmethod
    def time_scale(self, z: Array, factor: float) -> Array:
        """The same path, slower by a factor."""

    @abstractmethod
    def trajectory(self, z: Array) -> Trajectory:
        """The motion of an iterate."""

    def scaled_at(self, z: Array) -> Transcription[M]:
        """The transcription with scales of the controls from a motion."""
        return self

    def near(self, z: Array) -> Transcription[M]:
        """The transcription, quicker to evaluate near z; motions differ by rounding."""
        return self

    def turned(self, z: Array) -> tuple[Transcription[M], Array] | None:
        """The transcription with torque bounds for the directions in an iterate.

        Returns:
            The transcription, and the iterate within its bounds; None if joints with
            dry friction move in the assumed directions.
        """
        return None
