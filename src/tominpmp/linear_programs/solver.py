"""Interface of the solvers of linear programs."""

from __future__ import annotations

from abc import ABC, abstractmethod

from tominpmp.linear_programs.program import LinearProgram, LpSolution

# Value that stands for infinite bounds in solvers without an infinity.
NO_BOUND = 1e30


class LpSolver(ABC):
    """A solver of a sequence of related linear programs.

    Attributes:
        curved: Whether the solver takes the curvature of a program into account.
    """

    curved: bool = False

    @abstractmethod
    def solve(self, program: LinearProgram) -> LpSolution:
        """Solve a program, warm started from the last one if the method allows it."""

    def resolve(self, program: LinearProgram) -> LpSolution:
        """Solve the last program again, of which only the row bounds have changed."""
        return self.solve(program)
