"""Goals: conditions on the final state of a motion (paper, equations 5 and 8).

A goal is data; its residual a(x(T)) and the derivatives are evaluated by kinematics.
The residual has to end within bounds, which are zero unless the goal has a tolerance. A
motion ends at rest unless a final velocity is given.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
