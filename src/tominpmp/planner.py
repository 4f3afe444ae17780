"""Planning: choose a method and initial guesses, solve, keep the best."""

from __future__ import annotations

import itertools
import logging
from collections.abc import Generator, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from tominpmp.alternatives import attempts_of_alternatives
from tominpmp.attempts import (
    STOPPED,
    Attempt,
    Watch,
    check_clock,
    on_clock,
    searching,
    shots,
    solve_alone,
    solve_and_verify,
    solve_from_former,
    solve_with_continuous_accelerations,
)
from tominpmp.exceptions import OptionsError, ProblemError, expect
from tominpmp.goals import FrameGoal, PlaceGoal
from tominpmp.linear_programs import make_solver
from tominpmp.options import Control, Options
from tominpmp.problem import Problem
from tominpmp.seeding.guess import KINEMATIC_STARTS, Guess, initial_guesses
from tominpmp.seeding.inverse_kinematics import goal_configurations
from tominpmp.seeding.parallel import run_parallel
from tominpmp.seeding.passing import guesses_among_moving
from tominpmp.seeding.warm import FormerMotion
from tominpmp.smoothing import smooth
from tominpmp.solution import Solution, Status
from tominpmp.trajectory import Samples, Trajectory
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
# Guesses where obstacles move, which may be let pass or be passed, and those that are
# made while none has led to a motion.
MOVING_STARTS = 3
MOVING_RESCUE_STARTS = 16
# A timed guess this much slower than a motion that was found is not worth its time.
HOPELESS = 1.6
# Torques are the last guess for arms with so many joints, and how they are improved.
SWINGERS, SWINGERS_RESCUE_STARTS = 3, 2
SHOOTING: dict[str, Any] = dict(method="adjoint", control="constant", lp_solver="highs")
# A lower bound is mentioned if T is within this factor of it.
TELLING = 2.0
# More guesses are made, up to this number, while none has led to a motion.
RESCUE_STARTS = 8


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
    watch = Watch(searching(options))
    former = None if start is None else motion_of(start)
    make = partial(make_attempts, options=options, watch=watch)
    attempts: list[Attempt] = []
    any_will_do = options.objective == "feasible"
    status = None
    try:
        for attempt in attempts_of_alternatives(problem, make, watch, former):
            attempts.append(attempt)
            status = attempt.status
            logger.info("start %d: %s", watch.start, status.value)
            if watch.ended(status) or (any_will_do and attempt.found):
                break
        else:
            attempts.extend(continued(problem, options, watch, attempts))
    except KeyboardInterrupt:
        status = Status.INTERRUPTED
    solution = conclude(problem, options, watch, attempts, status)
    solution = on_clock(solution, attempts, watch)
    if options.slack is not None and solution.success and status not in STOPPED:
        solution = smooth(solution, options.slack)
    return solution.with_acceleration_remark()


def continued(
    problem: Problem, options: Options, watch: Watch, attempts: Sequence[Attempt]
) -> Iterator[Attempt]:
    """Go on from the fastest motion with continuous accelerations, if that is free."""
    if options.control != "auto" or watch.best == np.inf:
        return
    fastest = min(attempts, key=lambda attempt: attempt.duration)
    if options.refine == "switching" and not fastest.remark:
        return  # its torques switch exactly: there is nothing left to gain
    q, v = fastest.trajectory.q[-1], fastest.trajectory.v[-1]
    system = System.of(problem.alternative_at(q, v))
    watch.share(1)
    faster = solve_with_continuous_accelerations(system, options, fastest, watch)
    if faster is not None:
        yield replace(faster, remark=fastest.remark)


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


