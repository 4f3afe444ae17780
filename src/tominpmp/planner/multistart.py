"""Multistart: how many guesses are tried, in which order, and when it is enough.

The order does not depend on how many are asked for, nor on the number of processes:
more starts make the same candidates as fewer would, and then others; several processes
try guesses ahead, and what the turn does not come to is let go.
"""

from __future__ import annotations

import itertools
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from tominpmp.initial_guess.guess import FEW_LINES, Guess
from tominpmp.initial_guess.parallel import (
    asked_to_stop,
    available_processes,
    ready,
    run_parallel,
)
from tominpmp.initial_guess.path_velocity import guesses_of
from tominpmp.initial_guess.segments import SegmentedGuess, segmented_guesses
from tominpmp.initial_guess.warm_start import WarmStart
from tominpmp.options import Options
from tominpmp.planner.candidate import Candidate
from tominpmp.planner.coarse_search import coarse_grids_apply
from tominpmp.planner.descent import descended, stop_if_hopeless
from tominpmp.planner.former_motion import outdone, solve_from_warm_start
from tominpmp.planner.plan_state import PlanState
from tominpmp.planner.rescue import keep_best_on_interrupt
from tominpmp.planner.search import CachedGuesses, Search, further_paths
from tominpmp.planner.torque_starts import TORQUE_START_OPTIONS, random_torque_starts
from tominpmp.planner.unreachable import unreachable
from tominpmp.status import Status
from tominpmp.stopping import Stop
from tominpmp.transcription.bspline import DEGREES
from tominpmp.transcription.problem_functions import ProblemFunctions

# Guesses for a goal on a frame, whose final configuration is free: straight lines alone
# in free space, unless few joints may have to swing.
LONE_FRAME_STARTS, FRAME_STARTS = FEW_LINES, 4
# Guesses for several segments whose accelerations are continuous.
SEGMENTED_STARTS = 2
# Guesses where obstacles move, which may be let pass or be passed, and those that are
# made while none has led to a motion.
MOVING_STARTS = 3
MOVING_RESCUE_STARTS = 16
# A timed guess this much slower than a motion that was found is not worth its time.
TOO_SLOW = 1.6
# Torques are the last guess for arms with so many joints.
FEW_MOTORS, FEW_MOTORS_RESCUE_STARTS = 3, 2
# More guesses are made, up to this number, while none has led to a motion.
RESCUE_STARTS = 8
# Processes that are started at least where several are asked for; beyond the number of
# cores they would only wait for each other.
LEAST_PROCESSES = 2
# Where there is less time than this, none are started, which alone takes about two
# seconds: one process would have found something by then [s].
TO_START = 5.0
# Guesses that are made for each process before any of them is tried: to make one may
# take a while.
BATCH = 4
# Processes end before the time is over by this share of it, and by so much, to hand
# over what they have found [s].
HANDOVER_SHARE, HANDOVER = 0.02, 0.05


class Count(NamedTuple):
    """How many guesses are tried.

    Attributes:
        wanted: So many in any case.
        usual: So many where that is left to the planner.
        rescues: So many while none has led to a motion.
        swings: Whether torques are tried when that many have led to none.
    """

    wanted: int
    usual: int
    rescues: int
    swings: bool

    @classmethod
    def of(cls, system: ProblemFunctions, options: Options) -> Count:
        """What the options ask for, or what fits the problem."""
        moving = bool(system.problem.scene.moving)
        usual = 1
        if options.objective == "time":
            if system.final_configuration is None:
                many = system.in_free_space and system.n > FEW_MOTORS
                usual = LONE_FRAME_STARTS if many else FRAME_STARTS
            usual = max(usual, MOVING_STARTS) if moving else usual
            if system.parts:
                usual = SEGMENTED_STARTS if options.control in DEGREES else 1
        swings = torques_may_lead(system)
        rescues = FEW_MOTORS_RESCUE_STARTS if swings else RESCUE_STARTS
        rescues = max(usual, MOVING_RESCUE_STARTS if moving else rescues)
        return cls(options.starts or usual, usual, rescues, swings)

    def less(self, done: int) -> Count:
        """What is left when so many have led to a motion."""
        wanted = self.wanted - done
        if done and self.usual > 1 and self.wanted == self.usual:
            wanted = 0  # they were compared
        return self._replace(wanted=wanted, rescues=self.rescues - done)

    @property
    def most(self) -> int:
        """Largest number of guesses."""
        return max(self.wanted, self.rescues)


