"""Motions of several segments.

Closed forms, payloads, scenes, constraints, verification and wrong arguments.
"""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

import tominpmp as tm
from tests.reference_optima import rail_time
from tests.sample_arms import make_arm, rod, slide
from tominpmp.initial_guess.inverse_kinematics import Target
from tominpmp.initial_guess.segments import segmented_guesses
from tominpmp.kinematics import RobotKinematics
from tominpmp.stopping import Stop
from tominpmp.transcription.bspline import BSplineTranscription, InverseTranscription
from tominpmp.transcription.grid import segmented_shares
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import NonlinearProgram

MASS, FORCE = 2.0, 10.0
PUSH = FORCE / MASS
# Share by which a grid of 40 intervals per segment may be slower than the closed form.
GRID = 0.01
DENSE = 60
QUICK = {"control": "constant", "intervals": DENSE, "effort": "quick", "refine": None}


def rail(**changes):
    return make_arm(slide(MASS), effort=FORCE, **changes)


def problem_on_rail(*segments, robot=None, **changes):
    return tm.Problem(robot or rail(), np.zeros(1), segments=segments, **changes)


def at(x, **changes):
    return tm.Segment(tm.JointGoal([x]), **changes)


def planned(problem, **options):
    solution = tm.plan(problem, **QUICK | options)
    assert solution.success, solution.message
    assert solution.verification.ok, solution.verification.message
    assert tm.verify(problem, solution.trajectory).ok
    return solution


def assert_close_above(T, expected, above=GRID):
    assert expected * (1.0 - 1e-6) <= T <= expected * (1.0 + above)


# -- closed forms ----------------------------------------------------------------------


@pytest.mark.parametrize("via", [0.2, 0.5, 0.8])
def test_via_point_costs_no_motion_time(via):
    solution = planned(problem_on_rail(at(via), at(1.0)))
    assert_close_above(solution.T, rail_time(1.0, PUSH))
    first, second = solution.segments
    top = np.sqrt(PUSH)
    speed = min(np.sqrt(2.0 * PUSH * via), top, np.sqrt(2.0 * PUSH * (1.0 - via)))
    assert abs(first.trajectory.q[-1, 0] - via) < 1e-6
    assert abs(first.trajectory.v[-1, 0] - speed) < 0.1 * speed
    assert first.end == second.begin and second.end == solution.T


def test_stop_and_dwell_take_their_closed_form_durations():
    parts = rail_time(0.3, PUSH), rail_time(0.7, PUSH)
    stopping = planned(problem_on_rail(at(0.3, stop=True), at(1.0)))
    assert_close_above(stopping.T, sum(parts))
    assert_close_above(stopping.segments[0].duration, parts[0], 0.02)
    staying = planned(problem_on_rail(at(0.3, dwell=0.25), at(1.0, dwell=0.1)))
    assert_close_above(staying.T - 0.35, sum(parts))
    first = staying.segments[0]
    assert first.end - first.arrival == pytest.approx(0.25)
    during = np.linspace(first.arrival, first.end, 50)
    state = staying.trajectory(during)
    np.testing.assert_allclose(state.q, 0.3, atol=1e-6)
    np.testing.assert_allclose(state.v, 0.0, atol=1e-6)
    assert_close_above(
        planned(problem_on_rail(at(1.0, dwell=0.2))).T, rail_time(1.0, PUSH) + 0.2
    )


def test_continuous_accelerations_are_zero_at_a_dwell():
    """Regression: near the dwell, the force was 1.37 times its limit for 0.4 ms."""
    problem = problem_on_rail(at(1.4, dwell=0.1), at(1.0))
    solution = planned(problem, control="spline", refine="auto")
    assert_close_above(
        solution.T - 0.1, rail_time(1.4, PUSH) + rail_time(0.4, PUSH), 0.02
    )
    first = solution.segments[0]
    times = [
        np.linspace(end - 0.01, end + 0.01, 4001) for end in (first.arrival, first.end)
    ]
    assert np.max(np.abs(solution.trajectory(np.concatenate(times)).u)) < 1.005 * FORCE


def test_continuous_accelerations_are_zero_at_the_last_dwell():
    """Regression: just before the dwell, the force was 1.4 times its limit."""
    solution = planned(problem_on_rail(at(1.0, dwell=0.1)), control="spline")
    assert_close_above(solution.T - 0.1, rail_time(1.0, PUSH), 0.02)
    arrival = solution.segments[0].arrival
    before = solution.trajectory(np.linspace(0.9 * arrival, arrival, 4001))
    assert np.max(np.abs(before.u)) < 1.005 * FORCE


