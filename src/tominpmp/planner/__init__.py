"""Planning: from a problem to a verified motion; the entry point is planning.py."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
