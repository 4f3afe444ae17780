"""Several segments with a control period: knots on ticks, dwells of whole periods."""

from __future__ import annotations

import numpy as np
import pytest

import tominpmp as tm
from tests.sample_arms import make_arm, slide

PERIOD = 0.01
FEW = {"intervals": 24, "effort": "quick", "refine": None}
QUICK = {"control_period": PERIOD, **FEW}


@pytest.mark.parametrize("control", ["constant", "linear"])
def test_segments_end_on_ticks_of_the_control_period(tmp_path, control):
    robot = make_arm(slide(2.0), effort=10.0)
    limits = None
    if control == "linear":
        limits = tm.MotionLimits(acceleration=4.0, jerk=80.0)
    segments = [
        tm.Segment(tm.JointGoal([0.4])),
        tm.Segment(tm.JointGoal([0.6]), dwell=0.123),
        tm.Segment(tm.JointGoal([1.0]), payload=tm.Payload(1.0, "tip")),
    ]
    problem = tm.Problem(robot, [0.0], segments=segments, motion_limits=limits)
    free = tm.plan(problem, control=control, **FEW)
    solution = tm.plan(problem, control=control, **QUICK)
    assert solution.success, solution.message
    motion = solution.trajectory
    for times in (motion.t, motion.segment_ends):
        ticks = times / PERIOD
        np.testing.assert_allclose(ticks, np.rint(ticks), atol=1e-9)
    # Rounding takes a tick per segment and one for the dwell; coarser knots take 3 %.
    assert free.success, free.message
    assert free.T - 1e-6 <= solution.T <= free.T * 1.03 + 4 * PERIOD
    stay = solution.segments[1]
    during = motion(np.linspace(stay.arrival, stay.end, 20))
    np.testing.assert_allclose(during.q, 0.6, atol=1e-6)
    np.testing.assert_allclose(during.v, 0.0, atol=1e-6)
    path = solution.export(tmp_path / "motion.csv", dt=PERIOD)
    assert tm.verify(problem, tm.load_motion(path)).ok
    assert tm.check_file(problem, path).ok


def rail(*segments: tm.Segment, **more) -> tm.Problem:
    arm = make_arm(slide(1.0), effort=np.array([1.0]))
    return tm.Problem(arm, [0.0], segments=segments, **more)


def to(q: float, **more) -> tm.Segment:
    return tm.Segment(tm.JointGoal([q]), **more)


def ticks(solution: tm.Solution) -> list[tuple[int, int, int]]:
    """Begin, arrival and end of each segment in control periods, all of them whole."""
    found = [(part.begin, part.arrival, part.end) for part in solution.segments]
    counts = np.rint(np.array(found) / PERIOD)
    np.testing.assert_allclose(found, counts * PERIOD, rtol=0.0, atol=1e-12)
    return [tuple(row) for row in counts.astype(int).tolist()]


def check_dwells(solution: tm.Solution) -> None:
    """The arm is at rest at the goals of its dwells, from the stated arrivals on."""
    for part, segment in zip(solution.segments, solution.problem.segments, strict=True):
        if not segment.dwell:
            assert part.arrival == part.end
            continue
        assert segment.dwell - 1e-9 <= part.stay < segment.dwell + PERIOD - 1e-9
        during = solution.trajectory(np.linspace(part.arrival, part.end, 20)[:-1])
        np.testing.assert_allclose(during.q, segment.goal.q[0], atol=1e-6)
        np.testing.assert_allclose(during.v, 0.0, atol=1e-6)
        before = solution.trajectory(part.arrival - 0.5 * PERIOD)
        assert np.any(np.abs(before.v) > 1e-6)


LIMITS = {"torques": None, "jerk": tm.MotionLimits(acceleration=4.0, jerk=80.0)}


@pytest.mark.parametrize("limits", LIMITS)
@pytest.mark.parametrize("dwell", [0.0001, 0.011, 3 * PERIOD])
def test_arrival_is_where_the_dwell_of_whole_periods_begins(dwell, limits):
    problem = rail(to(0.4, dwell=dwell), to(0.8), motion_limits=LIMITS[limits])
    solution = tm.plan(problem, **QUICK)
    assert solution.success, solution.message
    (_, arrival, end), (begin, *_) = ticks(solution)
    assert end - arrival == {0.0001: 1, 0.011: 2, 3 * PERIOD: 3}[dwell]
    assert begin == end
    check_dwells(solution)


@pytest.mark.parametrize("limits", LIMITS)
def test_arrival_on_a_tick_is_within_its_time_window(limits):
    """Two ticks of ten milliseconds are within the window, and the dwell follows it."""
    late = to(0.4, dwell=0.0111, arrival=(2.0, 2.012))
    for segments in ((late,), (late, to(0.8))):
        problem = rail(*segments, motion_limits=LIMITS[limits])
        solution = tm.plan(problem, **QUICK)
        assert solution.success, solution.message
        assert ticks(solution)[0][1] in (200, 201)
        check_dwells(solution)


def test_time_windows_of_several_segments_with_one_tick_each_are_met():
    """Without a control period, the first goal is met between two ticks, one of which
    is too late.
    """
    problem = rail(
        to(0.4, dwell=0.001, arrival=(1.5, 1.505)),
        to(0.8, dwell=0.011, arrival=(3.0, 3.002)),
    )
    solution = tm.plan(problem, **QUICK)
    assert solution.success, solution.message
    assert ticks(solution) == [(0, 150, 151), (151, 300, 302)]
    check_dwells(solution)


