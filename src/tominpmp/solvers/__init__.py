"""Solvers of nonlinear programs: one iteration with exchangeable parts, in loop.py."""
