"""Improvements of the incumbent: a table of them, in their order."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from tominpmp.options import Options
from tominpmp.planner.exact_switches import with_exact_switches
from tominpmp.planner.optimality import certified
from tominpmp.planner.plan_state import PlanState
from tominpmp.planner.work import Schedule


class Improvement(NamedTuple):
    """A way to improve the incumbent.

    The gain of each is measured by ``python -m benchmarks.ablation``, which leaves them
    out one at a time.

    Attributes:
        name: Its name.
        wanted: Whether options ask for it.
        improve: Coroutine that improves the incumbent, or updates its status.
    """

    name: str
    wanted: Callable[[Options], bool]
    improve: Callable[[PlanState], Schedule[None]]


IMPROVEMENTS = (
    Improvement(
        "exact switches",
        lambda options: options.refine == "switching",
        with_exact_switches,
    ),
    Improvement("certificate", lambda options: True, certified),
)


def improvements(state: PlanState) -> Schedule[None]:
    """Improve the incumbent in all ways that the options ask for.

    Args:
        state: The plan.
    """
    state.share(1)
    for improvement in IMPROVEMENTS:
        if improvement.wanted(state.options):
            yield from improvement.improve(state)
