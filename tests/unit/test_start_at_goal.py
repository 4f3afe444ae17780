"""Problems whose start satisfies the goal, or nearly does.

In the first case the motion has no duration; motions of a millionth of a radian are
planned like others.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tominpmp as tm
from tominpmp.kinematics import RobotKinematics
from tominpmp.planner import candidate

START = np.array([0.5, 1.7, -1.7])
AWAY = START + np.array([0.5, -0.3, 0.2])
LIMITS = tm.MotionLimits(acceleration=14.0, jerk=900.0)
PERIOD = 0.004
VELOCITY = [0.1, 0.2, 0.3]
FEW = {"effort": "quick", "intervals": 16, "refine": None}


def tip() -> np.ndarray:
    placement = RobotKinematics(tm.load_robot("planar3r")).placement(START, "tip")
    return np.asarray(placement.translation)


def from_start(goal: tm.Goal, **more: Any) -> tm.Problem:
    return tm.Problem(tm.load_robot("planar3r"), START, goal, **more)


def through(*segments: tm.Segment, **more: Any) -> tm.Problem:
    return tm.Problem(tm.load_robot("planar3r"), START, segments=segments, **more)


def stays_for(seconds: float, **more: Any) -> tm.Segment:
    return tm.Segment(tm.JointGoal(START), dwell=seconds, **more)


def passing(distance: float) -> tm.Obstacle:
    """A ball that comes by below the arm."""
    motion = tm.ConstantVelocity(velocity=(-1.0, 0.0, 0.0))
    return tm.Sphere("ball", radius=0.2, position=(distance, -3.0, 0.0), motion=motion)


GOALS: dict[str, Callable[[], tm.Problem]] = {
    "joints": lambda: from_start(tm.JointGoal(START)),
    "joints nearly": lambda: from_start(tm.JointGoal(START + 9e-7)),
    "position": lambda: from_start(tm.PositionGoal("tip", tip())),
    "position nearby": lambda: from_start(
        tm.PositionGoal("tip", tip() + 0.01, tolerance=0.05)
    ),
    "region": lambda: from_start(tm.JointRegionGoal(START + 0.05, tolerance=0.1)),
    "any": lambda: from_start(
        tm.AnyGoal([tm.JointGoal(AWAY), tm.JointGoal(START), tm.JointGoal(START + 0.3)])
    ),
    "all": lambda: from_start(tm.AllGoals([tm.PositionGoal("tip", tip())])),
    "moving ends": lambda: from_start(
        tm.JointGoal(START, v=VELOCITY), v_start=VELOCITY
    ),
    "limits": lambda: from_start(tm.JointGoal(START), motion_limits=LIMITS),
    "constraint": lambda: from_start(
        tm.JointGoal(START), constraints=[tm.ToolSpeed("tip", 0.5)]
    ),
    "moving obstacle": lambda: from_start(tm.JointGoal(START), scene=[passing(5.0)]),
    "two goals": lambda: through(*[tm.Segment(tm.JointGoal(START))] * 2),
    "no motor": lambda: tm.Problem(
        tm.load_robot("planar3r", effort=[50.0, 50.0, 0.0], gravity=(0, 0, 0)),
        START,
        tm.JointRegionGoal(START, tolerance=0.1),
    ),
}


@pytest.mark.parametrize("name", GOALS)
def test_lower_bound_is_zero_if_the_start_satisfies_the_goal(name: str) -> None:
    bound = tm.lower_bound(GOALS[name]())
    assert bound.T < 1e-6 and "goal of this kind" not in bound.reason


@pytest.mark.parametrize("name", GOALS)
def test_motion_has_no_duration_if_the_start_satisfies_the_goal(name: str) -> None:
    problem = GOALS[name]()
    solution = tm.plan(problem)
    assert solution.T == 0.0
    assert solution.status is tm.Status.CONVERGED
    assert solution.verification is not None
    assert solution.verification.ok
    assert "The start already satisfies the goal" in solution.message
    assert solution.trajectory.t.tolist() == [0.0]
    assert solution.planning_time < 1.0
    assert tm.verify(problem, solution.trajectory).ok
    if not solution.problem.robot.passive_joints:
        assert tm.plan(problem, control_period=PERIOD).T == 0.0


def test_goal_at_the_tolerance_within_rounding_is_satisfied() -> None:
    arm = tm.load_robot("planar3r")
    start = np.array([0.8, 1.7, -1.7])  # 0.8 + 1e-6 is more than 1e-6 away
    problem = tm.Problem(arm, start, tm.JointGoal(start + 1e-6))
    assert tm.plan(problem).T == 0.0


@pytest.mark.parametrize("refine", ["switching", "grid", None])
def test_motion_of_no_duration_needs_no_refinement(refine: str | None) -> None:
    solution = tm.plan(GOALS["position nearby"](), refine=refine)
    assert solution.success
    assert solution.T == 0.0


@pytest.mark.parametrize(
    "problem",
    [
        from_start(tm.JointGoal(START, v=VELOCITY)),
        from_start(tm.JointGoal(START), v_start=VELOCITY),
        from_start(tm.JointGoal(START + 1.1e-6)),
        from_start(tm.JointRegionGoal(START + 0.1, tolerance=0.1 - 2e-6)),
    ],
    ids=["goal moves", "start moves", "apart", "outside"],
)
def test_start_beyond_the_tolerance_of_the_goal_needs_a_motion(
    problem: tm.Problem,
) -> None:
    solution = tm.plan(problem, **FEW)
    assert solution.success, solution.message
    assert solution.T > 1e-6
    assert "already" not in solution.message


def test_option_feasibility_decides_whether_the_start_satisfies_the_goal() -> None:
    problem = from_start(tm.JointGoal(START + 1e-4))
    assert tm.plan(problem, **FEW).T > 0.0
    assert tm.plan(problem, feasibility=2e-4).T == 0.0
    # The goal tolerance of the replay is an upper limit.
    tight = tm.plan(problem, feasibility=2e-4, goal_tolerance=5e-5, **FEW)
    assert tight.T > 0.0


def test_start_that_violates_a_constraint_is_rejected() -> None:
    box = tm.Box("box", size=(0.4, 0.4, 0.4), position=tuple(tip()))
    with pytest.raises(tm.ProblemError, match="start in collision"):
        from_start(tm.JointGoal(START), scene=[box])
    with pytest.raises(tm.ProblemError, match="start"):
        from_start(
            tm.JointGoal(START, v=VELOCITY),
            v_start=VELOCITY,
            constraints=[tm.ToolSpeed("tip", 0.01)],
        )


@pytest.mark.parametrize("ending", ["csv", "npz", "yaml", "json", "mcap"])
@pytest.mark.parametrize("name", ["joints", "moving ends", "two goals"])
@pytest.mark.parametrize("dt", [None, 0.01])
def test_file_of_a_motion_of_no_duration_has_one_row(
    name: str, ending: str, dt: float | None, tmp_path: Path
) -> None:
    problem = GOALS[name]()
    solution = tm.plan(problem)
    path = solution.export(tmp_path / f"motion.{ending}", dt=dt)
    samples = tm.load_motion(path)
    assert samples.t.tolist() == [0.0]
    np.testing.assert_array_equal(samples.q, solution.trajectory.q)
    np.testing.assert_array_equal(samples.v, solution.trajectory.v)
    assert tm.verify(problem, samples).ok
    check = tm.check_file(problem, path)
    assert check.ok, check.message
    assert check.duration == 0.0
    assert not tm.check_file(from_start(tm.JointGoal(AWAY)), path).ok
    if problem.segments and ending in ("csv", "npz"):
        assert samples.segment_ends is not None
        assert samples.segment_ends.tolist() == [0.0, 0.0]


@pytest.mark.parametrize("name", ["joints", "moving ends", "limits", "two goals"])
def test_every_attribute_works_for_a_motion_of_no_duration(
    name: str, tmp_path: Path
) -> None:
    solution = tm.plan(GOALS[name]())
    assert solution.certificate.ok, solution.certificate.message
    assert len(solution.sensitivities) == 0
    assert solution.lower_bound.T == 0.0
    assert solution.gap is None
    assert solution.energy == solution.cost == solution.roughness == 0.0
    assert solution.peak_acceleration.value == 0.0
    spans = [(part.begin, part.arrival, part.end) for part in solution.segments]
    assert spans == [(0.0, 0.0, 0.0)] * max(1, len(solution.problem.segments))
    assert solution.prove_clearance().proved
    for write in (solution.plot, solution.plot_certificate, solution.play):
        path = tmp_path / ("page.html" if write == solution.play else "picture.png")
        write(path)
        assert path.stat().st_size > 0
    assert "T = 0 s" in repr(solution)
    assert "T = 0 s" in solution._repr_html_() + solution.message
    assert tm.certify(solution.problem, solution.trajectory).ok


def test_motion_of_no_duration_is_smoothed_and_warm_starts_a_plan() -> None:
    stands = tm.plan(GOALS["joints"]())
    quiet = tm.smooth(stands, 0.05)
    assert quiet.T == 0.0
    assert quiet.success
    assert tm.plan(stands.problem, slack=0.05).T == 0.0
    onwards = from_start(tm.JointGoal(AWAY))
    fresh = tm.plan(onwards, **FEW)
    for start in (stands, stands.trajectory, stands.trajectory.sample(0.01)):
        solution = tm.plan(onwards, start=start, **FEW)
        assert pytest.approx(fresh.T) == solution.T
    # The other way round, a former motion changes nothing.
    assert tm.plan(stands.problem, start=fresh).T == 0.0
    other = tm.Trajectory(("a",), [0.0], [[0.0]], [[0.0]], [[0.0]])
    with pytest.raises(tm.ProblemError, match="expected a motion of joint1"):
        tm.plan(onwards, start=other)


SEGMENTS: dict[str, tuple[Callable[[], tm.Problem], list[float]]] = {
    "stays": (lambda: through(stays_for(0.1), stays_for(0.05)), [0.1, 0.15]),
    "load": (
        lambda: through(
            tm.Segment(tm.JointGoal(START)),
            stays_for(0.1, payload=tm.Payload(0.2, "tip")),
            tm.Segment(tm.JointGoal(START)),
        ),
        [0.0, 0.1, 0.1],
    ),
    "waits": (
        lambda: through(
            stays_for(0.011, arrival=(0.1005, 1.0)), tm.Segment(tm.JointGoal(START))
        ),
        [0.1115, 0.1115],
    ),
    "moving obstacle": (
        lambda: through(stays_for(0.1), scene=[passing(5.0)]),
        [0.1],
    ),
}


@pytest.mark.parametrize("name", SEGMENTS)
def test_segments_at_the_start_last_exactly_as_long_as_required(
    name: str, tmp_path: Path
) -> None:
    make, ends = SEGMENTS[name]
    problem = make()
    solution = tm.plan(problem)
    assert solution.status is tm.Status.CONVERGED
    assert solution.verification.ok
    assert solution.planning_time < 1.0
    np.testing.assert_allclose(solution.trajectory.segment_ends, ends, atol=1e-12)
    assert solution.lower_bound.T == solution.T
    assert solution.certificate.ok, solution.certificate.message
    for file in ("motion.csv", "motion.npz"):
        samples = tm.load_motion(solution.export(tmp_path / file))
        np.testing.assert_allclose(samples.segment_ends, ends, atol=1e-12)
        assert tm.verify(problem, samples).ok


def test_segments_at_the_start_are_rounded_up_to_control_periods() -> None:
    problem = SEGMENTS["waits"][0]()
    solution = tm.plan(problem, control_period=0.01)
    first = solution.segments[0]
    assert (first.arrival, first.end, solution.T) == (0.11, 0.13, 0.13)


def test_arm_leaves_its_goal_to_avoid_a_moving_obstacle() -> None:
    """The obstacle would hit an arm that stays at the goal."""
    there = tuple(tip() + np.array([1.0, 0.0, 0.0]))
    motion = tm.ConstantVelocity(velocity=(-2.0, 0.0, 0.0))
    ball = tm.Sphere("ball", radius=0.1, position=there, motion=motion)
    problem = through(stays_for(1.0), scene=[ball])
    solution = tm.plan(problem, effort="quick", intervals=24, refine=None)
    assert solution.success, solution.message
    assert solution.T > 1.2


@pytest.mark.parametrize("period", [None, PERIOD])
@pytest.mark.parametrize("dwell", [0.0, 0.05])
def test_goal_at_the_start_or_repeated_goal_costs_little_time(
    period: float | None, dwell: float
) -> None:
    """A stop takes four control periods; a via point takes one."""
    there, home = tm.JointGoal(AWAY), tm.JointGoal(START)
    plain = tm.plan(through(tm.Segment(there)), control_period=period, **FEW)
    most = plain.T + (0.0 if period is None else (5 if dwell else 2) * period)
    for first, second in ((home, there), (there, there)):
        problem = through(tm.Segment(first, dwell=dwell), tm.Segment(second))
        solution = tm.plan(problem, control_period=period, **FEW)
        assert solution.success, solution.message
        assert solution.T <= 1.02 * most + (0.0 if period is None else period) + dwell


def test_one_arm_of_two_may_stay_at_its_goal() -> None:
    arm = tm.load_robot("planar3r")
    cell = tm.Workcell({"left": (arm, (0.0, 0.0, 0.0)), "right": (arm, (0, 9.0, 0))})
    start = {"left": START, "right": START}

    def plan(left: np.ndarray, right: np.ndarray, **options: Any) -> tm.Solution:
        goal = {"left": tm.JointGoal(left), "right": tm.JointGoal(right)}
        return tm.plan(cell.problem(start=start, goal=goal), **options)

    assert plan(START, START).T == 0.0
    alone = tm.plan(from_start(tm.JointGoal(AWAY)), **FEW)
    one = plan(START, AWAY, **FEW)
    assert one.success, one.message
    assert one.T == pytest.approx(alone.T, rel=0.02)
    stays = cell.split(one.trajectory)["left"]
    np.testing.assert_allclose(stays.q, np.tile(START, (stays.t.size, 1)), atol=1e-2)


@pytest.mark.parametrize("limits", [None, LIMITS], ids=["torques", "limits"])
@pytest.mark.parametrize("period", [None, PERIOD], ids=["free", "clock"])
@pytest.mark.parametrize("way", [2e-6, 1e-4, 1e-3])
def test_tiny_motions_are_planned_and_verified(
    way: float, period: float | None, limits: tm.MotionLimits | None
) -> None:
    goal = tm.JointGoal(START + way * np.array([1.0, -0.6, 0.3]))
    problem = from_start(goal, motion_limits=limits)
    solution = tm.plan(problem, control_period=period, **FEW)
    assert solution.success, solution.message
    assert solution.verification.ok
    assert solution.T > 0.0
    if period is not None:
        assert solution.T / period == pytest.approx(round(solution.T / period))
        assert solution.T >= 3.999 * period
    if way < 1e-5 and period is not None:
        assert solution.T == 4 * period
        assert solution.status is tm.Status.CONVERGED


def test_refinement_stops_if_violations_grow(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Accelerations of tiny motions are lost in rounding if the intervals are short."""
    replayed: list[int] = []

    def seen(problem: tm.Problem, motion: tm.Trajectory, *rest, **more):
        replayed.append(motion.t.size - 1)
        return verify(problem, motion, *rest, **more)

    verify = candidate.verify
    monkeypatch.setattr(candidate, "verify", seen)
    goal = tm.JointGoal(START + 2e-6 * np.array([1.0, -0.6, 0.3]))
    solution = tm.plan(from_start(goal), effort="quick")
    assert solution.success, solution.message
    assert max(replayed) <= 160


