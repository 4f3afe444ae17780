"""Linear programs: one record, a few solvers. The only package that knows them.

Some of them take a convex curvature of the objective, too.
"""

from tominpmp.linear_programs.choice import available_solvers, make_solver
from tominpmp.linear_programs.highs import HighsSolver
from tominpmp.linear_programs.piqp import USUALLY, Nearly, PiqpSolver
from tominpmp.linear_programs.solver import LpSolver

__all__ = [
    "USUALLY",
    "HighsSolver",
    "LpSolver",
    "Nearly",
    "PiqpSolver",
    "available_solvers",
    "make_solver",
]
