"""The inverse transcription: rows, Jacobian, exactness of the spline."""

from __future__ import annotations

import numpy as np
import pytest

import tominpmp as tm
from tominpmp.transcription.exchange import Extra
from tominpmp.transcription.grid import interval_shares
from tominpmp.transcription.inverse import InverseTranscription
from tominpmp.transcription.spline_rows import Instants
from tominpmp.transcription.system import System

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


def build(problem, rng, *, intervals=7, free=False, extra=None):
    system = System.of(problem)
    shares = np.eye(intervals) if free else interval_shares("cosine", intervals)
    nlp = InverseTranscription(system, shares, 1.0, extra)
    points = np.array(START) + 0.3 * rng.normal(size=(intervals, 3))
    points[0] = START
    v_end = system.final_velocity
    if v_end is None:
        v_end = 0.2 * rng.normal(size=3)
    eta = rng.uniform(0.1, 0.3, intervals) if free else np.array([1.3])
    return nlp, nlp.pack(points, v_end, eta)


@pytest.mark.parametrize("name", PROBLEMS)
@pytest.mark.parametrize("free", [False, True])
def test_jacobian_against_differences(name, free):
    rng = np.random.default_rng(1)
    more = Instants(np.array([0, 3, 6]), np.array([0.3, 0.5, 0.8]))
    extra = Extra(torque=more, clearance=more)
    nlp, z = build(PROBLEMS[name], rng, free=free, extra=extra)
    steps = nlp.step_bounds(z, 10.0)
    linearization = nlp.linearize(z, nlp.evaluate(z), steps)
    analytic = linearization.matrix.toarray()
    step = 1e-6
    for i in range(3, nlp.size):  # the first point is the start and does not move
        shift = np.zeros(nlp.size)
        shift[i] = step
        up, down = nlp.evaluate(z + shift), nlp.evaluate(z - shift)
        expected = (up - down)[linearization.rows] / (2 * step)
        scale = max(1.0, float(np.abs(expected).max()))
        np.testing.assert_allclose(analytic[:, i], expected, atol=1e-6 * scale)


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


def test_points_bound_the_curve():
    """Position limits on the points hold on the whole curve (convex hull)."""
    nlp, z = build(PROBLEMS["joint goal"], np.random.default_rng(3))
    motion = nlp.trajectory(z)
    points = nlp.spline(z).points
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


def test_overloaded_instants_are_found_between_the_nodes():
    nlp, z = build(PROBLEMS["joint goal"], np.random.default_rng(5))
    found = nlp.inspect(z, 1e-3).torque
    motion = nlp.trajectory(z)
    t = motion.t[found.interval] + found.share * np.diff(motion.t)[found.interval]
    load = np.abs(motion(t).u) / nlp.system.problem.robot.limits.effort_upper
    assert found.interval.size > 0
    assert np.all(load.max(axis=1) > 1.0 + 1e-3)
    extra = Extra(torque=found)
    more = nlp.with_rows(extra).with_rows(extra)
    assert more.rows.size == nlp.rows.size + 2 * 3 * found.interval.size


def test_closest_instants_are_found_between_the_rows():
    # A thin post between two instants that are rows.
    post = tm.Scene([tm.Sphere("post", radius=0.01, position=(2.0, 2.2, 0.0))])
    problem = planar(tm.JointGoal((1.5, 0.5, 0.5)), scene=post)
    nlp, z = build(problem, np.random.default_rng(8), intervals=6)
    system = nlp.system
    q = np.linspace(START, (1.5, 0.5, 0.5), 6)
    z[: q.size] = q.ravel()
    at = nlp.inspect(z, 1e-3).clearance
    missing = system.clearance.values(at.states(nlp.spline(z))[0])
    dense = Instants(np.repeat(np.arange(6), 400), np.tile(np.linspace(0, 1, 400), 6))
    worst = system.clearance.values(dense.states(nlp.spline(z))[0]).max()
    assert at.size > 0
    assert np.all(missing.max(axis=1) > 1e-6)
    assert missing.max() > 0.5 * worst
    more = nlp.with_rows(Extra(clearance=at))
    assert more.rows.size == nlp.rows.size + at.size * system.clearance.count
    assert more.inspect(z, 1e-3).clearance.size < at.size


def test_variation_is_the_jumps_of_acceleration():
    nlp, z = build(PROBLEMS["joint goal"], np.random.default_rng(6))
    variation = nlp.variation(z)
    values = (variation.matrix @ z + variation.offset).reshape(-1, 3)
    jumps = np.diff(nlp.trajectory(z).a, axis=0)
    ratio = values / jumps
    # Each joint is scaled by its own range, which does not depend on time.
    np.testing.assert_allclose(ratio, np.broadcast_to(ratio[0], ratio.shape))
    assert np.all(ratio > 0)


def test_stretching_keeps_the_path():
    nlp, z = build(PROBLEMS["joint goal"], np.random.default_rng(7))
    slow, fast = nlp.trajectory(nlp.stretch(z, 2.0)), nlp.trajectory(z)
    np.testing.assert_allclose(slow.q, fast.q)
    np.testing.assert_allclose(slow.t, 2 * fast.t)
    np.testing.assert_allclose(slow.a, fast.a / 4)


@pytest.mark.parametrize("intervals", [4, 7, 8, 40, 75])
@pytest.mark.parametrize("kind", ["uniform", "cosine"])
def test_shares_add_up(kind, intervals):
    shares = interval_shares(kind, intervals)
    assert shares.shape == (intervals, 1)
    assert shares.sum() == pytest.approx(1.0)
    assert np.all(shares > 0)
    np.testing.assert_allclose(shares, shares[::-1])
