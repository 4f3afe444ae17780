"""Several segments on the clock of a controller: knots on ticks, stays rounded up."""

from __future__ import annotations

import numpy as np
import pytest

import tominpmp as tm
from tests.sample_arms import make_arm, slide

PERIOD = 0.01


@pytest.mark.parametrize("control", ["constant", "linear"])
def test_segments_on_a_clock(tmp_path, control):
    robot = make_arm(slide(2.0), effort=10.0)
    limits = None
    if control == "linear":
        limits = tm.MotionLimits(acceleration=4.0, jerk=80.0)
    segments = [
        tm.Segment(tm.JointGoal([0.4])),
        tm.Segment(tm.JointGoal([0.6]), dwell=0.123),
        tm.Segment(tm.JointGoal([1.0]), payload=tm.Payload(1.0, "tip")),
    ]
    problem = tm.Problem(robot, [0.0], segments=segments, motion_limits=limits)
    free = tm.plan(problem, intervals=24, control=control)
    solution = tm.plan(problem, intervals=24, control=control, control_period=PERIOD)
    assert solution.success, solution.message
    motion = solution.trajectory
    for times in (motion.t, motion.segment_ends):
        ticks = times / PERIOD
        np.testing.assert_allclose(ticks, np.rint(ticks), atol=1e-9)
    # A tick for each segment, one for the stay, and what coarser knots cost.
    assert free.success, free.message
    assert free.T - 1e-6 <= solution.T <= free.T * 1.03 + 4 * PERIOD
    stay = solution.segments[1]
    during = motion(np.linspace(stay.arrival, stay.end, 20))
    np.testing.assert_allclose(during.q, 0.6, atol=1e-6)
    np.testing.assert_allclose(during.v, 0.0, atol=1e-6)
    path = solution.export(tmp_path / "motion.csv", dt=PERIOD)
    assert tm.verify(problem, tm.load_motion(path)).ok
    assert tm.check_file(problem, path).ok
