"""Replays in which errors of the integrator grow are repeated with tighter tolerances.

If the two replays disagree, the motion is replayed with feedback.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from replays import integration

import tominpmp as tm
from tominpmp.options import Tolerances
from tominpmp.verification.feedback import ends_agree, errors_matter

# In this slow motion upwards, errors of the integrator grow by a factor of 2e10.
START = [-0.872, 2.293, 4.992, 2.843, 1.309, -2.691]
GOAL = [-0.08, 3.867, 5.097, -0.136, 2.149, -1.747]


@pytest.fixture(scope="module")
def raised() -> tm.Solution:
    kinova = tm.load_robot("kinova")
    return tm.plan(tm.Problem(kinova, START, tm.JointGoal(GOAL)))


def test_replay_that_finer_integration_changes_is_made_with_feedback(
    raised: tm.Solution,
) -> None:
    problem, motion = raised.problem, raised.trajectory
    start = np.concatenate([START, np.zeros(6)])
    ends = [
        integration(problem.robot, motion, "DOP853", tightness).run(start).q[-1]
        for tightness in (1.0, 10.0)
    ]
    moves = float(np.max(np.abs(ends[0] - ends[1])))
    misses = float(np.max(np.abs(ends[0] - GOAL)))
    assert 0.0 < moves < 1e-3
    # The replay keeps a tolerance of which finer integration changes a large share.
    strict = Tolerances(goal=max(1.5 * misses, 2.0 * moves))
    found = tm.verify(problem, motion, strict, integrator="DOP853")
    assert found.growth > 1e9
    assert found.feedback is not None
    assert "feedback" in found.message or not found.ok
    # With a wide tolerance the replay counts without feedback.
    loose = Tolerances(goal=max(2 * misses, 50.0 * moves))
    loose = tm.verify(problem, motion, loose, integrator="DOP853")
    assert loose.ok
    assert loose.feedback is None


def test_replays_agree_if_their_ends_are_close(raised: tm.Solution) -> None:
    replay, tolerances = raised.verification.replay, Tolerances()
    assert ends_agree(replay, replay, tolerances)
    q = np.array(replay.q)
    q[-1] += 0.05 * tolerances.goal
    assert ends_agree(replay, replace(replay, q=q), tolerances)
    q[-1] += 0.1 * tolerances.goal
    assert not ends_agree(replay, replace(replay, q=q), tolerances)
    assert not ends_agree(replay, replace(replay, complete=False), tolerances)


def test_errors_matter_only_where_they_grow_enough() -> None:
    assert not errors_matter(1e4, 1e-3, 1e-9)
    assert errors_matter(1e6, 1e-3, 1e-9)
    assert not errors_matter(1e6, 1e-3, 2e-11)
    assert errors_matter(1e8, 1e-3, 2e-11)
    assert errors_matter(np.inf, 1e-3, 2e-11)
    assert errors_matter(np.nan, 1e-3, 2e-11)
