"""`explain`: the messages of failed plans, with the reason and suggestions."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from optimum_cases import ROD
from sample_arms import DOWNWARD, make_arm

from tominpmp.dynamics import RobotDynamics
from tominpmp.goals.frames import PositionGoal
from tominpmp.goals.joints import JointGoal
from tominpmp.motion.trajectory import Trajectory
from tominpmp.motion_limits import EffortCurve, MotionLimits
from tominpmp.options import Options
from tominpmp.planner.candidate import Candidate
from tominpmp.planner.conclusion import conclude
from tominpmp.planner.plan_state import PlanState
from tominpmp.problem.problem import Problem
from tominpmp.problem.segments import Segment
from tominpmp.robot.payload import Payload
from tominpmp.robot.robot import Robot
from tominpmp.scene.obstacles import Sphere
from tominpmp.scene.scene import Scene
from tominpmp.status import Status
from tominpmp.stopping import Stop
from tominpmp.verification.diagnosis import CUT_SHORT, explain

TRIED = (2, 4)


def smooth(robot: Robot, begin: np.ndarray, end: np.ndarray, T: float) -> Trajectory:
    """A cubic from rest to rest with the torques that it takes."""
    share = np.linspace(0.0, 1.0, 21)[:, None]
    q = begin + (end - begin) * share**2 * (3.0 - 2.0 * share)
    v = (end - begin) * 6.0 * share * (1.0 - share) / T
    inverse = RobotDynamics(robot).inverse
    draft = Trajectory(robot.joint_names, T * share[:, 0], q, v, 0.0 * q)
    u = inverse(q, v, draft(draft.t).a)
    return replace(draft, u=u, inverse_dynamics=inverse)


def test_torque_violation_is_found_on_its_segment() -> None:
    """Regression: the end of the whole motion was examined, with another payload.

    The payload was that of another segment.
    """
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
    found = explain(problem, motion, Status.INFEASIBLE, TRIED)
    assert "on segment 1" in found and "joint joint2 would need" in found


def test_message_has_the_excess_torque_and_its_time() -> None:
    arm = make_arm(ROD, effort=2.0)
    motion = smooth(arm, np.zeros(1), np.ones(1), 0.8)
    problem = Problem(arm, np.zeros(1), JointGoal(np.ones(1)))
    found = explain(problem, motion, Status.TIME_LIMIT, TRIED)
    # The torque is 6 / T^2 times the inertia of 1/3, at both ends.
    assert "joint joint1 would need 3.1" in found
    assert "N m at 0.00 s, 2 allowed" in found or "N m at 0.80 s, 2" in found
    assert found.startswith("The planning time was used up")
    assert "after 2 starts and 4 iterations. In the nearest motion found, " in found
    assert "What may help: stronger motors, or less load or friction." in found
    first = explain(problem, motion, Status.TIME_LIMIT, (1, 2))
    assert "after 1 start and 2 iterations" in first
    assert "What may help" not in first  # the first start was not finished


def test_message_regards_the_weaker_direction_of_a_motor() -> None:
    """Regression: the message had the larger of both limits, not the exceeded limit."""
    arm = make_arm(ROD, effort=50.0)
    arm = replace(arm, limits=replace(arm.limits, effort_lower=np.array([-2.0])))
    motion = smooth(arm, np.zeros(1), np.ones(1), 0.8)
    problem = Problem(arm, np.zeros(1), JointGoal(np.ones(1)))
    found = explain(problem, motion, Status.TIME_LIMIT, TRIED)
    assert "joint joint1 is 1.1" in found
    assert "N m beyond its effort limit at 0.800 s" in found


def test_excess_over_an_effort_curve_is_not_added_to_the_plain_limit() -> None:
    arm = make_arm(ROD, effort=2.0)
    motion = smooth(arm, np.zeros(1), np.ones(1), 0.8)
    curve = EffortCurve([0.0, 10.0], [0.5, 0.5])
    limits = MotionLimits(effort_curves={"joint1": curve})
    problem = Problem(arm, np.zeros(1), JointGoal(np.ones(1)), motion_limits=limits)
    message = explain(problem, motion, Status.TIME_LIMIT, TRIED)
    assert "joint joint1 is 2.6" in message and "N m beyond its effort" in message
    assert "allowed" not in message


def test_message_has_the_missing_clearance_and_its_pair(planar3r: Robot) -> None:
    planar3r = planar3r.with_changes(effort=1e4, velocity=100.0)
    begin, end = np.array([0.3, 0.0, 0.0]), np.array([1.9, 0.0, 0.0])
    at = 6.5 * np.array([np.cos(1.1), np.sin(1.1), 0.0])
    scene = Scene([Sphere("post", radius=0.2, position=at)])
    problem = Problem(planar3r, begin, JointGoal(end), scene=scene, margin=0.5)
    motion = smooth(planar3r, begin, end, 3.0)
    found = explain(problem, motion, Status.INFEASIBLE, TRIED)
    assert re.search(r"link3 and post lack 0\.\d+ m of clearance at 1\.\d+ s", found)
    assert "What may help: more clearance there, a smaller margin" in found


def test_message_has_the_distance_to_the_goal() -> None:
    arm = make_arm(ROD, ROD, effort=50.0)
    motion = smooth(arm, np.zeros(2), np.array([0.5, 0.0]), 2.0)
    problem = Problem(arm, np.zeros(2), JointGoal(np.array([0.5, 0.3])))
    found = explain(problem, motion, Status.STALLED, TRIED)
    assert "joint joint2 ends 0.3 rad from the goal" in found
    goal = PositionGoal("tip", np.array([0.0, 2.0, 0.0]))
    found = explain(replace(problem, goal=goal), motion, Status.STALLED, TRIED)
    assert "frame tip ends 1.7" in found
    assert found.startswith("The iteration made no more progress")


@pytest.mark.parametrize("status", list(Status))
def test_message_without_a_motion_is_that_of_the_status(status: Status) -> None:
    arm = make_arm(ROD, effort=2.0)
    problem = Problem(arm, np.zeros(1), JointGoal(np.ones(1)))
    sentence = status.value
    if status in CUT_SHORT:
        sentence = f"{CUT_SHORT[status]}: no motion was found."
    assert explain(problem, None, status, (0, 0)) == sentence


def test_message_says_that_a_motion_is_nearly_feasible() -> None:
    arm = make_arm(ROD, effort=50.0)
    motion = smooth(arm, np.zeros(1), np.ones(1), 1.0)
    problem = Problem(arm, np.zeros(1), JointGoal(np.ones(1)))
    found = explain(problem, motion, Status.ITERATION_LIMIT, TRIED)
    assert "within 0.1 % of the limits" in found


def test_dry_friction_at_a_reversal_is_not_an_acceleration_violation() -> None:
    """Regression: torques just before a reversal were assigned to a state after it."""
    arm = make_arm(ROD, effort=5.0).with_changes(friction=1.0)
    t = np.array([[0.0], [1.3]])
    state = {"q": t**2 - 0.7 * t, "v": 2.0 * t - 0.7, "a": np.full((1, 1), 2.0)}
    motion = Trajectory(arm.joint_names, t[:, 0], u=0.0 * t, **state)
    motion = motion.with_torques(RobotDynamics(arm).inverse)
    limits = MotionLimits(acceleration=2.5)
    goal = JointGoal([1.0], v=state["v"][-1])
    problem = Problem(arm, [0.0], goal, motion_limits=limits, v_start=state["v"][0])
    found = explain(problem, motion, Status.TIME_LIMIT, TRIED)
    assert "joint joint1 ends 0." in found
    assert "acceleration" not in found


def test_message_without_time_to_examine_a_motion_names_its_violation(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Regression: it said that no motion was found, and nothing about the reason."""

    def no_time(*_: object) -> None:
        raise Stop(requested=False)

    monkeypatch.setattr("tominpmp.verification.diagnosis._violations_of", no_time)
    arm = make_arm(ROD, effort=2.0)
    problem = Problem(arm, np.zeros(1), JointGoal(np.ones(1)))
    motion = smooth(arm, np.zeros(1), np.ones(1), 0.8)
    violations = {"goal": 0.01, "torque": 0.6}
    state = PlanState(problem, Options())
    failed = Candidate(Status.TIME_LIMIT, False, motion, motion, violations)
    state.candidates.append(failed)
    solution = conclude(state, Status.TIME_LIMIT)
    assert "has its largest violation in the torque." in solution.message
