"""Replays that fail, and replays of a plan that is interrupted."""

from __future__ import annotations

from dataclasses import replace

import pytest
from robot_samples import INERTIAL, joint, link, load, robot

import tominpmp as tm
from tominpmp.planner import candidate
from tominpmp.verification.verification import verify

BALL = "<collision><geometry><sphere radius='0.05'/></geometry></collision>"
LIMIT = '<limit lower="-3" upper="3" effort="100" velocity="8"/>'


@pytest.fixture
def problem(tmp_path):
    """A ball on a rail, with another ball as obstacle beside its way."""
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
    """Replays of a plan; the replays whose numbers are in ``fail`` do not pass."""
    verifications, fail = [], set()

    def count(*arguments, **options):
        found = verify(*arguments, **options)
        verifications.append(found)
        return replace(found, ok=False) if len(verifications) in fail else found

    monkeypatch.setattr(candidate, "verify", count)
    return verifications, fail


def test_failed_replay_leads_to_another_motion(problem, replays):
    verifications, fail = replays
    fail.add(1)
    solution = tm.plan(problem)
    assert solution.success and solution.verification.ok
    assert len(verifications) >= 2


@pytest.mark.parametrize("again", [False, True])
def test_motion_of_an_interrupted_plan_is_replayed(problem, replays, again):
    verifications, fail = replays
    records = []
    tm.plan(problem, callback=lambda record: records.append(record))
    last = len(records)
    verifications.clear()
    if again:
        fail.add(1)
    records.clear()

    def stop(record):
        records.append(record)
        return len(records) >= last

    solution = tm.plan(problem, callback=stop)
    assert solution.status is tm.Status.INTERRUPTED
    assert verifications
    if solution.success:
        assert solution.verification is not None and solution.verification.ok
    else:
        assert again
