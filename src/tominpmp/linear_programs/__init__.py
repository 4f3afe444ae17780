"""Linear programs: one record, a few solvers. The only package that knows them.

Some of them take a convex curvature of the objective, too.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
