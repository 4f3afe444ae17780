"""Loads in nearly free fall: the tip of the friction cone."""

from __future__ import annotations

import numpy as np
import pytest

import tominpmp as tm
from tests.sample_arms import make_arm, slide
from tominpmp.constraints.stable_contact import TIP, _cone

G, EFFORT, MASS = 9.81, 30.0, 1.0


@pytest.mark.parametrize("load", [0.3, 3e-4])
def test_rounded_friction_cone_is_inside_the_cone(load):
    rng = np.random.default_rng(0)
    part, most = rng.normal(size=(500, 2)), np.abs(rng.normal(size=500))
    part, most = part * load, most * load
    value, _ = _cone(np.column_stack([part, most]), np.eye(6)[:3], TIP)
    beyond = np.linalg.norm(part, axis=1) - most
    assert np.all(value[:, 0] >= beyond)
    assert np.all(beyond[value[:, 0] <= 0.0] < 0.0)


def test_derivatives_at_the_tip_of_the_cone_are_continuous():
    ways = np.eye(6)[:3] * np.array([[1.0], [1.0], [0.3]])
    small = 1e-3 * TIP
    for part in ((small, 0.0), (-small, small)):
        _, here = _cone(np.array([[*part, small]]), ways, TIP)
        _, there = _cone(np.array([[-part[0], -part[1], small]]), ways, TIP)
        assert np.max(np.abs(here - there)) < 10.0 * small / TIP


def test_glass_on_a_lift_is_accelerated_nearly_to_free_fall():
    """The lift accelerates upwards with its full force, then nearly in free fall."""
    lift = make_arm(slide(MASS, axis=(0, 0, 1)), effort=EFFORT, gravity=(0, 0, -G))
    glass = tm.StableContact("tip", (0.0, 0.0, 0.05), 0.4, mass=0.1)
    problem = tm.Problem(lift, [0.0], tm.JointGoal([1.0]), constraints=(glass,))
    solution = tm.plan(problem)
    rise = EFFORT / MASS - G
    least = np.sqrt(2.0 * (rise + G) / (rise * G))
    assert solution.success and solution.verification.ok
    assert least * (1.0 - 1e-6) < solution.T < least * (1.0 + 2e-3)
