"""The last stage of a search: the grid of the best motion follows its bends.

A grid that was chosen before anything was known of the motion costs time where torques
switch inside an interval, where what runs to its limit gets there at one instant of it
only, and where obstacles bend the path. Intervals are halved where the controls bend;
the motion is the same on the new grid, and the first linear program there tells what is
to be had. Where that is little it is left at that, else a few programs get nearly all
of it, and the next round looks where controls bend now.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from tominpmp.arrays import Array
from tominpmp.linear_programs import LpSolver, make_solver
from tominpmp.motion.trajectory import Trajectory
from tominpmp.options import Options
from tominpmp.planner.attempt import Attempt
from tominpmp.planner.continuation import SPEED_SHARE, speed_share
from tominpmp.planner.direct_solve import SMOOTHING_SHARE, by_squares
from tominpmp.planner.progress import Progress
from tominpmp.planner.ramps import time_at_speed_limits
from tominpmp.planner.rescue import guarded
from tominpmp.problem import Problem
from tominpmp.solvers.iterate import Iterate, SlpResult
from tominpmp.solvers.restoration import LIGHT, cured
from tominpmp.solvers.rounds import solve_in_rounds
from tominpmp.solvers.slp import SlpSolver
from tominpmp.status import STOPPED, IterationRecord, Status
from tominpmp.transcription.base import Program
from tominpmp.transcription.bends import BENDS, to_be_split
from tominpmp.transcription.distance_rows import times_of_rows, with_rows_at
from tominpmp.transcription.inverse import InverseTranscription
from tominpmp.transcription.layout import (
    QUADRATIC,
    Gridded,
    Layout,
    split_intervals,
)
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import NonlinearProgram

logger = logging.getLogger(__name__)

# What further rounds promise together is half of what this one did, at most; as much as
# this one did where accelerations are constant, whose error falls with their lengths.
FALLS, FALLS_OF_CONSTANT = 2.0, 1.0
# Slowing down cures a violation of this much, and costs no more than half of it.
CURABLE = 3e-4
# Programs that all rounds together may take at least, on the first grid; and how much
# more of everything where accelerations are constant: they need more intervals.
LEAST_PROGRAMS, MORE_FOR_CONSTANT = 16, 2.0
# Iterations on a grid; and at most, where violations are left that slowing down does
# not cure: without them all that was gained would be lost.
ITERATIONS, MOST_ITERATIONS = 8, 20
# Trust region, as a share of the usual one: the motion is near to what it comes from.
RADIUS = 0.3


@dataclass(frozen=True)
class Thrift:
    """What finer grids must bring, and may take.

    Attributes:
        worth: A round is worth while if it promises this share of T.
        enough: An iteration goes on while it has not kept more of what it promised than
            this share of T: most of the gain comes with the first step.
        gain: Motions that gain less than this share of T are not worth a replay.
        rounds: Rounds of halving.
        work: What the programs of all rounds may take together, in intervals of
            programs, to what the search took. A round that has used it up ends with
            what it has, and is the last.
        bends: Intervals are halved that have this share of all bends, with their
            lengths, together.
    """

    worth: float
    enough: float
    gain: float
    rounds: int
    work: float
    bends: float


USUAL = Thrift(3e-3, 1.5e-3, 1e-3, 5, 1.5, BENDS)
# Where time matters less than T.
LAVISH = Thrift(3e-4, 1.5e-4, 1e-4, 6, 4.0, 0.99)


def on_finer_grid(
    problem: Problem,
    options: Options,
    progress: Progress,
    attempts: Sequence[Attempt],
    thrift: Thrift = USUAL,
) -> Iterator[Attempt]:
    """Go on with the best motion on a grid of its own, if that pays.

    Args:
        problem: The problem.
        options: Options of the plan.
        progress: Time limit and callback.
        attempts: What was found.
        thrift: What it must bring, and may take.

    Yields:
        The motion on a finer grid, if it is faster.
    """
    if options.refine != "auto" or options.objective != "time":
        return
    found = [attempt for attempt in attempts if attempt.found]
    if not found:
        return
    best = min(found, key=lambda attempt: attempt.duration)
    if best.status in STOPPED:
        return
    if best.taken_over and speed_share(best.trajectory, problem) > SPEED_SHARE:
        return
    system = ProblemFunctions.of(problem.alternative_of(best.trajectory))
    if nothing_to_gain(system, best.trajectory, thrift.worth):
        return
    progress.share(1)
    progress.begin()
    made = sum(r.programs for attempt in attempts for r in attempt.history)
    programs = max(thrift.work * made, LEAST_PROGRAMS)
    if best.trajectory.degree == QUADRATIC:
        programs *= MORE_FOR_CONSTANT
    work = Work(programs * (best.trajectory.t.size - 1), thrift)
    solve = partial(refined, system, options, best, progress, work)
    faster = guarded(problem, options, progress, best.name, solve)
    # One that is cut short brings as much as one that is not, or nothing: a plan with
    # more time would have let go of less.
    if faster is not None and faster.duration < (1.0 - thrift.gain) * best.duration:
        yield faster
    elif progress.cut_short is not None:
        yield replace(best, history=(), status=progress.cut_short)
    progress.deadline.check()


def nothing_to_gain(
    system: ProblemFunctions, motion: Trajectory, worth: float = USUAL.worth
) -> bool:
    """Whether a joint needs nearly all of T for its way at its speed limit alone."""
    least = time_at_speed_limits(system, motion)
    return bool(least > (1.0 - worth) * motion.duration)


class Work:
    """What the programs of finer grids may take.

    Args:
        budget: Intervals of all programs together.
        thrift: What it must bring.

    Attributes:
        done: How many there were.
    """

    def __init__(self, budget: float, thrift: Thrift) -> None:
        self.budget, self.thrift, self.done = budget, thrift, 0.0

    @property
    def spent(self) -> bool:
        """Whether it is used up."""
        return self.done >= self.budget


def refined(
    system: ProblemFunctions,
    options: Options,
    attempt: Attempt,
    progress: Progress,
    work: Work,
) -> Attempt | None:
    """A motion on finer grids, replayed; None if that brings next to nothing.

    Args:
        system: The functions of the problem; those of an arm alone let its links touch
            at first, unless the motion came of rows that keep them apart.
        options: Options of the plan.
        attempt: What led to the motion.
        progress: Time limit and callback.
        work: What may be done.
    """
    first = system if attempt.apart else system.first_tried
    found = _refined(first, options, attempt, progress, work)
    if first is system or found is None or not found.touches:
        return found
    again = Work(work.budget, work.thrift)
    return _refined(system, options, attempt, progress, again)


def _refined(
    system: ProblemFunctions,
    options: Options,
    attempt: Attempt,
    progress: Progress,
    work: Work,
) -> Attempt | None:
    layout = attempt.layout or Layout.of_motion(attempt.trajectory)
    if layout is None:
        return None
    of, z = layout.taken_up(system, attempt.trajectory)
    T, lp = attempt.duration, make_solver(options.lp_solver)
    best: tuple[NonlinearProgram, SlpResult] | None = None
    thrift, rows, lean = work.thrift, attempt.rows, False
    reached = kept = T
    for _ in range(thrift.rounds):
        split = to_be_split(of, z, thrift.bends)
        if not np.any(split):
            break
        of, z = split_intervals(of, z, split)
        promise = Promise(progress, T, reached, work, of.intervals, options)
        program, result = _solve(of, z, rows, options, lp, promise)
        found = result.best
        logger.info("%d intervals: promise %.1e", of.intervals, promise.first)
        if found is None or found.duration >= reached or (lean and promise.broken):
            break
        # What the first grid does not bring the next one may, which knows more bends.
        lean = promise.broken
        best, kept = (best, kept) if lean else ((program, result), found.duration)
        assert isinstance(program.transcription, Gridded)  # noqa: S101
        reached = found.duration
        little = promise.first < _falls(of) * thrift.worth
        if little or work.spent:
            break
        of, z = program.transcription, found.z
        rows = times_of_rows(program, z)
    if best is None or kept > (1.0 - thrift.gain) * T:
        return None
    return _attempt(system, options, attempt, best, progress)


def _falls(of: Gridded) -> float:
    """What a round has to promise for another one to be worth while, in its worth."""
    constant = isinstance(of, InverseTranscription)
    return FALLS_OF_CONSTANT if constant else FALLS


def _attempt(
    system: ProblemFunctions,
    options: Options,
    former: Attempt,
    best: tuple[NonlinearProgram, SlpResult],
    progress: Progress,
) -> Attempt:
    """What was found, replayed."""
    history = tuple(progress.records)
    result = replace(best[1], status=former.status, history=history)
    attempt = Attempt.of(former.name, best[0], former.initial, result)
    attempt = replace(attempt, remark=former.remark)
    return attempt.verified(system.problem, options, later=progress.puts_off)


class Promise:
    """Callback that ends an iteration when no more is promised.

    Args:
        progress: Is shown every record.
        duration: T of the motion that has to be beaten [s].
        begun: T of the motion that the iteration begins with [s].
        work: What may be done.
        intervals: Of the grid.
        options: Options of the plan.

    Attributes:
        first: What the first step promised, as a share of T.
        reached: T of the last iterate [s].
        iterations: How many it has seen.
        latest: Program and iterate of the motion that was kept last.
    """

    def __init__(
        self,
        progress: Progress,
        duration: float,
        begun: float,
        work: Work,
        intervals: int,
        options: Options,
    ) -> None:
        self.progress, self.duration = progress, duration
        self.work, self.intervals = work, intervals
        self.first, self.begun = np.nan, begun
        self.reached, self.iterations = begun, 0
        self.feasibility = options.feasibility
        self.most = min(options.max_iterations, ITERATIONS)
        self.latest: tuple[Program, Iterate] | None = None

    def __call__(self, record: IterationRecord) -> Status | None:
        """See a record; a status ends the iteration."""
        status = self.progress(record)
        promised = record.predicted / self.duration
        left = promised - max(record.actual, 0.0) / self.duration
        if np.isnan(self.first):
            self.first = promised
        self.reached = record.duration
        self.work.done += record.programs * self.intervals
        self.iterations += 1
        thrift = self.work.thrift
        enough = left < thrift.enough or self.work.spent
        enough = enough or self.iterations >= self.most
        enough = enough and record.violation <= CURABLE and self.cured_by_time
        enough = enough or self.first < thrift.worth
        return status or (Status.CONVERGED if enough else None)

    @property
    def broken(self) -> bool:
        """Whether less is left of it than is worth a replay.

        Rows between the nodes, which make motions slower, are not looked for then.
        """
        least = max(self.reached, (1.0 - self.first) * self.begun)
        return least > (1.0 - self.work.thrift.gain) * self.duration

    def keep(self, program: Program, iterate: Iterate) -> None:
        """See the best motion so far, or the present one, and have it kept."""
        self.latest = (program, iterate)
        self.progress.keep(program, iterate)

    @property
    def cured_by_time(self) -> bool:
        """Whether slowing down cures all that is violated: it parts nothing."""
        if self.latest is None:
            return True
        program, iterate = self.latest
        return cured(program, iterate, np.inf, self.feasibility) is not None


def _solve(
    of: Gridded,
    z: Array,
    rows: Mapping[str, Array],
    options: Options,
    lp: LpSolver,
    promise: Promise,
) -> tuple[NonlinearProgram, SlpResult]:
    """A few programs on a new grid, with the rows of distances that there were."""
    smoothing = options.smoothing
    if smoothing is None:
        smoothing = 0.0 if of.system.alone else SMOOTHING_SHARE * float(of.cost @ z)
    squares = by_squares(of.system, options)
    few = replace(
        options,
        trust_region=RADIUS * options.trust_region,
        max_iterations=min(options.max_iterations, MOST_ITERATIONS),
    )
    program = with_rows_at(NonlinearProgram.of(of).at(z), z, rows)

    def solve(
        program: NonlinearProgram, z: Array, options: Options, after: SlpResult | None
    ) -> SlpResult:
        promise.iterations = 0
        solver = SlpSolver(program, options, smoothing, lp, promise, keep=promise.keep)
        return replace(solver, squares=squares).run(z, after=after)

    return solve_in_rounds(
        program,
        z,
        few,
        solve,
        rough=False,
        light=LIGHT,
        over=lambda: promise.broken,
    )
