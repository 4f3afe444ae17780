"""Motions with a velocity at their start or end: initial guesses and plans."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

import tominpmp as tm
from tominpmp.initial_guess.guess import MOVING, GuessRequest
from tominpmp.initial_guess.inverse_kinematics import GoalVelocity, end_velocity
from tominpmp.initial_guess.segments import segmented_guesses
from tominpmp.initial_guess.timing import between_velocities
from tominpmp.kinematics import RobotKinematics
from tominpmp.transcription.problem_functions import ProblemFunctions

UR5 = tm.load_robot("ur5")
START = np.array([0.0, -1.2, 1.2, -1.5, -1.5, 0.0])
ALONG = np.array([1.0, 0.3, -0.4, 0.2, 0.5, 0.8])
SPEED = 1.5  # rad/s of the first joint

RAIL = """<robot name="rail"><link name="base"/>
<link name="cart"><inertial><mass value="2"/>
<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
<joint name="x" type="prismatic"><parent link="base"/><child link="cart"/>
<axis xyz="1 0 0"/><limit lower="-100" upper="100" effort="{}" velocity="{}"/>
</joint></robot>"""


def rail(acceleration: float, top: float) -> tm.Robot:
    return tm.load_robot(RAIL.format(2.0 * acceleration, top))


def moving_on(share: float, **changes) -> tm.Problem:
    """A UR5 with a goal ahead, to be passed at the velocity of the start."""
    v, goal = SPEED * ALONG, START + share * ALONG
    return tm.Problem(UR5, START, tm.JointGoal(goal, v=v), v_start=v, **changes)


def first_guess(problem: tm.Problem):
    system = ProblemFunctions.of(problem)
    return next(GuessRequest(np.random.default_rng(0)).guesses(system))


def via_points(*, given: tuple[float | None, ...]) -> tm.Problem:
    """A UR5 whose first joint passes two via points; velocities [rad/s], or None."""

    def segment(way: float, v: float | None) -> tm.Segment:
        first = np.eye(6)[0]
        v_end = None if v is None else v * first
        return tm.Segment(tm.JointGoal(START + way * first, v=v_end))

    ends = zip((0.6, 0.75, 1.35), (*given, None), strict=True)
    return tm.Problem(UR5, START, segments=[segment(*end) for end in ends])


# -- motions between velocities --------------------------------------------------------


@pytest.mark.parametrize("seed", range(20))
def test_motion_between_velocities_meets_its_ends_and_speed_limits(seed):
    rng = np.random.default_rng(seed)
    top = rng.uniform(1.0, 3.0, 5)
    (q, q_end), (v, v_end) = rng.normal(size=(2, 5)), rng.uniform(-1, 1, (2, 5)) * top
    T = 1.01 * float(np.max(np.abs(q_end - q) / top)) * rng.choice([1.0, 2.0, 9.0])
    t = np.linspace(0.0, T, 2001)
    at = between_velocities((q, v, q_end, v_end), top, T, t)
    assert at.q[[0, -1]] == pytest.approx(np.stack([q, q_end]), abs=1e-9)
    assert at.v[[0, -1]] == pytest.approx(np.stack([v, v_end]), abs=1e-9)
    assert np.all(np.abs(at.v) <= top + 1e-9)
    most = np.abs(at.a).max(axis=0)
    steps = np.diff(at.q, axis=0) / t[1] - 0.5 * (at.v[1:] + at.v[:-1])
    assert np.all(np.abs(steps) <= most * t[1])
    # A joint has one acceleration, in both directions.
    assert np.all(np.isclose(np.abs(at.a), most) | (at.a == 0.0))


def test_motions_between_velocities_match_closed_forms():
    """From rest to rest, at constant velocity, at constant acceleration."""
    q, v = np.zeros(3), np.array([0.0, 0.5, 1.0])
    q_end, v_end = np.array([1.0, 1.0, 1.0]), np.array([0.0, 0.5, 0.0])
    t = np.linspace(0.05, 1.95, 20)
    at = between_velocities((q, v, q_end, v_end), np.full(3, np.inf), 2.0, t)
    assert np.abs(at.a).max(axis=0) == pytest.approx([1.0, 0.0, 0.5])
    assert at.v[:, 1] == pytest.approx(0.5)


def test_motion_that_cannot_stop_in_time_overshoots():
    ends = np.array([[0.0], [2.0], [0.5], [0.0]])
    at = between_velocities(ends, np.full(1, 3.0), 4.0, np.linspace(0.0, 4.0, 99))
    assert at.q.max() > 0.6 and at.v.min() < 0.0


# -- guesses ---------------------------------------------------------------------------


@pytest.mark.parametrize("share", [0.1, 0.2, 0.4])
def test_moving_guess_has_the_given_velocities_at_both_ends(share):
    """The duration of the guess is in the short interval of feasible durations."""
    guess = first_guess(moving_on(share))
    assert guess.name == MOVING
    assert guess.duration < share / SPEED
    v = np.gradient(guess.q, guess.t, axis=0)
    assert v[[0, -1]] == pytest.approx(np.tile(SPEED * ALONG, (2, 1)), abs=0.1)


def test_motion_at_rest_at_both_ends_has_no_moving_guess():
    problem = tm.Problem(UR5, START, tm.JointGoal(START + 0.2 * ALONG))
    system = ProblemFunctions.of(problem)
    guesses = list(islice(GuessRequest(np.random.default_rng(0)).guesses(system), 3))
    assert MOVING not in {guess.name for guess in guesses}


def test_moving_guess_keeps_acceleration_jerk_and_tool_limits():
    kinematics = ProblemFunctions.of(moving_on(0.4)).kinematics
    free = first_guess(moving_on(0.4)).duration
    at_ends = [
        np.linalg.norm(kinematics.jacobian(q, "tool0")[:3] @ (SPEED * ALONG))
        for q in (START, START + 0.4 * ALONG)
    ]
    limits = (
        {"motion_limits": tm.MotionLimits(acceleration=2.0)},
        {"motion_limits": tm.MotionLimits(jerk=40.0)},
        {"motion_limits": tm.MotionLimits(effort_rate=200.0)},
        {"constraints": [tm.ToolSpeed("tool0", 1.02 * max(at_ends))]},
    )
    for more in limits:
        assert first_guess(moving_on(0.4, **more)).duration > 1.01 * free


def test_moving_guess_in_collision_is_left_out():
    system = ProblemFunctions.of(moving_on(0.4))
    middle = system.kinematics.placement(START + 0.2 * ALONG, "tool0").translation
    for place, name in ((middle, "straight line"), (middle + 5.0, MOVING)):
        scene = tm.Scene([tm.Sphere("ball", radius=0.02, position=place)])
        assert first_guess(moving_on(0.4, scene=scene)).name == name


def test_end_velocity_at_a_tool_goal_is_nearest_to_the_start_velocity():
    kinematics = ProblemFunctions.of(moving_on(0.1)).kinematics
    jacobian = kinematics.jacobian(START, "tool0")[:3]
    place, v = kinematics.placement(START, "tool0").translation, SPEED * ALONG
    goal = tm.PositionGoal("tool0", place, v=jacobian @ v)
    system = ProblemFunctions.of(tm.Problem(UR5, START - 0.2 * ALONG, goal, v_start=v))
    assert end_velocity(system, START) == pytest.approx(v)
    system = ProblemFunctions.of(tm.Problem(UR5, START - 0.2 * ALONG, goal))
    least = end_velocity(system, START)
    assert jacobian @ least == pytest.approx(jacobian @ v)
    assert np.linalg.norm(least) < np.linalg.norm(v)


@pytest.mark.parametrize("given", [(SPEED, SPEED), (SPEED, None)])
def test_guesses_pass_via_points_without_a_stop(given):
    system = ProblemFunctions.of(via_points(given=given))
    guess = next(segmented_guesses(system, GuessRequest(np.random.default_rng(0))))
    assert guess.durations[1] < 0.12


# -- plans -----------------------------------------------------------------------------


def test_arm_with_its_goal_ahead_takes_no_run_up():
    """Regression: the motion took 17 times as long, with a stop and a run-up."""
    solution = tm.plan(moving_on(0.1), effort="quick")
    assert solution.success and solution.T < 0.1 / SPEED
    assert solution.T == pytest.approx(solution.lower_bound.T, rel=5e-3)


@pytest.mark.parametrize(
    ("given", "most"), [((SPEED, SPEED), 1.13), ((SPEED, None), 1.11)]
)
def test_via_points_passed_at_given_velocities_need_no_stop(given, most):
    """Regression: the motions took 2.12 s and 1.75 s."""
    solution = tm.plan(via_points(given=given), effort="quick")
    assert solution.success and solution.T < most


@pytest.fixture(scope="module")
def whole() -> tm.Solution:
    problem = tm.Problem(
        tm.load_robot("planar3r"), [0.5, 1.7, -1.7], tm.JointGoal([1.0, 1.0, -1.0])
    )
    return tm.plan(problem, effort="quick")


@pytest.mark.parametrize("shares", [(0.5, 0.55), (0.4, 0.6), (0.3, 0.4)])
def test_part_of_a_fast_motion_takes_no_longer_than_in_the_whole(whole, shares):
    """Regression: plans between two states of a motion took 6 to 26 times as long."""
    first, last = (whole.trajectory(share * whole.T) for share in shares)
    goal = tm.JointGoal(last.q, v=last.v, wrap=False)
    problem = tm.Problem(whole.problem.robot, first.q, goal, v_start=first.v)
    part = tm.plan(problem, effort="quick")
    assert part.success and part.T < 1.001 * (shares[1] - shares[0]) * whole.T


@pytest.mark.parametrize(
    ("v", "acceleration", "top"), [(3.0, 0.36, 3.1), (1.0, 0.04, 1.1), (1.0, 0.1, 1.1)]
)
@pytest.mark.parametrize("effort", ["quick", "standard"])
def test_weak_rail_overshoots_or_takes_a_run_up(v, acceleration, top, effort):
    """Regression: no motion was found, as slowing down left a violation of 3e-6."""
    way = 0.55 * v**2 / (2.0 * acceleration)
    least = v / acceleration + 2.0 * np.sqrt(
        (v**2 / 2 / acceleration - way) / acceleration
    )
    robot = rail(acceleration, top)
    problems = (
        tm.Problem(robot, [0.0], tm.JointGoal([way]), v_start=[v]),
        tm.Problem(robot, [way], tm.JointGoal([0.0], v=[-v])),
    )
    for problem in problems:
        solution = tm.plan(problem, effort=effort)
        assert solution.success and solution.T == pytest.approx(least, rel=2e-3)


# -- velocities of frames at goals -----------------------------------------------------

THROWN = np.array([0.8, -1.2, 1.2, -1.5, -1.5, 0.0])


def throw(speed: float) -> tm.PositionGoal:
    """A goal at a place that tool0 of a UR5 can pass along y at up to 1.8612 m/s.

    SLSQP over configurations and joint velocities found this speed, from 60 starts.
    """
    place = RobotKinematics(UR5).placement(THROWN, "tool0").translation
    return tm.PositionGoal("tool0", place, v=(0.0, speed, 0.0))


@pytest.mark.parametrize("segment", ["", "segment 2 of 3: "])
def test_goal_velocity_beyond_joint_speeds_is_refused_before_a_search(segment) -> None:
    fast, via = throw(1.9), tm.JointGoal(START + 0.1 * ALONG)
    problem = tm.Problem(UR5, START, fast)
    if segment:
        segments = [tm.Segment(goal) for goal in (via, fast, via)]
        problem = tm.Problem(UR5, START, segments=segments)
    message = (
        f"^{segment}goal: .* velocity of the goal: .* is 0.0.* m/s off with joint "
    )
    with pytest.raises(tm.ProblemError, match=f"{message}.* its limit of 3.142 rad/s"):
        tm.plan(problem)


def test_goal_velocity_near_the_joint_speeds_is_reached() -> None:
    few = {"effort": "quick", "intervals": 24, "refine": None}
    solution = tm.plan(tm.Problem(UR5, START, throw(1.82)), **few)
    assert solution, solution.message


def test_derivatives_of_goal_velocity_excess_match_differences() -> None:
    goal, step = throw(3.0), 1e-6
    lacks = GoalVelocity(ProblemFunctions.of(tm.Problem(UR5, START, goal)), goal)
    _, (slope,) = lacks.excess_at_rest(THROWN[None])
    ends = [THROWN + sign * step * np.eye(6) for sign in (1, -1)]
    ahead, behind = (lacks.excess_at_rest(q)[0][:, 0] for q in ends)
    np.testing.assert_allclose(slope[0], (ahead - behind) / (2 * step), atol=1e-4)


SMOOTH = tm.MotionLimits(acceleration=8.0, jerk=200.0)


@pytest.fixture(scope="module")
def smooth() -> tm.Solution:
    goal = tm.JointGoal(START + 1.2 * ALONG)
    return tm.plan(tm.Problem(UR5, START, goal, motion_limits=SMOOTH), effort="quick")


@pytest.mark.parametrize("warm", [False, True])
@pytest.mark.parametrize("share", [0.1, 0.8, 0.97])
def test_replanned_motion_starts_with_the_current_acceleration(
    smooth: tm.Solution, share: float, warm: bool
) -> None:
    """The rest of a time-optimal motion is time-optimal (Bellman).

    Regression: from zero acceleration the arm took up to three times the time left.
    """
    at = share * smooth.T
    state, left = smooth.trajectory(at), smooth.T - at
    problem = tm.Problem(
        UR5,
        state.q,
        smooth.problem.goal,
        v_start=state.v,
        a_start=state.a,
        motion_limits=SMOOTH,
    )
    former = smooth if warm else None
    solution = tm.plan(problem, effort="quick", start=former)
    assert solution.success and solution.certificate.ok
    assert solution.lower_bound.T <= solution.T <= left * (1.0 + 2e-3)
    begin = solution.trajectory(0.0)
    np.testing.assert_allclose(begin.a, state.a, atol=1e-5)
    jerks = solution.trajectory(np.linspace(0.0, solution.T, 500), 3)
    assert np.max(np.abs(jerks)) <= 200.0 * (1.0 + 5e-3)


def test_acceleration_jump_at_the_start_violates_the_jerk_limit(
    smooth: tm.Solution,
) -> None:
    state, goal = smooth.trajectory(0.3 * smooth.T), smooth.problem.goal
    problem = tm.Problem(
        UR5,
        state.q,
        goal,
        v_start=state.v,
        a_start=state.a,
        motion_limits=SMOOTH,
    )
    solution = tm.plan(problem, effort="quick", start=smooth)
    assert solution.verification.ok
    from_rest = tm.verify(replace(problem, a_start=None), solution.trajectory)
    (jump,) = from_rest.violations
    assert jump.kind == "jerk" and jump.time == 0.0


def test_start_acceleration_applies_to_the_first_segment(
    smooth: tm.Solution,
) -> None:
    state, goal = smooth.trajectory(0.3 * smooth.T), smooth.problem.goal
    back = tm.Segment(tm.JointGoal(START))
    problem = tm.Problem(
        UR5,
        state.q,
        segments=[tm.Segment(goal, stop=True), back],
        v_start=state.v,
        a_start=state.a,
        motion_limits=SMOOTH,
    )
    assert not np.any(problem.phases[1].a_start)
    solution = tm.plan(problem, effort="quick")
    assert solution.success
    np.testing.assert_allclose(solution.trajectory(0.0).a, state.a, atol=1e-5)
    assert solution.segments[0].end <= 0.7 * smooth.T * (1.0 + 5e-3)


@pytest.mark.parametrize(
    ("limits", "kinematic"),
    [(SMOOTH, False), (SMOOTH, True), (tm.MotionLimits(effort_rate=500.0), False)],
    ids=["jerk", "kinematic", "effort rate"],
)
def test_goal_with_a_tool_velocity_is_met_without_acceleration(
    limits: tm.MotionLimits, kinematic: bool
) -> None:
    """Regression: the replay, in which the arm has no acceleration after the motion,
    refuted every plan.
    """
    arm = tm.load_robot("planar3r", kinematic=kinematic)
    there = RobotKinematics(arm).placement(np.array([0.9, -1.2, -0.9]), "tip")
    goal = tm.PositionGoal("tip", np.array(there.translation), v=[0.5, 0.3, 0.0])
    problem = tm.Problem(arm, [0.5, 1.7, -1.7], goal, motion_limits=limits)
    solution = tm.plan(problem, effort="quick")
    assert solution.success and solution.T < 2.0, solution.message
    last = solution.trajectory(np.nextafter(solution.T, 0.0))
    every = solution.trajectory(solution.trajectory.t).a
    most = np.max(np.abs(every))
    np.testing.assert_allclose(last.a, 0.0, atol=1e-5 * most)
