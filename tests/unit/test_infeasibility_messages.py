"""Messages of plans without a motion: the cause is named, and proofs of infeasibility
come at once.
"""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from optimum_cases import ROD
from sample_arms import DOWNWARD, make_arm

import tominpmp as tm
from tominpmp.bounds.lower_bound import lower_bound, why_impossible
from tominpmp.initial_guess import segments
from tominpmp.initial_guess.guess import GuessRequest
from tominpmp.initial_guess.rrt import PathSearches
from tominpmp.initial_guess.unreachable import hindrance
from tominpmp.kinematics import RobotKinematics
from tominpmp.planner import plan_state
from tominpmp.status import Status
from tominpmp.transcription.problem_functions import ProblemFunctions

TOLERANCE = 5e-3


def rushed(*latest: float | None, dwell: float = 0.0) -> tm.Problem:
    """One joint moves to 1 rad and back, with the latest arrivals at both goals."""
    arm = make_arm(ROD, effort=5.0)
    segments = [
        tm.Segment(
            tm.JointGoal([1.0 - k]),
            arrival=None if time is None else (0.0, time),
            stop=True,
            dwell=dwell * (k == 0),
        )
        for k, time in enumerate(latest)
    ]
    return tm.Problem(arm, [0.0], segments=segments)


def test_unreachable_arrival_time_is_infeasible_at_once() -> None:
    """Regression: nine starts failed first, and a violated acceleration was named."""
    fastest = lower_bound(rushed(None)).T

    solution = tm.plan(rushed(0.5 * fastest))

    assert solution.status is Status.INFEASIBLE and not solution.history
    assert solution.message == (
        "No motion exists: the goal of segment 1 is to be reached by "
        f"{0.5 * fastest:.4g} s, and no motion gets there before {fastest:.4g} s: "
        "joint joint1 has 1 rad to go, and no torque moves it there sooner."
    )


def test_motions_that_are_too_long_for_a_replay_are_not_searched_for() -> None:
    """Regression: the search used up its time, and more time was the advice."""
    slow = tm.MotionLimits(acceleration=1e-9)
    goal = tm.JointGoal([1.0])
    arm = make_arm(ROD, effort=5.0)
    solution = tm.plan(tm.Problem(arm, [0.0], goal, motion_limits=slow))
    assert solution.status is Status.INFEASIBLE and solution.iterations == 0
    assert "No motion takes less than 6.32e+04 s: joint joint1 has 1 rad to go" in (
        solution.message
    )
    assert solution.message.endswith("no more than 1e+04 s can be replayed.")


def test_earliest_arrival_includes_earlier_segments_and_dwells() -> None:
    fastest = lower_bound(rushed(None)).T
    least = 2.0 * fastest + 0.5

    early, in_time = (
        why_impossible(rushed(None, share * least, dwell=0.5), TOLERANCE)
        for share in (0.97, 1.0)
    )

    assert f"the goal of segment 2 is to be reached by {0.97 * least:.4g} s" in early
    assert f"no motion gets there before {least:.4g} s, by its joint" in early
    assert not in_time
    assert tm.plan(rushed(None, 1.05 * least, dwell=0.5)).success


def moving(at: float, v: float, to: float, w: float) -> tm.Problem:
    """A joint between 0 and 1 rad, with at most 2 rad/s^2."""
    arm = make_arm(ROD, effort=50.0).with_changes(
        position_lower=0.0, position_upper=1.0
    )
    limits = tm.MotionLimits(acceleration=2.0)
    return tm.Problem(
        arm, [at], tm.JointGoal([to], v=[w]), v_start=[v], motion_limits=limits
    )


