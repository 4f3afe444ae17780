"""Problems of the planar arm for the tests of transcriptions."""

from __future__ import annotations

from typing import Any

import numpy as np

import tominpmp as tm

START = np.array([0.5, 1.7, -1.7])
OBSTACLE = tm.Scene([tm.Sphere("O", radius=0.8, position=(4, 0, 0))])


def planar(goal: tm.Goal, **changes: Any) -> tm.Problem:
    """A problem from START; changes that no Problem knows are options of the robot."""
    names = ("scene", "margin", "v_start", "motion_limits")
    options = {name: changes.pop(name) for name in names if name in changes}
    return tm.Problem(tm.load_robot("planar3r", **changes), START, goal, **options)
