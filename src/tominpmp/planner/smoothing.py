"""Smoothing, the second stage of a plan: time given away for quiet torques."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from tominpmp.arrays import Array
from tominpmp.blas_threads import on_one_thread
from tominpmp.checks import instance, number
from tominpmp.exceptions import OptionsError, ProblemError
from tominpmp.initial_guess.warm_start import WarmStart, warm_start
from tominpmp.motion.measures import roughness, way_of
from tominpmp.motion.trajectory import Trajectory
from tominpmp.options import Options
from tominpmp.planner.later_stage import Over, bent, bettered, made
from tominpmp.solution import Solution
from tominpmp.solvers.quiet_torques import QuietTorques
from tominpmp.status import Status
from tominpmp.transcription.grid import Ticks, ticks_of
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import NonlinearProgram

NO_QUIETER = "no quieter motion was found."
# Ways of all joints that are shorter by this share are a gain without quieter torques.
WORTH_IT = 0.01
# Ways are told in shares of this at least [s].
SHORTEST_WAY = 1e-9


@on_one_thread
def smooth(solution: Solution, slack: float = 0.01) -> Solution:
    """Make the torques of a motion as quiet as they can be in slightly more time.

    The duration is fixed at (1 + slack) T, or at the next multiple of the control
    period if the motion was planned for one, and the squared differences of successive
    torques are minimised, with all limits and clearances held and the start and the
    goal met. The squares of the speeds count a little beside them: joints that have
    time to spare, which the fastest motion lets go to and fro where that helps it by
    next to nothing, go as straight as they can. Quadratic programs are solved one after
    the other, as the constraints are not linear, and the result is verified by its
    replay.

    Args:
        solution: A motion by any method.
        slack: Share of T to give away; 0 quietens what the minimum time leaves free.

    Returns:
        The quieter motion; its ``initial`` is the motion as it was, ``roughness`` tells
        how much was gained, and the message how much shorter the ways of the joints
        are. If none is found, the solution as it was, and its message says so.

    Raises:
        ProblemError: If there is no motion that keeps all constraints.
        OptionsError: If the slack is not a share >= 0.
    """
    instance(solution, Solution, "solution")
    expected = "a share of T >= 0"
    share = number(slack, "slack", expected, least=0.0, error=OptionsError)
    former = solution.trajectory
    if former is None or not solution.success:
        raise ProblemError(
            f"there is no motion to smooth: {solution.message}", "solution"
        )

    def left(reason: str) -> Solution:
        message = f"{solution.message} Its torques were left as they are: {reason}"
        return replace(solution, message=message)

    if not former.duration:
        return left("the motion takes no time.")
    return bettered(
        solution, partial(_quietest, solution, former, share), left, "making them quiet"
    )


def _quietest(solution: Solution, former: Trajectory, share: float) -> Solution | str:
    """The solution with quiet torques, or why there are none."""
    options, limits = solution.options, solution.problem.robot.limits
    before = roughness(former, limits)
    make = partial(_quieter, options, former, share)
    found = made(solution, former, former.t.size - 1, make)
    if found is None:
        return NO_QUIETER
    trajectory = found.trajectory
    if not found.verification.ok:
        return found.verification.message
    after = roughness(trajectory, limits)
    saved = 1.0 - way_of(trajectory, limits) / max(way_of(former, limits), SHORTEST_WAY)
    if after >= before and saved < WORTH_IT:
        return NO_QUIETER
    slower = trajectory.duration / former.duration - 1.0
    ways = f" and ways shorter by {100 * saved:.3g} %" if saved >= WORTH_IT else ""
    return replace(
        solution,
        options=replace(options, slack=share or None),
        message=f"{solution.message} Quiet torques: roughness {before:.3g} to "
        f"{after:.3g}{ways} for {100 * slower:.3g} % more time, T = "
        f"{trajectory.duration:.4f} s.",
        trajectory=trajectory,
        initial=former,
        violations={},
        verification=found.verification,
    )


def _quieter(
    options: Options,
    former: Trajectory,
    slack: float,
    system: ProblemFunctions,
    intervals: int,
    over: Over,
) -> tuple[Trajectory | None, Status]:
    """Quieter motion in the form of the former one, and how the iteration ended."""
    ticks, guess = None, warm_start(system, former)
    if options.control_period is None:
        program, z = _program(system, options, guess, former, intervals)
        z = program.time_scale(z, 1.0 + slack)
    else:
        period = options.control_period
        count = ticks_of((1.0 + slack) * former.duration, period)
        ticks = Ticks.near(period, count, former.t, intervals)
        program, z = guess.clocked_program(system, ticks)
    objective = QuietTorques.of(program, z, options.feasibility)
    result = bent(program, objective, z, options, over)
    if result.best is None:
        return None, result.status
    motion = result.program.trajectory(result.best.z)
    return motion if ticks is None else ticks.timed(motion), result.status


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
    if former.degree == 2:
        return guess.inverse_program(system, intervals, kind)
    return guess.spline_program(system, intervals, kind, former.degree)
