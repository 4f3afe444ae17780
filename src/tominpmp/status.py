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
        iteration: Its number, from 0.
        duration: T after it [s].
        violation: Largest violation after it, in the scaled units of the rows.
        objective: Merit after it [s].
        predicted: Reduction of the merit that the linear program predicted [s].
        actual: Reduction of the merit that the step achieved [s].
        radius: Trust region radius, as a share of the initial one.
        accepted: Whether the step was taken.
        programs: Linear programs solved in it.
        pivots: Simplex or interior-point iterations in them.
        program_seconds: Time spent in them [s].
        seconds: Time since the start of planning [s].
        start: Number of the initial guess that it belongs to.
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
