"""Certificates of the minimum principle: costates and multipliers of a motion."""

from __future__ import annotations

from tominpmp.certificate.certificate import ActiveLimit, Certificate
from tominpmp.certificate.minimum_principle import certify

__all__ = ["ActiveLimit", "Certificate", "certify"]
