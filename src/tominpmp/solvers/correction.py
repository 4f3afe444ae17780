r"""Second-order corrections of a step without another linear program.

At the end of a step rows miss what the linearisation promised by an error of second
order. The smallest change of the step that makes up for it on the rows that hold the
step (those with a multiplier, and those that it breaks) solves

.. math::
    \min_\delta \; \epsilon \|D^{-1} \delta\|^2 + \|A \delta - r\|^2 + \|G \delta\|^2

with the trust region's sizes D, rows A of the program, what they miss r, and those
differences G of controls that the program holds at zero. To first order it costs what
the multipliers say, which is what the program itself would find with its right-hand
side corrected, for the time of one iteration of an interior-point method.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from tominpmp.arrays import Array, BoolArray
from tominpmp.linear_programs import LpSolution
from tominpmp.solvers.subproblem import Subproblem
from tominpmp.transcription.base import StepBounds

# Rows hold a step if their multiplier is this share of the largest one at least.
HOLDING = 1e-5
# Weight of the size of the change, and of differences that are held.
SMALL, HELD = 1e-6, 0.1
# Differences are held whose multiplier is below this share of their weight.
FREE = 0.99


def corrected_step(
    program: Subproblem,
    solution: LpSolution,
    error: Array,
    steps: StepBounds,
    wide: StepBounds,
    smoothing: float,
) -> Array | None:
    """A step whose rows make up for an error of their linearisation.

    Args:
        program: The linear program.
        solution: Its solution.
        error: Of its rows at the end of a step, shape (r,).
        steps: The box of the program.
        wide: A larger one, which the corrected step does not leave.
        smoothing: Weight of the differences of the controls.

    Returns:
        Shape (size,); None if there is nothing to be corrected, or no solution.
    """
    free, count = program.free, program.rows.size
    step = program.step(solution)
    lower, upper = (
        bound[:count]
        for bound in (program.program.row_lower, program.program.row_upper)
    )
    promised = program.matrix @ step
    there = promised + error
    # Elastic variables are no cure: what is promised beyond a bound remains.
    lower, upper = np.minimum(lower, promised), np.maximum(upper, promised)
    size = np.abs(solution.row_duals[:count])
    holding = size > HOLDING * np.max(size, initial=0.0)
    wanted = np.where(holding, promised, np.clip(there, lower, upper))
    chosen = np.flatnonzero(holding | (wanted != there))
    if not chosen.size:
        return None
    differences = None
    held = _held(program, solution, smoothing)
    if held.any():
        differences = program.program.matrix.tocsr()[count:][: held.size][held]
        differences = differences[:, : free.size]
    scale = np.maximum(steps.upper - steps.lower, 1e-12)[free]
    matrix = program.matrix[chosen][:, free]
    change = least_change(matrix, (wanted - there)[chosen], scale, differences)
    if change is None:
        return None
    out = step.copy()
    out[free] += change
    return np.clip(out, wide.lower, wide.upper)


def least_change(
    matrix: sp.spmatrix,
    missed: Array,
    scale: Array,
    differences: sp.spmatrix | None = None,
    small: float = SMALL,
) -> Array | None:
    """The smallest change of unknowns that makes up for what rows miss.

    Args:
        matrix: Jacobian of the rows, shape (r, k).
        missed: What they miss, shape (r,).
        scale: What the unknowns are measured by, shape (k,).
        differences: What is to remain as it is, shape (d, k); None for nothing.
        small: Weight of the size of the change.

    Returns:
        Shape (k,); None if there is no solution.
    """
    rows, missed = _normed(matrix @ sp.diags(scale), missed)
    normal = rows.T @ rows + small * sp.identity(scale.size)
    if differences is not None:
        none = np.zeros(differences.shape[0])
        held, _ = _normed(differences @ sp.diags(scale), none)
        normal = normal + HELD * (held.T @ held)
    try:
        factors = splu(
            sp.csc_matrix(normal),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
    except RuntimeError:
        return None
    change = scale * factors.solve(rows.T @ missed)
    return change if np.all(np.isfinite(change)) else None


def _normed(matrix: sp.spmatrix, values: Array) -> tuple[sp.csr_matrix, Array]:
    """Rows of length 1, and their values."""
    rows = sp.csr_matrix(matrix)
    norms = np.sqrt(np.asarray(rows.multiply(rows).sum(axis=1)).ravel())
    factor = 1.0 / np.maximum(norms, 1e-12)
    return sp.csr_matrix(sp.diags(factor) @ rows), factor * values


def _held(program: Subproblem, solution: LpSolution, smoothing: float) -> BoolArray:
    """Which differences of controls the program holds at zero, shape (k,)."""
    duals = solution.row_duals[program.rows.size :]
    return np.asarray(np.abs(duals) < FREE * smoothing)
