"""The inverse transcription: rows, row exchange, exactness of the spline."""

from __future__ import annotations

import numpy as np
import pytest

import tominpmp as tm
from tominpmp.transcription.bspline import InverseTranscription
from tominpmp.transcription.exchange import exchanged
from tominpmp.transcription.grid import interval_shares
from tominpmp.transcription.instants import Instants
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import NonlinearProgram

OBSTACLE = tm.Scene([tm.Sphere("O", radius=0.8, position=(4, 0, 0))])
START = (0.5, 1.7, -1.7)


def planar(goal, **kwargs):
    return tm.Problem(tm.load_robot("planar3r"), START, goal, **kwargs)


PROBLEMS = {
    "position goal, obstacle": planar(
        tm.PositionGoal("tip", (4, 1, 0)), scene=OBSTACLE, margin=0.05
    ),
    "moving start and goal": planar(
        tm.JointGoal((0.5, 1, 1), v=(0.1, 0.2, 0.3)), v_start=(0.1, -0.2, 0.3)
    ),
    "tip velocity": planar(
        tm.PositionGoal("tip", (4, 1, 0), v=(1, 0, 0)), v_start=(0.1, 0.2, 0.3)
    ),
    "joint goal": planar(tm.JointGoal((0.5, 1, 1))),
}


def build(problem, rng, *, intervals=7, free=False):
    system = ProblemFunctions.of(problem)
    shares = np.eye(intervals) if free else interval_shares("cosine", intervals)
    nlp = InverseTranscription(system, shares, 1.0)
    points = np.array(START) + 0.3 * rng.normal(size=(intervals, 3))
    end = points[-1] + 0.02 * rng.normal(size=3)
    eta = rng.uniform(0.1, 0.3, intervals) if free else np.array([1.3])
    z = nlp.unknowns(np.vstack([START, points, end]), eta)
    return NonlinearProgram.of(nlp).at(z), z


def block_of(nlp, kind):
    return next(block for block in nlp.blocks if block.name == kind)


def added(more, nlp, kind):
    """Instants that a row exchange added to the rows of a kind."""
    before, after = block_of(nlp, kind).fixed, block_of(more, kind).fixed
    np.testing.assert_array_equal(after.interval[: before.size], before.interval)
    np.testing.assert_array_equal(after.share[: before.size], before.share)
    return Instants(after.interval[before.size :], after.share[before.size :])


@pytest.mark.parametrize("name", PROBLEMS)
def test_trajectory_is_an_exact_double_integrator(name):
    nlp, z = build(PROBLEMS[name], np.random.default_rng(2), free=True)
    motion = nlp.trajectory(z)
    h = np.diff(motion.t)[:, None]
    np.testing.assert_allclose(np.diff(motion.v, axis=0), h * motion.a, atol=1e-12)
    np.testing.assert_allclose(
        np.diff(motion.q, axis=0),
        h * motion.v[:-1] + 0.5 * h**2 * motion.a,
        atol=1e-12,
    )
    np.testing.assert_allclose(motion.q[0], START)
    np.testing.assert_allclose(motion.v[0], PROBLEMS[name].v_start)
    assert motion.duration == pytest.approx(nlp.cost @ z)


def test_control_points_bound_the_curve():
    """Position limits on the points hold on the whole curve (convex hull)."""
    nlp, z = build(PROBLEMS["joint goal"], np.random.default_rng(3))
    motion = nlp.trajectory(z)
    points = nlp.transcription.motion(z).derivative(0)
    q = motion(np.linspace(0, motion.duration, 2000)).q
    low, high = points.min(axis=0), points.max(axis=0)
    ends = motion.q[[0, -1]]
    assert np.all(q >= np.minimum(low, ends.min(axis=0)) - 1e-12)
    assert np.all(q <= np.maximum(high, ends.max(axis=0)) + 1e-12)


def test_torque_rows_are_the_torques_of_the_motion():
    nlp, z = build(PROBLEMS["joint goal"], np.random.default_rng(4))
    motion = nlp.trajectory(z)
    rows = nlp.evaluate(z)[: 2 * 7 * 3].reshape(2, 7, 3)
    limits = nlp.system.problem.robot.limits
    after = motion(motion.t[:-1]).u / limits.effort_upper
    before = motion(motion.t[1:] - 1e-13).u / limits.effort_upper
    np.testing.assert_allclose(rows[0], after, atol=1e-9)
    np.testing.assert_allclose(rows[1], before, atol=1e-7)


