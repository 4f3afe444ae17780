"""Checks of exported motions, interpolated as their readers will interpolate them.

A file holds some points of a motion, each reader interpolates them in its own way, and
the arm follows the result. So a file from any source is read, interpolated as its
reader does, and verified like a plan. If the file of a plan fails, other sampling
periods are tried, so that the message can recommend one that passes.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np

from tominpmp.arrays import Array, MaybeNone
from tominpmp.blas_threads import on_one_thread
from tominpmp.checks import instance
from tominpmp.description.paths import checked_path
from tominpmp.exceptions import enumerated
from tominpmp.files.export import file_samples, is_message, read_motion
from tominpmp.files.ros import Refusal, controller_refusals
from tominpmp.files.tables import known_quantities
from tominpmp.motion.joining import Joined, join, with_controls
from tominpmp.motion.samples import Interpolation, Samples
from tominpmp.motion.trajectory import Trajectory
from tominpmp.options import LONGEST_PERIOD, Tolerances
from tominpmp.problem.joint_limits import joint_limits
from tominpmp.problem.problem import Problem
from tominpmp.solution import Solution
from tominpmp.verification.limit_violations import LimitViolation, planned_violations
from tominpmp.verification.verification import Verification, verify

# Usual periods of controllers [s], the longest first.
PERIODS = (0.01, 0.008, 0.004, 0.002, 0.001)
# Controller period to recommend where no period is known [s].
DEFAULT_PERIOD = 0.004
# Instants at which each interval is examined, as shares of it: also near the ends,
# where overshooting polynomials are fastest.
INSTANTS = np.array([0.0005, 0.1, 0.3, 0.5, 0.7, 0.9, 0.9995])
# Multiple of the tolerance beyond which an excess is evident without a replay.
EVIDENT = 2.0
# Intervals shorter than this are rounding of times [s].
MIN_INTERVAL = 1e-7
# Two curves count as equal up to these differences, in positions [rad or m], velocities
# [rad/s or m/s] and torques, the last relative to half of their range.
SAME_Q, SAME_V, SAME_U = 1e-7, 1e-5, 4e-4


@dataclass(frozen=True, eq=False)
class ExportCheck:
    """Result of checking a file.

    Attributes:
        path: The file.
        ok: Whether the motion that its reader makes of it solves the problem, and a
            controller accepts it.
        joined: Interpolation of its reader, in words.
        refusals: Rules of the joint trajectory controller that it breaks, for messages
            of ROS.
        violations: Limits that it breaks, and the goal if it misses it.
        verification: Its replay; None if the points alone showed that it breaks limits.
        holding: Sampling periods that would pass [s], among those that were tried; None
            stands for the nodes of the motion.
        tried: Sampling periods that were tried [s].
        replan: Control period to plan with for a motion whose samples pass [s]; None
            without a recommendation.
        notes: Further remarks, in sentences.
        seconds: Time taken [s].
        duration: Duration of the motion that its reader makes of it [s].
    """

    path: Path
    ok: bool
    joined: str
    refusals: tuple[Refusal, ...]
    violations: tuple[LimitViolation, ...]
    verification: MaybeNone = field(repr=False)
    holding: tuple[float | None, ...] = ()
    tried: tuple[float | None, ...] = ()
    replan: float | None = None
    notes: tuple[str, ...] = ()
    seconds: float = 0.0
    duration: float = math.nan

    def __bool__(self) -> bool:
        """Whether the file passes."""
        return self.ok

    @property
    def message(self) -> str:
        """Whether the file passes; if not, its faults and the remedies."""
        if self.ok:
            return f"{self.path} passes, interpolated by {self.joined}."
        parts = [f"{self.path} does not pass, interpolated by {self.joined}"]
        if self.violations:
            worst = sorted(self.violations, key=lambda item: -item.share)
            parts.append(enumerated(worst))
        if self.refusals:
            parts.append(f"a controller would refuse it: {enumerated(self.refusals)}")
        return ": ".join(parts) + "." + self._advice()

    def _advice(self) -> str:
        """Sampling periods that would pass, among those tried, and other remedies."""
        parts = []
        if self.holding:
            parts.append(f"What passes: {_listed(self.holding)}.")
        elif self.tried:
            parts.append(f"Nor do these pass: {_listed(self.tried)}.")
        if self.replan is not None:
            parts.append(
                f"A motion for samples of {self.replan:g} s is planned with the option "
                f"control_period = {self.replan:g}."
            )
        return "".join(f" {part}" for part in parts)


def _listed(steps: tuple[float | None, ...]) -> str:
    return ", ".join(
        "the nodes of the motion (without dt)" if step is None else f"dt = {step:g} s"
        for step in steps
    )


# Result of a verification: the violated limits, and the replay if there was one.
Judgement = tuple[tuple[LimitViolation, ...], Verification | None]


def check_file(
    problem: Problem,
    path: str | Path,
    *,
    tolerances: Tolerances | None = None,
    interpolation: Interpolation | None = None,
) -> ExportCheck:
    """Read a motion from a file of any origin, and verify it as its reader executes it.

    Args:
        problem: The problem that the motion is to solve.
        path: The file, see :func:`~tominpmp.files.export.load_motion`.
        tolerances: Tolerances of the replay; None for the defaults.
        interpolation: How the points are interpolated; None for the default of the kind
            of file.

    Returns:
        The result, with the replay.

    Raises:
        ProblemError: If an argument is wrong.
        ScenarioError: If the file cannot be read, or belongs to another robot.
    """
    instance(problem, Problem, "problem")
    instance(tolerances, (Tolerances, type(None)), "tolerances", "Tolerances or None")

    def judge(motion: Trajectory) -> Judgement:
        replay = verify(problem, motion, tolerances)
        return replay.violations, replay

    return _check(problem, checked_path(path), judge, interpolation)


@on_one_thread
def check_export(
    solution: Solution, path: str | Path, *, dt: float | None = None
) -> ExportCheck:
    """Read the exported file of a solution, and verify it as its reader executes it.

    Args:
        solution: The solution.
        path: The file, as :meth:`Solution.export` wrote it.
        dt: Time between its points [s], as passed to the export; for the advice only.

    Returns:
        The result.

    Raises:
        ProblemError: If the first argument is not a solution or has no motion, or an
            argument is wrong.
        ScenarioError: If the file cannot be read.
    """
    begin = time.perf_counter()
    instance(solution, Solution, "solution")
    motion = solution._motion()
    path, dt = checked_path(path), solution._step_of_rows(dt)
    judge = partial(_verified, solution, motion)
    check = _check(solution.problem, path, judge)
    if not check.violations:
        return check
    holding, tried = list[float | None](), list[float | None]()
    for step in _alternative_steps(dt):
        # The check must not take longer than planning took.
        if time.perf_counter() - begin > solution.planning_time:
            break
        samples = file_samples(motion, path, step)
        tried.append(step)
        as_read = joined_samples(samples, solution.problem, path).trajectory
        if not judge(as_read)[0]:
            holding.append(step)
            if step is not None:
                break  # one period that passes is enough advice
    return replace(
        check,
        holding=tuple(holding),
        tried=tuple(tried),
        replan=_replan(solution, path, dt),
        seconds=time.perf_counter() - begin,
    )


@np.errstate(all="ignore")  # numbers of a stranger's file may overflow
def _check(
    problem: Problem,
    path: Path,
    judge: Callable[[Trajectory], Judgement],
    interpolation: Interpolation | None = None,
) -> ExportCheck:
    """Read a file, interpolate its points, and verify the motion."""
    begin = time.perf_counter()
    refusals: tuple[Refusal, ...] = ()
    samples, message = read_motion(path, interpolation)
    notes: dict[str, bool] = {}
    if message is not None:
        effort, moving = "u" in known_quantities(samples), problem.goal.ends_moving
        refusals = controller_refusals(
            message, effort_interface=effort, moving_end=moving
        )
        notes = {
            "The points have efforts: only controllers that command efforts take "
            "them.": effort,
            "The motion ends in motion: the controller needs "
            "allow_nonzero_velocity_at_trajectory_end.": moving,
        }
    joined = joined_samples(samples, problem, path)
    violations, verification = judge(joined.trajectory)
    return ExportCheck(
        path,
        not (violations or refusals),
        str(joined),
        refusals,
        violations,
        verification,
        notes=tuple(note for note, applies in notes.items() if applies),
        seconds=time.perf_counter() - begin,
        duration=joined.trajectory.duration,
    )


def joined_samples(samples: Samples, problem: Problem, path: Path) -> Joined:
    """The motion that the reader of a file makes of its samples for a problem."""
    return join(samples, problem.robot, path, (problem.q_start, problem.v_start))


def _replan(solution: Solution, path: Path, dt: float | None) -> float | None:
    """Control period to plan with so that samples pass; None if there is no advice."""
    if solution.problem.robot.passive_joints:
        return None
    if dt is None:
        return DEFAULT_PERIOD if is_message(path) else None
    known = dt == solution.options.control_period
    return None if known or dt > LONGEST_PERIOD else dt


def _alternative_steps(dt: float | None) -> list[float | None]:
    """Sampling periods to try in place of one: the nodes, then shorter periods."""
    if dt is None:
        return list(PERIODS[::-1])
    return [None, *(period for period in PERIODS if period < dt * (1.0 - 1e-9))]


def _verified(solution: Solution, planned: Trajectory, motion: Trajectory) -> Judgement:
    """Verify a reader's version of a plan; replay it only if in doubt."""
    problem, known = solution.problem, solution.verification
    planned, motion = (with_controls(each, problem.robot) for each in (planned, motion))
    tolerances = solution.options.tolerances
    limits: list[LimitViolation] = []
    # With several segments, torques depend on the segment ends, which a file may lack.
    if not problem.segments:
        limits = planned_violations(problem, motion, tolerances.limits)
    evident = [item for item in limits if item.share > EVIDENT * tolerances.limits]
    if evident:
        return tuple(evident), None
    # Motions of the same states may differ in their jerks and torque rates.
    within = not any(item.violated for item in limits)
    if known and within and _is_planned(problem, planned, motion):
        return (), known
    replayed = verify(problem, motion, tolerances)
    return replayed.violations, replayed


def _is_planned(problem: Problem, planned: Trajectory, motion: Trajectory) -> bool:
    """Whether a motion equals the planned one up to rounding."""
    if abs(planned.duration - motion.duration) > MIN_INTERVAL:
        return False
    times = _inner_instants(np.union1d(planned.t, motion.t))
    expected, actual = planned(times), motion(times)
    _, _, control, *_ = joint_limits(problem.robot, problem.motion_limits)
    same = {"q": SAME_Q, "v": SAME_V, "u": SAME_U * control.scale}
    apart = {k: np.abs(getattr(expected, k) - getattr(actual, k)) for k in same}
    return all(bool(np.all(apart[k] <= most)) for k, most in same.items())


def _inner_instants(nodes: Array) -> Array:
    """Times inside the intervals, away from their ends [s], shape (m,)."""
    h = np.diff(nodes)
    wide = h > MIN_INTERVAL
    return np.ravel(nodes[:-1][wide, None] + INSTANTS * h[wide, None])
