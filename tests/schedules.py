"""Schedules of the planner, carried out without a plan round them."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, TypeVar
from unittest import mock

from tominpmp.planner.plan_state import PlanState
from tominpmp.planner.work import Schedule, run
from tominpmp.status import Status

T = TypeVar("T")


def carried_out(state: PlanState, schedule: Schedule[T]) -> T:
    """Do all that a schedule says, whatever is cut short; returns what it ends with."""
    results = list[T]()

    def whole() -> Schedule[None]:
        results.append((yield from schedule))

    with mock.patch.object(PlanState, "ended", None):
        run(state, whole())
    return results[0]


def loop_with(records: list[Any], **attributes: Any) -> Any:
    """A loop of a solver as far as rules look at it."""
    drop = {"drop": lambda: Status.STALLED}
    return SimpleNamespace(history=records, **drop, **attributes)
