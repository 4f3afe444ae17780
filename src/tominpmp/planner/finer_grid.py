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
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from tominpmp.planner.automatic_options import PROMISE, warm_start_options
from tominpmp.solvers.iterate import SlpResult
from tominpmp.solvers.loop import Loop, Rule, first_of
from tominpmp.solvers.objective import MinimumTime
from tominpmp.solvers.trust_region_step import trust_regions
from tominpmp.status import Status
from tominpmp.transcription.exchange import times_of_rows, with_rows_at
from tominpmp.transcription.layout import Gridded, intervals_to_halve, split_intervals
from tominpmp.transcription.program import NonlinearProgram

if TYPE_CHECKING:
    from tominpmp.planner.plan_state import PlanState

logger = logging.getLogger(__name__)
Descended = SlpResult[NonlinearProgram]

# Least gain that a round must predict where planning time matters less than T, and that
# a round of improvement must have for another one to follow, as a share of T.
LITTLE_PROMISE = 3e-4
# Finer grids are kept if they gain this share of the least gain of a round.
GAINED = 0.2


def on_finer_grids(
    result: Descended, objective: MinimumTime, state: PlanState
) -> Descended:
    """Improve the motion of a descent on finer grids, as long as the gain is worth it.

    Args:
        result: The result of the descent.
        objective: The objective of the descent.
        state: The plan.

    Returns:
        The result on the last grid that gained enough; the given result if finer grids
        gain next to nothing, or the transcription has no grid that can be refined.
    """
    best, options, program = result.best, state.options, result.program
    if best is None or result.dropped:
        return result
    incumbent = state.incumbent
    if incumbent is not None and options.refine != "switching":
        # On the requested grid only a candidate that beats the incumbent is refined,
        # unless the incumbent is refined as exact switches were not found.
        rival = incumbent.coarser or incumbent
        if best.duration >= rival.trajectory.duration:
            return result
    usual = options.refine == "auto" and options.effort != "thorough"
    worth = PROMISE if usual else LITTLE_PROMISE
    if program.system.in_free_space:
        # The proximal term then suffices to keep controls quiet.
        objective = replace(objective, jump_weight=options.smoothing or 0.0)
    finest, initial_duration = result, best.duration
    step, stop = trust_regions(warm_start_options(options))
    while True:
        transcription, z = program.transcription, best.z
        if not isinstance(transcription, Gridded):
            break
        split = intervals_to_halve(transcription, z)
        if not np.any(split):
            break
        rows = times_of_rows(program, z)
        transcription, z = split_intervals(transcription, z, split)
        # The distance rows of the former grid are kept on the new one.
        finer = state.solve(
            with_rows_at(NonlinearProgram.of(transcription).at(z), z, rows),
            objective,
            z,
            step,
            first_of(_round_ends(worth * best.duration), stop),
        )
        promise = finer.history[0].predicted / best.duration
        logger.info("%d intervals: promise %.1e", transcription.intervals, promise)
        if finer.best is None or finer.best.duration >= best.duration:
            break
        finest, best, program = finer, finer.best, finer.program
        if promise < worth:
            break
    if best.duration > (1.0 - GAINED * worth) * initial_duration:
        return result
    return replace(finest, status=result.status)


def _round_ends(worth: float) -> Rule:
    """Stop rule of a round: a single iteration if it predicts too small a gain.

    Args:
        worth: Least gain that the first step of a round must predict [s].
    """

    def rule(loop: Loop) -> Status | None:
        return Status.CONVERGED if loop.history[0].predicted < worth else None

    return rule
