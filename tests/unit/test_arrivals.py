"""Segments that are to end no earlier, or no later, than some time."""

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


def to(q: float, **more) -> tm.Segment:
    return tm.Segment(tm.JointGoal([q]), **more)


def test_a_goal_is_not_reached_before_it_may_be():
    solution = tm.plan(rail(to(1.0, arrival=(3.0, math.inf))), **QUICK)
    assert solution.success, solution.message
    assert pytest.approx(3.0, abs=1e-5) == solution.T


def test_a_via_point_is_passed_in_time():
    """From 0 to 1 to 3, at 1 within two times: faster to there, slower beyond."""
    free = tm.plan(rail(to(1.0), to(3.0)), **QUICK)
    early = tm.plan(rail(to(1.0, arrival=(0.0, 1.5)), to(3.0)), **QUICK)
    late = tm.plan(rail(to(1.0, arrival=(2.0, 4.0)), to(3.0)), **QUICK)
    for solution in (free, early, late):
        assert solution.success, solution.message
    assert early.segments[0].arrival <= 1.5 + 1e-5
    assert pytest.approx(2.0, abs=1e-5) == late.segments[0].arrival
    # It is passed after sqrt(2) s anyway: that is early enough for 1.5, not for 2.
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
def test_an_arm_waits_where_it_is(segments, duration):
    """A segment that ends where it begins was too short to become long enough."""
    solution = tm.plan(rail(*segments), **QUICK)
    assert solution.success, solution.message
    assert solution.iterations < 20
    assert solution.T <= duration * 1.01
    first = segments[0].arrival
    assert first[0] - 1e-5 <= solution.segments[0].arrival <= first[1] + 1e-5


def test_the_replay_tells_who_is_late():
    motion = tm.plan(rail(to(1.0)), **QUICK).trajectory
    verdict = tm.verify(rail(to(1.0, arrival=(0.0, 1.5))), motion)
    assert not verdict.ok
    assert "the goal is reached 0.5" in verdict.message
    assert "s too late, at 2.0" in verdict.message
    verdict = tm.verify(rail(to(1.0, arrival=(2.5, 9.0))), motion)
    assert "s too early" in verdict.message


def test_what_cannot_be_reached_in_time_is_told():
    solution = tm.plan(rail(to(1.0, arrival=(0.0, 1.5))), **QUICK)
    assert not solution.success
    assert solution.message


def test_scenario_files_know_them(tmp_path):
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
def test_wrong_times_are_refused(arrival):
    with pytest.raises(ProblemError, match=r"segment\.arrival is .*, expected the ear"):
        to(1.0, arrival=arrival)


def test_contradictory_times_are_refused():
    words = r"segment 2 is to be reached by 1 s, and segment 1 does not end before 2\.5"
    with pytest.raises(ProblemError, match=words):
        rail(to(1.0, arrival=(2.0, 3.0), dwell=0.5), to(2.0, arrival=(0.0, 1.0)))
