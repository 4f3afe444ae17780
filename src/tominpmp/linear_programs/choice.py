"""Choice of a solver of linear programs by its name."""

from __future__ import annotations

from tominpmp.exceptions import SolverNotFound
from tominpmp.linear_programs.highs import HighsSolver
from tominpmp.linear_programs.piqp import PiqpSolver
from tominpmp.linear_programs.solver import LpSolver
from tominpmp.linear_programs.through_qpsolvers import QpsolversSolver

# Solvers with a module of their own, by name; all others are those of qpsolvers.
SOLVERS: dict[str, type[LpSolver]] = {"highs": HighsSolver, "piqp": PiqpSolver}


def available_solvers() -> tuple[str, ...]:
    """Names of the solvers that are installed."""
    import qpsolvers

    return tuple(dict.fromkeys([*SOLVERS, *qpsolvers.available_solvers]))


def make_solver(name: str) -> LpSolver:
    """Make a solver by its name.

    Args:
        name: A name in SOLVERS, or one that qpsolvers knows.

    Raises:
        SolverNotFound: If the solver is not installed.
    """
    if name in SOLVERS:
        return SOLVERS[name]()
    if name not in available_solvers():
        raise SolverNotFound(name, available_solvers())
    return QpsolversSolver(name)
