"""Solvers of nonlinear and linear programs."""
