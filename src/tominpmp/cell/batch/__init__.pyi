"""Where the names of the package are; read by type checkers and at import."""

from .dataset import (
    Dataset as Dataset,
    Outcome as Outcome,
)
from .plan_many import (
    Progress as Progress,
    plan_many as plan_many,
)
