"""Plans with constraints of tools and couplings, against closed forms and TOPP-RA."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

import tominpmp as tm
from tests.sample_arms import Link, make_arm, rod, slide
from tominpmp.constraints.base import States

# Other files test the search for the best motion.
plan_quickly = partial(tm.plan, effort="quick", refine=None)

STRONG = 100.0


def largest(solution: tm.Solution, item) -> float:
    """The largest value along the motion, on a finer grid than that of the replay."""
    motion = solution.trajectory
    assert motion is not None
    ready = item.on(solution.problem.robot)
    times = np.linspace(0.0, motion.duration, 4001)[:-1]
    state = motion(times)
    states = States(times, state.q, state.v, state.a)
    return float(ready.measures(states).max())


@pytest.mark.parametrize("method", ["inverse", "collocation"])
def test_tool_acceleration_on_a_rail_matches_the_closed_form(method):
    limit = tm.ToolAcceleration("tip", 2.0)
    rail = make_arm(slide(1.0), effort=np.array([STRONG]))
    problem = tm.Problem(rail, [0.0], tm.JointGoal([1.0]), constraints=(limit,))
    solution = plan_quickly(problem, method=method)
    assert solution.success, solution.message
    assert pytest.approx(2.0 * np.sqrt(1.0 / 2.0), rel=6e-3) == solution.T
    assert largest(solution, limit) < 1.01 * 2.0


@pytest.mark.parametrize("limit", [0.1, 1e-3])
def test_small_tool_acceleration_is_planned(planar3r, limit):
    """Regression: guesses were timed as if there were no limit, up to a hundred times
    too fast.
    """
    slow = tm.ToolAcceleration("tip", limit)
    goal = tm.JointGoal([2.0, -1.0, 0.5])
    problem = tm.Problem(planar3r, [0.5, 1.7, -1.7], goal, constraints=(slow,))
    solution = plan_quickly(problem, objective="feasible")
    assert solution.success, solution.message
    assert largest(solution, slow) < 1.01 * limit


def test_tool_acceleration_has_its_centripetal_part():
    limit = tm.ToolAcceleration("tip", 3.0)
    arm = make_arm(rod(1.0, 1.0), effort=np.array([STRONG]))
    problem = tm.Problem(arm, [0.0], tm.JointGoal([2.0]), constraints=(limit,))
    solution = plan_quickly(problem)
    assert solution.success, solution.message
    assert largest(solution, limit) < 1.01 * 3.0
    # dw/dt = sqrt(a^2 - w^4) on the way up: the angle where w^2 = a sin(2 x) is x.
    w_top = np.sqrt(3.0 * np.sin(2.0 * min(0.5 * 2.0, 0.25 * np.pi)))
    x = np.linspace(0.0, min(1.0, 0.25 * np.pi), 200_001)[1:]
    w = np.sqrt(3.0 * np.sin(2.0 * x))
    up = x[0] / (0.5 * w[0]) + np.sum(2.0 * np.diff(x) / (w[1:] + w[:-1]))
    expected = 2.0 * up + (2.0 - 2.0 * min(1.0, 0.25 * np.pi)) / w_top
    assert pytest.approx(expected, rel=1e-2) == solution.T


def two_links() -> tm.Robot:
    return make_arm(rod(1.0, 1.0), rod(1.0, 1.0), effort=np.array([12.0, 5.0]))


def bent(point) -> np.ndarray:
    """Angles of two links of 1 m whose tip is at a point, the elbow on one side."""
    x, y = point
    elbow = np.arccos((x * x + y * y - 2.0) / 2.0)
    first = np.arctan2(y, x) - np.arctan2(np.sin(elbow), 1.0 + np.cos(elbow))
    return np.array([first, elbow])


def test_motion_along_a_tool_line_matches_topp_ra():
    pytest.importorskip("toppra", reason="toppra has no wheel for this machine")
    import toppra
    from toppra import algorithm, constraint

    toppra.setup_logging("ERROR")
    begin, end = np.array([1.2, -0.6]), np.array([0.8, 0.9])
    robot = two_links()
    s = np.linspace(0.0, 1.0, 401)
    q = np.array([bent(begin + share * (end - begin)) for share in s])
    path = toppra.SplineInterpolator(s, q)
    limits = robot.limits
    torque = constraint.JointTorqueConstraint(
        lambda q, v, a: tm_inverse(robot, q, v, a),
        np.stack([limits.effort_lower, limits.effort_upper], axis=1),
        np.zeros(2),
    )
    solver = algorithm.TOPPRA([torque], path, gridpoints=s, solver_wrapper="seidel")
    expected = solver.compute_trajectory(0.0, 0.0).duration
    line = tm.ToolLine("tip", (*begin, 0.0), (*end, 0.0), radius=1e-4)
    problem = tm.Problem(robot, q[0], tm.JointGoal(q[-1]), constraints=(line,))
    solution = plan_quickly(problem, intervals=80)
    assert solution.success, solution.message
    assert largest(solution, line) < 1.1e-4
    assert pytest.approx(expected, rel=3e-3) == solution.T


def tm_inverse(robot, q, v, a):
    """Torques of a robot, by Pinocchio alone."""
    import pinocchio as pin

    return pin.rnea(robot.model, robot.model.createData(), q, v, a)


def test_wider_tool_line_allows_a_faster_motion():
    begin, end = np.array([1.2, -0.6]), np.array([0.8, 0.9])
    times = []
    for radius in (0.02, 0.2):
        line = tm.ToolLine("tip", (*begin, 0.0), (*end, 0.0), radius=radius)
        goal = tm.JointGoal(bent(end))
        problem = tm.Problem(two_links(), bent(begin), goal, constraints=(line,))
        solution = plan_quickly(problem)
        assert solution.success, solution.message
        assert largest(solution, line) < 1.01 * radius
        times.append(solution.T)
    assert times[1] < 0.99 * times[0]


def test_plan_keeps_away_from_a_point_and_within_a_region():
    begin, end = np.array([1.2, -0.6]), np.array([0.8, 0.9])
    goal = tm.JointGoal(bent(end))
    away = tm.KeepAway("tip", (1.2, 0.1, 0.0), 0.35)
    box = tm.WithinRegion("tip", (0.75, -np.inf, -1.0), (1.25, np.inf, 1.0))
    free = plan_quickly(tm.Problem(two_links(), bent(begin), goal))
    for item in (away, box):
        assert largest(free, item) > 0.05
        problem = tm.Problem(two_links(), bent(begin), goal, constraints=(item,))
        solution = plan_quickly(problem)
        assert solution.success, solution.message
        assert largest(solution, item) < 2e-3
        assert solution.T >= 0.999 * free.T


def test_joint_fixed_by_a_coupling_matches_a_locked_joint():
    links = (rod(1.0, 1.0), rod(1.0, 0.7), Link(mass=0.5, length=0.4, inertia=0.02))
    effort = np.array([12.0, 6.0, 1e3])
    arm = make_arm(*links, effort=effort)
    fixed = tm.JointCoupling(("joint3",), (1.0,), upper=0.4, lower=0.4)
    problem = tm.Problem(
        arm, [0.0, 0.3, 0.4], tm.JointGoal([1.0, -0.5, 0.4]), constraints=(fixed,)
    )
    solution = plan_quickly(problem)
    assert solution.success, solution.message
    assert largest(solution, fixed) < 1e-4
    reduced = make_arm(*links, effort=effort[:2], locked_joints={"joint3": 0.4})
    lone = plan_quickly(tm.Problem(reduced, [0.0, 0.3], tm.JointGoal([1.0, -0.5])))
    assert lone.success
    assert pytest.approx(lone.T, rel=3e-3) == solution.T


def test_coupling_that_keeps_a_link_level_matches_an_upright_cone():
    arm = make_arm(
        rod(1.0, 1.0), rod(1.0, 0.7), rod(0.2, 0.2), effort=np.array([12.0, 6.0, 20.0])
    )
    names = ("joint1", "joint2", "joint3")
    level = tm.JointCoupling(names, (1.0, 1.0, 1.0), upper=0.0, lower=0.0)
    start, end = [0.4, -0.9, 0.5], [1.3, -0.7, -0.6]
    problem = tm.Problem(arm, start, tm.JointGoal(end), constraints=(level,))
    coupled = plan_quickly(problem)
    assert coupled.success, coupled.message
    # The reference keeps the direction of the link within a narrow cone.
    cone = tm.KeepUpright("tip", (1, 0, 0), (1, 0, 0), tolerance=2e-3)
    other = plan_quickly(tm.Problem(arm, start, tm.JointGoal(end), constraints=(cone,)))
    assert other.success, other.message
    assert pytest.approx(coupled.T, rel=1e-2) == other.T
