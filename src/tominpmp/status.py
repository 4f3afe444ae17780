"""Outcome of planning, and the record of an iteration."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Status(Enum):
    """Outcome of planning; the value is a sentence."""

    CONVERGED = "A locally time-optimal motion was found."
    FEASIBLE = "A motion that keeps all constraints was found, not the fastest one."
    ITERATION_LIMIT = "The iteration limit was reached before the duration had settled."
    TIME_LIMIT = "The planning time was used up before the duration had settled."
    INTERRUPTED = "The planning was interrupted."
    STALLED = "The iteration made no more progress before the duration had settled."
    UNVERIFIED = "A motion was found, but its verification failed."
    INFEASIBLE = "No motion was found that keeps all constraints."
    NUMERICAL_FAILURE = "The linear programs could not be solved."


# Outcomes of an iteration that was stopped from outside.
STOPPED = (Status.TIME_LIMIT, Status.INTERRUPTED)


@dataclass(frozen=True)
class IterationRecord:
    """One iteration of a solver.

    Attributes:
        iteration: Number of the iteration in its start, from 0.
        duration: T of the iterate [s].
        violation: Largest violation of the iterate, in the scaled units of the rows.
        objective: Merit of the iterate [s].
        predicted: Reduction of the merit that the linear program predicted [s].
        actual: Reduction of the merit that the step achieved [s].
        radius: Trust region radius, as a share of the initial one.
        accepted: Whether the step was taken.
        programs: Number of linear programs that were solved.
        pivots: Simplex or interior-point iterations of these programs.
        program_seconds: Time for these programs [s].
        seconds: Time since the start of planning [s].
        start: Number of the start, from 0: a descent or its improvement.
    """

    iteration: int
    duration: float
    violation: float
    objective: float
    predicted: float
    actual: float
    radius: float
    accepted: bool
    programs: int
    pivots: int
    program_seconds: float
    seconds: float
    start: int = 0
