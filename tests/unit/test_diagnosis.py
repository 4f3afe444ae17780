"""Reasons for failed plans, in words."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from optimum_cases import ROD
from sample_arms import DOWNWARD, make_arm

from tominpmp.dynamics import RobotDynamics
from tominpmp.goals.frames import PositionGoal
from tominpmp.goals.joints import JointGoal
from tominpmp.motion.trajectory import Trajectory
from tominpmp.motion_limits import EffortCurve, MotionLimits
from tominpmp.problem.problem import Problem
from tominpmp.problem.segments import Segment
from tominpmp.robot.payload import Payload
from tominpmp.robot.robot import Robot
from tominpmp.scene.obstacles import Sphere
from tominpmp.scene.scene import Scene
from tominpmp.status import IterationRecord, Status
from tominpmp.verification.diagnosis import GAVE_UP, explain

RECORD = IterationRecord(0, 1.0, 0.1, 1.0, 0.0, 0.0, 1.0, True, 1, 1, 0.0, 0.0)


@dataclass(frozen=True)
class Outcome:
    """What an initial guess led to."""

    trajectory: Trajectory
    violations: dict[str, float] = field(default_factory=lambda: {"torque": 1.0})
    history: tuple[IterationRecord, ...] = (RECORD, RECORD)


def smooth(robot: Robot, begin: np.ndarray, end: np.ndarray, T: float) -> Trajectory:
    """A cubic from rest to rest with the torques that it takes."""
    share = np.linspace(0.0, 1.0, 21)[:, None]
    q = begin + (end - begin) * share**2 * (3.0 - 2.0 * share)
    v = (end - begin) * 6.0 * share * (1.0 - share) / T
    inverse = RobotDynamics(robot).inverse
    draft = Trajectory(robot.joint_names, T * share[:, 0], q, v, 0.0 * q)
    u = inverse(q, v, draft(draft.t).a)
    return replace(draft, u=u, inverse_dynamics=inverse)


def test_weight_that_cannot_be_held_is_named_with_both_torques() -> None:
    weak = make_arm(ROD, ROD, effort=np.array([15.0, 9.0]), gravity=DOWNWARD)
    begin, end = np.array([-1.5, 0.0]), np.zeros(2)
    motion = smooth(weak, begin, end, 4.0)
    goal = PositionGoal("tip", np.array([2.0, 0.0, 0.0]))
    found = explain(Problem(weak, begin, goal), [Outcome(motion)], Status.INFEASIBLE)
    assert "joint joint1 cannot hold its weight at the goal" in found
    assert "19.6 N m needed, 15 allowed" in found
    assert "would need" in found and "more effort of joint joint1" in found
    assert found.startswith("No motion was found that keeps all constraints")


def test_weights_are_those_at_the_goal_of_their_segment() -> None:
    """The end of the whole motion was looked at, with the load of another one."""
    arm = make_arm(ROD, ROD, effort=np.array([50.0, 9.0]), gravity=DOWNWARD)
    level, down = np.array([-1.5, 1.5]), np.array([-1.5, 0.0])
    loaded = Payload(5.0, "tip")
    segments = [
        Segment(JointGoal(down), payload=loaded, stop=True),
        Segment(JointGoal(level)),
    ]
    problem = Problem(arm, np.array([-1.7, 0.1]), segments=segments)
    q, T = np.array([[-1.7, 0.1], down, level]), np.array([0.0, 0.1, 4.0])
    motion = Trajectory(arm.joint_names, T, q, 0.0 * q, np.zeros((3, 2)))
    motion = replace(motion, segment_ends=T[1:])
    dynamics = [RobotDynamics(phase.robot).inverse for phase in problem.phases]
    motion = motion.with_torques(dynamics[0], dynamics)
    found = explain(problem, [Outcome(motion)], Status.INFEASIBLE)
    assert "on segment 1" in found and "joint joint2 would need" in found
    assert "cannot hold its weight" not in found


def test_motion_that_is_too_strong_is_told_with_its_time() -> None:
    arm = make_arm(ROD, effort=2.0)
    motion = smooth(arm, np.zeros(1), np.ones(1), 0.8)
    problem = Problem(arm, np.zeros(1), JointGoal(np.ones(1)))
    found = explain(problem, [Outcome(motion)], Status.TIME_LIMIT)
    # 6 / T^2 times the inertia of a third, at both ends.
    assert "joint joint1 would need 3.1" in found
    assert "N m at 0.00 s, 2 allowed" in found or "N m at 0.80 s, 2" in found
    assert found.startswith("Gave up when the planning time was used up")
    assert "after 1 start and 2 iterations" in found


def test_excess_over_an_effort_curve_is_not_added_to_the_plain_limit() -> None:
    arm = make_arm(ROD, effort=2.0)
    motion = smooth(arm, np.zeros(1), np.ones(1), 0.8)
    curve = EffortCurve([0.0, 10.0], [0.5, 0.5])
    limits = MotionLimits(effort_curves={"joint1": curve})
    problem = Problem(arm, np.zeros(1), JointGoal(np.ones(1)), motion_limits=limits)
    message = explain(problem, [Outcome(motion)], Status.TIME_LIMIT)
    assert "joint joint1 is 2.6" in message and "N m beyond its effort" in message
    assert "allowed" not in message


def test_overlap_is_told_where_every_start_has_it(planar3r: Robot) -> None:
    planar3r = planar3r.with_changes(effort=1e4, velocity=100.0)
    begin, end = np.array([0.3, 0.0, 0.0]), np.array([1.9, 0.0, 0.0])
    at = 5.0 * np.array([np.cos(1.1), np.sin(1.1), 0.0])
    scene = Scene([Sphere("post", radius=0.2, position=at)])
    problem = Problem(planar3r, begin, JointGoal(end), scene=scene)
    slow, slower = (smooth(planar3r, begin, end, T) for T in (2.0, 3.0))
    outcomes = [Outcome(slow), Outcome(slower)]
    found = explain(problem, outcomes, Status.INFEASIBLE)
    assert "links link" in found and "and post overlap by" in found
    assert "from every start tried" in found
    assert "cm more clearance between" in found
    assert "2 starts and 4 iterations" in found
    away = smooth(planar3r, begin, begin + 0.01, 2.0)
    other = Outcome(away, violations={"goal": 3.0})
    found = explain(problem, [Outcome(slow), other], Status.INFEASIBLE)
    assert "overlap" in found and "every start" not in found


def test_margin_that_is_missing_is_no_overlap(planar3r: Robot) -> None:
    planar3r = planar3r.with_changes(effort=1e4, velocity=100.0)
    begin, end = np.array([0.3, 0.0, 0.0]), np.array([1.9, 0.0, 0.0])
    at = 6.5 * np.array([np.cos(1.1), np.sin(1.1), 0.0])
    scene = Scene([Sphere("post", radius=0.2, position=at)])
    problem = Problem(planar3r, begin, JointGoal(end), scene=scene, margin=0.5)
    outcome = Outcome(smooth(planar3r, begin, end, 3.0))
    found = explain(problem, [outcome], Status.INFEASIBLE)
    assert "apart at" in found and "less than the margin 50 cm" in found


def test_goal_that_was_not_reached_is_told_with_its_distance() -> None:
    arm = make_arm(ROD, ROD, effort=50.0)
    motion = smooth(arm, np.zeros(2), np.array([0.5, 0.0]), 2.0)
    problem = Problem(arm, np.zeros(2), JointGoal(np.array([0.5, 0.3])))
    found = explain(problem, [Outcome(motion)], Status.STALLED)
    assert "joint joint2 comes no nearer to its goal than 0.3 rad" in found
    assert "a goal 0.3 rad nearer" in found
    goal = PositionGoal("tip", np.array([0.0, 2.0, 0.0]))
    found = explain(replace(problem, goal=goal), [Outcome(motion)], Status.STALLED)
    assert "frame tip comes no nearer to its goal than 1.7" in found
    assert found.startswith("Gave up when the iteration made no more progress")


@pytest.mark.parametrize("status", list(Status))
def test_without_an_outcome_the_end_of_the_search_is_said(status: Status) -> None:
    arm = make_arm(ROD, effort=2.0)
    problem = Problem(arm, np.zeros(1), JointGoal(np.ones(1)))
    sentence = status.value
    if status in GAVE_UP:
        sentence = f"{GAVE_UP[status]}: no motion was found."
    assert explain(problem, [], status) == sentence


def test_motion_that_is_nearly_allowed_is_told_as_such() -> None:
    arm = make_arm(ROD, effort=50.0)
    motion = smooth(arm, np.zeros(1), np.ones(1), 1.0)
    problem = Problem(arm, np.zeros(1), JointGoal(np.ones(1)))
    found = explain(problem, [Outcome(motion)], Status.ITERATION_LIMIT)
    assert "within 0.1 % of the limits" in found


def test_dry_friction_of_a_reversal_is_no_acceleration() -> None:
    """Torques just before a reversal were assigned to a state after it."""
    arm = make_arm(ROD, effort=5.0).with_changes(friction=1.0)
    t = np.array([[0.0], [1.3]])
    state = {"q": t**2 - 0.7 * t, "v": 2.0 * t - 0.7, "a": np.full((1, 1), 2.0)}
    motion = Trajectory(arm.joint_names, t[:, 0], u=0.0 * t, **state)
    motion = motion.with_torques(RobotDynamics(arm).inverse)
    limits = MotionLimits(acceleration=2.5)
    goal = JointGoal([1.0], v=state["v"][-1])
    problem = Problem(arm, [0.0], goal, motion_limits=limits, v_start=state["v"][0])
    found = explain(problem, [Outcome(motion)], Status.TIME_LIMIT)
    assert "joint joint1 comes no nearer to its goal than" in found
    assert "acceleration" not in found
