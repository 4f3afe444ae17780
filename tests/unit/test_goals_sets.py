"""Goals with a tolerance, and sets of goals: AnyGoal and AllGoals."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from tominpmp.exceptions import (
    FrameNotFound,
    JointNotFound,
    ProblemError,
    TominpmpWarning,
)
from tominpmp.goals.base import Goal
from tominpmp.goals.frames import AxisGoal, PoseGoal, PositionGoal, RegionGoal
from tominpmp.goals.joints import JointGoal, JointRegionGoal
from tominpmp.goals.sets import AllGoals, AnyGoal
from tominpmp.kinematics import RobotKinematics
from tominpmp.options import Options
from tominpmp.planner.planning import plan
from tominpmp.problem.problem import Problem
from tominpmp.robot.robot import Robot
from tominpmp.scene.obstacles import Sphere
from tominpmp.scene.scene import Scene

TIP = "ee_link"
Q = np.array([0.4, -1.1, 1.3, -0.7, 0.6, 0.2])
AXIS = np.array([1.0, 2.0, -0.5])
REST = np.zeros(6)


@pytest.fixture(scope="module")
def kinematics(ur5: Robot) -> RobotKinematics:
    return RobotKinematics(ur5)


@pytest.fixture(scope="module")
def pose(kinematics: RobotKinematics) -> pin.SE3:
    return kinematics.placement(Q, TIP)


def every_goal(pose: pin.SE3) -> dict[str, Goal]:
    """Goals that Q reaches, each in the middle of its tolerance."""
    p, towards = np.array(pose.translation), pose.rotation @ AXIS
    return {
        "position": PositionGoal(TIP, p, tolerance=0.03),
        "position moving": PositionGoal(TIP, p, (0.1, 0, 0.2), tolerance=0.03),
        "pose": PoseGoal(TIP, pose, tolerance=0.03, angle_tolerance=0.2),
        "pose turned": PoseGoal(TIP, pose, angle_tolerance=0.2),
        "axis": AxisGoal(TIP, AXIS, towards),
        "cone": AxisGoal(TIP, AXIS, towards, angle_tolerance=0.2),
        "axis at": AxisGoal(TIP, AXIS, towards, p, tolerance=0.03),
        "cone at": AxisGoal(TIP, AXIS, towards, p, angle_tolerance=0.2),
        "box": RegionGoal(TIP, p - 0.03, p + 0.03),
        "plane": RegionGoal(TIP, [-np.inf, p[1], -np.inf], [np.inf, p[1], np.inf]),
        "turned box": RegionGoal(
            TIP, [-0.03] * 3, [0.03] * 3, pose=pose, angle_tolerance=(0.1, 0.2, np.pi)
        ),
        "some joints": JointRegionGoal(
            Q[[3, 1]], (0.1, 0.2), ["wrist_1_joint", "shoulder_lift_joint"]
        ),
        "joints": JointRegionGoal(Q, 0.1),
        "all": AllGoals(
            [JointRegionGoal(Q[:1], 0.1, ["shoulder_pan_joint"]), PositionGoal(TIP, p)]
        ),
    }


def goal_of(kind: str, pose: pin.SE3) -> Goal:
    return every_goal(pose)[kind]


kinds = pytest.mark.parametrize("kind", list(every_goal(pin.SE3.Identity())))


def near_by(rng: np.random.Generator, reach: float) -> np.ndarray:
    """A configuration near Q, where the tool is turned by 6 times the reach at most.

    Below pi: rotation vectors jump there, and lose digits near it.
    """
    return Q + rng.uniform(-reach, reach, size=6)


# Residuals


@kinds
def test_residual_is_within_bounds_where_the_goal_is_reached(
    kind: str, pose: pin.SE3, kinematics: RobotKinematics
) -> None:
    goal = goal_of(kind, pose)
    v = REST
    if goal.fixes_velocity is False:
        v = np.linalg.pinv(kinematics.jacobian(Q, TIP)[:3]) @ (0.1, 0.0, 0.2)
    lower, upper = goal.bounds(kinematics)
    value = goal.residual(kinematics, Q, v).value
    assert np.all(value >= lower - 1e-9)
    assert np.all(value <= upper + 1e-9)
    np.testing.assert_allclose(goal.excess(kinematics, Q, v), 0.0, atol=1e-9)
    missed = goal.misses(kinematics, Q + 0.8, v)
    assert len(missed) == value.size
    assert max(item.amount for item in missed if not item.moving) > 0.1


@kinds
def test_derivatives_of_residuals_match_finite_differences(
    kind: str, pose: pin.SE3, kinematics: RobotKinematics, rng: np.random.Generator
) -> None:
    goal = goal_of(kind, pose)
    for reach in (0.02, 0.5):
        q, v = near_by(rng, reach), rng.normal(size=6)

        def values(q: np.ndarray, v: np.ndarray = v) -> np.ndarray:
            return goal.residual(kinematics, q, v).value

        found, step = goal.residual(kinematics, q, v), 1e-6
        for i, way in enumerate(step * np.eye(6)):
            numeric = (values(q + way) - values(q - way)) / (2 * step)
            np.testing.assert_allclose(found.by_q[:, i], numeric, atol=1e-7)
            numeric = (values(q, v + way) - values(q, v - way)) / (2 * step)
            np.testing.assert_allclose(found.by_v[:, i], numeric, atol=1e-7)


@kinds
def test_place_residual_vanishes_within_the_tolerance(
    kind: str, pose: pin.SE3, kinematics: RobotKinematics, rng: np.random.Generator
) -> None:
    goal = goal_of(kind, pose)
    value, jacobian = goal.place_residual(kinematics, Q)
    np.testing.assert_allclose(value, 0.0, atol=1e-9)
    place = goal.place(kinematics, Q)
    free = place.lower < place.upper
    assert not np.any(jacobian[free])
    assert len(place.labels) == value.size
    q, step = near_by(rng, 0.5), 1e-6
    value, jacobian = goal.place_residual(kinematics, q)
    for i, way in enumerate(step * np.eye(6)):
        ends = [goal.place_residual(kinematics, q + s * way)[0] for s in (1, -1)]
        numeric = (ends[0] - ends[1]) / (2 * step)
        np.testing.assert_allclose(jacobian[:, i], numeric, atol=1e-7)


def test_tolerance_of_a_position_is_a_ball(
    pose: pin.SE3, kinematics: RobotKinematics
) -> None:
    for factor, inside in ((0.999, True), (1.001, False)):
        for way in ((1.0, 0.0, 0.0), (1.0, 1.0, 1.0), (-1.0, 2.0, 0.5)):
            shift = 0.03 * factor * np.array(way) / np.linalg.norm(way)
            goal = PositionGoal(TIP, pose.translation + shift, tolerance=0.03)
            excess = goal.excess(kinematics, Q, REST)
            assert (np.abs(excess).max() == 0.0) == inside
            if not inside:
                assert np.abs(excess).max() == pytest.approx(3e-5, rel=0.01)


def test_tolerance_of_a_pose_is_an_angle(
    pose: pin.SE3, kinematics: RobotKinematics
) -> None:
    for angle, inside in ((0.199, True), (0.201, False)):
        axis = np.array([1.0, -2.0, 1.0]) / np.sqrt(6.0)
        turned = pin.SE3(pose.rotation @ pin.exp3(angle * axis), pose.translation)
        goal = PoseGoal(TIP, turned, angle_tolerance=0.2)
        assert (np.abs(goal.excess(kinematics, Q, REST)).max() < 1e-9) == inside


def test_residual_of_axis_goal_has_the_angle_as_its_norm(
    pose: pin.SE3, kinematics: RobotKinematics
) -> None:
    towards = pose.rotation @ np.array([0.0, 0.0, 1.0])
    other = np.cross(towards, [1.0, 0.0, 0.0])
    other /= np.linalg.norm(other)
    for angle in (0.0, 1e-9, 1e-4, 0.01, 1.0, 3.0, np.pi):
        direction = np.cos(angle) * towards + np.sin(angle) * other
        goal = AxisGoal(TIP, (0, 0, 7.0), 0.2 * direction)
        value = goal.place(kinematics, Q).value
        assert np.linalg.norm(value) == pytest.approx(angle, abs=1e-9)
        excess = replace(goal, angle_tolerance=0.5).excess(kinematics, Q, REST)
        assert (np.abs(excess).max() > 0.0) == (angle > 0.5)


def test_axis_goal_opposite_to_its_direction_has_a_descent_direction(
    pose: pin.SE3, kinematics: RobotKinematics
) -> None:
    goal = AxisGoal(TIP, (1, 0, 0), -pose.rotation[:, 0])
    value, jacobian = goal.place_residual(kinematics, Q)
    assert np.linalg.norm(value) == pytest.approx(np.pi, abs=1e-6)
    assert np.all(np.isfinite(jacobian))
    step = -1e-3 * jacobian.T @ value
    assert np.linalg.norm(goal.place_residual(kinematics, Q + step)[0]) < np.pi - 1e-3


def test_rotation_about_a_free_axis_gives_no_excess(
    pose: pin.SE3, kinematics: RobotKinematics
) -> None:
    for angle in (1.0, 3.0):
        about = pin.SE3(pin.exp3(np.array([0.0, 0.0, angle])), np.zeros(3))
        goal = RegionGoal(
            TIP, [0] * 3, [0] * 3, pose * about, angle_tolerance=(0.01, 0.01, np.pi)
        )
        np.testing.assert_allclose(goal.excess(kinematics, Q, REST), 0.0, atol=1e-9)


def test_misses_name_joints_and_frames(
    pose: pin.SE3, kinematics: RobotKinematics
) -> None:
    goal = AllGoals(
        [
            JointRegionGoal(Q[1:2] + 0.5, 0.1, ["shoulder_lift_joint"]),
            AxisGoal(TIP, (1, 0, 0), pose.rotation[:, 0], pose.translation),
        ]
    )
    missed = goal.misses(kinematics, Q, REST + 0.3)
    assert missed[0].name == "joint shoulder_lift_joint"
    assert missed[0].amount == pytest.approx(0.4)
    assert [item.unit for item in missed[:6]] == ["rad"] * 3 + ["m"] * 3
    assert {item.name for item in missed[1:6]} == {f"frame {TIP}"}
    moving = [item for item in missed if item.moving]
    assert len(moving) == 6
    assert all(item.amount == 0.3 and item.unit == "rad/s" for item in moving)
    frame = goal_of("position moving", pose).misses(kinematics, Q, REST)
    assert [item.unit for item in frame if item.moving] == ["m/s"] * 3


# Sets


def test_any_goal_is_measured_by_its_nearest_alternative(
    pose: pin.SE3, kinematics: RobotKinematics
) -> None:
    far, near = PositionGoal(TIP, (0.1, 0.1, 0.9)), JointGoal(Q + 0.01)
    goal = AnyGoal([far, AnyGoal([near])])
    assert goal.alternatives == (far, near)
    np.testing.assert_allclose(
        goal.excess(kinematics, Q, REST), near.excess(kinematics, Q, REST)
    )
    assert goal.residual(kinematics, Q, REST).value.size == 12
    assert goal.misses(kinematics, Q, REST)[0].amount == pytest.approx(0.01)
    assert near.alternatives == (near,)


def test_any_goal_leaves_out_unreachable_alternatives(ur5: Robot) -> None:
    far = PositionGoal(TIP, (5.0, 0.0, 0.0))
    goal = AnyGoal([far, JointGoal(Q), JointGoal([9.0, 0, 0, 0, 0, 0])])
    with pytest.warns(TominpmpWarning, match=r"left out") as found:
        problem = Problem(ur5, 0.5 * Q, goal)
    assert [str(w.message)[:11] for w in found] == ["goal 1 of 3", "goal 3 of 3"]
    assert problem.goal.alternatives == (JointGoal(Q),)
    with pytest.raises(ProblemError, match=r"goal 1 of 2: .*reach.*; goal 2 of 2: "):
        Problem(ur5, 0.5 * Q, AnyGoal([far, far]))


def test_alternatives_of_a_problem_share_their_checker(ur5: Robot) -> None:
    scene = Scene([Sphere("ball", radius=0.1, position=(3, 0, 0))])
    goals = (JointGoal(Q), JointGoal(Q - 0.1))
    problem = Problem(ur5, 0.5 * Q, AnyGoal(goals), scene, margin=0.01)
    one, other = problem.alternatives
    assert (one.goal, other.goal) == goals
    assert one.checker is other.checker is problem.checker
    assert other == Problem(ur5, 0.5 * Q, goals[1], scene, margin=0.01)
    assert one.alternatives == (one,)


def test_all_goals_need_goals_at_rest(pose: pin.SE3) -> None:
    one = PositionGoal(TIP, pose.translation)
    assert AllGoals([one, AllGoals([one])]).members == (one, one)
    with pytest.raises(ProblemError, match="JointGoal, expected goals on frames"):
        AllGoals([JointGoal(Q)])
    with pytest.raises(ProblemError, match="velocity v, expected goals at rest"):
        AllGoals([replace(one, v=(0.1, 0, 0))])


@pytest.mark.parametrize("make", [AnyGoal, AllGoals])
@pytest.mark.parametrize(
    ("goals", "message"),
    [
        ([], r"is \[\], expected a list of goals, at least one"),
        (JointGoal(Q), "is .*JointGoal.*, expected a list"),
        (None, "is None"),
        ([JointGoal(Q), Q], r"goals\[1\] is array.*, expected a goal"),
    ],
)
def test_bad_sets_of_goals_are_refused(make: type, goals: object, message: str) -> None:
    with pytest.raises(ProblemError, match=message):
        make(goals)


def test_any_goal_refuses_alternatives_of_unlike_final_velocities(
    pose: pin.SE3,
) -> None:
    goals = [PositionGoal(TIP, pose.translation, (1, 0, 0)), JointGoal(Q)]
    with pytest.raises(
        ProblemError, match="some of the goals fix the final joint velocity"
    ):
        AnyGoal(goals)


# Values and checks


@kinds
def test_goals_are_equal_by_value(kind: str, pose: pin.SE3, ur5: Robot) -> None:
    goal = goal_of(kind, pose)
    goal.validate(ur5)
    assert goal == goal_of(kind, pose)
    assert hash(goal) == hash(goal_of(kind, pose))
    assert pickle.loads(pickle.dumps(goal)) == goal
    assert [k for k, g in every_goal(pose).items() if g == goal] == [kind]


BAD: dict[str, tuple[Callable[[], Goal], str]] = {
    "negative": (lambda: PositionGoal(TIP, Q[:3], tolerance=-1), r"tolerance .*>= 0"),
    "nan": (lambda: PositionGoal(TIP, Q[:3], tolerance=np.nan), r"goal\.tolerance"),
    "text": (
        lambda: PositionGoal(TIP, Q[:3], tolerance="1"),  # type: ignore[arg-type]
        r"goal\.tolerance",
    ),
    "any angle": (
        lambda: PoseGoal(TIP, pin.SE3.Identity(), angle_tolerance=3.2),
        r"goal\.angle_tolerance is 3.2, .* < 3.142 \[rad\]",
    ),
    "no axis": (lambda: AxisGoal(TIP, (0, 0, 0), (0, 0, 1)), r"goal\.axis"),
    "no direction": (lambda: AxisGoal(TIP, (0, 0, 1), (0, 0)), r"goal\.direction"),
    "swapped": (lambda: RegionGoal(TIP, (0, 1, 0), (1, 0, 1)), "along y"),
    "at infinity": (lambda: RegionGoal(TIP, [np.inf] * 3, [np.inf] * 3), "along x"),
    "anywhere": (lambda: RegionGoal(TIP, [-np.inf] * 3, [np.inf] * 3), "no condition"),
    "no pose": (
        lambda: RegionGoal(TIP, Q[:3], Q[:3], pose=np.eye(3)),
        "expected a pinocchio.SE3",
    ),
    "angles": (
        lambda: RegionGoal(TIP, Q[:3], Q[:3], angle_tolerance=(1, -1, 1)),
        r"goal\.angle_tolerance",
    ),
    "two angles": (
        lambda: RegionGoal(TIP, Q[:3], Q[:3], angle_tolerance=(1, 1)),
        r"goal\.angle_tolerance",
    ),
    "twice": (lambda: JointRegionGoal([1, 2], 0, ["a", "a"]), "different"),
    "one name": (lambda: JointRegionGoal([1], 0, "elbow"), r"goal\.joints"),
    "lengths": (lambda: JointRegionGoal([1, 2], 0, ["a"]), "2 numbers, expected 1"),
    "tolerances": (lambda: JointRegionGoal([1, 2], [1, 2, 3]), r"goal\.tolerance"),
    "below": (lambda: JointRegionGoal([1, 2], [1, -2]), r"goal\.tolerance"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_values_are_refused(case: str) -> None:
    make, message = BAD[case]
    with pytest.raises(ProblemError, match=message):
        make()


def test_goals_that_do_not_fit_the_robot_are_refused(ur5: Robot) -> None:
    with pytest.raises(JointNotFound, match="there is no joint 'elbow'"):
        JointRegionGoal([1.0], 0.0, ["elbow"]).validate(ur5)
    with pytest.raises(ProblemError, match="1 number, expected 6"):
        JointRegionGoal([1.0]).validate(ur5)
    with pytest.raises(ProblemError, match="'elbow_joint' is 8 rad, outside"):
        Problem(ur5, Q, JointRegionGoal([9.0], 1.0, ["elbow_joint"]))
    with pytest.raises(FrameNotFound):
        AllGoals([AxisGoal("hand", (1, 0, 0), (1, 0, 0))]).validate(ur5)
    with pytest.raises(ProblemError, match=r"outside reach by"):
        Problem(ur5, Q, RegionGoal(TIP, (3, -9, -9), (9, 9, 9)))
    far = PositionGoal(TIP, (0, 3, 0), tolerance=2.5)
    assert Problem(ur5, Q, far).goal == far
    with pytest.raises(ProblemError, match=r"outside reach by"):
        Problem(ur5, Q, AllGoals([replace(far, tolerance=0.5)]))


def test_joint_range_beyond_a_limit_ends_at_the_limit(
    kinematics: RobotKinematics,
) -> None:
    top = float(kinematics.robot.limits.position_upper[2])
    goal = JointRegionGoal([top + 0.05], 0.2, ["elbow_joint"])
    place = goal.place(kinematics, np.full(6, top))
    assert place.value[0] + place.upper[0] >= 0.0
    assert place.lower[0] == pytest.approx(-0.15)


# Planning


@pytest.mark.parametrize("method", ["inverse", "collocation", "adjoint"])
def test_plan_uses_the_tolerance_of_its_goal(method: str, planar3r: Robot) -> None:
    """The tip stops where it enters the ball of the tolerance, in each method."""
    q = np.array([0.5, 1.7, -1.7])
    kinematics = RobotKinematics(planar3r)
    centre = kinematics.placement(q + 0.2, "tip").translation
    quick = {"effort": "quick", "refine": None}
    options = Options(method=method, intervals=12, starts=1, **quick)
    exact = plan(Problem(planar3r, q, PositionGoal("tip", centre)), options)
    goal = PositionGoal("tip", centre, tolerance=0.3)
    loose = plan(Problem(planar3r, q, goal), options)
    assert exact.feasible
    assert loose.feasible
    assert loose.T < 0.95 * exact.T
    assert loose.trajectory is not None
    end = kinematics.placement(loose.trajectory.q[-1], "tip").translation
    assert np.linalg.norm(end - centre) == pytest.approx(0.3, abs=1e-4)


@pytest.mark.parametrize(
    ("goal", "error"),
    [
        (JointGoal(Q[:3]), ProblemError),
        (PositionGoal("nope", [0.3, 0.2, 0.4]), FrameNotFound),
    ],
)
def test_errors_of_a_goal_in_a_set_name_the_goal(
    ur5: Robot, goal: Goal, error: type[Exception]
) -> None:
    with pytest.raises(error, match=r"^goal 2 of 2: "):
        Problem(ur5, Q, AnyGoal([JointGoal(Q), goal]))