def test_motion_there_and_back_takes_its_closed_form_duration():
    assert_close_above(
        planned(problem_on_rail(at(1.0), at(0.4))).T,
        rail_time(1.0, PUSH) + rail_time(0.6, PUSH),
        0.02,
    )


def test_payload_is_picked_up_between_segments():
    load = tm.Payload(3.0, "tip")
    problem = problem_on_rail(at(0.5), at(1.5, payload=load))
    solution = planned(problem)
    heavy = FORCE / (MASS + 3.0)

    def time(v):
        return rail_time(0.5, PUSH, end_speed=v) + rail_time(1.0, heavy, start_speed=v)

    most = min(np.sqrt(2.0 * PUSH * 0.5), np.sqrt(2.0 * heavy))
    best = minimize_scalar(time, bounds=(0.0, most), method="bounded").fun
    assert_close_above(solution.T, best)
    light = tm.Problem(problem.robot, np.zeros(1), segments=[at(0.5), at(1.5)])
    assert not tm.verify(light, solution.trajectory).ok
    # On both sides of the node, the torque is that of the mass that is carried there.
    end = solution.segments[0].end
    state = solution.trajectory(np.array([end - 1e-6, end + 1e-6]))
    np.testing.assert_allclose(state.u[0], MASS * state.a[0], rtol=1e-6)
    np.testing.assert_allclose(state.u[1], (MASS + 3.0) * state.a[1], rtol=1e-6)


def test_tool_speed_constrains_one_segment():
    slow = (tm.ToolSpeed("tip", 0.5),)
    solution = planned(problem_on_rail(at(0.5), at(1.0, constraints=slow)))
    cruise = (0.5 - 0.5 * 0.25 / PUSH) / 0.5 + 0.5 / PUSH
    assert_close_above(solution.T, rail_time(0.5, PUSH, end_speed=0.5) + cruise, 0.02)
    first, second = solution.segments
    assert np.max(np.abs(first.trajectory.v)) > 1.0
    assert np.max(np.abs(second.trajectory.v)) < 0.5 * 1.003


def test_acceleration_limit_holds_on_one_segment():
    gentle = tm.MotionLimits(acceleration=1.0)
    problem = problem_on_rail(at(0.5, stop=True), at(1.0, motion_limits=gentle))
    solution = planned(problem, control="linear")
    first, second = solution.segments
    expected = rail_time(0.5, PUSH), rail_time(0.5, 1.0)
    assert_close_above(first.duration, expected[0], 0.08)
    assert_close_above(second.duration, expected[1], 0.08)
    assert np.max(np.abs(solution.trajectory(np.linspace(0, first.end, 400)).a)) > 3.0


@pytest.mark.parametrize("control", ["linear", "spline"])
def test_smooth_controls_pass_a_via_point(control):
    limits = tm.MotionLimits(acceleration=4.0, jerk=80.0)
    problem = problem_on_rail(at(0.5), at(1.0), motion_limits=limits)
    solution = planned(problem, control=control, intervals=24)
    alone = planned(
        tm.Problem(problem.robot, [0.0], tm.JointGoal([1.0]), motion_limits=limits),
        control=control,
        intervals=48,
    )
    assert abs(solution.T / alone.T - 1.0) < 0.02
    staying = planned(
        problem_on_rail(at(0.5, dwell=0.1), at(1.0), motion_limits=limits),
        control=control,
        intervals=24,
    )
    assert staying.T > solution.T + 0.1


# -- arms ------------------------------------------------------------------------------


def two_links():
    return make_arm(
        rod(1.0, 0.5), rod(1.0, 0.5), effort=(8.0, 4.0), gravity=(0.0, -9.81, 0.0)
    )


def test_frame_goals_between_segments_are_passed():
    robot = two_links()
    segments = [
        tm.Segment(tm.PositionGoal("tip", (0.6, -0.5, 0.0))),
        tm.Segment(tm.PositionGoal("tip", (0.2, -0.8, 0.0)), stop=True),
        tm.Segment(tm.JointGoal([-1.57, 0.0])),
    ]
    few = {"intervals": 24, "effort": "quick", "refine": None}
    solution = planned(tm.Problem(robot, [-1.2, 0.3], segments=segments), **few)
    assert len(solution.segments) == 3
    stopping = [replace(segment, stop=True) for segment in segments]
    slower = planned(tm.Problem(robot, [-1.2, 0.3], segments=stopping), **few)
    assert solution.T < slower.T


