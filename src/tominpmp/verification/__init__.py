"""Verification: independent checks of a motion, and reasons for a missing motion."""
