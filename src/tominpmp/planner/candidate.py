"""Candidates: the motions of initial guesses, their replays, and kept iterates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from tominpmp.motion.trajectory import Trajectory
from tominpmp.options import Options
from tominpmp.problem.problem import Problem
from tominpmp.solvers.iterate import Iterate, SlpResult
from tominpmp.solvers.objective import SLOWDOWN
from tominpmp.status import Status
from tominpmp.transcription.base import ProgramInterface
from tominpmp.transcription.grid import at_ticks
from tominpmp.transcription.layout import Gridded, Layout
from tominpmp.transcription.problem_functions import PADDING
from tominpmp.transcription.program import NonlinearProgram
from tominpmp.verification.verification import Verification, verify

if TYPE_CHECKING:
    from tominpmp.certificate.minimum_principle import Examination


class KeptIterate(NamedTuple):
    """An intermediate motion, kept in case planning ends without a better one.

    Attributes:
        program: The nonlinear program.
        iterate: The motion as an iterate of the program.
        feasible: Whether the iterate keeps all constraints of the program.
        initial: The initial iterate of its candidate; None if it is this one.
    """

    program: ProgramInterface
    iterate: Iterate
    feasible: bool
    initial: KeptIterate | None = None

    @property
    def rank(self) -> tuple[bool, float]:
        """Order of motions to be slowed down: with clearance first, then the fastest.

        The duration is an estimate once violations are removed, which is exact for
        torques, as these go with the square of the speed.
        """
        every = self.program.rows.violation_by_kind(self.iterate.values).items()
        missing = (x for kind, x in every if kind.startswith("clearance"))
        touches = max(missing, default=0.0) * self.program.system.reach > PADDING
        factor = 1.0 + SLOWDOWN * self.iterate.violation
        return touches, self.iterate.duration * factor

    def candidate(self, status: Status) -> Candidate:
        """The motion as a candidate, not replayed yet."""
        best = self.iterate if self.feasible else None
        result = SlpResult(status, self.iterate, best, (), self.program)
        first = self.initial or self
        return Candidate.of(first.program.trajectory(first.iterate.z), result)


@dataclass(frozen=True, eq=False)
class Candidate:
    """The motion that one initial guess led to.

    Attributes:
        status: How the iteration ended.
        feasible: Whether the motion keeps all constraints of its program.
        trajectory: The best motion.
        initial: The initial motion.
        violations: Largest violation by kind of constraint.
        verification: Replay of the torques; None without a replay.
        remark: A sentence for the user; may be empty.
        layout: Parameterisation of the motion; None for shooting methods, whose only
            unknowns are torques, and for motions from elsewhere.
        clearance_rows: Whether its program had clearance rows.
        dropped: Whether a stop rule has given the candidate up.
        coarser: The candidate on a coarser grid that was refined; None without one.
        examination: Its certificate, with the multipliers behind it; None before the
            motion was examined.
    """

    status: Status
    feasible: bool
    trajectory: Trajectory
    initial: Trajectory
    violations: dict[str, float]
    verification: Verification | None = None
    remark: str = ""
    layout: Layout | None = None
    clearance_rows: bool = False
    dropped: bool = False
    coarser: Candidate | None = None
    examination: Examination | None = None

    @classmethod
    def of(cls, initial: Trajectory, result: SlpResult[Any]) -> Candidate:
        """Candidate from its initial motion and the result of the solver."""
        program = result.program
        feasible = result.best is not None
        iterate = result.best or result.iterate
        violations = program.rows.violation_by_kind(iterate.values)
        layout, clearance_rows = None, False
        if isinstance(program, NonlinearProgram):
            of = program.transcription
            layout = Layout.of(of, iterate.z) if isinstance(of, Gridded) else None
            clearance_rows = program.system.clearance is not None
        return cls(
            result.status,
            feasible,
            program.trajectory(iterate.z),
            initial,
            violations,
            layout=layout,
            clearance_rows=clearance_rows,
            dropped=result.dropped,
        )

    @property
    def violation(self) -> float:
        """Largest constraint violation."""
        return max(self.violations.values(), default=0.0)

    def after(self, former: Candidate) -> Candidate:
        """This candidate, with the initial motion of its predecessor."""
        return replace(self, initial=former.initial)

    @property
    def confirmed(self) -> bool:
        """Whether the program and the replay of the motion keep all limits."""
        return self.feasible and bool(self.verification)

    def is_on_clock(self, period: float | None) -> bool:
        """Whether the knots are ticks of a clock; False without a clock."""
        t = self.trajectory.t
        return period is not None and np.array_equal(at_ticks(t, period), t)

    @property
    def refuted(self) -> bool:
        """Whether the replay breaks limits that the program keeps."""
        replay = self.verification
        return self.feasible and replay is not None and not replay.ok

    @property
    def excess(self) -> float:
        """Largest excess over a limit in the replay, as a share of the limit."""
        replay = self.verification
        violations = () if replay is None else replay.violations
        return max((violation.share for violation in violations), default=0.0)

    @property
    def touches(self) -> bool:
        """Whether the replay breaks a clearance."""
        return self.verification is not None and any(
            item.kind == "clearance" for item in self.verification.violations
        )

    @property
    def duration(self) -> float:
        """T of the motion [s]; infinite unless its replay keeps all limits."""
        return self.trajectory.duration if self.confirmed else np.inf

    def verified(self, problem: Problem, options: Options) -> Candidate:
        """Replay the torques, if the motion is feasible by its program."""
        if not self.feasible:
            return self
        verification = verify(problem, self.trajectory, options.tolerances)
        return replace(self, verification=verification)


def best_of(candidates: Sequence[Candidate]) -> Candidate | None:
    """The fastest confirmed candidate, else the one with the smallest violation.

    Among equally good candidates it is the last one, whose status and remark are the
    newest. None without candidates.
    """

    def order(item: Candidate) -> tuple[float, bool, float]:
        return item.duration, not item.feasible, item.violation

    return min(reversed(candidates), key=order, default=None)
