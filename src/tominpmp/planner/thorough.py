"""Thorough search: waves of starts of all kinds, while there is time for them.

The motion of a plan with less effort is found first, to its last stage; then come waves
of starts on coarse grids: detours, paths around obstacles, other configurations at the
goal, motions of the arm without its weight, and random torques. A coarse motion that
promises to be faster than the incumbent is finished, and if it is faster it has the
last stages too. So a longer search never ends with a slower motion.
"""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from tominpmp.dynamics import RobotDynamics
from tominpmp.initial_guess.bumps import SPREADS, bumped, bumps
from tominpmp.initial_guess.guess import Guess
from tominpmp.initial_guess.path_velocity import guesses_of
from tominpmp.planner.candidate import Candidate
from tominpmp.planner.coarse_search import CoarseSearch, coarse_grids_apply
from tominpmp.planner.descent import torques_rule
from tominpmp.planner.improvements import improvements, with_exact_switches
from tominpmp.planner.plan_state import PlanState
from tominpmp.planner.torque_starts import (
    FEW_JOINTS,
    random_torque_starts,
    torques_may_lead,
)
from tominpmp.planner.work import Schedule
from tominpmp.transcription.problem_functions import ProblemFunctions

# Starts of a wave, how many waves there are without a time limit, and at most.
WAVE, WAVES, MOST_WAVES = 8, 4, 1000
# The search ends where the gap to the lower bound is at most this.
PROVEN = 1e-3
# Seeds of the kinds of starts, which do not depend on each other.
DETOUR, GUESS, AROUND_BEST = 1, 2, 3


def thorough_search(state: PlanState) -> Schedule[None]:
    """Search on for faster motions.

    Args:
        state: The plan, whose incumbent is that of a plan with less effort.
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
    before = state.best_duration
    yield from _with_exact_switches(state)
    if state.best_duration < before:
        yield from improvements(state)
    state.complete = True
    most = WAVES if options.max_planning_time is None else MOST_WAVES
    for number, search in itertools.product(range(most), searches):
        if state.best_duration <= (1.0 + PROVEN) * state.lower_bound(problem).T:
            return
        before = state.best_duration
        yield from search.wave(number)
        if state.best_duration < before:
            yield from _with_exact_switches(state)
            yield from improvements(state)


def _with_exact_switches(state: PlanState) -> Schedule[None]:
    """Place the switches of a small arm with nothing around it exactly.

    Their structure is looked at only: other ones come from other starts.
    """
    best, options = state.incumbent, state.options
    if best is None:
        return
    system = ProblemFunctions.of(state.problem.alternative_of(best.trajectory))
    small = system.in_free_space and system.n <= FEW_JOINTS
    plain = state.problem.motion_limits is None and options.control == "auto"
    plain = plain and options.refine == "auto"
    if small and plain and not options.control_period:
        yield from with_exact_switches(state, replace(options, starts=1))


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
        self.shot: Candidate | None = None
        self.shots = random_torque_starts(system, state, MOST_WAVES)

    def _rng(self, kind: int) -> np.random.Generator:
        return np.random.default_rng([self.options.seed, kind])

    def wave(self, number: int) -> Schedule[None]:
        """Make the candidates of a wave.

        Args:
            number: Its number, from 0.
        """
        if self.coarse is None:
            self._begin()
        if self.coarse is None:
            return
        turns = itertools.islice(itertools.cycle(self.sources), WAVE)
        guesses = (next(source, None) for source in turns)
        found = (guess for guess in guesses if guess is not None)
        # In every second wave a guess becomes the motion it leads to without weight.
        weighs = number % 2 == 0 or not np.any(self.system.problem.robot.gravity)
        lighter = None if weighs else self._weightless
        yield from self.coarse.probes(found, prepared=lighter)
        if torques_may_lead(self.system):
            with contextlib.suppress(StopIteration):
                self.shot = yield self.shots.send(self.shot)

    def _begin(self) -> None:
        """Prepare the sources of starts."""
        system, options = self.system, self.options
        every = guesses_of(
            system,
            MOST_WAVES * WAVE,
            self._rng(GUESS),
            options.initial_duration,
            self.state.ends,
        )
        first = next(every, None)
        if first is None:
            return
        torques = torques_rule(system, first)
        self.coarse = CoarseSearch(system, options, self.state, torques=torques)
        straight = [first, *itertools.islice(every, 1)]
        line = next((guess for guess in straight if guess.timed), straight[-1])
        self.sources = [
            bumps(system, line, self._rng(DETOUR)),
            itertools.chain(straight, every),
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

    def _weightless(self, guess: Guess) -> Schedule[Guess]:
        """The motion that a guess leads to where nothing has a weight."""
        system, spare = self.system.without_self_collision, self.state.fallback
        robot = system.problem.robot.with_changes(gravity=np.zeros(3))
        light = replace(system, dynamics=RobotDynamics(robot, dry=False))
        search = CoarseSearch(light, self.options, self.state, torques=True)
        rough = yield from search.solve_coarse(guess)
        self.state.fallback = spare  # that one has its weight
        if rough is None:
            return guess
        return Guess.of_motion(guess.name, rough.candidate.trajectory, len(guess.t))
