"""Descents: convex programs improve a guess on the asked grid, then on finer ones."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from tominpmp.constraints.friction import EFFORT_TOLERANCE
from tominpmp.initial_guess.constrained import speed_used
from tominpmp.initial_guess.guess import Guess
from tominpmp.initial_guess.segments import at_rest_on_the_way
from tominpmp.initial_guess.warm_start import WarmStart, warm_start
from tominpmp.options import Options
from tominpmp.planner.automatic_options import least_time
from tominpmp.planner.candidate import Candidate
from tominpmp.planner.finer_grid import on_finer_grids
from tominpmp.planner.first_program import Begun, first_program
from tominpmp.planner.plan_state import PlanState
from tominpmp.planner.work import REPAIRS, Work
from tominpmp.solvers.exchange import RowExchange, with_missing_rows
from tominpmp.solvers.loop import Loop, Rule, solve
from tominpmp.solvers.objective import LIGHT
from tominpmp.solvers.stop import first_of
from tominpmp.solvers.trust_region_step import trust_regions
from tominpmp.status import Status
from tominpmp.transcription.bspline import DEGREES
from tominpmp.transcription.problem_functions import ProblemFunctions

# Gap of programs, as a share of T, where the final configuration is free: looser ones
# lead to more iterations there.
FREE_ACCURACY = 1e-6
# Iterations for a motion whose accelerations jump, from which a smooth one begins.
FIRST_ITERATIONS = 10
# Doublings of the grid of constant torques: swift motions need more of them, which take
# little time.
REPAIRS_OF_COLLOCATION = 4
# Intervals of grids from which on coarser ones pay, and linear accelerations: on fewer
# they lose more where torques switch than constant ones do.
MANY_INTERVALS = 24
# Speed limits are active at a sample of a guess where a joint has AT_LIMIT of
# its speed; they limit a guess if they are at SPEED_SHARE of its samples, else torques
# do.
SPEED_SHARE, AT_LIMIT = 0.6, 0.97
# Stop rule: from PATIENCE iterations on, the violation is above the threshold, and its
# minimum over the last LATELY ones is more than FALLING times the earlier minimum.
PATIENCE, LATELY, FALLING = 10, 5, 0.9
# Or T has grown by the factor EVER_SLOWER, and the violation is above FAR.
EVER_SLOWER, FAR = 10.0, 1e-3


def stop_if_hopeless(duration: float, near: float = FAR) -> Rule:
    """Rule that drops an iteration which comes no nearer to a motion, or ever slower.

    Args:
        duration: T of the guess [s].
        near: Violations up to this share are near; infinite judges the time alone.
    """

    def rule(loop: Loop) -> Status | None:
        seen = [record.violation for record in loop.history]
        late = len(seen) >= PATIENCE and seen[-1] > near
        over = late and min(seen[-LATELY:]) > FALLING * min(seen[:-LATELY])
        slower = loop.history[-1].duration > EVER_SLOWER * duration
        return loop.drop() if over or (slower and seen[-1] > FAR) else None

    return rule


def _with_control(system: ProblemFunctions, options: Options, guess: Guess) -> Options:
    """The options, with accelerations that fit a guess where that was left open.

    Linear ones are 3 to 4 % faster where torques rule. Where speeds do they bring next
    to nothing: constant ones take half the programs there, and no ramps that are too
    short for the clock of a controller.
    """
    if options.control != "auto":
        return options
    smooth = isinstance(guess, WarmStart) and guess.continuous
    many = options.intervals >= MANY_INTERVALS
    smooth = smooth or (many and torques_rule(system, guess))
    smooth = smooth and not system.parts
    return replace(options, control="linear" if smooth else "constant")


def torques_rule(system: ProblemFunctions, guess: Guess) -> bool:
    """Whether torques rule a motion along a guess, rather than speed limits."""
    if not guess.timed and not isinstance(guess, WarmStart):
        return True
    v = np.diff(guess.q, axis=0) / np.diff(guess.t)[:, None]
    used = speed_used(system.problem, 0.5 * (guess.q[1:] + guess.q[:-1]), v)
    return bool(np.mean(used > AT_LIMIT) < SPEED_SHARE)


def descent_work(
    system: ProblemFunctions,
    options: Options,
    guess: Guess,
    state: PlanState,
    stop: Rule | None = None,
    follows: Candidate | None = None,
) -> Work:
    """Work that improves a guess until its replay holds.

    Args:
        system: Functions of the problem.
        options: Options of the descent.
        guess: The guess.
        state: The plan.
        stop: Ends the iteration early.
        follows: The candidate that the guess comes from.
    """
    options = _with_control(system, options, guess)
    if guess.blocked:
        # The goal seems to be out of reach: no more is waited for than has to be.
        hopeless = stop_if_hopeless(guess.duration)
        stop = hopeless if stop is None else first_of(stop, hopeless)
    make = partial(descend, options, guess, state, stop)
    torques_kept = options.method == "collocation"
    repairs = REPAIRS_OF_COLLOCATION if torques_kept else REPAIRS
    return Work(system, guess.name, make, repairs, follows=follows)


def guess_of(system: ProblemFunctions, candidate: Candidate) -> Guess:
    """The motion of a candidate as a guess."""
    found = warm_start(system, candidate.trajectory)
    return replace(found, name=candidate.name, solved=True)


def descend(
    options: Options,
    guess: Guess,
    state: PlanState,
    stop: Rule | None,
    system: ProblemFunctions,
    doublings: int = 0,
    former: Candidate | None = None,
    *,
    effort_tolerance: float = EFFORT_TOLERANCE,
) -> Candidate:
    """Improve a guess on the grid that the options ask for, then on finer ones.

    Args:
        options: Options of the descent.
        guess: The guess.
        state: Sees and keeps the motions.
        stop: Ends the iteration early; None for the usual rules alone.
        system: Functions of the problem.
        doublings: How often the grid is doubled.
        former: The refuted candidate that serves as warm start.
        effort_tolerance: Excess of torques that is tolerated between rows.
    """
    if former is not None:
        guess = guess_of(system, former)
        stop = stop_if_hopeless(former.trajectory.duration, np.inf)
    if doublings:
        # The first motion will not do on the finer grid either: it was too rough.
        intervals = 2**doublings * options.intervals
        options = replace(options, intervals=intervals, objective="time")
    objective = least_time(system, options, guess.duration)
    program, z = first_program(system, options, guess)
    initial = program.trajectory(z)
    if system.parts and not guess.solved and options.control in DEGREES:
        program, z = _smooth_start(system, options, guess, state)
    step, usual = trust_regions(options, accuracy=_accuracy(system))
    exchange = RowExchange(
        # The last violations cost less than a finer grid brings.
        light=LIGHT if options.refine == "auto" else 0.0,
        revise=partial(with_missing_rows, effort_tolerance=effort_tolerance),
    )
    result = solve(
        program,
        objective,
        z,
        step,
        usual if stop is None else first_of(usual, stop),
        exchange=exchange,
        callback=state,
        keep=state.keep,
    )
    found = Candidate.of(guess.name, initial, result)
    if options.refine not in ("auto", "grid") or state.options.objective != "time":
        return found
    finer = on_finer_grids(result, state)
    if finer is result:
        return found
    refined = Candidate.of(guess.name, initial, finer)
    return replace(refined, coarser=found)


def _accuracy(system: ProblemFunctions) -> float | None:
    """Gap of the programs of a descent; None for the usual one."""
    return FREE_ACCURACY if system.final_configuration is None else None


def _smooth_start(
    system: ProblemFunctions, options: Options, guess: Guess, state: PlanState
) -> Begun:
    """Program with continuous accelerations for a guess, and where to begin.

    Where goals are passed, the corners of a guess are far from any such motion: it is
    begun with a motion that stops there, or with one whose accelerations may jump.
    """
    few = replace(options, max_iterations=FIRST_ITERATIONS)
    own = at_rest_on_the_way(system)
    if not guess.stops:
        own, few = system.without_smooth_limits(), replace(few, control="constant")
    program, z = first_program(own, few, guess)
    result = solve(
        program,
        least_time(system, few, guess.duration),
        z,
        *trust_regions(few, accuracy=_accuracy(system)),
        callback=state,
        keep=state.keep,
    )
    if guess.stops:
        program, z = first_program(system, options, guess)
        z = z if result.best is None else result.best.z
        return program.at(z), z
    if result.best is not None:
        motion = result.program.trajectory(result.best.z)
        found = warm_start(system, motion)
        inner = found.inner_ends
        guess = Guess(guess.name, found.t, found.q, False, inner_ends=inner)
    return first_program(system, options, guess)
