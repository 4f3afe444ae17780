"""Limits of torque rates hold between the rows of a program.

Regression: rates were checked near the nodes only. For a Panda with slow torques, the
rate was 0.8 % beyond its limit in the middle of an interval, and no feasible motion
remained after all refinements.
"""

from __future__ import annotations

import numpy as np
import pytest

import tominpmp as tm
from tominpmp.dynamics import RobotDynamics

START = np.array([0.0, -0.8, 0.0, -2.3, 0.0, 1.6, 0.8])
DISPLACEMENT = np.array([-0.408, 0.281, -0.464, -0.131, 0.02, -0.083, 0.104])
FINGERS = {"panda_finger_joint1": 0.02, "panda_finger_joint2": 0.02}


@pytest.fixture(scope="module", params=[5.0, 20.0])
def planned(request: pytest.FixtureRequest) -> tuple[tm.Solution, np.ndarray]:
    """A motion with torque rates as its only active limit [1/s], in shares of the
    torques.
    """
    robot = tm.load_robot("panda", limits="urdf", locked_joints=FINGERS)
    largest = request.param * robot.limits.effort_upper
    problem = tm.Problem(
        robot,
        START,
        tm.JointGoal(START + DISPLACEMENT),
        motion_limits=tm.MotionLimits(effort_rate=largest),
    )
    return tm.plan(problem, effort="quick"), largest


def test_plan_with_torque_rate_limits_succeeds(
    planned: tuple[tm.Solution, np.ndarray],
) -> None:
    solution, _ = planned
    assert solution.success, solution.message


def test_torque_rates_keep_their_limits_between_rows(
    planned: tuple[tm.Solution, np.ndarray],
) -> None:
    solution, largest = planned
    motion = solution.trajectory
    assert motion is not None
    h = np.diff(motion.t)[:, None]
    times = motion.t[:-1, None] + h * np.linspace(1e-9, 1.0 - 1e-9, 21)
    state = motion(times.ravel())
    u = RobotDynamics(solution.problem.robot).inverse(state.q, state.v, state.a)
    u = u.reshape(*times.shape, -1)
    rates = np.diff(u, axis=1) / np.diff(times, axis=1)[..., None]
    share = np.abs(rates) / largest
    assert share.max() <= 1.005
    assert share.max() >= 0.99  # the limit is active
