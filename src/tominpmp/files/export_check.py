"""Files of motions, judged as their readers will follow them.

A file is some points of a motion; each reader joins them in a way of its own, and
what moves the arm is that. So a file is read, joined as its reader does, and judged
like a plan, whoever made it. Where one does not hold that a plan was written to, other
times between the points are tried, so that there is something to say beyond that.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np

from tominpmp.arrays import Array
from tominpmp.blas_threads import on_one_thread
from tominpmp.checks import instance
from tominpmp.description.paths import checked_path
from tominpmp.exceptions import ProblemError
from tominpmp.files.export import (
    file_samples,
    is_message,
    load_message,
    load_motion,
    message_motion,
)
from tominpmp.files.ros import Refusal, controller_needs, controller_refusals
from tominpmp.files.tables import known_quantities
from tominpmp.motion.joining import Joined, controlled, join
from tominpmp.motion.samples import Interpolation, Samples, check_interpolation
from tominpmp.motion.trajectory import Trajectory
from tominpmp.options import Tolerances
from tominpmp.problem.controls import control_bounds
from tominpmp.problem.problem import Problem
from tominpmp.solution import Solution
from tominpmp.verification.limit_violations import LimitViolation, state_violations
from tominpmp.verification.verification import Verification, verify

# Periods that controllers have [s], the longest first.
PERIODS = (0.01, 0.008, 0.004, 0.002, 0.001)
# A period that controllers have [s], where none is known.
USUAL = 0.004
# Instants of each interval that are looked at, as shares of it: near the ends, where
# polynomials that overshoot are fastest, too.
INSTANTS = np.array([0.0005, 0.1, 0.3, 0.5, 0.7, 0.9, 0.9995])
# Times what is tolerated that an excess must be to do without a replay.
CLEARLY = 2.0
# Intervals shorter than this [s] are rounding of times.
SHORTEST = 1e-7
# Two curves are the same if they differ by no more, in positions [rad or m],
# velocities [rad/s or m/s] and torques, these relative to their range.
SAME_Q, SAME_V, SAME_U = 1e-7, 1e-5, 2e-4


@dataclass(frozen=True, eq=False)
class ExportCheck:
    """What a file was found to do.

    Attributes:
        path: The file.
        ok: Whether what its reader makes of it solves the problem, and a controller
            takes it.
        joined: How its reader joins the points, in words.
        refusals: Rules of the joint trajectory controller that it breaks, for messages
            of ROS.
        violations: Limits that it breaks, and the goal if it misses it.
        verification: Its replay; None where the points alone told that it breaks
            limits.
        holding: Times between points that would hold [s], of those that were tried;
            None stands for the nodes of the motion.
        tried: Those that were tried.
        replan: Period to plan with for a motion whose samples hold [s]; None if there
            is nothing to say.
        notes: What else is to be known of it, in sentences.
        seconds: Time taken [s].
        duration: Duration of the motion that its reader makes of it [s].
    """

    path: Path
    ok: bool
    joined: str
    refusals: tuple[Refusal, ...]
    violations: tuple[LimitViolation, ...]
    verification: Verification | None = field(repr=False)
    holding: tuple[float | None, ...] = ()
    tried: tuple[float | None, ...] = ()
    replan: float | None = None
    notes: tuple[str, ...] = ()
    seconds: float = 0.0
    duration: float = math.nan

    @property
    def message(self) -> str:
        """Whether the file holds; if not, what is wrong and what would hold."""
        if self.ok:
            return f"{self.path} holds, joined by {self.joined}."
        parts = [f"{self.path} does not hold, joined by {self.joined}"]
        if self.violations:
            parts.append("; ".join(map(str, self.violations)))
        if self.refusals:
            shown = "; ".join(map(str, self.refusals[:3]))
            more = len(self.refusals) - 3
            rest = f"; and {more} more" if more > 0 else ""
            parts.append(f"a controller would refuse it: {shown}{rest}")
        return ": ".join(parts) + "." + self._advice()

    def _advice(self) -> str:
        """What would hold, as far as it was tried, and what else to do."""
        parts = []
        if self.holding:
            parts.append(f"What holds: {_listed(self.holding)}.")
        elif self.tried:
            parts.append(f"Nor do these hold: {_listed(self.tried)}.")
        if self.replan is not None:
            parts.append(
                f"A motion for samples of {self.replan:g} s is planned with "
                f"control_period = {self.replan:g} (--control-period)."
            )
        return "".join(f" {part}" for part in parts)


def _listed(steps: tuple[float | None, ...]) -> str:
    return ", ".join(
        "the nodes of the motion (without dt)" if step is None else f"dt = {step:g} s"
        for step in steps
    )


# What a judge found of a motion: the limits it breaks, and its replay if there was one.
Found = tuple[tuple[LimitViolation, ...], Verification | None]


def check_file(
    problem: Problem,
    path: str | Path,
    *,
    tolerances: Tolerances | None = None,
    interpolation: Interpolation | None = None,
) -> ExportCheck:
    """Read a motion from a file of any origin, and judge it as its reader.

    Args:
        problem: What it is to solve.
        path: The file, see :func:`~tominpmp.files.export.load_motion`.
        tolerances: What is tolerated; None for the defaults.
        interpolation: How the points are joined; None for what the kind of file says.

    Returns:
        What was found, with the replay.

    Raises:
        ProblemError: If an argument is wrong.
        ScenarioError: If the file cannot be read, or is of another robot.
    """
    instance(problem, Problem, "problem")
    if interpolation is not None:
        check_interpolation(interpolation)
    within = Tolerances() if tolerances is None else tolerances
    instance(within, Tolerances, "tolerances", "Tolerances or None")

    def judge(motion: Trajectory) -> Found:
        found = verify(problem, motion, within)
        return found.violations, found

    return _check(problem, path, judge, interpolation)


@on_one_thread
def check_export(
    solution: Solution, path: str | Path, *, dt: float | None = None
) -> ExportCheck:
    """Read a file back that a solution was written to, and judge it as its reader.

    Args:
        solution: The solution.
        path: The file, as :meth:`Solution.export` wrote it.
        dt: Time between its points [s], as given to that; only for the advice.

    Returns:
        What was found.

    Raises:
        ProblemError: If the solution is none or has no motion, or an argument is wrong.
        ScenarioError: If the file cannot be read.
    """
    begin = time.perf_counter()
    instance(solution, Solution, "solution")
    motion = solution.trajectory
    if motion is None:
        raise ProblemError(f"there is no motion: {solution.message}", "trajectory")
    path = checked_path(path)
    judge = partial(_judged, solution, motion)
    check = _check(solution.problem, path, judge)
    if not check.violations:
        return check
    holding: list[float | None] = []
    tried: list[float | None] = []
    for step in _others(dt):
        # The check must not take longer than planning did.
        if time.perf_counter() - begin > solution.planning_time:
            break
        samples = file_samples(motion, path, step)
        tried.append(step)
        violations, _ = judge(_joined(samples, solution.problem, path).trajectory)
        if not violations:
            holding.append(step)
            if step is not None:
                break  # shorter periods hold less surprise
    return replace(
        check,
        holding=tuple(holding),
        tried=tuple(tried),
        replan=_replan(solution, path, dt),
        seconds=time.perf_counter() - begin,
    )


def _check(
    problem: Problem,
    path: str | Path,
    judge: Callable[[Trajectory], Found],
    interpolation: Interpolation | None = None,
) -> ExportCheck:
    """Read, join and judge."""
    begin = time.perf_counter()
    path = checked_path(path)
    refusals: tuple[Refusal, ...] = ()
    notes: list[str] = []
    if is_message(path):
        message = load_message(path)
        samples = message_motion(message, path)
        effort, moving = "u" in known_quantities(samples), problem.goal.ends_moving
        refusals = controller_refusals(
            message, effort_interface=effort, moving_end=moving
        )
        notes += controller_needs(samples, moving)
    else:
        samples = load_motion(path)
    joined = _joined(samples, problem, path, interpolation)
    violations, verification = judge(joined.trajectory)
    return ExportCheck(
        path,
        not (violations or refusals),
        str(joined),
        refusals,
        violations,
        verification,
        notes=tuple(notes),
        seconds=time.perf_counter() - begin,
        duration=joined.trajectory.duration,
    )


def _joined(
    samples: Samples,
    problem: Problem,
    path: Path,
    interpolation: Interpolation | None = None,
) -> Joined:
    return join(
        samples,
        problem.robot,
        path,
        start=problem.q_start,
        start_velocity=problem.v_start,
        interpolation=interpolation,
    )


def _replan(solution: Solution, path: Path, dt: float | None) -> float | None:
    """Period to plan with so that samples hold; None if there is none to name."""
    if solution.problem.robot.passive_joints:
        return None
    if dt is None:
        return USUAL if is_message(path) else None
    return None if dt == solution.options.control_period else dt


def _others(dt: float | None) -> list[float | None]:
    """Times between points to try instead of one: the nodes, then shorter periods."""
    if dt is None:
        return list(PERIODS[::-1])
    return [None, *(period for period in PERIODS if period < dt * (1.0 - 1e-9))]


def _judged(solution: Solution, planned: Trajectory, motion: Trajectory) -> Found:
    """Judge what a reader makes of a plan; by its replay if nothing simpler tells."""
    problem, known = solution.problem, solution.verification
    planned, motion = (controlled(one, problem.robot) for one in (planned, motion))
    tolerances = solution.options.tolerances
    if known is not None and known.ok and _is_planned(problem, planned, motion):
        return (), known
    # Of several segments, torques are known only when it is known where they end.
    if not problem.segments:
        times = _inner_instants(motion.t)
        state, clearly = motion(times), CLEARLY * tolerances.limits
        found = state_violations(problem, times, state.q, state.v, state.u, clearly)
        broken = tuple(item for item in found if item.violated)
        if broken:
            return broken, None
    replayed = verify(problem, motion, tolerances)
    return replayed.violations, replayed


def _is_planned(problem: Problem, planned: Trajectory, motion: Trajectory) -> bool:
    """Whether a motion is the planned one, up to rounding."""
    if abs(planned.duration - motion.duration) > SHORTEST:
        return False
    times = _inner_instants(np.union1d(planned.t, motion.t))
    ours, theirs = planned(times), motion(times)
    lower, upper = control_bounds(problem.robot, problem.motion_limits)
    span = upper - lower
    span = np.where(span > 0.0, span, max(float(np.max(span)), 1e-12))
    apart = (
        (ours.q - theirs.q) / SAME_Q,
        (ours.v - theirs.v) / SAME_V,
        (ours.u - theirs.u) / (SAME_U * span),
    )
    return all(bool(np.all(np.abs(part) <= 1.0)) for part in apart)


def _inner_instants(nodes: Array) -> Array:
    """Times within intervals, on none of their ends [s], shape (m,)."""
    h = np.diff(nodes)
    wide = h > SHORTEST
    return np.ravel(nodes[:-1][wide, None] + INSTANTS * h[wide, None])
