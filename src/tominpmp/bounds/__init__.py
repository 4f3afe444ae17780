"""Bounds that no motion can beat: how short its duration can be at the least."""

from __future__ import annotations

from tominpmp.bounds.lower_bound import LowerBound, lower_bound

__all__ = ["LowerBound", "lower_bound"]
