"""Motions over time: curves through nodes, samples, reversals and measures."""
