"""Warm starts of problems with several segments, and refinement of their grid."""

from __future__ import annotations

import numpy as np
import pytest

import tominpmp as tm
from tests.sample_arms import make_arm, slide

OPTIONS = {"intervals": 40, "control": "constant", "refine": None}


def problem(middle=0.5, end=1.0, start=0.0, **changes):
    robot = make_arm(slide(2.0), effort=10.0)
    segments = [
        tm.Segment(tm.JointGoal([middle]), dwell=0.1),
        tm.Segment(tm.JointGoal([end])),
    ]
    return tm.Problem(robot, [start], segments=segments, **changes)


@pytest.fixture(scope="module")
def former():
    found = tm.plan(problem(), **OPTIONS)
    assert found.success, found.message
    return found


@pytest.mark.parametrize("kind", ["solution", "trajectory", "file"])
@pytest.mark.parametrize("control", ["constant", "linear"])
def test_warm_start_with_a_motion_of_segments_is_used(former, tmp_path, kind, control):
    start = former
    if kind == "trajectory":
        start = former.trajectory
    elif kind == "file":
        start = tm.load_motion(former.export(tmp_path / "former.csv"))
    changed = problem(0.45, 1.1, 0.02)
    found = tm.plan(changed, start=start, **(OPTIONS | {"control": control}))
    cold = tm.plan(changed, **(OPTIONS | {"control": control}))
    assert found.success and cold.success, found.message
    assert found.T <= 1.005 * cold.T
    np.testing.assert_allclose(found.initial.q[0], 0.02, atol=1e-9)
    # No other guess is made; the certificate may lead to a few more iterations.
    first = [record.duration for record in found.history if record.start == 0]
    later = [record.duration for record in found.history if record.start > 0]
    assert later == pytest.approx([first[-1]] * len(later), rel=1e-3)


def test_warm_start_keeps_the_nearest_goal_of_a_set(former):
    robot = former.problem.robot
    either = tm.AnyGoal([tm.JointGoal([-3.0]), tm.JointGoal([0.5])])
    segments = [tm.Segment(either, dwell=0.1), tm.Segment(tm.JointGoal([1.0]))]
    changed = tm.Problem(robot, [0.0], segments=segments)
    found = tm.plan(changed, start=former, **OPTIONS)
    assert found.success, found.message
    assert abs(found.segments[0].trajectory.q[-1, 0] - 0.5) < 1e-6


@pytest.mark.parametrize("goals", [[1.0], [0.2, 0.5, 1.0]])
def test_warm_start_may_have_another_number_of_segments(former, goals):
    """Regression: torques of the former segments were assigned to the new segments."""
    segments = [tm.Segment(tm.JointGoal([goal])) for goal in goals]
    changed = tm.Problem(former.problem.robot, [0.0], segments=segments)
    verdict = tm.verify(changed, former.trajectory)
    assert verdict.ok, verdict.message
    found = tm.plan(changed, start=former, **OPTIONS)
    assert found.T <= 1.005 * tm.plan(changed, **OPTIONS).T


def test_warm_start_with_other_joints_is_rejected(former):
    other = tm.Trajectory(("a",), [0.0, 1.0], np.zeros((2, 1)), *[np.zeros((2, 1))] * 2)
    with pytest.raises(tm.ProblemError, match="start"):
        tm.plan(problem(), start=other, **OPTIONS)


def test_grid_refinement_shortens_a_motion_of_segments():
    robot = make_arm(slide(2.0), effort=10.0)
    passed = [tm.Segment(tm.JointGoal([0.3])), tm.Segment(tm.JointGoal([1.0]))]
    task = tm.Problem(robot, [0.0], segments=passed)
    coarse = tm.plan(task, **OPTIONS)
    finer = tm.plan(task, **(OPTIONS | {"refine": "grid"}))
    assert coarse.success and finer.success, finer.message
    assert finer.T < coarse.T
    assert finer.trajectory.t.size > coarse.trajectory.t.size
    expected = 2.0 * np.sqrt(1.0 / 5.0)
    assert expected * (1.0 - 1e-6) <= finer.T <= 1.002 * expected
