"""Certificates of motions over micrometres or within microseconds."""

from __future__ import annotations

import numpy as np
import pytest

import tominpmp as tm

START = np.array([0.5, 1.7, -1.7])
WAY = np.array([1.0, -0.6, 0.3])


def goal_at(share: float) -> tm.Problem:
    goal = tm.JointGoal(START + share * WAY)
    return tm.Problem(tm.load_robot("planar3r"), START, goal)


@pytest.mark.parametrize("share", [2e-6, 1e-5])
def test_converged_motion_over_micrometres_is_certified(share: float) -> None:
    solution = tm.plan(goal_at(share), effort="quick")
    assert solution.status is tm.Status.CONVERGED, solution.message
    certificate = solution.certificate
    assert certificate is not None
    assert certificate.ok, certificate.message
    # T grows with the root of the distance where no speed limit is reached.
    assert solution.T / np.sqrt(share) == pytest.approx(0.8, rel=0.5)


def test_slow_motion_over_micrometres_fails() -> None:
    solution = tm.plan(goal_at(2e-6), objective="feasible")
    assert solution.success
    certificate = solution.certificate
    assert certificate is not None
    assert not certificate.ok
    assert certificate.stationarity > 0.01


@pytest.mark.parametrize("way", [2e-6, 2e-5])
def test_converged_motion_within_microseconds_is_certified(way: float) -> None:
    strong = tm.load_robot("planar3r", effort=[1e5, 1e5, 1e5])
    goal = tm.JointGoal(START + way)
    solution = tm.plan(tm.Problem(strong, START, goal), effort="quick")
    assert solution.status is tm.Status.CONVERGED, solution.message
    assert 0.0 < solution.T < 1e-4
    certificate = solution.certificate
    assert certificate is not None
    assert certificate.ok, certificate.message
    assert certificate.stationarity < 0.01


def test_motion_of_zero_duration_is_certified() -> None:
    solution = tm.plan(goal_at(0.0))
    certificate = solution.certificate
    assert certificate is not None
    assert certificate.ok, certificate.message
    assert "no change can shorten" in certificate.message
