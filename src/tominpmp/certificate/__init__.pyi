"""Where the names of the package are; read by type checkers and at import."""

from .certificate import (
    ActiveLimit as ActiveLimit,
    Certificate as Certificate,
)
from .minimum_principle import certify as certify
