"""Thorough search: waves of starts of all kinds, while there is time for them.

What a plan with less effort finds is found first, to its last stage; then come waves of
starts on coarse grids: detours, paths around obstacles, other configurations at the
goal, motions of the arm without its weight, and torques from nowhere. What promises to
be faster than the best motion is finished, and if it is faster it has the last stages
too. So a longer search never ends with a slower motion.
"""

from __future__ import annotations

import itertools
import logging
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from tominpmp.dynamics import RobotDynamics
from tominpmp.initial_guess.bumps import SPREADS, bumped, bumps
from tominpmp.initial_guess.guess import Guess
from tominpmp.initial_guess.path_velocity import guesses_of
from tominpmp.options import Options
from tominpmp.planner.candidate import Candidate, fastest
from tominpmp.planner.coarse_search import CoarseSearch, coarse_grids_apply
from tominpmp.planner.descent import torques_rule
from tominpmp.planner.exact_switches import with_exact_switches
from tominpmp.planner.finer_grid import on_finer_grid
from tominpmp.planner.optimality import certified
from tominpmp.planner.plan_state import PlanState
from tominpmp.planner.torque_starts import TORQUE_START_OPTIONS, random_torque_starts
from tominpmp.problem import Problem
from tominpmp.status import STOPPED
from tominpmp.stopping import Stop
from tominpmp.transcription.problem_functions import ProblemFunctions

logger = logging.getLogger(__name__)

# Starts of a wave, how many waves there are without a time limit, and at most.
WAVE, WAVES, MOST_WAVES = 8, 4, 1000
# A motion this close to what none can beat is not searched on from.
PROVEN = 1e-3
# For so many motors torques from nowhere are tried too, and switches placed exactly.
FEW_MOTORS = 3
# Seeds of the kinds of starts, which do not depend on each other.
DETOUR, GUESS, AGAIN = 1, 2, 3

Stages = Callable[[Candidate], Iterator[Candidate]]


def thorough_search(
    problem: Problem,
    options: Options,
    progress: PlanState,
    candidates: Sequence[Candidate],
    stages: Stages,
) -> Iterator[Candidate]:
    """Search on for faster motions.

    Args:
        problem: The problem.
        options: Options of the plan.
        progress: Time limit, and the duration of the best motion so far.
        candidates: What less effort has led to.
        stages: The last stages of a plan, for a motion.

    Yields:
        Candidates, the last stages of those that are the best then among them.
    """
    if options.effort != "thorough" or options.objective != "time":
        return
    searches = [
        Waves(ProblemFunctions.of(part), options, progress)
        for part in problem.alternatives
        if coarse_grids_apply(ProblemFunctions.of(part), options)
    ]
    if not searches:
        return
    best = fastest(candidates)
    progress.best = np.inf if best is None else best.duration
    if best is not None:
        for last in exactly(problem, options, progress, best):
            best = last if _faster(last, best) else best
            yield last
    most = WAVES if options.max_planning_time is None else MOST_WAVES
    try:
        for number, search in itertools.product(range(most), searches):
            if _proven(problem, progress):
                return
            for candidate in search.wave(number, best):
                if candidate.status in STOPPED and not _faster(candidate, best):
                    return
                yield candidate
                if _faster(candidate, best):
                    best = candidate
                    for last in _to_the_end(problem, options, progress, best, stages):
                        best = last if _faster(last, best) else best
                        yield last
            if search.stopped:
                return
    except Stop as stop:
        if stop.requested:
            raise
        # The time is used up, as it should be.


def _to_the_end(
    problem: Problem,
    options: Options,
    progress: PlanState,
    best: Candidate,
    stages: Stages,
) -> Iterator[Candidate]:
    """The last stages for a motion that is the best one now."""
    for candidate in stages(best):
        best = candidate if _faster(candidate, best) else best
        yield candidate
    yield from exactly(problem, options, progress, best)


def exactly(
    problem: Problem, options: Options, progress: PlanState, best: Candidate
) -> Iterator[Candidate]:
    """What is left to be had of a motion: exact switches, or a finer grid.

    Exact switches are for small arms with nothing around them. Their structure is
    looked at only: other ones come from other starts.
    """
    system = ProblemFunctions.of(problem.alternative_of(best.trajectory))
    small = system.in_free_space and system.n <= FEW_MOTORS
    plain = problem.motion_limits is None and options.control == "auto"
    plain = plain and options.refine == "auto"
    if small and plain and not options.control_period:
        one = replace(options, starts=1)
        for candidate in with_exact_switches(problem, one, progress, [best]):
            if _faster(candidate, best):
                progress.best = min(progress.best, candidate.duration)
                yield candidate
                best = candidate
    lavish = options if options.refine is None else replace(options, refine="grid")
    for candidate in on_finer_grid(problem, lavish, progress, [best]):
        if _faster(candidate, best):
            yield candidate
            yield from certified(problem, options, progress, [candidate])


