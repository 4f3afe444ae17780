"""Linear programs: one record, a few solvers. The only package that knows them.

Some of them take a convex curvature of the objective, too.
"""
