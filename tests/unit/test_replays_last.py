"""Replays that wait until it is known that no finer grid takes a motion's place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from robot_samples import INERTIAL, joint, link, load, robot

import tominpmp as tm
from tominpmp.options import Options
from tominpmp.planner import attempt as attempts
from tominpmp.planner.replays import replays_last
from tominpmp.verification import verify

BALL = "<collision><geometry><sphere radius='0.05'/></geometry></collision>"
LIMIT = '<limit lower="-3" upper="3" effort="100" velocity="8"/>'


@pytest.fixture
def problem(tmp_path):
    """A ball on a rail, with another one beside its way."""
    rail = load(
        tmp_path,
        robot(
            link("base", ""),
            link("ball", INERTIAL + BALL),
            joint("slide", "base", "ball", "prismatic", limit=LIMIT, axis="1 0 0"),
        ),
    )
    scene = tm.Scene([tm.Sphere("post", radius=0.05, position=(1.0, 0.15, 0.0))])
    return tm.Problem(rail, [-1.0], tm.JointGoal([1.0]), scene=scene)


@pytest.fixture
def replays(monkeypatch):
    """Replays that a plan makes; those whose numbers are in ``fail`` go wrong."""
    made, fail = [], set()

    def count(*arguments, **options):
        found = verify(*arguments, **options)
        made.append(found)
        return replace(found, ok=False) if len(made) in fail else found

    monkeypatch.setattr(attempts, "verify", count)
    return made, fail


def test_a_plan_replays_the_motion_that_it_returns_alone(problem, replays):
    made, _ = replays
    solution = tm.plan(problem)
    assert solution.success and solution.status is tm.Status.CONVERGED
    assert len(made) == 1 and solution.verification is made[0]
    limited = tm.plan(problem, max_planning_time=60.0)
    assert limited.T == pytest.approx(solution.T)
    assert len(made) >= 2


def test_nor_does_an_arm_that_is_alone_replay_what_a_finer_grid_replaces(replays):
    made, _ = replays
    start, goal = [0.2, -1.2, 0.0, -1.5, -0.1, 0.1], [1.1, -0.4, -1.9, 0.1, -1.2, 1.0]
    near = tm.Problem(tm.load_robot("ur10"), start, tm.JointGoal(goal))
    coarse = tm.plan(near, refine=None)
    made.clear()
    solution = tm.plan(near)
    assert solution.T < coarse.T  # a finer grid took its place
    assert len(made) == 1 and solution.verification is made[0]


def test_a_replay_that_has_waited_and_fails_leads_to_another_plan(problem, replays):
    made, fail = replays
    fail.add(1)
    solution = tm.plan(problem)
    assert solution.success and solution.verification.ok
    assert len(made) >= 2


@pytest.mark.parametrize("again", [False, True])
def test_what_was_found_when_a_plan_is_interrupted_is_replayed(problem, replays, again):
    made, fail = replays
    records = []
    tm.plan(problem, callback=lambda record: records.append(record))
    last = len(records)
    made.clear()
    if again:
        fail.add(1)
    records.clear()

    def stop(record):
        records.append(record)
        return len(records) >= last

    solution = tm.plan(problem, callback=stop)
    assert solution.status is tm.Status.INTERRUPTED
    assert made
    if solution.success:
        assert solution.verification is not None and solution.verification.ok
    else:
        assert again


def test_where_what_was_found_has_to_hold_nothing_waits():
    usual = Options(method="inverse", refine="auto")
    assert replays_last(usual)
    for change in (
        {"max_planning_time": 1.0},
        {"starts": 3},
        {"effort": "thorough"},
        {"refine": None},
        {"control_period": 0.01},
    ):
        assert not replays_last(replace(usual, **change)), change


def test_the_same_motion_is_returned(problem, monkeypatch):
    usual = tm.plan(problem)
    monkeypatch.setattr("tominpmp.planner.planning.replays_last", lambda _: False)
    at_once = tm.plan(problem)
    assert at_once.T == usual.T
    np.testing.assert_array_equal(at_once.trajectory.q, usual.trajectory.q)
