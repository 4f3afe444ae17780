"""Motions over time: curves through nodes, samples of them, turns and measures."""
