"""Smoothing, the second stage of a plan: time given away for less torque variation."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tominpmp.arrays import Array, number_or_nan
from tominpmp.exceptions import OptionsError, ProblemError, brief, expect
from tominpmp.initial_guess.warm_start import WarmStart, warm_start
from tominpmp.options import Options
from tominpmp.planner.attempt import REFINEMENTS
from tominpmp.planner.rescue import NUMERICAL
from tominpmp.solution import Solution
from tominpmp.solvers.iterate import SlpResult
from tominpmp.solvers.rounds import solve_in_rounds
from tominpmp.solvers.torque_variation import TorqueVariationSolver
from tominpmp.status import Status
from tominpmp.stopping import Stop, bounded, seconds_left
from tominpmp.torque_measures import roughness
from tominpmp.trajectory import Trajectory
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import NonlinearProgram
from tominpmp.transcription.ticks import Ticks, ticks_of
from tominpmp.verification import Verification, verify

logger = logging.getLogger(__name__)

# Time for the replay of what was found, in multiples of what the last one took.
REPLAYS = 2.0
NO_QUIETER = "no quieter motion was found."


def smooth(solution: Solution, slack: float = 0.01) -> Solution:
    """Make the torques of a motion as quiet as they can be in slightly more time.

    The duration is fixed at (1 + slack) T, or at the next multiple of the control
    period if the motion was planned for one, and the squared differences of successive
    torques are minimised, with all limits and clearances held and the start and the
    goal met. Quadratic programs are solved one after the other, as the constraints are
    not linear, and the result is verified by its replay.

    Args:
        solution: A motion by any method.
        slack: Share of T to give away; 0 quietens what the minimum time leaves free.

    Returns:
        The quieter motion; its ``initial`` is the motion as it was, and ``roughness``
        tells how much was gained. If none is found, the solution as it was, and its
        message says so.

    Raises:
        ProblemError: If there is no motion that keeps all constraints.
        OptionsError: If the slack is not a share >= 0.
    """
    expect(solution, Solution, "solution", "a Solution")
    share = number_or_nan(slack)
    if not 0.0 <= share < np.inf:
        raise OptionsError(
            f"slack is {brief(slack)}, expected a share of T >= 0", "slack"
        )
    former = solution.trajectory
    if former is None or not solution.success:
        raise ProblemError(
            f"there is no motion to smooth: {solution.message}", "solution"
        )
    begin = time.perf_counter()

    def left(reason: str) -> Solution:
        message = f"{solution.message} Its torques were left as they are: {reason}"
        seconds = solution.planning_time + time.perf_counter() - begin
        return replace(solution, message=message, planning_time=seconds)

    try:
        with bounded(solution.options.max_planning_time):
            found = _quietest(solution, former, share)
    except (Stop, KeyboardInterrupt) as stop:
        if isinstance(stop, Stop) and not stop.requested:
            return left("the time was used up.")
        return replace(left("this was interrupted."), status=Status.INTERRUPTED)
    except NUMERICAL as error:
        logger.warning("making torques quiet failed: %r", error)
        return left(f"that failed ({type(error).__name__}).")
    if isinstance(found, str):
        return left(found)
    seconds = solution.planning_time + time.perf_counter() - begin
    return replace(found, planning_time=seconds)


def _quietest(solution: Solution, former: Trajectory, share: float) -> Solution | str:
    """The solution with quiet torques, or why there are none."""
    options, problem = solution.options, solution.problem
    replay = 0.0 if solution.verification is None else solution.verification.seconds

    def over() -> bool:
        return seconds_left() < REPLAYS * replay

    reached = problem.alternative_at(former.q[-1], former.v[-1])
    complete = ProblemFunctions.of(reached)
    system = complete.first_tried
    guess = warm_start(system, former)
    before = roughness(former, problem.robot.limits)
    intervals = former.t.size - 1
    found: tuple[Trajectory, Verification] | None = None
    for refinement in range(1 + REFINEMENTS):
        quiet = _quieter(system, options, guess, former, intervals, share, over)
        if quiet is None:
            break
        found = (
            quiet,
            verify(problem, quiet, options.tolerances, checker=problem.checker),
        )
        if found[1].ok or over():
            break
        if any(item.kind == "clearance" for item in found[1].violations):
            system = complete  # with rows for the links
        intervals = intervals * 2 ** (refinement + 1)
    if found is None:
        return NO_QUIETER
    trajectory, verification = found
    if not verification.ok:
        return verification.message
    after = roughness(trajectory, problem.robot.limits)
    if after >= before:
        return NO_QUIETER
    gained = trajectory.duration / former.duration - 1.0
    return replace(
        solution,
        options=replace(options, slack=share or None),
        message=f"{solution.message} Quiet torques: roughness {before:.3g} to "
        f"{after:.3g} for {100 * gained:.3g} % more time, T = "
        f"{trajectory.duration:.4f} s.",
        trajectory=trajectory,
        initial=former,
        violations={},
        verification=verification,
    )


def _quieter(
    system: ProblemFunctions,
    options: Options,
    guess: WarmStart,
    former: Trajectory,
    intervals: int,
    slack: float,
    over: Callable[[], bool],
) -> Trajectory | None:
    """Quieter motion in the form of the former one; None if there is none."""
    ticks = None
    if options.control_period is None:
        program, z = _program(system, options, guess, former, intervals)
        z = program.stretch(z, 1.0 + slack)
    else:
        period = options.control_period
        count = ticks_of((1.0 + slack) * former.duration, period)
        ticks = Ticks.near(period, count, former.t, intervals)
        program, z = guess.clocked_program(system, ticks)

    def solve(
        program: NonlinearProgram, z: Array, options: Options, _: SlpResult | None
    ) -> SlpResult:
        times = program.transcription.sequence_times(z)
        return TorqueVariationSolver(program, options, times, over).run(z)

    program, result = solve_in_rounds(program, z, options, solve, rough=False)
    if result.best is None:
        return None
    motion = program.trajectory(result.best.z)
    return motion if ticks is None else ticks.timed(motion)


def _program(
    system: ProblemFunctions,
    options: Options,
    guess: WarmStart,
    former: Trajectory,
    intervals: int,
) -> tuple[NonlinearProgram, Array]:
    """Program in the form of a motion, and the motion as its iterate."""
    kind = options.grid
    if former.inverse_dynamics is None:
        return guess.lifted_program(system, intervals, kind)
    if former.a is not None and former.a.shape[0] == former.t.size - 1:
        return guess.inverse_program(system, intervals, kind)
    degree = 3 if former.a is None else 5
    return guess.spline_program(system, intervals, kind, degree)
