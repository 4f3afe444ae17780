r"""The linear program of an iteration: step, total variation and elastic variables.

.. math::
    \min \; c^T d + \gamma \sum (p + m) + \sum_g \mu_g e_g
    \quad s.t. \quad l \le g(z) + J d - s e_g \le u, \quad
    G (z + d) + G_0 = p - m

Elastic variables e_g exist for the groups of rows that are violated, up to their
present violation, or a trace. Their coefficients s are the signs of the violations (for
equations the violations relative to the largest of the group, so that all shrink in
proportion), and zero on rows that are satisfied: d = 0 is always feasible.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array, IntArray
from tominpmp.program_records import LinearProgram, LpSolution
from tominpmp.solvers.merit import NEGLIGIBLE, Merit
from tominpmp.transcription.base import (
    Linearization,
    SquaredVariation,
    StepBounds,
    Variation,
)
from tominpmp.transcription.rows import Rows

# Keys of rows and columns that are not of the transcription begin here.
_KEY_BLOCK = 10_000_000
# Room of an elastic variable at least: in smaller boxes interior points stand still.
LEAST_ROOM = 1e-7


@dataclass(frozen=True, eq=False)
class Subproblem:
    """A linear program and how to read its solution.

    Attributes:
        program: The linear program.
        free: Indices of the unknowns that can move, shape (k,).
        rows: Indices of the transcription's rows in it, shape (r,).
        size: Number of unknowns of the transcription.
        row_count: Number of rows of the transcription.
        matrix: Jacobian of its rows in all unknowns, shape (r, size).
        root: Root of the curvature of its objective in all unknowns, but for that of
            squared differences, which the merit knows, shape (k, size); None if that
            is linear.
    """

    program: LinearProgram
    free: IntArray
    rows: IntArray
    size: int
    row_count: int
    matrix: sp.csr_matrix
    root: sp.csr_matrix | None = None

    def bend(self, step: Array) -> float:
        """What its curvature adds to the objective for a step."""
        return (
            0.0 if self.root is None else 0.5 * float(np.sum((self.root @ step) ** 2))
        )

    def step(self, solution: LpSolution) -> Array:
        """Step in all unknowns, shape (size,)."""
        step = np.zeros(self.size)
        step[self.free] = solution.x[: self.free.size]
        return step

    def multipliers(self, solution: LpSolution) -> Array:
        """Multipliers of all rows of the transcription, shape (row_count,)."""
        out = np.zeros(self.row_count)
        out[self.rows] = solution.row_duals[: self.rows.size]
        return out

    def corrected(self, error: Array) -> tuple[Array, Array]:
        """Row bounds with a second-order error of the rows put in, shape (r,)."""
        lower, upper = self.program.row_lower.copy(), self.program.row_upper.copy()
        count = self.rows.size
        lower[:count] -= error
        upper[:count] -= error
        return lower, upper


def build_subproblem(
    merit: Merit,
    values: Array,
    linearization: Linearization,
    steps: StepBounds,
    variation: Variation | None,
    z: Array,
    root: sp.csr_matrix | None = None,
    accuracy: float = 1e-6,
) -> Subproblem:
    """Build the linear program at an iterate.

    Args:
        merit: Weights.
        values: Row values g(z), shape (m,).
        linearization: Jacobian of the rows that may matter.
        steps: Box for the step.
        variation: Differences of the controls; None leaves them out.
        z: Iterate, shape (size,).
        root: Root of the curvature of the objective, shape (k, size); None for none.
        accuracy: A duality gap that is none [s].
    """
    rows = merit.rows
    gradient, curvature = merit.cost, root
    if isinstance(variation, SquaredVariation):
        own = math.sqrt(2.0 * merit.smoothing) * variation.matrix
        differences = variation.matrix @ z + variation.offset
        gradient = gradient + 2.0 * merit.smoothing * (differences @ variation.matrix)
        curvature = own if root is None else sp.vstack([root, own], format="csr")
        variation = None
    free = np.flatnonzero(steps.upper - steps.lower > 0.0)
    chosen, matrix, low, high = _rows_within_reach(rows, values, linearization, steps)
    violation = rows.group_violation(values)
    slack_groups = np.flatnonzero(violation > NEGLIGIBLE)
    count = chosen.size
    body = matrix[:, free]
    cost, lower, upper = [gradient[free]], [steps.lower[free]], [steps.upper[free]]
    keys = [free]
    if variation is not None:
        differences = variation.matrix @ z + variation.offset
        k = differences.size
        cost += [np.full(2 * k, merit.smoothing)]
        lower += [np.zeros(2 * k)]
        upper += [np.full(2 * k, np.inf)]
        keys += [_KEY_BLOCK + np.arange(2 * k)]
    row_keys, row_low, row_high = [chosen], [low], [high]
    if variation is not None:
        eye = sp.identity(k, format="csr")
        none = sp.csr_matrix((count, 2 * k))
        differing = sp.hstack([variation.matrix[:, free], -eye, eye], format="csr")
        body = sp.vstack([sp.hstack([body, none]), differing], format="csr")
        row_low.append(-differences)
        row_high.append(-differences)
        row_keys.append(_KEY_BLOCK + np.arange(k))
    if slack_groups.size:
        elastic = _elastic_columns(rows, values, chosen, violation, slack_groups)
        padding = sp.csr_matrix((body.shape[0] - count, slack_groups.size))
        body = sp.hstack([body, sp.vstack([elastic, padding])], format="csr")
        cost += [merit.weights[rows.group_kind[slack_groups]]]
        lower += [np.zeros(slack_groups.size)]
        upper += [np.maximum(violation[slack_groups] * (1.0 + 1e-9), LEAST_ROOM)]
        keys += [2 * _KEY_BLOCK + slack_groups]
    program = LinearProgram(
        np.concatenate(cost),
        body.tocsc(),
        np.concatenate(row_low),
        np.concatenate(row_high),
        np.concatenate(lower),
        np.concatenate(upper),
        np.concatenate(row_keys),
        np.concatenate(keys),
        _curvature(curvature, free, body.shape[1]),
        accuracy,
    )
    return Subproblem(program, free, chosen, z.size, rows.size, matrix, root)


def _curvature(
    root: sp.csr_matrix | None, free: IntArray, size: int
) -> sp.csc_matrix | None:
    """Curvature of the objective in all columns, from its root in the unknowns."""
    if root is None:
        return None
    of_step = root[:, free]
    rest = sp.csc_matrix((size - free.size, size - free.size))
    return sp.block_diag([of_step.T @ of_step, rest], format="csc")


def _rows_within_reach(
    rows: Rows, values: Array, linearization: Linearization, steps: StepBounds
) -> tuple[IntArray, sp.csr_matrix, Array, Array]:
    """Rows that a step in the box may bring to a bound: the others are left out.

    Returns:
        Their indices, shape (r,), their part of the Jacobian, and their bounds less
        their values, infinite where a bound is out of reach, which helps the solver.
    """
    matrix = linearization.matrix.tocsr()
    change = abs(matrix) @ np.maximum(np.abs(steps.lower), np.abs(steps.upper))
    here = values[linearization.rows]
    low, high = rows.lower[linearization.rows], rows.upper[linearization.rows]
    keep = (here + change >= high) | (here - change <= low)
    here, low, high, change = here[keep], low[keep], high[keep], change[keep]
    low = np.where(here - change > low, -np.inf, low) - here
    high = np.where(here + change < high, np.inf, high) - here
    return linearization.rows[keep], matrix[keep], low, high


def _elastic_columns(
    rows: Rows,
    values: Array,
    chosen: IntArray,
    violation: Array,
    slack_groups: IntArray,
) -> sp.csr_matrix:
    """Coefficients of the elastic variables in the chosen rows."""
    here = values[chosen]
    low, high = rows.lower[chosen], rows.upper[chosen]
    group = rows.group[chosen]
    column = np.full(violation.size, -1)
    column[slack_groups] = np.arange(slack_groups.size)
    sign = np.where(here > high, 1.0, np.where(here < low, -1.0, 0.0))
    equal = low == high
    share = (here - high)[equal] / np.maximum(violation[group[equal]], NEGLIGIBLE)
    sign[equal] = share
    used = np.flatnonzero((sign != 0.0) & (column[group] >= 0))
    return sp.csr_matrix(
        (-sign[used], (used, column[group[used]])),
        shape=(chosen.size, slack_groups.size),
    )