def test_first_descent_does_not_begin_at_rest_at_the_start():
    near_elbow = tm.JointRegionGoal([-0.9], tolerance=0.1, joints=["joint1"])
    segments = [tm.Segment(near_elbow), tm.Segment(tm.JointGoal([-1.57, 0.0]))]
    problem = tm.Problem(two_links(), [-1.57, 0.0], segments=segments)
    solution = planned(problem, starts=1, intervals=30, refine=None)
    # Later records are of descents that the certificate requests, from where the first
    # descent ended.
    first = [record.duration for record in solution.history if record.start == 0]
    later = [record.duration for record in solution.history if record.start > 0]
    assert later == pytest.approx([first[-1]] * len(later), rel=1e-2)


def test_fastest_of_several_via_points_is_chosen():
    goals = tm.AnyGoal([tm.JointGoal([2.0]), tm.JointGoal([0.5])])
    problem = problem_on_rail(tm.Segment(goals), at(1.0))
    assert len(problem.alternatives) == 2
    assert_close_above(planned(problem).T, rail_time(1.0, PUSH))


def test_lower_bound_of_a_plan_holds_for_all_alternative_goals():
    # The bound of the far goal, which is also planned, does not hold for the near one.
    goals = tm.AnyGoal([tm.JointGoal([2.0]), tm.JointGoal([0.5])])
    problem = problem_on_rail(tm.Segment(goals), at(0.6), robot=rail(velocity=1.0))
    solution = planned(problem)
    assert solution.lower_bound.T == tm.lower_bound(problem).T
    assert solution.lower_bound.T <= solution.T


def two_via_points_and_goals() -> tm.Problem:
    """Two links that pass one of two positions, and end at one of two others."""
    vias = [tm.PositionGoal("tip", (0.6, y, 0.0)) for y in (-0.5, -0.3)]
    ends = [tm.PositionGoal("tip", (x, -0.9, 0.0)) for x in (0.1, 0.2)]
    segments = [tm.Segment(tm.AnyGoal(goals)) for goals in (vias, ends)]
    return tm.Problem(two_links(), [-1.2, 0.3], segments=segments)


def test_inverse_kinematics_is_solved_once_for_each_goal_and_start(monkeypatch):
    """Regression: every combination of goals had its own, and each of them two."""
    calls, usual = [], Target.configurations

    def seen(self, *arguments):
        calls.append(1)
        return usual(self, *arguments)

    monkeypatch.setattr(Target, "configurations", seen)
    problem = two_via_points_and_goals()
    assert len(problem.alternatives) == 4
    assert planned(problem).success
    # Two via points from the start, and two goals from each of the via points.
    assert len(calls) <= 6


def test_combinations_whose_shares_end_early_are_tried_again(monkeypatch):
    """Regression: no motion to a combination of goals without a guess in its share."""
    calls = []

    def late(*arguments):
        calls.append(1)
        if len(calls) <= 4:
            raise Stop(requested=False)
        return segmented_guesses(*arguments)

    monkeypatch.setattr("tominpmp.planner.starts.segmented_guesses", late)
    assert planned(two_via_points_and_goals()).success


def test_message_says_that_no_combination_of_goals_had_a_start(monkeypatch):
    def late(*arguments):
        raise Stop(requested=False)

    monkeypatch.setattr("tominpmp.planner.starts.segmented_guesses", late)
    solution = tm.plan(two_via_points_and_goals(), **QUICK)
    assert solution.status is tm.Status.TIME_LIMIT
    assert "before the first start to any of 4 combinations of goals: no motion" in (
        solution.message
    )


def test_scene_of_a_segment_belongs_to_its_phase():
    robot = tm.load_robot("planar3r")
    start, end = np.array([0.4, 0.3, 0.2]), np.array([0.4, -0.3, -0.2])
    wall = tm.Scene([tm.Sphere("ball", radius=0.1, position=(30.0, 0.0, 0.0))])
    problem = tm.Problem(
        robot,
        start,
        segments=[
            tm.Segment(tm.JointGoal(0.5 * (start + end))),
            tm.Segment(tm.JointGoal(end), scene=wall),
        ],
    )
    assert [len(phase.scene) for phase in problem.phases] == [0, 1]
    solution = planned(problem, intervals=24, effort="quick", refine=None)
    assert solution.verification.min_clearance > 0.0


