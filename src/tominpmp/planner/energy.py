"""Time against energy: what follows the search where energy has a weight.

The fastest motion that was found, as slow as is best for its path, is where it begins.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from scipy.optimize import minimize_scalar

from tominpmp.arrays import Array
from tominpmp.motion.trajectory import Trajectory
from tominpmp.options import Options
from tominpmp.planner.later_stage import another_motion, bettered
from tominpmp.solution import Solution
from tominpmp.solvers.time_and_energy import TimeAndEnergy
from tominpmp.status import Status
from tominpmp.transcription.bspline import DEGREES
from tominpmp.transcription.layout import LIFTED, QUADRATIC, Layout
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import NonlinearProgram

# How much slower than the fastest motion along its path another one is tried, at most.
SLOWEST = 100.0
# How much finer the grid is than that of the search: motions that spend less have no
# torques that jump, as those of the fastest motion do, or jump elsewhere.
FINER = 2
# How often a slower pace is halved that breaks limits, as of times of arrival.
SLOWER_TRIALS = 6
UNITS = {"torque_squared": "N^2 m^2 s", "work": "J"}
NO_CHEAPER = "none of less cost was found."


def economical(solution: Solution, options: Options) -> Solution:
    """The motion of least T + k times its energy.

    Args:
        solution: The fastest motion that was found.
        options: Options of the plan.

    Returns:
        The motion, or the fastest one with a message that says why there is none.
    """
    solution = replace(solution, options=options)
    if solution.trajectory is None or not solution.success:
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

    made = another_motion(solution, partial(_layout, solution, former), least)
    found = replace(
        solution,
        status=made.status,
        trajectory=made.trajectory,
        initial=former,
        verification=made.verification,
        violations={},
    )
    if not made.found or found.cost > solution.cost:
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
    layout = layout.with_intervals(2**halvings * FINER * options.intervals)
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
    settled = "A locally optimal" if found.status is Status.CONVERGED else "A"
    begin = "" if found.status is Status.CONVERGED else f"{found.status.value} "
    weight, unit = found.options.energy_weight, UNITS[found.options.energy]
    name = "work" if found.options.energy == "work" else "energy"
    return (
        f"{begin}{settled} trade of time against {name} was found. "
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
    best, power = z, float(found.x)
    allowed = max(nlp.rows.largest_violation(nlp.evaluate(z)), objective.feasibility)
    for _ in range(SLOWER_TRIALS):
        best = slower(power)
        if nlp.rows.largest_violation(nlp.evaluate(best)) <= allowed:
            return best
        power *= 0.5
    return z
