"""Thorough search: waves of starts of all kinds, as long as planning time remains.

A plan with effort "thorough" first completes all stages of a plan with less effort.
Waves of starts on coarse grids follow: detours, paths around obstacles, other final
configurations, and random torques. A coarse motion that predicts a gain over the
incumbent is finished; if it is faster, the improvements are repeated for it. A longer
search therefore never ends with a slower motion.
"""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Iterator

import numpy as np

from tominpmp.initial_guess.bumps import SPREADS, bumped, bumps
from tominpmp.initial_guess.guess import Guess, GuessRequest
from tominpmp.initial_guess.path_velocity import guesses_of
from tominpmp.planner.candidate import Candidate
from tominpmp.planner.coarse_search import CoarseSearch, coarse_grids_apply
from tominpmp.planner.descent import torques_rule
from tominpmp.planner.improvements import improvements
from tominpmp.planner.plan_state import PlanState
from tominpmp.planner.torque_starts import random_torque_starts, torques_may_lead
from tominpmp.planner.work import Schedule
from tominpmp.transcription.problem_functions import ProblemFunctions

# Starts of a wave, number of waves without a time limit, and most waves with one.
WAVE, WAVES, MOST_WAVES = 8, 4, 1000
# The search ends where the gap to the lower bound is at most this.
PROVEN = 1e-3
# Seeds of the independent random streams of the kinds of starts.
DETOUR, GUESS, AROUND_BEST = 1, 2, 3


def thorough_search(state: PlanState) -> Schedule[None]:
    """Continue the search for faster motions, if the effort is "thorough".

    Args:
        state: The plan, whose incumbent is the result of a plan with less effort.
    """
    options, problem = state.options, state.problem
    if options.effort != "thorough":
        return
    systems = [ProblemFunctions.of(part) for part in problem.alternatives]
    searches = [
        Waves(system, state)
        for system in systems
        if coarse_grids_apply(system, options)
    ]
    if not searches:
        return
    state.complete = True
    most = WAVES if options.max_planning_time is None else MOST_WAVES
    for _, search in itertools.product(range(most), searches):
        if state.best_duration <= (1.0 + PROVEN) * state.lower_bound(problem).T:
            return
        before = state.best_duration
        yield from search.wave()
        if state.best_duration < before:
            yield from improvements(state)


class Waves:
    """Waves of starts for a problem with one goal.

    Args:
        system: Functions of the problem.
        state: The plan.
    """

    def __init__(self, system: ProblemFunctions, state: PlanState) -> None:
        self.system, self.options, self.state = system, state.options, state
        self.coarse: CoarseSearch | None = None
        self.sources: list[Iterator[Guess | None]] = []
        self.answer: Candidate | None = None
        self.starts = random_torque_starts(system, state, MOST_WAVES)

    def _rng(self, kind: int) -> np.random.Generator:
        return np.random.default_rng([self.options.seed, kind])

    def wave(self) -> Schedule[None]:
        """Make the candidates of a wave."""
        if self.coarse is None:
            self._begin()
        if self.coarse is None:
            return
        turns = itertools.islice(itertools.cycle(self.sources), WAVE)
        guesses = (next(source, None) for source in turns)
        made = (guess for guess in guesses if guess is not None)
        yield from self.coarse.probes(made)
        if torques_may_lead(self.system):
            with contextlib.suppress(StopIteration):
                self.answer = yield self.starts.send(self.answer)

    def _begin(self) -> None:
        """Prepare the sources of starts."""
        system, options = self.system, self.options
        count, rng = MOST_WAVES * WAVE, self._rng(GUESS)
        guesses = guesses_of(system, GuessRequest(count, rng, options.initial_duration))
        first = next(guesses, None)
        if first is None:
            return
        torques = torques_rule(system, first)
        self.coarse = CoarseSearch(system, options, self.state, torques=torques)
        straight = [first, *itertools.islice(guesses, 1)]
        line = next((guess for guess in straight if guess.timed), straight[-1])
        self.sources = [
            bumps(system, line, self._rng(DETOUR)),
            itertools.chain(straight, guesses),
            self._around_best(),
        ]

    def _around_best(self) -> Iterator[Guess | None]:
        """Detours from the incumbent; None while there is no incumbent."""
        rng = self._rng(AROUND_BEST)
        for spread in itertools.cycle(SPREADS):
            heights = spread * rng.normal(size=(2, self.system.n))
            best = self.state.incumbent
            if best is None:
                yield None
                continue
            guess = Guess.of_motion(best.name, best.trajectory)
            yield bumped(self.system, guess, heights)
