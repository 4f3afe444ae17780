"""Descents: a guess is improved by linear programs until its replay holds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from tominpmp.arrays import Array
from tominpmp.constraints.friction import EFFORT_TOLERANCE
from tominpmp.initial_guess.constrained import speed_used
from tominpmp.initial_guess.guess import Guess
from tominpmp.initial_guess.segments import (
    SegmentedGuess,
    at_rest_on_the_way,
    solved_guess,
)
from tominpmp.initial_guess.warm_start import WarmStart, warm_start
from tominpmp.linear_programs import make_solver
from tominpmp.options import Options
from tominpmp.planner.candidate import Candidate
from tominpmp.planner.first_program import Begun, first_program
from tominpmp.planner.plan_state import Judge, PlanState
from tominpmp.solvers.exchange import RowExchange, with_missing_rows
from tominpmp.solvers.iterate import SlpResult
from tominpmp.solvers.loop import solve
from tominpmp.solvers.objective import LIGHT, MinimumTime
from tominpmp.solvers.trust_region_step import trust_regions
from tominpmp.status import STOPPED, IterationRecord, Status
from tominpmp.transcription.bspline import DEGREES
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import NonlinearProgram
from tominpmp.verification.verification import LONGEST

# Weight of the total variation, as a share of the duration of the guess; chosen on
# benchmarks/random_goals.py: it costs less than 0.1 % of T and halves the iterations.
SMOOTHING_SHARE = 1e-4
# Gap of programs, as a share of T, where the final configuration is free: looser ones
# lead to more iterations there.
FREE_ACCURACY = 1e-6
# Iterations for a motion whose accelerations jump, from which a smooth one begins.
FIRST_ITERATIONS = 10
# Doublings of the grid, or of the steps, of a motion whose replay does not hold; swift
# motions on grids of constant torques need more of them, which take little time.
REPAIRS, REPAIRS_OF_COLLOCATION = 2, 4
# Intervals of grids from which on coarser ones pay, and linear accelerations: on fewer
# they lose more where torques switch than constant ones do.
MANY_INTERVALS = 24
# A guess is held by speed limits where a joint is at one for this share of the time,
# from this share of it on: torques do not rule it then.
SPEED_SHARE, AT_LIMIT = 0.6, 0.97
# An iteration is hopeless after so many steps if it breaks limits by more than is near
# to a motion, and that has not fallen to this share of it in the last ones.
PATIENCE, LATELY, FALLING = 10, 5, 0.9
# Or once it has become so many times as slow, and breaks limits by more than this.
EVER_SLOWER, FAR = 10.0, 1e-3

# Makes a motion, replayed, from the functions of the problem, the number of doublings
# of its grid, and what was made before.
Make = Callable[[ProblemFunctions, int, Candidate | None], Candidate]


def stop_if_hopeless(duration: float, near: float = FAR) -> Judge:
    """Ends an iteration that comes no nearer to a motion, or ever slower.

    Args:
        duration: T of what it began with [s].
        near: Violations up to this share are near; infinite judges the time alone.
    """
    seen: list[float] = []

    def judge(record: IterationRecord) -> Status | None:
        seen.append(record.violation)
        late = len(seen) >= PATIENCE and record.violation > near
        over = late and min(seen[-LATELY:]) > FALLING * min(seen[:-LATELY])
        slow = record.duration > EVER_SLOWER * duration and record.violation > FAR
        return Status.STALLED if over or slow else None

    return judge


def with_control(system: ProblemFunctions, options: Options, guess: Guess) -> Options:
    """The options, with accelerations that fit a guess where that was left open.

    Linear ones are 3 to 4 % faster where torques rule. Where speeds do they bring next
    to nothing: constant ones take half the programs there, and no ramps that are too
    short for the clock of a controller.
    """
    if options.control != "auto":
        return options
    smooth = isinstance(guess, WarmStart) and guess.continuous
    many = options.intervals >= MANY_INTERVALS and not system.parts
    smooth = smooth or (many and torques_rule(system, guess))
    return replace(options, control="linear" if smooth else "constant")


def torques_rule(system: ProblemFunctions, guess: Guess) -> bool:
    """Whether torques rule a motion along a guess, rather than speed limits."""
    if not guess.timed and not isinstance(guess, WarmStart):
        return True
    v = np.diff(guess.q, axis=0) / np.diff(guess.t)[:, None]
    used = speed_used(system.problem, 0.5 * (guess.q[1:] + guess.q[:-1]), v)
    return bool(np.mean(used > AT_LIMIT) < SPEED_SHARE)


def descended(
    system: ProblemFunctions, options: Options, guess: Guess, progress: PlanState
) -> Candidate:
    """Improve a guess, and repair the motion until its replay holds."""
    options = with_control(system, options, guess)

    def make(
        tried: ProblemFunctions, doublings: int, former: Candidate | None
    ) -> Candidate:
        begin, own, judge = guess, options, None
        if former is not None:
            begin = guess_of(tried, former)
            judge = stop_if_hopeless(former.trajectory.duration, np.inf)
        elif guess.blocked:
            # The goal seems to be out of reach: no more is waited for than has to be.
            judge = stop_if_hopeless(guess.duration)
        if doublings:
            # Nor will the first motion do on the finer grid: it was too rough.
            intervals = 2**doublings * options.intervals
            own = replace(options, intervals=intervals, objective="time")
        with progress.judged(judge):
            found = descend(tried, own, begin, progress)
        return found.verified(system.problem, options)

    torques_kept = options.method == "collocation"
    repairs = REPAIRS_OF_COLLOCATION if torques_kept else REPAIRS
    return repaired(system, progress, make, repairs)


def near_to_it(options: Options, radius: float, iterations: int) -> Options:
    """Options for going on with a motion that is near to what is looked for.

    Args:
        options: Options of the plan.
        radius: Share of the usual trust region.
        iterations: So many are enough.
    """
    return replace(
        options,
        trust_region=radius * options.trust_region,
        max_iterations=min(iterations, options.max_iterations),
    )


def total_variation_weight(
    system: ProblemFunctions, options: Options, duration: float
) -> float:
    """Weight of the total variation on a grid finer than the search's [s].

    With nothing in the way proximal steps keep controls quiet enough. Among obstacles
    torques that nothing holds would jump for less than the clock of a controller.
    """
    if options.smoothing is not None:
        return options.smoothing
    return 0.0 if system.in_free_space else SMOOTHING_SHARE * duration


def repaired(
    system: ProblemFunctions, progress: PlanState, make: Make, repairs: int = REPAIRS
) -> Candidate:
    """Make a motion, and again with what its replay shows to be missing.

    Where links of an arm alone touch, that is rows for them, without which it is tried
    first; else a finer grid.

    Args:
        system: The functions of the problem.
        progress: Remembers that links touched: rows are taken at once then.
        make: Makes the motion.
        repairs: How often the grid is doubled at most.
    """
    tried = system if progress.links_touched else system.without_self_collision
    candidate, doublings = make(tried, 0, None), 0
    while candidate.refuted and candidate.status not in STOPPED:
        # No repair is for one that its judge has dropped, nor makes one short enough.
        if progress.dropped or candidate.trajectory.duration > LONGEST:
            break
        if candidate.touches and tried is not system:
            tried, progress.links_touched = system, True
        elif doublings == repairs or (candidate.touches and system.clearance is None):
            break
        else:
            doublings += 1
        again = make(tried, doublings, candidate)
        if doublings and (not again.feasible or again.excess > candidate.excess):
            break  # shorter intervals break more by rounding than they mend
        candidate = again.after(candidate)
    return candidate


def guess_of(system: ProblemFunctions, candidate: Candidate) -> Guess:
    """The motion of a candidate as a guess."""
    motion = candidate.trajectory
    if system.parts:
        return solved_guess(candidate.name, motion, system.problem.segments)
    return replace(warm_start(system, motion), name=candidate.name)


def descend(
    system: ProblemFunctions,
    options: Options,
    guess: Guess,
    progress: PlanState,
    *,
    effort_tolerance: float = EFFORT_TOLERANCE,
) -> Candidate:
    """Improve a guess with the transcription that the options ask for.

    Args:
        system: The functions of the problem.
        options: Options of the plan.
        guess: The guess.
        progress: Sees and keeps the motions.
        effort_tolerance: Excess of torques between the rows that is let pass.
    """
    tv_weight = options.smoothing
    if tv_weight is None:
        tv_weight = SMOOTHING_SHARE * guess.duration
    exchange = RowExchange(
        # What the last violations cost is less than a finer grid brings.
        light=LIGHT if options.refine == "auto" else 0.0,
        revise=partial(with_missing_rows, effort_tolerance=effort_tolerance),
    )
    accuracy = FREE_ACCURACY if system.final_configuration is None else None
    lp = make_solver(options.lp_solver)

    def solved(
        program: NonlinearProgram,
        start: Array,
        options: Options,
        exchange: RowExchange | None = None,
    ) -> SlpResult:
        return solve(
            program,
            MinimumTime.of(options, tv_weight),
            start,
            *trust_regions(options, lp, accuracy),
            exchange=exchange,
            callback=progress,
            keep=progress.keep,
        )

    program, start = first_program(system, options, guess)
    initial = program.trajectory(start)
    if isinstance(guess, SegmentedGuess) and not guess.solved:
        if options.control in DEGREES:
            program, start = _smooth_start(system, options, guess, solved)
    result = solved(program, start, options, exchange)
    return Candidate.of(guess.name, result.program, initial, result)


def _smooth_start(
    system: ProblemFunctions,
    options: Options,
    guess: SegmentedGuess,
    solved: Callable[[NonlinearProgram, Array, Options], SlpResult],
) -> Begun:
    """Program with continuous accelerations for a guess, and where to begin.

    Where goals are passed, the corners of a guess are far from any such motion: it is
    begun with a motion that stops there, or with one whose accelerations may jump.
    """
    few = replace(options, max_iterations=FIRST_ITERATIONS)
    if guess.stops:
        program, start = first_program(at_rest_on_the_way(system), options, guess)
        stopping = solved(program, start, few).best
        program, start = first_program(system, options, guess)
        start = start if stopping is None else stopping.z
        return program.at(start), start
    jumping = replace(few, control="constant")
    program, start = first_program(system.without_smooth_limits(), jumping, guess)
    result = solved(program, start, jumping)
    if result.best is not None:
        motion = result.program.trajectory(result.best.z)
        better = solved_guess(guess.name, motion, system.problem.segments)
        guess = replace(better, solved=False)
    return first_program(system, options, guess)
