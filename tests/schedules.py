"""Running schedules of the planner without a plan."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, TypeVar
from unittest import mock

from tominpmp.planner.plan_state import PlanState
from tominpmp.planner.work import Schedule, run
from tominpmp.status import Status

T = TypeVar("T")


def carried_out(state: PlanState, schedule: Schedule[T]) -> T:
    """Run a schedule to its end, also if works are cut short; returns its result."""
    results = list[T]()

    def whole() -> Schedule[None]:
        results.append((yield from schedule))

    with mock.patch.object(PlanState, "ended", None):
        run(state, whole())
    return results[0]


def loop_with(records: list[Any], **attributes: Any) -> Any:
    """The attributes of a solver's loop that stop rules read."""
    drop = {"drop": lambda: Status.STALLED}
    return SimpleNamespace(history=records, **drop, **attributes)
