"""Where the names of the package are; read by type checkers and at import."""

from .result import LowerBound as LowerBound
