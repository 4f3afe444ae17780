"""Distances between a robot, its surroundings and itself.

Distances are signed: negative in penetration, where the value is the depth. Links are
taken as convex pieces, which makes a query about a hundred times faster than with the
triangles of their meshes. Pairs that are surely far apart are found by bounds, without
a query.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
