"""Smoothing, an optional last stage of a plan: a longer duration for quiet torques."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from tominpmp.arrays import Array
from tominpmp.blas_threads import on_one_thread
from tominpmp.checks import instance, number, raised_as
from tominpmp.exceptions import OptionsError, ProblemError
from tominpmp.motion.measures import roughness, travel
from tominpmp.motion.trajectory import Trajectory
from tominpmp.planner.energy import reoptimised, run_stage
from tominpmp.problem.segments import spans_of
from tominpmp.solution import Solution
from tominpmp.solvers.quiet_torques import QuietTorques
from tominpmp.transcription.grid import ticks_of
from tominpmp.transcription.layout import Layout
from tominpmp.transcription.program import NonlinearProgram

# Least reduction of the path lengths of all joints, as a share, that counts as a gain
# even if torques are no quieter.
WORTH_IT = 0.01


@on_one_thread
def smooth(solution: Solution, slack: float = 0.01) -> Solution:
    """Make the torques of a motion as quiet as they can be in slightly more time.

    The duration is fixed at (1 + slack) T, or at the next multiple of the control
    period if the motion was planned for one, and the squared differences of successive
    torques are minimised, with all limits and clearances held and the start and the
    goal met. The squares of the speeds have a small weight, too: joints with time to
    spare, which the fastest motion moves to and fro for a negligible gain, then go as
    straight as they can. As the constraints are not linear, a sequence of quadratic
    programs is solved, and the result is verified by its replay.

    Args:
        solution: A motion by any method.
        slack: Additional duration as a share of T; with 0 only those torques become
            quieter that the minimum time leaves free.

    Returns:
        The quieter motion. Its ``initial`` is the former motion, ``roughness`` measures
        the gain, and the message has the reduction of the path lengths of the joints.
        If no quieter motion is found, the former solution, whose message says so.

    Raises:
        ProblemError: If the solution has no motion that keeps all constraints, the
            problem has segments, or the robot is kinematic.
        OptionsError: If the slack is not a share >= 0.
    """
    instance(solution, Solution, "solution")
    with raised_as(OptionsError):
        share = number(slack, "slack", "a share of T >= 0", least=0.0)
    former = solution.trajectory
    if former is None or not solution.success:
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
    otherwise, doing = "Its torques were left as they are", "making them quiet"
    quietest = partial(_quietest, solution, former, share)
    return run_stage(solution, doing, otherwise, quietest)


def _quietest(solution: Solution, former: Trajectory, slack: float) -> Solution | str:
    """The solution with quiet torques, or the reason for its failure."""
    options, limits = solution.options, solution.problem.robot.limits
    if not former.duration:
        return "the motion takes no time."
    T, period = (1.0 + slack) * former.duration, options.control_period

    def layout(halvings: int) -> Layout:
        if period is not None:
            whole, counts = spans_of(former, ()), [ticks_of(T, period)]
            return Layout.on_clock(former, whole, period, counts, halvings)
        grid = Layout.of_motion(former) or Layout.of_torques(former)
        return grid.with_intervals(2**halvings * len(grid.shares))

    def quiet(program: NonlinearProgram, z: Array) -> tuple[QuietTorques, Array]:
        if period is None:
            z = program.time_scale(z, 1.0 + slack)
        return QuietTorques.of(program, z, options.feasibility), z

    candidate = reoptimised(solution, former, layout, quiet)
    if candidate.refuted and candidate.verification is not None:
        return candidate.verification.message
    motion, before = candidate.trajectory, roughness(former, limits)
    after, length = roughness(motion, limits), travel(former, limits) or 1.0
    saved = 1.0 - travel(motion, limits) / length
    if not candidate.confirmed or (after >= before and saved < WORTH_IT):
        return "no quieter motion was found."
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
        verification=candidate.verification,
    )
