"""Damped least squares find roots within bounds, for many rows at once."""

from __future__ import annotations

import numpy as np
import pytest

from tominpmp.least_squares import least_squares, padded

LIMITS = np.full(3, -2.0), np.full(3, 2.0)
ONE = np.ones(3)
SETTINGS = {"reached": 1e-9, "steps": 40}


def on_spheres(q: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return padded(on_sphere(*each) for each in zip(rows.tolist(), q, strict=True))


def on_sphere(row: int, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Residual of a sphere of radius 1; odd rows: of radius 2, and of a plane."""
    value, slope = [q @ q - (1.0 + row % 2) ** 2], [2.0 * q]
    if row % 2:
        value.append(q[0] - 0.5)
        slope.append(np.array([1.0, 0.0, 0.0]))
    return np.array(value), np.array(slope)


def plane_at(total: float):
    """Residual that is zero where the first two joints add up to a total."""
    normal = np.array([[1.0, 1.0, 0.0]])
    return lambda q, _: (q @ normal.T - total, np.tile(normal, (len(q), 1, 1)))


def test_rows_of_different_residual_sizes_converge_as_if_alone():
    starts = np.random.default_rng(0).uniform(-1.5, 1.5, (8, 3))
    found, left = least_squares(on_spheres, starts, LIMITS, ONE, 0.5 * ONE, **SETTINGS)
    assert left.max() < 1e-9
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), [1.0, 2.0] * 4)
    for row, start in enumerate(starts):
        alone, _ = least_squares(
            lambda q, _, row=row: on_spheres(q, np.array([row])),
            start[None],
            LIMITS,
            ONE,
            0.5 * ONE,
            **SETTINGS,
        )
        np.testing.assert_allclose(found[row], alone[0], atol=1e-9)


def test_step_is_the_shortest_in_scaled_joint_units():
    plane = plane_at(1.0)
    scale = np.array([2.0, 1.0, 1.0])
    found, _ = least_squares(
        plane, np.zeros((1, 3)), LIMITS, scale, 9.0 * ONE, **SETTINGS
    )
    np.testing.assert_allclose(found, [[0.8, 0.2, 0.0]], atol=1e-6)


def test_other_joints_converge_when_a_joint_is_at_its_bound():
    plane = plane_at(3.0)
    found, left = least_squares(
        plane, np.array([[2.0, 0.0, 0.0]]), LIMITS, ONE, 9.0 * ONE, **SETTINGS
    )
    np.testing.assert_allclose(found, [[2.0, 1.0, 0.0]], atol=1e-6)
    assert left[0] < 1e-9


def test_residual_beyond_the_bounds_is_returned():
    def beyond(q, _):
        return q - 50.0, np.tile(np.eye(3), (len(q), 1, 1))

    found, left = least_squares(
        beyond, np.zeros((2, 3)), LIMITS, ONE, 9.0 * ONE, **SETTINGS
    )
    np.testing.assert_allclose(found, 2.0)
    assert left == pytest.approx(48.0 * np.sqrt(3.0))