# -- derivatives -----------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["inverse", "linear", "spline"])
def test_rows_of_segments_match_finite_differences(kind):
    robot = two_links()
    limits = tm.MotionLimits(acceleration=30.0)
    if kind != "inverse":
        limits = tm.MotionLimits(acceleration=30.0, jerk=900.0, effort_rate=300.0)
    segments = [
        tm.Segment(tm.PositionGoal("tip", (0.6, -0.5, 0.0)), dwell=0.1),
        tm.Segment(
            tm.JointGoal([-1.57, 0.2]),
            payload=tm.Payload(0.7, "tip"),
            constraints=(tm.ToolSpeed("tip", 2.0),),
        ),
        tm.Segment(tm.PositionGoal("tip", (0.1, -0.9, 0.0))),
    ]
    problem = tm.Problem(robot, [-1.2, 0.3], segments=segments, motion_limits=limits)
    system = ProblemFunctions.of(problem)
    rng = np.random.default_rng(4)
    shares = segmented_shares(
        "cosine", np.full(3, 6), np.array([0.3, 0.5, 0.2]), kind != "inverse"
    )
    ends = (6, 12, 18)
    if kind == "inverse":
        of = InverseTranscription(system, shares, 1.0, segment_ends=ends)
    else:
        of = BSplineTranscription(
            system, shares, {"linear": 3, "spline": 5}[kind], ends
        )
    z = rng.normal(size=of.size) * 0.3 + np.tile([-1.3, 0.2], of.size)[: of.size]
    z[-3:] = (0.8, 1.1, 1.3)
    program = NonlinearProgram.of(of).at(z)
    kinds = set(program.rows.kinds)
    assert {"torque on segment 1", "torque on segment 2", "goal of segment 1"} <= kinds
    assert "speed of frame tip on segment 2" in kinds
    assert "speed of frame tip on segment 1" not in kinds
    steps = program.step_bounds(z, 10.0)
    found = program.linearize(z, program.evaluate(z), steps)
    matrix = np.zeros((program.rows.size, program.size))
    matrix[found.rows] = found.matrix.toarray()
    for i in np.flatnonzero(steps.upper > steps.lower):
        shift = np.zeros(program.size)
        shift[i] = 1e-6
        expected = program.evaluate(z + shift) - program.evaluate(z - shift)
        expected /= 2e-6
        # Rates of torques over short intervals are large numbers.
        scale = np.maximum(1.0, np.abs(program.evaluate(z)))
        scale *= max(1.0, float(np.abs(expected).max()))
        error = np.abs(matrix[:, i] - expected)[found.rows] / scale[found.rows]
        assert np.max(error) < 2e-5, (i, found.rows[np.argmax(error)])


# -- verification ----------------------------------------------------------------------


def test_verification_names_a_goal_that_is_not_passed():
    solution = planned(problem_on_rail(at(0.5), at(1.0)))
    other = problem_on_rail(at(1.2), at(1.0))
    verdict = tm.verify(other, solution.trajectory)
    assert not verdict.ok
    assert any(item.kind == "goal" for item in verdict.violations)
    moving = problem_on_rail(at(0.5, stop=True), at(1.0))
    verdict = tm.verify(moving, solution.trajectory)
    assert any(item.kind == "speed" for item in verdict.violations)
    staying = problem_on_rail(at(0.5, dwell=0.2), at(1.0))
    assert not tm.verify(staying, solution.trajectory).ok


def test_motion_file_is_verified_segment_by_segment(tmp_path):
    load = tm.Payload(3.0, "tip")
    solution = planned(problem_on_rail(at(0.5, dwell=0.1), at(1.5, payload=load)))
    path = solution.export(tmp_path / "motion.csv")
    assert tm.verify(solution.problem, tm.load_motion(path)).ok


def test_segments_are_parts_of_the_motion():
    solution = planned(problem_on_rail(at(0.4, dwell=0.1), at(1.0)))
    for part in solution.segments:
        times = np.linspace(0.0, part.duration, 40)[1:-1]
        own, whole = part.trajectory(times), solution.trajectory(part.begin + times)
        for mine, his in zip(own, whole, strict=True):
            np.testing.assert_allclose(mine, his, atol=1e-7)
    copied = pickle.loads(pickle.dumps(solution))
    assert copied.segments == solution.segments


