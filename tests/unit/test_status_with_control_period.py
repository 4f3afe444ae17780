"""Status and certificate of motions with a control period."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import tominpmp as tm
from tominpmp.certificate.certificate import with_bound
from tominpmp.certificate.minimum_principle import certify, clock_share
from tominpmp.planner.control_period import _with_clock, _without_clock, status_on_clock
from tominpmp.planner.plan_state import PlanState

START = np.array([0.5, 1.7, -1.7])


@pytest.fixture(scope="module")
def problem() -> tm.Problem:
    goal = tm.JointGoal(START + np.array([0.5, -0.3, 0.2]))
    return tm.Problem(tm.load_robot("planar3r"), START, goal)


@pytest.fixture(scope="module")
def free(problem: tm.Problem) -> tm.Solution:
    return tm.plan(problem)


def test_rounding_to_the_control_period_is_no_predicted_gain(
    problem: tm.Problem, free: tm.Solution
) -> None:
    period = free.T / 19.5
    solution = tm.plan(problem, control_period=period)
    assert solution.status is tm.Status.CONVERGED, solution.message
    certificate = solution.certificate
    assert certificate is not None
    assert certificate.ok, certificate.message
    assert certificate.stationarity > 0.01
    assert "clock" in certificate.message
    # Without the control period, the same motion is not certified.
    motion = solution.trajectory
    assert motion is not None
    assert not certify(problem, motion, verification=solution.verification).ok


def test_motion_slower_by_more_than_a_period_is_stalled(free: tm.Solution) -> None:
    slow = tm.smooth(free, 0.05)
    assert slow.trajectory is not None
    status, remark = status_on_clock(free, slow.trajectory, slow.verification, 0.004)
    assert status is tm.Status.STALLED
    assert "Small changes promise" in remark
    assert free.trajectory is not None
    same = status_on_clock(free, free.trajectory, free.verification, 0.004)
    assert same == (tm.Status.CONVERGED, "")


def test_loss_by_the_control_period_is_never_reported_as_negative(
    free: tm.Solution,
) -> None:
    """Regression: the message said "-0.00 % above the motion without such a clock"."""
    motion = free.trajectory
    assert motion is not None
    longer = replace(free, trajectory=replace(motion, t=(1.0 + 1e-7) * motion.t))
    clocked: Any = SimpleNamespace(
        trajectory=motion, verification=free.verification, remark=""
    )
    state: Any = SimpleNamespace(seconds=0.0)
    message = _with_clock(longer, free.T / 100, clocked, state).message
    assert " 0.00 % above the motion without such a clock" in message


def test_time_limit_with_a_control_period_names_the_seconds_allowed(
    problem: tm.Problem, free: tm.Solution
) -> None:
    """Regression: only messages of plans without a control period had them."""
    state = PlanState(problem, free.options)
    cut, words = replace(free, status=tm.Status.TIME_LIMIT), " s were allowed; max_pl"
    clocked: Any = SimpleNamespace(
        trajectory=free.trajectory, verification=free.verification, remark=""
    )
    assert words in _with_clock(cut, free.T / 100, clocked, state).message
    wanted = PlanState(problem, free.options.changed({"control_period": 0.01}))
    message = _without_clock(cut, wanted, None, tm.Status.TIME_LIMIT).message
    assert "No motion on a clock of 0.01 s was found: " in message and words in message


def test_clock_share_is_the_period_over_the_duration(free: tm.Solution) -> None:
    motion = free.trajectory
    assert motion is not None
    assert clock_share(motion, free.T / 50) == pytest.approx(0.02)
    # Four periods are the shortest motion with a control period.
    assert clock_share(motion, free.T / 4) == 1.0


def test_lower_bound_overrules_a_predicted_gain(free: tm.Solution) -> None:
    found = free.certificate
    assert found is not None
    refuted = replace(found, ok=False, stationarity=0.02, message="Refuted.")
    T = free.T
    assert not with_bound(refuted, T, 0.98 * T, "speed").ok
    accepted = with_bound(refuted, T, 0.995 * T, "speed")
    assert accepted.ok
    assert "No motion takes less" in accepted.message


@pytest.mark.parametrize("period", [0.0, -1.0, np.nan, np.inf, "a"])
def test_wrong_control_period_is_rejected(
    problem: tm.Problem, free: tm.Solution, period: object
) -> None:
    with pytest.raises(tm.ProblemError, match="control_period"):
        certify(problem, free.trajectory, control_period=period)  # type: ignore
