"""Planning: candidates from initial guesses, and improvements of the incumbent.

A plan is a schedule, a coroutine that yields :class:`~tominpmp.planner.work.Work` and
is sent the candidate that came of it, and a loop in :func:`plan` that does the work:

- :func:`everything`: starts, improvements, and the thorough search;
- :mod:`~tominpmp.planner.alternatives`: the goals of a set take turns;
- :mod:`~tominpmp.planner.starts`: guesses for one goal, and how many;
- :mod:`~tominpmp.planner.coarse_search`: guesses compared on a coarse grid;
- :mod:`~tominpmp.planner.descent`: a guess becomes a locally optimal motion;
- :mod:`~tominpmp.planner.improvements`: a table of what improves the incumbent, the
  fastest candidate whose replay holds;
- :func:`~tominpmp.planner.work.run`: makes, replays and repairs one candidate, and
  saves it where planning is stopped;
- :mod:`~tominpmp.planner.conclusion`: the incumbent becomes a solution.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

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
from tominpmp.planner.conclusion import conclude, with_remarks, without_motion
from tominpmp.planner.control_period import on_clock, searching
from tominpmp.planner.energy import economical
from tominpmp.planner.improvements import improvements
from tominpmp.planner.plan_state import PlanState
from tominpmp.planner.smoothing import smooth
from tominpmp.planner.standing import standing
from tominpmp.planner.starts import starts
from tominpmp.planner.thorough import thorough_search
from tominpmp.planner.work import Schedule, run, use_fallback
from tominpmp.problem.problem import Problem
from tominpmp.solution import Solution
from tominpmp.status import STOPPED, Status
from tominpmp.stopping import Stop


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
        **changes: Options by name, as in ``plan(problem, intervals=60)``; they override
            those of ``options``.

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
        return with_remarks(stands, PlanState(problem, options))
    if asked.energy_weight:
        # The time-optimal motion only warm-starts the search for the energy optimum.
        options = replace(
            options,
            energy_weight=0.0,
            refine=None,
            effort="quick",
            max_planning_time=asked.time_limit,
        )
    former = None if start is None else motion_of(problem, start)
    state = PlanState(problem, searching(options))
    status, answer = None, None
    with state.deadline.in_force():
        try:
            barrier = find_barrier(problem, options.tolerances.contact)
            if barrier is not None:
                return without_motion(state, asked, Status.INFEASIBLE, str(barrier))
            schedule = everything(state, former)
            while status is None and not state.satisfied:
                answer = run(state, schedule.send(answer))
                status = state.ended
            schedule.close()
        except StopIteration:
            pass
        except (Stop, KeyboardInterrupt) as stop:
            status = state.stopped(stop)
        solution = _ended(state, options, status)
        if asked.energy_weight:
            solution = economical(replace(solution, options=asked))
        return with_remarks(solution, state)


def _ended(state: PlanState, options: Options, status: Status | None) -> Solution:
    """The solution once the schedule is exhausted or planning was stopped.

    Args:
        state: The plan.
        options: Options of the plan, with the whole of its time.
        status: How it was stopped; None if all is tried.
    """
    if status is not None and state.best_duration == np.inf:
        use_fallback(state, status)
    if not state.candidates and state.failures:
        raise state.failures[0]
    if state.complete and status is Status.TIME_LIMIT:
        status = None
    with state.saving():
        solution = conclude(state, options, status)
    state.extend(options.time_limit)
    with state.saving():
        solution = on_clock(solution, state)
    if options.slack is not None and solution.success and status not in STOPPED:
        solution = smooth(solution, options.slack)
    return _interrupted(solution) if state.deadline.requested else solution


def everything(
    state: PlanState, former: Trajectory | Samples | None = None
) -> Schedule[None]:
    """The schedule of a plan: starts, improvements, thorough search.

    Args:
        state: The plan.
        former: A former motion to begin with.
    """
    yield from candidates_of_alternatives(state, partial(starts, state), former)
    if state.incumbent is None:
        use_fallback(state, Status.FEASIBLE)
    if state.options.objective == "time":
        yield from improvements(state)
        yield from thorough_search(state)


def _interrupted(solution: Solution) -> Solution:
    """A solution at the end of a planning that was interrupted."""
    if solution.status is Status.INTERRUPTED:
        return solution
    message = solution.message
    if solution.success:
        message = f"{Status.INTERRUPTED.value} {message}"
    return replace(solution, status=Status.INTERRUPTED, message=message)


def motion_of(
    problem: Problem, start: Solution | Trajectory | Samples
) -> Trajectory | Samples | None:
    """The motion to warm-start from; None if its duration is zero.

    Raises:
        ProblemError: If the solution has no motion, or that is one of other joints.
    """
    former = start.trajectory if isinstance(start, Solution) else start
    if former is None:
        message = getattr(start, "message", "")
        raise ProblemError(f"start: there is no motion in it: {message}", "start")
    if isinstance(former, Trajectory | Samples) and former.t.size == 1:
        checked_motion(former, problem.robot, problem.q_start, problem.v_start)
        return None
    return former
