"""Finer grids: the last part of a descent, whose grid follows the bends of its motion.

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
from typing import TYPE_CHECKING

import numpy as np

from tominpmp.planner.automatic_options import least_time, near_to_it
from tominpmp.solvers.exchange import RowExchange
from tominpmp.solvers.iterate import SlpResult
from tominpmp.solvers.loop import Loop, solve
from tominpmp.solvers.objective import LIGHT
from tominpmp.solvers.stop import first_of
from tominpmp.solvers.trust_region_step import trust_regions
from tominpmp.status import IterationRecord, Status
from tominpmp.transcription.bends import BENDS, to_be_split
from tominpmp.transcription.distance_rows import times_of_rows, with_rows_at
from tominpmp.transcription.layout import Gridded, split_intervals
from tominpmp.transcription.program import NonlinearProgram

if TYPE_CHECKING:
    from tominpmp.planner.plan_state import PlanState

logger = logging.getLogger(__name__)

# A round is the last whose predicted decrease is below FALLS times the worth of one.
FALLS = 2.0
# An iteration goes on while the predicted gain that its last step left is more than
# this share of the worth of a round: most of the gain comes with the first step.
ENOUGH = 0.5
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
        gain: Motions that gain less than this share of T are left on their grid: their
            last steps tell that they are optimal there.
        rounds: Rounds of halving.
        work: Programs of all rounds together, to those of the search. A round that has
            used them up ends with its motion, and is the last.
        bends: Intervals are halved that have this share of all bends, with their
            lengths, together.
    """

    worth: float
    gain: float
    rounds: int
    work: float
    bends: float


STANDARD_BUDGET = RefinementBudget(3e-3, 5e-4, 5, 1.5, BENDS)
# Where time matters less than T.
GENEROUS_BUDGET = RefinementBudget(3e-4, 1e-4, 6, 4.0, 0.99)


def on_finer_grids(result: SlpResult, state: PlanState) -> SlpResult:
    """Go on with the motion of a descent on grids of its own, if that pays.

    Args:
        result: The outcome of the descent.
        state: The plan.

    Returns:
        The outcome on the finest grid that was worth it, with the records of both; the
        same if finer grids bring next to nothing.
    """
    best, options, program = result.best, state.options, result.program
    if best is None or result.dropped or not isinstance(program, NonlinearProgram):
        return result
    incumbent = state.incumbent
    if incumbent is not None and options.refine != "switching":
        # Both on the grids that were asked for: only the faster one is refined, but
        # for an incumbent whose switches could not be placed exactly.
        rival = incumbent.coarser or incumbent
        if best.duration >= rival.trajectory.duration:
            return result
    usual = options.refine == "auto" and options.effort != "thorough"
    budget = STANDARD_BUDGET if usual else GENEROUS_BUDGET
    begun, first = _programs(state.records), len(state.records) - len(result.history)
    made = begun + sum(_programs(one.history) for one in state.candidates)
    most = begun + max(budget.work * made, LEAST_PROGRAMS)

    def spent() -> bool:
        return _programs(state.records) >= most

    few, found = near_to_it(options, RADIUS, MOST_ITERATIONS), result
    worth_it = (1.0 - budget.gain) * best.duration
    step, stop = trust_regions(few)
    for _ in range(budget.rounds):
        of, z = program.transcription, best.z
        assert isinstance(of, Gridded)  # noqa: S101
        split = to_be_split(of, z, budget.bends)
        if not np.any(split):
            break
        rows = times_of_rows(program, z)
        of, z = split_intervals(of, z, split)
        # A few programs on the new grid, with the rows of distances that there were.
        enough = RoundStop(budget, best.duration, spent)
        finer = solve(
            with_rows_at(NonlinearProgram.of(of).at(z), z, rows),
            least_time(of.system, few, best.duration, refined=True),
            z,
            step,
            first_of(enough, stop),
            exchange=RowExchange(level=0.0, light=LIGHT),
            callback=state,
            keep=state.keep,
        )
        promise = enough.first(finer.history)
        logger.info("%d intervals: promise %.1e", of.intervals, promise)
        if finer.best is None or finer.best.duration >= best.duration:
            break
        found, best, program = finer, finer.best, finer.program
        if promise < FALLS * budget.worth or enough.spent():
            break
        assert isinstance(program, NonlinearProgram)  # noqa: S101
    if best.duration > worth_it:
        return result
    records = state.records[first:]
    history = tuple(replace(r, iteration=r.iteration - first) for r in records)
    return replace(found, status=result.status, history=history)


def _programs(records: Sequence[IterationRecord]) -> int:
    """Number of programs that iterations have solved."""
    return sum(record.programs for record in records)


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
        enough = vain or left < ENOUGH * self.budget.worth or self.spent()
        enough = enough or len(loop.history) >= ITERATIONS
        if not enough or record.violation > CURABLE:
            return None
        # Slowing down cures all that is violated, where it parts nothing.
        best = loop.best or loop.state
        slower = loop.objective.cured(loop.program, best, np.inf)
        return None if slower is None else Status.CONVERGED
