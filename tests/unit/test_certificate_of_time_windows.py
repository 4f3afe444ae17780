"""The certificate of motions with arrival windows and constraints in time windows."""

from __future__ import annotations

import math

import pytest

import tominpmp as tm
from tests.sample_arms import make_arm, slide
from tests.unit.test_time_windows import duration_with_a_slow_beginning

OPTIONS = {"intervals": 40, "effort": "quick"}
ARM = make_arm(slide(1.0), effort=1.0)


def to(x: float, **more) -> tm.Segment:
    return tm.Segment(tm.JointGoal([x]), **more)


def by_way_of(*segments: tm.Segment, **more) -> tm.Problem:
    return tm.Problem(ARM, [0.0], segments=segments, **more)


def in_windows(*constraints) -> tm.Problem:
    return tm.Problem(ARM, [0.0], tm.JointGoal([1.0]), constraints=constraints)


def certified(problem: tm.Problem) -> tm.Solution:
    solution = tm.plan(problem, **OPTIONS)
    assert solution.status is tm.Status.CONVERGED, solution.message
    found = solution.certificate
    assert found.ok, found.message
    return solution


def test_earliest_arrival_is_an_active_limit():
    """Half way no sooner than after 3 s, then as fast as possible to a stop."""
    solution = certified(by_way_of(to(0.5, arrival=(3.0, 9.0)), to(1.0)))
    assert pytest.approx(4.0, rel=1e-3) == solution.T
    found = solution.certificate
    assert "Limits depend on time" in found.message
    assert ("arrival", "segment 1") in {(x.kind, x.name) for x in found.active}


def test_goal_reached_later_than_necessary_is_named():
    solution = certified(by_way_of(to(0.5, arrival=(3.5, 9.0)), to(1.0)))
    sooner = by_way_of(to(0.5, arrival=(3.0, 9.0)), to(1.0))
    found = tm.certify(sooner, solution.trajectory)
    assert not found.ok
    assert found.stationarity == pytest.approx(0.5 / solution.T, rel=0.1)
    assert "the goal of segment 1 is met 0.5 s later than necessary" in found.message


def test_dwells_count_towards_the_arrival_at_a_goal():
    """There and back, with dwells: the second goal is reached at its earliest time."""
    early, late = to(0.5, dwell=0.4), to(0.2, arrival=(3.0, 9.0), dwell=0.3)
    solution = certified(by_way_of(early, late, to(1.0)))
    assert pytest.approx(3.3 + 2.0 * math.sqrt(0.8), rel=1e-3) == solution.T
    sooner = by_way_of(early, to(0.2, arrival=(2.8, 9.0), dwell=0.3), to(1.0))
    assert not tm.certify(sooner, solution.trajectory).ok


def test_accelerations_are_zero_at_a_dwell():
    """There and back with a jerk limit: a reversal needs no zero acceleration."""
    limits = tm.MotionLimits(jerk=10.0)
    staying = by_way_of(to(1.0, dwell=0.2), to(0.4), motion_limits=limits)
    solution = certified(staying)
    turning = by_way_of(to(1.0, stop=True), to(0.4), motion_limits=limits)
    assert certified(turning).T < 0.98 * (solution.T - 0.2)


def test_hamiltonian_may_jump_where_a_constraint_ends():
    solution = certified(in_windows(tm.ToolSpeed("tip", 0.3, during=(0.0, 0.8))))
    assert (
        pytest.approx(duration_with_a_slow_beginning(0.3, 0.8), rel=3e-3) == solution.T
    )
    assert "Limits depend on time" in solution.certificate.message
    slower = certified(in_windows(tm.ToolSpeed("tip", 0.1, during=(0.0, 0.8))))
    problem = in_windows(tm.ToolSpeed("tip", 0.3, during=(0.0, 0.8)))
    assert not tm.certify(problem, slower.trajectory).ok


def test_region_may_be_left_at_the_end_of_its_time_window():
    """The arm leaves at the speed that it can brake: no motion is shorter."""
    place = tm.WithinRegion(
        "tip", (-9.0, -9.0, -9.0), (0.3, 9.0, 9.0), during=(0.0, 2.0)
    )
    solution = certified(in_windows(place))
    assert pytest.approx(2.0 + math.sqrt(1.4), rel=3e-3) == solution.T
