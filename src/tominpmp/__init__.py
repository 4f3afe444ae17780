"""Time-optimal motions of robot manipulators, planned from their URDF.

import tominpmp as tm

robot = tm.load_robot("panda", locked_joints={"panda_finger_joint1": 0.04})
problem = tm.Problem(robot, q_start, tm.JointGoal(q_goal))
solution = tm.plan(problem)
print(solution.T, solution.trajectory(0.1).q)

``__init__.pyi`` says where the public names are: a module is imported when one of its
names is first used, so that the command line shows its help without loading the
robotics libraries.
"""

from __future__ import annotations

import logging
from typing import Any

import lazy_loader

_of_a_module, _public_names, __all__ = lazy_loader.attach_stub(__name__, __file__)

# A library leaves it to the application whether its log is shown.
logging.getLogger(__name__).addHandler(logging.NullHandler())


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used."""
    if name == "__version__":
        from importlib.metadata import version

        return version("tominpmp")
    return _of_a_module(name)


def __dir__() -> list[str]:
    """List the public names, imported or not."""
    return sorted({*globals(), *__all__, "__version__"})
