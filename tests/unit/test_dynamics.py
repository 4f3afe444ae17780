"""The equations of motion, inverse and forward.

`test_derivatives_problem.py` tests their derivatives.
"""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from robot_samples import chain, load, mass_matrix, one_joint

from tominpmp.dynamics import RobotDynamics
from tominpmp.robot.robot import Robot, load_robot
from tominpmp.stopping import Stop

GRAVITY = 9.81


@pytest.fixture(scope="module", params=["planar3r", "ur5", "panda", "geared panda"])
def arm(request: pytest.FixtureRequest) -> Robot:
    name = request.param
    if name != "geared panda":
        return load_robot(name)
    values = np.arange(1.0, 9.0)
    return load_robot("panda", limits="urdf", damping=values, armature=0.1 * values)


def states(
    arm: Robot, rng: np.random.Generator, m: int = 4
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    lower = np.maximum(arm.limits.position_lower, -3.0)
    upper = np.minimum(arm.limits.position_upper, 3.0)
    q = rng.uniform(lower, upper, size=(m, arm.n))
    return q, rng.normal(size=q.shape), rng.normal(size=q.shape)


# Closed forms


def test_pendulum_matches_the_closed_form(tmp_path: Path) -> None:
    """A body of 2 kg, centre at 0.5 m, inertia 0.3 kg m^2 about its centre."""
    arm = load(
        tmp_path, one_joint(), gravity=(0, -GRAVITY, 0), damping=0.7, armature=0.05
    )
    dynamics = RobotDynamics(arm)
    q, v, u = np.array([[0.0], [0.4], [-2.0]]), np.array([[0.0], [3.0], [-1.0]]), 1.5
    inertia = 0.3 + 2.0 * 0.5**2 + 0.05
    weight = 2.0 * GRAVITY * 0.5 * np.cos(q)
    a = (u - 0.7 * v - weight) / inertia
    x = np.hstack([q, v])
    found = dynamics.forward(x, np.full((3, 1), u))
    np.testing.assert_allclose(found, np.hstack([v, a]), rtol=1e-12)
    np.testing.assert_allclose(dynamics.inverse(q, v, a), u, rtol=1e-12)
    jacobians = dynamics.forward_jacobians(x, np.full((3, 1), u))
    np.testing.assert_allclose(jacobians.f_u[:, 1, 0], 1.0 / inertia, rtol=1e-12)
    np.testing.assert_allclose(jacobians.f_x[:, 1, 1], -0.7 / inertia, rtol=1e-12)


def test_prismatic_joint_matches_the_closed_form(tmp_path: Path) -> None:
    arm = load(
        tmp_path,
        one_joint(kind="prismatic"),
        gravity=(1, 2, -GRAVITY),
        damping=4.0,
        armature=0.5,
    )
    dynamics = RobotDynamics(arm)
    q, v, a = np.array([[0.3]]), np.array([[1.2]]), np.array([[-0.8]])
    force = (2.0 + 0.5) * a + 4.0 * v + 2.0 * GRAVITY
    np.testing.assert_allclose(dynamics.inverse(q, v, a), force, rtol=1e-12)
    found = dynamics.forward(np.hstack([q, v]), force)
    np.testing.assert_allclose(found, np.hstack([v, a]), rtol=1e-12)


def test_mimic_joint_adds_its_mass_and_weight_to_the_leader(tmp_path: Path) -> None:
    """Two equal sliders on one rail; the second follows at -0.5 times the first."""
    mimic = '<mimic joint="j1" multiplier="-0.5" offset="0.2"/>'
    arm = load(
        tmp_path,
        chain("", mimic, kind="prismatic"),
        gravity=(0, 0, -GRAVITY),
        damping=3.0,
    )
    dynamics = RobotDynamics(arm)
    assert dynamics.n == 1
    q, v, a = np.array([[0.3]]), np.array([[1.2]]), np.array([[-0.8]])
    # The first slider carries the second, which moves at 1 - 0.5 of its speed.
    mass = 2.0 + 2.0 * 0.5**2
    weight = GRAVITY * (2.0 + 2.0 * 0.5)
    np.testing.assert_allclose(dynamics.inverse(q, v, a), mass * a + 3.0 * v + weight)


# Invariants


def test_forward_dynamics_inverts_inverse_dynamics(
    arm: Robot, rng: np.random.Generator
) -> None:
    dynamics = RobotDynamics(arm)
    q, v, a = states(arm, rng)
    u = dynamics.inverse(q, v, a)
    found = dynamics.forward(np.hstack([q, v]), u)
    np.testing.assert_allclose(found[:, : arm.n], v, atol=0)
    np.testing.assert_allclose(found[:, arm.n :], a, rtol=1e-8, atol=1e-8)


def test_mass_matrix_matches_pinocchio(arm: Robot, rng: np.random.Generator) -> None:
    dynamics = RobotDynamics(arm)
    q, v, a = states(arm, rng)
    mass = dynamics.inverse_jacobians(q, v, a).tau_a
    np.testing.assert_array_equal(mass, np.swapaxes(mass, 1, 2))
    assert np.linalg.eigvalsh(mass).min() > 0.0
    for row, expected in zip(q, mass, strict=True):
        np.testing.assert_allclose(
            mass_matrix(arm, row), expected, rtol=1e-9, atol=1e-9
        )
    u = dynamics.inverse(q, v, a)
    f_u = dynamics.forward_jacobians(np.hstack([q, v]), u).f_u
    assert not np.any(f_u[:, : arm.n])
    identity = np.broadcast_to(np.eye(arm.n), mass.shape)
    np.testing.assert_allclose(mass @ f_u[:, arm.n :], identity, atol=1e-8)


def test_inertial_torque_is_the_part_of_the_acceleration(
    arm: Robot, rng: np.random.Generator
) -> None:
    dynamics = RobotDynamics(arm)
    q, v, a = states(arm, rng)
    found = dynamics.inertial(q, a)
    rest = dynamics.inverse(q, v, np.zeros_like(a))
    np.testing.assert_allclose(found, dynamics.inverse(q, v, a) - rest, atol=1e-10)


def test_power_equals_the_rate_of_energy_and_friction_losses(
    arm: Robot, rng: np.random.Generator
) -> None:
    """d/dt (v M v / 2 + potential energy) = u v - v D v."""
    dynamics = RobotDynamics(arm)
    data = arm.model.createData()

    def energy(q: np.ndarray, v: np.ndarray) -> float:
        potential = pin.computePotentialEnergy(arm.model, data, arm.expand(q))
        return float(0.5 * v @ mass_matrix(arm, q) @ v + potential)

    h = 1e-5
    for q, v, a in zip(*states(arm, rng), strict=True):
        u = dynamics.inverse(q[None], v[None], a[None])[0]
        ahead = energy(q + h * v + 0.5 * h**2 * a, v + h * a)
        behind = energy(q - h * v + 0.5 * h**2 * a, v - h * a)
        power = u @ v - v @ (arm.damping * v)
        assert (ahead - behind) / (2 * h) == pytest.approx(power, rel=1e-6, abs=1e-5)


def test_damping_adds_a_viscous_torque(arm: Robot, rng: np.random.Generator) -> None:
    q, v, a = states(arm, rng)
    more = arm.with_changes(damping=arm.damping + 2.5)
    extra = RobotDynamics(more).inverse(q, v, a) - RobotDynamics(arm).inverse(q, v, a)
    np.testing.assert_allclose(extra, 2.5 * v, atol=1e-9)


def test_torque_at_rest_is_proportional_to_gravity(
    arm: Robot, rng: np.random.Generator
) -> None:
    q, v, _ = states(arm, rng)
    weightless = RobotDynamics(arm.with_changes(gravity=(0, 0, 0)))
    np.testing.assert_allclose(weightless.inverse(q, 0 * v, 0 * v), 0.0, atol=1e-12)
    doubled = RobotDynamics(arm.with_changes(gravity=2.0 * arm.gravity))
    held = RobotDynamics(arm).inverse(q, 0 * v, 0 * v)
    np.testing.assert_allclose(doubled.inverse(q, 0 * v, 0 * v), 2.0 * held, rtol=1e-9)


# Rows


@pytest.mark.parametrize("m", [0, 1, 5])
def test_dynamics_return_the_documented_shapes(
    arm: Robot, m: int, rng: np.random.Generator
) -> None:
    dynamics, n = RobotDynamics(arm), arm.n
    q, v, a = states(arm, rng, m)
    x = np.hstack([q, v])
    assert dynamics.inverse(q, v, a).shape == (m, n)
    assert dynamics.forward(x, a).shape == (m, 2 * n)
    inverse = dynamics.inverse_jacobians(q, v, a)
    assert inverse.tau.shape == (m, n)
    assert (
        inverse.tau_q.shape == inverse.tau_v.shape == inverse.tau_a.shape == (m, n, n)
    )
    forward = dynamics.forward_jacobians(x, a)
    assert forward.f.shape == (m, 2 * n)
    assert forward.f_x.shape == (m, 2 * n, 2 * n)
    assert forward.f_u.shape == (m, 2 * n, n)


def test_dynamics_of_a_row_do_not_depend_on_other_rows(
    arm: Robot, rng: np.random.Generator
) -> None:
    dynamics = RobotDynamics(arm)
    q, v, a = states(arm, rng)
    x = np.hstack([q, v])
    together = (
        dynamics.inverse(q, v, a),
        *dynamics.inverse_jacobians(q, v, a),
        *dynamics.forward_jacobians(x, a),
    )
    for i in (3, 0, 2):
        row = slice(i, i + 1)
        alone = (
            dynamics.inverse(q[row], v[row], a[row]),
            *dynamics.inverse_jacobians(q[row], v[row], a[row]),
            *dynamics.forward_jacobians(x[row], a[row]),
        )
        for one, all_rows in zip(alone, together, strict=True):
            np.testing.assert_array_equal(one[0], all_rows[i])


def test_matrices_of_pinocchio_are_symmetric(arm, rng) -> None:
    """Its algorithms fill one triangle; its Python functions fill the other one."""
    model, data = arm.model, arm.model.createData()
    (q,), v, a = arm.expand(states(arm, rng, 1)[0]), *rng.normal(size=(2, model.nv))
    found = [pin.crba(model, data, q)]
    found.append(pin.computeRNEADerivatives(model, data, q, v, a)[2])
    found.append(pin.computeABADerivatives(model, data, q, v, a)[2])
    for matrix in map(np.array, found):
        np.testing.assert_array_equal(matrix, matrix.T)


def test_dynamics_can_be_pickled(arm: Robot, rng: np.random.Generator) -> None:
    dynamics = RobotDynamics(arm)
    back = pickle.loads(pickle.dumps(dynamics))
    q, v, a = states(arm, rng)
    np.testing.assert_array_equal(back.inverse(q, v, a), dynamics.inverse(q, v, a))
    assert back.robot.joint_names == arm.joint_names


def test_dynamics_of_many_rows_check_the_time_limit(arm: Robot, monkeypatch) -> None:
    """Slow motions have hundreds of thousands of rows."""

    def stop() -> None:
        raise Stop(requested=False)

    monkeypatch.setattr("tominpmp.dynamics.check", stop)
    monkeypatch.setattr("tominpmp.dynamics.CHECK_PERIOD", 3)
    dynamics, few, many = RobotDynamics(arm), np.zeros((2, arm.n)), np.zeros((3, arm.n))
    dynamics.inverse(few, few, few)
    with pytest.raises(Stop):
        dynamics.inverse(many, many, many)
    with pytest.raises(Stop):
        dynamics.forward(np.hstack([many, many]), many)
