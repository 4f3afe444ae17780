"""Search among moving obstacles: what is tried once the first motions are finished.

Motions that are made in full tell more of what passes than coarse grids do, and a few
of them are. Only when the best of them is through the last stages are further paths
tried on coarse grids: so a plan whose time is used up then has lost nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from tominpmp.initial_guess.path_velocity import guesses_of
from tominpmp.options import Options
from tominpmp.planner.attempt import TIE, Attempt
from tominpmp.planner.coarse_grids import suits
from tominpmp.planner.multistart import Count
from tominpmp.planner.progress import Progress
from tominpmp.planner.search import Remembered, Search, further_paths
from tominpmp.problem import Problem
from tominpmp.stopping import Stop
from tominpmp.transcription.problem_functions import ProblemFunctions


def search_among_moving(
    problem: Problem,
    options: Options,
    progress: Progress,
    attempts: Sequence[Attempt],
    stages: Callable[[Attempt], Iterator[Attempt]],
) -> Iterator[Attempt]:
    """Search on for faster motions among obstacles that move.

    Args:
        problem: The problem.
        options: Options of the plan.
        progress: Time limit, and the duration of the best motion so far.
        attempts: What a plan has led to, the last stages among them.
        stages: The last stages of a plan, for a motion.

    Yields:
        Attempts, with the last stages of those that are nearly the best then.
    """
    best = min(attempts, key=lambda attempt: attempt.duration, default=None)
    if best is None or not best.found or not problem.scene.moving:
        return
    system = ProblemFunctions.of(problem.alternative_of(best.trajectory))
    if not suits(system, options):
        return
    usual = Count.of(system, options).usual
    guesses = guesses_of(
        system,
        usual + further_paths(system),
        np.random.default_rng(options.seed),
        options.initial_duration,
        progress.ends,
    )
    search = Search(system, options, progress, Remembered(guesses), usual, swings=False)
    progress.best = least = best.duration
    try:
        for attempt in search.beyond(best):
            yield attempt
            if attempt.duration < (1.0 + TIE) * least:
                for last in stages(attempt):
                    least = min(least, last.duration)
                    yield last
    except Stop as stop:
        if stop.requested:
            raise
        # The time is used up, as it should be.