def make_attempts(
    system: System, former: FormerMotion | None, options: Options, watch: Watch
) -> Iterator[Attempt]:
    """Solve from one initial guess after the other, a former motion being the first."""
    if former is not None:
        watch.begin()
        attempt = solve_from_former(system, options, former, watch)
        watch.best = min(watch.best, attempt.duration)
        yield attempt
        if attempt.found and (options.starts or 1) == 1:
            return
    if options.method in ("adjoint", "penalty"):
        yield from shots(system, options, watch)
        return
    rng = np.random.default_rng(options.seed)
    moving = bool(system.problem.scene.moving)
    wanted = options.starts
    if wanted is None:
        several = system.joint_goal is None and options.objective == "time"
        wanted = FRAME_STARTS if several else 1
        if moving and options.objective == "time":
            wanted = max(wanted, MOVING_STARTS)
    swings = options.starts is None and may_swing(system)
    rescues = SWINGERS_RESCUE_STARTS if swings else RESCUE_STARTS
    count = max(wanted, MOVING_RESCUE_STARTS if moving else rescues)
    make = guesses_among_moving if moving else initial_guesses
    guesses = make(system, count, rng, options.initial_duration, watch.deadline)
    if options.processes > 1:
        any_made = yield from _in_processes(system, options, watch, guesses, wanted)
    else:
        any_made = yield from _in_turn(system, options, watch, guesses, wanted)
    if not any_made:
        raise unreachable(system, rng)
    if swings and watch.best == np.inf:
        yield from shots(system, replace(options, **SHOOTING), watch)


def may_swing(system: System) -> bool:
    """Whether torques from nowhere may lead where no path does.

    With nothing in the way it is the torques that are too small for guesses of a path:
    a small arm may have to swing.
    """
    smooth = system.problem.motion_limits is not None
    return system.alone and system.n <= SWINGERS and not smooth


def _in_turn(
    system: System,
    options: Options,
    watch: Watch,
    guesses: Iterator[Guess],
    wanted: int,
) -> Generator[Attempt, None, bool]:
    """Try one guess after the other; returns whether there were any."""
    tried, any_made = 0, False
    # No guess is made, which may take a search, before it is known to be wanted.
    while tried < wanted or (options.starts is None and watch.best == np.inf):
        guess = next(guesses, None)
        if guess is None:
            break
        any_made = True
        if guess.timed and guess.duration > HOPELESS * watch.best:
            wanted -= 1
            continue
        tried += 1
        watch.begin()
        attempt = solve_and_verify(system, options, guess, watch)
        watch.best = min(watch.best, attempt.duration)
        yield attempt
    return any_made


def _in_processes(
    system: System,
    options: Options,
    watch: Watch,
    guesses: Iterator[Guess],
    wanted: int,
) -> Generator[Attempt, None, bool]:
    """Try several guesses at a time; returns whether there were any."""
    any_made = False
    while not any_made or (options.starts is None and watch.best == np.inf):
        share = list(
            itertools.islice(guesses, options.processes if any_made else wanted)
        )
        if not share:
            break
        any_made = True
        left = watch.left
        alone = replace(options, callback=None, processes=1, max_planning_time=left)
        task = partial(solve_alone, system, alone)
        first = watch.begin(len(share))
        for number, attempt in run_parallel(task, share, options.processes, left):
            watch.best = min(watch.best, attempt.duration)
            watch.start = first + number
            status = watch.replay(attempt.history)
            yield replace(attempt, status=status or attempt.status)
    return any_made


def unreachable(system: System, rng: np.random.Generator) -> ProblemError:
    """Error for a goal that no configuration was found to reach."""
    goal = system.problem.goal
    assert isinstance(goal, PlaceGoal)  # noqa: S101
    _, least = goal_configurations(system, goal, 2 * KINEMATIC_STARTS, rng)
    what = (
        f"brings frame {goal.frame!r} there"
        if isinstance(goal, FrameGoal)
        else ("reaches it")
    )
    return ProblemError(
        f"goal: no configuration within the position limits {what}; the nearest one "
        f"found misses it by {least:.4g} (m, rad)",
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
        if bound.T * TELLING > T:
            above = 100 * (T / bound.T - 1)
            sentence = f"{sentence}, {above:.1f} % above what none can beat"
        return f"{sentence}. {best.remark}".rstrip()
    if best.feasible and best.verification is not None:
        return f"{status.value} {best.verification.message}"
    return explain(problem, attempts, status)
