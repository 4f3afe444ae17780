"""Improvements of the incumbent: a table of stages, in their order.

Exact switches free the switching times of torques from the nodes of the grid. The
certificate checks the first-order conditions; only a motion that satisfies them, or
that the lower bound proves to be optimal, is called optimal.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from importlib import import_module

from tominpmp.planner.candidate import Candidate, best_of
from tominpmp.planner.descent import descent_work, guess_of
from tominpmp.planner.optimality import certified
from tominpmp.planner.plan_state import PlanState
from tominpmp.planner.work import Schedule, Work
from tominpmp.transcription.bspline import DEGREES
from tominpmp.transcription.problem_functions import ProblemFunctions

SMOOTH = "Its switches were not placed exactly: that is not done for control {!r}."


def _with_exact_switches(state: PlanState) -> Schedule[None]:
    """Place the switches of the best motion exactly, or remark why this is not done.

    Args:
        state: The plan; nothing is done unless its options ask for exact switches.
    """
    best, options = best_of(state.candidates), state.options
    if best is None or options.refine != "switching":
        return
    if options.control in DEGREES:
        state.amend(best, remark=SMOOTH.format(options.control))
        return
    # An add-on is imported by name, so that the core works without it.
    exact = import_module("tominpmp.exact.switching_refinement")

    def make(system: ProblemFunctions, *_: object) -> Candidate:
        placed: Candidate = exact.exact_switches(system, best, state)
        return placed

    system = ProblemFunctions.of(state.problem.alternative_of(best.trajectory))
    yield Work(system, make, self_collision_rows=True)
    best = state.incumbent
    if best is None or best.layout is None:
        return
    # No exact switches were found: the grid is refined at the switches instead.
    finer = replace(options, refine="grid")
    candidate = yield descent_work(system, finer, guess_of(system, best), state)
    if candidate is not None:
        state.amend(candidate, remark=best.remark)


# Schedules that improve the incumbent or update its status, by name. The gain of each
# stage is measured by `python -m benchmarks.ablation`, which leaves out one at a time.
IMPROVEMENTS: dict[str, Callable[[PlanState], Schedule[None]]] = {
    "exact switches": _with_exact_switches,
    "certificate": certified,
}


def improvements(state: PlanState) -> Schedule[None]:
    """Run all stages of the table, with all of the remaining planning time.

    Args:
        state: The plan.
    """
    state.share_time(1)
    for improved in IMPROVEMENTS.values():
        yield from improved(state)
