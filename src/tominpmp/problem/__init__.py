"""Planning problems: robot, start, goals and obstacles, of one arm or a workcell."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
