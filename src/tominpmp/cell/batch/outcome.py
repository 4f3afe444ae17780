"""The outcome of one plan of a batch."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

from tominpmp.arrays import Record
from tominpmp.exceptions import BRIEF, brief, shortened
from tominpmp.solution import Solution


@dataclass(frozen=True, eq=False)
class Outcome(Record):
    """What became of one problem of a batch; true if there is a motion.

    Attributes:
        index: Its number in the batch, from 0.
        name: Its name: that of its file, or its number.
        seed: The seed that it was planned with.
        success: Whether there is a motion that keeps all constraints.
        status: Name of the status of the solution; "BROKEN" where the problem could not
            be made or sent, "LOST" where the process that planned it was killed.
        message: How it ended, or what is wrong with it.
        T: Duration of the motion [s]; infinite without one.
        gap: T over what no motion can beat, less one; None if that is not known.
        verified: Whether the independent replay of the motion passed.
        seconds: Time that planning took [s].
        began_with: Number of the problem whose motion it began with; None for none.
        solution: The solution; None where there is none. One that was read from a
            folder of results has neither history nor replay.
        path: File that holds it; None without a folder of results.
        resumed: Whether it was read from there.
    """

    index: int
    name: str
    seed: int
    success: bool
    status: str
    message: str
    T: float = math.inf
    gap: float | None = None
    verified: bool = False
    seconds: float = 0.0
    began_with: int | None = None
    solution: Solution | None = field(default=None, repr=False)
    path: Path | None = None
    resumed: bool = False

    def __bool__(self) -> bool:
        """Whether there is a motion."""
        return self.success

    def __repr__(self) -> str:
        """Name, status and time, on one line."""
        found = f"T = {self.T:.6g} s" if self.success else shortened(self.message)
        return f"<Outcome {brief(self.name, BRIEF)}: {self.status}, {found}>"

    @classmethod
    def failed(
        cls, index: int, name: str, seed: int, status: str, reason: str
    ) -> Outcome:
        """Of a problem that was not planned."""
        return cls(index, name, seed, False, status, reason)

    @classmethod
    def of(
        cls,
        solution: Solution,
        index: int,
        name: str,
        seed: int,
        began_with: int | None = None,
    ) -> Outcome:
        """Of a solution."""
        judged = solution.verification
        return cls(
            index=index,
            name=name,
            seed=seed,
            success=solution.success,
            status=solution.status.name,
            message=solution.message,
            T=solution.T,
            gap=solution.gap,
            verified=judged is not None and judged.ok,
            seconds=solution.planning_time,
            began_with=began_with,
            solution=solution,
        )
