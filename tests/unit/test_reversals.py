"""Reversals of joints with dry friction at a node, beside it, at an end, or
simultaneously.

Rounding leaves a velocity of about 1e-9 rad/s at a node where a joint reverses: the
polynomial beside it passes through zero a fraction of a nanosecond from the node.
Regression: the torque for that fraction had the acceleration of one side and the
friction of the other: 32 N m for a motor of 30.
"""

from __future__ import annotations

import numpy as np
import pytest
from sample_arms import make_arm, slide
from scipy.interpolate import PPoly

import tominpmp as tm
from tominpmp.arrays import Array
from tominpmp.dynamics import RobotDynamics
from tominpmp.motion.trajectory import torque_breaks
from tominpmp.motion.turns import SAME, Turns
from tominpmp.transcription.collocation import CollocationTranscription
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.verification.replay import torque_pieces

FRICTION = np.array([2.0, 1.0])
MASSES = np.array([3.0, 1.0])  # that the rails of the cross table move
FORCE = np.array([30.0, 10.0])
# Velocities that rounding leaves at a node, in place of zero [m/s].
RESIDUAL_VELOCITIES = [0.0, 1e-17, -1e-17, 5e-9, -5e-9, 9e-7, -9e-7]
# Time offsets from an instant [s].
OFFSETS = np.array([1e-13, 1e-11, 1e-10, 1e-9, 1e-8, 1e-6, 1e-3])
DEGREES = [2, 3, 5]


@pytest.fixture(scope="module")
def table() -> tm.Robot:
    return make_arm(
        slide(2.0), slide(1.0, (0.0, 1.0, 0.0)), effort=FORCE, friction=FRICTION
    )


def motion_of(
    robot: tm.Robot, t: Array, v: Array, degree: int, a: Array | None = None
) -> tm.Trajectory:
    """A motion whose velocities are linear between its nodes.

    The default accelerations at the nodes are those of the second interval.
    """
    t, v = np.asarray(t, dtype=float), np.asarray(v, dtype=float)
    h = np.diff(t)[:, None]
    q = np.vstack([0.0 * v[:1], np.cumsum(0.5 * h * (v[:-1] + v[1:]), axis=0)])
    steps = np.diff(v, axis=0) / h
    if a is None:
        a = np.repeat(steps[1:2], len(t), axis=0)
    accelerations = {2: steps, 3: None, 5: a}[degree]
    draft = tm.Trajectory(robot.joint_names, t, q, v, 0.0 * q, accelerations)
    return draft.with_torques(RobotDynamics(robot).inverse)


def friction_share(robot: tm.Robot, motion: tm.Trajectory, times: Array) -> Array:
    """Dry friction in the torques of a motion, as a share of its largest value."""
    state = motion(times)
    free = RobotDynamics(robot, dry=False).inverse(state.q, state.v, state.a)
    return np.asarray((state.u - free) / FRICTION)


@pytest.mark.parametrize("residual", RESIDUAL_VELOCITIES)
@pytest.mark.parametrize("degree", DEGREES)
def test_friction_changes_sign_at_the_node_of_a_reversal(
    table: tm.Robot, degree: int, residual: float
) -> None:
    v = np.array([[-1.0, 2.0], [residual, -residual], [0.5, -1.0]])
    motion = motion_of(table, [0.0, 0.1, 0.15], v, degree)
    before = friction_share(table, motion, 0.1 - OFFSETS)
    after = friction_share(table, motion, 0.1 + np.append(0.0, OFFSETS))
    assert np.allclose(before, [-1.0, 1.0], atol=1e-6)
    assert np.allclose(after, [1.0, -1.0], atol=1e-6)
    node = MASSES * motion(0.1).a + FRICTION * [1.0, -1.0]
    assert np.allclose(motion.u[1], node, atol=1e-6)
    assert torque_breaks(motion, table.friction).tolist() == motion.t.tolist()


@pytest.mark.parametrize("residual", RESIDUAL_VELOCITIES)
def test_torques_beside_a_reversal_stay_between_those_of_its_sides(
    table: tm.Robot, residual: float
) -> None:
    """The torques are at their limit before and after the reversal, as in time-optimal
    motions.
    """
    braking, starting = (FORCE + FRICTION) / MASSES, (FORCE - FRICTION) / MASSES
    v = np.array([-0.1 * braking, [residual, residual], 0.1 * starting])
    motion = motion_of(table, [0.0, 0.1, 0.2], v, 2)
    near = np.linspace(-2.0 * abs(residual), 2.0 * abs(residual), 2001) / braking.min()
    times = 0.1 + np.concatenate([near, -OFFSETS, OFFSETS])
    assert np.all(np.abs(motion(times).u) <= FORCE * (1.0 + 1e-6))
    pieces = torque_pieces(table, motion)
    assert np.allclose(pieces.ends(), FORCE, rtol=1e-6)
    for period in (0.1, 0.001, 0.1 / 3.0):
        assert np.all(np.abs(motion.sample(period).u) <= FORCE * (1.0 + 1e-6))


