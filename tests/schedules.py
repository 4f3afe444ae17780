"""Schedules of the planner, carried out without a plan round them."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, TypeVar

from tominpmp.planner.plan_state import PlanState
from tominpmp.planner.work import Schedule, run
from tominpmp.status import Status

T = TypeVar("T")


def carried_out(state: PlanState, schedule: Schedule[T]) -> T:
    """Do all that a schedule says; returns what it ends with."""
    answer = None
    while True:
        try:
            work = schedule.send(answer)
        except StopIteration as end:
            result: T = end.value
            return result
        answer = run(state, work)


def loop_with(records: list[Any], **attributes: Any) -> Any:
    """A loop of a solver as far as rules look at it."""
    drop = {"drop": lambda: Status.STALLED}
    return SimpleNamespace(history=records, **drop, **attributes)
