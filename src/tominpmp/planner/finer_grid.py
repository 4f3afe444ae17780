"""Finer grids: the last part of a descent refines the grid where its controls bend.

The initial grid is chosen without knowledge of the motion. It costs time where torques
switch inside an interval, where a quantity reaches its limit only at an instant, and
where obstacles bend the path. A round of refinement halves the intervals on which the
controls bend. The motion is the same on the new grid, and the first convex program
there predicts the possible gain. If it is small, the round ends; otherwise a few
programs obtain nearly all of it, and the next round halves intervals anew.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from tominpmp.planner.automatic_options import minimum_time, warm_start_options
from tominpmp.solvers.exchange import RowExchange
from tominpmp.solvers.iterate import SlpResult
from tominpmp.solvers.loop import Loop, solve
from tominpmp.solvers.objective import SMALL_VIOLATION
from tominpmp.solvers.stop import first_of
from tominpmp.solvers.trust_region_step import trust_regions
from tominpmp.status import IterationRecord, Status
from tominpmp.transcription.distance_rows import times_of_rows, with_rows_at
from tominpmp.transcription.halving import HALVED_SHARE, intervals_to_halve
from tominpmp.transcription.layout import Gridded, split_intervals
from tominpmp.transcription.program import NonlinearProgram

if TYPE_CHECKING:
    from tominpmp.planner.plan_state import PlanState

logger = logging.getLogger(__name__)
Descended = SlpResult[NonlinearProgram]

# The iterations of a round continue while the part of the predicted gain that the last
# step has not realised exceeds this share of the least gain of a round: most of the
# gain comes with the first step.
ENOUGH = 0.5
# Least budget of programs of all rounds.
LEAST_PROGRAMS = 16
# Usual and largest number of iterations on a grid. The largest is for motions with
# violations that slowing down does not remove: the gain would be lost with them.
ITERATIONS, MOST_ITERATIONS = 8, 20
# Trust-region radius as a share of the usual one: the motion changes little.
RADIUS = 0.3


@dataclass(frozen=True)
class RefinementBudget:
    """Thresholds for the gain of finer grids, and limits for their work.

    Attributes:
        worth: Least gain that a round must predict, as a share of T.
        gain: Least gain of all rounds, as a share of T. Below it the motion remains on
            the grid of the search, where its last steps show it to be optimal.
        rounds: Most rounds of halving.
        work: Most programs of all rounds, as a multiple of the programs of the search.
            The round that uses them up is the last one.
        halved: The intervals that are halved have this share of the losses of all
            intervals.
    """

    worth: float
    gain: float
    rounds: int
    work: float
    halved: float


STANDARD_BUDGET = RefinementBudget(3e-3, 5e-4, 5, 1.5, HALVED_SHARE)
# For plans in which planning time matters less than T.
GENEROUS_BUDGET = RefinementBudget(3e-4, 1e-4, 6, 4.0, 0.99)


def on_finer_grids(result: Descended, state: PlanState) -> Descended:
    """Improve the motion of a descent on finer grids, as long as the gain is worth it.

    Args:
        result: The result of the descent.
        state: The plan.

    Returns:
        The result on the last grid that gained enough, with the records of all grids;
        the given result if finer grids gain next to nothing, or the transcription has
        no grid that can be refined.
    """
    best, options, program = result.best, state.options, result.program
    if best is None or result.dropped:
        return result
    incumbent = state.incumbent
    if incumbent is not None and options.refine != "switching":
        # On the requested grid only a candidate that beats the incumbent is refined,
        # unless the incumbent is refined for want of exact switches.
        rival = incumbent.coarser or incumbent
        if best.duration >= rival.trajectory.duration:
            return result
    usual = options.refine == "auto" and options.effort != "thorough"
    budget = STANDARD_BUDGET if usual else GENEROUS_BUDGET
    programs, first = _programs(state.records), len(state.records) - len(result.history)
    total = programs + sum(_programs(c.history) for c in state.candidates)
    most = programs + max(budget.work * total, LEAST_PROGRAMS)

    def spent() -> bool:
        return _programs(state.records) >= most

    warm, finest = warm_start_options(options, RADIUS, MOST_ITERATIONS), result
    worth_it = (1.0 - budget.gain) * best.duration
    step, stop = trust_regions(warm)
    for _ in range(budget.rounds):
        transcription, z = program.transcription, best.z
        if not isinstance(transcription, Gridded):
            break
        split = intervals_to_halve(transcription, z, budget.halved)
        if not np.any(split):
            break
        rows = times_of_rows(program, z)
        transcription, z = split_intervals(transcription, z, split)
        # The distance rows of the former grid are kept on the new one.
        enough = RoundStop(budget, best.duration, spent)
        finer = solve(
            with_rows_at(NonlinearProgram.of(transcription).at(z), z, rows),
            minimum_time(transcription.system, warm, best.duration, refined=True),
            z,
            step,
            first_of(enough, stop),
            exchange=RowExchange(level=0.0, small_violation=SMALL_VIOLATION),
            callback=state,
            keep=state.keep,
        )
        promise = enough.first(finer.history)
        logger.info("%d intervals: promise %.1e", transcription.intervals, promise)
        if finer.best is None or finer.best.duration >= best.duration:
            break
        finest, best, program = finer, finer.best, finer.program
        if promise < budget.worth or enough.spent():
            break
    if best.duration > worth_it:
        return result
    records = state.records[first:]
    history = tuple(replace(r, iteration=r.iteration - first) for r in records)
    return replace(finest, status=result.status, history=history)


def _programs(records: Sequence[IterationRecord]) -> int:
    """Number of programs that were solved in the iterations."""
    return sum(record.programs for record in records)


@dataclass(frozen=True)
class RoundStop:
    """Stop rule of the iterations of a round: little further gain is predicted.

    Attributes:
        budget: Thresholds for the gain, and limits for the work.
        duration: T of the motion on the former grid [s].
        spent: Predicate: whether the programs of all rounds are used up.
    """

    budget: RefinementBudget
    duration: float
    spent: Callable[[], bool]

    def first(self, history: Sequence[IterationRecord]) -> float:
        """Gain predicted for the first step of a round, as a share of T."""
        return history[0].predicted / self.duration

    def __call__(self, loop: Loop) -> Status | None:
        """CONVERGED once little further gain is predicted."""
        record = loop.history[-1]
        little = self.first(loop.history) < self.budget.worth
        if little and len(loop.history) == 1:
            return Status.CONVERGED
        missed = (record.predicted - max(record.actual, 0.0)) / self.duration
        enough = little or missed < ENOUGH * self.budget.worth or self.spent()
        enough = enough or len(loop.history) >= ITERATIONS
        if not enough or record.violation > SMALL_VIOLATION:
            return None
        # The round may end only if slowing down removes the remaining violations, which
        # is not the case for clearances.
        best = loop.best or loop.state
        slower = loop.objective.cured(loop.program, best, np.inf)
        return None if slower is None else Status.CONVERGED
