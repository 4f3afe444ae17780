"""The iterate of an iteration, the outcome of a step, and the result."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np

from tominpmp.arrays import Array
from tominpmp.status import IterationRecord, Status
from tominpmp.transcription.base import ProgramInterface, Rows

# First penalty weight, as a multiple of the objective, far above most multipliers, so
# that violations are reduced before the objective counts; and the factor by which a
# weight is raised if the iteration settles on a violated constraint.
HIGH_WEIGHT, WEIGHT_GROWTH = 10.0, 10.0
# Penalty weights exceed the largest sum of multipliers of their groups by this factor.
WEIGHT_MARGIN = 1.5
# Violations below this need no elastic variable.
NEGLIGIBLE = 1e-9


@dataclass(frozen=True, eq=False)
class Iterate:
    r"""An iterate, with the penalty weights and multipliers at it.

    The iteration reduces an exact penalty merit: the objective plus the weighted
    constraint violations,

    .. math::
        \phi(z) = f(z) + \sum_g \mu_g \max_{i \in g} v_i(z)

    with the violations v of the rows of a group g. It is exact if each weight is above
    the sum of the multipliers of its group (Fletcher, 1987); the subproblem of an
    iteration has one elastic variable per group for it.

    Attributes:
        z: Unknowns.
        values: Row values there.
        cost: Gradient of the duration, which is cost @ z.
        rows: Bounds, kinds and groups of the rows.
        weights: Weight mu of each kind of row [s], shape (kinds,).
        multipliers: Multipliers of all rows, from the last program.
        radius: Trust-region radius, as a share of the initial one.
        gains: Reductions of the merit in the last iterations [s], the newest last.
    """

    z: Array
    values: Array
    cost: Array
    rows: Rows
    weights: Array
    multipliers: Array
    radius: float = 1.0
    gains: tuple[float, ...] = ()

    @classmethod
    def of(cls, program: ProgramInterface, z: Array, weights: Array | float) -> Iterate:
        """An iterate without known multipliers.

        Args:
            program: The program.
            z: Unknowns.
            weights: Weights of the violations, one for all or one per kind of row [s].
        """
        rows, values = program.rows, program.evaluate(z)
        weights = np.broadcast_to(weights, len(rows.kinds))
        return cls(z, values, program.cost, rows, weights, np.zeros(rows.size))

    @property
    def duration(self) -> float:
        """T [s]."""
        return float(self.cost @ self.z)

    @property
    def violation(self) -> float:
        """Largest violation of all rows."""
        return self.rows.largest_violation(self.values)

    def penalty(self, values: Array) -> float:
        """Weighted violations of row values [s]."""
        violation = self.rows.group_violation(values)
        return float(self.weights[self.rows.group_kind] @ violation)

    def raised_weights(self, multipliers: Array) -> Array:
        """Weights above the multipliers of a program, shape (kinds,).

        The multipliers of a group with an elastic variable add up to its weight at
        most, so that they are no measure for it.

        Args:
            multipliers: Multipliers of all rows, shape (m,).
        """
        rigid = self.rows.group_violation(self.values) <= NEGLIGIBLE
        groups = np.bincount(self.rows.group, np.abs(multipliers), rigid.size)
        kind, needed = self.rows.group_kind, np.zeros_like(self.weights)
        np.maximum.at(needed, kind[rigid], WEIGHT_MARGIN * groups[rigid])
        return np.maximum(self.weights, needed)

    def on(self, program: ProgramInterface, z: Array) -> Iterate:
        """The iterate on a similar program, with other rows and unknowns."""
        return replace(
            self,
            z=z,
            values=program.evaluate(z),
            rows=program.rows,
            multipliers=program.rows.carried(self.rows, self.multipliers),
        )


P_co = TypeVar("P_co", bound=ProgramInterface, covariant=True)


@dataclass(frozen=True, eq=False)
class SlpResult(Generic[P_co]):
    """Result of a loop, whose programs have one class.

    Attributes:
        status: How it ended.
        iterate: The last iterate.
        best: The feasible iterate of the least objective; None without one.
        history: Records, one per iteration.
        program: The final program, with the rows that have joined it.
        dropped: Whether a stop rule has given the motion up.
    """

    status: Status
    iterate: Iterate
    best: Iterate | None
    history: tuple[IterationRecord, ...]
    program: P_co
    dropped: bool = False


@dataclass(frozen=True, eq=False)
class TrialPoint:
    """A trial point, with its row values, its merit and the damping of its step."""

    z: Array
    values: Array
    merit: float
    damping: float = 1.0


@dataclass(frozen=True, eq=False)
class StepOutcome:
    """Outcome of a step.

    Attributes:
        trial: The best trial point.
        predicted: Predicted reduction of the merit [s].
        actual: Actual reduction of the merit [s].
        ratio: Actual reduction divided by the predicted one, for the full step.
        accepted: Whether the step was accepted.
        settled: Whether little progress is predicted, or was made lately, and slowing
            down removes the violations that remain.
    """

    trial: TrialPoint
    predicted: float
    actual: float
    ratio: float
    accepted: bool
    settled: bool = False
