"""Sequential linear programming: linearise, solve, correct, accept or shrink, repeat.

Steps are corrected and shortened as :mod:`~tominpmp.solvers.step_search` says; its
corrections are the feasibility iterations of Kiessling, Zanelli, Nurkanovic, Gillis,
Diehl, Zeilinger, Pipeleers and Swevers (2022).
"""

from __future__ import annotations

import contextlib
import math
import time
from dataclasses import dataclass, replace

import numpy as np

from tominpmp.arrays import Array
from tominpmp.linear_programs import LpSolver
from tominpmp.options import Options
from tominpmp.solvers.callbacks import Callback, Keep, go_on, keep_nothing
from tominpmp.solvers.exchange import RowExchange
from tominpmp.solvers.iterate import Effort, Iterate, Outcome, SlpResult, Trial
from tominpmp.solvers.merit import Merit
from tominpmp.solvers.proposal import Proposal, propose
from tominpmp.solvers.restoration import RESTORABLE, restorable, restored
from tominpmp.solvers.step_search import StepSearch
from tominpmp.solvers.subproblem import Subproblem
from tominpmp.solvers.trust_region import TrustRegion, repairing
from tominpmp.status import IterationRecord, Status
from tominpmp.stopping import Stop, grace
from tominpmp.transcription.base import Program, Variation

# Where any motion will do: how much slower one may be made.
TIME_SCALINGS = (1.0, 1.02, 1.05, 1.1, 1.2)
# Weights of the merit before any multiplier is known, in shares of T: what the duration
# can gain at most from a violation of 100 % of a torque (T/2), or of a limit of joints'
# velocities or of the speed of a tool (T).
FIRST_WEIGHTS = {"torque": 0.7, "velocity": 2.0, "speed": 2.0}
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
LINE_SEARCH = (0.6, 0.36, 0.2, 0.1, 0.05, 0.02)
# A step that brings this share of what was predicted needs no correction.
ENOUGH = 0.8
# Second-order corrections of a step, by what the rows are: without equations a second
# one costs a third more programs and brings nothing (benchmarks/random_goals.py).
CORRECTIONS, CORRECTIONS_OF_EQUATIONS = 1, 4
# They are for violations between these.
CORRECTABLE = 1.0
EXACT = 1e-10
# Share of the violation that the error of a step may have once the duration has
# settled, and the radius that is left at least.
SETTLED_ERROR = 0.05
SETTLED_RADIUS = 0.01
# Shorter motions are settled to a share of this: an arm that is at its goal already
# would get there sooner and sooner [s].
SHORTEST = 0.01
# Time for slowing a motion down once the iteration was told to stop [s].
RESTORING = 0.2


