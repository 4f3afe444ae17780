"""Certificates of motions of micrometres: those of the same motions in metres."""

from __future__ import annotations

import numpy as np
import pytest

import tominpmp as tm
from tominpmp.certificate.optimality_report import no_time, not_asked

START = np.array([0.5, 1.7, -1.7])
WAY = np.array([1.0, -0.6, 0.3])


def goal_at(share: float) -> tm.Problem:
    goal = tm.JointGoal(START + share * WAY)
    return tm.Problem(tm.load_robot("planar3r"), START, goal)


@pytest.mark.parametrize("share", [1e-7, 1e-6])
def test_a_small_motion_that_converged_is_certified(share: float) -> None:
    solution = tm.plan(goal_at(share))
    assert solution.status is tm.Status.CONVERGED, solution.message
    certificate = solution.certificate
    assert certificate is not None
    assert certificate.ok, certificate.message
    # T grows with the root of the way where no speed limit is reached.
    assert solution.T / np.sqrt(share) == pytest.approx(0.8, rel=0.5)


def test_a_small_motion_that_is_slow_is_refuted() -> None:
    solution = tm.plan(goal_at(1e-7), objective="feasible")
    assert solution.success
    certificate = solution.certificate
    assert certificate is not None
    assert not certificate.ok
    assert certificate.stationarity > 0.01


@pytest.mark.parametrize("share", [0.0, 1e-11, 1e-9])
def test_status_and_certificate_agree_where_numbers_end(share: float) -> None:
    robot = tm.load_robot("planar3r")
    goal = tm.JointGoal(START + share * WAY)
    inside = tm.JointRegionGoal(START, tolerance=0.1)
    solution = tm.plan(tm.Problem(robot, START, goal if share else inside))
    certificate = solution.certificate
    assert certificate is not None
    assert certificate.ok == (solution.status is tm.Status.CONVERGED)


def test_a_motion_that_takes_no_time_is_not_asked_for_less() -> None:
    assert no_time(0.9e-4)
    assert not no_time(1.1e-4)
    assert "no time to speak of" in not_asked(0.9e-4)
