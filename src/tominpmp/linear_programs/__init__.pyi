"""Where the names of the package are; read by type checkers and at import."""

from .choice import (
    available_solvers as available_solvers,
    make_solver as make_solver,
)
from .highs import HighsSolver as HighsSolver
from .piqp import (
    USUAL_TERMINATION as USUAL_TERMINATION,
    PiqpSolver as PiqpSolver,
    Termination as Termination,
)
from .solver import LpSolver as LpSolver
