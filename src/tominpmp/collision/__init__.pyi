"""Where the names of the package are; read by type checkers and at import."""

from .checker import (
    CollisionChecker as CollisionChecker,
    Contact as Contact,
    enclosure as enclosure,
)
from .query import Derivatives as Derivatives
from .bodies import obstacle_shape as obstacle_shape
