"""Attempts: what one initial guess leads to."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from tominpmp.arrays import Array
from tominpmp.options import Options
from tominpmp.problem import Problem
from tominpmp.refinement import refine
from tominpmp.seeding.guess import Guess
from tominpmp.seeding.warm import FormerMotion, former_motion
from tominpmp.solution import IterationRecord, Status
from tominpmp.solvers.iterate import SlpResult
from tominpmp.solvers.lp import LpSolver, make_solver
from tominpmp.solvers.paper import PaperSolver
from tominpmp.solvers.penalty import PenaltySolver
from tominpmp.solvers.slp import SlpSolver
from tominpmp.trajectory import Trajectory
from tominpmp.transcription.adjoint import AdjointTranscription, Instants
from tominpmp.transcription.base import Transcription
from tominpmp.transcription.bspline import DEGREES, BSplineTranscription
from tominpmp.transcription.collocation import CollocationTranscription
from tominpmp.transcription.controls import torque_shares
from tominpmp.transcription.grid import delayed_shares, interval_shares
from tominpmp.transcription.inverse import InverseTranscription
from tominpmp.transcription.system import System
from tominpmp.verification.verdict import Verification, verify

# Weight of the total variation, as a share of the duration of the guess; chosen on
# benchmarks/random_goals.py: it costs less than 0.1 % of T and halves the iterations.
SMOOTHING_SHARE = 1e-4
# Relative torque excess between the rows that is let pass, and rounds of adding rows.
OVERLOAD = 2e-3
NEARLY = 1e-2
EXCHANGES = 6
EXCHANGE_ITERATIONS = 25
# Progress below which rows between the nodes are looked for while the duration still
# falls: rows that a finished motion breaks cost a new solve.
ROUGH = 1e-2
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
# Doublings of the grid of a motion that the replay does not confirm.
REFINEMENTS = 2
# Trust region of a start from a former motion, in shares of the usual one.
FORMER_RADIUS = 0.3
# A timed guess lies on the limits; the grid rounds it. This much slower it is nearly
# admissible.
GUESS_STRETCH = 1.02
# The same for motions whose accelerations must not jump.
SMOOTH_STRETCH = 1.3


class Watch:
    """Time limit, callback and interruption of a planning, as a monitor of solvers.

    Attributes:
        start: Number of the initial guess that is worked on.
        best: Duration of the best motion so far [s]; infinite if there is none.
    """

    def __init__(self, options: Options) -> None:
        self.start = 0
        self.best = np.inf
        self._starts = 0
        self._begin = time.perf_counter()
        self._limit = options.max_planning_time
        self._until = self._limit
        self._callback = options.callback
        # A violation that is good enough to stop, where any motion will do.
        self._enough = options.feasibility if options.objective == "feasible" else -1.0

    @property
    def seconds(self) -> float:
        """Time since planning began [s]."""
        return time.perf_counter() - self._begin

    def begin(self, count: int = 1) -> int:
        """Begin with one or several new guesses; returns the number of the first."""
        self.start = self._starts
        self._starts += count
        return self.start

    def share(self, parts: int) -> None:
        """Allow the next start one of so many parts of the time that is left.

        All of it once there is a motion: what comes after it can only be better.
        """
        self._until = self._limit
        if self._limit is not None and self.best == np.inf:
            self._until = self.seconds + (self._limit - self.seconds) / max(parts, 1)

    def ended(self, status: Status) -> bool:
        """Whether planning ends when a start has ended with a status."""
        used_up = self._until is self._limit or self.over
        return status is Status.INTERRUPTED or (status is Status.TIME_LIMIT and used_up)

    @property
    def deadline(self) -> float | None:
        """When the planning time is used up, on the clock of perf_counter [s]."""
        return None if self._limit is None else self._begin + self._limit

    @property
    def left(self) -> float | None:
        """Planning time that is left [s], a little at least; None without a limit."""
        return None if self._until is None else max(self._until - self.seconds, 1e-3)

    @property
    def over(self) -> bool:
        """Whether the planning time is used up."""
        return self._limit is not None and self.seconds >= self._limit

    def replay(self, history: tuple[IterationRecord, ...]) -> Status | None:
        """Show records that were made in another process to the callback."""
        for record in history:
            if self._callback is not None:
                record = replace(record, start=self.start, seconds=self.seconds)
                if self._callback(record):
                    return Status.INTERRUPTED
        return None

    def __call__(self, record: IterationRecord) -> Status | None:
        """See a record; a status ends the iteration."""
        record = replace(record, start=self.start, seconds=self.seconds)
        if self._callback is not None and self._callback(record):
            return Status.INTERRUPTED
        if record.violation <= self._enough:
            return Status.FEASIBLE
        late = self._until is not None and self.seconds >= self._until
        return Status.TIME_LIMIT if late else None


@dataclass(frozen=True, eq=False)
class Attempt:
    """What one initial guess led to.

    Attributes:
        name: What it began with.
        status: How the iteration ended.
        feasible: Whether the motion keeps all constraints.
        trajectory: The best motion.
        initial: The motion it began with.
        violations: Largest violation by kind of constraint.
        history: One record an iteration.
        verification: Replay of the torques, if the motion is feasible.
    """

    name: str
    status: Status
    feasible: bool
    trajectory: Trajectory
    initial: Trajectory
    violations: dict[str, float]
    history: tuple[IterationRecord, ...]
    verification: Verification | None = None

    @classmethod
    def of(
        cls,
        name: str,
        transcription: Transcription,
        initial: Array | Trajectory,
        result: SlpResult,
    ) -> Attempt:
        """Attempt from the iterate it began with and the outcome of a solver."""
        feasible = result.best is not None
        iterate = result.iterate if result.best is None else result.best
        rows = transcription.rows
        violation = rows.violation(iterate.values)
        violations = {
            kind: float(np.max(violation[rows.kind == index], initial=0.0))
            for index, kind in enumerate(rows.kinds)
        }
        return cls(
            name,
            result.status,
            feasible,
            transcription.trajectory(iterate.z),
            initial
            if isinstance(initial, Trajectory)
            else transcription.trajectory(initial),
            violations,
            result.history,
        )

    @property
    def violation(self) -> float:
        """Largest violation."""
        return max(self.violations.values(), default=0.0)

    def after(self, former: Attempt) -> Attempt:
        """This attempt as what another one that it goes on from has led to."""
        count = len(former.history)
        more = (replace(r, iteration=r.iteration + count) for r in self.history)
        history = (*former.history, *more)
        return replace(self, initial=former.initial, history=history)

    @property
    def found(self) -> bool:
        """Whether the motion keeps all constraints, in the replay too."""
        return self.feasible and (self.verification is None or self.verification.ok)

    @property
    def duration(self) -> float:
        """T of the motion if it keeps all constraints [s]; else infinite."""
        return self.trajectory.duration if self.found else np.inf

    def verified(self, problem: Problem, options: Options) -> Attempt:
        """Replay the torques of a motion that is said to keep all constraints."""
        if not self.feasible:
            return self
        verification = verify(
            problem, self.trajectory, options.tolerances, checker=problem.checker
        )
        return replace(self, verification=verification)


def solve_and_verify(
    system: System, options: Options, guess: Guess, watch: Watch
) -> Attempt:
    """Improve a guess; where the replay fails, go on with a finer grid."""
    problem = system.problem
    attempt = solve_from_guess(system, options, guess, watch)
    attempt = attempt.verified(problem, options)
    for _ in range(REFINEMENTS):
        if attempt.found or not attempt.feasible or attempt.status in STOPPED:
            break
        # Nor will the first motion do on the finer grid: it was too rough.
        options = replace(options, intervals=2 * options.intervals, objective="time")
        guess = replace(former_motion(system, attempt.trajectory), name=attempt.name)
        finer = solve_from_guess(system, options, guess, watch)
        finer = finer.verified(problem, options)
        if not finer.feasible:
            break
        attempt = finer.after(attempt)
    return attempt


def solve_alone(system: System, options: Options, guess: Guess) -> Attempt:
    """Improve a guess in a process of its own."""
    return solve_and_verify(system, options, guess, Watch(options))


def solve_from_guess(
    system: System, options: Options, guess: Guess, watch: Watch
) -> Attempt:
    """Improve a guess with the inverse or the collocation transcription."""
    smoothing = options.smoothing
    if smoothing is None:
        smoothing = SMOOTHING_SHARE * guess.duration
    shares = guess_shares(options, guess)
    duration = guess.duration * (GUESS_STRETCH if guess.timed else 1.0)
    lp = make_solver(options.lp_solver)
    former = guess if isinstance(guess, FormerMotion) else None
    if options.method == "collocation":
        shares = np.sum(shares, axis=1, keepdims=True)
        lifted = CollocationTranscription(system, shares, guess.duration)
        if former is not None:
            grid = options.intervals, options.grid
            lifted, start = former.lifted_program(system, *grid)
        else:
            nodes = np.concatenate([[0.0], np.cumsum(shares)])
            start = lifted.start(
                guess.position(nodes * guess.duration), np.array([duration])
            )
        solver = SlpSolver(lifted, options, smoothing, lp, watch)
        return Attempt.of(guess.name, lifted, start, solver.run(start))
    if options.control != "constant":
        return solve_smooth(system, options, guess, smoothing, watch)
    if former is not None:
        grid = options.intervals, options.grid
        transcription, start = former.inverse_program(system, *grid)
        # Rows between the nodes that the motion rests on, which it had before.
        transcription = transcription.with_rows(transcription.inspect(start, -NEARLY))
    else:
        transcription = InverseTranscription(system, shares, guess.duration)
        start = transcription.start(guess.position, duration)
    initial = transcription.trajectory(start)
    found: tuple[Transcription, SlpResult] = exchange(
        transcription, start, options, smoothing, lp, watch
    )
    done = (*STOPPED, Status.FEASIBLE)
    if options.refine is not None and found[1].status not in done:
        found = refine(system, options, *found, lp, watch)
    return Attempt.of(guess.name, found[0], initial, found[1])


def guess_shares(options: Options, guess: Guess) -> Array:
    """Grid for a guess: intervals of their own for the time before it sets out."""
    if guess.delay > 0.0:
        return delayed_shares(options.intervals, guess.delay / guess.duration)
    return interval_shares(options.grid, options.intervals)


def solve_smooth(
    system: System, options: Options, guess: Guess, smoothing: float, watch: Watch
) -> Attempt:
    """Improve a guess with a B-spline of the degree that the control asks for."""
    shares = np.sum(guess_shares(options, guess), axis=1, keepdims=True)
    degree = DEGREES[options.control]
    if isinstance(guess, FormerMotion):
        grid = options.intervals, options.grid
        transcription, start = guess.spline_program(system, *grid, degree)
    else:
        transcription = BSplineTranscription(system, shares, degree)
        start = transcription.start(
            guess.position, guess.duration, SMOOTH_STRETCH * guess.duration
        )
    z = start
    lp = make_solver(options.lp_solver)
    result = SlpSolver(transcription, options, smoothing, lp, watch).run(z)
    for _ in range(EXCHANGES):
        extra = transcription.inspect(result.iterate.z, OVERLOAD)
        if not (extra[0].size or extra[1].size) or result.status in STOPPED:
            break
        transcription = transcription.with_rows(extra)
        solver = SlpSolver(transcription, options, smoothing, lp, watch)
        result = solver.run(result.iterate.z, after=result)
    return Attempt.of(guess.name, transcription, start, result)


def exchange(
    transcription: InverseTranscription,
    z: Array,
    options: Options,
    smoothing: float,
    lp: LpSolver,
    watch: Watch,
) -> tuple[InverseTranscription, SlpResult]:
    """Solve, and solve on with rows where the motion breaks limits between them."""
    system = transcription.system
    rough = options
    if system.clearance is not None:
        rough = replace(options, tolerance=max(ROUGH, options.tolerance))
    result = SlpSolver(transcription, rough, smoothing, lp, watch).run(z)
    settled = rough is options
    few = replace(
        options, max_iterations=min(options.max_iterations, EXCHANGE_ITERATIONS)
    )
    for _ in range(EXCHANGES):
        if result.status in STOPPED:
            break
        extra = transcription.inspect(result.iterate.z, OVERLOAD)
        if not extra.size and settled:
            break
        transcription = transcription.with_rows(extra)
        solver = SlpSolver(transcription, few if settled else options, smoothing, lp)
        solver = replace(solver, monitor=watch)
        result = solver.run(result.iterate.z, after=result)
        settled = True
    return transcription, result


def solve_from_former(
    system: System, options: Options, former: FormerMotion, watch: Watch
) -> Attempt:
    """Improve a former motion; it stays as it was if nothing faster is found."""
    near = replace(options, trust_region=FORMER_RADIUS * options.trust_region)
    if options.method in ("adjoint", "penalty"):
        attempt = solve_by_shooting(system, near, watch, former)
    else:
        attempt = solve_and_verify(system, near, former, watch)
    if attempt.duration < former.duration:
        return attempt
    kept = former.remainder(system)
    if kept is None:
        return attempt
    same = replace(attempt, feasible=True, trajectory=kept, violations={})
    same = same.verified(system.problem, options)
    return same if same.duration < attempt.duration else attempt


def solve_by_shooting(
    system: System,
    options: Options,
    watch: Watch,
    former: FormerMotion | None = None,
) -> Attempt:
    """Improve torques from the paper's kind of start, which need reach nothing.

    Where the replay fails, go on with shorter steps of the integration.
    """
    n, N = system.n, options.intervals
    if former is not None:
        z = former.torque_program(system, interval_shares(options.grid, N))
    else:
        control = options.initial_control
        control = np.zeros(n) if control is None else control
        duration = np.array([options.initial_duration or FIRST_DURATION])
        shares = torque_shares(system, np.broadcast_to(control, (N, n)))
        z = np.concatenate([shares.ravel(), duration])
    attempt, z = shoot(system, options, watch, z, substeps=1)
    for refinement in range(REFINEMENTS):
        if attempt.found or not attempt.feasible or attempt.status in STOPPED:
            break
        finer, z = shoot(system, options, watch, z, substeps=2 ** (refinement + 1))
        if not finer.feasible:
            break
        attempt = finer.after(attempt)
    return attempt


def shoot(
    system: System, options: Options, watch: Watch, z: Array, substeps: int
) -> tuple[Attempt, Array]:
    """Improve torques and duration with so many integration steps an interval."""
    shares = interval_shares(options.grid, options.intervals)
    paper = options.step_rule == "paper" and options.method == "adjoint"
    transcription = AdjointTranscription(
        system,
        shares,
        float(z[-1]),
        substeps=substeps,
        instants=INSTANTS["paper" if paper else options.method],
    )
    lp = make_solver(options.lp_solver)
    solver: PaperSolver | PenaltySolver | SlpSolver
    if options.method == "penalty":
        solver = PenaltySolver(transcription, options, watch)
    elif paper:
        solver = PaperSolver(transcription, options, lp, watch)
    else:
        smoothing = options.smoothing or 0.0
        solver = SlpSolver(transcription, options, smoothing, lp, watch)
    result = solver.run(z)
    attempt = Attempt.of("shooting", transcription, z, result)
    found = result.iterate if result.best is None else result.best
    return attempt.verified(system.problem, options), found.z
