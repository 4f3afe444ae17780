"""Torques just before a stop have the dry friction of the motion until then.

Regression: a joint that is brought to rest with a bounded jerk is slower than rounding
can resolve in the last microseconds. The sign of its velocity was then taken from the
acceleration, which is opposite before a stop, so that the torque was off by twice the
dry friction.
"""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from sample_arms import DOWNWARD, make_arm, rod

import tominpmp as tm
from tominpmp.certificate.motion import GridMotion
from tominpmp.dynamics import RobotDynamics
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.verification.replay import torque_pieces

# Other files test the search for the best motion.
plan_quickly = partial(tm.plan, effort="quick", refine=None)

FRICTION = np.array([2.0, 1.5])
# Displacements of the joints [rad]; times from an end, down to microseconds [s].
DISPLACEMENT = np.array([0.3, -0.002])
BEFORE = np.array([1e-4, 2e-5, 5e-6, 1e-6])


def arm() -> tm.Robot:
    return make_arm(
        rod(2.0, 0.5),
        rod(1.0, 0.4),
        effort=[40.0, 15.0],
        gravity=DOWNWARD,
        friction=FRICTION,
    )


def from_rest_to_rest(degree: int, robot: tm.Robot) -> tm.Trajectory:
    """A motion of one second, whose acceleration is bounded or zero at its ends."""
    t = np.concatenate([[0.0, 1e-3], np.linspace(0.1, 0.9, 9), [0.999, 1.0]])
    s = t[:, None]
    q, v, a = (
        DISPLACEMENT * (s**3 / 3 - s**4 / 2 + s**5 / 5),
        DISPLACEMENT * (s - s**2) ** 2,
        DISPLACEMENT * 2 * (s - s**2) * (1 - 2 * s),
    )
    if degree == 2:
        a = np.sign(DISPLACEMENT) * np.where(s[1:] <= 0.5, 1.0, -1.0) * 1e-4
        h = np.diff(t)[:, None]
        v = np.vstack([0.0 * DISPLACEMENT, np.cumsum(h * a, axis=0)])
        v[-1] = 0.0
        steps = h * v[:-1] + 0.5 * h**2 * a
        q = np.vstack([0.0 * DISPLACEMENT, np.cumsum(steps, axis=0)])
    inverse = RobotDynamics(robot).inverse
    at_nodes = a if len(a) == len(t) else np.vstack([a, a[-1:]])
    u = inverse(q, v, at_nodes)
    accelerations = None if degree == 3 else a
    return tm.Trajectory(robot.joint_names, t, q, v, u, accelerations, inverse)


@pytest.mark.parametrize("degree", [2, 3, 5])
def test_friction_opposes_the_motion_until_its_end(degree: int) -> None:
    robot = arm()
    motion = from_rest_to_rest(degree, robot)
    after, before = BEFORE, motion.duration - BEFORE
    free = RobotDynamics(robot, dry=False).inverse
    for times in (after, before):
        state = motion(times)
        dry = state.u - free(state.q, state.v, state.a)
        # Nearly at rest, friction may be zero; it never has the opposite sign.
        still = (np.abs(state.v) < 1e-6) & (np.abs(state.a) < 1e-6)
        expected = np.broadcast_to(FRICTION * np.sign(DISPLACEMENT), dry.shape)
        assert np.allclose(dry[~still], expected[~still], atol=1e-7)
        assert np.all(dry * expected >= -1e-7)
        assert not np.all(still[1:])


@pytest.mark.parametrize("degree", [2, 3, 5])
def test_replayed_torques_have_the_same_friction(degree: int) -> None:
    robot = arm()
    motion = from_rest_to_rest(degree, robot)
    times = np.concatenate([BEFORE, 0.5 - BEFORE, 0.5 + BEFORE, 1.0 - BEFORE])
    curve = torque_pieces(robot, motion)(times)
    free = RobotDynamics(robot, dry=False).inverse
    dry = curve - free(*motion(times)[:3])
    assert np.allclose(dry, FRICTION * np.sign(DISPLACEMENT), atol=1e-7)


def test_friction_changes_sign_exactly_at_a_reversal_on_a_node() -> None:
    robot = arm()
    inverse = RobotDynamics(robot).inverse
    t = np.array([0.0, 1.0, 2.0])
    a = np.array([[-1e-4, 2e-4], [-1e-4, 2e-4]])
    v = np.array([[1e-4, -2e-4], [0.0, 0.0], [-1e-4, 2e-4]])
    q = np.array([[0.0, 0.0], [5e-5, -1e-4], [0.0, 0.0]])
    u = inverse(q, v, np.vstack([a, a[-1:]]))
    motion = tm.Trajectory(robot.joint_names, t, q, v, u, a, inverse)
    state = motion(np.array([1.0 - 1e-7, 1.0, 1.0 + 1e-7]))
    dry = state.u - RobotDynamics(robot, dry=False).inverse(*state[:3])
    assert np.allclose(dry / FRICTION, [[1, -1], [-1, 1], [-1, 1]], atol=1e-7)


def test_friction_of_a_planned_motion_does_not_jump_before_a_stop() -> None:
    robot = arm()
    problem = tm.Problem(
        robot,
        [-1.6, 0.0],
        tm.JointGoal([-1.4, 0.05]),
        motion_limits=tm.MotionLimits(acceleration=2.0, jerk=20.0),
    )
    motion = plan_quickly(problem).raise_if_failed().trajectory
    assert motion is not None
    state = motion(motion.duration - np.array([4e-5, 2e-5, 1e-5, 5e-6, 2e-6, 1e-6]))
    dry = state.u - RobotDynamics(robot, dry=False).inverse(*state[:3])
    still = (np.abs(state.v) < 1e-6) & (np.abs(state.a) < 1e-6)
    assert np.any((np.abs(state.v) < 1e-10) & ~still)
    # A joint nearly at rest may have the friction of its motion, or no friction.
    moving = np.isclose(dry, FRICTION * np.sign(dry[0]), atol=1e-7)
    assert np.all(moving | (still & np.isclose(dry, 0.0, atol=1e-7)))


def test_certificate_has_the_acceleration_before_the_stop() -> None:
    """Regression: at the end of a motion, the certificate had the accelerations of the
    opposite friction.
    """
    problem = tm.Problem(arm(), [-1.6, 0.0], tm.JointGoal([-1.3, 0.001]))
    solution = plan_quickly(problem, method="collocation").raise_if_failed()
    motion = solution.trajectory
    assert motion is not None
    assert motion.inverse_dynamics is None
    seen = GridMotion.of(ProblemFunctions.of(problem), motion)
    found = seen.states(seen.instants(0.0, 1.0)).a[-2:]
    cubic = motion(motion.duration).a
    assert np.allclose(found, cubic, rtol=1e-3, atol=1e-3 * np.abs(cubic).max())
