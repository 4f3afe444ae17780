"""Exact switches: torques of the best motion switch where they do, not at nodes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from importlib import import_module

from tominpmp.options import Options
from tominpmp.planner.candidate import Candidate
from tominpmp.planner.plan_state import PlanState
from tominpmp.planner.rescue import improvement_of
from tominpmp.problem import Problem
from tominpmp.status import STOPPED
from tominpmp.transcription.bspline import DEGREES
from tominpmp.transcription.problem_functions import ProblemFunctions

SMOOTH = "Its switches were not placed exactly: that is not done for control {!r}."


def with_exact_switches(
    problem: Problem,
    options: Options,
    progress: PlanState,
    candidates: Sequence[Candidate],
) -> Iterator[Candidate]:
    """Place the switches of the best motion exactly.

    Args:
        problem: The problem.
        options: Options of the plan.
        progress: Time limit and callback.
        candidates: What was found.

    Yields:
        The motion, or the one on the grid with a remark.
    """

    def order(candidate: Candidate) -> tuple[float, bool, float]:
        return candidate.duration, not candidate.feasible, candidate.trajectory.duration

    best = min(candidates, key=order, default=None)
    if best is None or best.status in STOPPED:
        return
    if options.refine == "switching" and options.control in DEGREES:
        yield replace(best, history=(), remark=SMOOTH.format(options.control))
        return
    # An add-on: loaded by name, so that the core works without it.
    exact = import_module("tominpmp.exact.switching_refinement")

    def work(system: ProblemFunctions) -> Candidate:
        placed: Candidate = exact.exact_switches(system, options, best, progress)
        return placed

    found = improvement_of(problem, options, progress, best, work)
    if found is not None:
        yield found
