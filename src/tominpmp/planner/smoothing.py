"""Smoothing, the second stage of a plan: time given away for quiet torques."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from tominpmp.arrays import Array
from tominpmp.blas_threads import on_one_thread
from tominpmp.checks import instance, number
from tominpmp.exceptions import OptionsError, ProblemError
from tominpmp.motion.measures import roughness, way_of
from tominpmp.planner.control_period import layout_on_clock
from tominpmp.planner.energy import another_motion, bettered
from tominpmp.problem.segments import spans_of
from tominpmp.solution import Solution
from tominpmp.solvers.quiet_torques import QuietTorques
from tominpmp.transcription.grid import ticks_of
from tominpmp.transcription.layout import Layout
from tominpmp.transcription.program import NonlinearProgram

NO_QUIETER = "no quieter motion was found."
# Ways of all joints that are shorter by this share are a gain without quieter torques.
WORTH_IT = 0.01
# Shorter path lengths are not divided by [s].
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
        ProblemError: If there is no motion that keeps all constraints, the problem has
            segments, or the robot is kinematic.
        OptionsError: If the slack is not a share >= 0.
    """
    instance(solution, Solution, "solution")
    expected = "a share of T >= 0"
    share = number(slack, "slack", expected, least=0.0, error=OptionsError)
    if solution.trajectory is None or not solution.success:
        raise ProblemError(
            f"there is no motion to smooth: {solution.message}", "solution"
        )
    if solution.problem.robot.kinematic:
        raise ProblemError("solution is of a kinematic robot: no torques", "solution")
    count = len(solution.problem.segments)
    if count:
        raise ProblemError(
            f"the motion has {count} segments, expected one without segments: the "
            "torques of others cannot be made quiet yet",
            "solution",
        )
    kept, doing = "Its torques were left as they are", "making them quiet"
    return bettered(solution, doing, kept, partial(_quietest, solution, share))


def _quietest(solution: Solution, slack: float) -> Solution | str:
    """The solution with quiet torques, or why there are none."""
    options, limits = solution.options, solution.problem.robot.limits
    former, feasibility = solution.trajectory, options.feasibility
    assert former is not None  # noqa: S101
    if not former.duration:
        return "the motion takes no time."
    T, period = (1.0 + slack) * former.duration, options.control_period

    def layout(halvings: int) -> Layout:
        if period is not None:
            whole, counts = spans_of(former, ()), [ticks_of(T, period)]
            return layout_on_clock(former, whole, period, counts, halvings)
        own = Layout.of_motion(former) or Layout.of_torques(former)
        return own.with_intervals(2**halvings * len(own.shares))

    def quiet(program: NonlinearProgram, z: Array) -> tuple[QuietTorques, Array]:
        if period is None:
            z = program.time_scale(z, 1.0 + slack)
        return QuietTorques.of(program, z, feasibility), z

    found = another_motion(solution, layout, quiet)
    if found.refuted and found.verification is not None:
        return found.verification.message
    motion, before = found.trajectory, roughness(former, limits)
    after, way = roughness(motion, limits), max(way_of(former, limits), SHORTEST_WAY)
    saved = 1.0 - way_of(motion, limits) / way
    if not found.found or (after >= before and saved < WORTH_IT):
        return NO_QUIETER
    slower = motion.duration / former.duration - 1.0
    ways = f" and ways shorter by {100 * saved:.3g} %" if saved >= WORTH_IT else ""
    return replace(
        solution,
        options=replace(options, slack=slack or None),
        message=f"{solution.message} Quiet torques: roughness {before:.3g} to "
        f"{after:.3g}{ways} for {100 * slower:.3g} % more time, T = "
        f"{motion.duration:.4f} s.",
        trajectory=motion,
        initial=former,
        violations={},
        verification=found.verification,
    )
