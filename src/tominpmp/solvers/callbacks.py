"""Callbacks of solvers: they are told of motions on the way, and may stop."""

from __future__ import annotations

from collections.abc import Callable

from tominpmp.solvers.iterate import Iterate
from tominpmp.status import IterationRecord, Status
from tominpmp.transcription.base import Program

# Sees every record; a status ends the iteration.
Callback = Callable[[IterationRecord], Status | None]
# Is given motions on the way, should the rest be cut short.
Keep = Callable[[Program, Iterate], None]


def go_on(record: IterationRecord) -> Status | None:
    """Let the iteration go on."""
    return None


def keep_nothing(program: Program, iterate: Iterate) -> None:
    """Let a motion on the way go."""
