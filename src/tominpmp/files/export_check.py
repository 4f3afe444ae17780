"""Checks of exported motions, interpolated as their readers will interpolate them.

A file holds some points of a motion, each reader interpolates them in its own way, and
the arm follows the result. So a file from any source is read, interpolated as its
reader does, and verified like a plan. If the file of a plan fails, other sampling
periods are tried, so that the message can recommend one that passes.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from tominpmp.blas_threads import on_one_thread
from tominpmp.checks import instance
from tominpmp.description.paths import checked_path
from tominpmp.exceptions import enumerated
from tominpmp.files.export import file_samples, is_message, read_motion
from tominpmp.files.ros import Refusal, controller_refusals
from tominpmp.files.tables import known_quantities
from tominpmp.motion.joining import Joined, join
from tominpmp.motion.samples import Interpolation, Samples
from tominpmp.options import LONGEST_PERIOD, Tolerances
from tominpmp.problem.problem import Problem
from tominpmp.solution import Solution
from tominpmp.verification.limit_violations import LimitViolation
from tominpmp.verification.verification import Verification, verify

# Usual periods of controllers [s], the longest first.
PERIODS = (0.01, 0.008, 0.004, 0.002, 0.001)
# Controller period to recommend where no period is known [s].
DEFAULT_PERIOD = 0.004


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
        verification: Its replay.
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
    verification: Verification = field(repr=False)
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


@np.errstate(all="ignore")  # numbers of a caller's file may overflow
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
    begin = time.perf_counter()
    instance(problem, Problem, "problem")
    instance(tolerances, (Tolerances, type(None)), "tolerances", "Tolerances or None")
    path = checked_path(path)
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
    replay = verify(problem, joined.trajectory, tolerances)
    return ExportCheck(
        path,
        not (replay.violations or refusals),
        str(joined),
        refusals,
        replay.violations,
        replay,
        notes=tuple(note for note, applies in notes.items() if applies),
        seconds=time.perf_counter() - begin,
        duration=joined.trajectory.duration,
    )


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
    instance(solution, Solution, "solution")
    motion = solution._motion()
    path, dt = checked_path(path), solution._step_of_rows(dt)
    problem, tolerances = solution.problem, solution.options.tolerances
    check = check_file(problem, path, tolerances=tolerances)
    if not check.violations:
        return check
    holding, tried = list[float | None](), list[float | None]()
    begin = time.perf_counter()
    for step in _alternative_steps(dt):
        # The advice must not take longer than planning took.
        if time.perf_counter() - begin > solution.planning_time:
            break
        samples = file_samples(motion, path, step)
        tried.append(step)
        as_read = joined_samples(samples, problem, path).trajectory
        if not verify(problem, as_read, tolerances).violations:
            holding.append(step)
            if step is not None:
                break  # one period that passes is enough advice
    return replace(
        check,
        holding=tuple(holding),
        tried=tuple(tried),
        replan=_replan(solution, path, dt),
        seconds=check.seconds + time.perf_counter() - begin,
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
