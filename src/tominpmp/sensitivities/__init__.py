"""Sensitivities of the duration of a motion to the limits of its problem."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
