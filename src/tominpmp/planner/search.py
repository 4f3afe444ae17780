"""Search for the best motion: the first descents, and what is tried beyond them.

What is worth a try is decided by how far a motion is above what none can beat: most
motions that speed limits rule are within a per cent of that, and need nothing else.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from tominpmp.initial_guess.bumps import bumps
from tominpmp.initial_guess.guess import SAMPLED, Guess
from tominpmp.options import Options
from tominpmp.planner.candidate import Candidate
from tominpmp.planner.coarse_search import NEARLY, CoarseSearch
from tominpmp.planner.descent import torques_rule
from tominpmp.planner.plan_state import PlanState
from tominpmp.planner.torque_starts import TORQUE_START_OPTIONS, random_torque_starts
from tominpmp.status import STOPPED, IterationRecord, Status
from tominpmp.stopping import Stop
from tominpmp.transcription.problem_functions import ProblemFunctions

# A motion is not searched on from that is at most this much above what none can beat.
GAP = 0.03
# Arms with so many joints at most are searched on where nothing is in their way: they
# may swing, or turn their elbow over. How many detours are tried at least.
FEW_JOINTS, DETOURS = 3, 6
# Arms of more joints, up to so many, are where a motion takes more than so many times
# what none can beat: of 70 random goals (speeds times four) five did, and three of them
# were 1 to 4 % longer than need be. Of whole robots a start takes seconds.
FAR_ABOVE, MOST_JOINTS = 2.0, 10
# Iterations on the asked grid after which a motion among obstacles has to be
# near one that none can beat by much; else coarse grids are tried.
# It leads astray that is ever so much above that.
DIRECT, ASTRAY = 8, 0.1
# After so many starts in a row that promise nothing more it is enough: with few joints,
# and with many.
IN_VAIN, MANY_IN_VAIN = 4, 8
# Further paths among obstacles, and for arms of few joints, whose bounds say little: of
# 42 problems of a planar arm seven ended 0.2 to 45 % faster by the seventh to
# fourteenth, two 0.1 and 0.2 % slower, in 1.1 times the time; 28 found nothing more.
PATHS, PATHS_OF_FEW = 2, 14
# And where obstacles move, beside which a path may be gone along sooner or later.
PATHS_WHILE_MOVING = 6

# Torques from nowhere that are tried where a motion has to swing.
SHOTS = 3

Solve = Callable[[Guess], Candidate | None]


def further_paths(system: ProblemFunctions) -> int:
    """How many paths among obstacles are tried beyond the first descents."""
    if system.n <= FEW_JOINTS:
        return PATHS_OF_FEW
    return PATHS_WHILE_MOVING if system.problem.scene.moving else PATHS


class CachedGuesses:
    """Guesses that can be gone through again.

    Args:
        guesses: The guesses; one is made when it is first asked for.
    """

    def __init__(self, guesses: Iterator[Guess]) -> None:
        self._source = guesses
        self.made: list[Guess] = []

    def get(self, number: int) -> Guess | None:
        """The guess of a number, from 0; None if there are not so many."""
        while len(self.made) <= number:
            guess = next(self._source, None)
            if guess is None:
                return None
            self.made.append(guess)
        return self.made[number]

    def since(self, number: int) -> Iterator[Guess]:
        """The guesses from a number on."""
        for index in itertools.count(number):
            guess = self.get(index)
            if guess is None:
                return
            yield guess


class Search:
    """Search for the best motion of a problem with one goal.

    Args:
        system: The problem.
        options: Options of the plan.
        progress: Time limit and callback, and the duration of the best motion so far.
        guesses: Guesses, the most promising first.
        wanted: How many of them are compared before one of them is finished.
        swings: Whether torques may lead where no path does.
    """

    def __init__(
        self,
        system: ProblemFunctions,
        options: Options,
        progress: PlanState,
        guesses: CachedGuesses,
        wanted: int,
        *,
        swings: bool,
    ) -> None:
        self.system, self.options, self.progress = system, options, progress
        self.guesses, self.wanted, self.swings = guesses, wanted, swings
        self.stopped = False

    def run(self, solve: Solve) -> Iterator[Candidate]:
        """Make the candidates.

        Args:
            solve: Improves a guess on the grid that is asked for.
        """
        system, options, progress = self.system, self.options, self.progress
        guesses = list(itertools.islice(self.guesses.since(0), self.wanted))
        if not guesses:
            return
        first = next((guess for guess in guesses if guess.timed), guesses[0])
        torques = torques_rule(system, first)
        coarse = CoarseSearch(system, options, progress, torques=torques)
        try:
            yield from self._descents(coarse, first, torques, solve)
            if not self.stopped and options.effort != "quick" and self.promising:
                yield from self._beyond(coarse, first)
        except Stop:
            yield from coarse.saved()
            raise

    def _descents(
        self, coarse: CoarseSearch, first: Guess, torques: bool, solve: Solve
    ) -> Iterator[Candidate]:
        """The first motions.

        Where speed limits rule and little is in the way, a descent on the grid that is
        asked for takes a few iterations only, and ends near what none can beat.
        """
        system, progress = self.system, self.progress
        if system.final_configuration is not None and not torques:
            judge = None if system.in_free_space else self._leads_astray
            with progress.judged(judge):
                candidate = solve(first)
            self.stopped = candidate is not None and candidate.status in STOPPED
            if candidate is not None and (candidate.found or self.stopped):
                progress.best = min(progress.best, candidate.duration)
                yield candidate
            if self.stopped or (progress.best < np.inf and system.in_free_space):
                return
            if progress.best < np.inf and not self.promising:
                return
        yield from coarse.descents(self._from_paths(), self.wanted)
        self.stopped = coarse.stopped

    def _from_paths(self) -> Iterator[Guess]:
        """The guesses, a sampled path before the one straight line among obstacles.

        It leads to the same motion, or to one as good, in half the programs, where the
        straight line is not near one.
        """
        first = self.guesses.get(0)
        second = None
        if self.wanted == 1 and not self.system.in_free_space:
            second = self.guesses.get(1)
        if first is None or second is None or second.name != SAMPLED:
            yield from self.guesses.since(0)
            return
        yield from (second, first)
        yield from self.guesses.since(2)

    def _leads_astray(self, record: IterationRecord) -> Status | None:
        """End a descent among obstacles that is not near the best motion soon."""
        bound = self.progress.lower_bound(self.system.problem).T
        above = record.duration / max(bound, 1e-12) - 1.0
        early = len(self.progress.records) < DIRECT
        near = early or (above <= GAP and record.violation <= NEARLY)
        return None if near and above <= ASTRAY else Status.ITERATION_LIMIT

    def _beyond(self, coarse: CoarseSearch, first: Guess) -> Iterator[Candidate]:
        """What is tried beyond the first descents."""
        patience = MANY_IN_VAIN if self._many else IN_VAIN
        if not self.system.in_free_space:
            patience = further_paths(self.system)  # all of them
        if self._many or not self.system.in_free_space:
            coarse.compare()
        yield from coarse.probes(self._further(first), patience)
        self.stopped = coarse.stopped
        if self.swings and not first.timed and not self.stopped:
            # What cannot be held on the way has to be swung over.
            shooting = replace(self.options, **TORQUE_START_OPTIONS)
            tried = random_torque_starts(self.system, shooting, self.progress, SHOTS)
            yield from (candidate for candidate in tried if candidate is not None)

    @property
    def _many(self) -> bool:
        """Whether an arm in free space has more joints than turn over."""
        return self.system.in_free_space and self.system.n > FEW_JOINTS

    @property
    def promising(self) -> bool:
        """Whether there may be a motion that is a good deal faster."""
        system, best = self.system, self.progress.best
        if system.final_configuration is None:
            return False
        if self._many and system.n > MOST_JOINTS:
            return False
        if best == np.inf:
            # Among obstacles all guesses were tried.
            return system.in_free_space and not self._many
        above = FAR_ABOVE if self._many else 1.0 + GAP
        return best > above * self.progress.lower_bound(system.problem).T

    def _further(self, first: Guess) -> Iterator[Guess]:
        """What is tried beyond the first descents."""
        system = self.system
        if not system.in_free_space:
            further = self.guesses.since(self.wanted)
            return itertools.islice(further, further_paths(system))
        rng = np.random.default_rng(self.options.seed)
        count = max(2 * system.n, DETOURS)
        detours = bumps(system, first, rng, from_base=self._many)
        return itertools.islice(detours, count)