@pytest.mark.parametrize("residual", RESIDUAL_VELOCITIES)
def test_friction_of_a_stop_at_a_node_has_one_sign_before_it(
    table: tm.Robot, residual: float
) -> None:
    """Regression: the torque was 32 N m of 30 for 0.14 ns before the node."""
    v = np.array([[-1.0, 1.0], [residual, 1.0], [residual / 3.0, 1.0], [0.0, 1.0]])
    motion = motion_of(table, [0.0, 0.1, 1.1, 2.1], v, 2)
    assert np.allclose(
        friction_share(table, motion, 0.1 - OFFSETS)[:, 0], -1.0, atol=1e-6
    )
    resting = abs(residual) <= 5e-9
    if resting:
        after = np.concatenate([0.1 + OFFSETS, 1.1 + OFFSETS, 1.1 - OFFSETS])
        assert np.allclose(friction_share(table, motion, after)[:, 0], 0.0, atol=1e-6)
    assert torque_breaks(motion, table.friction).tolist() == motion.t.tolist()


@pytest.mark.parametrize("degree", [2, 3])
def test_resting_joint_with_residual_velocities_has_no_friction(
    table: tm.Robot, degree: int
) -> None:
    """Regression: the friction of a resting joint changed its sign with velocities of
    1e-8 rad/s.
    """
    traces = np.array([3e-9, -1e-8, 1.9e-8, 1e-9, -2e-9, 0.0, 2e-8, -2e-8])
    t = np.concatenate([[0.0, 0.1], 0.1 + 0.004 * np.arange(1, 9), [0.2, 0.3]])
    v = np.concatenate([[-1.0, 1e-9], traces, [0.0, 1.0]])
    motion = motion_of(table, t, np.column_stack([v, 0.0 * v + 1.0]), degree)
    dense = np.linspace(0.1001, 0.1319, 500)
    assert np.all(np.abs(friction_share(table, motion, dense)[:, 0]) < 1e-6)
    assert torque_breaks(motion, table.friction).tolist() == motion.t.tolist()
    for time, way in ((0.05, -1.0), (0.0999999, -1.0), (0.21, 1.0)):
        assert np.allclose(
            friction_share(table, motion, np.array([time]))[:, 0], way, atol=1e-6
        )


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_slow_stop_and_slow_start_belong_to_their_movements(
    table: tm.Robot, side: float
) -> None:
    """A joint with a low jerk limit is slow for milliseconds without resting.

    Taken as rests, they left the torques without friction, and replays missed goals.
    """
    t = np.array([0.0, 0.1, 0.104, 0.108, 0.112, 0.2, 0.204, 0.208, 0.3])
    v = side * np.array([1.0, 9e-7, 4e-7, 1e-7, 0.0, 0.0, 3e-7, 9e-7, 1.0])
    motion = motion_of(table, t, np.column_stack([v, 0.0 * v + 1.0]), 2)
    times = np.array([0.05, 0.102, 0.106, 0.111, 0.15, 0.202, 0.206, 0.25])
    share = friction_share(table, motion, times)[:, 0]
    resting = (times > 0.112) & (times < 0.2)
    np.testing.assert_allclose(share, side * ~resting, atol=1e-3)


def test_reversal_within_microsecond_intervals_is_no_rest(table: tm.Robot) -> None:
    """Nodes may be microseconds apart; the joint passes through rest, and reverses."""
    t = np.array([0.0, 0.1, 0.1 + 1e-6, 0.1 + 2e-6, 0.2])
    v = np.array([-1.0, -8e-7, 2e-7, 9e-7, 1.0])
    motion = motion_of(table, t, np.column_stack([v, -v]), 2)
    zero = 0.1 + 0.8e-6
    assert np.allclose(motion.turns.of_joints(table.friction > 0.0), zero, atol=1e-15)
    way = friction_share(
        table, motion, np.array([0.1 - 1e-9, zero - 1e-9, zero + 1e-9])
    )
    assert np.allclose(way, np.outer([-1, -1, 1], [1, -1]), atol=1e-6)


