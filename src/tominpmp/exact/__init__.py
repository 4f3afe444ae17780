"""Exact switching times: motions as arcs between switches, of optimised lengths."""
