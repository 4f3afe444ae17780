"""Improvements of the incumbent: a table of them, in their order.

Torques switch where they do, not at nodes, once switches are exact; and only a motion
that keeps the first-order conditions is called optimal.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from importlib import import_module

import numpy as np

from tominpmp.options import Options
from tominpmp.planner.candidate import Candidate, best_of
from tominpmp.planner.descent import descent_work, guess_of
from tominpmp.planner.optimality import certified
from tominpmp.planner.plan_state import PlanState
from tominpmp.planner.work import Schedule, Work
from tominpmp.transcription.bspline import DEGREES
from tominpmp.transcription.problem_functions import ProblemFunctions

SMOOTH = "Its switches were not placed exactly: that is not done for control {!r}."


def with_exact_switches(
    state: PlanState, options: Options | None = None
) -> Schedule[None]:
    """Place the switches of the best motion exactly, or say why that is not done.

    Args:
        state: The plan.
        options: Replace the options of the plan, be exact switches asked for or not;
            the result is then kept only if it is faster than the motion it begins with.
    """
    best = best_of(state.candidates)
    wanted = options is not None or state.options.refine == "switching"
    if best is None or not wanted:
        return
    cutoff = np.inf if options is None else best.duration
    options = options or state.options
    if options.refine == "switching" and options.control in DEGREES:
        state.amend(best, remark=SMOOTH.format(options.control))
        return
    # An add-on: loaded by name, so that the core works without it.
    exact = import_module("tominpmp.exact.switching_refinement")

    def make(system: ProblemFunctions, *_: object) -> Candidate:
        placed: Candidate = exact.exact_switches(system, options, best, state)
        return placed

    work = Work.from_best(state, best, make)
    yield replace(work, self_collision_rows=True, cutoff=cutoff)
    best = state.incumbent
    if options.refine != "switching" or best is None or best.layout is None:
        return
    # Nothing exact was found: the grid follows the switches instead.
    system, finer = work.system, replace(options, refine="grid")
    found = yield descent_work(system, finer, guess_of(system, best), state)
    if found is not None:
        state.amend(found, remark=best.remark)


# Coroutines that improve the incumbent, or update its status, by their names. The gain
# of each is measured by `python -m benchmarks.ablation`, which leaves them out one at a
# time.
IMPROVEMENTS: dict[str, Callable[[PlanState], Schedule[None]]] = {
    "exact switches": with_exact_switches,
    "certificate": certified,
}


def improvements(state: PlanState) -> Schedule[None]:
    """Improve the incumbent in all ways that the options ask for.

    Args:
        state: The plan.
    """
    state.share(1)
    for improved in IMPROVEMENTS.values():
        yield from improved(state)
