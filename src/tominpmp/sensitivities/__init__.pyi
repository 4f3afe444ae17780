"""Where the names of the package are; read by type checkers and at import."""

from .analysis import analyse as analyse
from .records import (
    Sensitivities as Sensitivities,
    Sensitivity as Sensitivity,
)
