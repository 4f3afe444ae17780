"""Other objectives than time: another motion of the one that was found.

The motion is taken up on its own grid with some of its intervals halved, and improved
for the other objective. Its replay tells what is missing: rows for links that touch,
else a finer grid. Where nothing comes of it, the motion is left as it was.

Time against energy is one such objective: it begins with the fastest motion that was
found, as slow as is best for its path. Quiet torques are another one, see
:mod:`~tominpmp.planner.smoothing`.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.optimize import minimize_scalar

from tominpmp.arrays import Array
from tominpmp.linear_programs.choice import make_solver
from tominpmp.motion.trajectory import Trajectory
from tominpmp.planner.candidate import Candidate
from tominpmp.planner.control_period import on_ticks
from tominpmp.planner.plan_state import PlanState
from tominpmp.planner.work import NUMERICAL, REPAIRS, Work, made
from tominpmp.solution import Solution
from tominpmp.solvers.exchange import RowExchange
from tominpmp.solvers.loop import solve
from tominpmp.solvers.objective import Objective
from tominpmp.solvers.time_and_energy import TimeAndEnergy
from tominpmp.solvers.trust_region_step import trust_regions
from tominpmp.status import STOPPED, IterationRecord, Status
from tominpmp.stopping import Stop, bounded, seconds_left
from tominpmp.transcription.bspline import DEGREES
from tominpmp.transcription.layout import LIFTED, QUADRATIC, Layout
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import NonlinearProgram

logger = logging.getLogger(__name__)

# Time for the replay of what was found, in multiples of what the last one took.
REPLAYS = 2.0
# How much slower than the fastest motion along its path another one is tried, at most.
SLOWEST = 100.0
# Refinement of the grid of the fastest motion, by the kind of energy: the optimum has
# continuous torques, or torques that switch at other times.
FINER = {"torque_squared": 3, "work": 2}
# How often the time scaling is halved that breaks limits, as of times of arrival.
SLOWER_TRIALS = 6
# Names and units of the kinds of energy, as messages have them.
ENERGIES = {"torque_squared": ("energy", "N^2 m^2 s"), "work": ("work", "J")}
NO_CHEAPER = "no motion of less cost was found."


def another_motion(
    solution: Solution,
    layout: Callable[[int], Layout],
    objective: Callable[[NonlinearProgram, Array], tuple[Objective, Array]],
) -> Candidate:
    """Make another motion of the one of a solution, on finer grids until it holds.

    Args:
        solution: The solution.
        layout: Grid of the other motion, whose intervals are halved a number of times.
        objective: What is to be least, and where to begin, from a program and the
            motion as its iterate.
    """
    options, problem, former = solution.options, solution.problem, solution.trajectory
    assert former is not None  # noqa: S101
    replay = 0.0 if solution.verification is None else solution.verification.seconds

    def seen(_: IterationRecord) -> Status | None:
        return Status.TIME_LIMIT if seconds_left() < REPLAYS * replay else None

    def make(tried: ProblemFunctions, halvings: int, _: Candidate | None) -> Candidate:
        of, z = layout(halvings).represented(tried, former, within=True)
        program = NonlinearProgram.of(of).at(z)
        begun = program, *objective(program, z)
        steps = trust_regions(options, make_solver("piqp"))
        exchange = RowExchange(level=0.0)
        result = solve(*begun, *steps, exchange=exchange, callback=seen)
        found = Candidate.of("former motion", former, result)
        if options.control_period is not None:
            motion = on_ticks(found.trajectory, options.control_period)
            found = replace(found, trajectory=motion)
        return found.verified(problem, options)

    system = ProblemFunctions.of(problem.alternative_of(former))
    work = Work(system, "former motion", make, REPAIRS)
    return made(PlanState(problem, options), work)


def bettered(
    solution: Solution, doing: str, kept: str, work: Callable[[], Solution | str]
) -> Solution:
    """What a stage makes of a solution, within the time of a plan.

    Args:
        solution: The solution.
        doing: What is done to its motion, in a few words.
        kept: What is said of the motion where it is left as it was.
        work: Makes the better solution, or says why there is none.
    """
    begin, status = time.perf_counter(), None
    try:
        with bounded(solution.options.time_limit):
            found = work()
    except (Stop, KeyboardInterrupt) as stop:
        if isinstance(stop, Stop) and not stop.requested:
            found = f"there was no time for {doing}."
        else:
            found, status = "this was interrupted.", Status.INTERRUPTED
    except NUMERICAL as error:
        logger.warning("%s failed: %r", doing, error)
        found = f"{doing} failed ({type(error).__name__})."
    if isinstance(found, str):
        found = replace(solution, message=f"{solution.message} {kept}: {found}")
    seconds = solution.planning_time + time.perf_counter() - begin
    return replace(found, status=status or found.status, planning_time=seconds)


def economical(solution: Solution) -> Solution:
    """The motion of least T + k times its energy.

    Args:
        solution: The fastest motion that was found, with the options of the plan.

    Returns:
        The motion, or the fastest one with a message that says why there is none.
    """
    if not solution.success or solution.status in STOPPED:
        return solution
    kept, doing = "This is the fastest motion", "weighing its energy"
    fastest = replace(solution, status=Status.FEASIBLE)
    return bettered(fastest, doing, kept, partial(_cheapest, fastest))


def _cheapest(solution: Solution) -> Solution | str:
    """The solution with the motion of least cost, or why there is none."""
    former, options = solution.trajectory, solution.options
    assert former is not None  # noqa: S101
    objective = TimeAndEnergy.of(options)

    def least(program: NonlinearProgram, z: Array) -> tuple[TimeAndEnergy, Array]:
        return objective, _as_slow_as_is_best(objective, program, z)

    cheapest = another_motion(solution, partial(_layout, solution, former), least)
    found = replace(
        solution,
        status=cheapest.status,
        trajectory=cheapest.trajectory,
        initial=former,
        verification=cheapest.verification,
        violations={},
    )
    if not cheapest.found or found.cost > solution.cost:
        return NO_CHEAPER
    return replace(found, message=_message(found, former))


def _layout(solution: Solution, motion: Trajectory, halvings: int) -> Layout:
    """Layout of splines that fit the energy, on a finer grid than that of the search.

    Torques that spend little do not jump; where work counts, motors push, coast and
    brake, and torques jump between. They jump where segments end as well, as what is
    carried changes there.
    """
    problem, options = solution.problem, solution.options
    layout = Layout.of_motion(motion, problem.segments) or Layout.of_torques(motion)
    finer = 2**halvings * FINER[options.energy]
    layout = layout.with_intervals(finer * len(layout.shares))
    if layout.degree == LIFTED:
        return layout
    degree, breaks = layout.degree, layout.segment_ends[:-1]
    if options.control not in DEGREES:
        degree = QUADRATIC if options.energy == "work" else DEGREES["linear"]
    if degree == QUADRATIC or not ProblemFunctions.of(problem).sudden:
        breaks = ()
    return replace(layout, degree=degree, breaks=breaks)


def _message(found: Solution, former: Trajectory) -> str:
    """What was found, in a sentence."""
    assert found.trajectory is not None and found.energy is not None  # noqa: S101
    share = 100.0 * (found.T / former.duration - 1.0)
    # On a finer grid it may take less.
    more = f"{abs(share):.3g} % {'more' if share >= 0.0 else 'less'}"
    converged = found.status is Status.CONVERGED
    begin = "A locally optimal" if converged else f"{found.status.value} A"
    weight = found.options.energy_weight
    name, unit = ENERGIES[found.options.energy]
    return (
        f"{begin} trade of time against {name} was found. "
        f"T = {found.T:.4f} s, {more} than the fastest motion of the search, "
        f"{name} = {found.energy:.4g} {unit}, "
        f"T + {weight:g} {name} = {found.cost:.6g} s."
    )


def _as_slow_as_is_best(
    objective: TimeAndEnergy, nlp: NonlinearProgram, z: Array
) -> Array:
    """The same path, as slow as is best for it; as it is if limits do not allow it."""

    def slower(power: float) -> Array:
        return nlp.time_scale(z, float(np.exp(power)))

    found = minimize_scalar(
        lambda power: objective.value(nlp, slower(power), z),
        bounds=(0.0, np.log(SLOWEST)),
        method="bounded",
    )
    allowed = max(nlp.rows.largest_violation(nlp.evaluate(z)), objective.feasibility)
    for halvings in range(SLOWER_TRIALS):
        best = slower(float(found.x) / 2**halvings)
        if nlp.rows.largest_violation(nlp.evaluate(best)) <= allowed:
            return best
    return z
