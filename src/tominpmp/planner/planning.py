"""Planning: choose a method and initial guesses, solve, keep the best."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from tominpmp.exceptions import OptionsError, ProblemError, expect
from tominpmp.linear_programs import make_solver
from tominpmp.options import Control, Options
from tominpmp.planner.alternatives import attempts_of_alternatives
from tominpmp.planner.attempt import Attempt
from tominpmp.planner.conclusion import conclude
from tominpmp.planner.continuation import solve_with_continuous_accelerations
from tominpmp.planner.control_period import (
    check_clock,
    on_clock,
    puts_off_replays,
    searching,
)
from tominpmp.planner.multistart import make_attempts
from tominpmp.planner.progress import Progress
from tominpmp.planner.rescue import guarded
from tominpmp.planner.smoothing import smooth
from tominpmp.problem import Problem
from tominpmp.samples import Samples
from tominpmp.solution import Solution
from tominpmp.status import STOPPED, Status
from tominpmp.stopping import Stop
from tominpmp.trajectory import Trajectory
from tominpmp.transcription.problem_functions import ProblemFunctions

logger = logging.getLogger(__name__)

# Which solver of linear programs a method takes, by measurement (docs/benchmarks.md).
LP_SOLVERS = {
    "inverse": "piqp",
    "collocation": "piqp",
    "adjoint": "highs",
    "penalty": "highs",
}


def plan(
    problem: Problem,
    options: Options | None = None,
    start: Solution | Trajectory | Samples | None = None,
    **changes: Any,
) -> Solution:
    """Plan a motion in minimum time.

    Args:
        problem: Robot, start, goal and scene.
        options: How; the defaults are sensible.
        start: A former motion of the same joints to begin with, for a problem that is
            much like its own: another goal, obstacle or limit, or a start on its way.
            It is bent to the new ends. Other guesses are made only if it leads to no
            motion, or ``options.starts`` asks for more than one.
        **changes: Options by name, as in ``plan(problem, intervals=60)``; they go
            before those of ``options``.

    Returns:
        The solution. When no motion is found, its status and message say why; on Ctrl-C
        or when the planning time is used up it holds the best motion so far.

    Raises:
        OptionsError: If an option does not fit the problem.
        ProblemError: If the goal cannot be reached at all, or the former motion is one
            of other joints.
        SolverNotFound: If the solver of linear programs is not installed.
    """
    expect(problem, Problem, "problem", "a Problem")
    options = resolve_options(problem, Options.of(options).changed(changes))
    progress = Progress(searching(options), puts_off=puts_off_replays(options))
    with progress.deadline.in_force():
        solution = _plan(problem, options, progress, start)
    if not progress.in_vain or progress.deadline.requested:
        return solution
    # The search ended with a motion whose replay was put off, and has failed since.
    again = Progress(searching(options))
    with again.deadline.in_force():
        solution = _plan(problem, options, again, start)
    return replace(solution, planning_time=progress.seconds)


def _plan(
    problem: Problem,
    options: Options,
    progress: Progress,
    start: Solution | Trajectory | Samples | None,
) -> Solution:
    """Plan, until it is time to stop; what was found by then is the solution."""
    attempts: list[Attempt] = []
    status = None
    try:
        for attempt in _attempts(problem, options, progress, start):
            attempts.append(attempt)
            status = attempt.status
            if progress.ended(status):
                break
    except (Stop, KeyboardInterrupt) as stop:
        status = progress.stopped(stop)
    if not attempts and progress.failures:
        raise progress.failures[0]
    with progress.saving():
        solution = conclude(problem, options, progress, attempts, status)
    progress.extend(options.max_planning_time)
    if options.control_period is not None:
        with progress.saving():
            solution = on_clock(solution, attempts, progress)
    if options.slack is not None and solution.success and status not in STOPPED:
        solution = smooth(solution, options.slack)
    if progress.deadline.requested:
        solution = _interrupted(solution)
    return solution.with_acceleration_remark()


def _attempts(
    problem: Problem,
    options: Options,
    progress: Progress,
    start: Solution | Trajectory | Samples | None,
) -> Iterator[Attempt]:
    """One attempt after the other."""
    former = None if start is None else motion_of(start)
    if former is not None and problem.segments:
        raise ProblemError(
            "start: a motion of several segments does not begin with a former one",
            "start",
        )
    make = partial(make_attempts, options=options, progress=progress)
    attempts: list[Attempt] = []
    for attempt in attempts_of_alternatives(problem, make, progress, former):
        logger.info("start %d: %s", progress.start, attempt.status.value)
        attempts.append(attempt)
        yield attempt
        if options.objective == "feasible" and attempt.found:
            return
    yield from continued(problem, options, progress, attempts)


def _interrupted(solution: Solution) -> Solution:
    """A solution at the end of a planning that was interrupted."""
    if solution.status is Status.INTERRUPTED:
        return solution
    message = solution.message
    if solution.success:
        message = f"{Status.INTERRUPTED.value} {message}"
    return replace(solution, status=Status.INTERRUPTED, message=message)


def continued(
    problem: Problem, options: Options, progress: Progress, attempts: Sequence[Attempt]
) -> Iterator[Attempt]:
    """Go on with continuous accelerations, if that is free.

    From the fastest motion, and from all that were the fastest when they were found:
    fewer starts would have gone on from one of them, and might have come farther.
    """
    if options.control != "auto" or problem.segments:
        return
    records: list[Attempt] = []
    for attempt in attempts:
        if attempt.duration < min((a.duration for a in records), default=np.inf):
            records.append(attempt)
    for former in reversed(records):
        if options.refine == "switching" and not former.remark:
            continue  # its torques switch exactly: there is nothing left to gain
        system = ProblemFunctions.of(problem.alternative_of(former.trajectory))
        progress.share(1)
        progress.begin()
        solve = partial(
            solve_with_continuous_accelerations, system, options, former, progress
        )
        faster = guarded(problem, options, progress, former.name, solve)
        if faster is not None and faster.duration < former.duration:
            yield replace(faster, remark=f"{former.remark} {faster.remark}".strip())
        progress.deadline.check()


def motion_of(start: Solution | Trajectory | Samples) -> Trajectory | Samples:
    """Motion to begin with.

    Raises:
        ProblemError: If the solution has none.
    """
    if not isinstance(start, Solution):
        return start
    if start.trajectory is None:
        raise ProblemError(f"start: there is no motion in it: {start.message}", "start")
    return start.trajectory


def resolve_options(problem: Problem, options: Options) -> Options:
    """Replace "auto" and None by what fits the problem.

    Raises:
        OptionsError: If an option does not fit the problem.
    """
    robot = problem.robot
    method = options.method
    check_clock(problem, options)
    check_segments(problem, options)
    if method == "auto":
        method = "collocation" if robot.passive_joints else "inverse"
    if method == "inverse" and robot.passive_joints:
        raise OptionsError(
            "method 'inverse' needs a motor at every joint, and "
            f"{', '.join(robot.passive_joints)} has none; take 'collocation'",
            "method",
        )
    control = resolve_control(problem, options, method)
    lp_solver = options.lp_solver
    if lp_solver == "auto":
        lp_solver = LP_SOLVERS[method]
    make_solver(lp_solver)
    torque = options.initial_control
    if torque is not None and torque.shape not in (
        (robot.n,),
        (options.intervals, robot.n),
    ):
        raise OptionsError(
            f"initial_control has shape {torque.shape}, expected ({robot.n},) or "
            f"({options.intervals}, {robot.n}) for {options.intervals} intervals",
            "initial_control",
        )
    return replace(options, method=method, lp_solver=lp_solver, control=control)


def check_segments(problem: Problem, options: Options) -> None:
    """Refuse options that are not for motions of several segments.

    Raises:
        OptionsError: If there is one.
    """
    if not problem.segments:
        return
    known = {
        "method": ("auto", "inverse"),
        "refine": (None,),
        "slack": (None,),
        "control_period": (None,),
    }
    for name, allowed in known.items():
        value = getattr(options, name)
        if value not in allowed:
            raise OptionsError(
                f"{name} is {value!r}, and the problem has several segments: expected "
                f"{' or '.join(map(repr, allowed))}",
                name,
            )


def resolve_control(problem: Problem, options: Options, method: str) -> Control:
    """Control parameterisation that fits the problem and the method.

    Raises:
        OptionsError: If there is none.
    """
    limits, control = problem.motion_limits, options.control
    smooth = limits is not None and limits.need_smooth
    if method != "inverse" and (smooth or control not in ("auto", "constant")):
        raise OptionsError(
            f"method {method!r} knows piecewise constant torques only: motion limits "
            "and controls 'linear' and 'spline' need method 'inverse'",
            "control",
        )
    if control == "constant" and smooth:
        raise OptionsError(
            "control is 'constant', and the motion limits of the problem need "
            "continuous accelerations: expected 'linear', 'spline' or 'auto'",
            "control",
        )
    if control != "auto":
        return control
    if smooth:
        return "linear"
    # Left to choose, "constant" and then "linear" where that is faster.
    return "auto" if options.method == "auto" and method == "inverse" else "constant"
