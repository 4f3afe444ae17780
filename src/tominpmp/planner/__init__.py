"""Planning: the story from a problem to a motion, which begins in planning.py."""

from __future__ import annotations

from tominpmp.planner.planning import plan

__all__ = ["plan"]
