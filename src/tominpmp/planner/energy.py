"""Time against energy: what follows the search where energy has a weight.

The fastest motion that was found, as slow as is best for its path, is where it begins.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.optimize import minimize_scalar

from tominpmp.arrays import Array
from tominpmp.initial_guess.segments import solved_guess
from tominpmp.initial_guess.warm_start import warm_start
from tominpmp.motion.trajectory import Trajectory
from tominpmp.options import Control, Options
from tominpmp.planner.first_program import (
    Begun,
    first_program,
    rested,
    segmented_program,
)
from tominpmp.planner.later_stage import Over, bent, bettered, made
from tominpmp.solution import Solution
from tominpmp.solvers.time_and_energy import TimeAndEnergy
from tominpmp.status import Status
from tominpmp.transcription.bspline import DEGREES
from tominpmp.transcription.layout import QUADRATIC, Layout, split_intervals
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
    former = solution.trajectory
    solution = replace(solution, options=options)
    if former is None or not solution.success:
        return solution

    def left(reason: str) -> Solution:
        message = f"{solution.message} This is the fastest motion: {reason}"
        return replace(solution, status=Status.FEASIBLE, message=message)

    return bettered(
        solution, partial(_best, solution, former), left, "weighing its energy"
    )


def _best(solution: Solution, former: Trajectory) -> Solution | str:
    """The solution with the motion of least cost, or why there is none."""
    options, found = solution.options, None
    fits = options.control in DEGREES
    if options.energy == "work":
        fits = fits or former.degree == QUADRATIC
    if options.method == "collocation" or not fits:
        found = _cheaper(solution, former, _converted)
    if found is None and options.method != "collocation":
        # Where another spline is too far from what the problem allows, the motion is
        # bettered as it is.
        found = _cheaper(solution, former, _represented)
    return NO_CHEAPER if found is None else found


def _cheaper(
    solution: Solution,
    former: Trajectory,
    begun: Callable[[ProblemFunctions, Options, Trajectory], Begun],
) -> Solution | None:
    """The solution with a motion of less cost, begun with one kind of program."""
    options = solution.options
    make = partial(_solved, options, begun, former)
    motion = made(solution, former, FINER * options.intervals, make)
    if motion is None or not motion.verification.ok:
        return None
    found = replace(
        solution,
        status=motion.status,
        trajectory=motion.trajectory,
        initial=former,
        verification=motion.verification,
        violations={},
    )
    if found.cost > solution.cost:
        return None
    return replace(found, message=_message(found, former))


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


def _solved(
    options: Options,
    begun: Callable[[ProblemFunctions, Options, Trajectory], Begun],
    former: Trajectory,
    system: ProblemFunctions,
    intervals: int,
    over: Over,
) -> tuple[Trajectory | None, Status]:
    """The motion of least cost on a grid, and how the iteration ended."""
    program, z = begun(system, replace(options, intervals=intervals), former)
    objective = TimeAndEnergy.of(options)
    z = _as_slow_as_is_best(objective, program, z)
    result = bent(program, objective, z, options, over)
    if result.best is None:
        return None, result.status
    return result.program.trajectory(result.best.z), result.status


def _converted(system: ProblemFunctions, options: Options, former: Trajectory) -> Begun:
    """Program near to the fastest motion, of splines that fit the energy.

    Torques that spend little do not jump; where work counts, motors push, coast and
    brake, and torques jump between.
    """
    if options.method != "collocation":
        control: Control = "constant" if options.energy == "work" else "linear"
        options = replace(options, control=control)
    if not system.parts:
        return first_program(system, options, warm_start(system, former))
    # What is carried changes at the ends of segments, and so do torques.
    guess = solved_guess("former motion", former, system.problem.segments)
    return segmented_program(system, options, guess, breaks=True)


def _represented(
    system: ProblemFunctions, options: Options, former: Trajectory
) -> Begun:
    """Program of the fastest motion itself, on a finer grid."""
    layout = Layout.of_motion(former, system.problem.segments)
    if layout is None:
        return _converted(system, options, former)
    of, z = layout.represented(system, former)
    while of.intervals < options.intervals:
        longest = np.argsort(-of.motion(z).h, kind="stable")
        split = np.zeros(of.intervals, dtype=bool)
        split[longest[: options.intervals - of.intervals]] = True
        of, z = split_intervals(of, z, split)
    return rested(NonlinearProgram.of(of).at(z), z)


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
