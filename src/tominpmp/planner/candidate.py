"""Candidates: motions made from initial guesses, with their replays, and on the way."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from tominpmp.arrays import Array
from tominpmp.motion.trajectory import Trajectory
from tominpmp.options import Options
from tominpmp.problem.problem import Problem
from tominpmp.solvers.iterate import Iterate, SlpResult
from tominpmp.status import IterationRecord, Status
from tominpmp.transcription.base import Solved
from tominpmp.transcription.distance_rows import times_of_rows
from tominpmp.transcription.layout import Layout
from tominpmp.transcription.program import NonlinearProgram
from tominpmp.verification.verification import Verification, verify


class Kept(NamedTuple):
    """A motion on the way.

    Attributes:
        program: Its program.
        iterate: The motion.
        feasible: Whether it keeps all constraints of the program.
    """

    program: Solved
    iterate: Iterate
    feasible: bool


@dataclass(frozen=True, eq=False)
class Candidate:
    """The motion that one initial guess led to.

    Attributes:
        name: Name of the guess.
        status: How the iteration ended.
        feasible: Whether the motion keeps all constraints.
        trajectory: The best motion.
        initial: The motion it began with.
        violations: Largest violation by kind of constraint.
        history: One record an iteration.
        verification: Replay of the torques, if the motion is feasible.
        remark: A sentence for the user, if there is something to say.
        layout: How the motion was parameterised; None where only torques are.
        clearance_rows: Whether its program had clearance rows.
        dropped: Whether a rule of its iteration has given it up.
        coarser: The motion on a coarser grid that it was refined from; None for others.
        row_times: Times of the rows of distances in its program [s], by their block.
    """

    name: str
    status: Status
    feasible: bool
    trajectory: Trajectory
    initial: Trajectory
    violations: dict[str, float]
    history: tuple[IterationRecord, ...]
    verification: Verification | None = None
    remark: str = ""
    layout: Layout | None = None
    clearance_rows: bool = False
    dropped: bool = False
    coarser: Candidate | None = None
    row_times: Mapping[str, Array] = field(default_factory=dict)

    @classmethod
    def of(cls, name: str, initial: Trajectory, result: SlpResult) -> Candidate:
        """Candidate from the motion it began with and the outcome of a solver."""
        program = result.program
        feasible = result.best is not None
        iterate = result.iterate if result.best is None else result.best
        rows = program.rows
        violation = rows.violation(iterate.values)
        violations = {
            kind: float(np.max(violation[rows.kind == index], initial=0.0))
            for index, kind in enumerate(rows.kinds)
        }
        layout, clearance_rows, row_times = None, False, dict[str, Array]()
        if isinstance(program, NonlinearProgram):
            layout = Layout.of(program.transcription, iterate.z)
            clearance_rows = program.system.clearance is not None
            row_times = times_of_rows(program, iterate.z)
        return cls(
            name,
            result.status,
            feasible,
            program.trajectory(iterate.z),
            initial,
            violations,
            result.history,
            layout=layout,
            clearance_rows=clearance_rows,
            dropped=result.dropped,
            row_times=row_times,
        )

    @property
    def violation(self) -> float:
        """Largest violation."""
        return max(self.violations.values(), default=0.0)

    def after(self, former: Candidate) -> Candidate:
        """This candidate, with initial motion and history of its predecessor."""
        count = len(former.history)
        more = (replace(r, iteration=r.iteration + count) for r in self.history)
        history = (*former.history, *more)
        return replace(self, initial=former.initial, history=history)

    @property
    def found(self) -> bool:
        """Whether the motion keeps all constraints of its program, and its replay."""
        confirmed = self.verification is not None and self.verification.ok
        return self.feasible and confirmed

    @property
    def unconfirmed(self) -> bool:
        """Whether there was no time left for the replay."""
        return self.feasible and self.verification is None

    @property
    def refuted(self) -> bool:
        """Whether the replay of a motion that a program allows does not hold."""
        return self.feasible and not self.unconfirmed and not self.found

    @property
    def excess(self) -> float:
        """Largest excess over a limit in the replay, as a share of the limit."""
        judged = self.verification
        found = () if judged is None else judged.violations
        return max((item.share for item in found), default=0.0)

    @property
    def touches(self) -> bool:
        """Whether links come too close in the replay of a motion."""
        return self.verification is not None and any(
            item.kind == "clearance" for item in self.verification.violations
        )

    @property
    def duration(self) -> float:
        """T of the motion if its replay holds [s]; else infinite."""
        return self.trajectory.duration if self.found else np.inf

    def verified(self, problem: Problem, options: Options) -> Candidate:
        """Replay the torques of a motion that is said to keep all constraints."""
        if not self.feasible:
            return self
        verification = verify(
            problem, self.trajectory, options.tolerances, checker=problem.checker
        )
        return replace(self, verification=verification)


class Fallback(NamedTuple):
    """A motion of the plan that no replay has confirmed, for want of a better one.

    Attributes:
        candidate: The motion.
        kept: Its iterate.
        problem: The problem it solves, which has one goal.
    """

    candidate: Candidate
    kept: Kept
    problem: Problem


def best_of(candidates: Sequence[Candidate]) -> Candidate | None:
    """The fastest verified candidate, else the one nearest to one; None for none.

    Among equally good ones it is the last, whose status and remark are the newest.
    """

    def order(one: Candidate) -> tuple[float, bool, float]:
        return one.duration, not one.feasible, one.violation

    return min(reversed(candidates), key=order, default=None)