def make_candidates(
    system: ProblemFunctions,
    former: WarmStart | SegmentedGuess | None,
    options: Options,
    progress: PlanState,
) -> Iterator[Candidate | None]:
    """Solve from one initial guess after the other, a former motion being the first.

    Yields:
        Candidates; None for those that lead to nothing, or promise nothing.

    Raises:
        ProblemError: If no guess can be made: the goal is out of reach.
    """
    if former is not None:
        progress.begin()
        solve = partial(solve_from_warm_start, system, options, former, progress)
        candidate = keep_best_on_interrupt(
            system.problem, options, progress, former.name, solve
        )
        yield _noted(progress, candidate)
        found = candidate is not None and candidate.found
        enough = (options.starts or 1) == 1
        if found and enough and not outdone(system, options, progress):
            return
    if options.method in ("adjoint", "penalty"):
        yield from random_torque_starts(system, options, progress)
        return
    yield from _from_guesses(system, options, progress)


def _from_guesses(
    system: ProblemFunctions, options: Options, progress: PlanState
) -> Iterator[Candidate | None]:
    rng = np.random.default_rng(options.seed)
    count = Count.of(system, options)
    make = guesses_of
    if system.parts:
        make = partial(segmented_guesses, smooth=options.control in DEGREES)
    searched = coarse_grids_apply(system, options)
    most = count.most
    if searched and not system.in_free_space:
        most = max(most, count.usual + further_paths(system))
    made = make(system, most, rng, options.initial_duration, progress.ends)
    first = next(made, None)
    if first is None:
        raise unreachable(system, rng)
    guesses: Iterator[Guess] = itertools.chain([first], made)
    if first.blocked:
        # A motion may end where none was looked for; more of the same would not.
        count = count._replace(rescues=count.usual)
        guesses = itertools.islice(guesses, count.most)
    if searched:
        remembered = CachedGuesses(guesses)
        search = Search(
            system, options, progress, remembered, count.usual, swings=count.swings
        )
        alone = _Source(system, options, progress, iter(()))
        yield from search.run(partial(alone.solve, 0))
        if search.stopped or first.blocked:
            return
        # Where that has led to nothing, everything is tried in full.
        done = 0 if progress.best == np.inf else 1
        guesses, count = remembered.since(done), count.less(done)
    yield from _in_full(system, options, progress, guesses, count)


def _in_full(
    system: ProblemFunctions,
    options: Options,
    progress: PlanState,
    guesses: Iterator[Guess],
    count: Count,
) -> Iterator[Candidate | None]:
    """Improve guesses on the grid that is asked for."""
    source: _Source = _Source(system, options, progress, guesses)
    left = progress.left
    if options.processes > 1 and (left > TO_START or ready()):
        source = _SourceOfMany(system, options, progress, guesses)
    swings = count.swings
    for number in itertools.count():
        if number >= count.rescues and swings and progress.best == np.inf:
            # Fewer starts than are asked for would try them now.
            swings = False
            yield from random_torque_starts(
                system, replace(options, **TORQUE_START_OPTIONS), progress
            )
        enough = progress.best < np.inf or number >= count.rescues
        if number >= count.wanted and enough:
            break
        # None is made, which may take a search, before it is known to be wanted.
        guess = source.next(max(count.wanted - number, 0))
        if guess is None:
            break
        if guess.timed and guess.duration > TOO_SLOW * progress.best:
            yield None
            continue
        # The last one may take as long as it likes.
        judge = None
        if number + 1 < count.rescues and isinstance(guess, SegmentedGuess):
            judge = stop_if_hopeless(guess.duration)
        try:
            with progress.judged(judge):
                candidate = source.solve(number, guess)
        except Stop:
            # The others may have found something by then.
            yield from (_noted(progress, candidate) for candidate in source.left())
            raise
        yield _noted(progress, candidate)
    if swings and progress.best == np.inf:
        yield from random_torque_starts(
            system, replace(options, **TORQUE_START_OPTIONS), progress
        )


def _noted(progress: PlanState, candidate: Candidate | None) -> Candidate | None:
    if candidate is not None:
        progress.best = min(progress.best, candidate.duration)
    return candidate


def torques_may_lead(system: ProblemFunctions) -> bool:
    """Whether torques from nowhere may lead where no path does.

    With nothing in the way it is the torques that are too small for guesses of a path:
    a small arm may have to swing.
    """
    smooth = system.problem.motion_limits is not None
    return system.in_free_space and system.n <= FEW_MOTORS and not smooth


