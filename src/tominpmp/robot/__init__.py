"""Robots: what a description file, or the caller, says about an arm."""
