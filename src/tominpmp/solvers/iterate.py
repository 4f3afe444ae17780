"""Where an iteration stands, and what a step of it brought."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tominpmp.arrays import Array
from tominpmp.status import IterationRecord, Status
from tominpmp.transcription.base import Solved
from tominpmp.transcription.rows import Rows

# Weights stay this much above the multipliers seen.
WEIGHT_MARGIN = 1.5
# A violation counts as left alone if this share of it remains.
STUCK = 0.95
# Violations below this need no elastic variable.
NEGLIGIBLE = 1e-9
# Steps are taken when they bring this share of the predicted reduction (Fletcher,
# 1987).
ACCEPT = 0.1
# Share of the predicted reduction that is aimed for, and how fast the radius follows.
# Found on the random goals of benchmarks/random_goals.py: with the error of a
# linearisation quadratic in the radius, it leads to the radius that loses half.
AIM = 0.5
GROWTH = 2.5
SHRINK = 0.5
# The radius grows up to this share of the first one; below the other share the
# iteration has stalled.
LARGEST_RADIUS, SMALLEST_RADIUS = 5.0, 1e-6


def next_radius(radius: float, ratio: float, damping: float) -> float:
    """Radius of the trust region for the next iteration.

    Args:
        radius: The present one, as a share of the first one.
        ratio: Actual and predicted reduction, of the whole step.
        damping: Share of the step that was taken after a line search.
    """
    if damping < 1.0:
        factor = max(damping, 0.3)
    else:
        # The loss 1 - ratio is proportional to the radius.
        factor = min(max(AIM / max(1.0 - ratio, 1e-3), SHRINK), GROWTH)
    return min(radius * factor, LARGEST_RADIUS)


@dataclass(frozen=True, eq=False)
class Iterate:
    r"""Where an iteration stands.

    What it is to lower is an exact penalty merit, an objective and the weighted
    violations of its limits,

    .. math::
        \phi(z) = f(z) + \sum_g \mu_g \max_{i \in g} v_i(z)

    with the violations v of the rows of a group g. It is exact when each weight is
    above the sum of the multipliers of its group (Fletcher, 1987); the program of an
    iteration has one elastic variable a group for it.

    Attributes:
        z: Unknowns.
        values: Row values there.
        cost: Gradient of the duration, which is cost @ z.
        rows: What the rows are.
        weights: Weight mu of each kind of row [s], shape (kinds,).
        multipliers: Of all rows, from the last program.
        radius: Radius of the trust region, as a share of the first one.
        raises: How often weights were raised for want of feasibility.
        gains: Merit gained in the last iterations [s], the newest last.
    """

    z: Array
    values: Array
    cost: Array
    rows: Rows
    weights: Array
    multipliers: Array
    radius: float = 1.0
    raises: int = 0
    gains: tuple[float, ...] = ()

    @classmethod
    def of(cls, program: Solved, z: Array, weights: Array | float) -> Iterate:
        """An iterate of a program of which no multiplier is known.

        Args:
            program: The program.
            z: Unknowns.
            weights: Weights of the violations, by kinds of rows or of all [s].
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

    def raised_weights(self, multipliers: Array, promised: Array) -> Array:
        """Weights above the multipliers of a program, shape (kinds,).

        Those of a group with an elastic variable add up to its weight at most and say
        nothing about it; its weight is doubled where the program would leave the
        violation as it is.

        Args:
            multipliers: Of all rows, shape (m,).
            promised: Row values that the program promises, shape (m,).
        """
        violation = self.rows.group_violation(self.values)
        after = self.rows.group_violation(promised)
        elastic = violation > NEGLIGIBLE
        groups = np.zeros(elastic.size)
        np.add.at(groups, self.rows.group, np.abs(multipliers))
        kind = self.rows.group_kind
        needed = np.zeros_like(self.weights)
        np.maximum.at(needed, kind[~elastic], WEIGHT_MARGIN * groups[~elastic])
        stuck = np.zeros(self.weights.size, dtype=bool)
        stuck[kind[elastic & (after > STUCK * violation)]] = True
        weights = np.where(stuck, 2.0 * self.weights, self.weights)
        return np.asarray(np.maximum(weights, needed))

    def on(self, program: Solved, z: Array) -> Iterate:
        """The iterate of nearly the same program, with other rows and unknowns."""
        return replace(
            self,
            z=z,
            values=program.evaluate(z),
            rows=program.rows,
            multipliers=program.rows.carried(self.rows, self.multipliers),
        )


@dataclass(frozen=True, eq=False)
class SlpResult:
    """Outcome of an iteration.

    Attributes:
        status: How it ended.
        iterate: The last iterate.
        best: The iterate of the least objective without violation, if there was one.
        history: One record an iteration.
        program: The program as it was in the end, with the rows that have joined it.
        dropped: Whether a rule has given the motion up.
    """

    status: Status
    iterate: Iterate
    best: Iterate | None
    history: tuple[IterationRecord, ...]
    program: Solved
    dropped: bool = False


@dataclass(frozen=True, eq=False)
class Trial:
    """A point tried, with its merit."""

    z: Array
    values: Array
    merit: float
    damping: float = 1.0


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a step brought.

    Attributes:
        trial: The best point that was tried.
        predicted: Reduction of the merit that the program predicted [s].
        actual: Reduction that was had [s].
        ratio: Of the two, for the whole step.
        accepted: Whether the step was taken.
        settled: Whether no more progress is predicted, or was had lately.
    """

    trial: Trial
    predicted: float
    actual: float
    ratio: float
    accepted: bool
    settled: bool = False
