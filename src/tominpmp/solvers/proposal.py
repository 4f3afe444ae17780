"""The program of an iteration, solved: linear, and curved where that is known.

A linear program knows nothing of what bends. Where the solution is no vertex of its
rows, as on a way that a tool speed rules and that is shortest where it is straight, its
steps run to the ends of the trust region and back. Constraints that are convex
functions of what is linear tell their curvature; weighted with the multipliers of the
last program it is added to the objective, and the steps are those of Newton's method.

Nor does it know of unknowns that the duration does not hang on: they may be anywhere in
the trust region, and what that breaks has to be mended. A small weight on the square of
the step keeps them where they are (proximal points, Rockafellar, 1976).
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np

from tominpmp.arrays import Array
from tominpmp.linear_programs import LpSolver, make_solver
from tominpmp.linear_programs.program import LpSolution
from tominpmp.solvers.iterate import Effort, Iterate
from tominpmp.solvers.subproblem import Subproblem, build_subproblem
from tominpmp.solvers.trust_region import GROWTH
from tominpmp.stopping import check
from tominpmp.transcription.base import Program, StepBounds, Variation

# Rounds of putting rows into a program that its step breaks by more than this.
ADDITIONS = 3
MISSED = 1e-4
# What a step of all unknowns to the ends of the trust region costs, as a share of T,
# where no weight on the sum of differences of the controls keeps them quiet. With a
# third of it iterations are as many, with three times as much motions end slower by
# 0.05 %.
PROXIMAL = 3e-3


class Proposal(NamedTuple):
    """What the program of an iteration proposes.

    Attributes:
        program: The program.
        solution: Its solution.
        reached: Row values where its step leads, shape (m,).
        room: Rows that have more of it need not be exact.
    """

    program: Subproblem
    solution: LpSolution
    reached: Array
    room: float


def propose(
    nlp: Program,
    lp: LpSolver,
    iterate: Iterate,
    radius: float,
    variation: Variation | None,
    effort: Effort,
    accuracy: float,
) -> Proposal | None:
    """Build the program of an iteration and solve it.

    Rows far from their bounds are left out at first; those that the step breaks are put
    in.

    Args:
        nlp: The nonlinear program.
        lp: Solver of the programs of the iterations.
        iterate: Where the iteration stands.
        radius: Radius of the trust region [rad].
        variation: Differences of the controls; None leaves them out.
        effort: Counts the work.
        accuracy: Gap of the program that is none, as a share of T.

    Returns:
        The proposal; None if the program could not be solved.
    """
    z = iterate.z
    steps = nlp.step_bounds(z, radius)
    # The next step may be as much longer as trust regions grow.
    room = GROWTH * nlp.attention(steps)
    selecting, multipliers = iterate.values, iterate.multipliers
    near = root = None
    if lp.curved:
        if variation is None:
            near = _proximal(nlp, steps, iterate.duration)
        root = nlp.curvature(z, multipliers)
    unknown = lp.curved and root is None  # no multipliers yet, or nothing bends
    for _ in range(1 + ADDITIONS):
        check()
        linearization = nlp.linearize(z, selecting, steps)
        build = partial(
            build_subproblem,
            iterate.merit,
            iterate.values,
            linearization,
            steps,
            variation,
            z,
            near=near,
            accuracy=accuracy * iterate.duration,
        )
        program = build(root)
        solution = solved(lp, program, effort)
        if unknown and solution.optimal:
            root = nlp.curvature(z, program.multipliers(solution))
            unknown = False
            if root is not None:
                program = build(root)
                solution = solved(lp, program, effort)
        if not solution.optimal:
            return None
        reached = nlp.evaluate(z + program.step(solution), room)
        broken = nlp.rows.violation(reached) > MISSED
        broken[linearization.rows] = False
        if not np.any(broken):
            break
        selecting = np.where(broken, reached, selecting)
    return Proposal(program, solution, reached, room)


def _proximal(nlp: Program, steps: StepBounds, duration: float) -> Array:
    """Roots of the weights on the squares of a step, shape (size,).

    Args:
        nlp: The nonlinear program.
        steps: Box for the step.
        duration: T [s].
    """
    reach = np.maximum(-steps.lower, steps.upper)
    moving = (reach > 0.0) & (nlp.cost == 0.0)
    weights = np.zeros(nlp.size)
    share = 2.0 * PROXIMAL * duration / max(int(moving.sum()), 1)
    weights[moving] = np.sqrt(share) / reach[moving]
    return weights


def solved(lp: LpSolver, program: Subproblem, effort: Effort) -> LpSolution:
    """Solution of the program of an iteration."""
    solution = effort.add(lp.solve(program.program))
    if not solution.optimal:
        solution = effort.add(make_solver("highs").solve(program.program))
    return solution
