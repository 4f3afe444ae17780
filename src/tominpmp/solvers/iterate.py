"""State of the iteration, and what a step of it brought."""

from __future__ import annotations

from dataclasses import dataclass, replace

from tominpmp.arrays import Array
from tominpmp.linear_programs.program import LpSolution
from tominpmp.solvers.merit import Merit
from tominpmp.solvers.trust_region import TrustRegion
from tominpmp.status import IterationRecord, Status
from tominpmp.transcription.base import Program


@dataclass(frozen=True, eq=False)
class Iterate:
    """State of the iteration.

    Attributes:
        z: Unknowns.
        values: Row values there.
        merit: Weights of the merit.
        region: Trust region.
        multipliers: Of all rows, from the last linear program.
        raises: How often weights were raised for want of feasibility.
        gains: Merit gained in the last iterations [s], the newest last.
    """

    z: Array
    values: Array
    merit: Merit
    region: TrustRegion
    multipliers: Array
    raises: int = 0
    gains: tuple[float, ...] = ()

    @property
    def duration(self) -> float:
        """T [s]."""
        return float(self.merit.cost @ self.z)

    @property
    def violation(self) -> float:
        """Largest violation of all rows."""
        return self.merit.rows.largest_violation(self.values)

    def better_than(self, best: Iterate | None, feasibility: float) -> Iterate | None:
        """This iterate if it is feasible and faster than the best one, else that."""
        if self.violation > feasibility:
            return best
        return self if best is None or self.duration < best.duration else best

    def on(self, program: Program, z: Array) -> Iterate:
        """The state for nearly the same program, with other rows and unknowns."""
        former = self.merit.rows
        return replace(
            self,
            z=z,
            values=program.evaluate(z),
            merit=replace(self.merit, rows=program.rows),
            multipliers=program.rows.carried(former, self.multipliers),
        )


@dataclass(frozen=True, eq=False)
class SlpResult:
    """Outcome of the iteration.

    Attributes:
        status: How it ended.
        iterate: The last iterate.
        best: The fastest iterate without violation, if there was one.
        history: One record an iteration.
        remark: A sentence for the user, if there is something to say.
        program: The program as it was in the end, where rows have joined it on the way;
            None if it is the one that was given.
    """

    status: Status
    iterate: Iterate
    best: Iterate | None
    history: tuple[IterationRecord, ...]
    remark: str = ""
    program: Program | None = None


@dataclass
class Effort:
    """Counts the work of one iteration."""

    programs: int = 0
    pivots: int = 0
    seconds: float = 0.0

    def add(self, solution: LpSolution) -> LpSolution:
        """Count a linear program and hand it on."""
        self.programs += 1
        self.pivots += solution.iterations
        self.seconds += solution.seconds
        return solution


@dataclass(frozen=True, eq=False)
class Trial:
    """A point tried, with its merit."""

    z: Array
    values: Array
    merit: float
    damping: float = 1.0


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a step brought."""

    trial: Trial
    predicted: float
    actual: float
    ratio: float
    accepted: bool
