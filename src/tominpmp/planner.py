"""Planning: choose a method and initial guesses, solve, keep the best."""

from __future__ import annotations

import itertools
import logging
from collections.abc import Generator, Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from tominpmp.attempts import (
    STOPPED,
    Attempt,
    Watch,
    solve_alone,
    solve_and_verify,
    solve_by_shooting,
)
from tominpmp.exceptions import OptionsError, ProblemError
from tominpmp.goals import FrameGoal
from tominpmp.options import Control, Options
from tominpmp.problem import Problem
from tominpmp.seeding.guess import KINEMATIC_STARTS, Guess, initial_guesses
from tominpmp.seeding.inverse_kinematics import goal_configurations
from tominpmp.seeding.parallel import run_parallel
from tominpmp.solution import Solution, Status
from tominpmp.solvers.lp import make_solver
from tominpmp.transcription.system import System
from tominpmp.verification import LowerBound, explain, lower_bound

logger = logging.getLogger(__name__)

# Which solver of linear programs a method takes, by measurement (docs/benchmarks.md).
LP_SOLVERS = {
    "inverse": "piqp",
    "collocation": "piqp",
    "adjoint": "highs",
    "penalty": "highs",
}
# Guesses for a goal on a frame, whose final configuration is free.
FRAME_STARTS = 4
# A timed guess this much slower than a motion that was found is not worth its time.
HOPELESS = 1.6
# A lower bound is mentioned if T is within this factor of it.
TELLING = 2.0
# More guesses are made, up to this number, while none has led to a motion.
RESCUE_STARTS = 8


def plan(problem: Problem, options: Options | None = None) -> Solution:
    """Plan a motion in minimum time.

    Args:
        problem: Robot, start, goal and scene.
        options: How; the defaults are sensible.

    Returns:
        The solution. When no motion is found, its status and message say why; on Ctrl-C
        or when the planning time is used up it holds the best motion so far.

    Raises:
        OptionsError: If an option does not fit the problem.
        ProblemError: If the goal cannot be reached at all.
        SolverNotFound: If the solver of linear programs is not installed.
    """
    options = resolve_options(problem, options or Options())
    watch = Watch(options)
    system = System.of(problem)
    attempts: list[Attempt] = []
    status = None
    try:
        for attempt in make_attempts(system, options, watch):
            attempts.append(attempt)
            status = attempt.status
            logger.info("start %d: %s", watch.start, status.value)
            if status in STOPPED:
                break
    except KeyboardInterrupt:
        status = Status.INTERRUPTED
    return conclude(problem, options, watch, attempts, status)


def resolve_options(problem: Problem, options: Options) -> Options:
    """Replace "auto" and None by what fits the problem.

    Raises:
        OptionsError: If an option does not fit the problem.
    """
    robot = problem.robot
    method = options.method
    if method == "auto":
        method = "collocation" if robot.passive_joints else "inverse"
    if method == "inverse" and robot.passive_joints:
        raise OptionsError(
            "method 'inverse' needs a motor at every joint, and "
            f"{', '.join(robot.passive_joints)} has none; take 'collocation'",
            "method",
        )
    control = resolve_control(problem, options.control, method)
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


def resolve_control(problem: Problem, control: Control, method: str) -> Control:
    """Control parameterisation that fits the problem and the method.

    Raises:
        OptionsError: If there is none.
    """
    limits = problem.motion_limits
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
    if control == "auto":
        return "linear" if smooth else "constant"
    return control


def make_attempts(system: System, options: Options, watch: Watch) -> Iterator[Attempt]:
    """Solve from one initial guess after the other."""
    if options.method in ("adjoint", "penalty"):
        yield solve_by_shooting(system, options, watch)
        return
    rng = np.random.default_rng(options.seed)
    wanted = options.starts
    if wanted is None:
        wanted = 1 if system.joint_goal is not None else FRAME_STARTS
    count = max(wanted, RESCUE_STARTS)
    guesses = initial_guesses(
        system, count, rng, options.initial_duration, watch.deadline
    )
    if options.processes > 1:
        tried = yield from _in_processes(system, options, watch, guesses, wanted)
    else:
        tried = yield from _in_turn(system, options, watch, guesses, wanted)
    if not tried:
        raise unreachable(system, rng)


