"""Torque starts: shooting from initial torques that need not lead to the goal.

Without torques or a duration in the options, the shooting methods begin with torques
that track the first guess of other methods. Without feedback such torques would leave
the guess: even their rounding to intervals makes an arm of light links miss by radians.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tominpmp.arrays import Array
from tominpmp.initial_guess.guess import GuessRequest
from tominpmp.initial_guess.path_velocity import guesses_of
from tominpmp.options import Options
from tominpmp.planner.automatic_options import SHOOTING
from tominpmp.planner.candidate import Candidate
from tominpmp.planner.first_program import GUESS_TIME_SCALE
from tominpmp.planner.plan_state import PlanState, start_key
from tominpmp.planner.work import REPAIRS, Schedule, Work
from tominpmp.solvers.fixed_step import fixed_steps
from tominpmp.solvers.loop import Rule, Step
from tominpmp.solvers.objective import MinimumTime
from tominpmp.solvers.penalty import penalty_rounds
from tominpmp.solvers.trust_region_step import trust_regions
from tominpmp.transcription.adjoint import AdjointTranscription
from tominpmp.transcription.collocation import CollocationTranscription
from tominpmp.transcription.grid import interval_shares
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import NonlinearProgram

# Initial duration for shooting: the paper's T^0 [s].
FIRST_DURATION = 1.5
# Number of starts if a motion may have to swing, and most starts while there is no
# incumbent.
TORQUE_STARTS = 4
# Arms of at most this number of joints may have to swing.
FEW_JOINTS = 3
# Random torques are constant on PIECES pieces; their duration is the initial one times
# or divided by up to LONGER.
PIECES = 4
LONGER = 2.0


def torque_starts(
    system: ProblemFunctions, state: PlanState, least: int = TORQUE_STARTS
) -> Schedule[None]:
    """Descend from given torques, or those of a guess, then from random torques.

    Starts that the plan has made before are left out.

    Args:
        system: Functions of the problem.
        state: The plan. If its method is no shooting method, the adjoint method is
            used.
        least: Number of starts unless options set it for a shooting method. The adjoint
            method makes up to TORQUE_STARTS while there is no incumbent.
    """
    options, tracked = state.options, None
    if options.method in SHOOTING:
        tracked = _tracked_guess(system, options)
    else:
        options = replace(
            options,
            method="adjoint",
            control="constant",
            lp_solver="highs",
            starts=None,
        )
    first = _given_torques(system, options) if tracked is None else tracked
    rng = np.random.default_rng(options.seed)
    wanted = most = options.starts or least
    if options.method == "adjoint":
        most = max(wanted, TORQUE_STARTS)
    for number in range(most):
        if number >= wanted and state.best_duration < np.inf:
            return
        z = _random_torques(system, options, rng) if number else first
        key = start_key(system.problem, z)
        if key not in state.tried:
            state.tried.add(key)
            yield shooting_work(system, options, state, z)


def torques_may_lead(system: ProblemFunctions) -> bool:
    """Whether random torques may lead to a motion where no path does.

    In free space a guess of a path fails only for lack of torque: a small arm may have
    to swing. Random torques are piecewise constant, and cannot keep motion limits, as
    of jerk or torque rate.
    """
    limited = bool(system.motion_limits._bounded)
    return system.in_free_space and system.n <= FEW_JOINTS and not limited


def _given_torques(system: ProblemFunctions, options: Options) -> Array:
    """Initial iterate: the torques and the duration of the options, or the default."""
    given, shape = options.initial_control, (options.intervals, system.n)
    control = np.zeros(shape) if given is None else np.broadcast_to(given, shape)
    shares = system.torque_shares(control)
    return np.append(shares.ravel(), options.initial_duration or FIRST_DURATION)


def _tracked_guess(system: ProblemFunctions, options: Options) -> Array | None:
    """Initial iterate: torques that track the first guess, in its duration.

    None if the options give torques or a duration, or no guess reaches the goal, or the
    motors are too weak for its path: an arm may have to swing.
    """
    if options.initial_control is not None or options.initial_duration is not None:
        return None
    request = GuessRequest(np.random.default_rng(options.seed))
    guess = next(guesses_of(system, request), None)
    if guess is None or not guess.timed:
        return None
    T = GUESS_TIME_SCALE * guess.duration
    shares, eta = interval_shares(options.grid, options.intervals), np.array([T])
    lifted = CollocationTranscription(system, shares, T)
    x, _, _ = lifted.split(lifted.start(guess.position, guess.duration, eta))
    return AdjointTranscription(system, shares, T).tracking(x, eta)


def _random_torques(
    system: ProblemFunctions, options: Options, rng: np.random.Generator
) -> Array:
    """Initial iterate: random piecewise constant torques, and a random duration."""
    pieces = rng.uniform(-1.0, 1.0, (PIECES, system.n))
    piece = np.arange(options.intervals) * PIECES // options.intervals
    longer = LONGER ** rng.uniform(-1.0, 1.0)
    duration = longer * (options.initial_duration or FIRST_DURATION)
    return np.append(pieces[piece].ravel(), duration)


def shooting_work(
    system: ProblemFunctions, options: Options, state: PlanState, z: Array
) -> Work:
    """Work that improves torques and a duration.

    If the replay breaks limits, it is repeated with shorter integration steps.
    """
    shares = interval_shares(options.grid, options.intervals)
    penalty = options.method == "penalty"
    paper = options.step_rule == "paper" and not penalty
    objective = MinimumTime.of(options, 0.0 if paper else options.smoothing or 0.0)

    def make(functions: ProblemFunctions, doublings: int, _: object) -> Candidate:
        nonlocal z
        transcription = AdjointTranscription(
            functions, shares, float(z[-1]), substeps=2**doublings
        )
        program = NonlinearProgram.of(transcription, "exact" if paper else "near")
        initial = program.trajectory(z)
        gradual = program.system.clearance is not None
        method: tuple[Step, Rule]
        # Among obstacles, methods without a trust region get farther if they are
        # restarted.
        for _ in range(2 if gradual and (paper or penalty) else 1):
            if penalty:
                method = penalty_rounds(options, z)
            else:
                method = fixed_steps(options) if paper else trust_regions(options)
            result = state.solve(program, objective, z, *method)
            program, z = result.program, result.iterate.z
        z = (result.best or result.iterate).z
        return Candidate.of(initial, result)

    return Work(system, make, REPAIRS)
