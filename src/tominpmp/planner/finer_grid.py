"""Finer grids: the grid of the best motion follows its bends.

A grid that was chosen before anything was known of the motion costs time where torques
switch inside an interval, where a quantity reaches its limit at one instant of it only,
and where obstacles bend the path. Intervals are halved where the controls bend;
the motion is the same on the new grid, and the first linear program there tells the
possible gain. Where that is little the round ends, else a few programs get nearly all
of it, and the next round looks where controls bend now.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from tominpmp.options import Options
from tominpmp.planner.candidate import Candidate
from tominpmp.planner.descent import near_to_it, total_variation_weight
from tominpmp.planner.plan_state import PlanState
from tominpmp.planner.work import KEPT, Schedule, Work
from tominpmp.solvers.exchange import RowExchange
from tominpmp.solvers.iterate import SlpResult
from tominpmp.solvers.loop import Loop, solve
from tominpmp.solvers.objective import LIGHT, MinimumTime
from tominpmp.solvers.stop import first_of
from tominpmp.solvers.trust_region_step import trust_regions
from tominpmp.status import IterationRecord, Status
from tominpmp.transcription.bends import BENDS, to_be_split
from tominpmp.transcription.distance_rows import times_of_rows, with_rows_at
from tominpmp.transcription.layout import Gridded, split_intervals
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import NonlinearProgram

logger = logging.getLogger(__name__)

# A round is the last whose predicted decrease is below FALLS times the worth of one.
FALLS = 2.0
# Time scaling removes a violation up to this, and costs no more than half of it.
CURABLE = 3e-4
# Programs that all rounds together may take at least.
LEAST_PROGRAMS = 16
# Iterations on a grid; and at most, where violations are left that slowing down does
# not cure: without them all that was gained would be lost.
ITERATIONS, MOST_ITERATIONS = 8, 20
# Trust region, as a share of the usual one: the new motion is near the former one.
RADIUS = 0.3


@dataclass(frozen=True)
class RefinementBudget:
    """The gain that finer grids must bring, and the programs they may take.

    Attributes:
        worth: A round is worth while if it promises this share of T.
        enough: An iteration goes on while the predicted gain that its last step left is
            more than this share of T: most of the gain comes with the first step.
        gain: Motions that gain less than this share of T are not worth a replay.
        rounds: Rounds of halving.
        work: Programs of all rounds together, to those of the search. A round that has
            used them up ends with its motion, and is the last.
        bends: Intervals are halved that have this share of all bends, with their
            lengths, together.
    """

    worth: float
    enough: float
    gain: float
    rounds: int
    work: float
    bends: float


STANDARD_BUDGET = RefinementBudget(3e-3, 1.5e-3, 5e-4, 5, 1.5, BENDS)
# Where time matters less than T.
GENEROUS_BUDGET = RefinementBudget(3e-4, 1.5e-4, 1e-4, 6, 4.0, 0.99)


def on_finer_grid(state: PlanState, options: Options) -> Schedule[None]:
    """Go on with the best motion on a grid of its own, if that pays.

    Args:
        state: The plan.
        options: Options, which may be other ones than those of the plan.
    """
    best = state.incumbent
    if best is None:
        return
    if best.layout is None:
        if options.refine == "grid":
            way = f"method {options.method!r}"
            _remark(state, best, f"It was not refined: that is not done for {way}.")
        return
    budget = STANDARD_BUDGET if options.refine == "auto" else GENEROUS_BUDGET
    made = sum(r.programs for one in state.candidates for r in one.history)
    programs = max(budget.work * made, LEAST_PROGRAMS)

    def spent() -> bool:
        return sum(record.programs for record in state.records) >= programs

    enough = RoundStop(budget, best.duration, spent)
    work = Work.from_best(state, best, partial(_refined, options, best, state, enough))
    # A motion that is cut short brings as much as one that is not, or is dropped: a
    # plan with more time would have dropped it.
    found = yield replace(work, cutoff=(1.0 - budget.gain) * best.duration)
    if found is None:
        _remark(state, best, KEPT.format(type(state.failures[-1]).__name__))


def _remark(state: PlanState, best: Candidate, remark: str) -> None:
    """Have the best motion say more of itself."""
    remark = f"{best.remark} {remark}".strip()
    state.amend(best, remark=remark)


def _refined(
    options: Options,
    candidate: Candidate,
    state: PlanState,
    enough: RoundStop,
    system: ProblemFunctions,
    *more: object,
) -> Candidate:
    """A motion on finer grids; the same if that brings next to nothing."""
    assert candidate.layout is not None  # noqa: S101
    of, z = candidate.layout.represented(system, candidate.trajectory)
    best: SlpResult | None = None
    budget, rows, reached = enough.budget, candidate.rows, candidate.duration
    for _ in range(budget.rounds):
        split = to_be_split(of, z, budget.bends)
        if not np.any(split):
            break
        of, z = split_intervals(of, z, split)
        # A few programs on the new grid, with the rows of distances that there were.
        few = near_to_it(options, RADIUS, MOST_ITERATIONS)
        T, free = float(of.cost @ z), system.in_free_space
        tv_weight = total_variation_weight(options, T, proximal=free)
        step, stop = trust_regions(few)
        result = solve(
            with_rows_at(NonlinearProgram.of(of).at(z), z, rows),
            MinimumTime.of(few, tv_weight),
            z,
            step,
            first_of(enough, stop),
            exchange=RowExchange(level=0.0, light=LIGHT),
            callback=state,
            keep=state.keep,
        )
        found, first = result.best, enough.first(result.history)
        logger.info("%d intervals: promise %.1e", of.intervals, first)
        if found is None or found.duration >= reached:
            break
        best, reached = result, found.duration
        if first < FALLS * budget.worth or enough.spent():
            break
        program = result.program
        assert isinstance(program, NonlinearProgram)  # noqa: S101
        assert isinstance(program.transcription, Gridded)  # noqa: S101
        of, z = program.transcription, found.z
        rows = times_of_rows(program, z)
    if best is None or reached > (1.0 - budget.gain) * candidate.duration:
        return candidate
    history = tuple(state.records)
    result = replace(best, status=candidate.status, history=history)
    finer = Candidate.of(candidate.name, result.program, candidate.initial, result)
    return replace(finer, remark=candidate.remark)


@dataclass(frozen=True)
class RoundStop:
    """Rule that ends the iterations of a round when no more is promised.

    Attributes:
        budget: The gain that finer grids must bring, and their programs.
        duration: T of the motion that has to be beaten [s].
        spent: Tells whether the programs of all rounds are used up.
    """

    budget: RefinementBudget
    duration: float
    spent: Callable[[], bool]

    def first(self, history: Sequence[IterationRecord]) -> float:
        """Gain predicted by the first step of a round, as a share of T."""
        return history[0].predicted / self.duration

    def __call__(self, loop: Loop) -> Status | None:
        """CONVERGED once it is enough."""
        record = loop.history[-1]
        vain = self.first(loop.history) < self.budget.worth
        if vain and len(loop.history) == 1:
            return Status.CONVERGED
        left = (record.predicted - max(record.actual, 0.0)) / self.duration
        enough = vain or left < self.budget.enough or self.spent()
        enough = enough or len(loop.history) >= ITERATIONS
        if not enough or record.violation > CURABLE:
            return None
        # Slowing down cures all that is violated, where it parts nothing.
        best = loop.best or loop.state
        slower = loop.objective.cured(loop.program, best, np.inf)
        return None if slower is None else Status.CONVERGED
