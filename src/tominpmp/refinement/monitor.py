"""What tells a refinement when to stop."""

from __future__ import annotations

from typing import Protocol

from tominpmp.solution import IterationRecord, Status


class Monitor(Protocol):
    """Time limit and callback; see :class:`~tominpmp.attempts.Watch`."""

    @property
    def over(self) -> bool:
        """Whether the planning time is used up."""

    def __call__(self, record: IterationRecord) -> Status | None:
        """See a record; a status ends the iteration."""
