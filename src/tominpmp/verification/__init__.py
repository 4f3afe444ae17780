"""Verification: independent checks of a motion, and reasons for a missing motion."""

from __future__ import annotations

from tominpmp.verification.clearance import ClearanceProof, prove_clearance
from tominpmp.verification.diagnosis import explain
from tominpmp.verification.limit_violations import LimitViolation
from tominpmp.verification.nearest import Touch
from tominpmp.verification.replay import Replay, replay
from tominpmp.verification.verification import Verification, verify

__all__ = [
    "ClearanceProof",
    "LimitViolation",
    "Replay",
    "Touch",
    "Verification",
    "explain",
    "prove_clearance",
    "replay",
    "verify",
]