def test_time_window_between_two_ticks_has_no_motion():
    between = to(0.4, arrival=(2.0021, 2.0079))
    for number, parts in enumerate([[between], [to(0.2), between, to(0.8)]], 1):
        solution = tm.plan(rail(*parts), **QUICK)
        assert not solution.success and not solution.history
        said = f"of segment {number}, 2.0021 to 2.0079 s, holds no multiple of the con"
        assert said in solution.message


@pytest.mark.parametrize("dwell", [0.0, 0.1])
def test_more_periods_are_tried_if_every_tick_is_a_knot(dwell):
    """The motions need 1 % more periods than their duration has, and no interval can be
    halved.
    """
    robot = tm.load_robot("planar3r", gravity=(0.0, 0.0, 0.0))
    segments = [
        tm.Segment(tm.JointGoal([2.0, -1.0, 0.5]), stop=True, dwell=dwell),
        tm.Segment(tm.JointGoal([1.0, 1.0, -0.5])),
    ]
    problem = tm.Problem(robot, [0.5, 1.7, -1.7], segments=segments)
    options = {"effort": "quick", "refine": None, "intervals": 120}
    solution = tm.plan(problem, **options, control_period=0.04)
    assert solution.success, solution.message
    assert solution.T < 2.85 + dwell


def test_dwells_of_different_durations_follow_each_other(tmp_path):
    problem = rail(
        to(0.4, dwell=0.0001), to(0.5, stop=True), to(0.8, dwell=0.03), to(0.9, dwell=2)
    )
    solution = tm.plan(problem, **QUICK)
    assert solution.success, solution.message
    found = ticks(solution)
    assert [end - arrival for _, arrival, end in found] == [1, 0, 3, 200]
    check_dwells(solution)
    free = tm.plan(problem, **FEW)
    # Rounding takes less than a period for each motion and for each dwell.
    assert solution.T < free.T + 8 * PERIOD
    assert solution.certificate.message


@pytest.fixture(scope="module")
def timely() -> tm.Solution:
    window = (2.0, 2.012)
    problem = rail(to(0.4, dwell=0.0111, arrival=window), to(0.8, dwell=0.015))
    return tm.plan(problem, **QUICK)


@pytest.mark.parametrize(
    ("ending", "dt"),
    [("csv", None), ("csv", 0.005), ("npz", None), ("yaml", None), ("mcap", None)],
)
def test_files_hold_arrivals_and_ends_of_dwells(timely, ending, dt, tmp_path):
    path = timely.export(tmp_path / f"motion.{ending}", dt=dt)
    samples = tm.load_motion(path)
    check = tm.check_file(timely.problem, path)
    assert check.ok, check.message
    if ending in ("csv", "npz"):
        ends = timely.trajectory.segment_ends
        np.testing.assert_allclose(samples.segment_ends, ends, atol=1e-12)
    # The replay rejects it for a later time window and for a longer dwell.
    late = rail(to(0.4, dwell=0.0111, arrival=(2.05, 2.06)), to(0.8, dwell=0.015))
    assert "too early" in tm.verify(late, samples).message
    window = timely.problem.segments[0].arrival
    longer = rail(to(0.4, dwell=0.05, arrival=window), to(0.8, dwell=0.015))
    assert not tm.verify(longer, samples).ok


def test_file_meets_a_time_window_within_rounding(tmp_path):
    """With limits of jerk, the motion ends at a tiny distance from the goal before the
    time window begins.
    """
    limits = tm.MotionLimits(acceleration=4.0, jerk=80.0)
    problem = rail(
        to(0.4, dwell=0.001, arrival=(1.5, 1.505)), to(0.8), motion_limits=limits
    )
    solution = tm.plan(problem, **{**QUICK, "refine": "auto"})
    assert solution.success, solution.message
    path = solution.export(tmp_path / "motion.yaml")
    check = tm.check_file(problem, path)
    assert check.ok, check.message


def test_via_points_take_at_least_a_period():
    """The goals are twenty millimetres apart, two periods at a metre a second."""
    goals = [to(0.5 + 0.02 * k) for k in range(5)]
    problem = rail(*goals, to(1.2))
    free = tm.plan(problem, **FEW)
    solution = tm.plan(problem, **QUICK)
    assert solution.success, solution.message
    assert all(end - begin < 4 for begin, _, end in ticks(solution)[1:-1])
    assert solution.T < free.T + 6 * PERIOD


def test_report_has_the_dwell_rounded_up_to_periods(tmp_path):
    from tominpmp.cli.report import report_data, report_text

    solution = tm.plan(rail(to(0.4, dwell=0.011), to(0.8)), **QUICK)
    data = report_data(solution, {})
    first = data["segments"][0]
    assert first["dwell"] == 0.011
    assert first["stay"] == pytest.approx(0.02)
    text = report_text(data)
    assert f"arrives at {first['arrival']:.4f} s, stays 0.02 s" in text


def test_rounding_to_periods_is_spread_over_many_via_points():
    """Regression: rounding gave each further period to one segment, and its neighbours
    were too fast.
    """
    robot = make_arm(slide(1.0), effort=100.0)
    segments = [to(0.1 * k) for k in range(1, 9)]
    limits = tm.MotionLimits(acceleration=5.0)
    problem = tm.Problem(robot, [0.0], segments=segments, motion_limits=limits)
    solution = tm.plan(problem, effort="quick", control_period=0.008)
    assert solution.success, solution.message
    assert solution.T < 1.15 * 2.0 * np.sqrt(0.8 / 5.0)
