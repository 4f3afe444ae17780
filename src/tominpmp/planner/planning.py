"""Planning: candidates from initial guesses, and improvements of the best of them."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

from tominpmp.blas_threads import on_one_thread
from tominpmp.checks import instance
from tominpmp.exceptions import ProblemError
from tominpmp.motion.joining import checked_motion
from tominpmp.motion.samples import Samples
from tominpmp.motion.trajectory import Trajectory
from tominpmp.options import Options
from tominpmp.planner.alternatives import candidates_of_alternatives
from tominpmp.planner.automatic_options import resolve_options
from tominpmp.planner.barriers import find_barrier
from tominpmp.planner.candidate import Candidate
from tominpmp.planner.conclusion import conclude, with_remarks, without_motion
from tominpmp.planner.control_period import on_clock, searching
from tominpmp.planner.energy import economical
from tominpmp.planner.exact_switches import with_exact_switches
from tominpmp.planner.finer_grid import on_finer_grid
from tominpmp.planner.multistart import make_candidates
from tominpmp.planner.optimality import certified
from tominpmp.planner.plan_state import PlanState
from tominpmp.planner.smoothing import smooth
from tominpmp.planner.standing import standing
from tominpmp.planner.thorough import thorough_search
from tominpmp.problem import Problem
from tominpmp.solution import Solution
from tominpmp.status import STOPPED, Status
from tominpmp.stopping import Stop

logger = logging.getLogger(__name__)


@on_one_thread
def plan(
    problem: Problem,
    options: Options | None = None,
    start: Solution | Trajectory | Samples | None = None,
    **changes: Any,
) -> Solution:
    """Plan a motion in minimum time.

    Args:
        problem: Robot, start, goal and scene.
        options: How; the defaults are sensible.
        start: A former motion of the same joints to begin with, for a problem that is
            much like its own: another goal, obstacle or limit, or a start on its way.
            It is bent to the new ends. Other guesses are made only if it leads to no
            motion, or ``options.starts`` asks for more than one.
        **changes: Options by name, as in ``plan(problem, intervals=60)``; they go
            before those of ``options``.

    Returns:
        The solution. When no motion is found, its status and message say why; on Ctrl-C
        or when the planning time is used up it holds the best motion so far.

    Raises:
        OptionsError: If an option does not fit the problem.
        ProblemError: If the goal cannot be reached at all, or the former motion is one
            of other joints.
        SolverNotFound: If the solver of linear programs is not installed.
    """
    instance(problem, Problem, "problem")
    asked = options = resolve_options(problem, Options.of(options).changed(changes))
    stands = standing(problem, options)
    if stands is not None:
        return stands
    if asked.energy_weight:
        # The fastest motion is where the search for the best one begins, no more.
        options = replace(options, energy_weight=0.0, refine=None, effort="quick")
    progress = PlanState(searching(options))
    with progress.deadline.in_force():
        solution = _plan(problem, options, progress, start)
        if asked.energy_weight and solution.status not in STOPPED:
            return with_remarks(economical(solution, asked), progress)
    return solution


def _plan(
    problem: Problem,
    options: Options,
    progress: PlanState,
    start: Solution | Trajectory | Samples | None,
) -> Solution:
    """Plan, until it is time to stop; what was found by then is the solution."""
    candidates: list[Candidate] = []
    status = None
    try:
        barrier = find_barrier(problem, options.tolerances.contact)
        if barrier is not None:
            ended = Status.INFEASIBLE
            return without_motion(problem, options, progress, ended, str(barrier))
        for candidate in _candidates(problem, options, progress, start):
            candidates.append(candidate)
            status = candidate.status
            if progress.ended(status):
                break
    except (Stop, KeyboardInterrupt) as stop:
        status = progress.stopped(stop)
    if not candidates and progress.failures:
        raise progress.failures[0]
    with progress.saving():
        solution = conclude(problem, options, progress, candidates, status)
    progress.extend(options.time_limit)
    if options.control_period is not None:
        with progress.saving():
            solution = on_clock(solution, candidates, progress)
    if options.slack is not None and solution.success and status not in STOPPED:
        solution = smooth(solution, options.slack)
    if progress.deadline.requested:
        solution = _interrupted(solution)
    return with_remarks(solution, progress)


def _candidates(
    problem: Problem,
    options: Options,
    progress: PlanState,
    start: Solution | Trajectory | Samples | None,
) -> Iterator[Candidate]:
    """One candidate after the other."""
    former = None if start is None else motion_of(start)
    if isinstance(former, Trajectory | Samples) and former.t.size == 1:
        checked_motion(former, problem.robot, problem.q_start, problem.v_start)
        former = None  # a motion that takes no time leads nowhere
    make = partial(make_candidates, options=options, progress=progress)
    candidates: list[Candidate] = []
    for candidate in candidates_of_alternatives(problem, make, progress, former):
        logger.info("start %d: %s", progress.start, candidate.status.value)
        candidates.append(candidate)
        yield candidate
        if options.objective == "feasible" and candidate.found:
            return
    for candidate in improved(problem, options, progress, tuple(candidates)):
        candidates.append(candidate)
        yield candidate

    def stages(candidate: Candidate) -> Iterator[Candidate]:
        return improved(problem, options, progress, [candidate])

    yield from thorough_search(problem, options, progress, candidates, stages)


class Improvement(NamedTuple):
    """What is made of the best motion of a search.

    What each brings tells ``python -m benchmarks.ablation``, which leaves them out.

    Attributes:
        name: Its name.
        wanted: Whether options ask for it.
        improve: Yields faster motions, or the best one with the status it deserves.
    """

    name: str
    wanted: Callable[[Options], bool]
    improve: Callable[
        [Problem, Options, PlanState, Sequence[Candidate]], Iterator[Candidate]
    ]


IMPROVEMENTS = (
    Improvement(
        "exact switches",
        lambda options: options.refine == "switching",
        with_exact_switches,
    ),
    Improvement(
        "finer grid",
        lambda options: options.refine is not None,
        on_finer_grid,
    ),
    Improvement(
        "certificate",
        lambda options: True,
        certified,
    ),
)


def improved(
    problem: Problem, options: Options, progress: PlanState, found: Sequence[Candidate]
) -> Iterator[Candidate]:
    """What is made of the best motion of a search, or of a single one."""
    if options.objective != "time":
        return
    candidates = list(found)
    for improvement in IMPROVEMENTS:
        if improvement.wanted(options):
            for candidate in improvement.improve(
                problem, options, progress, candidates
            ):
                candidates.append(candidate)
                yield candidate


def _interrupted(solution: Solution) -> Solution:
    """A solution at the end of a planning that was interrupted."""
    if solution.status is Status.INTERRUPTED:
        return solution
    message = solution.message
    if solution.success:
        message = f"{Status.INTERRUPTED.value} {message}"
    return replace(solution, status=Status.INTERRUPTED, message=message)


def motion_of(start: Solution | Trajectory | Samples) -> Trajectory | Samples:
    """Motion to begin with.

    Raises:
        ProblemError: If the solution has none.
    """
    if not isinstance(start, Solution):
        return start
    if start.trajectory is None:
        raise ProblemError(f"start: there is no motion in it: {start.message}", "start")
    return start.trajectory
