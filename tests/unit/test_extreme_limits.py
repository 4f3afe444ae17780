"""Limits that are too wide or too narrow: a plan, or a message that says what to do."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

import tominpmp as tm
from tominpmp.solvers.trust_region_step import TrustRegionStep

# Other tests cover the search for the best motion.
plan_quickly = partial(tm.plan, effort="quick", refine=None)

START, END = [0.5, 1.7, -1.7], [2.0, -1.0, 0.5]


def reach(limits: tm.MotionLimits | None = None, **changes: object) -> tm.Problem:
    arm = tm.load_robot("planar3r", **changes)
    return tm.Problem(arm, START, tm.JointGoal(END), motion_limits=limits)


@pytest.mark.parametrize("wide", [1e9, 1e12])
def test_problem_without_effective_limits_is_refused_before_iterations(
    wide: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    def step(*_: object) -> None:
        pytest.fail("an iteration is made, and it would take many")

    monkeypatch.setattr(TrustRegionStep, "__call__", step)
    with pytest.raises(tm.ProblemError) as caught:
        plan_quickly(reach(effort=wide, velocity=wide))
    assert caught.value.field == "robot"
    message = str(caught.value)
    for part in ("joint '", "velocity", "effort", "load_robot", "MotionLimits"):
        assert part in message


def test_frame_goal_without_effective_limits_is_refused() -> None:
    arm = tm.load_robot("planar3r", effort=1e12, velocity=1e12)
    problem = tm.Problem(arm, START, tm.PositionGoal("tip", (3.0, 1.0, 0.0)))
    with pytest.raises(tm.ProblemError, match="hardly limit it"):
        plan_quickly(problem)


@pytest.mark.parametrize(
    "limits",
    [
        tm.MotionLimits(acceleration=10.0),
        tm.MotionLimits(acceleration=10.0, jerk=1000.0),
        tm.MotionLimits(acceleration=1e-2),
    ],
)
def test_acceleration_limits_alone_suffice(limits: tm.MotionLimits) -> None:
    problem = reach(limits, effort=1e12, velocity=1e12)
    solution = plan_quickly(problem)
    assert solution.success, solution.message
    way = np.max(np.abs(np.subtract(END, START)))
    push = float(np.max(limits.by_joint("acceleration", problem.robot.joint_names)))
    least = 2.0 * np.sqrt(way / push)
    assert least <= solution.T * (1 + 1e-6)
    assert solution.T < (1.01 if limits.jerk is None else 1.1) * least


def test_one_joint_without_effective_limits_is_planned() -> None:
    usual = plan_quickly(reach())
    limits = reach().robot.limits
    effort, velocity = limits.effort_upper.copy(), limits.velocity.copy()
    effort[2], velocity[2] = 1e12, 1e12
    freer = plan_quickly(reach(effort=effort, velocity=velocity))
    assert freer.success
    assert freer.T <= usual.T * 1.01


def test_message_names_the_joint_whose_speed_limit_is_too_low() -> None:
    few = {"intervals": 8, "max_iterations": 3}
    solution = plan_quickly(reach(velocity=[1.0, 1e-9, 1.0]), **few)
    assert not solution.success
    assert "can be replayed" in solution.message
    assert "joint joint2" in solution.message and "1e-09 rad/s" in solution.message


def test_message_shows_short_motion_times_with_three_digits() -> None:
    solution = plan_quickly(reach(effort=1e7, velocity=1e3))
    assert solution.success and solution.T < 0.01
    assert f"T = {solution.T:.3g} s" in solution.message


@pytest.mark.parametrize("limit", ["velocity", "position_upper"])
def test_limits_of_the_largest_number_cause_no_overflow(limit: str) -> None:
    """Regression: NumPy warned of an overflow in the room between the limits."""
    most = float(np.finfo(float).max)
    changes = {"position_lower": -most} if limit == "position_upper" else {}
    arm = tm.load_robot("planar3r", **{limit: most}, **changes)
    problem = tm.Problem(arm, START, tm.JointGoal(END))
    assert getattr(problem.robot.limits, limit)[0] == most
