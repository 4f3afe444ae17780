"""Sequential convex programming: linearise, solve, correct, accept or shrink.

Linear programs ignore curvature. If the solution is no vertex of the constraints, for
example if a limit of the tool speed rules a motion whose shortest path is straight,
their steps oscillate between the bounds of the trust region. Constraints that are
convex functions of linearised quantities provide their curvature; weighted with the
multipliers of the last program, it is added to the objective, and the steps become
those of Newton's method.

Second-order correction: the error of the linearisation is moved to the right-hand side,
and the same program is solved once more, so that steps along curved constraints are not
rejected (Maratos effect; Fletcher and Sainz de la Maza, 1989; as feasibility iterations
Kiessling, Zanelli, Nurkanovic, Gillis, Diehl, Zeilinger, Pipeleers and Swevers, 2022).
If the merit still does not fall, a line search tries shorter steps: it only costs
evaluations, while a smaller trust region would cost another program.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from tominpmp.arrays import Array
from tominpmp.linear_programs.choice import make_solver
from tominpmp.linear_programs.program import LpSolution
from tominpmp.linear_programs.solver import LpSolver
from tominpmp.options import Options
from tominpmp.solvers.iterate import HIGH_WEIGHT, WEIGHT_GROWTH, StepOutcome, TrialPoint
from tominpmp.solvers.loop import SETTLED_RADIUS, Loop, Rule, until_settled
from tominpmp.solvers.objective import RESTORABLE, Model
from tominpmp.solvers.subproblem import Subproblem, build_subproblem
from tominpmp.stopping import check

# Penalty weights before any multiplier is known, as multiples of the objective. They
# exceed the most that the duration can gain from a violation of 100 %: T/2 for torques,
# T for velocities of joints and for speeds of tools. Others begin with HIGH_WEIGHT.
FIRST_WEIGHTS = {"torque": 0.7, "acceleration": 0.7, "velocity": 2.0, "speed": 2.0}
# Weight that ends the iteration, in multiples of the objective. In descents of the
# golden set that led to a feasible motion weights were at most 4e4, in the others up to
# 1e16.
LARGEST_WEIGHT = 1e6
# Duality gap below which a program counts as solved, and predicted reduction below
# which there is no progress, as a share of the tolerance. With half of it programs take
# more iterations; with twice as much, warm starts on a clock took a period more.
ACCURACY = 0.1
# Number of iterations over which progress is judged.
WINDOW = 3
# Rows that the step violates join the program, in at most this many rounds.
ADDITIONS = 3
# Damping factors of the line search.
LINE_SEARCH = (0.6, 0.36, 0.2, 0.1, 0.05, 0.02)
# A step that achieves this share of the predicted reduction needs no correction.
ENOUGH = 0.8
# Most second-order corrections of a step, for programs without and with equations:
# without equations a second one costs a third more programs and gains nothing
# (benchmarks/random_goals.py).
CORRECTIONS, CORRECTIONS_OF_EQUATIONS = 1, 4
# Another correction follows if the last one leaves at most this share of the violation.
CONTRACTION = 0.5
# Largest violation that is corrected.
CORRECTABLE = 1.0
# Once the objective has settled, the second-order error of the next step may be at most
# this share of the violation.
SETTLED_ERROR = 0.05
# Least share of the predicted reduction for which a step is accepted (Fletcher, 1987).
ACCEPT = 0.1
# Ratio of actual to predicted reduction that the radius control aims for: as the error
# of a linearisation is quadratic in the radius, the radius settles where half of the
# predicted reduction is lost. It is also the smallest factor of the radius.
AIM = 0.5
# Largest factor of the radius, tuned by benchmarks/random_goals.py.
GROWTH = 2.5
# Largest radius, as a share of the initial one.
LARGEST_RADIUS = 5.0


def trust_regions(
    options: Options, lp: LpSolver | None = None, accuracy: float | None = None
) -> tuple[TrustRegionStep, Rule]:
    """Steps within trust regions, and their stop rule.

    Args:
        options: Options with the initial radius, the solver and the iteration limit.
        lp: Solver of the subproblems; None for the solver of the options.
        accuracy: Duality gap below which a subproblem counts as solved, as a share of
            the objective; None for a gap that fits the tolerance of the objective.
    """
    lp = make_solver(options.lp_solver) if lp is None else lp
    stop = until_settled(LARGEST_WEIGHT, options.max_iterations)
    return TrustRegionStep(lp, options.trust_region, accuracy), stop


class _Proposal(NamedTuple):
    """The step that the subproblem of an iteration proposes.

    Attributes:
        program: The subproblem.
        model: The model of the objective.
        solution: The solution of the subproblem.
        value: The objective at the iterate.
        step: The step, shape (size,).
        linear: Row values that the linearisation predicts, shape (m,).
        reached: Row values after the step, shape (m,).
        slack: Rows with more slack than this need not be evaluated exactly.
    """

    program: Subproblem
    model: Model
    solution: LpSolution
    value: float
    step: Array
    linear: Array
    reached: Array
    slack: float


@dataclass(frozen=True, eq=False)
class TrustRegionStep:
    """A step of sequential linear or quadratic programming, for any transcription.

    Attributes:
        lp: Solver of the subproblems.
        radius: Initial trust-region radius [rad].
        accuracy: Duality gap below which a subproblem counts as solved, as a share of
            the objective; None for a gap that fits the tolerance of the objective.
    """

    lp: LpSolver
    radius: float
    accuracy: float | None = None

    def first_weight(self, kind: str) -> float:
        """Weight above the most that the objective can gain from a violation of 100 %.

        Examples of kinds are "torque", "torque on segment 2", or "speed of frame tip".
        """
        on_any_segment, _, _ = kind.partition(" on segment")
        quantity, _, _ = on_any_segment.partition(" of ")
        return FIRST_WEIGHTS.get(quantity, HIGH_WEIGHT)

    def __call__(self, loop: Loop) -> None:
        """Linearise, solve, correct, search; accept the step or shrink the radius."""
        state, objective = loop.state, loop.objective
        proposal = self._propose(loop)
        if proposal is None:
            radius = next_radius(state.radius, 0.0, 0.1)
            loop.advance(replace(state, radius=radius), None)
            return
        outcome = self._search(loop, proposal)
        multipliers = proposal.program.multipliers(proposal.solution)
        weights = state.raised_weights(multipliers)
        if outcome.accepted:
            state = replace(state, z=outcome.trial.z, values=outcome.trial.values)
        state = replace(
            state,
            weights=weights,
            radius=self._radius_after(loop, proposal, outcome),
            multipliers=multipliers,
            gains=(*state.gains, max(outcome.actual, 0.0))[-WINDOW:],
        )
        value = objective.value(loop.program, state.z, state.values)
        little = objective.tolerance * value
        slow = len(state.gains) == WINDOW and sum(state.gains) < little
        settled = slow or outcome.predicted < ACCURACY * little
        # Slowing down does not help a motion that begins or ends moving.
        slower = objective.slowed(loop.program, state) if settled else state
        done = settled and slower.violation <= objective.feasibility
        if settled and not done:
            # The weight of the violated constraint may be below its multiplier.
            weights = WEIGHT_GROWTH * state.weights
            state = replace(state, weights=weights, gains=())
        loop.advance(state, replace(outcome, settled=done))

    def _propose(self, loop: Loop) -> _Proposal | None:
        """Build the subproblem of an iteration and solve it.

        Rows far from their bounds are left out at first; rows that the step violates
        join the subproblem, which is then solved again.

        Returns:
            The proposal; None if the subproblem could not be solved.
        """
        nlp, objective, state, lp = loop.program, loop.objective, loop.state, self.lp
        z, values = state.z, state.values
        radius = self.radius * state.radius
        steps = objective.within(nlp, nlp.step_bounds(z, radius))
        # The trust region of the next step may be larger by the factor GROWTH.
        slack = GROWTH * nlp.attention(steps)
        value = objective.value(nlp, z, values)
        accuracy = value * (self.accuracy or ACCURACY * objective.tolerance)
        # Solvers without curvature get a root without rows.
        root = nlp.curvature(z, lp.curved * state.multipliers)
        # There may be no multipliers yet, or no curvature.
        unknown = lp.curved and not root.shape[0]
        selecting = values
        linearization = nlp.linearize(z, selecting, steps)
        model = objective.model(nlp, state, linearization).with_curvature(root)
        additions = 0
        while True:
            check()
            program = build_subproblem(state, model, linearization, accuracy)
            begin = time.perf_counter()
            solution = loop.count(lp.solve(program.program), begin)
            if not solution.optimal:
                return None
            if unknown:
                unknown = False
                root = nlp.curvature(z, program.multipliers(solution))
                if root.shape[0]:
                    model = model.with_curvature(root)
                    continue
            step = program.step(solution)
            reached = nlp.evaluate(z + step, slack)
            broken = nlp.rows.violation(reached) > objective.feasibility
            broken[linearization.rows] = False
            if additions == ADDITIONS or not np.any(broken):
                break
            additions += 1
            selecting = np.where(broken, reached, selecting)
            linearization = nlp.linearize(z, selecting, steps)
        linear = values.copy()
        linear[program.rows] += program.change(step)
        return _Proposal(program, model, solution, value, step, linear, reached, slack)

    def _search(self, loop: Loop, proposal: _Proposal) -> StepOutcome:
        """Try the step, then its second-order corrections, then shorter steps."""
        nlp, state, rows = loop.program, loop.state, loop.program.rows
        program, model, penalty = proposal.program, proposal.model, state.penalty
        z, values, step = state.z, state.values, proposal.step

        def tried(
            step: Array, damping: float = 1.0, known: Array | None = None
        ) -> TrialPoint:
            check()
            there = z + damping * step
            reached = nlp.evaluate(there, proposal.slack) if known is None else known
            merit = model.value(there, reached) + penalty(reached)
            return TrialPoint(there, reached, merit, damping)

        now = model.value(z, values)
        # In this order there is no rounding error if the model is exact.
        modelled = now - model.without_curvature(z) + model.without_curvature(z + step)
        modelled += penalty(proposal.linear)
        if proposal.solution.curved:
            modelled += model.curvature_term(step)
        now += penalty(values)
        predicted = max(now - modelled, 0.0)
        trial = best = tried(step, known=proposal.reached)
        equations = bool(np.any(rows.lower == rows.upper))
        for _ in range(CORRECTIONS_OF_EQUATIONS if equations else CORRECTIONS):
            left = rows.largest_violation(trial.values)
            achieved = (now - trial.merit) / max(predicted, 1e-12)
            if achieved >= ENOUGH or not 0.0 < left < CORRECTABLE:
                break
            linear = values[program.rows] + program.change(trial.z - z)
            error = trial.values[program.rows] - linear
            begin = time.perf_counter()
            again = loop.count(self.lp.resolve(program.corrected(error)), begin)
            if not again.optimal:
                break
            trial = tried(program.step(again))
            best = min(best, trial, key=lambda trial: trial.merit)
            if rows.largest_violation(trial.values) > CONTRACTION * left:
                break
        ratio = (now - best.merit) / max(predicted, 1e-12)
        if ratio < ACCEPT:
            for damping in LINE_SEARCH:
                trial = tried(step, damping)
                if now - trial.merit > ACCEPT * damping * predicted:
                    best = trial
                    break
            else:
                best = replace(best, damping=LINE_SEARCH[-1])
        actual = now - best.merit
        return StepOutcome(best, predicted, actual, ratio, actual > 0.0)

    def _radius_after(
        self, loop: Loop, proposal: _Proposal, outcome: StepOutcome
    ) -> float:
        """Trust-region radius for the next step, as a share of the initial one.

        A linear program uses the whole trust region for unknowns that the objective
        leaves free, which causes violations of the order of the squared radius. Once
        the objective has settled, the radius is therefore limited, so that the next
        step removes the last violation instead of causing another one.
        """
        state, trial, objective = loop.state, outcome.trial, loop.objective
        radius = next_radius(state.radius, outcome.ratio, trial.damping)
        left = loop.program.rows.largest_violation(trial.values)
        little = objective.tolerance * proposal.value
        gradient = proposal.model.gradient
        change = max(abs(gradient @ (trial.z - state.z)), abs(gradient @ proposal.step))
        if change > little or not objective.feasibility < left <= RESTORABLE:
            return radius
        enough = math.sqrt(SETTLED_ERROR * left) / self.radius
        return min(radius, max(enough, SETTLED_RADIUS))


def next_radius(radius: float, ratio: float, damping: float) -> float:
    """Radius of the trust region for the next iteration.

    Args:
        radius: The present radius, as a share of the initial one.
        ratio: Actual reduction divided by the predicted one, for the full step.
        damping: Share of the step that was taken after a line search.
    """
    if damping < 1.0:
        factor = max(damping, 0.3)
    else:
        # The loss 1 - ratio is proportional to the radius.
        factor = AIM / min(max(1.0 - ratio, AIM / GROWTH), 1.0)
    return min(radius * factor, LARGEST_RADIUS)
