"""Lower bounds on the motion time: valid for each motion, and tight for simple arms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from optimum_cases import FORCE, MASS, ROD
from replays import replay
from sample_arms import DOWNWARD, Link, make_arm, rod, slide
from two_link_cases import CASES as FAMILIES

from tominpmp.bounds.energy import gravity_bounds
from tominpmp.bounds.lower_bound import lower_bound
from tominpmp.bounds.result import LowerBound
from tominpmp.collision.placements import JointPlacements
from tominpmp.exceptions import ProblemError
from tominpmp.goals.base import Goal
from tominpmp.goals.frames import AxisGoal, PoseGoal, PositionGoal, RegionGoal
from tominpmp.goals.joints import JointGoal, JointRegionGoal
from tominpmp.goals.sets import AllGoals, AnyGoal
from tominpmp.kinematics import RobotKinematics
from tominpmp.motion.trajectory import Trajectory
from tominpmp.motion_limits import MotionLimits
from tominpmp.options import Options
from tominpmp.planner.planning import plan
from tominpmp.problem.problem import Problem
from tominpmp.robot.robot import Robot
from tominpmp.solution import Solution
from tominpmp.status import Status

# Without most arms that lift payloads, whose optima take long to compute.
CASES = {
    name: case
    for family, cases in FAMILIES.items()
    for name, case in cases.items()
    if family != "vertical" or name == "vertical rods"
}


@pytest.mark.parametrize("name", CASES)
def test_bound_is_no_larger_than_the_known_optimum(name: str) -> None:
    case = CASES[name]
    found = lower_bound(case.problem())
    assert 0.0 < found.T <= case.minimum
    if name.startswith("rail"):
        # One mass: the bound is the optimum, with friction too.
        assert case.minimum <= found.T * (1.0 + 1e-6)
        assert found.joint == "joint1"


@pytest.mark.parametrize(
    ("name", "share"), [("pendulum, lift", 0.89), ("pendulum, upright", 0.75)]
)
def test_bound_of_a_pendulum_under_gravity_is_near_the_optimum(
    name: str, share: float
) -> None:
    case = CASES[name]
    assert lower_bound(case.problem()).T >= share * case.minimum


def thrown(
    robot: Robot, torques: np.ndarray, T: float, start: np.ndarray
) -> Problem | None:
    """A problem that given torques solve in the time T; None if limits are broken."""
    n = robot.n
    t = np.linspace(0.0, T, len(torques) + 1)
    u = np.concatenate([torques, torques[-1:]])
    rest = np.zeros((t.size, n))
    motion = Trajectory(robot.joint_names, t, rest, rest, u)
    # At a goal that is passed in motion the arm need not hold itself.
    moving = np.full(n, 1e-12)
    goal = JointGoal(start[:n], moving)
    problem = Problem(robot, start[:n], goal, v_start=start[n:])
    end = replay(problem, motion)
    assert end.complete
    limits = robot.limits
    if np.any((end.q < limits.position_lower) | (end.q > limits.position_upper)):
        return None
    return replace(problem, goal=JointGoal(end.q[-1], end.v[-1] + moving))


ARMS = {
    "pendulum": lambda: make_arm(ROD, effort=8.0, gravity=DOWNWARD, damping=0.3),
    "mass": lambda: make_arm(slide(2.0), effort=np.array([(-4.0, 9.0)]), damping=2.0),
    "rotors": lambda: make_arm(
        *[Link(0.4, 0.3, 0.1)] * 3, effort=3.0, armature=np.array([1.0, 0.5, 0.2])
    ),
    "rotors, damped, upright": lambda: make_arm(
        *[Link(0.4, 0.3, 0.1)] * 2,
        effort=9.0,
        armature=np.array([1.0, 0.5]),
        damping=0.5,
        gravity=DOWNWARD,
    ),
}


@pytest.mark.parametrize("name", ARMS)
def test_no_random_motion_beats_the_bound(name: str, rng: np.random.Generator) -> None:
    robot = ARMS[name]()
    limits, positive, tightest = robot.limits, 0, 0.0
    for _ in range(12):
        T = float(rng.uniform(0.05, 0.6))
        # Mostly full torques, as the fastest motions have them.
        share = np.clip(1.5 * rng.uniform(-1.0, 1.0, (3, robot.n)), -1.0, 1.0)
        middle = 0.5 * (limits.effort_upper + limits.effort_lower)
        half = 0.5 * (limits.effort_upper - limits.effort_lower)
        still = float(rng.uniform() < 0.5)
        start = np.concatenate(
            [rng.uniform(-1.5, 1.5, robot.n), still * rng.normal(size=robot.n)]
        )
        problem = thrown(robot, middle + half * share, T, start)
        if problem is None:
            continue
        found = lower_bound(problem)
        assert found.T <= T * (1.0 + 1e-6)
        positive += found.T > 0.0
        tightest = max(tightest, found.T / T)
    assert positive >= 8
    assert tightest > 0.2


@settings(max_examples=30, deadline=None)
@given(
    st.floats(-2.0, 2.0),
    st.floats(-1.5, 1.5),
    st.floats(-1.5, 1.5),
    st.floats(0.3, 3.0),
    st.floats(0.3, 3.0),
    st.floats(1.5, 6.0),
)
def test_bound_of_a_mass_is_symmetric_in_space_and_time(
    way: float, v0: float, v1: float, up: float, down: float, top: float
) -> None:
    def bound(way: float, begin: float, end: float, ahead: float, back: float) -> float:
        robot = make_arm(slide(1.0), effort=np.array([[-back, ahead]]), velocity=top)
        goal = JointGoal([way], [end])
        return lower_bound(Problem(robot, [0.0], goal, v_start=[begin])).T

    T = bound(way, v0, v1, up, down)
    assert bound(way, v0, v1, 2 * up, 2 * down) <= T * (1.0 + 1e-6)
    assert T >= abs(v1 - v0) / max(up, down) * (1.0 - 1e-2) - 2e-3
    assert T >= abs(way) / top * (1.0 - 1e-6) - 1e-12
    mirrored = bound(-way, -v0, -v1, down, up)
    assert mirrored == pytest.approx(T, rel=1e-6, abs=1e-9)
    turned = bound(way, v1, v0, down, up)
    assert turned == pytest.approx(T, rel=1e-6, abs=1e-9)


def test_bound_by_speed_limits_is_that_of_the_slowest_joint() -> None:
    robot = make_arm(ROD, ROD, ROD, effort=1e3, velocity=np.array([1.0, 2.0, 3.0]))
    problem = Problem(robot, np.zeros(3), JointGoal(np.array([1.0, 2.4, 1.0])))
    found = lower_bound(problem)
    assert (found.T, found.joint) == (pytest.approx(1.2), "joint2")
    assert "2.4 rad to go" in found.reason
    limits = MotionLimits(acceleration=4.0)
    slower = lower_bound(replace(problem, motion_limits=limits))
    assert slower.T == pytest.approx(1.2 + 0.5)
    assert (
        slower.reason == "joint joint2 has 2.4 rad to go, at 2 rad/s, 4 rad/s^2 at most"
    )


@pytest.mark.parametrize(
    ("limits", "v", "T"),
    [
        (MotionLimits(acceleration=2.0), (1.0, -0.5, 0.2), 0.5),
        (MotionLimits(acceleration=4.0, jerk=40.0), (2.0, 1.0, -1.0), 0.6),
        (MotionLimits(acceleration=4.0, jerk=4.0), (1.0, -1.0, 0.0), 1.0),
    ],
)
def test_bound_of_a_stop_is_the_time_of_braking(
    limits: MotionLimits, v: tuple[float, ...], T: float
) -> None:
    """Regression: the bound was zero if the goal includes the start of the motion."""
    robot = make_arm(ROD, ROD, ROD, effort=1e3, velocity=3.0)
    anywhere = JointRegionGoal(np.zeros(3), 3.0)
    problem = Problem(robot, np.zeros(3), anywhere, v_start=v, motion_limits=limits)
    found = lower_bound(problem)
    assert found.T == pytest.approx(T, rel=1e-8)
    assert found.reason.startswith("joint joint1 has 0 rad to go from ")


@pytest.mark.parametrize("kind", [PositionGoal, PoseGoal])
def test_no_straight_motion_beats_the_bound_of_a_frame_goal(
    kind: type, planar3r: Robot, rng: np.random.Generator
) -> None:
    robot = planar3r.with_changes(velocity=np.array([1.0, 2.0, 3.0]))
    kinematics, limits = RobotKinematics(robot), robot.limits
    best = 0.0
    for _ in range(4):
        q = rng.uniform(limits.position_lower, limits.position_upper)
        sign = np.where(
            q > 0.5 * (limits.position_lower + limits.position_upper), -1, 1
        )
        T = float(rng.uniform(0.1, 0.5))
        end = q + sign * rng.uniform(0.7, 1.0, 3) * limits.velocity * T
        place = kinematics.placement(end, "tip")
        goal = PoseGoal("tip", place)
        if kind is PositionGoal:
            goal = PositionGoal("tip", place.translation)
        found = lower_bound(Problem(robot, q, goal))
        assert found.T <= T
        assert found.joint is None
        best = max(best, found.T / T)
    assert best > 0.5


def test_bound_of_a_goal_region_is_the_time_to_its_edge(planar3r: Robot) -> None:
    robot = planar3r.with_changes(velocity=np.array([1.0, 2.0, 3.0]))
    q = np.array([0.5, 0.0, 0.0])

    def bound(goal: Goal) -> float:
        return lower_bound(Problem(robot, q, goal)).T

    first, second = robot.joint_names[:2]
    near = JointRegionGoal(np.array([1.0]), 0.1, joints=[first])
    far = JointRegionGoal(np.array([2.0]), 0.1, joints=[second])
    assert bound(near) == pytest.approx(0.4)
    assert bound(far) == pytest.approx(0.95)
    assert bound(AnyGoal([near, far])) == pytest.approx(0.4)
    assert bound(AllGoals([near, far])) == pytest.approx(0.95)
    # The frame points along the stretched arm, and its joints turn it by 6 rad/s.
    beside = np.array([np.cos(0.5 + 1.2), np.sin(0.5 + 1.2), 0.0])
    axis = AxisGoal("tip", np.array([1.0, 0.0, 0.0]), beside)
    assert bound(axis) == pytest.approx(0.2)
    wide = replace(axis, angle_tolerance=0.6)
    assert bound(wide) == pytest.approx(0.1)
    point = PositionGoal("tip", np.array([0.0, 5.0, 0.0]))
    exact, loose = bound(point), bound(replace(point, tolerance=1.0))
    assert 0.0 < loose < exact
    box = RegionGoal("tip", np.array([-9.0, 4.0, -1.0]), np.array([9.0, 9.0, 1.0]))
    assert 0.0 < bound(box) < loose
    here = RegionGoal("tip", np.array([-9.0, 0.0, -1.0]), np.array([9.0, 9.0, 1.0]))
    assert bound(here) == 0.0


def test_displacements_of_link_points_stay_within_their_bound(
    rng: np.random.Generator,
) -> None:
    arm = make_arm(ROD, slide(1.0), rod(1.0, 0.6), effort=1.0)
    joint = arm.model.njoints - 1
    point, radius = np.array([0.6, 0.1, 0.2]), 0.05
    ball = np.array([joint]), point[None], np.array([radius])
    middle, half = rng.uniform(-1.0, 1.0, (40, 3)), rng.uniform(0.0, 0.8, (40, 3))
    moved = JointPlacements(arm.model).displacements(middle, half, *ball)
    bound = np.sum(moved, axis=2)[:, 0]
    kinematics, largest = RobotKinematics(arm), np.zeros(40)
    for _ in range(25):
        q = middle + half * rng.uniform(-1.0, 1.0, (40, 3)).round()
        offset = rng.normal(size=3)
        offset *= radius / np.linalg.norm(offset)
        for k in range(40):
            places = [kinematics.placement(x[k], "link3") for x in (middle, q)]
            moved = places[1].act(point + offset) - places[0].act(point + offset)
            largest[k] = max(largest[k], float(np.linalg.norm(moved)))
    assert np.all(largest <= bound * (1.0 + 1e-9))
    assert np.max(largest / bound) > 0.5


def test_gravity_torques_stay_within_their_bounds(rng: np.random.Generator) -> None:
    arm = make_arm(
        rod(1.0, 1.0), rod(0.5, 0.7), slide(0.8), effort=9.0, gravity=DOWNWARD
    )
    weight, data = gravity_bounds(arm), arm.model.createData()
    largest = np.zeros(3)
    for q in rng.uniform(-np.pi, np.pi, (200, 3)):
        held = pin.computeGeneralizedGravity(arm.model, data, q)
        largest = np.maximum(largest, np.abs(held))
    assert np.all(largest <= weight * (1.0 + 1e-12))
    assert np.all(largest > 0.4 * weight)


def test_work_of_torques_bounds_the_time_of_arms_with_rotor_inertia() -> None:
    links = [Link(0.4, 0.3, 0.1)] * 3
    problem = Problem(
        make_arm(*links, effort=3.0, armature=np.array([1.0, 0.5, 0.2])),
        np.zeros(3),
        JointGoal([1.0, -0.5, 0.4]),
    )
    found = lower_bound(problem)
    assert found.reason == "no torques carry the arm there sooner"
    solution = plan(problem)
    assert 0.2 * solution.T < found.T < solution.T
    # If a joint has no rotor inertia, only speed limits give a bound.
    light = problem.robot.with_changes(armature=np.array([1.0, 0.5, 0.0]))
    assert "to go" in lower_bound(replace(problem, robot=light)).reason


@pytest.mark.parametrize("known", [0.0, -1.0, np.nan, "long"])
def test_invalid_known_time_is_named_in_the_error(known: object) -> None:
    with pytest.raises(ProblemError, match="known"):
        lower_bound(CASES["rods"].problem(), known=known)  # type: ignore[arg-type]


def test_bound_does_not_exceed_the_known_time(planar3r: Robot) -> None:
    goal = PositionGoal("tip", np.array([0.0, 5.0, 0.0]))
    problem = Problem(planar3r, np.array([0.5, 0.0, 0.0]), goal)
    free = lower_bound(problem).T
    assert lower_bound(problem, known=0.5 * free).T == pytest.approx(0.5 * free)
    assert 0.95 * free < lower_bound(problem, known=1.1 * free).T <= 1.1 * free


def test_gap_is_the_excess_of_the_motion_over_the_bound() -> None:
    robot = make_arm(slide(MASS), effort=FORCE)
    problem = Problem(robot, np.zeros(1), JointGoal(np.ones(1)))
    nodes, rest = np.array([0.0, 1.2]), np.zeros((2, 1))
    motion = Trajectory(robot.joint_names, nodes, rest, rest, rest)
    solution = Solution(problem, Options(), Status.CONVERGED, "", True, motion)
    assert solution.gap is None
    bounded = replace(solution, lower_bound=LowerBound(1.0, "so it is"))
    assert bounded.gap == pytest.approx(0.2)
    assert replace(bounded, lower_bound=LowerBound(0.0, "no bound")).gap is None
    assert replace(bounded, trajectory=None).gap is None
    # A bound is useful from half of T on.
    assert bounded.lower_bound is not None
    assert bounded.lower_bound.useful(2.0) and not bounded.lower_bound.useful(2.01)


def test_bounds_below_half_the_duration_are_left_out_of_messages() -> None:
    bound = LowerBound(1.0, "so it is")
    assert bound.comparison(1.05) == "5.0 % above the lower bound"
    assert bound.comparison(1.0 - 1e-5) == "0.0 % above the lower bound"
    assert bound.comparison(2.0) == "100.0 % above the lower bound"
    assert bound.comparison(2.01) == ""
    assert bound.comparison(np.inf) == ""
    assert bound.in_words(1.95) == "1.0000 s (so it is)"
    assert bound.in_words(2.05) == "no useful bound"
    for T in (0.0, 1.0):
        assert LowerBound(0.0, "nothing").comparison(T) == ""
        assert LowerBound(0.0, "nothing").in_words(T) == "no useful bound"
