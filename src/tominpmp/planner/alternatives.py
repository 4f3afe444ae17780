"""Planning for sets of goals of which any will do."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from tominpmp.bounds import lower_bound
from tominpmp.exceptions import ProblemError
from tominpmp.initial_guess.segments import SegmentedGuess, former_segments
from tominpmp.initial_guess.warm_start import WarmStart, warm_start
from tominpmp.motion.samples import Samples
from tominpmp.motion.trajectory import Trajectory
from tominpmp.planner.candidate import Candidate
from tominpmp.planner.plan_state import PlanState
from tominpmp.problem import Problem
from tominpmp.stopping import Stop
from tominpmp.transcription.problem_functions import ProblemFunctions

Start = WarmStart | SegmentedGuess
Candidates = Callable[[ProblemFunctions, Start | None], Iterator[Candidate | None]]


def candidates_of_alternatives(
    problem: Problem,
    make: Candidates,
    progress: PlanState,
    former: Trajectory | Samples | None = None,
) -> Iterator[Candidate]:
    """Solve for each goal of a set, a start each before the second one for any.

    The goals that might be reached soonest come first. As long as there is no motion,
    a start may take no more than its share of the planning time: one goal may be out of
    reach, and that is not always known at once. Goals that no motion could reach faster
    than the best one so far are left out.

    Args:
        problem: A problem with a set of goals, or with one.
        make: Makes the candidates for a problem with one goal, given a former motion.
        progress: Time limit, and the duration of the best motion so far.
        former: A former motion; it goes to the goal that it ends nearest to.

    Yields:
        The candidates.

    Raises:
        ProblemError: If none of the goals can be reached at all.
    """
    parts = problem.alternatives
    if len(parts) == 1:
        system = ProblemFunctions.of(parts[0])
        start = None if former is None else _start(system, former)
        yield from (
            candidate for candidate in make(system, start) if candidate is not None
        )
        return
    bounds = [lower_bound(part).T for part in parts]
    order = np.argsort(bounds, kind="stable").tolist()
    entered = None
    if former is not None:
        entered = _entered(problem, former)
        order = [entered, *(i for i in order if i != entered)]
    runs: dict[int, Iterator[Candidate | None]] = {}
    wrong: list[str] = []
    while order:
        again: list[int] = []
        for place, i in enumerate(order):
            if bounds[i] >= progress.best:
                continue
            progress.share(len(order) - place + len(again))
            if i not in runs:
                system = ProblemFunctions.of(parts[i])
                start = None
                if former is not None and i == entered:
                    start = _start(system, former)
                runs[i] = make(system, start)
            try:
                candidate = next(runs[i])
            except StopIteration:
                continue
            except Stop as stop:
                if progress.ended(progress.stopped(stop)):
                    raise
                continue  # its share of the time is used up
            except ProblemError as error:
                wrong.append(f"goal {i + 1} of {len(parts)}: {error}")
                continue
            again.append(i)
            if candidate is not None:
                yield candidate
        order = again
    if len(wrong) == len(parts):
        raise ProblemError("; ".join(wrong), "goal")


def _start(system: ProblemFunctions, former: Trajectory | Samples) -> Start:
    """A former motion as the first guess for a problem."""
    if system.parts:
        return former_segments(system.problem, former)[0]
    return warm_start(system, former)


def _entered(problem: Problem, former: Trajectory | Samples) -> int:
    """The alternative of a problem that a former motion is nearest to."""
    parts = problem.alternatives
    if problem.segments:
        nearest = problem.alternative_of(former_segments(problem, former)[1])
    else:
        # Its columns may be in any order, and its velocities be missing.
        motion = warm_start(ProblemFunctions.of(parts[0]), former).trajectory
        nearest = problem.alternative_at(motion.q[-1], motion.v[-1])
    goals = [[phase.goal for phase in part.phases] for part in (nearest, *parts)]
    same = [
        all(one is other for one, other in zip(goals[0], each, strict=True))
        for each in goals[1:]
    ]
    return same.index(True)
