"""Certificates of optimality: costates and multipliers of the minimum principle."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