def test_row_exchange_finds_overloaded_instants_between_nodes():
    nlp, z = build(PROBLEMS["joint goal"], np.random.default_rng(5))
    more = exchanged(nlp, z, 1e-3)
    found = added(more, nlp, "torque")
    motion = nlp.trajectory(z)
    t = motion.t[found.interval] + found.share * np.diff(motion.t)[found.interval]
    load = np.abs(motion(t).u) / nlp.system.problem.robot.limits.effort_upper
    assert found.interval.size > 0
    assert np.all(load.max(axis=1) > 1.0 + 1e-3)
    # No instant is found twice.
    assert len(set(zip(found.interval, found.share, strict=True))) == found.size
    assert more.rows.size == nlp.rows.size + 3 * found.size
    rows = more.evaluate(z)[more.rows.kind == more.rows.kinds.index("torque")]
    expected = motion(t).u / nlp.system.problem.robot.limits.effort_upper
    np.testing.assert_allclose(rows[-expected.size :], expected.ravel(), atol=1e-9)


def test_row_exchange_finds_small_clearances_between_rows():
    # A thin post between two instants that are rows.
    post = tm.Scene([tm.Sphere("post", radius=0.01, position=(2.0, 2.2, 0.0))])
    problem = planar(tm.JointGoal((1.5, 0.5, 0.5)), scene=post)
    nlp, z = build(problem, np.random.default_rng(8), intervals=6)
    system = nlp.system
    q = np.linspace(START, (1.5, 0.5, 0.5), 6)
    z = nlp.transcription.unknowns(np.vstack([q[:1], q, q[-1:]]), z[-1:])
    # With an infinite tolerance the exchange adds no torque rows.
    more = exchanged(nlp, z, np.inf)
    at = added(more, nlp, "clearance")
    motion = nlp.transcription.motion(z)

    def clearances(instants):
        return system.clearance.values(nlp.transcription.states(motion, instants, 0).q)

    missing = clearances(at)
    dense = Instants(np.repeat(np.arange(6), 400), np.tile(np.linspace(0, 1, 400), 6))
    worst = clearances(dense).max()
    assert at.size > 0
    assert np.all(missing.max(axis=1) > 1e-6)
    assert missing.max() > 0.5 * worst
    assert more.rows.size == nlp.rows.size + at.size * system.clearance.count
    again = exchanged(more, z, np.inf)
    assert again is None or added(again, more, "clearance").size < at.size


def test_variation_is_proportional_to_jumps_of_acceleration():
    nlp, z = build(PROBLEMS["joint goal"], np.random.default_rng(6))
    variation = nlp.transcription.variation(z)
    values = (variation.matrix @ z + variation.offset).reshape(-1, 3)
    jumps = np.diff(nlp.trajectory(z).a, axis=0)
    ratio = values / jumps
    # Each joint is scaled by its own range, which does not depend on time.
    np.testing.assert_allclose(ratio, np.broadcast_to(ratio[0], ratio.shape))
    assert np.all(ratio > 0)


def test_time_scaling_keeps_the_path():
    nlp, z = build(PROBLEMS["joint goal"], np.random.default_rng(7))
    slow, fast = nlp.trajectory(nlp.time_scale(z, 2.0)), nlp.trajectory(z)
    np.testing.assert_allclose(slow.q, fast.q)
    np.testing.assert_allclose(slow.t, 2 * fast.t)
    np.testing.assert_allclose(slow.a, fast.a / 4)


@pytest.mark.parametrize("intervals", [4, 7, 8, 40, 75])
@pytest.mark.parametrize("kind", ["uniform", "cosine"])
def test_interval_shares_are_symmetric_and_sum_to_one(kind, intervals):
    shares = interval_shares(kind, intervals)
    assert shares.shape == (intervals, 1)
    assert shares.sum() == pytest.approx(1.0)
    assert np.all(shares > 0)
    np.testing.assert_allclose(shares, shares[::-1])


def test_clearances_out_of_reach_of_a_step_are_only_bounded():
    nlp, z = build(PROBLEMS["position goal, obstacle"], np.random.default_rng(3))
    mine = nlp.rows.kind == nlp.rows.kinds.index("clearance")
    exact = nlp.evaluate(z)
    attention = nlp.attention(nlp.step_bounds(z, 1e-2))
    assert 0.0 < attention < nlp.attention(nlp.step_bounds(z, 0.3))
    for room in (0.0, attention, 0.04):
        found = nlp.evaluate(z, room)
        near = exact[mine] > -room
        np.testing.assert_allclose(found[mine][near], exact[mine][near], atol=1e-7)
        assert np.all(found[mine] >= exact[mine] - 1e-7)
        assert np.all(found[mine][~near] <= -room + 1e-7)
        np.testing.assert_array_equal(found[~mine], exact[~mine])
        assert np.array_equal(
            nlp.rows.violation(found) > 1e-6, nlp.rows.violation(exact) > 1e-6
        )


def test_all_clearances_are_exact_with_moving_obstacles():
    aside = tm.ConstantVelocity(velocity=(0.0, 0.3, 0.0))
    ball = tm.Sphere("O", radius=0.8, position=(4, 0, 0), motion=aside)
    problem = planar(tm.JointGoal((0.5, 1, 1)), scene=tm.Scene([ball]))
    nlp, z = build(problem, np.random.default_rng(3))
    assert nlp.attention(nlp.step_bounds(z, 1e-2)) == np.inf
