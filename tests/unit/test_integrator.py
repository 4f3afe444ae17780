"""Radau IIA integrator: order, stiffness, sensitivities, divergence."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from rollout_derivatives import differentiate_rollout
from scipy.integrate import solve_ivp
from toy_dynamics import Pendulum, double_integrator

from tominpmp.dynamics import RobotDynamics
from tominpmp.robot.robot import Robot
from tominpmp.transcription.integrator import SteppedMotion, rollout

# Two joints: one swings, the other is heavily damped.
SWING = Pendulum([0.5, 0.2], [0.1, 2.0], [3.0, 1.0])
# Friction as in some robot descriptions: the time constant is 0.02 ms.
STIFF = Pendulum([1e-3], [50.0], [0.1])


def sample(dynamics, rng, intervals=6):
    x = rng.normal(size=2 * dynamics.n)
    u = rng.normal(size=(intervals, dynamics.n))
    return x, u, rng.uniform(0.02, 0.1, intervals)


def reference(dynamics, x, u, h):
    for torque, length in zip(u, h, strict=True):
        solution = solve_ivp(
            lambda _, y, torque=torque: dynamics.forward(y[None], torque[None])[0],
            (0.0, length),
            x,
            method="Radau",
            rtol=1e-11,
            atol=1e-12,
        )
        x = solution.y[:, -1]
    return x


def test_motion_of_a_free_mass_under_constant_torque_is_exact():
    x, u, h = np.array([0.3, -0.2]), np.array([[2.0], [-1.0]]), np.array([0.5, 2.0])
    motion = rollout(double_integrator(), x, u, h)
    v1 = -0.2 + 2.0 * 0.5
    q1 = 0.3 - 0.2 * 0.5 + 0.5 * 2.0 * 0.5**2
    expected = [[0.3, -0.2], [q1, v1], [q1 + 2.0 * v1 - 0.5 * 2.0**2, v1 - 2.0]]
    np.testing.assert_allclose(motion.x, expected, atol=1e-13)


def test_error_falls_with_the_third_power_of_the_step(rng):
    x, u, h = sample(SWING, rng)
    exact = reference(SWING, x, u, h)
    errors = [
        np.abs(rollout(SWING, x, u, h, substeps).x[-1] - exact).max()
        for substeps in (2, 4, 8)
    ]
    assert errors[0] > 1e-8  # far above the error of the reference
    for coarse, fine in pairwise(errors):
        assert 6.5 < coarse / fine < 9.5


def test_velocity_under_stiff_friction_is_where_torques_balance():
    u = np.array([[5.0], [-5.0], [2.0]])
    h = np.full(3, 0.05)  # 2500 time constants
    motion = rollout(STIFF, np.array([0.2, 1.0]), u, h)
    assert motion.finite
    # The velocity is where torque and friction balance, whatever it was before.
    balance = (u[:, 0] - 0.1 * np.sin(motion.x[1:, 0])) / 50.0
    np.testing.assert_allclose(motion.x[1:, 1], balance, rtol=2e-2)
    moved = np.diff(motion.x[1:, 0])
    np.testing.assert_allclose(moved, h[1:] * balance[1:], rtol=2e-2)


def test_rollout_agrees_with_the_condensed_stages(rng, planar3r: Robot):
    """A rollout has no defects, and its inner stages are the condensed stages."""
    dynamics = RobotDynamics(planar3r)
    x, u, h = sample(dynamics, rng, 12)
    motion = rollout(dynamics, x, u, h)
    condensed = SteppedMotion(dynamics, motion.x, u, h)
    assert condensed.stage.solved.all()
    np.testing.assert_allclose(condensed.inner, motion.inner, atol=1e-10)
    np.testing.assert_allclose(condensed.defects, 0.0, atol=1e-10)


@pytest.mark.parametrize("change", [1e-6, 0.02, 0.5])
def test_warm_start_does_not_change_the_rollout(rng, planar3r: Robot, change):
    dynamics = RobotDynamics(planar3r)
    x, u, h = sample(dynamics, rng, 20)
    before = rollout(dynamics, x, u, h, 2)
    u = u + change * rng.normal(size=u.shape)
    cold = rollout(dynamics, x, u, 1.01 * h, 2)
    warm = rollout(dynamics, x, u, 1.01 * h, 2, before)
    np.testing.assert_allclose(warm.x, cold.x, atol=1e-10)
    np.testing.assert_allclose(warm.inner, cold.inner, atol=1e-10)


@pytest.mark.parametrize("substeps", [1, 3])
def test_sensitivities_match_finite_differences(rng, planar3r: Robot, substeps):
    dynamics = RobotDynamics(planar3r)
    x, u, h = sample(dynamics, rng, 1)
    motion = rollout(dynamics, x, u, h, substeps)
    by = differentiate_rollout(motion)

    def end(x, u, h):
        return rollout(dynamics, x, u, h, substeps).x[-1]

    step = 1e-5
    for analytic, function, size in (
        (by.A[0], lambda d: end(x + d, u, h), x.size),
        (by.B[0], lambda d: end(x, u + d, h), u.shape[1]),
        (by.c[0][:, None], lambda d: end(x, u, h + d), 1),
    ):
        columns = [
            (function(step * e) - function(-step * e)) / (2 * step)
            for e in np.eye(size)
        ]
        expected = np.stack(columns, axis=1)
        scale = max(1.0, np.abs(expected).max())
        np.testing.assert_allclose(analytic, expected, atol=1e-6 * scale)


def test_substeps_equal_shorter_intervals(rng):
    """Two substeps of an interval equal two intervals of half its length."""
    x, u, h = sample(SWING, rng, 3)
    whole = rollout(SWING, x, u, h, 2)
    halves = rollout(SWING, x, np.repeat(u, 2, axis=0), np.repeat(h / 2, 2))
    np.testing.assert_allclose(whole.x, halves.x[::2], atol=1e-12)
    one, two = differentiate_rollout(whole), differentiate_rollout(halves)
    np.testing.assert_allclose(one.A, two.A[1::2] @ two.A[::2], atol=1e-12)
    np.testing.assert_allclose(
        one.B, two.A[1::2] @ two.B[::2] + two.B[1::2], atol=1e-12
    )
    carried = (two.A[1::2] @ two.c[::2][..., None])[..., 0]
    np.testing.assert_allclose(one.c, 0.5 * (carried + two.c[1::2]), atol=1e-12)


def test_diverging_motion_is_marked_as_not_finite():
    class Diverging(Pendulum):
        """Accelerates with the square of its speed: infinite after a finite time."""

        def forward(self, x, u):
            return np.concatenate([x[:, 1:], 1.0 + x[:, 1:] ** 2], axis=1)

        def forward_jacobians(self, x, u):
            by = super().forward_jacobians(x, u)
            by.f_x[:, 1, 0] = 0.0
            by.f_x[:, 1, 1] = 2.0 * x[:, 1]
            return by

    diverging = Diverging([1.0], [0.0], [0.0])
    motion = rollout(diverging, np.zeros(2), np.zeros((40, 1)), np.full(40, 0.1))
    assert not motion.finite
    assert np.isfinite(motion.x[:10]).all()  # up to pi / 2
    assert np.isnan(motion.x[-1]).all()
    ends = np.array([[0.0, 5.0], [1.0, 4.0]])
    stage = SteppedMotion(diverging, ends, np.zeros((1, 1)), np.array([2.0])).stage
    assert not stage.solved.any()
    assert np.isfinite(stage.x).all()
