"""Starts of a plan with one goal: which guesses are tried, and when it is enough.

The order does not depend on how many are asked for, nor on the number of processes:
more starts make the same candidates as fewer would, and then others; several processes
try guesses ahead, and those whose turn does not come are dropped.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from tominpmp.initial_guess.guess import FEW_LINES, Guess, initial_guesses
from tominpmp.initial_guess.parallel import (
    asked_to_stop,
    available_processes,
    ready,
    run_parallel,
)
from tominpmp.initial_guess.path_velocity import guesses_of
from tominpmp.initial_guess.segments import segmented_guesses
from tominpmp.initial_guess.unreachable import unreachable
from tominpmp.initial_guess.warm_start import WarmStart, warm_start
from tominpmp.motion.samples import Samples
from tominpmp.motion.trajectory import Trajectory
from tominpmp.options import Options
from tominpmp.planner.automatic_options import JUMPS_SHARE, SHOOTING
from tominpmp.planner.candidate import Candidate
from tominpmp.planner.coarse_search import (
    MOST_PATHS,
    TOO_SLOW,
    CachedGuesses,
    coarse_grids_apply,
    search,
)
from tominpmp.planner.descent import descent_work, stop_if_hopeless
from tominpmp.planner.plan_state import PlanState
from tominpmp.planner.torque_starts import (
    FEW_JOINTS,
    random_torque_starts,
    shooting_work,
    torques_may_lead,
)
from tominpmp.planner.work import Schedule, Work, run, use_fallback
from tominpmp.problem.problem import Problem
from tominpmp.status import STOPPED, Status
from tominpmp.stopping import Stop
from tominpmp.transcription.bspline import DEGREES
from tominpmp.transcription.grid import interval_shares
from tominpmp.transcription.problem_functions import ProblemFunctions

# Guesses for a goal on a frame, whose final configuration is free: straight lines alone
# in free space, unless few joints may have to swing.
LONE_FRAME_STARTS, FRAME_STARTS = FEW_LINES, 4
# Guesses for several segments whose accelerations are continuous.
SEGMENTED_STARTS = 2
# Guesses where obstacles move, for which a motion may wait, and those that are made
# while no motion is found.
MOVING_STARTS = 3
MOVING_RESCUE_STARTS = 16
# Torques are the last guess for arms of few joints.
FEW_JOINTS_RESCUE_STARTS = 2
# More guesses are made, up to this number, while no motion is found.
RESCUE_STARTS = 8
# Processes that are started at least where several are asked for; beyond the number of
# cores they would only wait for each other.
LEAST_PROCESSES = 2
# With less time than this everything runs in one process: to start others takes about
# two seconds [s].
TO_START = 5.0
# Guesses that are made for each process before any of them is tried: to make one may
# take a while.
BATCH = 4
# Processes hand over their candidates before the time is over: share of it, and [s].
HANDOVER_SHARE, HANDOVER = 0.02, 0.05
# Trust region of a warm start, in shares of the usual one.
WARM_RADIUS = 0.3
# A warm start that stays this far from any motion is dropped: one near a motion reaches
# it in a few iterations, else a search is the shorter way.
WARM_FAR = 0.05
# A search follows a warm start whose T exceeds this share of the first guess's T.
OUTDONE = 0.95


def usual_starts(system: ProblemFunctions, options: Options) -> tuple[int, int]:
    """How many guesses are tried where ``options.starts`` is None.

    Returns:
        The number of guesses, and its upper limit while there is no incumbent.
    """
    moving = bool(system.problem.scene.moving)
    usual = 1
    if options.objective == "time":
        if system.final_configuration is None:
            many = system.in_free_space and system.n > FEW_JOINTS
            usual = LONE_FRAME_STARTS if many else FRAME_STARTS
        usual = max(usual, MOVING_STARTS) if moving else usual
        if system.parts:
            usual = SEGMENTED_STARTS if options.control in DEGREES else 1
    swings = torques_may_lead(system)
    rescues = FEW_JOINTS_RESCUE_STARTS if swings else RESCUE_STARTS
    return usual, max(usual, MOVING_RESCUE_STARTS if moving else rescues)


def starts(
    state: PlanState, problem: Problem, motion: Trajectory | Samples | None = None
) -> Schedule[None]:
    """Begin with one guess after the other, a former motion being the first.

    Args:
        state: The plan.
        problem: Its problem, or that with one of its goals.
        motion: The former motion, if there is one.

    Raises:
        ProblemError: If no guess can be made: the goal is out of reach.
    """
    options, system = state.options, ProblemFunctions.of(problem)
    if motion is not None:
        former = warm_start(system, motion)
        candidate = yield _warm_start_work(system, former, state)
        found = candidate is not None and candidate.found
        if candidate is not None and candidate.duration >= former.duration:
            found = _keep_former(system, former, state, candidate) or found
        if found and (options.starts or 1) == 1 and not _outdone(system, state):
            return
    if options.method in SHOOTING:
        yield from random_torque_starts(system, state)
        return
    rng = np.random.default_rng(options.seed)
    usual, rescues = usual_starts(system, options)
    wanted = options.starts or usual
    searched = coarse_grids_apply(system, options)
    most = max(wanted, rescues)
    if searched and not system.in_free_space:
        most = max(most, usual + MOST_PATHS)
    make = guesses_of
    if system.parts:
        make = partial(segmented_guesses, smooth=options.control in DEGREES)
    guesses = make(system, most, rng, options.initial_duration, state.ends)
    first = next(guesses, None)
    if first is None:
        raise unreachable(system, rng)
    guesses = itertools.chain([first], guesses)
    if first.blocked:
        # A descent may still free the final configuration; more guesses would not.
        rescues = usual
        guesses = itertools.islice(guesses, max(wanted, rescues))
    if searched:
        cached = CachedGuesses(guesses)
        yield from search(system, state, cached, usual)
        if first.blocked:
            return
        # Where that has led to no motion, everything is tried in full.
        found = state.best_duration < np.inf
        guesses = cached.since(int(found))
        if found:
            # The first guess was tried, and the usual ones were compared.
            wanted, rescues = 0 if wanted == usual else wanted - 1, rescues - 1
    yield from _in_full(system, state, guesses, wanted, rescues)


def _in_full(
    system: ProblemFunctions,
    state: PlanState,
    guesses: Iterator[Guess],
    wanted: int,
    rescues: int,
) -> Schedule[None]:
    """Improve guesses on the grid that is asked for.

    Args:
        system: Functions of the problem.
        state: The plan.
        guesses: The guesses.
        wanted: How many are tried in any case.
        rescues: Upper limit while there is no incumbent.
    """
    options = state.options
    swings = torques_may_lead(system)
    several = options.processes > 1 and (state.left > TO_START or ready())
    ahead = Ahead(system, state, guesses) if several else None
    try:
        for number in itertools.count():
            if number >= rescues and swings and state.best_duration == np.inf:
                # Fewer starts than are asked for would try them now.
                swings = False
                yield from random_torque_starts(system, state)
            enough = state.best_duration < np.inf or number >= rescues
            if number >= wanted and enough:
                return
            # To make one may take a search: not before it is known to be wanted.
            left = max(wanted - number, 0)
            guess = ahead.next(left) if ahead else next(guesses, None)
            if guess is None:
                break
            if guess.timed and guess.duration > TOO_SLOW * state.best_duration:
                continue
            # The last one may take as long as it likes.
            stop = None
            if number + 1 < rescues and system.parts:
                stop = stop_if_hopeless(guess.duration)
            work = descent_work(system, options, guess, state, stop)
            if ahead is not None:
                work = replace(work, make=partial(ahead.result, number), repairs=0)
            yield work
        if swings and state.best_duration == np.inf:
            yield from random_torque_starts(system, state)
    finally:
        if ahead is not None and state.cut_short:
            state.candidates += ahead.left()


class Ahead:
    """Guesses that several processes try ahead of their turn.

    Args:
        system: Functions of the problem.
        state: The plan.
        guesses: The guesses.
    """

    def __init__(
        self, system: ProblemFunctions, state: PlanState, guesses: Iterator[Guess]
    ) -> None:
        self.system, self.state, self.guesses = system, state, guesses
        cores = max(available_processes(), LEAST_PROCESSES)
        self.processes = min(state.options.processes, cores)
        self.ready: list[Guess] = []
        self.made = self.first = 0
        self.run: Iterator[tuple[int, Result]] = iter(())
        self.results: dict[int, Result] = {}

    def next(self, wanted: int) -> Guess | None:
        """The next guess; batches hold ``wanted`` guesses, or one a process."""
        if not self.ready:
            size = min(wanted or self.processes, BATCH * self.processes)
            self.ready = list(itertools.islice(self.guesses, size))
            self.first, self.made = self.made, self.made + len(self.ready)
            left = self.state.left
            alone = replace(self.state.options, callback=None, processes=1)
            ends = time.time() + (1.0 - HANDOVER_SHARE) * left - HANDOVER
            task = partial(solve_alone, self.system, alone, ends)
            self.run = run_parallel(task, list(self.ready), self.processes, left)
        return self.ready.pop(0) if self.ready else None

    def result(self, number: int, *_: object) -> Candidate:
        """The candidate of a guess, when its turn has come.

        Raises:
            Stop: If it is late.
            Exception: The error with which its process has ended.
        """
        while number not in self.results:
            following = next(self.run, None)
            if following is None:
                raise Stop(requested=False)  # it was late, and is not waited for
            self.results[self.first + following[0]] = following[1]
        candidate, failures = self.results.pop(number)
        if candidate is None:
            raise failures[-1] if failures else Stop(requested=False)
        for record in candidate.history:
            self.state.show(record)
        return self._as_here(candidate)

    def left(self) -> list[Candidate]:
        """Candidates that were made and not asked for, the fastest first."""
        for number, result in self.run:
            self.results[self.first + number] = result
        made = [one for one, _ in self.results.values() if one is not None]
        return sorted(map(self._as_here, made), key=lambda one: one.duration)

    def _as_here(self, candidate: Candidate) -> Candidate:
        """A candidate of a process with the reason why it ended.

        A process is asked to stop at the end of the time, too: nobody interrupted the
        planning then.
        """
        asked = candidate.status is Status.INTERRUPTED
        if not asked or self.state.deadline.interrupted:
            return candidate
        return replace(candidate, status=Status.TIME_LIMIT)


Result = tuple[Candidate | None, list[Exception]]


def solve_alone(
    system: ProblemFunctions,
    options: Options,
    ends: float,
    guess: Guess,
) -> Result:
    """Improve a guess in a process of its own.

    Args:
        system: Functions of the problem.
        options: Options of the plan.
        ends: When the planning time is used up, on the clock of ``time.time`` [s].
        guess: The guess.

    Returns:
        The candidate, if it led to any motion, and the errors it ended with.
    """
    options = replace(options, max_planning_time=max(ends - time.time(), 1e-3))
    state = PlanState(system.problem, options, asked=asked_to_stop)
    with state.deadline.in_force():
        candidate = run(state, descent_work(system, options, guess, state))
        if candidate and candidate.status in STOPPED and not candidate.found:
            use_fallback(state, candidate.status)
    return state.incumbent or candidate, state.failures


# -- warm starts -----------------------------------------------------------------------


def _warm_start_work(
    system: ProblemFunctions, former: WarmStart, state: PlanState
) -> Work:
    """Work that improves a former motion."""
    near = replace(state.options, trust_region=WARM_RADIUS * state.options.trust_region)
    if near.method in SHOOTING:
        shares = interval_shares(near.grid, near.intervals)
        return shooting_work(system, near, state, former.torque_program(system, shares))
    if near.smoothing is None:
        # Squares of jumps take four times the programs near an optimum.
        near = replace(near, smoothing=JUMPS_SHARE * former.duration)
    hopeless = stop_if_hopeless(former.duration, WARM_FAR)
    return descent_work(system, near, former, state, hopeless)


def _keep_former(
    system: ProblemFunctions, former: WarmStart, state: PlanState, candidate: Candidate
) -> bool:
    """Keep a former motion that led to no faster one, if its replay holds."""
    kept = None if system.parts else former.remainder(system)
    if kept is None:
        return False
    same = replace(
        candidate, feasible=True, trajectory=kept, violations={}, layout=None
    )
    same = same.verified(system.problem, state.options)
    if same.duration < candidate.duration:
        state.amend(same)
    return same.found


def _outdone(system: ProblemFunctions, state: PlanState) -> bool:
    """Whether a former motion has led to one that a search may well beat.

    Past an obstacle, or to another configuration, it may lead the long way round.
    First guesses take their paths as fast as can be, and better motions cut corners.
    """
    fixed = system.in_free_space and system.final_configuration is not None
    if fixed or system.parts or system.problem.scene.moving:
        return False
    options = state.options
    rng = np.random.default_rng(options.seed)
    guesses = initial_guesses(system, 1, rng, options.initial_duration, state.ends)
    guess = next(guesses, None)
    if guess is None or not guess.timed:
        return False
    return bool(state.best_duration > OUTDONE * guess.duration)
