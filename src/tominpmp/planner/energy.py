"""Objectives other than time: the motion of a solution is optimised once more.

The motion is a warm start on its own grid, whose intervals are halved where the other
objective gains from it, and is improved for this objective. If its replay breaks
limits, it is repaired: by rows against self-collision if links touch, otherwise by a
finer grid. If the repair fails, the solution keeps its former motion.

One such objective is time against energy. The warm start is the fastest motion, or, for
squared torques, the better of two rough optima: one is reached from the fastest motion,
the other one from a slow motion of little energy. Another objective is quiet torques,
see :mod:`~tominpmp.planner.smoothing`.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from tominpmp.arrays import Array
from tominpmp.linear_programs.choice import make_solver
from tominpmp.motion.measures import ENERGIES
from tominpmp.motion.trajectory import Trajectory
from tominpmp.planner.candidate import Candidate
from tominpmp.planner.plan_state import END_SECONDS, REPLAYS, PlanState
from tominpmp.planner.work import NUMERICAL, REPAIRS, Work, make_and_repair
from tominpmp.solution import Solution
from tominpmp.solvers.exchange import RowExchange
from tominpmp.solvers.loop import Loop, Rule, Step, first_of, solve
from tominpmp.solvers.objective import Objective
from tominpmp.solvers.quiet_torques import SETTLED
from tominpmp.solvers.time_and_energy import TimeAndEnergy
from tominpmp.solvers.trust_region_step import trust_regions
from tominpmp.status import STOPPED, Status
from tominpmp.stopping import Stop, bounded, grace, seconds_left, seconds_to_end
from tominpmp.transcription.bspline import DEGREES
from tominpmp.transcription.layout import LIFTED, QUADRATIC, Layout, on_ticks
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import NonlinearProgram

logger = logging.getLogger(__name__)

# Time-scaling factors at which the fastest motion is tried as a warm start.
PACES = np.geomspace(1.0, 100.0, 21).tolist()
# Intervals of the optimal motion per interval of the fastest one: if its torques jump,
# at other times than in the fastest motion, and if they are continuous.
FINER = {True: 2, False: 3}
# Weight of the energy in the descent to a slow motion, as a multiple of the requested
# one.
HEAVIER = 30.0


def reoptimised(
    solution: Solution,
    motion: Trajectory,
    layout: Callable[[int], Layout],
    objective: Callable[[NonlinearProgram, Array], tuple[Objective, Array]],
) -> Candidate:
    """Optimise a motion for another objective.

    If the replay of the new motion breaks limits, the grid is refined.

    Args:
        solution: The solution whose problem and options count.
        motion: The motion, that of the solution or a similar one.
        layout: Gives the layout of the new motion, for a number of halvings.
        objective: Gives the objective and the initial iterate, from a program and the
            motion as its iterate.
    """
    options, problem = solution.options, solution.problem

    def make(tried: ProblemFunctions, halvings: int, _: Candidate | None) -> Candidate:
        program, z = layout(halvings).represented(tried, motion, within=True)
        start = program, *objective(program, z)
        result = solve(*start, *_steps_in_time(solution), exchange=RowExchange())
        candidate = Candidate.of(motion, result)
        if options.control_period is not None:
            clocked = on_ticks(candidate.trajectory, options.control_period)
            candidate = replace(candidate, trajectory=clocked)
        with grace(seconds_to_end()):
            return candidate.verified(problem, options)

    system = ProblemFunctions.of(problem.alternative_of(motion))
    return make_and_repair(PlanState(problem, options), Work(system, make, REPAIRS))


def _steps_in_time(solution: Solution) -> tuple[Step, Rule]:
    """Steps, and a stop rule that leaves time for a last step and replays."""
    replay = 0.0 if solution.verification is None else solution.verification.seconds
    reserve = max(END_SECONDS, REPLAYS * replay)
    step, settled = trust_regions(solution.options, make_solver("piqp"))

    def late(_: Loop) -> Status | None:
        return Status.TIME_LIMIT if seconds_left() < reserve else None

    return step, first_of(settled, late)


def run_stage(
    solution: Solution, doing: str, otherwise: str, work: Callable[[], Solution | str]
) -> Solution:
    """Run a stage that improves a solution, within the time limit of its options.

    Args:
        solution: The solution.
        doing: Name of the stage in messages, as a gerund.
        otherwise: Sentence on the motion if the stage fails, without its reason.
        work: Gives the better solution, or the reason for its failure.

    Returns:
        The better solution; otherwise the solution with the reason in its message.
    """
    begin, status = time.perf_counter(), None
    try:
        with bounded(solution.options.time_limit):
            result = work()
    except (Stop, KeyboardInterrupt) as stop:
        if isinstance(stop, Stop) and not stop.requested:
            allowed = f"within the {solution.options.time_limit:.3g} s allowed"
            result = f"there was no time for {doing} {allowed}."
            status = Status.TIME_LIMIT
        else:
            result, status = f"{doing} was interrupted.", Status.INTERRUPTED
    except NUMERICAL as error:
        logger.warning("%s failed: %r", doing, error)
        result = f"{doing} failed ({type(error).__name__})."
    if isinstance(result, str):
        result = replace(solution, message=f"{solution.message} {otherwise}: {result}")
    seconds = solution.planning_time + time.perf_counter() - begin
    return replace(result, status=status or result.status, planning_time=seconds)


def with_least_cost(solution: Solution) -> Solution:
    """The motion of least cost, T + k times its energy.

    Args:
        solution: The solution of minimum time, with the options of the plan.

    Returns:
        The motion of least cost; otherwise the fastest one, with the reason in its
        message.
    """
    former = solution.trajectory
    if former is None or not solution.success:
        return solution
    if solution.status in STOPPED:
        message = f"{solution.message} Its energy was not weighed."
        return replace(solution, message=message)
    otherwise, doing = "This is the fastest motion", "weighing its energy"
    fastest = replace(solution, status=Status.FEASIBLE)
    return run_stage(fastest, doing, otherwise, partial(_least_cost, fastest, former))


def _least_cost(solution: Solution, former: Trajectory) -> Solution | str:
    """The solution with the motion of least cost, or the reason for its failure."""
    objective = TimeAndEnergy.of(solution.options)
    rough, kind = former, objective.kind
    if not kind.jumping:  # no path saves the work of holding: it is zero
        rough = _roughly_cheapest(solution, former, objective)
    grid = _layout(solution, rough)

    def finer(halvings: int) -> Layout:
        return grid.with_intervals(2**halvings * FINER[kind.jumping] * len(grid.shares))

    def least(program: NonlinearProgram, z: Array) -> tuple[TimeAndEnergy, Array]:
        return objective, _at_least_cost(objective, program, z)

    cheapest = reoptimised(solution, rough, finer, least)
    better = replace(
        solution,
        status=cheapest.status,
        trajectory=cheapest.trajectory,
        initial=former,
        verification=cheapest.verification,
        violations={},
    )
    if not cheapest.confirmed or better.cost > solution.cost:
        if cheapest.status is Status.TIME_LIMIT:
            raise Stop(requested=False)
        return "no motion of less cost was found."
    return replace(better, message=_message(better, former))


def _roughly_cheapest(
    solution: Solution, former: Trajectory, objective: TimeAndEnergy
) -> Trajectory:
    """The better of two motions that are optimised roughly, on the grid of the search.

    Motions that nearly minimise the energy alone may take other paths than the fastest
    one, for example with the arm upright, where gravity needs little torque. One
    descent begins with the fastest motion. It is continued with a larger weight of the
    energy, and a second descent begins with the slow motion that it leads to.
    """
    system = ProblemFunctions.of(solution.problem.alternative_of(former))
    layout = _layout(solution, former)
    program, z = layout.represented(system, former, within=True)
    rough = replace(objective, tolerance=SETTLED)
    slow = replace(rough, weight=HEAVIER * rough.weight)

    def descent(towards: TimeAndEnergy, z: Array) -> Array:
        result = solve(program, towards, z, *_steps_in_time(solution))
        return (result.best or result.iterate).z

    first = descent(rough, _at_least_cost(rough, program, z))
    second = descent(rough, descent(slow, first))

    def cost(z: Array) -> tuple[bool, float]:
        values = program.evaluate(z)
        broken = program.rows.largest_violation(values) > objective.feasibility
        return broken, objective.value(program, z, values)

    return program.trajectory(min(first, second, key=cost))


def _layout(solution: Solution, motion: Trajectory) -> Layout:
    """Spline layout that suits the energy, on the grid of a motion.

    Motions of least squared torques have continuous torques. In motions of least work
    the motors push, coast and brake, and torques jump in between: they have the splines
    that suit the fastest motion. Torques also jump at the ends of segments, where the
    load changes.
    """
    problem = solution.problem
    kind = ENERGIES[solution.options.energy]
    layout = Layout.of_motion(motion, problem.segments) or Layout.of_torques(motion)
    if layout.degree == LIFTED:
        return layout
    degree, breaks = layout.degree, layout.segment_ends[:-1]
    if solution.options.control not in DEGREES and not kind.jumping:
        degree = DEGREES["linear"]
    if degree == QUADRATIC or not ProblemFunctions.of(problem).sudden:
        breaks = ()
    return replace(layout, degree=degree, breaks=breaks)


def _message(best: Solution, former: Trajectory) -> str:
    """Message on the motion of least cost: T, energy and cost."""
    share = 100.0 * (best.T / former.duration - 1.0)
    # On the finer grid even the duration may be smaller.
    more = f"{abs(share):.3g} % {'more' if share >= 0.0 else 'less'}"
    converged = best.status is Status.CONVERGED
    begin = "A locally optimal" if converged else f"{best.status.value} A"
    kind = ENERGIES[best.options.energy]
    return (
        f"{begin} trade of time against {kind.name} was found. "
        f"T = {best.T:.4f} s, {more} than the fastest motion of the search, "
        f"{kind.name} = {best.energy:.4g} {kind.unit}, "
        f"T + {best.options.energy_weight:g} {kind.name} = {best.cost:.6g} s."
    )


def _at_least_cost(
    objective: TimeAndEnergy, program: NonlinearProgram, z: Array
) -> Array:
    """The motion at the pace of least cost among those that break no further limits."""
    violation = program.rows.largest_violation(program.evaluate(z))
    allowed = max(violation, objective.feasibility)

    def cost(slower: Array) -> float:
        values = program.evaluate(slower)
        kept = program.rows.largest_violation(values) <= allowed
        return objective.value(program, slower, values) if kept else np.inf

    return min((program.time_scale(z, pace) for pace in PACES), key=cost)
