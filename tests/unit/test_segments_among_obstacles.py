"""Segments around an obstacle: planned one by one, joined, and improved together."""

from __future__ import annotations

import numpy as np
import pytest

import tominpmp as tm
from tests.clocks import Clock

NEAR = [0.6, -1.2, 1.9, -0.7, 0.3, 0.0]
FAR = [-0.6, -1.2, 1.9, -0.7, 0.3, 0.0]
THERE = tm.Segment(tm.JointGoal(FAR), stop=True)
BACK = tm.Segment(tm.JointGoal(NEAR))
# Motions stay on the first grid, without refinement.
QUICK = {"effort": "quick", "refine": None}
WALL = tm.Box("wall", size=(0.8, 0.03, 0.9), position=(0.7, 0.0, 0.45))


@pytest.fixture(scope="module")
def arm() -> tm.Robot:
    """A UR5 without limits of jerk, whose accelerations may jump."""
    return tm.load_robot("ur5", limits="urdf")


def problem(arm: tm.Robot, *segments: tm.Segment) -> tm.Problem:
    return tm.Problem(arm, NEAR, segments=segments, scene=[WALL], margin=0.01)


@pytest.fixture(scope="module")
def apart(arm: tm.Robot) -> list[tm.Solution]:
    """The motion over the wall and the motion back, each for itself."""
    ends = (NEAR, FAR), (FAR, NEAR)
    plans = [
        tm.plan(tm.Problem(arm, q, tm.JointGoal(goal), [WALL], 0.01), **QUICK)
        for q, goal in ends
    ]
    assert all(plan.success for plan in plans)
    return plans


@pytest.fixture(scope="module")
def alone(apart: list[tm.Solution]) -> float:
    return sum(plan.T for plan in apart)


def planned(task: tm.Problem, **options: object) -> tm.Solution:
    solution = tm.plan(task, **QUICK, **options)
    assert solution.success, solution.message
    assert tm.verify(task, solution.trajectory).ok
    return solution


@pytest.fixture(scope="module")
def both(arm: tm.Robot) -> tuple[tm.Solution, list[float]]:
    """A motion over the wall and back, and the durations of its iterations."""
    durations: list[float] = []

    def see(record: tm.IterationRecord) -> None:
        durations.append(record.duration)

    return planned(problem(arm, THERE, BACK), callback=see), durations


def test_segments_with_a_stop_last_as_long_as_separate_plans(
    both: tuple[tm.Solution, list[float]], apart: list[tm.Solution], alone: float
) -> None:
    solution, _ = both
    assert solution.T == pytest.approx(alone, rel=1e-4)
    # Together they are optimal if each one is: gains are shares of the whole duration.
    optimal = [plan.status is tm.Status.CONVERGED for plan in apart]
    assert solution.status is tm.Status.CONVERGED or not all(optimal)
    gains = [tm.certify(plan.problem, plan.trajectory).stationarity for plan in apart]
    gain = tm.certify(solution.problem, solution.trajectory).stationarity
    mean = np.average(gains, weights=[plan.T for plan in apart])
    assert gain == pytest.approx(mean, rel=0.1)


def test_dwell_adds_its_duration_between_segments(arm: tm.Robot, alone: float) -> None:
    there = tm.Segment(tm.JointGoal(FAR), dwell=0.3)
    solution = planned(problem(arm, there, BACK))
    assert solution.T == pytest.approx(alone + 0.3, rel=1e-4)
    first = solution.segments[0]
    assert first.stay == pytest.approx(0.3, abs=1e-6)
    rest = solution.trajectory(np.linspace(first.arrival, first.end, 20))
    assert np.max(np.abs(rest.v)) < 1e-6


def test_via_point_is_faster_than_a_stop_at_the_same_goal(
    arm: tm.Robot, alone: float
) -> None:
    via = tm.JointGoal([-0.2, -1.9, 0.9, -0.7, 0.3, 0.0])
    stop = [tm.Segment(via, stop=True), tm.Segment(tm.JointGoal(FAR))]
    passing = [tm.Segment(via), tm.Segment(tm.JointGoal(FAR))]
    slow = planned(problem(arm, *stop))
    fast = planned(problem(arm, *passing))
    assert 0.5 * alone < fast.T < 0.995 * slow.T


def test_iteration_records_have_the_duration_of_all_segments(
    both: tuple[tm.Solution, list[float]], alone: float
) -> None:
    solution, durations = both
    assert len(solution.history) > 0
    assert min(durations) > 0.6 * alone


@pytest.mark.parametrize("count", [1, 5])
def test_callback_interrupts_the_plan_of_a_segment(arm: tm.Robot, count: int) -> None:
    seen: list[tm.IterationRecord] = []

    def stop(record: tm.IterationRecord) -> bool:
        seen.append(record)
        return len(seen) >= count

    solution = tm.plan(problem(arm, THERE, BACK), callback=stop)
    assert solution.status is tm.Status.INTERRUPTED
    assert len(seen) == count


@pytest.mark.parametrize("readings", [50.0, 200.0])
def test_planning_time_limit_holds_for_segments(
    arm: tm.Robot, clock: Clock, readings: float
) -> None:
    """The clock advances with each reading; a plan reads it thousands of times."""
    clock.tick = 1.0
    solution = tm.plan(problem(arm, THERE, BACK), max_planning_time=readings, **QUICK)
    assert solution.status is tm.Status.TIME_LIMIT
    assert solution.planning_time <= 1.1 * readings + 10.0
