"""Verification: independent checks of a motion, and reasons where there is none."""

from __future__ import annotations

from tominpmp.verification.certificate import ActiveLimit, Certificate
from tominpmp.verification.clearance import ClearanceProof, prove_clearance
from tominpmp.verification.excess import Excess
from tominpmp.verification.lower_bound import LowerBound, lower_bound
from tominpmp.verification.pontryagin import certify
from tominpmp.verification.reasons import explain
from tominpmp.verification.replay import Replay, replay
from tominpmp.verification.verdict import Verification, verify

__all__ = [
    "ActiveLimit",
    "Certificate",
    "ClearanceProof",
    "Excess",
    "LowerBound",
    "Replay",
    "Verification",
    "certify",
    "explain",
    "lower_bound",
    "prove_clearance",
    "replay",
    "verify",
]
