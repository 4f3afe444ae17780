"""Bounds that no motion can beat: how short its duration can be at the least."""
