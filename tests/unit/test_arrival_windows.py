"""Arrival windows of segments: the earliest and the latest time at which one ends."""

from __future__ import annotations

import math

import numpy as np
import pytest

import tominpmp as tm
from tests.sample_arms import make_arm, slide
from tominpmp.exceptions import ProblemError

QUICK = {"intervals": 12, "effort": "quick", "starts": 1, "control": "constant"}


def rail(*segments) -> tm.Problem:
    arm = make_arm(slide(1.0), effort=np.array([1.0]))
    return tm.Problem(arm, [0.0], segments=segments)


def to(q: float, **options) -> tm.Segment:
    return tm.Segment(tm.JointGoal([q]), **options)


def test_goal_is_reached_at_its_earliest_arrival():
    solution = tm.plan(rail(to(1.0, arrival=(3.0, math.inf))), **QUICK)
    assert solution.success, solution.message
    assert pytest.approx(3.0, abs=1e-5) == solution.T


def test_via_point_is_passed_within_its_arrival_window():
    """The motion goes from 0 over 1 to 3; the via point at 1 has an arrival window."""
    free = tm.plan(rail(to(1.0), to(3.0)), **QUICK)
    early = tm.plan(rail(to(1.0, arrival=(0.0, 1.5)), to(3.0)), **QUICK)
    late = tm.plan(rail(to(1.0, arrival=(2.0, 4.0)), to(3.0)), **QUICK)
    for solution in (free, early, late):
        assert solution.success, solution.message
    assert early.segments[0].arrival <= 1.5 + 1e-5
    assert pytest.approx(2.0, abs=1e-5) == late.segments[0].arrival
    # Without a window the via point is passed after sqrt(2) s: before 1.5 s, and
    # earlier than 2 s allow.
    assert pytest.approx(free.T, rel=5e-3) == early.T
    assert late.T > free.T + 0.1


@pytest.mark.parametrize(
    ("segments", "duration"),
    [
        ([to(0.0, arrival=(0.5, 1.0)), to(1.0)], 2.5),
        ([to(0.0, arrival=(0.5, 1.0), stop=True), to(1.0)], 2.5),
        ([to(1.0, arrival=(3.0, 3.0)), to(1.0, arrival=(4.0, 5.0))], 4.0),
    ],
)
def test_arm_waits_at_a_goal_that_equals_its_position(segments, duration):
    """Regression: a segment without a displacement did not become long enough.

    Its initial guess was too short.
    """
    solution = tm.plan(rail(*segments), **QUICK)
    assert solution.success, solution.message
    assert solution.iterations < 20
    assert solution.T <= duration * 1.01
    first = segments[0].arrival
    assert first[0] - 1e-5 <= solution.segments[0].arrival <= first[1] + 1e-5


def test_replay_names_the_goal_reached_too_late_or_too_early():
    motion = tm.plan(rail(to(1.0)), **QUICK).trajectory
    verdict = tm.verify(rail(to(1.0, arrival=(0.0, 1.5))), motion)
    assert not verdict.ok
    assert "the goal is reached 0.5" in verdict.message
    assert "s too late, at 2.0" in verdict.message
    verdict = tm.verify(rail(to(1.0, arrival=(2.5, 9.0))), motion)
    assert "s too early" in verdict.message


def test_unreachable_arrival_window_fails_with_a_message():
    solution = tm.plan(rail(to(1.0, arrival=(0.0, 1.5))), **QUICK)
    assert not solution.success
    assert solution.message


def test_arrival_windows_survive_a_scenario_file(tmp_path):
    robot = tm.load_robot("planar3r", gravity=(0, 0, 0))
    goal = tm.JointGoal([0.6, 0.5, 0.4])
    parts = [tm.Segment(goal, arrival=(1.0, math.inf)), tm.Segment(goal)]
    problem = tm.Problem(robot, [0.5, 0.5, 0.5], segments=parts)
    path = tmp_path / "task.toml"
    tm.save_scenario(path, problem)
    assert tm.load_scenario(path).problem.segments == problem.segments


@pytest.mark.parametrize(
    "arrival", [3.0, (1.0,), (2.0, 1.0), (-1.0, 1.0), (0.0, math.nan), "ab", (0.0, 0.0)]
)
def test_invalid_arrival_window_is_rejected(arrival):
    with pytest.raises(ProblemError, match=r"segment\.arrival is .*, expected the ear"):
        to(1.0, arrival=arrival)


def test_contradictory_arrival_windows_are_rejected():
    words = r"segment 2 is to be reached by 1 s, and segment 1 does not end before 2\.5"
    with pytest.raises(ProblemError, match=words):
        rail(to(1.0, arrival=(2.0, 3.0), dwell=0.5), to(2.0, arrival=(0.0, 1.0)))