@dataclass(frozen=True, eq=False)
class SlpSolver:
    """Sequential linear programming on any transcription.

    Attributes:
        nlp: The nonlinear program.
        options: Tolerances, limits and the trust region.
        smoothing: Weight of the total variation [s].
        lp: Solver of the linear programs.
        callback: Sees every record; a status ends the iteration.
        corrections: Second-order corrections of a step at most; None for what fits the
            program: several help where rows are equations, and one does where all are
            inequalities.
        keep: Is given the best motion so far, or the present one while there is none:
            the iteration may be told to stop at any time.
        accuracy: Gap of a program that is none, as a share of T; None fits tolerance.
        exchange: When to look between the rows, and what finds those missing, if any.
    """

    nlp: Program
    options: Options
    smoothing: float
    lp: LpSolver
    callback: Callback = go_on
    corrections: int | None = None
    keep: Keep = keep_nothing
    accuracy: float | None = None
    exchange: RowExchange | None = None

    def run(self, z: Array, *, after: SlpResult | None = None) -> SlpResult:
        """Iterate until it settles or has to stop.

        Args:
            z: Where to begin.
            after: Result for nearly the same program, whose history goes on.

        Raises:
            Stop: If it was told to; what it had is kept.
        """
        begin = time.perf_counter()
        iterate = self.init(z)
        self.keep(self.nlp, iterate)
        history: list[IterationRecord] = []
        if after is not None:
            history += after.history
            merit = replace(iterate.merit, weights=after.iterate.merit.weights)
            known = merit.rows.carried(
                after.iterate.merit.rows, after.iterate.multipliers
            )
            iterate = replace(
                iterate,
                merit=merit,
                region=repairing(iterate.violation),
                multipliers=known,
            )
        limit, solver, exchange = self.options.feasibility, self, self.exchange
        most = len(history) + self.options.max_iterations
        best = self.time_scaled(iterate)
        status = None if best is None else Status.FEASIBLE
        try:
            while status is None:
                effort = Effort()
                solver = replace(solver, nlp=solver.nlp.near(iterate.z))
                iterate, outcome = solver.step(iterate, effort)
                best = solver.time_scaled(iterate) or iterate.better_than(best, limit)
                self.keep(solver.nlp, best or iterate)
                record = solver.record(len(history), iterate, outcome, effort, begin)
                history.append(record)
                shown = self.callback(record)  # the last one, too
                ended = solver.terminate(iterate, outcome, most - len(history))
                status = ended or shown
                if best is not None and self.options.objective == "feasible":
                    status = Status.FEASIBLE
                # What has not moved since it was looked at would show nothing new.
                moved = status is not None or (outcome is not None and outcome.accepted)
                if exchange is not None and moved and exchange.due(iterate, status):
                    exchange = exchange.looked
                    joined = exchange.joined(solver.nlp, iterate)
                    if joined is not None:
                        program, iterate = joined
                        solver, best = replace(solver, nlp=program), None
                        if exchange.enough(program, iterate, status, limit):
                            continue
                        exchange, most = exchange.extended(iterate, most, len(history))
                        status = None if status is Status.CONVERGED else status
        except (Stop, KeyboardInterrupt):
            with grace(RESTORING), contextlib.suppress(Stop):
                last = restored(solver.nlp, iterate, limit).better_than(best, limit)
                self.keep(solver.nlp, last or iterate)
            raise
        assert status is not None  # noqa: S101
        if status is Status.FEASIBLE and best is not None:
            return SlpResult(status, best, best, tuple(history), program=solver.nlp)
        iterate = restored(solver.nlp, iterate, limit)
        best = iterate.better_than(best, limit)
        if status is Status.CONVERGED and best is None:
            status = Status.INFEASIBLE
        return SlpResult(status, iterate, best, tuple(history), program=solver.nlp)

    def init(self, z: Array) -> Iterate:
        """Iterate at the start."""
        nlp = self.nlp
        duration = float(nlp.cost @ z)
        shares = [first_weight(kind) for kind in nlp.rows.kinds]
        merit = Merit(nlp.cost, nlp.rows, self.smoothing, duration * np.array(shares))
        values = nlp.evaluate(z)
        return Iterate(z, values, merit, TrustRegion(), np.zeros(nlp.rows.size))

    def step(self, iterate: Iterate, effort: Effort) -> tuple[Iterate, Outcome | None]:
        """One iteration: linearise, solve, correct, search, accept or shrink."""
        merit, z = iterate.merit, iterate.z
        variation = self.variation(z)
        radius = self.options.trust_region * iterate.region.radius
        gap = self.accuracy
        if gap is None:
            gap = ACCURACY * self.options.tolerance
        found = propose(self.nlp, self.lp, iterate, radius, variation, effort, gap)
        if found is None:
            region = iterate.region.after(0.0, 0.1)
            return replace(iterate, region=region), None
        program, solution = found.program, found.solution
        outcome = self.search(iterate, found, variation, effort)
        multipliers = program.multipliers(solution)
        promised = self.promised(iterate, program, program.step(solution))
        merit = merit.raised(multipliers, iterate.values, promised)
        region = iterate.region.after(outcome.ratio, outcome.trial.damping)
        region = self.shrunk_near_feasible(
            region, iterate, outcome.trial, program.step(solution)
        )
        if outcome.accepted:
            iterate = replace(iterate, z=outcome.trial.z, values=outcome.trial.values)
        iterate = replace(
            iterate,
            merit=merit,
            region=region,
            multipliers=multipliers,
            gains=(*iterate.gains, max(outcome.actual, 0.0))[-WINDOW:],
        )
        if self.settled(iterate, outcome) and not self.restorable(iterate):
            # Settled on a violated constraint: its weight may be below its multiplier.
            merit = iterate.merit.scaled(WEIGHT_GROWTH)
            iterate = replace(iterate, merit=merit, raises=iterate.raises + 1, gains=())
        return iterate, outcome

    def variation(self, z: Array) -> Variation | None:
        """Differences of the controls as they are weighed; None if they are not."""
        return None if self.smoothing <= 0.0 else self.nlp.variation(z)

    def shrunk_near_feasible(
        self, region: TrustRegion, iterate: Iterate, trial: Trial, step: Array
    ) -> TrustRegion:
        """Trust region for removing the last violation once the duration has settled.

        A linear program uses the whole trust region for unknowns that the duration
        leaves free, with an error of the square of the radius; it is kept below the
        violation, which a step of its size removes.
        """
        left = self.nlp.rows.largest_violation(trial.values)
        cost, little = iterate.merit.cost, self.options.tolerance * iterate.duration
        change = abs(float(cost @ trial.z) - iterate.duration)
        small = max(change, abs(float(cost @ step))) <= little
        if not small or not self.options.feasibility < left <= RESTORABLE:
            return region
        enough = math.sqrt(SETTLED_ERROR * left) / self.options.trust_region
        return replace(region, radius=min(region.radius, max(enough, SETTLED_RADIUS)))

    def settled(self, iterate: Iterate, outcome: Outcome) -> bool:
        """Whether no more progress is predicted, or was had lately."""
        little = self.options.tolerance * max(iterate.duration, SHORTEST)
        if outcome.predicted < QUIET * little:
            return True
        return len(iterate.gains) == WINDOW and sum(iterate.gains) < little

    def restorable(self, iterate: Iterate) -> bool:
        """Whether slowing down can remove what violation is left."""
        return restorable(self.nlp, iterate, self.options.feasibility)

    def time_scaled(self, iterate: Iterate) -> Iterate | None:
        """The motion as slow as it has to be to keep all constraints.

        None if that is no cure, or not wanted, as the fastest motion is looked for.
        """
        if self.options.objective != "feasible":
            return None
        nlp, limit = self.nlp, self.options.feasibility
        rows = nlp.rows
        curable = rows.curable[rows.kind]
        if np.any(rows.violation(iterate.values)[~curable] > limit):
            return None
        for factor in TIME_SCALINGS:
            z, values = nlp.slower(iterate.z, factor, iterate.values)
            trial = replace(iterate, z=z, values=values)
            if trial.violation <= limit:
                return trial
        return None

    def search(
        self,
        iterate: Iterate,
        found: Proposal,
        variation: Variation | None,
        effort: Effort,
    ) -> Outcome:
        """Full step, second-order correction, then a line search on the merit."""
        merit, program, solution = iterate.merit, found.program, found.solution
        step = program.step(solution)
        now = merit(iterate.z, iterate.values, variation)
        # At a solution of the linear program its objective is the model of the merit.
        model = self.model(iterate, program, step, variation)
        if solution.curved:
            model += program.bend(step)
        predicted = max(now - model, 0.0)

        def resolve(error: Array) -> Array | None:
            again = effort.add(self.lp.resolve(*program.corrected(error)))
            return program.step(again) if again.optimal else None

        def enough(trial: Trial, violation: float) -> bool:
            brought = (now - trial.merit) / max(predicted, 1e-12)
            return brought >= ENOUGH or not EXACT < violation < CORRECTABLE

        corrections = self.corrections
        if corrections is None:
            rows = self.nlp.rows
            equations = bool(np.any(rows.lower == rows.upper))
            corrections = CORRECTIONS_OF_EQUATIONS if equations else CORRECTIONS
        search = StepSearch(
            self.nlp,
            lambda z, values: merit(z, values, variation),
            program,
            corrections,
            LINE_SEARCH,
            found.room,
        )
        origin = Trial(iterate.z, iterate.values, now)
        return search.run(origin, step, predicted, resolve, enough, found.reached)

    def model(
        self,
        iterate: Iterate,
        program: Subproblem,
        step: Array,
        variation: Variation | None,
    ) -> float:
        """Merit that the linearised rows promise for a step."""
        values = self.promised(iterate, program, step)
        return iterate.merit(iterate.z + step, values, variation)

    def promised(self, iterate: Iterate, program: Subproblem, step: Array) -> Array:
        """Row values that the linearisation promises for a step."""
        values = iterate.values.copy()
        values[program.rows] += program.change(step)
        return values

    def terminate(
        self, iterate: Iterate, outcome: Outcome | None, left: int
    ) -> Status | None:
        """Status if the iteration is to end, with so many left; else None."""
        if outcome is None:
            return Status.NUMERICAL_FAILURE if iterate.region.exhausted else None
        if self.settled(iterate, outcome) and self.restorable(iterate):
            return Status.CONVERGED
        if iterate.raises > WEIGHT_RAISES:
            return Status.INFEASIBLE
        if iterate.region.exhausted:
            return Status.STALLED
        if left <= 0:
            return Status.ITERATION_LIMIT
        return None

    def record(
        self,
        number: int,
        iterate: Iterate,
        outcome: Outcome | None,
        effort: Effort,
        begin: float,
    ) -> IterationRecord:
        """Record of an iteration."""
        return IterationRecord(
            iteration=number,
            duration=iterate.duration,
            violation=iterate.violation,
            objective=np.inf if outcome is None else outcome.trial.merit,
            predicted=0.0 if outcome is None else outcome.predicted,
            actual=0.0 if outcome is None else outcome.actual,
            radius=iterate.region.radius,
            accepted=outcome is not None and outcome.accepted,
            programs=effort.programs,
            pivots=effort.pivots,
            program_seconds=effort.seconds,
            seconds=time.perf_counter() - begin,
        )


def first_weight(kind: str) -> float:
    """Weight of a kind of rows before any multiplier is known, in shares of T.

    Kinds are named as "torque", "torque on segment 2", or "speed of frame tip".
    """
    of_all, _, _ = kind.partition(" on segment")
    quantity, _, _ = of_all.partition(" of ")
    return FIRST_WEIGHTS.get(quantity, OTHER_WEIGHT)
