"""What holds a motion back: how its duration changes with each limit of its problem."""

from __future__ import annotations

from tominpmp.sensitivities.analysis import analyse
from tominpmp.sensitivities.records import Sensitivities, Sensitivity

__all__ = ["Sensitivities", "Sensitivity", "analyse"]