def test_missing_distance_to_a_position_limit_is_infeasible_at_once() -> None:
    """Regression: other limits were named, after eight starts.

    The distance is missing to stop after the start, or to reach the speed of the goal.
    """
    stop = tm.plan(moving(0.9, 1.0, 0.5, 0.0))
    assert stop.status is Status.INFEASIBLE and not stop.history
    assert stop.message == (
        "No motion exists: joint 'joint1' has 1 rad/s at the start, 0.1 rad from its "
        "position limit of 1 rad, and needs 0.25 rad to stop."
    )
    run_up = why_impossible(moving(0.5, 0.0, 0.9, -1.0), TOLERANCE)
    assert "has 1 rad/s at the goal, 0.1 rad from its position limit of 1" in run_up
    assert run_up.endswith("and needs 0.25 rad to reach this speed.")


def test_missing_torque_for_the_start_acceleration_is_infeasible() -> None:
    """Regression: a start of this kind was searched until the time limit."""
    arm = make_arm(ROD, effort=50.0)
    goal, jerk = tm.JointGoal([0.5]), tm.MotionLimits(jerk=1e3)
    start = partial(tm.Problem, arm, [0.0], goal, motion_limits=jerk)
    solution = tm.plan(start(a_start=[400.0]))
    assert solution.status is Status.INFEASIBLE and not solution.history
    assert solution.message.startswith("No motion exists: joint 'joint1' needs ")
    assert "for its acceleration at the start, [-50, 50] allowed." in solution.message
    assert why_impossible(start(a_start=[1.0]), TOLERANCE) == ""
    # Without limits of jerk the acceleration jumps.
    jumping = tm.Problem(arm, [0.0], goal, a_start=[400.0])
    assert why_impossible(jumping, TOLERANCE) == ""


@pytest.mark.parametrize(
    "ends",
    [
        (0.7, 1.0, 0.5, 0.0),
        (0.5, 0.0, 0.7, -1.0),
        (0.9, 1.0, 0.95, 1.0),
        (0.1, -0.6, 0.05, -0.4),
    ],
)
def test_sufficient_distance_to_a_position_limit_is_feasible(
    ends: tuple[float, ...],
) -> None:
    problem = moving(*ends)
    assert why_impossible(problem, TOLERANCE) == ""
    assert tm.plan(problem).success


