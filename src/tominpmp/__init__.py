"""Time-optimal motions of robot manipulators, planned from their URDF.

import tominpmp as tm

robot = tm.load_robot("panda", locked_joints={"panda_finger_joint1": 0.04})
problem = tm.Problem(robot, q_start, tm.JointGoal(q_goal))
solution = tm.plan(problem)
print(solution.T, solution.trajectory(0.1).q)

``__init__.pyi`` lists the modules of the public names: a module is imported when one of
its names is first used, so that the command line handles signals, and shows its help,
before any slow import.
"""

from __future__ import annotations

TYPE_CHECKING = False  # typing takes long to import
if TYPE_CHECKING:
    from typing import Any

_attached: Any = None


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used."""
    global _attached
    if name == "__version__":
        from importlib.metadata import version

        return version("tominpmp")
    if _attached is None:
        import lazy_loader

        _attached = lazy_loader.attach_stub(__name__, __file__)
    load_attribute, _, names = _attached
    return names if name == "__all__" else load_attribute(name)


def __dir__() -> list[str]:
    """List the public names, imported or not."""
    return sorted({*globals(), *__getattr__("__all__"), "__version__"})
