"""Bounds that no motion can beat: how short its duration can be at the least."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
