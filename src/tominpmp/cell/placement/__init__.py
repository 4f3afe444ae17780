"""Where things stand in a cell: moved so that its tasks take less time."""

from __future__ import annotations

from tominpmp.cell.placement.improve import ImprovedPlacement, improve_placement
from tominpmp.cell.placement.moves import robot_at

__all__ = ["ImprovedPlacement", "improve_placement", "robot_at"]
