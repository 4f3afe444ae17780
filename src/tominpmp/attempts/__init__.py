"""Attempts: what one initial guess, or a former motion, leads to."""

from tominpmp.attempts.attempt import Attempt
from tominpmp.attempts.clock import (
    check_clock,
    on_clock,
    puts_off_replays,
    searching,
)
from tominpmp.attempts.conclusion import conclude
from tominpmp.attempts.continuation import solve_with_continuous_accelerations
from tominpmp.attempts.rescue import guarded
from tominpmp.attempts.starts import make_attempts
from tominpmp.attempts.watch import Watch

__all__ = [
    "Attempt",
    "Watch",
    "check_clock",
    "conclude",
    "guarded",
    "make_attempts",
    "on_clock",
    "puts_off_replays",
    "searching",
    "solve_with_continuous_accelerations",
]
