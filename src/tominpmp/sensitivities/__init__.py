"""Sensitivities of the duration of a motion to the limits of its problem."""

from __future__ import annotations

from tominpmp.sensitivities.analysis import analyse
from tominpmp.sensitivities.records import Sensitivities, Sensitivity

__all__ = ["Sensitivities", "Sensitivity", "analyse"]
