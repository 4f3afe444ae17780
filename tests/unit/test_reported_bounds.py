"""A lower bound is reported if it is at least half of the duration."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import invoke
from sample_arms import make_arm, rod

import tominpmp as tm
from tominpmp.cli.report import report_data, report_text

ABOVE = "% above the lower bound"


@pytest.fixture(scope="module")
def fast() -> tm.Solution:
    """Torques are the active limits; the velocity limits give only a small bound."""
    arm = make_arm(rod(1.0, 1.0), rod(1.0, 1.0), effort=np.array([10.0, 5.0]))
    problem = tm.Problem(arm, [-0.4, 0.6], tm.JointGoal([0.9, -0.3]))
    return tm.plan(problem, effort="quick")


@pytest.fixture(scope="module")
def slow() -> tm.Solution:
    """Velocities are the active limits."""
    arm = make_arm(rod(1.0, 1.0), rod(1.0, 1.0), effort=100.0, velocity=1.0)
    problem = tm.Problem(arm, [-0.4, 0.6], tm.JointGoal([0.9, -0.3]))
    return tm.plan(problem, effort="quick")


def test_bound_below_half_of_the_duration_is_not_reported(
    fast: tm.Solution,
) -> None:
    assert fast.success
    assert 0.0 < fast.lower_bound.T < 0.01 * fast.T
    assert fast.gap == pytest.approx(fast.T / fast.lower_bound.T - 1.0)
    data = report_data(fast, {})
    assert data["lower_bound"] == fast.lower_bound.T
    number = f"{fast.lower_bound.T:.4f}"
    for text in (fast.message, report_text(data), fast._repr_html_()):
        assert ABOVE not in text and number not in text
    assert "no useful bound" in report_text(data)
    assert "no useful bound" in fast._repr_html_()


def test_bound_above_half_of_the_duration_is_reported_everywhere(
    slow: tm.Solution,
) -> None:
    assert slow.success
    assert 0.5 * slow.T < slow.lower_bound.T < slow.T
    assert f"{100.0 * slow.gap:.1f} {ABOVE}" in slow.message
    expected = f"{slow.lower_bound.T:.4f} s ({slow.lower_bound.reason})"
    assert expected in report_text(report_data(slow, {}))
    assert expected in slow._repr_html_()
    # For a motion of more than twice the bound, the bound is useless.
    late = replace(slow, lower_bound=tm.LowerBound(0.49 * slow.T, "so it is"))
    assert "no useful bound" in report_text(report_data(late, {}))
    assert "no useful bound" in late._repr_html_()


def test_failed_plan_reports_no_bound(slow: tm.Solution) -> None:
    failed = replace(slow, feasible=False, message="")
    assert "lower bound" not in report_text(report_data(failed, {}))
    assert "lower bound" not in failed._repr_html_()


def test_tour_reports_its_bound_if_it_is_useful(tmp_path: Path) -> None:
    tour = """
[[stations]]
name = "one"
goal = {type = "joint", q = [0.9, 0.8, -0.4]}

[[stations]]
name = "two"
goal = {type = "joint", q = [0.6, 1.0, -0.3]}
"""
    head = '[robot]\nname = "planar3r"\n%s\n[start]\nq = [0.5, 1.2, -0.7]\n%s\n'
    limits = ("effort = 1e4", "[motion_limits]\nacceleration = 5.0")
    found = []
    for kind, words in (("useful", limits), ("useless", ("velocity = 1e3", ""))):
        path = tmp_path / f"{kind}.toml"
        path.write_text(head % words + tour)
        done = invoke(["tour", str(path)])
        assert done.exit_code == 0, done.output
        found.append(done.output)
    assert ABOVE in found[0] and "No tour takes less" in found[0]
    assert "no useful bound" in found[1] and "No tour takes less" not in found[1]


def test_deprecated_argument_quick_warns():
    robot = tm.load_robot("planar3r")
    problem = tm.Problem(robot, [0.5, 1.7, -1.7], tm.JointGoal([1.5, 1.0, -0.7]))
    with pytest.warns(tm.TominpmpWarning, match="quick has no effect"):
        assert tm.lower_bound(problem, quick=True) == tm.lower_bound(problem)
