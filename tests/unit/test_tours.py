"""Tours of small arms: cycle time, bounds, rules, payloads, messages."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import permutations, product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tests.sample_arms as arms
import tominpmp as tm
from tominpmp import stopping
from tominpmp.arrays import Array
from tominpmp.cell.tours.legs import JointTimes, Legs, direct_motion
from tominpmp.cell.tours.lower_bound import tour_bound
from tominpmp.cell.tours.planning import TourSearch
from tominpmp.cell.tours.station import Rules, TourTask, Visit
from tominpmp.cell.tours.tour import _draw_bars
from tominpmp.exceptions import OptionsError, PlanningFailed, ProblemError
from tominpmp.robot.robot import Robot
from tominpmp.verification.verification import verify

HOME = np.array([0.3, 0.9])
LIMITS = tm.MotionLimits(acceleration=6.0)
# Lengths of both links [m].
LENGTH = 1.0


@pytest.fixture(scope="module")
def arm() -> Robot:
    """Two turning joints with a frame at the end, whose torques never limit it."""
    return arms.two_link_arm(LENGTH)


def tip(robot: Robot) -> str:
    return robot.frame_names[-1]


def reached(x: float, y: float) -> list[Array]:
    """Both configurations whose tip is at the point."""
    c = (x * x + y * y - 2.0 * LENGTH**2) / (2.0 * LENGTH**2)
    found = []
    for bend in (np.arccos(c), -np.arccos(c)):
        first = np.arctan2(y, x) - np.arctan2(np.sin(bend), 1.0 + np.cos(bend))
        found.append(np.array([first, bend]))
    return found


POINTS = [(1.2, 0.5), (0.3, 1.4), (-0.6, 1.1), (1.5, -0.6), (0.8, -0.9), (0.5, 0.6)]


@pytest.fixture(scope="module")
def goals(arm: Robot) -> list[tm.PositionGoal]:
    return [tm.PositionGoal(tip(arm), (x, y, 0.0)) for x, y in POINTS]


@pytest.fixture(scope="module")
def tour(arm: Robot, goals: list[tm.PositionGoal]) -> tm.Tour:
    stations = [
        tm.Station(f"p{k}", goal, dwell=0.05 * k) for k, goal in enumerate(goals)
    ]
    return tm.plan_tour(arm, HOME, stations, motion_limits=LIMITS)


def least_cycle(
    robot: Robot, choices: Sequence[Sequence[Array]], back: bool = True
) -> float:
    """The least time of all orders and configurations, by enumeration."""
    times = JointTimes.of(
        tm.Problem(robot, HOME, tm.JointGoal(HOME), motion_limits=LIMITS)
    )
    best = np.inf
    for order in permutations(range(len(choices))):
        for way in product(*(choices[k] for k in order)):
            places = np.stack([HOME, *way, *([HOME] if back else [])])
            best = min(best, float(np.sum(times.between(places[:-1], places[1:]))))
    return best


def test_tour_matches_enumeration_of_orders_and_configurations(
    arm: Robot, tour: tm.Tour
) -> None:
    best = least_cycle(arm, [reached(*point) for point in POINTS])
    dwells = 0.05 * sum(range(len(POINTS)))
    assert tour.success and tour.verified and bool(tour)
    assert tour.cycle_time == pytest.approx(best + dwells, rel=1e-6)
    assert sorted(tour.order) == [f"p{k}" for k in range(len(POINTS))]
    assert tour.direct == len(tour.motions) == len(POINTS) + 1


def test_lower_bound_of_a_tour_is_below_its_cycle_time(
    arm: Robot, tour: tm.Tour
) -> None:
    assert 0.0 < tour.lower_bound <= tour.cycle_time
    assert tour.gap == pytest.approx(tour.cycle_time / tour.lower_bound - 1.0)
    # Between given configurations, the bound is the planned cycle time.
    stations = [tm.JointGoal(reached(*point)[0]) for point in POINTS[:4]]
    found = tm.plan_tour(arm, HOME, stations, motion_limits=LIMITS)
    best = least_cycle(arm, [[goal.q] for goal in stations])
    assert found.cycle_time == pytest.approx(best, rel=1e-9)
    assert found.lower_bound == pytest.approx(best, rel=1e-6)


def test_visits_agree_with_the_trajectory_of_the_cycle(tour: tm.Tour) -> None:
    motion = tour.trajectory
    assert motion is not None
    assert motion.duration == pytest.approx(tour.cycle_time)
    now = 0.0
    for visit in tour.visits:
        k = int(visit.station[1:])
        assert visit.arrival >= now
        assert visit.departure - visit.arrival == pytest.approx(0.05 * k)
        for time in (visit.arrival, visit.departure):
            state = motion(min(time, motion.duration))
            assert np.allclose(state.q, visit.q, atol=1e-9)
            assert np.allclose(state.v, 0.0, atol=1e-7)
        assert min(np.max(np.abs(visit.q - q)) for q in reached(*POINTS[k])) < 1e-5
        now = visit.departure
    assert np.allclose(motion.q[-1], HOME) and np.allclose(motion.q[0], HOME)
    # The legs are joined without jumps: positions are the integral of velocities.
    t = np.linspace(0.0, motion.duration, 20_001)
    state = motion(t)
    steps = 0.5 * (state.v[1:] + state.v[:-1]) * np.diff(t)[:, None]
    assert np.allclose(state.q[-1] - state.q[0], steps.sum(axis=0), atol=1e-4)
    assert np.max(np.abs(state.v)) <= 2.0 + 1e-9
    assert np.max(np.abs(state.a)) <= 6.0 + 1e-9


def test_export_warns_about_violations_between_samples(
    tour: tm.Tour, tmp_path: Path
) -> None:
    tour.export(tmp_path / "nodes.yaml")  # a warning would be an error
    expected = r"on segment \d .*, joint joint1 is .* beyond its acceleration limit"
    with pytest.warns(tm.TominpmpWarning, match=expected):
        tour.export(tmp_path / "samples.yaml", dt=0.1)


def test_cycle_is_exported_played_and_plotted(tour: tm.Tour, tmp_path: Path) -> None:
    motion = tour.trajectory
    assert motion is not None
    read = tm.load_motion(tour.export(tmp_path / "tour.csv", dt=0.01))
    assert read.t[-1] == pytest.approx(tour.cycle_time)
    assert np.allclose(read.q, motion(read.t).q)
    assert tour.play(tmp_path / "tour.html").stat().st_size > 1000
    pytest.importorskip("matplotlib")
    figure = tour.plot(tmp_path / "tour.png")
    assert (tmp_path / "tour.png").stat().st_size > 1000
    legend = [text.get_text() for text in figure.legends[0].get_texts()]
    assert legend[:2] == ["motion", "dwell"]
    assert "p3" in tour.table() and "6 stations" in repr(tour)


def test_long_station_names_are_shortened_in_the_figure() -> None:
    pytest.importorskip("matplotlib")
    from matplotlib.figure import Figure

    panel = Figure().subplots()
    name = "the station at the far end of the cell, behind the door"
    _draw_bars(panel, 1.0, [Visit(name, np.zeros(3), 0.4, 1.0)])
    labels = [text.get_text() for text in panel.get_yticklabels()]
    assert labels == ["the station at the far end of the cel..."]


def test_a_station_that_is_passed_has_no_bar_of_a_dwell() -> None:
    """Regression: the figure had a sliver in the colour of dwells."""
    pytest.importorskip("matplotlib")
    from matplotlib.figure import Figure

    panel = Figure().subplots()
    _draw_bars(panel, 1.0, [Visit("passed", np.zeros(3), 0.4, 0.4)])
    motion, dwell, home = (bar.get_width() for bar in panel.patches)
    assert (motion, dwell, home) == pytest.approx((0.4, 0.0, 0.6))


def test_tour_may_end_at_its_last_station_and_keeps_precedence(
    arm: Robot, goals: list[tm.PositionGoal]
) -> None:
    names = dict(zip("abcd", goals[:4], strict=True))
    free = tm.plan_tour(arm, HOME, names, q_end=None, motion_limits=LIMITS)
    best = least_cycle(arm, [reached(*point) for point in POINTS[:4]], back=False)
    assert free.cycle_time == pytest.approx(best, rel=1e-6)
    assert len(free.motions) == 4
    turned = [(free.order[k + 1], free.order[k]) for k in range(3)]
    bound = tm.plan_tour(
        arm, HOME, names, q_end=None, motion_limits=LIMITS, precedence=turned
    )
    assert bound.order == free.order[::-1]
    assert bound.cycle_time >= free.cycle_time
    assert bound.lower_bound <= bound.cycle_time


def test_then_of_a_station_restricts_the_next_station(
    arm: Robot, goals: list[tm.PositionGoal]
) -> None:
    load = tm.Payload(5.0, tip(arm), name="part")
    stations = [
        tm.Station("pick a", goals[0], then=("place a", "place b"), payload=load),
        tm.Station("pick b", goals[1], then=("place a", "place b"), payload=load),
        tm.Station("place a", goals[2]),
        tm.Station("place b", goals[3]),
    ]
    found = tm.plan_tour(arm, HOME, stations, motion_limits=LIMITS)
    first = [name.split()[0] for name in found.order]
    assert first == ["pick", "place", "pick", "place"]
    loads = [len(motion.problem.robot.payloads) for motion in found.motions]
    assert loads == [0, 1, 0, 1, 0]
    # Pages show the payload of each segment.
    carried = [segment.payload for segment in found._solution().problem.segments]
    assert carried == [None, load, None, load, None]
    motion = found.trajectory
    assert motion is not None
    # Torques of the whole cycle include the payload while it is carried.
    for visit in found.visits:
        if visit.station.startswith("pick"):
            time = visit.departure + 1e-3
            state = motion(time)
            bare = tm.Trajectory(
                motion.joint_names,
                motion.t,
                motion.q,
                motion.v,
                motion.u,
                a=motion.a,
                inverse_dynamics=found.motions[0].trajectory.inverse_dynamics,
            )(time)
            assert np.max(np.abs(state.u)) > 1.2 * np.max(np.abs(bare.u))


def test_station_without_a_stop_takes_less_time(arm: Robot) -> None:
    way = [tm.JointGoal([0.7, 0.6])]
    few = {"intervals": 6, "refine": None, "starts": 1, "max_iterations": 12}
    cycle = {}
    for stop in (True, False):
        stations = [tm.Station(f"s{k}", goal, stop=stop) for k, goal in enumerate(way)]
        found = tm.plan_tour(
            arm, HOME, stations, q_end=[1.1, 0.2], motion_limits=LIMITS, **few
        )
        assert found.verified
        assert found.lower_bound <= found.cycle_time * (1.0 + 1e-3)
        cycle[stop] = found.cycle_time
    assert cycle[False] < 0.9 * cycle[True]
    times = [visit.arrival for visit in found.visits]
    assert len(found.motions) == 1 and 0.0 < times[0] < found.cycle_time


def test_payload_may_touch_at_a_station_without_a_stop() -> None:
    """Regression: the arm stopped there, as its payload was named on the leg to the
    station, where it does not exist yet.
    """
    robot = tm.load_robot("planar3r", gravity=(0, 0, 0))
    part = tm.Box("part", size=(0.05, 0.05, 0.05))
    load = tm.Payload(0.1, "tip", geometry=[part], name="part")
    goal, touch = tm.JointGoal([0.8, 1.4, -1.6]), [("part", "table")]
    station = tm.Station("s", goal, stop=False, payload=load, may_touch=touch)
    few = {"intervals": 6, "refine": None, "starts": 1, "max_iterations": 12}
    found = tm.plan_tour(
        robot,
        [0.5, 1.7, -1.7],
        [station],
        q_end=[1.1, 1.0, -1.4],
        scene=tm.Scene([tm.Box("table", size=(1, 1, 0.1), position=(9, 9, 0))]),
        motion_limits=LIMITS,
        **few,
    )
    assert found.verified and len(found.motions) == 1


def test_direct_motion_matches_the_lower_bound(arm: Robot) -> None:
    rng = np.random.default_rng(1)
    for _ in range(5):
        q = rng.uniform(-2.0, 2.0, 2)
        problem = tm.Problem(arm, HOME, tm.JointGoal(q), motion_limits=LIMITS)
        motion = direct_motion(problem)
        assert motion is not None
        assert motion.duration == pytest.approx(tm.lower_bound(problem).T, rel=1e-6)
        assert verify(problem, motion).ok
    still = tm.Problem(arm, HOME, tm.JointGoal(HOME), motion_limits=LIMITS)
    free = tm.Problem(arm, HOME, tm.JointGoal(q))
    jerky = tm.MotionLimits(acceleration=6.0, jerk=50.0)
    smooth = tm.Problem(arm, HOME, tm.JointGoal(q), motion_limits=jerky)
    assert [direct_motion(p) for p in (still, free, smooth)] == [None] * 3


def test_bound_for_goals_on_frames_is_below_enumeration(arm: Robot) -> None:
    rng = np.random.default_rng(5)
    problem = tm.Problem(arm, HOME, tm.JointGoal(HOME), motion_limits=LIMITS)
    for _ in range(8):
        points = rng.uniform(-1.2, 1.2, (3, 2))
        stations = tuple(
            tm.Station(str(k), tm.PositionGoal(tip(arm), (*p, 0.0)))
            for k, p in enumerate(points)
        )
        bound = tour_bound(TourTask(problem, stations, Rules.of(stations))).T
        assert 0.0 < bound <= least_cycle(arm, [reached(*p) for p in points])


def test_message_about_a_wrong_tour_names_the_station_or_field(
    arm: Robot, goals: list[tm.PositionGoal]
) -> None:
    frame = tip(arm)
    far = tm.PositionGoal(frame, (5.0, 0.0, 0.0))
    above = tm.PositionGoal(frame, (1.0, 0.0, 0.5))
    with pytest.raises(ProblemError, match=r"'b'.*outside reach"):
        tm.plan_tour(arm, HOME, {"a": goals[0], "b": far})
    with pytest.raises(ProblemError, match=r"2 \('up'\) cannot be reached: no conf"):
        tm.plan_tour(arm, HOME, {"a": goals[0], "up": above})
    with pytest.raises(ProblemError, match=r"\('a'\) and .* \('b'\) are in one"):
        tm.plan_tour(arm, HOME, {"a": goals[0], "b": goals[0]})
    with pytest.raises(ProblemError, match="has a cycle"):
        pairs = [("a", "b"), ("b", "a")]
        tm.plan_tour(arm, HOME, {"a": goals[0], "b": goals[1]}, precedence=pairs)
    with pytest.raises(tm.FrameNotFound):
        tm.plan_tour(arm, HOME, [tm.PositionGoal("nothing", (1, 0, 0))])
    with pytest.raises(ProblemError, match="q_end"):
        tm.plan_tour(arm, HOME, goals, q_end="home")
    with pytest.raises(ProblemError, match="q_end"):
        tm.plan_tour(arm, HOME, goals, q_end=[0.0])
    with pytest.raises(ProblemError, match="q_start"):
        tm.plan_tour(arm, [0.0], goals)
    with pytest.raises(OptionsError, match="configurations"):
        tm.plan_tour(arm, HOME, goals, configurations=0)
    moving = tm.Sphere(
        "ball", radius=0.1, position=(9, 0, 0), motion=tm.ConstantVelocity((1, 0, 0))
    )
    scenes: list[Any] = [tm.Scene([moving]), [moving], moving]
    for scene in scenes:
        with pytest.raises(ProblemError, match="moves"):
            tm.plan_tour(
                tm.load_robot("planar3r"),
                [0.5, 1.2, -0.7],
                [tm.JointGoal(np.ones(3))],
                scene=scene,
            )


def test_two_stations_at_one_place_keep_their_order(
    arm: Robot, goals: list[tm.PositionGoal]
) -> None:
    stations = [
        tm.Station("tap", goals[0], after="drill"),
        tm.Station("drill", goals[0], dwell=0.1),
        tm.Station("look", goals[1]),
    ]
    found = tm.plan_tour(arm, HOME, stations, motion_limits=LIMITS)
    assert found.success and found.order.index("drill") < found.order.index("tap")


def test_tour_without_time_has_a_status_and_a_message(
    arm: Robot, goals: list[tm.PositionGoal]
) -> None:
    found = tm.plan_tour(arm, HOME, goals, motion_limits=LIMITS, max_planning_time=1e-4)
    assert not found.success and found.status is tm.Status.TIME_LIMIT
    assert "No tour" in found.message and found.cycle_time == np.inf
    assert found.gap is None and found.trajectory is None
    with pytest.raises(PlanningFailed, match="No tour"):
        found.raise_if_failed()
    with pytest.raises(ProblemError, match="no tour"):
        found.export("tour.csv")


def test_tour_found_at_the_time_limit_is_returned(
    arm: Robot, goals: list[tm.PositionGoal], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Regression: the tour was thrown away, as no time was left for its bound."""
    usual = TourSearch.run

    def run(search: TourSearch) -> tm.Tour:
        found = usual(search)
        assert stopping.request()
        return found

    monkeypatch.setattr(TourSearch, "run", run)
    found = tm.plan_tour(arm, HOME, goals[:2], motion_limits=LIMITS)
    assert found.success and found.lower_bound == 0.0 and found.gap is None