class _Source:
    """Guesses, and what they lead to, one after the other."""

    def __init__(
        self,
        system: ProblemFunctions,
        options: Options,
        progress: PlanState,
        guesses: Iterator[Guess],
    ) -> None:
        self.system, self.options, self.progress = system, options, progress
        self.guesses = guesses

    def next(self, ahead: int) -> Guess | None:
        """The next guess; None if there are no more."""
        return next(self.guesses, None)

    def solve(self, number: int, guess: Guess) -> Candidate | None:
        """What a guess leads to."""
        self.progress.begin()
        solve = partial(descended, self.system, self.options, guess, self.progress)
        problem = self.system.problem
        return keep_best_on_interrupt(
            problem, self.options, self.progress, guess.name, solve
        )

    def left(self) -> list[Candidate]:
        """Candidates that were made and not asked for, the fastest first."""
        return []


class _SourceOfMany(_Source):
    """Guesses that several processes try ahead of their turn."""

    def __init__(
        self,
        system: ProblemFunctions,
        options: Options,
        progress: PlanState,
        guesses: Iterator[Guess],
    ) -> None:
        super().__init__(system, options, progress, guesses)
        cores = max(available_processes(), LEAST_PROCESSES)
        self.processes = min(options.processes, cores)
        self.ready: deque[Guess] = deque()
        self.first = 0
        self.made = 0
        self.run: Iterator[tuple[int, _Result]] = iter(())
        self.results: dict[int, _Result] = {}

    def next(self, ahead: int) -> Guess | None:
        """The next guess; so many are wanted ahead, or one for each process."""
        if not self.ready:
            batch: list[Guess] = []
            size = min(ahead or self.processes, BATCH * self.processes)
            while len(batch) < size:
                guess = super().next(0)
                if guess is None:
                    break
                batch.append(guess)
            self._begin(batch)
        return self.ready.popleft() if self.ready else None

    def _begin(self, batch: list[Guess]) -> None:
        self.ready.extend(batch)
        self.first, self.made = self.made, self.made + len(batch)
        start = self.progress.begin(len(batch))
        left = self.progress.left
        alone = replace(self.options, callback=None, processes=1)
        ends = time.time() + (1.0 - HANDOVER_SHARE) * left - HANDOVER
        task = partial(solve_alone, self.system, alone, ends)
        numbered = [(start + k, guess) for k, guess in enumerate(batch)]
        self.run = run_parallel(task, numbered, self.processes, left)

    def solve(self, number: int, guess: Guess) -> Candidate | None:
        """What a guess leads to, when its turn has come."""
        while number not in self.results:
            following = next(self.run, None)
            if following is None:
                raise Stop(requested=False)  # it was late, and is not waited for
            self.results[self.first + following[0]] = following[1]
        candidate, failures = self.results.pop(number)
        self.progress.failures.extend(failures)
        if candidate is not None:
            self.progress.replay(candidate.history)
            if candidate.verification is not None:
                self.progress.replayed(candidate.verification.seconds)
        return self._as_here(candidate)

    def left(self) -> list[Candidate]:
        """Candidates that were made and not asked for, the fastest first."""
        for number, result in self.run:
            self.results[self.first + number] = result
        made = [self._as_here(candidate) for candidate, _ in self.results.values()]
        found = [candidate for candidate in made if candidate is not None]
        return sorted(found, key=lambda candidate: candidate.duration)

    def _as_here(self, candidate: Candidate | None) -> Candidate | None:
        """A candidate of a process with the reason why it ended.

        A process is asked to stop at the end of the time, too: nobody interrupted the
        planning then.
        """
        asked = candidate is not None and candidate.status is Status.INTERRUPTED
        if candidate is None or not asked or self.progress.deadline.interrupted:
            return candidate
        return replace(candidate, status=Status.TIME_LIMIT)


_Result = tuple[Candidate | None, list[Exception]]


def solve_alone(
    system: ProblemFunctions,
    options: Options,
    ends: float,
    numbered: tuple[int, Guess],
) -> _Result:
    """Improve a guess in a process of its own.

    Args:
        system: The problem.
        options: Options of the plan.
        ends: When the planning time is used up, on the clock of ``time.time`` [s].
        numbered: Number of the start, and the guess.

    Returns:
        The candidate, if it led to anything, and what went wrong.
    """
    number, guess = numbered
    left = max(ends - time.time(), 1e-3)
    options = replace(options, max_planning_time=left)
    progress = PlanState(options, first=number, asked=asked_to_stop)
    progress.begin()
    solve = partial(descended, system, options, guess, progress)
    with progress.deadline.in_force():
        candidate = keep_best_on_interrupt(
            system.problem, options, progress, guess.name, solve
        )
    return candidate, progress.failures
