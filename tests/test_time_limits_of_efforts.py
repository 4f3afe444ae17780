"""Plans without a given time limit have the limit of their planning effort."""

from __future__ import annotations

import math
import re
import time
from dataclasses import replace

import numpy as np
import pytest
from sample_arms import make_arm, rod

import tominpmp as tm
from tominpmp import options
from tominpmp.files.scenario import load_scenario, save_scenario
from tominpmp.planner.conclusion import _saturated


def reach():
    robot = tm.load_robot("planar3r")
    return tm.Problem(robot, (0.5, 1.7, -1.7), tm.JointGoal((2.0, -1.0, 0.5)))


def delay_iteration(record):
    """Callback that delays every iteration, as on a slow machine."""
    time.sleep(0.05)


@pytest.mark.parametrize("effort", options.EFFORTS)
def test_plan_ends_at_the_default_time_limit_of_its_effort(monkeypatch, effort):
    limit = 1.0
    monkeypatch.setitem(options.TIME_LIMITS, effort, limit)
    tm.plan(reach(), effort="quick", max_planning_time=math.inf)  # libraries load
    begin = time.perf_counter()
    found = tm.plan(reach(), effort=effort, callback=delay_iteration)
    seconds = time.perf_counter() - begin
    assert seconds < 1.1 * limit + 0.2
    assert found.status is tm.Status.TIME_LIMIT
    assert "1 s were allowed; max_planning_time allows more" in found.message


def test_higher_efforts_have_longer_time_limits():
    limits = [tm.Options(effort=effort).time_limit for effort in options.EFFORTS]
    assert limits == sorted(limits)
    assert len(set(limits)) == len(limits)


def test_given_time_limit_replaces_that_of_the_effort(monkeypatch):
    monkeypatch.setitem(options.TIME_LIMITS, "standard", 1e-3)
    assert tm.plan(reach(), max_planning_time=60.0).status is tm.Status.CONVERGED


def test_infinite_planning_time_is_no_limit(monkeypatch, tmp_path):
    monkeypatch.setitem(options.TIME_LIMITS, "standard", 1e-3)
    chosen = tm.Options(max_planning_time=math.inf)
    for ending in ("toml", "yaml", "json"):
        path = tmp_path / f"a.{ending}"
        save_scenario(path, reach(), chosen)
        assert load_scenario(path).options.max_planning_time == math.inf
    assert tm.plan(reach(), chosen).status is tm.Status.CONVERGED


def test_joint_whose_friction_takes_most_of_its_effort_is_named():
    """A gripper that its motor hardly turns determines the duration of all joints."""
    weak = make_arm(rod(1.0, 0.1), effort=np.array([0.005]), friction=[0.004])
    problem = tm.Problem(weak, (0.0,), tm.JointGoal((1.0,)))
    found = tm.plan(problem)
    name = weak.joint_names[0]
    assert re.search(
        rf"Joint {name} is at its effort limit of 0\.005 N m for \d+% of "
        r"the motion, 0\.004 N m of which its dry friction takes: if it need not move, "
        r"lock it",
        _saturated(problem, found.trajectory),
    )
    strong = replace(problem, robot=weak.with_changes(friction=[0.001]))
    assert _saturated(strong, found.trajectory) == ""