@pytest.mark.parametrize("trace", [-2e-7, -1e-9, 1e-9, 2e-7])
@pytest.mark.parametrize("later", [0.0, 1.0])
def test_residual_velocity_over_an_interval_has_the_friction_beside_it(
    table: tm.Robot, later: float, trace: float
) -> None:
    """Regression: the torque jumped by 4 N m before a stop, for a velocity of -2e-7
    rad/s.
    """
    t = np.array([0.0, 0.1, 0.1002, 0.2 if later else 0.1003])
    v = np.array([1.0, trace, 0.5 * trace, later])
    motion = motion_of(table, t, np.column_stack([v, -v]), 2)
    assert torque_breaks(motion, table.friction).tolist() == motion.t.tolist()
    way = friction_share(table, motion, np.array([0.05, 0.1 - 1e-9, 0.1001, 0.10025]))
    assert np.allclose(way, [1.0, -1.0], atol=1e-6)


@pytest.mark.parametrize("residual", RESIDUAL_VELOCITIES)
@pytest.mark.parametrize("degree", DEGREES)
def test_friction_at_the_ends_of_a_motion_has_one_sign(
    table: tm.Robot, degree: int, residual: float
) -> None:
    """The first and the last velocity may be on either side of zero."""
    v = np.array(
        [[-residual, residual], [1.0, -1.0], [0.9, -0.9], [-residual, residual]]
    )
    t = np.array([0.0, 0.1, 0.2, 0.3])
    a = np.array([[10.0, -10.0], [0.0, 0.0], [0.0, 0.0], [-9.0, 9.0]])
    motion = motion_of(table, t, v, degree, a)
    times = np.concatenate([[0.0], OFFSETS, 0.3 - OFFSETS])
    assert np.allclose(friction_share(table, motion, times), [1.0, -1.0], atol=1e-6)
    for row, time in ((0, 0.0), (-1, 0.3 - 1e-9)):
        assert np.allclose(motion.u[row], motion(time).u, atol=1e-5)
    assert not motion.turns.of_joints(table.friction > 0.0).size


@pytest.mark.parametrize("apart", [0.0, 1e-16, 1e-14, 1e-12, 1e-11, 1e-10, 1e-9])
@pytest.mark.parametrize("degree", DEGREES)
def test_simultaneous_reversals_are_found_for_each_joint(
    table: tm.Robot, degree: int, apart: float
) -> None:
    early, late = 0.05, 0.05 + apart
    t = np.array([0.0, 0.1, 0.2])
    v = np.column_stack([t - early, late - t])
    motion = motion_of(table, t, 10.0 * v, degree)
    breaks = torque_breaks(motion, table.friction)
    assert np.isin(motion.t, breaks).all()
    assert np.all(np.diff(breaks) > 1e-13)
    assert np.allclose(breaks[1], early, rtol=0.0, atol=1e-15)
    assert breaks.size == (5 if apart > SAME * 0.2 else 4)
    assert np.allclose(
        friction_share(table, motion, early - OFFSETS), [-1.0, 1.0], atol=1e-6
    )
    assert np.allclose(
        friction_share(table, motion, late + OFFSETS), [1.0, -1.0], atol=1e-6
    )
    if apart > SAME * 0.2:
        between = friction_share(table, motion, np.array([0.5 * (early + late)]))
        assert np.allclose(between, [1.0, 1.0], atol=1e-6)
    pieces = torque_pieces(table, motion)
    ends = pieces.ends().reshape(-1, 2)
    levels = np.abs(ends - MASSES * [10.0, -10.0]) / FRICTION
    assert np.allclose(levels, 1.0, atol=1e-6)


@pytest.mark.parametrize("aside", [1e-11, 1e-9, 1e-6, 1e-3])
@pytest.mark.parametrize("degree", DEGREES)
def test_reversal_close_to_a_node_is_not_dropped(
    table: tm.Robot, degree: int, aside: float
) -> None:
    """A reversal is not dropped for being close to a node; only residual velocities
    are.
    """
    steep = 1e-5 / aside
    v = np.array([[-1.0, 0.0], [1e-5, 0.0], [1e-5 + steep * 0.1, 0.0]])
    t = np.array([0.0, 1.0 / steep + aside, 1.0 / steep + aside + 0.1])
    motion = motion_of(table, t, v, degree)
    turns = motion.turns.of_joints(table.friction > 0.0)
    assert turns.size == 1
    assert abs(t[1] - turns[0] - aside) <= 1e-3 * aside + 1e-15
    times = turns[0] + aside * np.array([-0.5, 0.5])
    assert np.allclose(
        friction_share(table, motion, times)[:, 0], [-1.0, 1.0], atol=1e-4
    )


@pytest.mark.parametrize("depth", [-1e-8, 0.0, 1e-8, 1e-7])
def test_joint_that_touches_zero_velocity_does_not_reverse(
    table: tm.Robot, depth: float
) -> None:
    """Velocities (t - 1/2)^2 less a trace have two zeros; no motion is between them."""
    t = np.array([0.0, 1.0])
    v = np.array([[0.25, 0.25], [0.25, 0.25]]) - depth
    q = np.array([[0.0, 0.0], [1 / 12 - depth, 1 / 12 - depth]])
    draft = tm.Trajectory(table.joint_names, t, q, v, 0.0 * q)
    motion = draft.with_torques(RobotDynamics(table).inverse)
    times = np.concatenate([0.5 - OFFSETS, [0.5], 0.5 + OFFSETS, [0.1, 0.9]])
    assert np.allclose(friction_share(table, motion, times), 1.0, atol=1e-6)
    assert not motion.turns.of_joints(table.friction > 0.0).size


