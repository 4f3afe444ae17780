"""Refinement: finer grids where a motion needs them, and exact switches."""

from __future__ import annotations

from tominpmp.refinement.exact import refine_switching

__all__ = ["refine_switching"]
