"""Direct solves: guesses of paths, improved by programs in states or splines."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from tominpmp.arrays import Array
from tominpmp.constraints.friction import OVERLOAD
from tominpmp.initial_guess.guess import Guess
from tominpmp.initial_guess.segments import (
    SegmentedGuess,
    at_rest_on_the_way,
    solved_guess,
)
from tominpmp.initial_guess.warm_start import WarmStart, warm_start
from tominpmp.linear_programs import LpSolver, make_solver
from tominpmp.options import Options
from tominpmp.planner.attempt import REFINEMENTS, Attempt
from tominpmp.planner.judges import FAR, ever_slower, stagnating
from tominpmp.planner.progress import Progress
from tominpmp.planner.refinement import refine, unrefined
from tominpmp.solvers.exchange import RowExchange, with_missing_rows
from tominpmp.solvers.iterate import SlpResult
from tominpmp.solvers.restoration import LIGHT
from tominpmp.solvers.rounds import Solve, solve_in_rounds
from tominpmp.solvers.slp import SlpSolver
from tominpmp.status import STOPPED
from tominpmp.transcription.base import Program, Transcription
from tominpmp.transcription.bspline import DEGREES, BSplineTranscription
from tominpmp.transcription.bspline_segments import SegmentedBSpline
from tominpmp.transcription.collocation import CollocationTranscription
from tominpmp.transcription.exchange import exchanged
from tominpmp.transcription.grid import (
    delayed_shares,
    interval_shares,
    segment_intervals,
    segmented_shares,
)
from tominpmp.transcription.inverse import InverseTranscription
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import NonlinearProgram
from tominpmp.verification.verification import LONGEST

# A motion is not searched on from that is at most this much above what none can beat.
GAP = 0.03
# Weight of the total variation, as a share of the duration of the guess; chosen on
# benchmarks/random_goals.py: it costs less than 0.1 % of T and halves the iterations.
SMOOTHING_SHARE = 1e-4
# Relative room of torques between the rows up to which a former motion rests on them.
NEARLY = 1e-2
# A timed guess lies on the limits; the grid rounds it. This much slower it is nearly
# admissible.
GUESS_STRETCH = 1.02
# Iterations for a motion whose accelerations jump, from which a smooth one begins.
FIRST_ITERATIONS = 10
# Gap of programs, as a share of T, where the final configuration is free: looser ones
# lead to more iterations there.
FREE_ACCURACY = 1e-6
# Finer grids that motions on grids of constant torques may need until their replay
# holds: swift ones need more than the others, and none of them takes long.
REFINEMENTS_OF_COLLOCATION = 4
# The same for motions whose accelerations must not jump.
SMOOTH_STRETCH = 1.3
# Violation, in units of the rows, from which a guess on a grid of constant torques is
# no beginning, how often its intervals are halved at most, and what share of the
# violation may be left for that to help.
ASTRAY, HALVINGS, HELPS = 1.0, 3, 0.5


def solve_and_verify(
    system: ProblemFunctions, options: Options, guess: Guess, progress: Progress
) -> Attempt:
    """Improve a guess; where the replay fails, go on with a finer grid."""

    def solve(tried: ProblemFunctions, former: Attempt | None) -> Attempt:
        first = guess
        if former is not None:
            first = _guess_of(tried, former)
        # Where the goal seems to be out of reach, no more is waited for than has to be.
        judge = stagnating(FAR) if guess.blocked else None
        with progress.judged(judge):
            return _solve_and_verify(tried, options, first, progress)

    return with_rows_where_needed(system, progress, solve)


def with_rows_where_needed(
    system: ProblemFunctions,
    progress: Progress,
    solve: Callable[[ProblemFunctions, Attempt | None], Attempt],
) -> Attempt:
    """Solve without rows for the links of an arm alone; again with them if they touch.

    Args:
        system: The problem.
        progress: What remembers that links touched: rows are taken at once then.
        solve: Solves a problem, beginning with a former attempt if there is one.
    """
    first = system if progress.links_touched else system.first_tried
    attempt = solve(first, None)
    if first is system or not attempt.touches or attempt.status in STOPPED:
        return attempt
    progress.links_touched = True
    with progress.judged(ever_slower(attempt.trajectory.duration)):
        return solve(system, attempt).after(attempt)


def _guess_of(system: ProblemFunctions, attempt: Attempt) -> Guess:
    """What an attempt led to, as a guess."""
    motion = attempt.trajectory
    if system.parts:
        return solved_guess(attempt.name, motion, system.problem.segments)
    return replace(warm_start(system, motion), name=attempt.name)


def _solve_and_verify(
    system: ProblemFunctions, options: Options, guess: Guess, progress: Progress
) -> Attempt:
    problem = system.problem
    attempt = solve_from_guess(system, options, guess, progress)
    last = _replayed_last(system, attempt, progress)
    if last and not system.alone:
        return attempt
    # One that was let go is not gone on with. Links of an arm that is alone have no
    # rows, and are looked at.
    later = last or progress.puts_off or progress.let_go
    attempt = attempt.verified(problem, options, later=later)
    unwatched = system.clearance is None
    torques_kept = options.method == "collocation"
    for _ in range(REFINEMENTS_OF_COLLOCATION if torques_kept else REFINEMENTS):
        if attempt.found or not attempt.feasible or attempt.status in STOPPED:
            break
        if unwatched and attempt.touches:
            break  # a finer grid does not part the links
        if attempt.trajectory.duration > LONGEST:
            break  # nor does it make a motion short enough to be replayed
        # Nor will the first motion do on the finer grid: it was too rough.
        options = replace(options, intervals=2 * options.intervals, objective="time")
        guess = _guess_of(system, attempt)
        finer = solve_from_guess(system, options, guess, progress)
        finer = finer.verified(problem, options)
        if not finer.feasible:
            break
        attempt = finer.after(attempt)
    return attempt


def _replayed_last(
    system: ProblemFunctions, attempt: Attempt, progress: Progress
) -> bool:
    """Whether a motion is replayed in the end, if it is still the best one then.

    Where it is near what none can beat the search ends with it, and mostly a finer grid
    takes its place.
    """
    if not progress.replays_last or not attempt.feasible:
        return False
    return attempt.trajectory.duration <= _near(system, progress)


def _near(system: ProblemFunctions, progress: Progress) -> float:
    """T up to which a motion is near what none can beat [s]."""
    return (1.0 + GAP) * progress.lower_bound(system.problem).T


def make_slp(
    program: Program,
    options: Options,
    smoothing: float,
    lp: LpSolver,
    progress: Progress,
) -> SlpSolver:
    """Solver whose motions the progress sees and keeps."""
    keep = progress.keep
    return SlpSolver(program, options, smoothing, lp, progress, keep=keep)


def by_squares(system: ProblemFunctions, options: Options) -> bool:
    """Whether the variation of torques counts by its squares.

    Among obstacles that takes a sixth off the time, as programs have a third of the
    columns, at the same T and the same roughness (benchmarks/motionbenchmaker.py);
    coarse grids are better off with its sum.
    """
    usual = options.method == "inverse" and options.control not in DEGREES
    usual = usual and options.smoothing is None
    usual = usual and make_solver(options.lp_solver).curved
    return usual and not system.alone and not system.parts


def solve_from_guess(
    system: ProblemFunctions,
    options: Options,
    guess: Guess,
    progress: Progress,
    *,
    coarse: bool = False,
    overload: float = OVERLOAD,
) -> Attempt:
    """Improve a guess with the transcription that the options ask for.

    Args:
        system: The functions of the problem.
        options: Options of the plan.
        guess: The guess.
        progress: Sees and keeps the motions.
        coarse: Whether what comes of it is gone on with on another grid.
        overload: Excess of torques between the rows that is let pass.
    """
    smoothing = options.smoothing
    if smoothing is None:
        smoothing = SMOOTHING_SHARE * guess.duration
    lp, smooth = make_solver(options.lp_solver), options.control in DEGREES
    # What the last violations cost is less than a finer grid brings.
    light = LIGHT if options.refine == "auto" else 0.0
    squares = not coarse and by_squares(system, options)
    program, start = first_program(system, options, guess)
    initial = program.trajectory(start)
    missing = partial(with_missing_rows, overload=overload)
    accuracy = FREE_ACCURACY if system.final_configuration is None else None

    def sure(duration: float) -> bool:
        # With nothing in the way motions that are far from it ended too soon without.
        return not system.alone or duration <= _near(system, progress)

    def solve(
        program: NonlinearProgram, z: Array, options: Options, after: SlpResult | None
    ) -> SlpResult:
        solver = make_slp(program, options, smoothing, lp, progress)
        exchange = RowExchange(longest=LONGEST, light=light, revise=missing)
        solver = replace(
            solver,
            exchange=exchange,
            squares=squares,
            accuracy=accuracy,
            sure=sure,
        )
        return solver.run(z, after=after)

    if isinstance(guess, SegmentedGuess) and not guess.solved and smooth:
        program, start = _smooth_start(system, options, guess, solve)
    solved = solve_in_rounds(
        program,
        start,
        options,
        solve,
        rough=False,
        light=light,
        over=lambda: progress.let_go,
        overload=overload,
    )
    if smooth and options.method != "collocation":
        found: tuple[Program, SlpResult]
        found = solved[0], unrefined(options, solved[1])
    else:
        found = refine(system, options, *solved, lp, progress)
    return Attempt.of(guess.name, found[0], initial, found[1])


def _smooth_start(
    system: ProblemFunctions, options: Options, guess: SegmentedGuess, solve: Solve
) -> tuple[NonlinearProgram, Array]:
    """Program with continuous accelerations for a guess, and where to begin.

    Where goals are passed, the corners of a guess are far from any such motion: it is
    begun with a motion that stops there, or with one whose accelerations may jump.
    """
    few = replace(options, max_iterations=FIRST_ITERATIONS)
    if guess.stops:
        program, start = first_program(at_rest_on_the_way(system), options, guess)
        stopping = solve(program, start, few, None).best
        program, start = first_program(system, options, guess)
        start = start if stopping is None else stopping.z
        return program.at(start), start
    jumping = replace(few, control="constant")
    program, start = first_program(system.without_smooth_limits(), jumping, guess)
    found = solve(program, start, jumping, None).best
    if found is not None:
        motion = program.trajectory(found.z)
        better = solved_guess(guess.name, motion, system.problem.segments)
        guess = replace(better, solved=False)
    return first_program(system, options, guess)


def first_program(
    system: ProblemFunctions, options: Options, guess: Guess
) -> tuple[NonlinearProgram, Array]:
    """Program for a guess, and the guess as its iterate."""
    former = guess if isinstance(guess, WarmStart) else None
    grid = options.intervals, options.grid
    timed = GUESS_STRETCH if guess.timed else 1.0
    transcription: Transcription[Any]
    if isinstance(guess, SegmentedGuess):
        return segmented_program(system, options, guess)
    if options.method == "collocation":
        if former is not None:
            return former.lifted_program(system, *grid)
        return collocated(system, options, guess, timed * guess.duration)
    shares = guess_shares(system, options, guess)
    if options.control in DEGREES:
        degree = DEGREES[options.control]
        if former is not None:
            return former.spline_program(system, *grid, degree)
        shares = np.sum(shares, axis=1, keepdims=True)
        transcription = smooth = BSplineTranscription(system, shares, degree)
        stretched = SMOOTH_STRETCH * guess.duration
        start = smooth.start(guess.position, guess.duration, stretched)
    else:
        if former is not None:
            program, start = former.inverse_program(system, *grid)
            # Rows between the nodes that the motion rests on, which it had before.
            return exchanged(program, start, -NEARLY) or program, start
        transcription = jumping = InverseTranscription(system, shares, guess.duration)
        start = jumping.start(guess.position, timed * guess.duration)
    return NonlinearProgram.of(transcription).at(start), start


def collocated(
    system: ProblemFunctions, options: Options, guess: Guess, duration: float
) -> tuple[NonlinearProgram, Array]:
    """Program in states and torques for a guess, on a grid that its dynamics bear.

    Torques that are constant over an interval drive an arm away from the guess. Where
    that is far, linear programs promise nothing, so that intervals are halved until it
    is not, some times at most.
    """

    def halved(halvings: int) -> tuple[NonlinearProgram, Array, float]:
        finer = replace(options, intervals=2**halvings * options.intervals)
        shares = np.sum(guess_shares(system, finer, guess), axis=1, keepdims=True)
        lifted = CollocationTranscription(system, shares, guess.duration)
        nodes = np.concatenate([[0.0], np.cumsum(shares)])
        path = guess.position(nodes * guess.duration)
        start = lifted.start(path, np.array([duration]))
        program = NonlinearProgram.of(lifted).at(start)
        violation = program.rows.largest_violation(program.evaluate(start))
        return program, start, violation

    program, start, violation = halved(0)
    for halvings in range(1, HALVINGS + 1):
        if violation <= ASTRAY:
            break
        finer = halved(halvings)
        if not finer[2] <= HELPS * violation:
            break  # other limits are broken, whatever the intervals
        program, start, violation = finer
    return program, start


def segmented_program(
    system: ProblemFunctions,
    options: Options,
    guess: SegmentedGuess,
    *,
    breaks: bool = False,
) -> tuple[NonlinearProgram, Array]:
    """Program for a guess of several segments, and the guess as its iterate.

    Args:
        system: The functions of the problem.
        options: Options of the plan.
        guess: The guess.
        breaks: Whether the highest derivative but one of splines may jump where
            segments end.
    """
    smooth, durations = options.control in DEGREES, guess.durations
    sudden = system.sudden or not smooth
    counts = segment_intervals(options.intervals, durations)
    shares = segmented_shares(options.grid, counts, durations, smooth, sudden=sudden)
    ends = tuple(np.cumsum(counts).tolist())
    transcription: Transcription[Any]
    if smooth:
        where = ends[:-1] if breaks and system.sudden else ()
        transcription = spline = SegmentedBSpline(
            system, shares, DEGREES[options.control], ends, breaks=where
        )
        stretch = 1.0 if guess.solved else SMOOTH_STRETCH
        eta = np.full(len(ends), stretch * guess.duration)
        start = spline.start(lambda share: guess.position(share * guess.duration), eta)
    else:
        transcription = jumping = InverseTranscription(
            system, shares, guess.duration, segment_ends=ends
        )
        timed = GUESS_STRETCH if guess.timed else 1.0
        start = jumping.start(guess.position, timed * guess.duration)
    return NonlinearProgram.of(transcription).at(start), start


def guess_shares(system: ProblemFunctions, options: Options, guess: Guess) -> Array:
    """Grid for a guess: intervals of their own for the time before it sets out."""
    if guess.delay > 0.0:
        delay = guess.delay / guess.duration
        return delayed_shares(options.intervals, delay, sudden=system.sudden)
    return interval_shares(options.grid, options.intervals, sudden=system.sudden)
