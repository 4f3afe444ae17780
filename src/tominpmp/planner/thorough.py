"""Thorough search: waves of starts of all kinds, as long as planning time remains.

A plan with effort "thorough" first completes all stages of a plan with less effort.
Waves of new starts on coarse grids follow: detours, paths around obstacles, other final
configurations, and random torques. A coarse motion that predicts a gain over the
incumbent is finished; if it is faster, the improvements are repeated for it. A longer
search therefore never ends with a slower motion. Motions of several segments have no
coarse grids: each wave is a descent from a further guess.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from contextlib import suppress

import numpy as np

from tominpmp.exceptions import ProblemError
from tominpmp.initial_guess.guess import HEIGHT, Guess, GuessRequest, bumped, bumps
from tominpmp.initial_guess.path_velocity import guesses_of
from tominpmp.initial_guess.segments import segmented_guesses
from tominpmp.planner.coarse_search import CoarseSearch, coarse_grids_apply
from tominpmp.planner.descent import descent_work, torque_limited
from tominpmp.planner.improvements import improvements
from tominpmp.planner.optimality import tolerance_of
from tominpmp.planner.plan_state import PlanState
from tominpmp.planner.torque_starts import torque_starts, torques_may_lead
from tominpmp.planner.work import Schedule, Work, single
from tominpmp.transcription.problem_functions import ProblemFunctions

# Starts of a wave, number of waves without a time limit, and most waves with one.
WAVE, WAVES, MOST_WAVES = 8, 4, 1000


def thorough_search(state: PlanState) -> Schedule[None]:
    """Continue the search for faster motions, if the effort is "thorough".

    Args:
        state: The plan, whose incumbent is the result of a plan with less effort.
    """
    options, problem = state.options, state.problem
    if options.effort != "thorough":
        return
    searches = [
        _descents(system, state) if system.parts else _waves(system, state)
        for system in map(ProblemFunctions.of, problem.alternatives)
        if system.parts or coarse_grids_apply(system, options)
    ]
    state.complete = True
    proven = 1.0 + tolerance_of(options)
    most = WAVES if options.max_planning_time is None else MOST_WAVES
    for _, waves in itertools.product(range(most), searches):
        if not state.exceeds_bound(proven, problem):
            return
        before = state.best_duration
        yield from next(waves, ())
        if state.best_duration < before:
            yield from improvements(state)


def _waves(system: ProblemFunctions, state: PlanState) -> Iterator[Schedule[None]]:
    """Waves of starts for a problem with one goal, without end; none without a guess.

    Args:
        system: Functions of the problem.
        state: The plan.
    """
    seed, duration = state.options.seed, state.options.initial_duration
    of_detours, of_guesses, around_best = np.random.default_rng(seed).spawn(3)
    guesses = guesses_of(system, GuessRequest(of_guesses, duration))
    first = next(guesses, None)
    if first is None:
        return
    coarse = CoarseSearch(system, state, torques=torque_limited(system, first))
    straight = [first, *itertools.islice(guesses, 1)]
    line = next((guess for guess in straight if guess.timed), straight[-1])
    sources = [
        filter(coarse.untried, bumps(system, line, of_detours)),
        filter(coarse.untried, itertools.chain(straight, guesses)),
        _around_best(system, state, around_best),
    ]
    swings = torques_may_lead(system)
    shooting = iter(torque_starts(system, state, MOST_WAVES) if swings else ())
    while True:
        yield _wave(coarse, sources, shooting)


def _wave(
    coarse: CoarseSearch,
    sources: Sequence[Iterator[Guess | None]],
    shooting: Iterator[Work],
) -> Schedule[None]:
    """The candidates of a wave: from guesses of all sources in turn, and from torques.

    Args:
        coarse: The search on coarse grids.
        sources: Guesses of each kind; None where a source has none yet.
        shooting: Work from random torques, one of which belongs to each wave.
    """
    turns = itertools.islice(itertools.cycle(sources), WAVE)
    yield from coarse.probes(filter(None, (next(source, None) for source in turns)))
    work = next(shooting, None)
    if work is not None:
        yield work


def _descents(system: ProblemFunctions, state: PlanState) -> Iterator[Schedule[None]]:
    """Waves of one descent each, for several segments; none without a guess.

    Args:
        system: Functions of the problem.
        state: The plan, which has descended from the first guess.
    """
    options = state.options
    (rng,) = np.random.default_rng(options.seed).spawn(1)
    guesses = segmented_guesses(system, GuessRequest(rng, options.initial_duration))
    with suppress(ProblemError):  # no configuration reaches a goal
        for guess in itertools.islice(guesses, 1, None):
            yield single(descent_work(system, options, guess, state))


def _around_best(
    system: ProblemFunctions, state: PlanState, rng: np.random.Generator
) -> Iterator[Guess | None]:
    """Detours from the incumbent; None while there is no incumbent."""
    while True:
        heights = HEIGHT * rng.uniform() * rng.normal(size=(2, system.n))
        best = state.incumbent
        guess = None if best is None else Guess.of_motion(best.trajectory)
        yield None if guess is None else bumped(system, guess, heights)
