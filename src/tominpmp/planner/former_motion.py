"""Former motions: candidates that begin with one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tominpmp.initial_guess.guess import initial_guesses
from tominpmp.initial_guess.segments import SegmentedGuess
from tominpmp.initial_guess.warm_start import WarmStart
from tominpmp.motion.trajectory import Trajectory
from tominpmp.options import Options
from tominpmp.planner.candidate import Candidate
from tominpmp.planner.descent import descended, stop_if_hopeless
from tominpmp.planner.plan_state import PlanState
from tominpmp.planner.torque_starts import solve_by_shooting
from tominpmp.transcription.grid import interval_shares
from tominpmp.transcription.problem_functions import ProblemFunctions

# Trust region of a start from a former motion, in shares of the usual one.
RADIUS = 0.3
# A start from a former motion that stays this far from any is given up: what was near
# goes on in a few iterations, or a search is the shorter way.
FAR = 0.05
# Nor is one enough that takes longer than this share of what a first guess takes.
OUTDONE = 0.95


def solve_from_warm_start(
    system: ProblemFunctions,
    options: Options,
    former: WarmStart | SegmentedGuess,
    progress: PlanState,
) -> Candidate:
    """Improve a former motion.

    That of one segment stays as it was if nothing faster is found.
    """
    near = replace(options, trust_region=RADIUS * options.trust_region)
    if isinstance(former, SegmentedGuess):
        return descended(system, near, former, progress)
    if options.method in ("adjoint", "penalty"):
        shares = interval_shares(options.grid, options.intervals)
        first = former.torque_program(system, shares)
        candidate = solve_by_shooting(system, near, progress, first)
    else:
        with progress.judged(stop_if_hopeless(former.duration, FAR)):
            candidate = descended(system, near, former, progress)
    if candidate.duration < former.duration:
        return candidate
    kept = former.remainder(system)
    if kept is None or not _arrives(system, kept, options):
        return candidate
    same = replace(
        candidate, feasible=True, trajectory=kept, violations={}, layout=None
    )
    same = same.verified(system.problem, options)
    return same if same.duration < candidate.duration else candidate


def _arrives(system: ProblemFunctions, motion: Trajectory, options: Options) -> bool:
    """Whether a former motion ends where the problem wants it to."""
    q, v = motion.q[-1], motion.v[-1]
    goal = system.problem.goal.nearest(system.kinematics, q, v)
    lack, _ = goal.place_residual(system.kinematics, q)
    return bool(np.max(np.abs(lack), initial=0.0) <= options.goal_tolerance)


def outdone(system: ProblemFunctions, options: Options, progress: PlanState) -> bool:
    """Whether a former motion has led to one that a search may well beat.

    Past an obstacle, or to another configuration, it may lead the long way round.
    First guesses take their paths as fast as can be, and better motions cut corners.
    """
    fixed = system.in_free_space and system.final_configuration is not None
    if fixed or system.parts or system.problem.scene.moving:
        return False
    rng = np.random.default_rng(options.seed)
    guesses = initial_guesses(system, 1, rng, options.initial_duration, progress.ends)
    guess = next(guesses, None)
    if guess is None or not guess.timed:
        return False
    return bool(progress.best > OUTDONE * guess.duration)