def test_two_reversals_within_an_interval_are_found(table: tm.Robot) -> None:
    """No velocity at the nodes shows these two reversals."""
    t = np.array([0.0, 1.0])
    v = np.array([[0.21, -0.21], [0.21, -0.21]])
    # The integral of (t - 0.3) (t - 0.7), from 0 to 1.
    q = np.array([[0.0, 0.0], [1 / 3 - 0.5 + 0.21, -1 / 3 + 0.5 - 0.21]])
    draft = tm.Trajectory(table.joint_names, t, q, v, 0.0 * q)
    motion = draft.with_torques(RobotDynamics(table).inverse)
    assert np.allclose(
        motion.turns.of_joints(table.friction > 0.0), [0.3, 0.7], atol=1e-14
    )
    way = friction_share(table, motion, np.array([0.2, 0.4, 0.6, 0.8]))
    assert np.allclose(way, np.outer([1, -1, -1, 1], [1, -1]), atol=1e-6)


@pytest.mark.parametrize("K", [2, 3, 5])
def test_directions_are_the_signs_of_random_polynomials(K: int) -> None:
    """The signs agree wherever a joint is not at rest."""
    rng = np.random.default_rng(K)
    t = np.concatenate([[0.0], np.cumsum(rng.uniform(1e-9, 1.0, 200))])
    velocity = rng.normal(size=(200, 3, K)) * rng.choice([1.0, 1e-4], (200, 3, 1))
    powers = np.diff(t)[:, None] ** np.arange(K)[:, None, None]
    terms = np.moveaxis(velocity, -1, 0) / powers
    turns = Turns.of(PPoly(terms[::-1], t))
    x = rng.random(200)
    value = np.einsum("knp,kp->kn", velocity, x[:, None] ** np.arange(K))
    way = turns.at(t[:-1] + x * np.diff(t))
    clear = np.abs(value) > 1e-5
    assert clear.mean() > 0.8
    assert np.array_equal(way[clear], np.sign(value[clear]))
    # Every polynomial has opposite signs on the two sides of a reversal.
    for joint in range(3):
        own = turns.times[turns.joint == joint]
        assert np.all(turns.at(own)[:, joint] == -turns.at(own - 1e-11)[:, joint])


@pytest.mark.parametrize("residual", RESIDUAL_VELOCITIES)
def test_trajectory_from_torques_gets_no_node_beside_a_node(
    table: tm.Robot, residual: float
) -> None:
    """Motions made of torques get a node where a joint reverses: not a second node
    beside it.
    """
    v = np.array([[-1.0, 2.0], [residual, -residual], [0.5, -1.0]])
    plain = motion_of(table, [0.0, 0.1, 0.15], v, 3)
    goal = tm.JointGoal(plain.q[-1], v=plain.v[-1])
    problem = tm.Problem(table, plain.q[0], goal, v_start=plain.v[0])
    shares = np.diff(plain.t)[:, None]
    of = CollocationTranscription(ProblemFunctions.of(problem), shares, plain.duration)
    x = np.hstack([plain.q, plain.v])
    motion = of.trajectory(of.pack(x, np.zeros((2, 2)), np.ones(1)))
    assert np.allclose(motion.v, plain.v, rtol=0.0, atol=1e-12)
    assert motion.t.tolist() == [0.0, *np.cumsum(shares)]
    assert np.allclose(motion.u[:2] / FRICTION, [[-1.0, 1.0], [1.0, -1.0]])


def test_replay_verifies_a_motion_at_its_limits_with_residual_velocities(
    table: tm.Robot,
) -> None:
    """From rest to rest and back at the limits, with residual velocities at
    the nodes.
    """
    starting, braking = (FORCE - FRICTION) / MASSES, (FORCE + FRICTION) / MASSES
    share = (starting / braking)[0]
    h = np.array([0.2, 0.2 * share, 0.2, 0.2 * share])
    t = np.concatenate([[0.0], np.cumsum(h)])
    top = np.array([0.2 * starting[0], 0.0])
    v = np.array([0 * top, top, 0 * top + 3e-9, -top, 0 * top - 3e-9])
    motion = motion_of(table, t, v, 2)
    problem = tm.Problem(table, [0.0, 0.0], tm.JointGoal(motion.q[-1]))
    found = tm.verify(problem, motion)
    assert found.ok, found.message
