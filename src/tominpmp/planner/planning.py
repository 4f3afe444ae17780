"""Planning: candidates from initial guesses, and improvements of the incumbent.

A plan consists of a schedule and a loop. The schedule is a coroutine: it yields
:class:`~tominpmp.planner.work.Work` and is sent the candidate made from it. The loop,
:func:`~tominpmp.planner.work.run`, makes, replays and repairs one candidate after the
other, and saves the best iterate if planning is stopped. The incumbent is the fastest
candidate whose replay keeps all limits. The time, the candidates and the iterates are
kept by :class:`~tominpmp.planner.plan_state.PlanState`, which the solvers call with
every iteration. A plan passes through these modules:

- :mod:`~tominpmp.planner.automatic_options`: method, control and solver are chosen;
- :mod:`~tominpmp.planner.standing`: is the start at the goal already?
- :mod:`~tominpmp.planner.barriers`: is there a proof that no motion exists?
- :mod:`~tominpmp.planner.alternatives`: the goals of a set take turns;
- :mod:`~tominpmp.planner.starts`: initial guesses for one goal, and their number;
- :mod:`~tominpmp.planner.coarse_search`: guesses compared by descents on a coarse grid;
- :mod:`~tominpmp.planner.torque_starts`: shooting from given or random torques, for
  small arms that may have to swing, and for the shooting methods;
- :mod:`~tominpmp.planner.segment_by_segment`: several segments, planned one by one by
  the same schedule, and joined;
- :mod:`~tominpmp.planner.descent`: sequential convex programming turns a guess into a
  locally optimal motion;
- :mod:`~tominpmp.planner.first_program`: the convex programs begin on a grid that fits
  the guess;
- :mod:`~tominpmp.planner.finer_grid`: at the end of a descent, intervals are halved
  where the controls bend;
- :mod:`~tominpmp.planner.improvements`: a table of stages that improve the incumbent;
- :mod:`~tominpmp.planner.optimality`: one of these stages, the certificate;
- :mod:`~tominpmp.planner.thorough`: further starts while planning time remains;
- :mod:`~tominpmp.planner.conclusion`: turns the best candidate into a solution;
- :mod:`~tominpmp.planner.control_period`, :mod:`~tominpmp.planner.smoothing` and
  :mod:`~tominpmp.planner.energy`: optional stages that change this solution.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

from tominpmp.blas_threads import on_one_thread
from tominpmp.bounds.lower_bound import why_impossible
from tominpmp.checks import instance
from tominpmp.exceptions import ProblemError
from tominpmp.motion.joining import checked_motion
from tominpmp.motion.samples import Samples
from tominpmp.motion.trajectory import Trajectory
from tominpmp.options import Options
from tominpmp.planner.alternatives import candidates_of_alternatives
from tominpmp.planner.automatic_options import resolve_options
from tominpmp.planner.barriers import find_barrier
from tominpmp.planner.conclusion import conclude, with_remarks
from tominpmp.planner.control_period import SEARCH_SHARE, on_clock
from tominpmp.planner.energy import with_least_cost
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
from tominpmp.verification.verification import LONGEST


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
        options: Options of the planner; the defaults are sensible.
        start: Warm start: a former motion of the same joints, for a problem that
            resembles the one it solved, with another goal, obstacle or limit, or with a
            start on its path. It is bent to the new ends. Other starts follow only if
            it leads to no motion, or to one far above its lower bound that takes nearly
            as long as the first guess, or if ``options.starts`` asks for more than one
            start.
        **changes: Options by name, as in ``plan(problem, intervals=60)``; they override
            the values in ``options``.

    Returns:
        The solution. When no motion is found, its status and message say why; on Ctrl-C
        or when the planning time is used up it holds the best motion so far.

    Raises:
        OptionsError: If an option does not fit the problem.
        ProblemError: If the goal cannot be reached at all, the former motion has other
            joints, or the problem has segments and the arm joints without a motor.
        SolverNotFound: If the solver of linear programs is not installed.
        Exception: Any error of ``options.callback``.
    """
    instance(problem, Problem, "problem")
    requested = options = resolve_options(problem, Options.of(options).changed(changes))
    stands = standing(problem, options)
    if stands is not None:
        return with_remarks(stands, PlanState(problem, options))
    if requested.energy_weight:
        # The time-optimal motion only warm-starts the search for the energy optimum.
        options = replace(
            options,
            energy_weight=0.0,
            refine=None,
            effort="quick",
            max_planning_time=requested.time_limit,
        )
    former = None if start is None else _motion_of(problem, start)
    state = PlanState(problem, options)
    if options.control_period is not None:
        state.reset_limit(SEARCH_SHARE * options.time_limit)
    with state.deadline.in_force():
        solution = _finish(state, run(state, _full_schedule(state, former)))
        if state.callback_error is not None:
            raise state.callback_error
        if requested.energy_weight:
            solution = with_least_cost(replace(solution, options=requested))
        solution = with_remarks(solution, state)
    # From here on Ctrl-C raises KeyboardInterrupt: every request is known.
    if state.deadline.requested and solution.status is not Status.INTERRUPTED:
        begin = f"{Status.INTERRUPTED.value} " if solution.success else ""
        message = begin + solution.message
        solution = replace(solution, status=Status.INTERRUPTED, message=message)
    return solution


