"""Problems for the tests of motions on the clock of a controller."""

from __future__ import annotations

from typing import Any

import tominpmp as tm

LIMITS = tm.MotionLimits(acceleration=14.0, jerk=900.0, effort_rate=3000.0)
UR5_END = (-0.5, -1.6, 0.7, 0.4, 0.1, 1.0)


def ur5_problem(robot: tm.Robot, **changes: Any) -> tm.Problem:
    """A UR5 from one configuration to another."""
    start = (0.4, -1.1, 1.3, -0.7, 0.6, 0.2)
    return tm.Problem(robot, start, tm.JointGoal(UR5_END), **changes)


def planar_problem(robot: tm.Robot, **changes: Any) -> tm.Problem:
    """The planar arm from one configuration to another, or to another goal."""
    goal = changes.pop("goal", tm.JointGoal((0.9, -1.2, -0.9)))
    return tm.Problem(robot, (0.5, 1.7, -1.7), goal, **changes)
