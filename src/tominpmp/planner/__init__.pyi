"""Where the names of the package are; read by type checkers and at import."""

from .planning import plan as plan
