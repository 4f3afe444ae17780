"""Descents: a sequence of convex programs improves a guess, then refines its grid.

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
from functools import partial

import numpy as np

from tominpmp.initial_guess.guess import Guess
from tominpmp.initial_guess.rrt import is_free
from tominpmp.initial_guess.timing import speed_used
from tominpmp.initial_guess.warm_start import WarmStart, warm_start
from tominpmp.options import Options
from tominpmp.planner.automatic_options import (
    PROMISE,
    WARM_RADIUS,
    minimum_time,
    warm_start_options,
)
from tominpmp.planner.candidate import Candidate
from tominpmp.planner.first_program import first_program
from tominpmp.planner.plan_state import PlanState
from tominpmp.planner.work import REPAIRS, Work
from tominpmp.solvers.iterate import SlpResult
from tominpmp.solvers.loop import Loop, Rule, first_of
from tominpmp.solvers.trust_region_step import trust_regions
from tominpmp.status import Status
from tominpmp.transcription.exchange import times_of_rows, with_rows_at
from tominpmp.transcription.layout import Gridded, intervals_to_halve, split_intervals
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import NonlinearProgram

logger = logging.getLogger(__name__)
Descended = SlpResult[NonlinearProgram]

# Least number of intervals for which a coarse search pays off, and linear accelerations
# do: on longer intervals these lose more than constant ones where torques switch.
MANY_INTERVALS = 24
# Speed limits are active at a sample of a guess if a joint has the share AT_LIMIT of
# its speed limit. They rule the guess if they are active at SPEED_SHARE of its samples;
# otherwise torques rule it.
SPEED_SHARE, AT_LIMIT = 0.6, 0.97
# Stop rule: over the last PATIENCE iterations the violation exceeds the threshold, and
# its minimum over the RECENT ones is more than PROGRESS times the earlier minimum. The
# usual threshold is FAR.
PATIENCE, RECENT, PROGRESS, FAR = 10, 5, 0.9, 1e-3
# Largest number of iterations on a grid, as most of the gain comes with the first step.
ITERATIONS = 6
# Most rounds of halving.
ROUNDS = 5
# Least gain that a round must predict where planning time matters less than T, as a
# share of T.
LITTLE_PROMISE = 3e-4
# Finer grids are kept if they gain this share of the least gain of a round.
GAINED = 0.2


def stop_if_hopeless(small: float = FAR) -> Rule:
    """Stop rule that drops a descent whose violation stagnates.

    Args:
        small: Violations up to this are small enough to continue.
    """

    def rule(loop: Loop) -> Status | None:
        excess = [record.violation for record in loop.history]
        late = len(excess) >= PATIENCE and min(excess[-PATIENCE:]) > small
        stagnates = late and min(excess[-RECENT:]) > PROGRESS * min(excess[:-RECENT])
        return loop.drop() if stagnates else None

    return rule


def _with_control(system: ProblemFunctions, options: Options, guess: Guess) -> Options:
    """The options, with control "auto" resolved to accelerations that fit a guess.

    Where torques rule, motions with linear accelerations are 3 to 4 % faster. Where
    speeds rule, they gain next to nothing: constant accelerations then take half as
    many programs, and avoid ramps that are too short for the clock of a controller.
    """
    if options.control != "auto":
        return options
    smooth = isinstance(guess, WarmStart) and guess.continuous
    many = options.intervals >= MANY_INTERVALS
    smooth = smooth or (many and torques_rule(system, guess))
    smooth = smooth and not system.parts
    return replace(options, control="linear" if smooth else "constant")


def torques_rule(system: ProblemFunctions, guess: Guess) -> bool:
    """Whether torque limits rule a motion along a guess, rather than speed limits."""
    if not guess.timed and not isinstance(guess, WarmStart):
        return True
    v = np.diff(guess.q, axis=0) / np.diff(guess.t)[:, None]
    used = speed_used(system, 0.5 * (guess.q[1:] + guess.q[:-1]), v)
    return bool(np.mean(used > AT_LIMIT) < SPEED_SHARE)


def descent_work(
    system: ProblemFunctions,
    options: Options,
    guess: Guess,
    state: PlanState,
    stop: Rule | None = None,
) -> Work:
    """Work that descends from a guess until the replay keeps all limits.

    Args:
        system: Functions of the problem.
        options: Options of the descent.
        guess: The guess.
        state: The plan.
        stop: Additional stop rule; None without one.
    """
    options = _with_control(system, options, guess)
    make = partial(descend, options, guess, state, stop)
    touches = system.in_free_space and not is_free(system, guess.q[::10])
    return Work(system, make, REPAIRS, touches)


def guess_of(system: ProblemFunctions, candidate: Candidate) -> Guess:
    """The motion of a candidate as a guess."""
    return replace(warm_start(system, candidate.trajectory), solved=True)


def descend(
    options: Options,
    guess: Guess,
    state: PlanState,
    stop: Rule | None,
    system: ProblemFunctions,
    doublings: int = 0,
    former: Candidate | None = None,
) -> Candidate:
    """Improve a guess on the grid of the options, then on finer grids.

    Args:
        options: Options of the descent.
        guess: The guess.
        state: The plan, which sees all records and keeps iterates.
        stop: Additional stop rule; None for the usual ones only.
        system: Functions of the problem.
        doublings: How often the number of intervals is doubled.
        former: The candidate to be repaired, as warm start; None in the first try.
    """
    if guess.blocked:
        # The goal seems to be out of reach: the descent is dropped as soon as possible.
        stop = first_of(stop, stop_if_hopeless())
    if former is not None:
        guess, stop = guess_of(system, former), None
    if doublings:
        # Objective "feasible" would return the refuted motion unchanged, as that keeps
        # the rows of the finer grid.
        intervals = 2**doublings * options.intervals
        options = replace(options, intervals=intervals, objective="time")
    objective = minimum_time(system, options, guess.duration)
    program, z = first_program(system, options, guess)
    initial = program.trajectory(z)
    step, usual = trust_regions(options)
    result = state.solve(program, objective, z, step, first_of(usual, stop))
    candidate = Candidate.of(initial, result)
    if options.refine not in ("auto", "grid") or state.options.objective != "time":
        return candidate
    finer = on_finer_grids(result, state)
    if finer is result:
        return candidate
    return replace(Candidate.of(initial, finer), coarser=candidate)


def on_finer_grids(result: Descended, state: PlanState) -> Descended:
    """Improve the motion of a descent on finer grids, as long as the gain is worth it.

    Args:
        result: The result of the descent.
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
        # unless the incumbent is refined for want of exact switches.
        rival = incumbent.coarser or incumbent
        if best.duration >= rival.trajectory.duration:
            return result
    usual = options.refine == "auto" and options.effort != "thorough"
    worth = PROMISE if usual else LITTLE_PROMISE
    warm, finest = warm_start_options(options, ITERATIONS, WARM_RADIUS), result
    coarsest = best.duration
    step, stop = trust_regions(warm)
    for _ in range(ROUNDS):
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
            minimum_time(transcription.system, warm, best.duration, refined=True),
            z,
            step,
            first_of(round_ends(worth * best.duration), stop),
        )
        promise = finer.history[0].predicted / best.duration
        logger.info("%d intervals: promise %.1e", transcription.intervals, promise)
        if finer.best is None or finer.best.duration >= best.duration:
            break
        finest, best, program = finer, finer.best, finer.program
        if promise < worth:
            break
    if best.duration > (1.0 - GAINED * worth) * coarsest:
        return result
    return replace(finest, status=result.status)


def round_ends(worth: float) -> Rule:
    """Stop rule of a round: few iterations, or one if it predicts too small a gain.

    Args:
        worth: Least gain that the first step of a round must predict [s].
    """

    def rule(loop: Loop) -> Status | None:
        little = loop.history[0].predicted < worth
        return Status.CONVERGED if len(loop.history) >= ITERATIONS or little else None

    return rule
