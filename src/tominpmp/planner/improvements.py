"""Improvements of the incumbent: a table of them, in their order."""

from __future__ import annotations

from collections.abc import Callable

from tominpmp.planner.exact_switches import with_exact_switches
from tominpmp.planner.optimality import certified
from tominpmp.planner.plan_state import PlanState
from tominpmp.planner.work import Schedule

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