def _faster(candidate: Candidate, best: Candidate | None) -> bool:
    return candidate.found and (best is None or candidate.duration < best.duration)


def _proven(problem: Problem, progress: PlanState) -> bool:
    """Whether next to nothing is to be gained any more."""
    bound = progress.lower_bound(problem).T
    return progress.best <= (1.0 + PROVEN) * bound


class Waves:
    """Waves of starts for a problem with one goal.

    Args:
        system: The problem.
        options: Options of the plan.
        progress: Time limit, and the duration of the best motion so far.
    """

    def __init__(
        self, system: ProblemFunctions, options: Options, progress: PlanState
    ) -> None:
        self.system, self.options, self.progress = system, options, progress
        self.coarse: CoarseSearch | None = None
        self.sources: list[Iterator[Guess]] = []
        self.random_torque_starts = self._shots()
        self.best: Guess | None = None

    @property
    def stopped(self) -> bool:
        """Whether it was time to stop."""
        return self.coarse is not None and self.coarse.stopped

    def _rng(self, kind: int) -> np.random.Generator:
        return np.random.default_rng([self.options.seed, kind])

    def wave(self, number: int, best: Candidate | None) -> Iterator[Candidate]:
        """Make the candidates of a wave.

        Args:
            number: Its number, from 0.
            best: The best motion so far, if there is one.
        """
        if self.coarse is None:
            self._begin()
        if self.coarse is None:
            return
        if best is not None:
            self.best = Guess.of_motion(best.name, best.trajectory)
        turns = itertools.cycle(self.sources)
        guesses = (next(source, None) for source in itertools.islice(turns, WAVE))
        tried = self._lighter(number, guesses)
        yield from self.coarse.probes(tried, WAVE + 1)
        if not self.coarse.stopped:
            yield from itertools.islice(self.random_torque_starts, 1)

    def _begin(self) -> None:
        """Prepare the sources of starts."""
        system, options = self.system, self.options
        every = guesses_of(
            system,
            MOST_WAVES * WAVE,
            self._rng(GUESS),
            options.initial_duration,
            self.progress.ends,
        )
        first = next(every, None)
        if first is None:
            return
        torques = torques_rule(system, first)
        self.coarse = CoarseSearch(system, options, self.progress, torques=torques)
        straight = [first, *itertools.islice(every, 1)]
        line = next((guess for guess in straight if guess.timed), straight[-1])
        self.sources = [
            bumps(system, line, self._rng(DETOUR)),
            itertools.chain(straight, every),
            self._around_best(),
        ]

    def _around_best(self) -> Iterator[Guess]:
        """Detours from the best motion."""
        rng = self._rng(AGAIN)
        for spread in itertools.cycle(SPREADS):
            heights = spread * rng.normal(size=(2, self.system.n))
            if self.best is not None:
                yield bumped(self.system, self.best, heights)

    def _lighter(self, number: int, guesses: Iterable[Guess | None]) -> Iterator[Guess]:
        """Guesses; in every second wave what they lead to without weight instead."""
        gravity = self.system.problem.robot.gravity
        weightless = number % 2 == 1 and bool(np.any(gravity))
        for guess in guesses:
            if guess is None:
                continue
            yield self._weightless(guess) if weightless else guess

    def _weightless(self, guess: Guess) -> Guess:
        """The motion that a guess leads to where nothing has a weight."""
        assert self.coarse is not None  # noqa: S101
        system = self.system.without_self_collision
        robot = system.problem.robot.with_changes(gravity=np.zeros(3))
        light = replace(system, dynamics=RobotDynamics(robot, dry=False))
        search = CoarseSearch(light, self.options, self.progress, torques=True)
        rough = search.rough(guess)
        if rough is None:
            return guess
        return Guess.of_motion(guess.name, rough.candidate.trajectory, len(guess.t))

    def _shots(self) -> Iterator[Candidate]:
        """Torques from nowhere, improved in full."""
        system = self.system
        smooth = system.problem.motion_limits is not None
        if not system.in_free_space or system.n > FEW_MOTORS or smooth:
            return
        shooting = replace(self.options, **TORQUE_START_OPTIONS)
        for candidate in random_torque_starts(
            system, shooting, self.progress, MOST_WAVES
        ):
            if candidate is not None:
                yield candidate
