"""Arcs: stretches of time between switches, optimised exactly."""
