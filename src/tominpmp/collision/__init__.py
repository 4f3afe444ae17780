"""Distances between a robot, its surroundings and itself.

Distances are signed: in penetration they are negative, with the depth as magnitude.
Links are represented by convex pieces, which makes a query about a hundred times faster
than with the triangles of their meshes. The broad phase excludes pairs that are
certainly far apart by bounds; the narrow phase queries the other pairs.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
