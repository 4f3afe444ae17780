"""Where the names of the package are; read by type checkers and at import."""

from .problem import Problem as Problem
