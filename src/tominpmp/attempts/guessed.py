"""Motions improved from a guess of their path, by programs in states or splines."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tominpmp.arrays import Array
from tominpmp.attempts.attempt import REFINEMENTS, STOPPED, Attempt
from tominpmp.attempts.turning import solve_turning
from tominpmp.attempts.watch import Watch
from tominpmp.linear_programs import LpSolver, make_solver
from tominpmp.options import Options
from tominpmp.refinement import refine, unrefined
from tominpmp.seeding.guess import Guess
from tominpmp.seeding.warm import FormerMotion, former_motion
from tominpmp.solvers.iterate import SlpResult
from tominpmp.solvers.slp import SlpSolver
from tominpmp.transcription.base import Transcription
from tominpmp.transcription.bspline import DEGREES, BSplineTranscription
from tominpmp.transcription.collocation import CollocationTranscription
from tominpmp.transcription.exchange import OVERLOAD
from tominpmp.transcription.grid import delayed_shares, interval_shares
from tominpmp.transcription.inverse import InverseTranscription
from tominpmp.transcription.system import System
from tominpmp.verification.verdict import LONGEST

# Weight of the total variation, as a share of the duration of the guess; chosen on
# benchmarks/random_goals.py: it costs less than 0.1 % of T and halves the iterations.
SMOOTHING_SHARE = 1e-4
# Relative room of torques between the rows up to which a former motion rests on them.
NEARLY = 1e-2
# Rounds of adding rows, and iterations of each.
EXCHANGES = 6
EXCHANGE_ITERATIONS = 25
# Progress below which rows between the nodes are looked for while the duration still
# falls: rows that a finished motion breaks cost a new solve.
ROUGH = 1e-2
# Where rows are violated by so much, more of them between the nodes would not help.
FAR = 1e-2
# A timed guess lies on the limits; the grid rounds it. This much slower it is nearly
# admissible.
GUESS_STRETCH = 1.02
# The same for motions whose accelerations must not jump.
SMOOTH_STRETCH = 1.3


def solve_and_verify(
    system: System, options: Options, guess: Guess, watch: Watch
) -> Attempt:
    """Improve a guess; where the replay fails, go on with a finer grid."""

    def solve(tried: System, former: Attempt | None) -> Attempt:
        first = guess
        if former is not None:
            first = replace(former_motion(tried, former.trajectory), name=former.name)
        return _solve_and_verify(tried, options, first, watch)

    return with_rows_where_needed(system, watch, solve)


def with_rows_where_needed(
    system: System,
    watch: Watch,
    solve: Callable[[System, Attempt | None], Attempt],
) -> Attempt:
    """Solve without rows for the links of an arm alone; again with them if they touch.

    Args:
        system: The problem.
        watch: What remembers that links touched: rows are taken at once then.
        solve: Solves a problem, beginning with a former attempt if there is one.
    """
    first = system if watch.links_touched else system.first_tried
    attempt = solve(first, None)
    if first is system or not attempt.touches or attempt.status in STOPPED:
        return attempt
    watch.links_touched = True
    return solve(system, attempt).after(attempt)


def _solve_and_verify(
    system: System, options: Options, guess: Guess, watch: Watch
) -> Attempt:
    problem = system.problem
    attempt = solve_from_guess(system, options, guess, watch)
    attempt = attempt.verified(problem, options, later=watch.puts_off)
    unwatched = system.clearance is None
    for _ in range(REFINEMENTS):
        if attempt.found or not attempt.feasible or attempt.status in STOPPED:
            break
        if unwatched and attempt.touches:
            break  # a finer grid does not part the links
        if attempt.trajectory.duration > LONGEST:
            break  # nor does it make a motion short enough to be replayed
        # Nor will the first motion do on the finer grid: it was too rough.
        options = replace(options, intervals=2 * options.intervals, objective="time")
        guess = replace(former_motion(system, attempt.trajectory), name=attempt.name)
        finer = solve_from_guess(system, options, guess, watch)
        finer = finer.verified(problem, options)
        if not finer.feasible:
            break
        attempt = finer.after(attempt)
    return attempt


def make_slp(
    transcription: Transcription,
    options: Options,
    smoothing: float,
    lp: LpSolver,
    watch: Watch,
) -> SlpSolver:
    """Solver whose motions the watch sees and keeps."""
    keep = watch.keep
    return SlpSolver(transcription, options, smoothing, lp, watch, keep=keep)


def solve_from_guess(
    system: System, options: Options, guess: Guess, watch: Watch
) -> Attempt:
    """Improve a guess with the inverse or the collocation transcription."""
    smoothing = options.smoothing
    if smoothing is None:
        smoothing = SMOOTHING_SHARE * guess.duration
    shares = guess_shares(options, guess)
    duration = guess.duration * (GUESS_STRETCH if guess.timed else 1.0)
    lp = make_solver(options.lp_solver)
    former = guess if isinstance(guess, FormerMotion) else None
    if options.method == "collocation":
        shares = np.sum(shares, axis=1, keepdims=True)
        lifted = CollocationTranscription(system, shares, guess.duration)
        if former is not None:
            grid = options.intervals, options.grid
            lifted, start = former.lifted_program(system, *grid)
        else:
            nodes = np.concatenate([[0.0], np.cumsum(shares)])
            start = lifted.start(
                guess.position(nodes * guess.duration), np.array([duration])
            )
        initial = lifted.trajectory(start)

        def solve(
            program: CollocationTranscription, z: Array, after: SlpResult | None
        ) -> SlpResult:
            solver = make_slp(program, options, smoothing, lp, watch)
            return solver.run(z, after=after)

        solved = solve_turning(lifted, start, solve)
        refined = refine(system, options, *solved, lp, watch)
        return Attempt.of(guess.name, refined[0], initial, refined[1])
    if options.control in DEGREES:
        return solve_smooth(system, options, guess, smoothing, watch)
    if former is not None:
        grid = options.intervals, options.grid
        transcription, start = former.inverse_program(system, *grid)
        # Rows between the nodes that the motion rests on, which it had before.
        transcription = transcription.with_rows(transcription.inspect(start, -NEARLY))
    else:
        transcription = InverseTranscription(system, shares, guess.duration)
        start = transcription.start(guess.position, duration)
    initial = transcription.trajectory(start)
    rough = exchange(transcription, start, options, smoothing, lp, watch)
    found = refine(system, options, *rough, lp, watch)
    return Attempt.of(guess.name, found[0], initial, found[1])


def guess_shares(options: Options, guess: Guess) -> Array:
    """Grid for a guess: intervals of their own for the time before it sets out."""
    if guess.delay > 0.0:
        return delayed_shares(options.intervals, guess.delay / guess.duration)
    return interval_shares(options.grid, options.intervals)


def solve_smooth(
    system: System, options: Options, guess: Guess, smoothing: float, watch: Watch
) -> Attempt:
    """Improve a guess with a B-spline of the degree that the control asks for."""
    shares = np.sum(guess_shares(options, guess), axis=1, keepdims=True)
    degree = DEGREES[options.control]
    if isinstance(guess, FormerMotion):
        grid = options.intervals, options.grid
        transcription, start = guess.spline_program(system, *grid, degree)
    else:
        transcription = BSplineTranscription(system, shares, degree)
        start = transcription.start(
            guess.position, guess.duration, SMOOTH_STRETCH * guess.duration
        )
    z = start
    lp = make_solver(options.lp_solver)
    result = make_slp(transcription, options, smoothing, lp, watch).run(z)
    for _ in range(EXCHANGES):
        if result.best is None and result.iterate.violation > FAR:
            break
        if _too_long(result):
            break
        extra = transcription.inspect(result.iterate.z, OVERLOAD)
        if not extra.found or result.status in STOPPED:
            break
        transcription = transcription.with_rows(extra)
        solver = make_slp(transcription, options, smoothing, lp, watch)
        result = solver.run(result.iterate.z, after=result)
    result = unrefined(options, result)
    return Attempt.of(guess.name, transcription, start, result)


def _too_long(result: SlpResult) -> bool:
    """Whether nobody will replay the motion: it is not looked at between its nodes."""
    return bool(result.history) and result.history[-1].duration > LONGEST


def exchange(
    transcription: InverseTranscription,
    z: Array,
    options: Options,
    smoothing: float,
    lp: LpSolver,
    watch: Watch,
) -> tuple[InverseTranscription, SlpResult]:
    """Solve, and solve on with rows where the motion breaks limits between them."""
    system = transcription.system
    rough = options
    if system.clearance is not None:
        rough = replace(options, tolerance=max(ROUGH, options.tolerance))
    result = make_slp(transcription, rough, smoothing, lp, watch).run(z)
    settled = rough is options
    few = replace(
        options, max_iterations=min(options.max_iterations, EXCHANGE_ITERATIONS)
    )
    for _ in range(EXCHANGES):
        far = result.best is None and result.iterate.violation > FAR
        if result.status in STOPPED or (far and settled) or _too_long(result):
            break
        if not far:
            extra = transcription.inspect(result.iterate.z, OVERLOAD)
            if not extra.size and settled:
                break
            transcription = transcription.with_rows(extra)
        chosen = few if settled else options
        solver = make_slp(transcription, chosen, smoothing, lp, watch)
        result = solver.run(result.iterate.z, after=result)
        settled = True
    return transcription, result
