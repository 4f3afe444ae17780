"""Dry friction together with limits of acceleration, jerk, torque rate and a clock."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from sample_arms import DOWNWARD, make_arm, rod

import tominpmp as tm
from tominpmp.files.export import load_motion
from tominpmp.files.export_check import check_export
from tominpmp.motion.joining import join
from tominpmp.verification.limit_violations import limit_violations
from tominpmp.verification.replay import torque_pieces

START = (3.05, 0.35, 2.4, 1.2, -2.7, 1.4, 0.6)
GOAL = (-0.1, 1.85, 3.0, 0.24, 0.02, 1.9, -2.9)
PERIOD = 0.004


def xarm_problem(friction: float | None = None) -> tm.Problem:
    """A swing of an xArm 7 with the limits of its data sheet."""
    robot = tm.load_robot("xarm7", limits="datasheet", friction=friction)
    return tm.Problem(robot, START, tm.JointGoal(GOAL))


def two_links(**limits: float) -> tm.Problem:
    """A swing of two hanging links, one of which reverses its direction."""
    robot = make_arm(
        rod(2.0, 0.5),
        rod(1.0, 0.4),
        effort=[40.0, 15.0],
        gravity=DOWNWARD,
        friction=[2.0, 1.5],
    )
    return tm.Problem(
        robot,
        [-1.6, 0.0],
        tm.JointGoal([-0.6, 0.3]),
        motion_limits=tm.MotionLimits(**limits),
    )


@cache
def on_a_clock() -> tm.Solution:
    """The swing of the xArm, planned with a control period."""
    return tm.plan(xarm_problem(), control_period=PERIOD)


def test_arm_with_friction_keeps_its_acceleration_limits() -> None:
    problem = xarm_problem()
    assert np.all(problem.robot.friction == 1.0)
    solution = tm.plan(problem)
    assert solution.success, solution.message
    assert solution.verification is not None
    # The limit holds at the stop, too, where rounding has either sign.
    assert solution.verification.worst["acceleration"].share < 1e-3
    without = tm.plan(xarm_problem(friction=0.0))
    assert solution.T == pytest.approx(without.T, rel=1e-2)
    assert len(solution.history) <= 2 * len(without.history)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_acceleration_at_the_stop_does_not_depend_on_rounding(sign: float) -> None:
    # Whatever the sign of the final velocity, friction acts against the motion before.
    solution = on_a_clock()
    motion, found = solution.trajectory, solution.verification
    assert motion is not None and found is not None
    v = np.array(found.replay.v)
    v[-1] = sign * 1e-8
    robot = solution.problem.robot
    limits = limit_violations(
        solution.problem,
        replace(found.replay, v=v),
        torque_pieces(robot, motion),
        1e-3,
        np.zeros((2, robot.n)),
    )
    assert [item for item in limits if item.violated] == []
    assert "acceleration" in {item.kind for item in limits}


def test_replay_rejects_accelerations_beyond_limits_with_friction() -> None:
    robot = tm.load_robot("xarm7", limits="urdf")
    free = tm.plan(tm.Problem(robot, START, tm.JointGoal(GOAL)))
    assert free.success and free.trajectory is not None
    found = tm.verify(xarm_problem(), free.trajectory)
    assert not found.ok
    assert "acceleration" in {item.kind for item in found.violations}


@pytest.mark.parametrize("kind", ["yaml", "csv", "npz"])
@pytest.mark.parametrize("dt", [PERIOD, 0.001])
def test_exported_motion_with_friction_passes(
    tmp_path: Path, kind: str, dt: float
) -> None:
    solution = on_a_clock()
    assert solution.success, solution.message
    path = solution.export(tmp_path / f"motion.{kind}", dt=dt, verify=False)
    check = check_export(solution, path, dt=dt)
    assert check.ok, check.message


@pytest.mark.parametrize("dt", [PERIOD, 0.001])
def test_sampled_acceleration_ramps_are_not_joined_as_steps(
    tmp_path: Path, dt: float
) -> None:
    solution = on_a_clock()
    motion = solution.trajectory
    assert motion is not None
    solution.export(tmp_path / "motion.csv", dt=dt, verify=False)
    joined = join(load_motion(tmp_path / "motion.csv"), solution.problem.robot)
    assert joined.manner not in ("steps", "held")
    found = tm.verify(solution.problem, joined.trajectory)
    assert found.ok, found.message
    times = np.linspace(0.0, motion.duration, 997)
    ours, theirs = motion(times), joined.trajectory(times)
    np.testing.assert_allclose(theirs.q, ours.q, atol=1e-11)
    np.testing.assert_allclose(theirs.a, ours.a, atol=1e-3)


@pytest.mark.parametrize(
    ("limits", "period"),
    [
        ({"acceleration": 15.0}, None),
        ({"acceleration": 15.0, "jerk": 400.0}, 0.008),
        ({"jerk": 300.0}, None),
        ({"acceleration": 15.0, "effort_rate": 400.0}, None),
    ],
)
def test_plan_with_friction_succeeds_with_limits_of_all_kinds(
    limits: dict[str, float], period: float | None
) -> None:
    solution = tm.plan(two_links(**limits), control_period=period)
    assert solution.success, solution.message
