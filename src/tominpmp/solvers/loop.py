"""The loop that all methods share: step, ask when to stop, look between the rows.

Each iteration takes a step towards less of an objective under the limits of a program.
Objective, step and stop are values, and each of them may be another one:

- the objective is the least time (:mod:`~tominpmp.solvers.objective`), time against
  energy (:mod:`~tominpmp.solvers.time_and_energy`), or quiet torques in a given time
  (:mod:`~tominpmp.solvers.quiet_torques`),
- the step is that of a convex program within a trust region
  (:mod:`~tominpmp.solvers.trust_region_step`), the fixed one of the paper
  (:mod:`~tominpmp.solvers.fixed_step`), or a round of the penalty method
  (:mod:`~tominpmp.solvers.penalty`),
- rules that go together tell when to stop (:mod:`~tominpmp.solvers.stop`).

On the way, or at the end, the motion is looked at between the rows
(:mod:`~tominpmp.solvers.exchange`).
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

import numpy as np

from tominpmp.arrays import Array
from tominpmp.linear_programs.program import LpSolution
from tominpmp.solvers.iterate import Iterate, Outcome, SlpResult
from tominpmp.status import IterationRecord, Status
from tominpmp.stopping import Stop, grace
from tominpmp.transcription.program import NonlinearProgram

if TYPE_CHECKING:
    from tominpmp.solvers.objective import Objective

# Sees every record; a status ends the loop.
Callback = Callable[[IterationRecord], Status | None]
# Is given motions on the way, should the rest be cut short.
Keep = Callable[[NonlinearProgram, Iterate], None]
# How a loop ends; None if it goes on.
Rule = Callable[["Loop"], Status | None]
# Time for slowing a motion down once the loop was asked to stop [s].
RESTORING = 0.2


class Step(Protocol):
    """A way to make steps."""

    def start(
        self, program: NonlinearProgram, objective: Objective, z: Array
    ) -> Iterate:
        """The iterate to begin with, and the weights of its violations."""

    def __call__(self, loop: Loop) -> None:
        """Make a step, and have the loop go where it leads to."""


class Look(Protocol):
    """A way to look between the rows."""

    def due(self, loop: Loop, status: Status | None) -> bool:
        """Whether it is time to look, with the status that the loop is to end with."""

    def look(self, loop: Loop, status: Status | None) -> tuple[Look, Status | None]:
        """Have rows join that are missing; how to look next, and the status then."""


def solve(
    program: NonlinearProgram,
    objective: Objective,
    z: Array,
    step: Step,
    stop: Rule,
    *,
    exchange: Look | None = None,
    callback: Callback | None = None,
    keep: Keep | None = None,
) -> SlpResult:
    """Iterate until it is time to stop, and the motion keeps its limits between rows.

    Args:
        program: The nonlinear program.
        objective: What is to be least.
        z: Where to begin.
        step: Makes the steps.
        stop: Tells when to stop, and how that is called.
        exchange: Looks between the rows; None for programs that no rows join.
        callback: Sees every record; a status ends the loop.
        keep: Is given the best motion so far, or the present one while there is none:
            the loop may be asked to stop at any time.

    Raises:
        Stop: If it was asked to; the motion that it had is kept.
    """
    first = step.start(program, objective, z)
    loop = Loop(program, objective, first, callback, keep)
    loop.save()
    if objective.any_will_do:
        loop.best = objective.better(program, first, None)
    status = None if loop.best is None else Status.FEASIBLE
    try:
        while status is None:
            step(loop)
            status = stop(loop) or loop.shown
            if objective.any_will_do and loop.best is not None:
                status = Status.FEASIBLE
            if exchange is not None and exchange.due(loop, status):
                exchange, status = exchange.look(loop, status)
    except (Stop, KeyboardInterrupt):
        with grace(RESTORING), contextlib.suppress(Stop):
            loop.end(None)
            loop.save()
        raise
    loop.end(status)
    if status is Status.CONVERGED and loop.best is None:
        status = Status.INFEASIBLE
    history = tuple(loop.history)
    return SlpResult(status, loop.state, loop.best, history, loop.program, loop.dropped)


@dataclass(eq=False)
class Loop:
    """A loop on the way: where it stands, and the records of its steps.

    Attributes:
        program: The nonlinear program, with the rows that have joined it.
        objective: What is to be least.
        state: Where it stands.
        callback: Sees every record; a status ends the loop.
        keep: Is given the best motion so far, or the present one while there is none.
        best: The best iterate that keeps its limits; None while there is none.
        outcome: Of the last step; None if its program could not be solved.
        history: One record an iteration.
        shown: How the callback ends the loop; None if it goes on.
        granted: Iterations that rows which have joined are granted in all.
        dropped: Whether a rule has given the motion up: it gets no further rows.
    """

    program: NonlinearProgram
    objective: Objective
    state: Iterate
    callback: Callback | None = None
    keep: Keep | None = None
    best: Iterate | None = None
    outcome: Outcome | None = None
    history: list[IterationRecord] = field(default_factory=list)
    shown: Status | None = None
    granted: int = 0
    dropped: bool = False
    _begun: float = field(default_factory=time.perf_counter)
    _solved: list[LpSolution] = field(default_factory=list)

    def counted(self, solution: LpSolution) -> LpSolution:
        """Count a program as work of the present iteration, and hand it on."""
        self._solved.append(solution)
        return solution

    def reached(self, state: Iterate, outcome: Outcome | None) -> None:
        """Go to where an iteration has led to, and tell of it."""
        self.program = self.program.near(state.z)
        self.state, self.outcome = state, outcome
        self.best = self.objective.better(self.program, state, self.best)
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
            programs=len(self._solved),
            pivots=sum(solution.iterations for solution in self._solved),
            program_seconds=sum(solution.seconds for solution in self._solved),
            seconds=time.perf_counter() - self._begun,
        )
        self._solved = []
        self.history.append(record)
        self.shown = None if self.callback is None else self.callback(record)

    def drop(self) -> Status:
        """Give the motion up."""
        self.dropped = True
        return Status.STALLED

    def end(self, status: Status | None) -> None:
        """Go to the motion that the loop ends with, slowed down if it has to be.

        Args:
            status: How it ends; None if it was asked to stop.
        """
        if status is Status.FEASIBLE and self.best is not None:
            self.state = self.best
        self.state = self.objective.restored(self.program, self.state)
        self.best = self.objective.better(self.program, self.state, self.best)

    def save(self) -> None:
        """Have the best motion kept, or the present one while there is none."""
        if self.keep is not None:
            self.keep(self.program, self.best or self.state)