def _in_turn(
    system: System,
    options: Options,
    watch: Watch,
    guesses: Iterator[Guess],
    wanted: int,
) -> Generator[Attempt, None, int]:
    """Try one guess after the other; returns how many there were."""
    best, tried = np.inf, 0
    # No guess is made, which may take a search, before it is known to be wanted.
    while tried < wanted or (options.starts is None and best == np.inf):
        guess = next(guesses, None)
        if guess is None:
            break
        if tried >= 1 and guess.timed and guess.duration > HOPELESS * best:
            wanted -= 1
            continue
        watch.start = tried
        tried += 1
        attempt = solve_and_verify(system, options, guess, watch)
        best = min(best, attempt.duration)
        yield attempt
    return tried


def _in_processes(
    system: System,
    options: Options,
    watch: Watch,
    guesses: Iterator[Guess],
    wanted: int,
) -> Generator[Attempt, None, int]:
    """Try several guesses at a time; returns how many there were."""
    found, tried = False, 0
    while tried == 0 or (options.starts is None and not found):
        share = list(
            itertools.islice(guesses, wanted if not tried else options.processes)
        )
        if not share:
            break
        left = watch.left
        alone = replace(options, callback=None, processes=1, max_planning_time=left)
        task = partial(solve_alone, system, alone)
        for number, attempt in run_parallel(task, share, options.processes, left):
            found = found or attempt.found
            watch.start = tried + number
            status = watch.replay(attempt.history)
            yield replace(attempt, status=status or attempt.status)
        tried += len(share)
    return tried


def unreachable(system: System, rng: np.random.Generator) -> ProblemError:
    """Error for a goal that no configuration was found to reach."""
    goal = system.problem.goal
    assert isinstance(goal, FrameGoal)  # noqa: S101
    _, least = goal_configurations(system, goal, 2 * KINEMATIC_STARTS, rng)
    return ProblemError(
        f"goal: no configuration within the position limits brings frame "
        f"{goal.frame!r} there; the nearest one found misses it by {least:.4g} "
        "(m, rad)",
        "goal",
    )


def conclude(
    problem: Problem,
    options: Options,
    watch: Watch,
    attempts: list[Attempt],
    status: Status | None,
) -> Solution:
    """Turn the best attempt into a solution."""
    history = tuple(
        replace(record, start=number)
        for number, attempt in enumerate(attempts)
        for record in attempt.history
    )
    if not attempts:
        ended = status or Status.INFEASIBLE
        return Solution(
            problem,
            options,
            ended,
            ended.value,
            False,
            None,
            planning_time=watch.seconds,
        )
    best = min(attempts, key=lambda a: (a.duration, not a.feasible, a.violation))
    ended = best.status
    if status in STOPPED:
        ended = status
    if best.feasible and not best.found:
        ended = Status.UNVERIFIED
    elif ended is Status.CONVERGED and not best.feasible:
        ended = Status.INFEASIBLE
    bound = lower_bound(problem)
    return Solution(
        problem=problem,
        options=options,
        status=ended,
        message=_message(problem, ended, best, attempts, bound),
        feasible=best.found,
        trajectory=best.trajectory,
        initial=best.initial,
        history=history,
        planning_time=watch.seconds,
        violations=best.violations,
        verification=best.verification,
        lower_bound=bound,
    )


def _message(
    problem: Problem,
    status: Status,
    best: Attempt,
    attempts: list[Attempt],
    bound: LowerBound,
) -> str:
    if best.found:
        T = best.trajectory.duration
        sentence = f"{status.value} T = {T:.4f} s"
        if not bound.T * TELLING > T:
            return f"{sentence}."
        return f"{sentence}, {100 * (T / bound.T - 1):.1f} % above what none can beat."
    if best.feasible and best.verification is not None:
        return f"{status.value} {best.verification.message}"
    return explain(problem, attempts, status)
