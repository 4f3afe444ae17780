"""Finer grids: the grid of the best motion follows its bends.

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

import numpy as np

from tominpmp.arrays import Array
from tominpmp.linear_programs import make_solver
from tominpmp.options import Options
from tominpmp.planner.attempt import Attempt, fastest
from tominpmp.planner.descent import quieting, repaired
from tominpmp.planner.progress import Progress
from tominpmp.planner.rescue import KEPT, improvement_of
from tominpmp.problem import Problem
from tominpmp.solvers.iterate import Iterate, SlpResult
from tominpmp.solvers.restoration import LIGHT, cured
from tominpmp.solvers.rounds import solve_in_rounds
from tominpmp.solvers.slp import SlpSolver
from tominpmp.status import STOPPED, IterationRecord, Status
from tominpmp.transcription.base import Program
from tominpmp.transcription.bends import BENDS, to_be_split
from tominpmp.transcription.distance_rows import times_of_rows, with_rows_at
from tominpmp.transcription.layout import Gridded, split_intervals
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import NonlinearProgram

logger = logging.getLogger(__name__)

# What further rounds promise together is half of what this one did, at most.
FALLS = 2.0
# Slowing down cures a violation of this much, and costs no more than half of it.
CURABLE = 3e-4
# Programs that all rounds together may take at least.
LEAST_PROGRAMS = 16
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
        work: Programs of all rounds together, to those of the search. A round that has
            used them up ends with what it has, and is the last.
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
) -> Iterator[Attempt]:
    """Go on with the best motion on a grid of its own, if that pays.

    Args:
        problem: The problem.
        options: Options of the plan.
        progress: Time limit and callback.
        attempts: What was found.

    Yields:
        The motion on a finer grid, if it is faster.
    """
    best = fastest(attempts)
    if best is None or best.status in STOPPED:
        return
    if best.layout is None:
        if options.refine == "grid":
            way = f"method {options.method!r}"
            remark = f"It was not refined: that is not done for {way}."
            yield replace(best, history=(), remark=f"{best.remark} {remark}".strip())
        return
    thrift = USUAL if options.refine == "auto" else LAVISH
    made = sum(r.programs for attempt in attempts for r in attempt.history)
    programs = max(thrift.work * made, LEAST_PROGRAMS)

    def make(tried: ProblemFunctions, _: int, __: Attempt | None) -> Attempt:
        watch = Watch(progress, options, thrift, best.duration, programs)
        return _refined(tried, options, best, watch) or best

    def work(system: ProblemFunctions) -> Attempt:
        # Links that rows have kept apart would touch without them.
        progress.links_touched = best.apart
        return repaired(system, progress, make, repairs=0)

    faster = improvement_of(problem, options, progress, best, work)
    # One that is cut short brings as much as one that is not, or nothing: a plan with
    # more time would have let go of less.
    if faster is not None and faster.duration < (1.0 - thrift.gain) * best.duration:
        yield faster
    elif progress.cut_short is not None:
        yield replace(best, history=(), status=progress.cut_short)
    elif faster is None:
        remark = KEPT.format(type(progress.failures[-1]).__name__)
        yield replace(best, history=(), remark=f"{best.remark} {remark}".strip())
    progress.deadline.check()


def _refined(
    system: ProblemFunctions, options: Options, attempt: Attempt, watch: Watch
) -> Attempt | None:
    """A motion on finer grids, replayed; None if that brings next to nothing."""
    assert attempt.layout is not None  # noqa: S101
    of, z = attempt.layout.taken_up(system, attempt.trajectory)
    best: tuple[NonlinearProgram, SlpResult] | None = None
    thrift, rows, reached = watch.thrift, attempt.rows, attempt.duration
    for _ in range(thrift.rounds):
        split = to_be_split(of, z, thrift.bends)
        if not np.any(split):
            break
        of, z = split_intervals(of, z, split)
        watch.begin()
        program, result = _solve(of, z, rows, options, watch)
        found = result.best
        logger.info("%d intervals: promise %.1e", of.intervals, watch.first)
        if found is None or found.duration >= reached:
            break
        best, reached = (program, result), found.duration
        if watch.first < FALLS * thrift.worth or watch.spent:
            break
        assert isinstance(program.transcription, Gridded)  # noqa: S101
        of, z = program.transcription, found.z
        rows = times_of_rows(program, z)
    if best is None or reached > (1.0 - thrift.gain) * attempt.duration:
        return None
    history = tuple(watch.progress.records)
    result = replace(best[1], status=attempt.status, history=history)
    finer = Attempt.of(attempt.name, best[0], attempt.initial, result)
    finer = replace(finer, remark=attempt.remark)
    return finer.verified(system.problem, options)


class Watch:
    """Callback that ends the iterations of a round when no more is promised.

    Args:
        progress: Is shown every record.
        options: Options of the plan.
        thrift: What finer grids must bring, and may take.
        duration: T of the motion that has to be beaten [s].
        programs: How many all rounds may take.

    Attributes:
        first: What the first step of the round promised, as a share of T.
    """

    def __init__(
        self,
        progress: Progress,
        options: Options,
        thrift: Thrift,
        duration: float,
        programs: float,
    ) -> None:
        self.progress, self.options, self.thrift = progress, options, thrift
        self.duration, self.programs = duration, programs
        self.begin()

    def begin(self) -> None:
        """Begin with a round."""
        self.first, self.iterations = np.nan, 0
        self.latest: tuple[Program, Iterate] | None = None

    def __call__(self, record: IterationRecord) -> Status | None:
        """See a record; a status ends the iteration."""
        status = self.progress(record)
        promised = record.predicted / self.duration
        left = promised - max(record.actual, 0.0) / self.duration
        self.iterations += 1
        if np.isnan(self.first):
            self.first = promised
        enough = left < self.thrift.enough or self.spent
        enough = enough or self.iterations >= ITERATIONS
        enough = enough and record.violation <= CURABLE and self._cured_by_time
        enough = enough or self.first < self.thrift.worth
        return status or (Status.CONVERGED if enough else None)

    @property
    def spent(self) -> bool:
        """Whether the programs are used up."""
        made = sum(record.programs for record in self.progress.records)
        return made >= self.programs

    def keep(self, program: Program, iterate: Iterate) -> None:
        """See the best motion so far, or the present one, and have it kept."""
        self.latest = (program, iterate)
        self.progress.keep(program, iterate)

    @property
    def _cured_by_time(self) -> bool:
        """Whether slowing down cures all that is violated: it parts nothing."""
        if self.latest is None:
            return True
        limit = self.options.feasibility
        return cured(*self.latest, np.inf, limit) is not None


def _solve(
    of: Gridded,
    z: Array,
    rows: Mapping[str, Array],
    options: Options,
    watch: Watch,
) -> tuple[NonlinearProgram, SlpResult]:
    """A few programs on a new grid, with the rows of distances that there were."""
    lp = make_solver(options.lp_solver)
    smoothing = quieting(of.system, options, float(of.cost @ z))
    few = replace(
        options,
        trust_region=RADIUS * options.trust_region,
        max_iterations=min(options.max_iterations, MOST_ITERATIONS),
    )
    program = with_rows_at(NonlinearProgram.of(of).at(z), z, rows)

    def solve(
        program: NonlinearProgram, z: Array, options: Options, after: SlpResult | None
    ) -> SlpResult:
        watch.iterations = 0
        solver = SlpSolver(program, options, smoothing, lp, watch, keep=watch.keep)
        return solver.run(z, after=after)

    return solve_in_rounds(program, z, few, solve, rough=False, light=LIGHT)
