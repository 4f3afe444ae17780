"""Where the names of the package are; read by type checkers and at import."""

from .clearance import (
    ClearanceProof as ClearanceProof,
    prove_clearance as prove_clearance,
)
from .diagnosis import explain as explain
from .limit_violations import LimitViolation as LimitViolation
from .nearest import Touch as Touch
from .replay import Replay as Replay
from .verification import (
    Verification as Verification,
    verify as verify,
)
