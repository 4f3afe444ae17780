"""Sequential convex programming: linearise, solve, correct, accept or shrink.

A linear program knows nothing of what bends. Where the solution is no vertex of its
rows, as on a way that a tool speed rules and that is shortest where it is straight, its
steps loop to the ends of the trust region and back. Constraints that are convex
functions of what is linear tell their curvature; weighted with the multipliers of the
last program it is added to the objective, and the steps are those of Newton's method.

The error of a linearisation is put into the right-hand side and the same program is
solved once more, which keeps steps along curved constraints from being refused
(Maratos effect; Fletcher and Sainz de la Maza, 1989; as feasibility iterations
Kiessling, Zanelli, Nurkanovic, Gillis, Diehl, Zeilinger, Pipeleers and Swevers, 2022).
If the merit still does not fall, a shorter step is sought: that costs evaluations,
while a smaller trust region would cost another program.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from tominpmp.arrays import Array
from tominpmp.linear_programs.choice import make_solver
from tominpmp.linear_programs.program import LpSolution
from tominpmp.linear_programs.solver import LpSolver
from tominpmp.options import Options
from tominpmp.solvers.iterate import (
    ACCEPT,
    GROWTH,
    Iterate,
    Outcome,
    Trial,
    next_radius,
)
from tominpmp.solvers.loop import Loop, Rule
from tominpmp.solvers.model import Model
from tominpmp.solvers.objective import RESTORABLE, Objective
from tominpmp.solvers.stop import Iterations, Raises, exhausted, first_of, settled
from tominpmp.solvers.subproblem import Subproblem, build_subproblem
from tominpmp.stopping import check
from tominpmp.transcription.program import NonlinearProgram

# Weights of the merit before any multiplier is known, in shares of the objective: what
# the duration can gain at most from a violation of 100 % of a torque (T/2), or of a
# limit of joints' velocities or of the speed of a tool (T).
FIRST_WEIGHTS = {"torque": 0.7, "acceleration": 0.7, "velocity": 2.0, "speed": 2.0}
OTHER_WEIGHT = 10.0
# Raising of the weights when the iteration settles on a violated constraint.
WEIGHT_GROWTH = 10.0
WEIGHT_RAISES = 4
# Gap of a program that is none, as a share of the tolerance. With half of it programs
# take more iterations; with twice as much warm starts on a clock took a period more.
ACCURACY = 0.1
# No progress is predicted if it is less than this share of the tolerance.
QUIET = 0.1
# Progress is judged over this many iterations.
WINDOW = 3
# Rounds of putting rows into a program that its step breaks by more than this.
ADDITIONS = 3
MISSED = 1e-4
LINE_SEARCH = (0.6, 0.36, 0.2, 0.1, 0.05, 0.02)
# A step that brings this share of what was predicted needs no correction.
ENOUGH = 0.8
# Second-order corrections of a step, by what the rows are: without equations a second
# one costs a third more programs and brings nothing (benchmarks/random_goals.py).
CORRECTIONS, CORRECTIONS_OF_EQUATIONS = 1, 4
# Another correction follows while one leaves at most this share of the violation.
CONTRACTION = 0.5
# They are for violations between these.
CORRECTABLE = 1.0
EXACT = 1e-10
# Share of the violation that the error of a step may have once the objective has
# settled, and the radius that is left at least.
SETTLED_ERROR = 0.05
SETTLED_RADIUS = 0.01
# Shorter motions are settled to a share of this: an arm that is at its goal already
# would get there sooner and sooner [s].
SHORTEST = 0.01


def trust_regions(
    options: Options, lp: LpSolver | None = None, accuracy: float | None = None
) -> tuple[TrustRegionStep, Rule]:
    """Steps within trust regions, and when they end.

    Args:
        options: The first radius, the solver and the limit on the iterations.
        lp: Another solver of the programs of the steps; None for that of the options.
        accuracy: Gap of such a program that is none, as a share of the objective; None
            fits its tolerance.
    """
    lp = make_solver(options.lp_solver) if lp is None else lp
    limits = Raises(WEIGHT_RAISES), exhausted, Iterations(options.max_iterations)
    step = TrustRegionStep(lp, options.trust_region, accuracy)
    return step, first_of(settled, *limits)


class _Proposal(NamedTuple):
    """What the program of an iteration proposes.

    Attributes:
        program: The program.
        model: Its objective.
        solution: Its solution.
        value: The objective at the iterate.
        step: The step, shape (size,).
        promised: Row values that the linearisation promises, shape (m,).
        reached: Row values where the step leads, shape (m,).
        room: Rows that have more of it need not be exact.
    """

    program: Subproblem
    model: Model
    solution: LpSolution
    value: float
    step: Array
    promised: Array
    reached: Array
    room: float


@dataclass(frozen=True, eq=False)
class TrustRegionStep:
    """A step of sequential linear, or quadratic, programming on any transcription.

    Attributes:
        lp: Solver of the programs.
        radius: Radius of the trust region to begin with [rad].
        accuracy: Gap of a program that is none, as a share of the objective; None fits
            its tolerance.
    """

    lp: LpSolver
    radius: float
    accuracy: float | None = None

    def start(
        self, program: NonlinearProgram, objective: Objective, z: Array
    ) -> Iterate:
        """The iterate to begin with, and the weights of its violations."""
        state = Iterate.of(program, z, 0.0)
        shares = np.array([first_weight(kind) for kind in program.rows.kinds])
        weights = objective.value(program, z, state.values) * shares
        return replace(state, weights=weights)

    def __call__(self, loop: Loop) -> None:
        """Linearise, solve, correct, search, accept or shrink."""
        state, objective = loop.state, loop.objective
        found = self._propose(loop)
        if found is None:
            radius = next_radius(state.radius, 0.0, 0.1)
            loop.reached(replace(state, radius=radius), None)
            return
        outcome = self._search(loop, found)
        multipliers = found.program.multipliers(found.solution)
        weights = state.raised_weights(multipliers, found.promised)
        if outcome.accepted:
            state = replace(state, z=outcome.trial.z, values=outcome.trial.values)
        gained = max(outcome.actual, 0.0)
        state = replace(
            state,
            weights=weights,
            radius=self._radius_after(loop, found, outcome),
            multipliers=multipliers,
            gains=(*state.gains, gained)[-WINDOW:],
        )
        value = objective.value(loop.program, state.z, state.values)
        little = objective.tolerance * max(value, SHORTEST)
        slow = len(state.gains) == WINDOW and sum(state.gains) < little
        settled = slow or outcome.predicted < QUIET * little
        if settled and not objective.restorable(loop.program, state):
            # Settled on a violated constraint: its weight may be below its multiplier.
            weights = WEIGHT_GROWTH * state.weights
            state = replace(state, weights=weights, raises=state.raises + 1, gains=())
        loop.reached(state, replace(outcome, settled=settled))

    def _propose(self, loop: Loop) -> _Proposal | None:
        """Build the program of an iteration and solve it.

        Rows far from their bounds are left out at first; those that the step breaks are
        put in.

        Returns:
            The proposal; None if the program could not be solved.
        """
        nlp, objective, state, lp = loop.program, loop.objective, loop.state, self.lp
        z, values = state.z, state.values
        radius = self.radius * state.radius
        steps = objective.within(nlp, nlp.step_bounds(z, radius))
        # The next step may be as much longer as trust regions grow.
        room = GROWTH * nlp.attention(steps)
        accuracy = self.accuracy
        if accuracy is None:
            accuracy = ACCURACY * objective.tolerance
        value = objective.value(nlp, z, values)
        accuracy *= value
        root = nlp.curvature(z, state.multipliers) if lp.curved else None
        unknown = lp.curved and root is None  # no multipliers yet, or nothing bends
        selecting = values
        linearization = nlp.linearize(z, selecting, steps)
        model = objective.model(nlp, state, steps, linearization).bent(root)
        for additions in range(1 + ADDITIONS):
            check()
            program = build_subproblem(state, model, linearization, steps, accuracy)
            solution = loop.counted(self.lp.solve(program.program))
            if unknown and solution.optimal:
                root = nlp.curvature(z, program.multipliers(solution))
                unknown = False
                if root is not None:
                    model = model.bent(root)
                    program = build_subproblem(
                        state, model, linearization, steps, accuracy
                    )
                    solution = loop.counted(self.lp.solve(program.program))
            if not solution.optimal:
                return None
            step = program.step(solution)
            reached = nlp.evaluate(z + step, room)
            broken = nlp.rows.violation(reached) > MISSED
            broken[linearization.rows] = False
            if additions == ADDITIONS or not np.any(broken):
                break
            selecting = np.where(broken, reached, selecting)
            linearization = nlp.linearize(z, selecting, steps)
        promised = values.copy()
        promised[program.rows] += program.change(step)
        return _Proposal(program, model, solution, value, step, promised, reached, room)

    def _search(self, loop: Loop, found: _Proposal) -> Outcome:
        """Try the step, corrections of it, then shorter ones."""
        nlp, state, rows = loop.program, loop.state, loop.program.rows
        program, model, penalty = found.program, found.model, state.penalty
        z, values, step = state.z, state.values, found.step

        def tried(
            step: Array, damping: float = 1.0, known: Array | None = None
        ) -> Trial:
            check()
            there = z + damping * step
            reached = nlp.evaluate(there, found.room) if known is None else known
            merit = model.value(there, reached) + penalty(reached)
            return Trial(there, reached, merit, damping)

        now = model.value(z, values)
        # In this order nothing is rounded where the objective is its model.
        promise = now - model.straight(z) + model.straight(z + step)
        promise += penalty(found.promised)
        if found.solution.curved:
            promise += model.bend(step)
        now += penalty(values)
        predicted = max(now - promise, 0.0)
        trial = best = tried(step, known=found.reached)
        equations = bool(np.any(rows.lower == rows.upper))
        for _ in range(CORRECTIONS_OF_EQUATIONS if equations else CORRECTIONS):
            left = rows.largest_violation(trial.values)
            brought = (now - trial.merit) / max(predicted, 1e-12)
            if brought >= ENOUGH or not EXACT < left < CORRECTABLE:
                break
            linear = values[program.rows] + program.change(trial.z - z)
            error = trial.values[program.rows] - linear
            again = loop.counted(self.lp.resolve(*program.corrected(error)))
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
        return Outcome(best, predicted, actual, ratio, actual > 0.0)

    def _radius_after(self, loop: Loop, found: _Proposal, outcome: Outcome) -> float:
        """Radius of the trust region for the next step, as a share of the first one.

        A linear program uses the whole of it for unknowns that the objective leaves
        free, with an error of the square of the radius. Once the objective has settled
        it is kept below the last violation, which a step of its size removes.
        """
        state, trial, objective = loop.state, outcome.trial, loop.objective
        radius = next_radius(state.radius, outcome.ratio, trial.damping)
        left = loop.program.rows.largest_violation(trial.values)
        little = objective.tolerance * found.value
        gradient = found.model.gradient
        change = max(abs(gradient @ (trial.z - state.z)), abs(gradient @ found.step))
        if change > little or not objective.feasibility < left <= RESTORABLE:
            return radius
        enough = math.sqrt(SETTLED_ERROR * left) / self.radius
        return min(radius, max(enough, SETTLED_RADIUS))


def first_weight(kind: str) -> float:
    """Weight of a kind of rows before any multiplier is known, in shares of T.

    Kinds are named as "torque", "torque on segment 2", or "speed of frame tip".
    """
    of_all, _, _ = kind.partition(" on segment")
    quantity, _, _ = of_all.partition(" of ")
    return FIRST_WEIGHTS.get(quantity, OTHER_WEIGHT)
