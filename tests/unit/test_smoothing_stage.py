"""Smoothing: quiet torques for a little more time."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from scipy.optimize import LinearConstraint, minimize

import tominpmp as tm
from tominpmp.motion.measures import roughness
from tominpmp.solvers import quiet_torques
from tominpmp.solvers.quiet_torques import mean_speeds

# Other files test the search for the best motion.
plan_quickly = partial(tm.plan, effort="quick", refine=None)

START, END = (0.5, 1.7, -1.7), (0.9, -1.2, -0.9)
POST = tm.Scene([tm.Sphere("O", radius=0.8, position=(4, 0, 0))])
SLIDER = """<robot name="slider"><link name="base"/>
<link name="cart"><inertial><mass value="2"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="x" type="prismatic"><parent link="base"/><child link="cart"/>
<axis xyz="1 0 0"/><limit lower="-9" upper="9" effort="4" velocity="9"/></joint></robot>
"""


@pytest.fixture(scope="module")
def problem(planar3r):
    goal = tm.PositionGoal("tip", (4, 1, 0))
    return tm.Problem(planar3r, START, goal, scene=POST)


FORMS = [
    {},
    {"method": "collocation"},
    {"method": "adjoint"},
    {"control": "linear"},
    {"control": "spline"},
    {"refine": "grid"},
]


@pytest.mark.parametrize(
    "options", FORMS, ids=lambda options: str(options or "default")
)
def test_smoothing_lowers_roughness_for_the_slack_alone(problem, options):
    solution = plan_quickly(problem, tm.Options(starts=1, **options))
    quiet = tm.smooth(solution, 0.02)
    assert quiet.success and quiet.verification.ok
    assert quiet.T == pytest.approx(1.02 * solution.T, rel=1e-9)
    assert quiet.roughness < 0.4 * solution.roughness
    assert quiet.initial is solution.trajectory
    # The limits hold on a dense motion, the clearance in the replay.
    motion = quiet.trajectory(np.linspace(0, quiet.T, 2000))
    limits = problem.robot.limits
    assert np.max(np.abs(motion.v) / limits.velocity) <= 1.005
    assert np.max(np.abs(motion.u) / limits.effort_upper) <= 1.005
    assert quiet.verification.min_clearance >= -1e-5


def test_smoothed_torques_of_a_slider_are_the_least_squares_optimum(tmp_path):
    """The reference is least squares over torques held on a uniform grid, by another
    solver.
    """
    path = tmp_path / "slider.urdf"
    path.write_text(SLIDER)
    problem = tm.Problem(tm.load_robot(path), [0.0], tm.JointGoal([1.0]))
    options = tm.Options(grid="uniform", intervals=20, control="constant")
    solution = plan_quickly(problem, options)
    assert solution.T == pytest.approx(np.sqrt(2.0), rel=1e-3)  # bang-bang, a = 2
    quiet = tm.smooth(solution, 0.1)
    N, h, m = 20, quiet.T / 20, 2.0
    # v = h sum a and q = sum (v + h a / 2) at the end.
    speed = np.full(N, h) / m
    way = h**2 * (N - np.arange(N) - 0.5) / m
    jumps = np.diff(np.eye(N), axis=0) / 8.0
    best = minimize(
        lambda u: np.sum((jumps @ u) ** 2),
        np.zeros(N),
        jac=lambda u: 2 * jumps.T @ (jumps @ u),
        method="SLSQP",
        bounds=[(-4, 4)] * N,
        constraints=LinearConstraint(np.stack([speed, way]), [0, 1], [0, 1]),
        options={"maxiter": 500, "ftol": 1e-14},
    )
    found = np.sum((jumps @ quiet.trajectory.u[:-1, 0]) ** 2)
    assert found == pytest.approx(best.fun, rel=1e-2)


def detours(solution: tm.Solution) -> np.ndarray:
    """The path length of each joint beyond the distance from start to goal [rad]."""
    q = solution.trajectory(np.linspace(0.0, solution.T, 500)).q
    return np.abs(np.diff(q, axis=0)).sum(axis=0) - np.abs(q[-1] - q[0])


@pytest.mark.parametrize(("slack", "left"), [(0.0, 0.8), (0.003, 0.5)])
def test_smoothing_shortens_the_paths_of_joints_with_spare_time(slack, left):
    """Light joints swing out where this saves a ten-thousandth of T."""
    arm = tm.load_robot("ur5", limits="urdf")
    start = [0.3, -1.6, 1.2, -1.4, 0.4, -0.5]
    problem = tm.Problem(arm, start, tm.JointGoal([2.6, -0.6, -1.0, 0.4, 1.1, 0.3]))
    solution = plan_quickly(problem)
    quiet = tm.smooth(solution, slack)
    assert quiet.success
    assert quiet.T == pytest.approx((1.0 + slack) * solution.T, rel=1e-9)
    assert detours(solution).sum() > 0.5
    assert detours(quiet).sum() < left * detours(solution).sum()
    assert "ways shorter by" in quiet.message


@pytest.mark.parametrize("options", FORMS[:2] + FORMS[3:5], ids=str)
def test_mean_speeds_match_differences_of_positions_at_nodes(problem, options):
    """In every transcription, the mean speeds are linear in the unknowns and equal
    those of the motion.
    """
    solution = plan_quickly(problem, tm.Options(starts=1, **options))
    seen = []

    def recording_mean_speeds(nlp, z):
        seen.append((nlp, z, mean_speeds(nlp, z)))
        return seen[-1][-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(quiet_torques, "mean_speeds", recording_mean_speeds)
        tm.smooth(solution, 0.02)
    nlp, z, speeds = seen[0]
    limits = nlp.system.problem.robot.limits.velocity
    away = z + 1e-3 * np.random.default_rng(0).normal(size=z.size) * (nlp.cost == 0.0)
    for here in (z, away):
        motion = nlp.trajectory(here)
        q, h = motion.q, np.diff(motion.t)[:, None]
        by_hand = np.diff(q, axis=0) / limits / np.sqrt(h * motion.duration)
        found = (speeds.matrix @ here + speeds.offset).reshape(by_hand.shape)
        np.testing.assert_allclose(found, by_hand, atol=1e-9)


def test_more_slack_gives_less_roughness(planar3r):
    solution = plan_quickly(tm.Problem(planar3r, START, tm.JointGoal(END)))
    rough = [tm.smooth(solution, slack).roughness for slack in (0.0, 0.02, 0.2)]
    assert solution.roughness >= rough[0] > rough[1] > rough[2]


def test_smoothing_keeps_motion_limits(planar3r):
    limits = tm.MotionLimits(effort_rate=300.0, acceleration=25.0)
    problem = tm.Problem(planar3r, START, tm.JointGoal(END), motion_limits=limits)
    solution = plan_quickly(problem, tm.Options(intervals=30))
    quiet = tm.smooth(solution, 0.03)
    assert quiet.success and quiet.roughness < solution.roughness
    motion = quiet.trajectory(np.linspace(0, quiet.T, 4000))
    assert np.max(np.abs(motion.a)) <= 25.0 * 1.005
    rate = np.diff(motion.u, axis=0) / (quiet.T / 3999)
    assert np.max(np.abs(rate)) <= 300.0 * 1.02


def test_smoothing_keeps_the_start_velocity(planar3r):
    v = np.array([0.2, -0.3, 0.1])
    problem = tm.Problem(planar3r, START, tm.JointGoal(END), v_start=v)
    quiet = tm.smooth(plan_quickly(problem), 0.05)
    assert quiet.success
    np.testing.assert_allclose(quiet.trajectory.v[0], v, atol=1e-12)


def test_slack_is_an_option_of_the_plan(planar3r):
    problem = tm.Problem(planar3r, START, tm.JointGoal(END))
    plain, quiet = plan_quickly(problem), plan_quickly(problem, tm.Options(slack=0.02))
    assert quiet.T == pytest.approx(1.02 * plain.T, rel=1e-9)
    assert quiet.options.slack == 0.02
    assert "roughness" in quiet.message


def test_roughness_of_one_jump_matches_the_formula(planar3r):
    """The torque jumps once, by half of its range."""
    t = np.array([0.0, 0.5, 1.0])
    still = np.tile(START, (3, 1))
    effort = planar3r.limits.effort_upper
    u = np.array([0 * effort, effort, effort])
    motion = tm.Trajectory(planar3r.joint_names, t, still, 0 * still, u)
    assert roughness(motion, planar3r.limits) == pytest.approx(3 * 0.25)


def test_torques_of_some_milliseconds_are_rough_and_made_quiet():
    """The cart reaches its low speed limit within 5 ms, and brakes within 5 ms."""
    cart = tm.load_robot(SLIDER, velocity=0.01, gravity=(0.0, 0.0, 0.0))
    solution = plan_quickly(tm.Problem(cart, [0.0], tm.JointGoal([0.02])))
    assert solution.roughness > 0.3
    quiet = tm.smooth(solution, 0.02)
    assert quiet.T == pytest.approx(1.02 * solution.T, rel=1e-9)
    assert quiet.roughness < 0.1 * solution.roughness


def test_smooth_rejects_a_missing_motion_and_wrong_slack(planar3r):
    from dataclasses import replace

    solution = plan_quickly(tm.Problem(planar3r, START, tm.JointGoal(END)))
    with pytest.raises(tm.ProblemError, match="no motion to smooth"):
        tm.smooth(replace(solution, trajectory=None))
    for slack in (-0.01, np.nan, "much", True):
        with pytest.raises(tm.OptionsError, match="slack is"):
            tm.smooth(solution, slack)


def test_smooth_rejects_several_segments(planar3r):
    """Regression: the message was that of a ValueError, and the motion was returned
    unchanged.
    """
    goals = [1.0, 0.3, 0.2], [1.2, 0.5, 0.6]
    segments = [tm.Segment(tm.JointGoal(goal)) for goal in goals]
    problem = tm.Problem(planar3r, [0.5, 0.1, 0.1], segments=segments)
    solution = plan_quickly(problem)
    with pytest.raises(tm.ProblemError, match="2 segments"):
        tm.smooth(solution)
