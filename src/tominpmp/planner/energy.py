"""Time against energy: what follows the search where energy has a weight.

The fastest motion that was found, as slow as is best for its path, is where it begins.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize_scalar

from tominpmp.arrays import Array
from tominpmp.exceptions import OptionsError
from tominpmp.initial_guess.warm_start import WarmStart, warm_start
from tominpmp.options import Options
from tominpmp.planner.attempt import REFINEMENTS
from tominpmp.planner.rescue import NUMERICAL
from tominpmp.problem import Problem
from tominpmp.solution import Solution
from tominpmp.solvers.energy import EnergySolver
from tominpmp.solvers.iterate import SlpResult
from tominpmp.solvers.rounds import solve_in_rounds
from tominpmp.status import Status
from tominpmp.stopping import Stop, bounded, seconds_left
from tominpmp.trajectory import Trajectory
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import NonlinearProgram
from tominpmp.verification import verify

logger = logging.getLogger(__name__)

# How much slower than the fastest motion along its path another one is tried, at most.
SLOWEST = 100.0
# Time for the replay of what was found, in multiples of what the last one took.
REPLAYS = 2.0
# Splines whose accelerations are continuous, and how much finer their grid is: their
# torques do not jump, as those of the fastest motion do.
DEGREE, FINER = 3, 2


def check_energy(problem: Problem, options: Options) -> None:
    """Refuse options that know no energy.

    Raises:
        OptionsError: If there is one.
    """
    if options.energy_weight == 0.0:
        return
    known = {
        "method": ("auto", "inverse", "collocation"),
        "objective": ("time",),
        "control_period": (None,),
        "slack": (None,),
    }
    for name, allowed in known.items():
        value = getattr(options, name)
        if value not in allowed:
            raise OptionsError(
                f"{name} is {value!r}, and energy_weight is {options.energy_weight:g}: "
                f"expected {' or '.join(map(repr, allowed))}",
                name,
            )
    if problem.segments:
        raise OptionsError(
            f"energy_weight is {options.energy_weight:g}, and the problem has several "
            "segments: expected 0 for these",
            "energy_weight",
        )


def economical(solution: Solution, options: Options) -> Solution:
    """The motion of least T + k times the integral of the squared torques.

    Args:
        solution: The fastest motion that was found.
        options: Options of the plan.

    Returns:
        The motion, or the fastest one with a message that says why there is none.
    """
    begin = time.perf_counter()
    former = solution.trajectory
    solution = replace(solution, options=options)
    if former is None or not solution.success:
        return solution

    def left(reason: str) -> Solution:
        message = f"{solution.message} This is the fastest motion: {reason}"
        return replace(solution, status=Status.FEASIBLE, message=message)

    try:
        with bounded(options.max_planning_time):
            found = _best(solution, former)
    except (Stop, KeyboardInterrupt) as stop:
        if isinstance(stop, Stop) and not stop.requested:
            return left("there was no time to weigh its energy.")
        return replace(left("this was interrupted."), status=Status.INTERRUPTED)
    except NUMERICAL as error:
        logger.warning("weighing energy failed: %r", error)
        return left(f"weighing its energy failed ({type(error).__name__}).")
    if found is None:
        return left("none of less cost was found.")
    seconds = solution.planning_time + time.perf_counter() - begin
    return replace(found, planning_time=seconds)


def _best(solution: Solution, former: Trajectory) -> Solution | None:
    """The solution with the motion of least cost, if one was found."""
    options, problem = solution.options, solution.problem
    replay = 0.0 if solution.verification is None else solution.verification.seconds

    def over() -> bool:
        return seconds_left() < REPLAYS * replay

    complete = ProblemFunctions.of(problem.alternative_at(former.q[-1], former.v[-1]))
    system, intervals = complete.first_tried, FINER * options.intervals
    guess = warm_start(system, former)
    for refinement in range(1 + REFINEMENTS):
        motion, status = _solved(system, options, guess, intervals, over)
        if motion is None:
            return None
        verdict = verify(problem, motion, options.tolerances, checker=problem.checker)
        found = replace(
            solution,
            status=status,
            trajectory=motion,
            initial=former,
            verification=verdict,
            violations={},
        )
        if verdict.ok:
            found = replace(found, message=_message(found, former))
            return found if found.cost <= solution.cost else None
        if over():
            return None
        if any(item.kind == "clearance" for item in verdict.violations):
            system = complete  # with rows for the links
        intervals = intervals * 2 ** (refinement + 1)
    return None


def _message(found: Solution, former: Trajectory) -> str:
    """What was found, in a sentence."""
    assert found.trajectory is not None and found.energy is not None  # noqa: S101
    more = 100.0 * (found.T / former.duration - 1.0)
    settled = "A locally optimal" if found.status is Status.CONVERGED else "A"
    begin = "" if found.status is Status.CONVERGED else f"{found.status.value} "
    return (
        f"{begin}{settled} trade of time against energy was found. "
        f"T = {found.T:.4f} s, {more:.3g} % more than the fastest motion found, "
        f"energy = {found.energy:.4g} N^2 m^2 s, "
        f"T + {found.options.energy_weight:g} energy = {found.cost:.6g} s."
    )


def _solved(
    system: ProblemFunctions,
    options: Options,
    guess: WarmStart,
    intervals: int,
    over: Callable[[], bool],
) -> tuple[Trajectory | None, Status]:
    """The motion of least cost on a grid, and how the iteration ended."""
    if options.method == "collocation":
        program, z = guess.lifted_program(system, intervals, options.grid)
    else:
        program, z = guess.spline_program(system, intervals, options.grid, DEGREE)
    weight = options.energy_weight
    z = _as_slow_as_is_best(EnergySolver(program, options, weight), z)

    def solve(
        program: NonlinearProgram, z: Array, options: Options, _: SlpResult | None
    ) -> SlpResult:
        return EnergySolver(program, options, weight, over).run(z)

    program, result = solve_in_rounds(program, z, options, solve, rough=False)
    if result.best is None:
        return None, result.status
    return program.trajectory(result.best.z), result.status


def _as_slow_as_is_best(solver: EnergySolver, z: Array) -> Array:
    """The same path, as slow as is best for it."""
    found = minimize_scalar(
        lambda power: solver.objective(solver.nlp.stretch(z, float(np.exp(power)))),
        bounds=(0.0, np.log(SLOWEST)),
        method="bounded",
    )
    return solver.nlp.stretch(z, float(np.exp(found.x)))
