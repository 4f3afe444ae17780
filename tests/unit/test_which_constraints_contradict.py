"""Two constraints with the same name that no configuration satisfies: the message says
which, and where.
"""

from __future__ import annotations

import numpy as np
import pytest

import tominpmp as tm
from tests.sample_arms import make_arm, rod
from tominpmp.exceptions import ProblemError

UP, ACROSS = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)


def arm(**more) -> tm.Robot:
    links = [rod(1.0, 1.0)] * 3
    return make_arm(*links, effort=np.full(3, 90.0), **more)


def test_message_about_contradictory_constraints_has_numbers_and_values():
    items = (
        tm.ToolSpeed("tip", 1.0),
        tm.KeepUpright("tip", UP, UP, 0.05),
        tm.KeepUpright("tip", UP, ACROSS, 0.07),
    )
    words = (
        r"start: the tilt of frame tip is 1\.571 rad, 1\.5 rad more than its limit "
        r"0\.07 rad: no configuration was found that keeps it together with the tilt "
        r"of frame tip \(at most 0\.05 rad; number 2 of the constraints\); they "
        r"contradict each other, and come nearest at \[.*\], where they are "
        r"\d\.\d+ rad and \d\.\d+ rad"
    )
    with pytest.raises(ProblemError, match=words):
        tm.Problem(
            arm(), [0.8, -1.6, 0.8], tm.JointGoal([0.5, -1.0, 0.5]), constraints=items
        )


def test_constraints_of_equal_time_windows_contradict_each_other() -> None:
    items = [
        tm.KeepUpright("tip", UP, direction, 0.05, during=(0.0, 1.0))
        for direction in (UP, ACROSS)
    ]
    with pytest.raises(ProblemError, match="number 1 of the constraints"):
        tm.Problem(
            arm(), [0.8, -1.6, 0.8], tm.JointGoal([0.5, -1.0, 0.5]), constraints=items
        )


def test_message_about_a_load_that_slips_at_the_start_has_the_reason():
    """The tray is upright if the arm is stretched out, in the plane of gravity."""
    glass = tm.StableContact("tip", (0.0, 0.0, 0.1), 0.3)
    level = arm(gravity=(0.0, 0.0, -9.81))
    on_edge = arm(gravity=(0.0, -9.81, 0.0))
    goal = tm.PositionGoal("tip", (2.0, 1.0, 0.0))
    tm.Problem(level, [0.1, 0.2, 0.3], goal, constraints=(glass,))
    with pytest.raises(ProblemError, match=r"leans by 90 deg, and friction 0\.3 holds"):
        tm.Problem(on_edge, [0.1, 0.2, 0.3], goal, constraints=(glass,))
