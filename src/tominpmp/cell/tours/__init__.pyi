"""Where the names of the package are; read by type checkers and at import."""

from .planning import plan_tour as plan_tour
from .station import (
    Station as Station,
    Visit as Visit,
)
from .tour import Tour as Tour
