"""Where the names of the package are; read by type checkers and at import."""

from .choice import (
    available_solvers as available_solvers,
    make_solver as make_solver,
)
from .highs import HighsSolver as HighsSolver
from .piqp import (
    USUALLY as USUALLY,
    Nearly as Nearly,
    PiqpSolver as PiqpSolver,
)
from .solver import LpSolver as LpSolver
