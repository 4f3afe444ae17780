"""Refinement: finer grids where a motion needs them, and exact switches."""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module

from tominpmp.linear_programs import LpSolver
from tominpmp.options import Options
from tominpmp.planner.grid_refinement import refine_grid
from tominpmp.planner.progress import Progress
from tominpmp.solvers.iterate import SlpResult
from tominpmp.status import STOPPED, Status
from tominpmp.transcription.base import Program
from tominpmp.transcription.problem_functions import ProblemFunctions

# What does not ask for a refinement of every motion.
LATER = (None, "auto")
# What needs no refinement: planning that was stopped, and a motion that will do.
DONE = (*STOPPED, Status.FEASIBLE)


def refine(
    system: ProblemFunctions,
    options: Options,
    program: Program,
    result: SlpResult,
    lp: LpSolver,
    progress: Progress,
) -> tuple[Program, SlpResult]:
    """Refine a motion as ``options.refine`` says.

    Args:
        system: The functions of the problem.
        options: Options of the plan.
        program: The program of the motion.
        result: Its solution.
        lp: Solver of linear programs.
        progress: Time limit and callback.

    Returns:
        Program and solution of the refined motion; what was given where nothing better
        was found. The motion is never slower, unless its replay was not all right.
    """
    if result.status in DONE:
        return program, result
    if options.refine in LATER:
        return program, result
    if options.refine == "grid":
        return refine_grid(system, options, program, result, lp, progress)
    # An add-on: loaded by name, so that the core works without it.
    exact = import_module("tominpmp.exact.switching_refinement")
    refined: tuple[Program, SlpResult] = exact.refine_switching(
        system, options, program, result, lp, progress
    )
    return refined


def unrefined(options: Options, result: SlpResult) -> SlpResult:
    """The outcome of a solver whose motions no refinement knows, with a word on it.

    Args:
        options: Options of the plan.
        result: The outcome.
    """
    if options.refine in LATER:
        return result
    way = f"method {options.method!r}"
    if options.method == "inverse":
        way = f"control {options.control!r}"
    return replace(result, remark=f"It was not refined: that is not done for {way}.")
