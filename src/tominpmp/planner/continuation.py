"""Warm starts and continuations: attempts that go on from a motion."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from tominpmp.initial_guess.constrained import speed_used
from tominpmp.initial_guess.guess import initial_guesses
from tominpmp.initial_guess.segments import SegmentedGuess
from tominpmp.initial_guess.warm_start import WarmStart, warm_start
from tominpmp.motion.trajectory import Trajectory
from tominpmp.options import Options
from tominpmp.planner.attempt import Attempt
from tominpmp.planner.direct_solve import (
    solve_and_verify,
    solve_from_guess,
    with_rows_where_needed,
)
from tominpmp.planner.judges import stagnating
from tominpmp.planner.progress import Progress
from tominpmp.planner.rescue import guarded
from tominpmp.planner.torque_starts import solve_by_shooting
from tominpmp.problem import Problem
from tominpmp.status import STOPPED, Status
from tominpmp.transcription.grid import interval_shares
from tominpmp.transcription.problem_functions import ProblemFunctions

# Trust region of a start from a former motion, in shares of the usual one.
WARM_START_RADIUS = 0.3
# Going on with continuous accelerations takes 3 to 4 % off T where torques rule, and
# next to nothing where speeds do (benchmarks/random_goals.py). It is done where no
# joint is at its speed limit for more than this share of the nodes.
SPEED_SHARE = 0.4
# A start from a former motion that stays this far from any is given up: what was near
# goes on in a few iterations, or a search is the shorter way.
FAR = 0.05
# Nor is one enough that takes longer than this share of what a first guess takes.
OUTDONE = 0.95
# A limit is active from this share of it on.
ACTIVE = 0.99
# Most of the gain comes in so many iterations.
FEW_ITERATIONS = 12


def solve_from_warm_start(
    system: ProblemFunctions,
    options: Options,
    former: WarmStart | SegmentedGuess,
    progress: Progress,
) -> Attempt:
    """Improve a former motion.

    That of one segment stays as it was if nothing faster is found.
    """
    near = replace(options, trust_region=WARM_START_RADIUS * options.trust_region)
    if isinstance(former, SegmentedGuess):
        return solve_and_verify(system, near, former, progress)
    if options.control == "auto" and former.continuous:
        near = replace(near, control="linear")
    if options.method in ("adjoint", "penalty"):
        shares = interval_shares(options.grid, options.intervals)
        first = former.torque_program(system, shares)
        attempt = solve_by_shooting(system, near, progress, first)
    else:
        former = replace(former, halved=_halved(system, options, former))
        with progress.judged(stagnating(FAR)):
            attempt = solve_and_verify(system, near, former, progress)
        own = attempt.trajectory.t.size - 1 > options.intervals
        attempt = replace(attempt, taken_over=own)
    if attempt.duration < former.duration:
        return attempt
    kept = former.remainder(system)
    if kept is None or not _arrives(system, kept, options):
        return attempt
    same = replace(attempt, feasible=True, trajectory=kept, violations={}, layout=None)
    same = same.verified(system.problem, options)
    return same if same.duration < attempt.duration else attempt


def _halved(system: ProblemFunctions, options: Options, former: WarmStart) -> bool:
    """Whether the grid of a motion is halved at once where its controls bend.

    Where speeds rule that is all that finer grids would bring in the end.
    """
    return (
        options.refine == "auto"
        and options.objective == "time"
        and not system.parts
        and speed_share(former.trajectory, system.problem) > SPEED_SHARE
    )


def _arrives(system: ProblemFunctions, motion: Trajectory, options: Options) -> bool:
    """Whether a former motion ends where the problem wants it to."""
    q, v = motion.q[-1], motion.v[-1]
    goal = system.problem.goal.nearest(system.kinematics, q, v)
    lack, _ = goal.place_residual(system.kinematics, q)
    return bool(np.max(np.abs(lack), initial=0.0) <= options.goal_tolerance)


def outdone(system: ProblemFunctions, options: Options, progress: Progress) -> bool:
    """Whether a former motion has led to one that a search may well beat.

    Past an obstacle, or to another configuration, it may lead the long way round.
    First guesses take their paths as fast as can be, and better motions cut corners.
    """
    fixed = system.alone and system.final_configuration is not None
    if fixed or system.parts or system.problem.scene.moving:
        return False
    rng = np.random.default_rng(options.seed)
    guesses = initial_guesses(system, 1, rng, options.initial_duration, progress.ends)
    guess = next(guesses, None)
    if guess is None or not guess.timed:
        return False
    return bool(progress.best > OUTDONE * guess.duration)


def continued(
    problem: Problem, options: Options, progress: Progress, attempts: Sequence[Attempt]
) -> Iterator[Attempt]:
    """Go on with continuous accelerations, if that is free.

    From the fastest motion, and from all that were the fastest when they were found:
    fewer starts would have gone on from one of them, and might have come farther.
    """
    if options.control != "auto" or problem.segments:
        return
    records: list[Attempt] = []
    for attempt in attempts:
        if attempt.duration < min((a.duration for a in records), default=np.inf):
            records.append(attempt)
    for former in reversed(records):
        if options.refine == "switching" and not former.remark:
            continue  # its torques switch exactly: there is nothing left to gain
        system = ProblemFunctions.of(problem.alternative_of(former.trajectory))
        progress.share(1)
        progress.begin()
        solve = partial(
            solve_with_continuous_accelerations, system, options, former, progress
        )
        faster = guarded(problem, options, progress, former.name, solve)
        if faster is not None and faster.duration < former.duration:
            yield replace(faster, remark=f"{former.remark} {faster.remark}".strip())
        progress.deadline.check()


def solve_with_continuous_accelerations(
    system: ProblemFunctions, options: Options, attempt: Attempt, progress: Progress
) -> Attempt | None:
    """Go on from a motion with constant accelerations in each interval, where it pays.

    The parameterisation of the control is the paper's quasi-linear one. None if torques
    do not rule the motion, its accelerations are continuous already, or nothing faster
    came of it.
    """
    motion = attempt.trajectory
    if motion.a is None or speed_share(motion, system.problem) > SPEED_SHARE:
        return None
    near = replace(
        options,
        control="linear",
        trust_region=WARM_START_RADIUS * options.trust_region,
        max_iterations=min(options.max_iterations, FEW_ITERATIONS),
    )

    def solve(tried: ProblemFunctions, _: Attempt | None) -> Attempt:
        guess = warm_start(tried, motion)
        found = solve_from_guess(tried, near, guess, progress)
        return found.verified(system.problem, options, later=progress.puts_off)

    faster = with_rows_where_needed(system, progress, solve)
    if not faster.duration < attempt.duration:
        return None
    # Few iterations do, and the motion that they began with had settled.
    status = faster.status if faster.status in STOPPED else Status.CONVERGED
    return replace(faster, status=status)


def speed_share(motion: Trajectory, problem: Problem) -> float:
    """Share of the nodes at which a speed limit, of a tool too, holds the motion."""
    used = speed_used(problem, motion.q, motion.v)
    return float(np.mean(used > ACTIVE))