@pytest.mark.parametrize("segment", ["", "on segment 2, "], ids=["one", "second"])
def test_missing_path_names_joint_and_obstacle(
    segment: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Regression: torques of a guess were named that no iteration had improved."""
    for module in (plan_state, segments):
        monkeypatch.setattr(module, "PathSearches", partial(PathSearches, checks=2000))
    room = {"position_lower": [-3.0, -0.1, -0.1], "position_upper": [3.0, 0.1, 0.1]}
    arm = tm.load_robot("planar3r", **room)
    post = tm.Sphere("post", radius=0.3, position=(0.0, 5.0, 0.0))
    near, goal = (tm.JointGoal([q, 0.0, 0.0], wrap=False) for q in (0.5, 2.5))
    problem = tm.Problem(arm, [0.6, 0.0, 0.0], goal, [post])
    if segment:
        both = [tm.Segment(near, stop=True), tm.Segment(goal)]
        problem = tm.Problem(arm, [0.6, 0.0, 0.0], scene=[post], segments=both)

    few = {"intervals": 8, "starts": 1, "max_iterations": 2}
    solution = tm.plan(problem, max_planning_time=np.inf, **few)

    assert not solution.success
    assert f": {segment}no path around the obstacles was found: " in solution.message
    assert "joint 'joint1' came no farther than " in solution.message
    assert " rad towards the " in solution.message
    assert "link 'link2' and obstacle 'post'" in solution.message
    assert "N m" not in solution.message


def test_missing_path_of_a_segment_is_known_to_the_guesses_of_all_segments(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Obstacles that move keep segments from being planned one by one."""
    monkeypatch.setattr(segments, "PathSearches", partial(PathSearches, checks=500))
    room = {"position_lower": [-3.0, -0.1, -0.1], "position_upper": [3.0, 0.1, 0.1]}
    arm, searches = tm.load_robot("planar3r", **room), PathSearches()
    post = tm.Sphere("post", radius=0.3, position=(0.0, 5.0, 0.0))
    goals = (tm.JointGoal([q, 0.0, 0.0], wrap=False) for q in (0.5, 2.5))
    both = [tm.Segment(goal, stop=True) for goal in goals]
    system = ProblemFunctions.of(
        tm.Problem(arm, [0.6, 0, 0], None, [post], segments=both)
    )
    request = GuessRequest(np.random.default_rng(0), searches=searches)
    guesses = segments.segmented_guesses(system, request)
    next(guesses)
    assert not searches.impasse
    next(guesses)
    assert searches.impasse.startswith("on segment 2, no path around the obstacles was")
    assert "link 'link2' and obstacle 'post'" in searches.impasse


def test_goal_where_no_configuration_can_rest_is_named() -> None:
    weak = make_arm(ROD, ROD, effort=np.array([15.0, 9.0]), gravity=DOWNWARD)
    strong = make_arm(ROD, ROD, effort=np.array([50.0, 50.0]), gravity=DOWNWARD)
    goal = tm.PositionGoal("tip", [1.9, 0.0, 0.0])
    start = [-1.5, 0.0]

    message = hindrance(tm.Problem(weak, start, goal))

    assert "goal: the arm cannot rest in any of the " in message
    assert "joint 'joint1' cannot hold the arm against gravity there" in message
    assert hindrance(tm.Problem(strong, start, goal)) == ""
    moving = tm.PositionGoal("tip", [1.9, 0.0, 0.0], v=[0.0, 0.1, 0.0])
    assert hindrance(tm.Problem(weak, start, moving)) == ""

    segments = [tm.Segment(tm.JointGoal([-1.3, 0.1])), tm.Segment(goal)]
    in_two = hindrance(tm.Problem(weak, start, segments=segments))
    assert in_two.startswith("on segment 2, goal: the arm cannot rest in any of the ")
    assert hindrance(tm.Problem(strong, start, segments=segments)) == ""


def test_obstacle_at_a_frame_goal_is_named() -> None:
    arm = tm.load_robot("planar3r")
    ball = tm.Sphere("ball", radius=0.2, position=(3.0, 2.0, 0.0))
    region = tm.RegionGoal("tip", [2.99, 1.99, -0.1], [3.01, 2.01, 0.1])
    problem = tm.Problem(arm, [2.0, 0.0, 0.0], region, [ball], margin=0.02)

    message = hindrance(problem)

    assert "configurations found to reach it are in collision" in message
    assert "obstacle 'ball' lack 0." in message

    # Of alternative goals, each is hindered.
    either = tm.AnyGoal([region, tm.RegionGoal("tip", [2.99, 1.9, -1], [3.01, 2.1, 1])])
    both = hindrance(tm.Problem(arm, [2.0, 0.0, 0.0], either, [ball], margin=0.02))
    assert both.startswith(f"{message}; goal: all ")
    free = tm.AnyGoal([region, tm.PositionGoal("tip", [1.0, 1.0, 0.0])])
    assert not hindrance(tm.Problem(arm, [2.0, 0, 0], free, [ball], margin=0.02))
    segment = tm.Segment(either)
    problem = tm.Problem(
        arm, [2.0, 0, 0], scene=[ball], margin=0.02, segments=[segment]
    )
    assert hindrance(problem) == f"on segment 1, {both}"


def test_message_has_the_last_reachable_point_of_a_tool_line() -> None:
    """Regression: the message had the distance from the goal, and neither the obstacle
    nor the place.
    """
    arm, q = tm.load_robot("planar3r"), [0.5, 1.4, -0.8]
    begin = np.array(RobotKinematics(arm).placement(np.array(q), "tip").translation)

    def hindrance_along(way: float, *obstacles: tm.Sphere) -> str:
        line = tm.ToolLine("tip", begin, begin + np.array([way, 0.0, 0.0]), radius=0.01)
        goal = tm.PositionGoal("tip", line.end)
        return hindrance(tm.Problem(arm, q, goal, obstacles, constraints=[line]))

    assert hindrance_along(-4.0) == ""
    ball = tm.Sphere("ball", radius=0.2, position=begin - np.array([2.0, 0.0, 0.0]))
    hit = hindrance_along(-4.0, ball)
    assert "frame 'tip' can be led along its path as far as [0.7731, 4.222" in hit
    assert "beyond which link 'link3' and obstacle 'ball' collide" in hit

    line = tm.ToolLine("tip", begin, begin - np.array([4.0, 0.0, 0.0]), radius=0.01)
    before = tm.Segment(tm.JointGoal(q))
    along = tm.Segment(tm.PositionGoal("tip", line.end), constraints=[line])
    first = [0.4, 1.2, -0.6]
    assert hindrance(tm.Problem(arm, first, segments=[before, along])) == ""
    second = hindrance(tm.Problem(arm, first, scene=[ball], segments=[before, along]))
    assert second == f"on segment 2, {hit}"


@pytest.mark.parametrize(
    "limits", [None, tm.MotionLimits(acceleration=8.0, jerk=200.0)]
)
def test_pieces_of_a_feasible_motion_are_not_proved_infeasible(
    limits: tm.MotionLimits | None,
) -> None:
    """A piece has velocities at both ends, and meets its goals exactly at the latest
    arrival.
    """
    robot = tm.load_robot("ur5", limits="urdf")
    start = (-0.96, -1.19, 1.49, -1.87, 1.57, -0.61)
    goal = tm.JointGoal((1.1, -0.6, 0.9, -2.2, 0.5, 2.0), wrap=False)
    whole = tm.Problem(robot, start, goal, motion_limits=limits)
    motion = tm.plan(whole, effort="quick").trajectory
    assert motion is not None
    most = robot.limits.velocity
    rng = np.random.default_rng(5)
    for begin, end in np.sort(rng.uniform(0.0, motion.duration, (40, 2))).tolist():
        times = [begin, 0.5 * (begin + end), end]
        states = motion(np.array(times))
        speeds = np.clip(states.v, -most, most)
        segments = [
            tm.Segment(
                tm.JointGoal(states.q[k], speeds[k], wrap=False),
                arrival=(0.0, times[k] - begin),
            )
            for k in (1, 2)
        ]
        piece = tm.Problem(
            robot,
            states.q[0],
            segments=segments,
            v_start=speeds[0],
            motion_limits=limits,
        )
        assert not why_impossible(piece, TOLERANCE)


def test_goal_where_the_arm_cannot_rest_is_rejected_at_once() -> None:
    """Regression: the whole planning time was used up first."""
    weak = make_arm(ROD, ROD, effort=np.array([15.0, 9.0]), gravity=DOWNWARD)
    goal, start = tm.PositionGoal("tip", [1.9, 0.0, 0.0]), [-1.5, 0.0]
    back = tm.Segment(tm.JointGoal(start))
    few = {"intervals": 8, "starts": 1, "max_iterations": 2}

    with pytest.raises(tm.ProblemError, match="goal: the arm cannot rest in any of"):
        tm.plan(tm.Problem(weak, start, goal))
    stops = [tm.Segment(goal, stop=True), back]
    with pytest.raises(tm.ProblemError, match="segment 1 of 2: goal: the arm cannot"):
        tm.plan(tm.Problem(weak, start, segments=stops))
    # The arm may swing through the goal.
    passed = tm.plan(tm.Problem(weak, start, segments=[tm.Segment(goal), back]), **few)
    assert passed.iterations > 0


def test_iteration_limit_names_its_option() -> None:
    """Regression: the advice concerned errors of integration, while the duration was
    still falling.
    """
    # The arm is too weak for the straight way: it has to swing.
    weak = make_arm(ROD, effort=3.0, gravity=DOWNWARD)
    problem = tm.Problem(weak, [-1.57], tm.JointGoal([1.43]))
    few = {"method": "adjoint", "step_rule": "paper", "max_iterations": 5}
    solution = tm.plan(problem, initial_duration=1.5, **few)
    assert solution.status is Status.ITERATION_LIMIT and not solution.success
    assert solution.message.endswith(
        " max_iterations = 5 was reached; "
        "a larger number allows more iterations a start."
    )
