"""Choice of a solver of linear programs by its name."""

from __future__ import annotations

from tominpmp.exceptions import SolverNotFound
from tominpmp.linear_programs.highs import HighsSolver
from tominpmp.linear_programs.piqp import PiqpSolver
from tominpmp.linear_programs.solver import LpSolver
from tominpmp.linear_programs.through_qpsolvers import QpsolversSolver


def available_solvers() -> tuple[str, ...]:
    """Names of the solvers that are installed."""
    import qpsolvers

    return tuple(dict.fromkeys(["highs", "piqp", *qpsolvers.available_solvers]))


def make_solver(name: str) -> LpSolver:
    """Make a solver by its name.

    Args:
        name: "highs", "piqp" or a name that qpsolvers knows.

    Raises:
        SolverNotFound: If the solver is not installed.
    """
    if name == "highs":
        return HighsSolver()
    if name == "piqp":
        return PiqpSolver()
    if name not in available_solvers():
        raise SolverNotFound(name, available_solvers())
    return QpsolversSolver(name)
