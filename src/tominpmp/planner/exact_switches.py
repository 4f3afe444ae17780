"""Exact switches: torques of the best motion switch where they do, not at nodes."""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module

import numpy as np

from tominpmp.options import Options
from tominpmp.planner.candidate import Candidate
from tominpmp.planner.plan_state import PlanState
from tominpmp.planner.work import Policy, Work
from tominpmp.transcription.bspline import DEGREES
from tominpmp.transcription.problem_functions import ProblemFunctions

SMOOTH = "Its switches were not placed exactly: that is not done for control {!r}."


def with_exact_switches(
    state: PlanState, options: Options | None = None
) -> Policy[None]:
    """Place the switches of the best motion exactly, or say why that is not done.

    Args:
        state: The plan.
        options: Other options than those of the plan, which may go on from motions
            that are not faster then only.
    """

    def order(candidate: Candidate) -> tuple[float, bool, float]:
        return candidate.duration, not candidate.feasible, candidate.trajectory.duration

    best = min(state.candidates, key=order, default=None)
    worth = np.inf if options is None or best is None else best.duration
    options = options or state.options
    if best is None:
        return
    if options.refine == "switching" and options.control in DEGREES:
        remark = SMOOTH.format(options.control)
        state.candidates.append(replace(best, history=(), remark=remark))
        return
    # An add-on: loaded by name, so that the core works without it.
    exact = import_module("tominpmp.exact.switching_refinement")

    def make(system: ProblemFunctions, *_: object) -> Candidate:
        placed: Candidate = exact.exact_switches(system, options, best, state)
        return placed

    work = Work.from_best(state, best, make)
    yield replace(work, apart=True, worth=worth)
