"""The loop that all methods share: step, stop rules, row exchange.

Each iteration takes a step that reduces an objective under the constraints of a
nonlinear program. Objective, step and stop rule are values, and can be exchanged:

- the objective is minimum time (:mod:`~tominpmp.solvers.objective`), time against
  energy (:mod:`~tominpmp.solvers.time_and_energy`), or quiet torques in a given time
  (:mod:`~tominpmp.solvers.quiet_torques`),
- the step solves a convex program within a trust region
  (:mod:`~tominpmp.solvers.trust_region_step`), is the fixed step of the paper
  (:mod:`~tominpmp.solvers.fixed_step`), or a round of the penalty method
  (:mod:`~tominpmp.solvers.penalty`),
- stop rules (:func:`until_settled` and others) are evaluated after each step, and are
  combined by :func:`first_of`.

During the iteration and at its end, constraints that are violated between the rows
become rows of the program (:mod:`~tominpmp.solvers.exchange`).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np

from tominpmp.arrays import Array
from tominpmp.linear_programs.program import LpSolution
from tominpmp.solvers.iterate import Iterate, SlpResult, StepOutcome
from tominpmp.status import IterationRecord, Status
from tominpmp.transcription.program import NonlinearProgram

if TYPE_CHECKING:
    from tominpmp.solvers.objective import Objective

# Receives every record.
Callback = Callable[[IterationRecord], None]
# Receives intermediate iterates, in case the loop is cut short.
Keep = Callable[[NonlinearProgram, Iterate], None]
# Stop rule: the status with which the loop ends; None to continue.
Rule = Callable[["Loop"], Status | None]
# Iterations that follow near an optimum: after rows have joined, even beyond the
# iteration limit, and from a warm start.
ITERATIONS = 25
# Least trust-region radius of a loop that has settled, as a share of the initial one.
SETTLED_RADIUS = 0.01
# Radius below which a loop has stalled, as a share of the initial one.
SMALLEST_RADIUS = 1e-6


class Step(Protocol):
    """Makes the steps of a loop."""

    def first_weight(self, kind: str) -> float:
        """Initial penalty weight of a kind of rows, as a multiple of the objective."""

    def __call__(self, loop: Loop) -> None:
        """Make a step, and advance the loop to the new iterate."""


class Exchange(Protocol):
    """Adds rows to the program for constraints that are violated between its rows."""

    def due(self, loop: Loop, status: Status | None) -> bool:
        """Whether an exchange is due; ``status`` is that of the stop rules, or None."""

    def join(self, loop: Loop, status: Status | None) -> tuple[Exchange, Status | None]:
        """Add the missing rows; the updated exchange, and the new status."""


def solve(
    program: NonlinearProgram,
    objective: Objective,
    z: Array,
    step: Step,
    stop: Rule,
    *,
    exchange: Exchange | None = None,
    callback: Callback | None = None,
    keep: Keep | None = None,
) -> SlpResult[NonlinearProgram]:
    """Iterate until a stop rule applies and no constraint is violated between the rows.

    Args:
        program: The nonlinear program.
        objective: The objective to be minimised.
        z: The initial iterate.
        step: Makes the steps.
        stop: Stop rule.
        exchange: Row exchange; None for programs with fixed rows.
        callback: Receives every record.
        keep: Receives the best iterate, if one is feasible, and the present one after
            every step, as a stop may be requested at any time.

    Raises:
        Stop: If a stop was requested; the best iterate has been handed to ``keep``.
    """
    first = Iterate.of(program, z, 0.0)
    value = objective.value(program, z, first.values)
    weights = value * np.array([step.first_weight(kind) for kind in first.rows.kinds])
    first = replace(first, weights=weights)
    loop = Loop(program, objective, first, callback, keep)
    loop.save()
    status = loop.first_feasible()
    while status is None:
        step(loop)
        status = loop.first_feasible() or stop(loop)
        if exchange is not None and exchange.due(loop, status):
            exchange, status = exchange.join(loop, status)
    if status is Status.CONVERGED and loop.best is None:
        status = Status.INFEASIBLE
    history = tuple(loop.history)
    return SlpResult(status, loop.state, loop.best, history, loop.program, loop.dropped)


@dataclass(eq=False)
class Loop:
    """A running loop: its iterate, and the records of its steps.

    Attributes:
        program: The nonlinear program, with the rows that have joined it.
        objective: The objective to be minimised.
        state: The present iterate.
        callback: Receives every record.
        keep: Receives the best iterate, if one is feasible, and the present one.
        best: The best feasible iterate; None while there is none.
        outcome: Outcome of the last step; None if its program could not be solved.
        history: Records, one per iteration.
        extended_limit: Iteration limit after the last row exchange, if it exceeds the
            usual limit.
        dropped: Whether a stop rule has given the motion up: no further rows join.
    """

    program: NonlinearProgram
    objective: Objective
    state: Iterate
    callback: Callback | None = None
    keep: Keep | None = None
    best: Iterate | None = None
    outcome: StepOutcome | None = None
    history: list[IterationRecord] = field(default_factory=list)
    extended_limit: int = 0
    dropped: bool = False
    _begin: float = field(default_factory=time.perf_counter)
    _programs: list[tuple[int, float]] = field(default_factory=list)

    def count(self, solution: LpSolution, begin: float) -> LpSolution:
        """Record the iterations and the time of a solved program; its solution."""
        self._programs.append((solution.iterations, time.perf_counter() - begin))
        return solution

    def advance(self, state: Iterate, outcome: StepOutcome | None) -> None:
        """Advance to the iterate after a step, and record the iteration."""
        self.program = self.program.centred_at(state.z)
        self.state, self.outcome = state, outcome
        self.save()
        record = IterationRecord(
            iteration=len(self.history),
            duration=state.duration,
            violation=state.violation,
            objective=np.inf if outcome is None else outcome.trial.merit,
            predicted=0.0 if outcome is None else outcome.predicted,
            actual=0.0 if outcome is None else outcome.actual,
            radius=state.radius,
            accepted=outcome is not None and outcome.accepted,
            programs=len(self._programs),
            pivots=sum(iterations for iterations, _ in self._programs),
            program_seconds=sum(seconds for _, seconds in self._programs),
            seconds=time.perf_counter() - self._begin,
        )
        self._programs = []
        self.history.append(record)
        if self.callback is not None:
            self.callback(record)

    def first_feasible(self) -> Status | None:
        """FEASIBLE if any motion will do, and one is known; None otherwise."""
        found = self.objective.any_will_do and self.best is not None
        return Status.FEASIBLE if found else None

    def drop(self) -> Status:
        """Mark the motion as dropped; the status with which the loop ends."""
        self.dropped = True
        return Status.STALLED

    def save(self) -> None:
        """Keep the present iterate, slowed down to remove violations, if it is better.

        The best iterate, if there is one, and the present one are handed to ``keep``.
        """
        slower = self.objective.slowed(self.program, self.state)
        self.best = self.objective.better(self.program, slower, self.best)
        if self.keep is not None:
            for iterate in dict.fromkeys(filter(None, (self.best, self.state))):
                self.keep(self.program, iterate)


def first_of(*rules: Rule | None) -> Rule:
    """Combine stop rules, if any: the first one that applies determines the status."""

    def rule(loop: Loop) -> Status | None:
        verdicts = (each(loop) for each in filter(None, rules))
        return next((status for status in verdicts if status is not None), None)

    return rule


def collapsed(loop: Loop) -> Status | None:
    """STALLED if the trust region has collapsed; a failure if no program was solved."""
    if loop.state.radius >= SMALLEST_RADIUS:
        return None
    return Status.NUMERICAL_FAILURE if loop.outcome is None else Status.STALLED


def until_settled(heaviest: float, most: int) -> Rule:
    """Stop rule of iterations that adapt their weights, up to a number of iterations.

    It is CONVERGED if no more progress is made, and slowing down removes violations,
    and INFEASIBLE once violations cost too much for any multiplier: the weight of a
    violation is raised until it exceeds the multiplier of the constraint. If violations
    remain with a weight far above all multipliers, no small change removes them.

    Args:
        heaviest: Largest weight of a violation of 100 %, in multiples of the objective.
        most: Largest number of iterations.
    """

    def settled(loop: Loop) -> Status | None:
        if loop.outcome is not None and loop.outcome.settled:
            return Status.CONVERGED
        state = loop.state
        value = loop.objective.value(loop.program, state.z, state.values)
        heavy = np.max(state.weights, initial=0.0) > heaviest * value
        return Status.INFEASIBLE if heavy else None

    return first_of(settled, collapsed, iterations(most))


def iterations(most: int) -> Rule:
    """Stop rule: ITERATION_LIMIT at the limit, which row exchanges may extend."""

    def rule(loop: Loop) -> Status | None:
        limit = max(most, loop.extended_limit)
        over = loop.outcome is not None and len(loop.history) >= limit
        return Status.ITERATION_LIMIT if over else None

    return rule
