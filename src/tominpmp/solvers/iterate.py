"""Where an iteration stands, and what a step of it brought."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tominpmp.arrays import Array
from tominpmp.solvers.merit import Merit
from tominpmp.solvers.trust_region import TrustRegion
from tominpmp.status import IterationRecord, Status
from tominpmp.transcription.base import Program


@dataclass(frozen=True, eq=False)
class Iterate:
    """Where an iteration stands.

    Attributes:
        z: Unknowns.
        values: Row values there.
        cost: Gradient of the duration, which is cost @ z.
        merit: Weights of the violations.
        region: Trust region.
        multipliers: Of all rows, from the last program.
        raises: How often weights were raised for want of feasibility.
        gains: Merit gained in the last iterations [s], the newest last.
    """

    z: Array
    values: Array
    cost: Array
    merit: Merit
    region: TrustRegion
    multipliers: Array
    raises: int = 0
    gains: tuple[float, ...] = ()

    @classmethod
    def of(cls, program: Program, z: Array, weights: Array | float) -> Iterate:
        """An iterate of a program of which no multiplier is known.

        Args:
            program: The program.
            z: Unknowns.
            weights: Weights of the violations, by kinds of rows or of all [s].
        """
        rows = program.rows
        merit = Merit(rows, np.broadcast_to(weights, len(rows.kinds)))
        none = np.zeros(rows.size)
        return cls(z, program.evaluate(z), program.cost, merit, TrustRegion(), none)

    @property
    def duration(self) -> float:
        """T [s]."""
        return float(self.cost @ self.z)

    @property
    def violation(self) -> float:
        """Largest violation of all rows."""
        return self.merit.rows.largest_violation(self.values)

    def on(self, program: Program, z: Array) -> Iterate:
        """The iterate of nearly the same program, with other rows and unknowns."""
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
    """Outcome of an iteration.

    Attributes:
        status: How it ended.
        iterate: The last iterate.
        best: The iterate of the least objective without violation, if there was one.
        history: One record an iteration.
        program: The program as it was in the end, with the rows that have joined it.
    """

    status: Status
    iterate: Iterate
    best: Iterate | None
    history: tuple[IterationRecord, ...]
    program: Program


@dataclass(frozen=True, eq=False)
class Trial:
    """A point tried, with its merit."""

    z: Array
    values: Array
    merit: float
    damping: float = 1.0


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a step brought.

    Attributes:
        trial: The best point that was tried.
        predicted: Reduction of the merit that the program predicted [s].
        actual: Reduction that was had [s].
        ratio: Of the two, for the whole step.
        accepted: Whether the step was taken.
        settled: Whether no more progress is predicted, or was had lately.
    """

    trial: Trial
    predicted: float
    actual: float
    ratio: float
    accepted: bool
    settled: bool = False
