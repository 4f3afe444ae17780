"""Linear programs and their solvers; no other package imports such a solver.

Some of the solvers also accept a convex quadratic term of the objective.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