def test_start_acceleration_at_the_goal_needs_a_motion_if_jerk_is_limited() -> None:
    """With a limit of jerk j, the arm leaves the goal and returns to it."""
    goal, a = tm.JointGoal(START), np.array([2.0, 0.0, 0.0])
    problem = from_start(goal, a_start=a, motion_limits=LIMITS)
    solution = tm.plan(problem, effort="quick")
    assert solution.success and solution.T > a[0] / 900.0
    np.testing.assert_allclose(solution.trajectory(0.0).a, a, atol=1e-4)
    # Where accelerations may jump, the arm stays.
    assert tm.plan(from_start(goal, a_start=a)).T == 0.0


def test_start_where_the_arm_cannot_be_held_is_no_goal_to_rest_at() -> None:
    """A joint without a motor falls, whether the goal has joints or a frame."""
    weak = tm.load_robot("planar3r", effort=[50.0, 50.0, 0.0])
    here = tm.PositionGoal("tip", tip())
    for goal in (here, tm.JointRegionGoal(START, tolerance=0.1), tm.AllGoals([here])):
        solution = tm.plan(tm.Problem(weak, START, goal), max_iterations=1, starts=1)
        assert not solution.success
        assert "joint 'joint3' cannot hold the arm against gravity" in solution.message
    # A start that moves does not rest there.
    there = tm.JointGoal(START, v=VELOCITY)
    assert tm.plan(tm.Problem(weak, START, there, v_start=VELOCITY)).T == 0.0