def _finish(state: PlanState, status: Status | None) -> Solution:
    """The solution once the schedule is exhausted or planning was stopped.

    After a stop the former motion and a fallback are tried. The solution is then moved
    to the clock of the control period, and smoothed, if options ask for it.

    Args:
        state: The plan.
        status: How planning was stopped; None if the schedule is exhausted.
    """
    options = state.options
    if status is not None:
        use_fallback(state, status)
    if not state.candidates and state.failures:
        raise state.failures[0]
    if state.complete and status is Status.TIME_LIMIT:
        status = None
    with state.saving():
        solution = conclude(state, status)
    # A search for a motion without a clock had a share of the planning time only.
    state.reset_limit(options.time_limit)
    with state.saving():
        solution = on_clock(solution, state)
    if options.slack is not None and solution.success and status not in STOPPED:
        solution = smooth(solution, options.slack)
    return solution


def _full_schedule(
    state: PlanState, former: Trajectory | Samples | None
) -> Schedule[None]:
    """The schedule of a plan: proofs, starts, improvements, thorough search.

    Args:
        state: The plan.
        former: A former motion as warm start; None without one.
    """
    problem, options = state.problem, state.options
    proof = why_impossible(problem, options.limit_tolerance, options.control_period)
    state.impossible = proof or find_barrier(problem, options.contact_tolerance)
    if state.impossible:
        return
    bound = state.lower_bound(problem)
    if bound.T > LONGEST:
        state.impossible = (
            f"No motion takes less than {bound.T:.3g} s: {bound.reason}; and no more "
            f"than {LONGEST:.3g} s can be replayed."
        )
        return
    yield from candidates_of_alternatives(state, partial(starts, state), former)
    use_fallback(state, Status.FEASIBLE)
    if options.objective == "time":
        yield from improvements(state)
        yield from thorough_search(state)


def _motion_of(
    problem: Problem, start: Solution | Trajectory | Samples
) -> Trajectory | Samples | None:
    """The motion to warm-start from; None if its duration is zero.

    Raises:
        ProblemError: If the solution has no motion, or its motion has other joints.
    """
    former = start.trajectory if isinstance(start, Solution) else start
    if former is None:
        message = getattr(start, "message", "")
        raise ProblemError(f"start: there is no motion in it: {message}", "start")
    if isinstance(former, Trajectory | Samples) and former.t.size == 1:
        checked_motion(former, problem)
        return None
    return former
