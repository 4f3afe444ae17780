"""What a solver of linear programs does."""

from __future__ import annotations

from abc import ABC, abstractmethod

from tominpmp.arrays import Array
from tominpmp.linear_programs.program import LinearProgram, LpSolution

# Bounds beyond this are none, for solvers that have no infinity.
HUGE = 1e30
# Programs of more columns take a simplex method thousands of pivots and seconds.
MANY_COLUMNS = 1000


class LpSolver(ABC):
    """A solver of a sequence of related linear programs.

    Attributes:
        curved: Whether it heeds the curvature of a program.
    """

    curved: bool = False

    @abstractmethod
    def solve(self, program: LinearProgram) -> LpSolution:
        """Solve a program, warm started from the last one where that is possible."""

    @abstractmethod
    def resolve(self, row_lower: Array, row_upper: Array) -> LpSolution:
        """Solve the last program again with other row bounds."""
