"""Attempts: what one initial guess, or a former motion, leads to."""

from tominpmp.attempts.attempt import STOPPED, Attempt
from tominpmp.attempts.clock import check_clock, on_clock, searching
from tominpmp.attempts.continuation import (
    solve_from_former,
    solve_with_continuous_accelerations,
)
from tominpmp.attempts.guessed import solve_alone, solve_and_verify
from tominpmp.attempts.shooting import shots
from tominpmp.attempts.watch import Watch

__all__ = [
    "STOPPED",
    "Attempt",
    "Watch",
    "check_clock",
    "on_clock",
    "searching",
    "shots",
    "solve_alone",
    "solve_and_verify",
    "solve_from_former",
    "solve_with_continuous_accelerations",
]
