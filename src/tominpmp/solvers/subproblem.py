r"""The convex program of an iteration: step, total variation and elastic variables.

.. math::
    \min \; g^T d + |R d|^2 / 2 + w \sum (2 p - G d) + \sum_g \mu_g e_g
    \quad s.t. \quad l \le g(z) + J d - s e_g \le u, \quad
    p \ge G (z + d) + G_0, \quad p \ge 0

The absolute value of a difference x is 2 max(x, 0) - x. With two variables p and m of
the sum p + m and the difference p - m = x it would need an equation, beside which
interior points stall.

Elastic variables e_g exist for the groups of rows that are violated. Their upper bound
is the present violation, but at least a small positive one. Their coefficients s are
the signs of the violations (for equations, the violations relative to the largest of
the group, so that all shrink in proportion), and zero on satisfied rows, so that d = 0
is always feasible.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array, IntArray
from tominpmp.linear_programs.program import LinearProgram, LpSolution
from tominpmp.solvers.iterate import NEGLIGIBLE, Iterate
from tominpmp.solvers.objective import Model
from tominpmp.transcription.base import Linearization

# Least upper bound of an elastic variable: in smaller boxes interior points stall.
LEAST_ROOM = 1e-7


@dataclass(frozen=True, eq=False)
class Subproblem:
    """The convex program of an iteration, with the mapping of its solution.

    Attributes:
        state: The iterate.
        program: The program, linear apart from the curvature of its objective.
        free: Indices of the unknowns that can change, shape (k,).
        rows: Indices of the rows of the transcription that it contains, shape (r,).
        matrix: Jacobian of the rows by the unknowns that can change, shape (r, k).
        lost: Orthonormal changes of these rows that no step makes, shape (r, d): a pose
            has more components than an arm of five joints can change.
        units: Units of the steps in the program, shape (k,).
    """

    state: Iterate
    program: LinearProgram
    free: IntArray
    rows: IntArray
    matrix: sp.csr_matrix
    lost: Array
    units: Array

    def change(self, step: Array) -> Array:
        """Change of the linearised rows in a step, shape (r,)."""
        return np.asarray(self.matrix @ step[self.free])

    def step(self, solution: LpSolution) -> Array:
        """Step in all unknowns, shape (size,)."""
        step = np.zeros(self.state.z.size)
        step[self.free] = self.units * solution.x[: self.free.size]
        return step

    def multipliers(self, solution: LpSolution) -> Array:
        """Multipliers of all rows of the transcription, shape (m,)."""
        out = np.zeros(self.state.values.size)
        out[self.rows] = solution.row_duals[: self.rows.size]
        return out

    def corrected(self, error: Array) -> LinearProgram:
        """The program, its row bounds corrected by a second-order error, shape (r,)."""
        lower, upper = self.program.row_lower, self.program.row_upper
        error = error - self.lost @ (self.lost.T @ error)
        shift = np.pad(error, (0, lower.size - error.size))
        return replace(self.program, row_lower=lower - shift, row_upper=upper - shift)


def build_subproblem(
    state: Iterate, model: Model, linearization: Linearization, accuracy: float = 1e-6
) -> Subproblem:
    """Build the program at an iterate.

    Args:
        state: The iterate.
        model: Model of the objective near the iterate.
        linearization: Jacobian of the rows that may become active, with the box for the
            step.
        accuracy: Duality gap below which the program counts as solved [s].
    """
    rows, steps = state.rows, linearization.steps
    free = np.flatnonzero(steps.upper - steps.lower > 0.0)
    units = np.broadcast_to(linearization.units, state.z.shape)[free]
    scale = sp.diags(units)
    near, lost = _attainable(state, linearization, free)
    chosen, body, low, high = _rows_within_reach(near, linearization, free)
    violation = rows.group_violation(state.values)
    slack_groups = np.flatnonzero(violation > NEGLIGIBLE)
    elastic = _elastic_columns(near, chosen, violation, slack_groups)
    by_step = body @ scale
    blocks: list[list[sp.spmatrix | None]] = [[by_step, elastic]]
    # Costs and bounds of the columns, and bounds of the rows, by blocks.
    lower, upper = steps.lower[free] / units, steps.upper[free] / units
    gradient = units * model.gradient[free]
    columns, bounds = [(gradient, lower, upper)], [(low, high)]
    if model.variation is not None:
        jumps = model.variation.matrix[:, free] @ scale
        differences = model.variation.at(state.z)
        weights = np.full_like(differences, model.weight)
        blocks = [[by_step, None, elastic], [jumps, -sp.identity(weights.size), None]]
        gradient -= jumps.T @ weights
        most = np.full_like(weights, np.inf)
        columns.append((2.0 * weights, np.zeros_like(weights), most))
        bounds.append((-most, -differences))
    weights = state.weights[rows.group_kind[slack_groups]]
    most = np.maximum(violation[slack_groups] * (1.0 + 1e-9), LEAST_ROOM)
    columns.append((weights, np.zeros(most.size), most))
    matrix, of_step = sp.bmat(blocks, format="csc"), model.root[:, free] @ scale
    curved = sp.csc_matrix(of_step.T @ of_step)
    # The objective is linear in all other columns.
    curved.resize(matrix.shape[1], matrix.shape[1])
    cost, lower, upper = map(np.concatenate, zip(*columns, strict=True))
    low, high = map(np.concatenate, zip(*bounds, strict=True))
    program = LinearProgram(matrix, cost, lower, upper, low, high, curved, accuracy)
    return Subproblem(state, program, free, chosen, body, lost[chosen], units)


def _attainable(
    state: Iterate, linearization: Linearization, free: IntArray
) -> tuple[Iterate, Array]:
    """The iterate without the part of the values of goals that no step changes.

    This part is of second order if the goal can be reached. It would make the equations
    of the goal contradict each other, and keep their elastic variable from decreasing.

    Returns:
        The iterate, and orthonormal directions of this part, shape (m, d).
    """
    rows, every = state.rows, linearization.rows
    goals = np.array([kind.startswith("goal") for kind in rows.kinds], dtype=bool)
    mine = np.flatnonzero((goals[rows.kind] & (rows.lower == rows.upper))[every])
    slopes = np.linalg.qr(linearization.matrix[mine][:, free].toarray().T, mode="r")
    _, sizes, axes = np.linalg.svd(slopes)
    rank = np.count_nonzero(sizes > NEGLIGIBLE * np.max(sizes, initial=0.0))
    basis = axes[rank:].T
    lost = np.zeros((rows.size, basis.shape[1]))
    lost[every[mine]] = basis
    off = state.values - np.clip(state.values, rows.lower, rows.upper)
    return replace(state, values=state.values - lost @ (lost.T @ off)), lost


def _rows_within_reach(
    state: Iterate, linearization: Linearization, free: IntArray
) -> tuple[IntArray, sp.csr_matrix, Array, Array]:
    """Rows that may reach a bound within the box for the step; others are left out.

    Returns:
        Indices of these rows, shape (r,), their Jacobian by the unknowns that can
        change, and their bounds minus their values. Bounds that are out of reach are
        infinite, which helps the solver.
    """
    every, matrix, (lower, upper), _ = linearization
    change = abs(matrix) @ np.maximum(np.abs(lower), np.abs(upper))
    rows, here = state.rows, state.values[every]
    low, high = rows.lower[every], rows.upper[every]
    keep = (here + change >= high) | (here - change <= low)
    here, low, high, change = here[keep], low[keep], high[keep], change[keep]
    low = np.where(here - change > low, -np.inf, low) - here
    high = np.where(here + change < high, np.inf, high) - here
    return every[keep], matrix[keep][:, free], low, high


def _elastic_columns(
    state: Iterate, chosen: IntArray, violation: Array, slack_groups: IntArray
) -> sp.csc_matrix:
    """Coefficients of the elastic variables in the chosen rows."""
    rows, here = state.rows, state.values[chosen]
    low, high = rows.lower[chosen], rows.upper[chosen]
    group = rows.group[chosen]
    off = here - np.clip(here, low, high)
    share = off / np.maximum(violation[group], NEGLIGIBLE)
    sign = np.where(low == high, share, np.sign(off))
    used = np.flatnonzero((sign != 0.0) & np.isin(group, slack_groups))
    places = used, np.searchsorted(slack_groups, group[used])
    shape = chosen.size, slack_groups.size
    return sp.csc_matrix((-sign[used], places), shape=shape)
