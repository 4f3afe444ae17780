"""Certificates of the minimum principle: costates and multipliers of a motion."""
