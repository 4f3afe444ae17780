"""Exact switching of three joints that move at their speed limits."""

from __future__ import annotations

import numpy as np
import pytest
from sample_arms import make_arm, rod, slide

import tominpmp as tm
from tominpmp.dynamics import RobotDynamics
from tominpmp.exact.held_joints import FOLLOWS, HOLDS, differentiate_rates
from tominpmp.exact.structure import Arcs, Edit


def planar(velocity: object = 1e3) -> tm.Robot:
    effort = np.array([20.0, 10.0, 5.0])
    return make_arm(*[rod(1.0, 1.0)] * 3, effort=effort, velocity=velocity)


def test_three_rails_at_their_speed_limits_reach_the_closed_form() -> None:
    axes = np.eye(3)
    rails = make_arm(
        *(slide(1.0, tuple(axis)) for axis in axes),
        effort=np.array([9.0, 8.0, 5.0]),
        velocity=np.array([1.0, 1.2, 0.9]),
    )
    problem = tm.Problem(rails, np.zeros(3), tm.JointGoal([1.0, 0.8, -0.7]))
    solution = tm.plan(problem, tm.Options(refine="switching", starts=1))
    # The first rail carries all three masses: 1 m at 1 m/s, after 1/3 s of 3 m/s^2.
    assert solution.success
    assert solution.T == pytest.approx(4.0 / 3.0, rel=1e-7)


def test_three_links_at_their_speed_limits_reach_the_faster_optimum() -> None:
    """Two orders of switches are locally optimal, 1.23548 s and 1.23333 s.

    Where the elbow switches in the faster order, the first joint can keep its speed
    with full torque only while the elbow's torque lies between its limits; without this
    arc the motion takes 1.2356 s.
    """
    robot = planar(np.array([1.6, 2.0, 2.0]))
    goal = tm.JointGoal([1.2, -0.4, 0.6])
    problem = tm.Problem(robot, [0.0, 0.5, -0.5], goal)
    options = tm.Options(refine="switching", starts=1, max_planning_time=120.0)
    solution = tm.plan(problem, options)
    assert solution.success
    assert solution.T == pytest.approx(1.23333, abs=1e-5)
    assert solution.verification is not None
    assert solution.verification.ok


@pytest.mark.parametrize(
    "modes",
    [
        (HOLDS | FOLLOWS, 0, 0),
        (HOLDS, FOLLOWS, 0),
        (HOLDS | FOLLOWS, HOLDS, FOLLOWS),
        (0, 0, 0),
    ],
)
def test_rates_of_held_joints_match_finite_differences(
    modes: tuple[int, ...], rng: np.random.Generator
) -> None:
    """Held joints do not accelerate, and prescribed torques are as they were given."""
    robot = planar()
    dynamics = RobotDynamics(robot)
    x, u = rng.normal(size=(4, 6)), rng.normal(size=(4, 3))
    pattern = np.tile(np.array(modes), (4, 1))
    rates = differentiate_rates(dynamics, x, u, pattern)
    a = rates.f[:, 3:]
    np.testing.assert_allclose(a[(pattern & HOLDS) > 0], 0.0, atol=1e-12)
    known = (pattern & FOLLOWS) == 0
    np.testing.assert_allclose(rates.tau[known], u[known])
    needed = dynamics.inverse(x[:, :3], x[:, 3:], a)
    np.testing.assert_allclose(rates.tau, needed, rtol=1e-9, atol=1e-9)
    step = 1e-6
    for k in range(6):
        d = step * np.eye(6)[k]
        ends = [differentiate_rates(dynamics, x + s * d, u, pattern) for s in (1, -1)]
        slope = (ends[0].f - ends[1].f) / (2.0 * step)
        np.testing.assert_allclose(rates.f_x[..., k], slope, rtol=1e-5, atol=1e-6)
        slope = (ends[0].tau - ends[1].tau) / (2.0 * step)
        np.testing.assert_allclose(rates.tau_x[..., k], slope, rtol=1e-5, atol=1e-6)
    for k in range(3):
        d = step * np.eye(3)[k]
        ends = [differentiate_rates(dynamics, x, u + s * d, pattern) for s in (1, -1)]
        slope = (ends[0].f - ends[1].f) / (2.0 * step)
        np.testing.assert_allclose(rates.f_u[..., k], slope, rtol=1e-5, atol=1e-6)


def test_free_torque_is_replaced_by_torques_at_limits() -> None:
    one = np.ones((1, 1))
    none = np.zeros((1, 1), dtype=int)
    arcs = Arcs(np.array([2.0]), 0.5 * one, one > 0.0, none, none != 0)
    found = arcs.divided(0, (0.25, 0.75), [Edit(0, 0, -1.0), Edit(1, 0, 1.0)])
    np.testing.assert_allclose(found.lengths, [0.5, 1.5])
    np.testing.assert_allclose(found.levels[:, 0], [-1.0, 1.0])
    assert not found.free.any()


def test_another_torque_holds_the_joint_before_or_after_an_arc() -> None:
    held = np.array([[1, 0]])
    levels = np.array([[0.0, 1.0]])
    arcs = Arcs(np.array([2.0]), levels, held == 2, held, held != 0)
    for new in (0, 1):
        edits = [Edit(new, 0, -1.0, 1), Edit(new, 1, 1.0, follows=True)]
        found = arcs.divided(0, (float(new), 1.0 - new), edits)
        assert found.lengths[new] == 0.0
        assert found.lengths[1 - new] == 2.0
        np.testing.assert_array_equal(found.held, [[1, 0], [1, 0]])
        np.testing.assert_array_equal(found.follows[new], [False, True])
        np.testing.assert_array_equal(found.follows[1 - new], [True, False])
        assert found.levels[new, 0] == -1.0
