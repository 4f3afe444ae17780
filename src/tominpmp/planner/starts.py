"""Multi-start for one goal: which guesses are tried, and when the search ends.

The order of the starts depends neither on their number nor on the number of processes:
a plan with more starts makes the candidates of a plan with fewer starts first, and then
others. Several processes descend from guesses ahead of their turn; the motions of
guesses whose turn does not come count only if the plan is stopped.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from tominpmp.blas_threads import on_one_thread
from tominpmp.initial_guess.guess import CachedGuesses, Guess, GuessRequest
from tominpmp.initial_guess.parallel import ready, run_parallel, stop_requested
from tominpmp.initial_guess.path_velocity import guesses_of
from tominpmp.initial_guess.segments import segmented_guesses
from tominpmp.initial_guess.unreachable import unreachable
from tominpmp.initial_guess.warm_start import WarmStart, warm_start
from tominpmp.motion.samples import Samples
from tominpmp.motion.trajectory import Trajectory
from tominpmp.options import Options
from tominpmp.planner.automatic_options import JUMPS_SHARE, SHOOTING, WARM_RADIUS
from tominpmp.planner.candidate import Candidate, best_of
from tominpmp.planner.coarse_search import GAP, MOST_PATHS, coarse_grids_apply, search
from tominpmp.planner.descent import descent_work
from tominpmp.planner.improvements import improvements
from tominpmp.planner.plan_state import STEP_SECONDS, STEP_SHARE, PlanState
from tominpmp.planner.segment_by_segment import can_be_joined, segments_joined
from tominpmp.planner.torque_starts import (
    shooting_work,
    torque_starts,
    torques_may_lead,
)
from tominpmp.planner.work import NUMERICAL, Schedule, Work, run, single, use_fallback
from tominpmp.problem.problem import Problem
from tominpmp.solvers.loop import Loop
from tominpmp.status import STOPPED, IterationRecord, Status
from tominpmp.stopping import Stop
from tominpmp.transcription.grid import interval_shares
from tominpmp.transcription.layout import on_ticks
from tominpmp.transcription.problem_functions import ProblemFunctions

# Number of guesses for a goal on a frame, whose final configuration is free, and where
# obstacles move, as a motion may wait for them.
SEVERAL_STARTS = 3
# Upper limit of the number of guesses while there is no incumbent.
RESCUE_STARTS = 8
# Least remaining time to use several processes, as starting them takes about two
# seconds [s].
TO_START = 5.0
# Most guesses per process in a batch, all of which are made before its descents begin:
# a single guess may take seconds.
BATCH = 4


def _usual_starts(system: ProblemFunctions, options: Options) -> int:
    """Number of guesses that are tried if ``options.starts`` is None."""
    if options.objective != "time" or system.parts:
        return 1
    several = system.problem.scene.moving or system.final_configuration is None
    return SEVERAL_STARTS if several else 1


def starts(
    state: PlanState, problem: Problem, motion: Trajectory | Samples | None = None
) -> Schedule[None]:
    """Descend from one guess after the other, beginning with the warm start.

    Args:
        state: The plan.
        problem: The problem of the plan with one of its goals.
        motion: A former motion as warm start; None without one.

    Raises:
        ProblemError: If no guess can be made, as the goal is out of reach.
    """
    options = state.options
    system = ProblemFunctions.of(problem)
    rng = np.random.default_rng(options.seed)
    request = GuessRequest(
        rng, options.initial_duration, searches=state.searches, reached=state.reached
    )
    make = segmented_guesses if system.parts else guesses_of
    guesses = CachedGuesses(make(system, request))
    if motion is not None:
        former = warm_start(system, motion)
        whole = former.whole(system)
        if whole is not None:
            period = options.control_period
            whole = whole if period is None else on_ticks(whole, period)
            state.former = Candidate(Status.FEASIBLE, True, whole, whole, {})
            if state.former.is_on_clock(period):
                # There may be no time to bring another motion to the clock.
                state.recall_former(Status.FEASIBLE)
        candidate = yield _warm_start_work(system, former, state)
        state.recall_former(candidate.status if candidate else Status.FEASIBLE)
        enough = state.incumbent is not None and (options.starts or 1) == 1
        if enough and not _beatable(system, state, guesses):
            return
    if options.method in SHOOTING:
        yield from torque_starts(system, state, 1)
        return
    first = next(guesses.since(0), None)
    if first is None:
        raise unreachable(system, rng)
    usual = _usual_starts(system, options)
    searched = coarse_grids_apply(system, options)
    # If the final configuration of the guess collides, a descent may still move it out
    # of collision; more guesses would not.
    rescues = usual if first.blocked else RESCUE_STARTS
    wanted = options.starts or usual
    most = max(wanted, rescues)
    if searched and not (system.in_free_space or first.blocked):
        most = max(most, usual + MOST_PATHS)
    guesses = CachedGuesses(itertools.islice(guesses.since(0), most))
    tried = 0
    if searched:
        yield from search(system, state, guesses, usual)
        if first.blocked:
            return
        # Without an incumbent all guesses are tried again on the requested grid.
        if state.best_duration < np.inf:
            # The search has tried the first guess and compared the usual ones.
            wanted = 0 if wanted == usual else wanted - 1
            tried = 1
    elif can_be_joined(system):
        yield from _first_of_segments(system, state, first)
        wanted, rescues, tried = wanted - 1, rescues - 1, 1
    yield from _descents(system, state, guesses.since(tried), wanted, rescues)


def _first_of_segments(
    system: ProblemFunctions, state: PlanState, guess: Guess
) -> Schedule[None]:
    """Descend from the first guess of several segments, as a whole or one by one.

    In free space, and where final configurations are free, a descent of the whole
    motion is fast and mostly succeeds. Among obstacles it rarely does.
    """
    free = any(part.final_configuration is None for part in system.parts)
    if free or system.in_free_space:
        candidate = yield descent_work(system, state.options, guess, state)
        if candidate is not None and candidate.confirmed:
            return
    yield segments_joined(system, guess, state, _of_one_segment)


def _of_one_segment(state: PlanState, problem: Problem) -> Schedule[None]:
    """The schedule of a segment that is planned alone."""
    yield from starts(state, problem)
    yield from improvements(state)


def _descents(
    system: ProblemFunctions,
    state: PlanState,
    guesses: Iterator[Guess],
    wanted: int,
    rescues: int,
) -> Schedule[None]:
    """Descend from guesses on the requested grid.

    Args:
        system: Functions of the problem.
        state: The plan.
        guesses: The guesses.
        wanted: Number of guesses that are tried in any case.
        rescues: Upper limit of their number while there is no incumbent.
    """
    options = state.options
    swings = torques_may_lead(system)
    several = options.processes > 1 and (state.remaining_time > TO_START or ready())
    ahead = ParallelDescents(system, state, guesses) if several else None
    try:
        for number in range(max(wanted, rescues)):
            if number == rescues and swings and state.best_duration == np.inf:
                # A plan with fewer starts would try torques at this point, too.
                swings = False
                yield from torque_starts(system, state, 1)
            if number >= wanted and state.best_duration < np.inf:
                return
            # A guess may take a path search: it is made only once it is needed.
            rest = max(wanted - number, 0)
            guess = ahead.next(rest) if ahead else next(guesses, None)
            if guess is None:
                break
            if ahead is not None:
                yield Work(system, partial(ahead.result, number), None)
                continue
            yield descent_work(system, options, guess, state)
        if swings and state.best_duration == np.inf:
            yield from torque_starts(system, state, 1)
    finally:
        if ahead is not None and state.cut_short:
            state.candidates += ahead.unclaimed()


class ParallelDescents:
    """Descents in several processes, ahead of their turn in the order of guesses.

    Args:
        system: Functions of the problem.
        state: The plan.
        guesses: The guesses.

    Attributes:
        processes: Number of processes.
        batch: Guesses of the present batch whose turn has not come.
        taken: Number of guesses taken so far.
        done: The results of the batch as they come, with the numbers of their guesses.
        results: Results whose turn has not come, by the numbers of their guesses.
    """

    def __init__(
        self, system: ProblemFunctions, state: PlanState, guesses: Iterator[Guess]
    ) -> None:
        # The import takes a while, and most plans run in a single process.
        from loky import cpu_count

        self.system, self.state, self.guesses = system, state, guesses
        # More processes than cores would only wait for each other.
        self.processes = min(state.options.processes, cpu_count())
        self.batch: list[Guess] = []
        self.taken = 0
        self.done: Iterator[tuple[int, Result]] = iter(())
        self.results: dict[int, Result] = {}

    def next(self, wanted: int) -> Guess | None:
        """The next guess; a batch has ``wanted`` guesses, or one per process."""
        if not self.batch:
            size = min(wanted or self.processes, BATCH * self.processes)
            self.batch = list(itertools.islice(self.guesses, size))
            first, self.taken = self.taken, self.taken + len(self.batch)
            seconds = self.state.remaining_time
            serial = replace(self.state.options, callback=None, processes=1)
            # Processes hand over their candidates in time, even if a step overruns.
            end = time.time() + (1.0 - STEP_SHARE) * seconds - STEP_SECONDS
            best = self.state.best_duration
            task = partial(descend_in_process, self.system, serial, end, best)
            done = run_parallel(task, [*self.batch], self.processes, seconds)
            self.done = ((first + place, result) for place, result in done)
        return self.batch.pop(0) if self.batch else None

    def result(self, number: int, *_: object) -> Candidate:
        """The candidate of the guess whose turn has come.

        Raises:
            Stop: If the process did not hand it over in time, or the callback stops.
            Exception: The error with which the process has ended.
        """
        while number not in self.results:
            completed = next(self.done, None)
            if completed is None:
                raise Stop(requested=False)  # the process was late
            which, result = completed
            self.results[which] = result
        candidate, failures, history = self.results[number]
        for record in history:
            self.state.show(record)
        # If the callback has stopped the plan, the candidate is one of the unclaimed.
        del self.results[number]
        if candidate is None:
            raise failures[-1] if failures else Stop(requested=False)
        return self._with_status_here(candidate)

    def unclaimed(self) -> list[Candidate]:
        """Candidates whose turn has not come, the fastest first.

        The processes are still at work on others if the plan was stopped: they hand
        these over, and the stop is raised again after the last one.
        """
        try:
            self.results.update(self.done)
        except (Stop, KeyboardInterrupt) as stop:
            self.state.stopped(stop)
        except NUMERICAL as error:  # a process has died
            self.state.failures.append(error)
        made = [item for item, *_ in self.results.values() if item is not None]
        return sorted(map(self._with_status_here, made), key=lambda item: item.duration)

    def _with_status_here(self, candidate: Candidate) -> Candidate:
        """A candidate of a process, with the status that it has in this process.

        A process is also stopped when the time is used up. Its candidate then says
        INTERRUPTED although the user has not interrupted planning.
        """
        stopped = candidate.status is Status.INTERRUPTED
        if not stopped or self.state.deadline.interrupted:
            return candidate
        return replace(candidate, status=Status.TIME_LIMIT)


Result = tuple[Candidate | None, list[Exception], list[IterationRecord]]


@on_one_thread
def descend_in_process(
    system: ProblemFunctions,
    options: Options,
    end_time: float,
    best_duration: float,
    guess: Guess,
) -> Result:
    """Descend from a guess in a worker process.

    Args:
        system: Functions of the problem.
        options: Options of the plan.
        end_time: Instant when the planning time is used up, by ``time.time`` [s].
        best_duration: Duration of the incumbent [s]; infinite without one.
        guess: The guess.

    Returns:
        The candidate, or None if there is no motion; the errors that occurred; and the
        records of all iterations.
    """
    options = replace(options, max_planning_time=max(end_time - time.time(), 1e-3))
    state = PlanState(system.problem, options, stop_requested=stop_requested)
    state.T_to_beat = best_duration
    with state.deadline.in_force():
        run(state, single(descent_work(system, options, guess, state)))
        best = best_of(state.candidates)
        if best and best.status in STOPPED and not best.confirmed:
            use_fallback(state, best.status)
    return best_of(state.candidates), state.failures, state.history


# -- warm starts -----------------------------------------------------------------------


def _warm_start_work(
    system: ProblemFunctions, former: WarmStart, state: PlanState
) -> Work:
    """Work that descends from a former motion."""
    warm = replace(state.options, trust_region=WARM_RADIUS * state.options.trust_region)
    if warm.method in SHOOTING:
        shares = interval_shares(warm.grid, warm.intervals)
        return shooting_work(system, warm, state, former.torque_iterate(system, shares))
    if warm.smoothing is None:
        # Near an optimum squared jumps would take four times as many programs.
        warm = replace(warm, smoothing=JUMPS_SHARE * former.duration)
    # Without a feasible iterate half of the time is left to other guesses.
    late = state.seconds + 0.5 * state.remaining_time

    def stop_if_late(loop: Loop) -> Status | None:
        found = any(item.feasible for item in state.kept_iterates)
        return None if found or state.seconds < late else loop.drop()

    return descent_work(system, warm, former, state, stop_if_late)


def _beatable(
    system: ProblemFunctions, state: PlanState, guesses: CachedGuesses
) -> bool:
    """Whether the motion from a warm start is slow enough for a search to beat it.

    Around an obstacle, or to another final configuration, a warm start may take a long
    detour. The first guess is the measure: it follows its path in minimum time, and
    good motions are faster, as they cut corners.
    """
    fixed = system.in_free_space and system.final_configuration is not None
    if fixed or system.parts or system.problem.scene.moving:
        return False
    if not state.exceeds_bound(1.0 + GAP, system.problem):
        return False
    first = next(guesses.since(0), None)
    if first is None or not first.timed:
        return False
    return bool(state.best_duration > (1.0 - GAP) * first.duration)
