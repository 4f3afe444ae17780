"""Descents: a sequence of convex programs improves a guess, then refines its grid."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from tominpmp.initial_guess.guess import SAMPLED, Guess
from tominpmp.initial_guess.rrt import is_free
from tominpmp.initial_guess.timing import speed_used
from tominpmp.initial_guess.warm_start import FINEST, WarmStart, warm_start
from tominpmp.options import Options
from tominpmp.planner.automatic_options import minimum_time
from tominpmp.planner.candidate import Candidate, KeptIterate
from tominpmp.planner.finer_grid import on_finer_grids
from tominpmp.planner.first_program import first_program
from tominpmp.planner.plan_state import PlanState
from tominpmp.planner.work import LESS_PADDING, REPAIRS, Work
from tominpmp.solvers.iterate import Iterate
from tominpmp.solvers.loop import Loop, Rule, first_of
from tominpmp.solvers.trust_region_step import trust_regions
from tominpmp.status import Status
from tominpmp.transcription.layout import AT_LIMIT
from tominpmp.transcription.problem_functions import ProblemFunctions

# Least number of intervals for which a coarse search pays off, and linear accelerations
# do: on longer intervals these lose more than constant ones where torques switch.
MANY_INTERVALS = 24
# Speed limits rule a guess if a joint is at its limit at this share of its samples;
# otherwise torques rule it.
SPEED_SHARE = 0.6
# Stop rule: over the last PATIENCE iterations the violation exceeds FAR, and its
# minimum over the later half of these is more than STILL of that over the former half.
PATIENCE, FAR, STILL = 10, 1e-3, 0.9


def _stop_if_hopeless(state: PlanState, loop: Loop) -> Status | None:
    """Stop rule that drops a descent whose violation stagnates.

    A descent that is still faster than the incumbent continues: on 63 problems of a
    Fetch and a Panda 12 of 17 descents whose violation stagnated ended feasible, two of
    them 9 and 22 % faster than any other.
    """
    excess, half = [record.violation for record in loop.history], PATIENCE // 2
    late = len(excess) >= PATIENCE and min(excess[-PATIENCE:]) > FAR
    stagnates = late and min(excess[-half:]) > STILL * min(excess[-PATIENCE:-half])
    faster = loop.history[-1].duration < state.best_duration < np.inf
    return loop.drop() if stagnates and not faster else None


def _with_control(system: ProblemFunctions, options: Options, guess: Guess) -> Options:
    """The options, with control "auto" resolved to accelerations that fit a guess.

    Where torques rule, motions with linear accelerations are up to 2.4 % faster. Where
    speeds rule, they gain next to nothing: constant accelerations then take half as
    many programs, and avoid ramps that are too short for the clock of a controller.
    """
    if options.control != "auto":
        return options
    smooth = isinstance(guess, WarmStart) and guess.continuous
    many = options.intervals >= MANY_INTERVALS
    smooth = smooth or (many and torque_limited(system, guess))
    smooth = smooth and not system.parts
    return replace(options, control="linear" if smooth else "constant")


def torque_limited(system: ProblemFunctions, guess: Guess) -> bool:
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


def _followed(system: ProblemFunctions, options: Options, guess: Guess) -> KeptIterate:
    """A path around obstacles as an iterate on a grid that is fine enough to keep it.

    Args:
        system: Functions of the problem.
        options: Options of the plan.
        guess: The path over time.
    """
    intervals = FINEST * options.intervals
    fine = replace(options, intervals=intervals, control="linear", grid="uniform")
    system = system.padded(LESS_PADDING)
    program, z = first_program(system, replace(fine, method="inverse"), guess)
    return KeptIterate(program, Iterate.of(program, z, 0.0), False)


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
    if former is not None:
        guess, stop = guess_of(system, former), None
    if system.clearance is not None:
        # The goal may be out of reach, or links may touch on all motions nearby.
        stop = first_of(stop, partial(_stop_if_hopeless, state))
    if doublings:
        # Objective "feasible" would return the refuted motion unchanged, as that keeps
        # the rows of the finer grid.
        intervals = 2**doublings * options.intervals
        options = replace(options, intervals=intervals, objective="time")
    if guess.name == SAMPLED and not system.parts:
        follow = partial(_followed, system, state.options, guess)
        state.paths.setdefault(id(system.problem), follow)
    objective = minimum_time(system, options, guess.duration)
    program, z = first_program(system, options, guess)
    initial = program.trajectory(z)
    step, usual = trust_regions(options)
    result = state.solve(program, objective, z, step, first_of(usual, stop))
    candidate = Candidate.of(initial, result)
    if options.refine not in ("auto", "grid") or state.options.objective != "time":
        return candidate
    finer = on_finer_grids(result, objective, state)
    if finer is result:
        return candidate
    return replace(Candidate.of(initial, finer), coarser=candidate)
