"""Time against energy: what follows the search where energy has a weight.

The fastest motion that was found, as slow as is best for its path, is where it begins.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from scipy.optimize import minimize_scalar

from tominpmp.arrays import Array
from tominpmp.initial_guess.guess import Guess
from tominpmp.initial_guess.segments import SegmentedGuess, solved_guess
from tominpmp.initial_guess.warm_start import warm_start
from tominpmp.options import Control, Options
from tominpmp.planner.direct_solve import first_program, segmented_program
from tominpmp.planner.later_stage import Over, bettered, made
from tominpmp.solution import Solution
from tominpmp.solvers.energy import EnergySolver
from tominpmp.solvers.iterate import SlpResult
from tominpmp.solvers.rounds import solve_in_rounds
from tominpmp.status import Status
from tominpmp.trajectory import Trajectory
from tominpmp.transcription.bspline import DEGREES
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import NonlinearProgram

# How much slower than the fastest motion along its path another one is tried, at most.
SLOWEST = 100.0
# How much finer the grid is than that of the search: motions that spend less have no
# torques that jump, as those of the fastest motion do, or jump elsewhere.
FINER = 2
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
    options = solution.options
    intervals = FINER * options.intervals
    motion = made(solution, former, intervals, _taken, partial(_solved, options))
    if motion is None or not motion.verification.ok:
        return NO_CHEAPER
    found = replace(
        solution,
        status=motion.status,
        trajectory=motion.trajectory,
        initial=former,
        verification=motion.verification,
        violations={},
    )
    if found.cost > solution.cost:
        return NO_CHEAPER
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


def _taken(system: ProblemFunctions, former: Trajectory) -> Guess:
    """The fastest motion as a guess."""
    if system.parts:
        return solved_guess("former motion", former, system.problem.segments)
    return warm_start(system, former)


def _solved(
    options: Options,
    system: ProblemFunctions,
    guess: Guess,
    intervals: int,
    over: Over,
) -> tuple[Trajectory | None, Status]:
    """The motion of least cost on a grid, and how the iteration ended."""
    weight = options.energy_weight
    program, z = _program(system, replace(options, intervals=intervals), guess)
    z = _as_slow_as_is_best(EnergySolver(program, options, weight), z)

    def solve(
        program: NonlinearProgram, z: Array, options: Options, _: SlpResult | None
    ) -> SlpResult:
        return EnergySolver(program, options, weight, over).run(z)

    program, result = solve_in_rounds(program, z, options, solve, rough=False)
    if result.best is None:
        return None, result.status
    return program.trajectory(result.best.z), result.status


def _program(
    system: ProblemFunctions, options: Options, guess: Guess
) -> tuple[NonlinearProgram, Array]:
    """Program for the fastest motion, and that motion as its iterate."""
    smooth = options.control in DEGREES
    if options.method != "collocation" and not smooth:
        # Where work counts, motors push, coast and brake, and torques jump between.
        control: Control = "constant" if options.energy == "work" else "linear"
        options = replace(options, control=control)
    if isinstance(guess, SegmentedGuess):
        # What is carried changes at the ends of segments, and so do torques.
        return segmented_program(system, options, guess, breaks=not smooth)
    return first_program(system, options, guess)


def _as_slow_as_is_best(solver: EnergySolver, z: Array) -> Array:
    """The same path, as slow as is best for it."""
    found = minimize_scalar(
        lambda power: solver.objective(solver.nlp.stretch(z, float(np.exp(power)))),
        bounds=(0.0, np.log(SLOWEST)),
        method="bounded",
    )
    return solver.nlp.stretch(z, float(np.exp(found.x)))
