"""Records of iterations, for tests of reports and progress lines."""

from __future__ import annotations

from typing import Any

from tominpmp.status import IterationRecord

NUMBERS: dict[str, Any] = {
    "duration": 1.0,
    "violation": 0.0,
    "objective": 1.0,
    "predicted": 0.0,
    "actual": 0.0,
    "radius": 1.0,
    "accepted": True,
    "programs": 2,
    "pivots": 5,
    "program_seconds": 0.01,
    "seconds": 0.1,
}


def record(iteration: int, **changes: Any) -> IterationRecord:
    """A record with valid numbers, except those that are given."""
    return IterationRecord(iteration=iteration, **(NUMBERS | changes))
