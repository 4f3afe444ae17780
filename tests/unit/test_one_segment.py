"""A problem of one segment is planned with the payload and limits of that segment."""

from __future__ import annotations

import numpy as np
import pytest

import tominpmp as tm
from tests.sample_arms import make_arm, slide


def planned(*segments: tm.Segment, **options) -> tm.Solution:
    arm = make_arm(slide(1.0), effort=np.array([10.0]))
    problem = tm.Problem(arm, [0.0], segments=segments)
    solution = tm.plan(problem, intervals=16, **options)
    assert solution.success, solution.message
    return solution


@pytest.mark.parametrize(
    ("fields", "expected"),
    [
        ({"payload": tm.Payload(3.0, "tip")}, 2.0 * np.sqrt(0.4)),
        ({"constraints": (tm.ToolSpeed("tip", 0.5),)}, 2.05),
        ({"motion_limits": tm.MotionLimits(acceleration=2.0)}, np.sqrt(2.0)),
        # Jerk J alone: four equal parts of (d / 2 J)^(1/3).
        ({"motion_limits": tm.MotionLimits(jerk=16.0)}, 4.0 * (1.0 / 32.0) ** (1 / 3)),
    ],
    ids=["payload", "constraint", "acceleration", "jerk"],
)
def test_payload_constraint_and_limits_of_the_segment_hold(fields, expected):
    solution = planned(tm.Segment(tm.JointGoal([1.0]), **fields))
    assert solution.verification.ok
    assert pytest.approx(expected, rel=5e-3) == solution.T


def test_jerk_limit_on_one_segment_makes_its_acceleration_continuous():
    quiet = tm.MotionLimits(jerk=16.0)
    slow, fast = planned(
        tm.Segment(tm.JointGoal([1.0]), motion_limits=quiet, stop=True),
        tm.Segment(tm.JointGoal([0.0])),
    ).segments
    # From a = 0 with J for t and with -J for (1 + sqrt 2) t to rest, still braking.
    t, s = 1.0, 1.0 + np.sqrt(2.0)
    way = 16.0 * (t**3 / 6.0 + t**2 * s / 2.0 + t * s**2 / 2.0 - s**3 / 6.0)
    expected = (t + s) * (1.0 / way) ** (1 / 3)
    assert slow.duration == pytest.approx(expected, rel=1e-2)
    assert fast.duration < 0.8 * slow.duration


@pytest.mark.parametrize("kind", ["problem", "segment", "first of two"])
def test_jerk_limits_are_in_certificates_and_sensitivities(kind):
    arm, quiet = make_arm(slide(1.0), effort=10.0), tm.MotionLimits(jerk=16.0)
    there = tm.JointGoal([1.0])
    if kind == "problem":
        problem = tm.Problem(arm, [0.0], there, motion_limits=quiet)
    else:
        segments = [tm.Segment(there, motion_limits=quiet, stop=True)]
        if kind != "segment":
            segments.append(tm.Segment(tm.JointGoal([0.0])))
        problem = tm.Problem(arm, [0.0], segments=segments)
    solution = tm.plan(problem, intervals=16)
    assert solution.certificate.ok, solution.certificate.message
    jerk = next(item for item in solution.sensitivities if item.kind == "jerk")
    # Without another limit, T is proportional to the jerk to the power of -1/3.
    if kind != "first of two":
        assert jerk.value == pytest.approx(-1.0 / 3.0, rel=1e-2)
    else:
        assert jerk.value < -0.1