def test_station_at_the_current_configuration_is_visited(
    arm: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Regression: the station was left out if stations without a stop had to become
    stops.
    """
    usual = Legs.motion

    def stopping_everywhere(legs: Legs, nodes: Sequence[int], q: Any) -> Any:
        return usual(legs, nodes, q) if len(nodes) == 2 else None

    monkeypatch.setattr(Legs, "motion", stopping_everywhere)
    goal = tm.JointGoal([0.7, 0.6])
    stations = [
        tm.Station("one", goal, stop=False),
        tm.Station("other", goal, stop=False, after="one"),
    ]
    found = tm.plan_tour(arm, HOME, stations, motion_limits=LIMITS)
    assert found.order == ("one", "other") and len(found.motions) == 2
    assert found.visits[0].departure == found.visits[1].arrival


def test_tour_with_a_control_period_is_on_its_ticks(arm: Robot) -> None:
    """Direct motions, of which the fastest tour would consist, are not on ticks."""
    stations = [
        tm.Station("works", tm.JointGoal([1.0, 0.4]), dwell=0.011),
        tm.Station("passes", tm.JointGoal([0.7, 1.2]), stop=False),
        tm.Station("again", tm.JointGoal([1.2, 1.4]), dwell=0.03),
    ]
    tour = tm.plan_tour(
        arm, HOME, stations, motion_limits=LIMITS, control_period=0.01, intervals=16
    )
    assert tour.success, tour.message
    for times in (tour.trajectory.t, [visit.arrival for visit in tour.visits]):
        ticks = np.asarray(times) / 0.01
        np.testing.assert_allclose(ticks, np.rint(ticks), atol=1e-9)
    dwells = {visit.station: visit.departure - visit.arrival for visit in tour.visits}
    expected = {"works": 0.02, "passes": 0.0, "again": 0.03}
    assert dwells == {name: pytest.approx(stay) for name, stay in expected.items()}