# -- wrong input -----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("given", "word"),
    [
        (5, "list of Segment"),
        ("ab", "list of Segment"),
        ([at(0.5), 3], "expected a Segment"),
        ([at(9.0), at(1.0)], "segment 1 of 2"),
        ([at(0.5), tm.Segment(tm.JointGoal([1.0, 2.0]))], "segment 2 of 2"),
        ([at(0.5, constraints=(tm.ToolSpeed("nose", 1.0),))], "nose"),
        ([at(0.5, may_touch=[("link1", "box")])], "may_touch"),
    ],
)
def test_wrong_segments_are_refused(given, word):
    with pytest.raises(tm.TominpmpError, match=word):
        tm.Problem(rail(), [0.0], segments=given)


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"dwell": -1.0}, "dwell"),
        ({"dwell": "long"}, "dwell"),
        ({"stop": "yes"}, "stop"),
        ({"payload": 3.0}, "payload"),
        ({"scene": 3.0}, "scene"),
        ({"motion_limits": {}}, "motion_limits"),
        ({"may_touch": "ab"}, "may_touch"),
        ({"may_touch": [("a",)]}, "may_touch"),
    ],
)
def test_wrong_values_of_a_segment_are_refused(changes, word):
    with pytest.raises(tm.ProblemError, match=word):
        at(0.5, **changes)


def test_options_that_exclude_segments_are_refused():
    problem = problem_on_rail(at(0.5), at(1.0))
    for options in (
        {"method": "adjoint"},
        {"refine": "switching"},
        {"slack": 0.01},
    ):
        with pytest.raises(tm.OptionsError, match="several segments"):
            tm.plan(problem, **options)
    with pytest.raises(tm.ProblemError, match="or at least one segment"):
        tm.Problem(rail(), [0.0])
    with pytest.raises(tm.ProblemError, match="one or the other"):
        tm.Problem(rail(), [0.0], tm.JointGoal([1.0]), segments=[at(1.0)])
    with pytest.raises(tm.ProblemError, match="asks for a velocity"):
        tm.Segment(tm.JointGoal([0.5], v=[1.0]), stop=True)
    with pytest.raises(tm.ProblemError, match="dwell stops the arm") as caught:
        tm.Segment(tm.JointGoal([0.5], v=[1.0]), dwell=0.1)
    assert caught.value.field == "segment.dwell"


def test_velocity_at_a_via_point_is_reached():
    moving = tm.Segment(tm.JointGoal([0.5], v=[1.0]))
    solution = planned(problem_on_rail(moving, at(1.0)))
    assert solution.segments[0].trajectory.v[-1, 0] == pytest.approx(1.0, abs=1e-6)


def test_arrival_times_are_met_although_a_descent_stagnates():
    """Regression, parts on a belt: ten steps without progress ended the descent.

    No other descent succeeded.
    """
    robot = tm.load_robot("ur5")
    start = [0.0, -1.2, 1.3, -1.6, -1.57, 0.0]
    above = [1.2, -1.4, 1.5, -1.6, -1.57, 0.5]
    there = RobotKinematics(robot).placement(np.array(above), "tool0")
    turn, speed = there.rotation, (0.0, 0.25, 0.0)

    def met(time, *constraints):
        shift = np.array([0.3, -0.45 + 0.25 * time, 0.0])
        point = there.translation + shift
        goal = tm.PoseGoal("tool0", (point, turn), v=speed)
        window = (time - 1e-3, time + 1e-3)
        return tm.Segment(goal, constraints, arrival=window)

    first, then = met(1.2), met(1.6)
    line = tm.ToolLine(
        "tool0", first.goal.target.translation, then.goal.target.translation, 2e-3
    )
    held = tm.KeepOrientation("tool0", turn, tolerance=0.02)
    segments = [first, met(1.6, line, held), tm.Segment(tm.JointGoal(start))]
    problem = tm.Problem(robot, start, segments=segments)
    solution = tm.plan(problem, effort="quick", refine=None, max_planning_time=300.0)
    assert solution.success
    assert solution.segments[1].arrival == pytest.approx(1.6, abs=2e-3)
