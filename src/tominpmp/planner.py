"""Planning: choose a method and initial guesses, solve, keep the best."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from tominpmp.arrays import Array
from tominpmp.exceptions import OptionsError, ProblemError
from tominpmp.goals import FrameGoal
from tominpmp.options import Options
from tominpmp.problem import Problem
from tominpmp.seeding.guess import KINEMATIC_STARTS, Guess, initial_guesses
from tominpmp.seeding.inverse_kinematics import goal_configurations
from tominpmp.solution import IterationRecord, Solution, Status
from tominpmp.solvers.iterate import SlpResult
from tominpmp.solvers.lp import make_solver
from tominpmp.solvers.paper import PaperSolver
from tominpmp.solvers.penalty import PenaltySolver
from tominpmp.solvers.slp import SlpSolver
from tominpmp.transcription.adjoint import AdjointTranscription, Instants
from tominpmp.transcription.base import Transcription
from tominpmp.transcription.collocation import CollocationTranscription
from tominpmp.transcription.grid import interval_shares
from tominpmp.transcription.inverse import InverseTranscription
from tominpmp.transcription.system import System

logger = logging.getLogger(__name__)

# Weight of the total variation, as a share of the duration of the guess; chosen on
# benchmarks/random_goals.py: it costs less than 0.1 % of T and halves the iterations.
SMOOTHING_SHARE = 1e-4
# Which solver of linear programs a method takes, by measurement (docs/benchmarks.md).
LP_SOLVERS = {
    "inverse": "piqp",
    "collocation": "piqp",
    "adjoint": "highs",
    "penalty": "highs",
}
# Relative torque excess between the rows that is let pass, and rounds of adding rows.
OVERLOAD = 2e-3
EXCHANGES = 4
# Missing clearance between the rows that is let pass, as a share of the reach.
GRAZE = 1e-5
EXCHANGE_ITERATIONS = 25
# Which instants of path constraints the methods that shoot differentiate.
INSTANTS: dict[str, Instants] = {
    "paper": "exact",
    "adjoint": "near",
    "penalty": "violated",
}
# Duration that shooting begins with: the paper's T^0 [s].
FIRST_DURATION = 1.5
# How a solver ends when it was told to.
STOPPED = (Status.TIME_LIMIT, Status.INTERRUPTED)
# Guesses for a goal on a frame, whose final configuration is free.
FRAME_STARTS = 4
# More guesses are made, up to this number, while none has led to a motion.
RESCUE_STARTS = 8
# A timed guess lies on the limits; the grid rounds it. This much slower it is nearly
# admissible.
GUESS_STRETCH = 1.02


class Watch:
    """Time limit, callback and interruption of a planning, as a monitor of solvers.

    Attributes:
        start: Number of the initial guess that is worked on.
    """

    def __init__(self, options: Options) -> None:
        self.start = 0
        self._begin = time.perf_counter()
        self._limit = options.max_planning_time
        self._callback = options.callback

    @property
    def seconds(self) -> float:
        """Time since planning began [s]."""
        return time.perf_counter() - self._begin

    @property
    def over(self) -> bool:
        """Whether the planning time is used up."""
        return self._limit is not None and self.seconds >= self._limit

    def __call__(self, record: IterationRecord) -> Status | None:
        """See a record; a status ends the iteration."""
        record = replace(record, start=self.start, seconds=self.seconds)
        if self._callback is not None and self._callback(record):
            return Status.INTERRUPTED
        return Status.TIME_LIMIT if self.over else None


@dataclass(frozen=True, eq=False)
class Attempt:
    """What one initial guess led to.

    Attributes:
        transcription: The transcription that was solved.
        start: The iterate it began with.
        result: The outcome.
    """

    transcription: Transcription
    start: Array
    result: SlpResult

    @property
    def duration(self) -> float:
        """T of the best motion that keeps all constraints [s]; infinite without one."""
        best = self.result.best
        return np.inf if best is None else best.duration


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
            status = attempt.result.status
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
    if options.processes > 1:
        raise OptionsError(
            f"processes is {options.processes}, and starts are not yet spread over "
            "several processes: expected 1",
            "processes",
        )
    lp_solver = options.lp_solver
    if lp_solver == "auto":
        lp_solver = LP_SOLVERS[method]
    make_solver(lp_solver)
    control = options.initial_control
    if control is not None and control.shape not in (
        (robot.n,),
        (options.intervals, robot.n),
    ):
        raise OptionsError(
            f"initial_control has shape {control.shape}, expected ({robot.n},) or "
            f"({options.intervals}, {robot.n}) for {options.intervals} intervals",
            "initial_control",
        )
    return replace(options, method=method, lp_solver=lp_solver)


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
    guesses = initial_guesses(system, count, rng, options.initial_duration)
    found = tried = False
    for number, guess in enumerate(guesses):
        if number >= wanted and (found or options.starts is not None):
            return
        tried = True
        watch.start = number
        attempt = solve_from_guess(system, options, guess, watch)
        found = found or attempt.result.best is not None
        yield attempt
    if not tried:
        raise unreachable(system, rng)


def solve_from_guess(
    system: System, options: Options, guess: Guess, watch: Watch
) -> Attempt:
    """Improve a guess with the inverse or the collocation transcription."""
    shares = interval_shares(options.grid, options.intervals)
    duration = guess.duration * (GUESS_STRETCH if guess.timed else 1.0)
    smoothing = options.smoothing
    if smoothing is None:
        smoothing = SMOOTHING_SHARE * guess.duration
    lp = make_solver(options.lp_solver)
    if options.method == "collocation":
        lifted = CollocationTranscription(system, shares, guess.duration)
        nodes = np.concatenate([[0.0], np.cumsum(shares)])
        start = lifted.start(
            guess.position(nodes * guess.duration), np.array([duration])
        )
        return Attempt(
            lifted,
            start,
            SlpSolver(lifted, options, smoothing, lp, watch).run(start),
        )
    transcription = InverseTranscription(system, shares, guess.duration)
    z = transcription.start(guess.position, duration)
    result = SlpSolver(transcription, options, smoothing, lp, watch).run(z)
    for _ in range(EXCHANGES):
        # Torques and clearances run on between the rows.
        extra = transcription.inspect(result.iterate.z, OVERLOAD, GRAZE)
        if not extra.size or result.status in STOPPED:
            break
        transcription = transcription.with_rows(extra)
        few = replace(options, max_iterations=EXCHANGE_ITERATIONS)
        solver = SlpSolver(transcription, few, smoothing, lp, watch)
        result = solver.run(result.iterate.z, after=result)
    return Attempt(transcription, z, result)


def solve_by_shooting(system: System, options: Options, watch: Watch) -> Attempt:
    """Improve torques from the paper's kind of start, which need reach nothing."""
    n, N = system.n, options.intervals
    shares = interval_shares(options.grid, N)
    duration = options.initial_duration or FIRST_DURATION
    paper = options.step_rule == "paper" and options.method == "adjoint"
    transcription = AdjointTranscription(
        system,
        shares,
        duration,
        instants=INSTANTS["paper" if paper else options.method],
    )
    control = options.initial_control
    control = np.zeros(n) if control is None else control
    z = transcription.pack(np.broadcast_to(control, (N, n)), np.array([duration]))
    lp = make_solver(options.lp_solver)
    solver: PaperSolver | PenaltySolver | SlpSolver
    if options.method == "penalty":
        solver = PenaltySolver(transcription, options, watch)
    elif paper:
        solver = PaperSolver(transcription, options, lp, watch)
    else:
        smoothing = options.smoothing or 0.0
        solver = SlpSolver(transcription, options, smoothing, lp, watch)
    return Attempt(transcription, z, solver.run(z))


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
        for record in attempt.result.history
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
    best = min(attempts, key=lambda a: (a.duration, a.result.iterate.violation))
    result = best.result
    iterate = result.iterate if result.best is None else result.best
    rows = best.transcription.rows
    violation = rows.violation(iterate.values)
    violations = {
        kind: float(np.max(violation[rows.kind == index], initial=0.0))
        for index, kind in enumerate(rows.kinds)
    }
    feasible = result.best is not None
    ended = result.status
    if status in STOPPED:
        ended = status
    if ended is Status.CONVERGED and not feasible:
        ended = Status.INFEASIBLE
    return Solution(
        problem=problem,
        options=options,
        status=ended,
        message=_message(ended, feasible, iterate.duration, violations),
        feasible=feasible,
        trajectory=best.transcription.trajectory(iterate.z),
        initial=best.transcription.trajectory(best.start),
        history=history,
        planning_time=watch.seconds,
        violations=violations,
    )


def _message(
    status: Status, feasible: bool, duration: float, violations: dict[str, float]
) -> str:
    if feasible:
        return f"{status.value} T = {duration:.4f} s."
    worst = max(violations, key=lambda kind: violations[kind])
    return f"{status.value} The {worst} rows stay violated by {violations[worst]:.3g}."
