"""The B-spline transcription: derivatives, exactness of the curve, motion limits."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.interpolate import BSpline

import tominpmp as tm
from tests.sample_arms import make_arm, slide
from tominpmp.constraints.base import Partials
from tominpmp.exceptions import JointNotFound, OptionsError, ProblemError
from tominpmp.motion_limits import EffortCurve, MotionLimits
from tominpmp.transcription.bspline import BSplineTranscription
from tominpmp.transcription.grid import interval_shares
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import NonlinearProgram

# The multi-start search is tested elsewhere.
plan_quickly = partial(tm.plan, effort="quick", refine=None)

START = (0.5, 1.7, -1.7)
OBSTACLE = tm.Scene([tm.Sphere("O", radius=0.8, position=(4, 0, 0))])
ALL = MotionLimits(
    acceleration=50.0,
    jerk=500.0,
    effort_rate=200.0,
    effort_scale=0.9,
    effort_curves={"joint1": EffortCurve.droop(20.0, 10.0)},
)
GOALS = {
    "joint": tm.JointGoal((0.5, 1, 1)),
    "moving": tm.JointGoal((0.5, 1, 1), v=(0.1, 0.2, 0.3)),
    "position": tm.PositionGoal("tip", (4, 1, 0)),
    "tip velocity": tm.PositionGoal("tip", (4, 1, 0), v=(1, 0, 0)),
}


@pytest.fixture(scope="module")
def rail():
    """A mass of 1 kg on a rail, pushed by 10 N."""
    return make_arm(slide(1.0), effort=10.0)


def planar(goal=GOALS["joint"], **kwargs):
    return tm.Problem(tm.load_robot("planar3r"), START, goal, **kwargs)


def build(problem, degree, seed=0):
    shares = interval_shares("cosine", 7)
    transcription = BSplineTranscription(ProblemFunctions.of(problem), shares, degree)
    nlp, rng = NonlinearProgram.of(transcription), np.random.default_rng(seed)
    return nlp, np.append(0.5 + 0.5 * rng.normal(size=nlp.size - 1), 1.2)


@pytest.mark.parametrize("degree", [3, 5])
@pytest.mark.parametrize("goal", GOALS)
def test_jacobian_against_differences(goal, degree):
    problem = planar(
        GOALS[goal], v_start=(0.1, -0.2, 0.3), scene=OBSTACLE, motion_limits=ALL
    )
    nlp, z = build(problem, degree)
    linearization = nlp.linearize(z, nlp.evaluate(z), nlp.step_bounds(z, 1.0))
    analytic = linearization.matrix.toarray()
    # Links that cross have a distance that cannot be differentiated, and clearances
    # far from contact are bounds only.
    clearance = nlp.rows.kind == nlp.rows.kinds.index("clearance")
    values = nlp.evaluate(z)
    smooth = ~clearance | ((values > -0.045) & (values < -0.005))
    smooth = smooth[linearization.rows]
    step = 1e-6
    for i in range(nlp.size):
        shift = np.zeros(nlp.size)
        shift[i] = step
        change = nlp.evaluate(z + shift) - nlp.evaluate(z - shift)
        expected = change[linearization.rows] / (2 * step)
        scale = max(1.0, float(np.abs(expected).max()))
        error = (analytic[:, i] - expected)[smooth]
        np.testing.assert_allclose(error, 0.0, atol=2e-6 * scale)


@pytest.mark.parametrize("a_start", [(0.0, 0.0, 0.0), (3.0, -2.0, 1.0)])
@pytest.mark.parametrize("degree", [3, 5])
def test_trajectory_is_the_spline_with_the_given_initial_state(degree, a_start):
    problem = planar(v_start=(0.1, -0.2, 0.3), a_start=a_start, motion_limits=ALL)
    nlp, z = build(problem, degree)
    motion = nlp.trajectory(z)
    times = np.linspace(0.0, z[-1], 57)
    curve = nlp.transcription.motion(z)
    q = BSpline(curve.knots.knots, curve.derivative(0), degree)(times / z[-1])
    np.testing.assert_allclose(motion(times).q, q, atol=1e-12)
    step = 1e-5
    middle = motion(times[1:-1])
    ahead, behind = motion(times[1:-1] + step), motion(times[1:-1] - step)
    np.testing.assert_allclose(middle.v, (ahead.q - behind.q) / (2 * step), atol=1e-4)
    start, end = motion(0.0), motion(z[-1])
    np.testing.assert_allclose(start.v, (0.1, -0.2, 0.3), atol=1e-12)
    np.testing.assert_allclose(start.a, a_start, atol=1e-9)  # jerk is limited
    np.testing.assert_allclose(end.q, (0.5, 1, 1), atol=1e-12)
    np.testing.assert_allclose(end.a, 0.0, atol=1e-9)


def jerk_limited_time(distance, velocity, acceleration, jerk):
    """Minimum time from rest to rest that never reaches the velocity limit."""
    ramp = acceleration / jerk
    if distance < 2 * acceleration * ramp**2:  # full acceleration is not reached
        return 4 * (distance / (2 * jerk)) ** (1 / 3)
    plateau = (-3 * ramp + np.sqrt(ramp**2 + 4 * distance / acceleration)) / 2
    assert acceleration * (ramp + plateau) < velocity
    return 4 * ramp + 2 * plateau


@pytest.mark.parametrize(
    ("acceleration", "jerk"), [(4.0, 20.0), (np.inf, 20.0), (2.0, 40.0)]
)
def test_jerk_limited_rail_against_the_closed_form(acceleration, jerk, rail):
    limits = MotionLimits(acceleration=acceleration, jerk=jerk)
    problem = tm.Problem(rail, [0.0], tm.JointGoal([1.0]), motion_limits=limits)
    solution = plan_quickly(
        problem, tm.Options(intervals=60, grid="uniform", smoothing=0.0)
    )
    best = jerk_limited_time(1.0, np.inf, min(acceleration, 1e3), jerk)
    assert solution.success
    assert best * (1 - 1e-6) < solution.T < best * 1.004
    dense = solution.trajectory.sample(1e-3)
    assert np.max(np.abs(np.diff(dense.a[:-1], axis=0))) < jerk * 1e-3 * (1 + 1e-5)
    assert np.max(np.abs(dense.a)) < acceleration * (1 + 1e-5)


def test_torque_rate_limit_holds_and_lengthens_the_motion(rail):
    times = []
    for rate in (np.inf, 400.0, 40.0):
        limits = MotionLimits(effort_rate=rate)
        problem = tm.Problem(rail, [0.0], tm.JointGoal([1.0]), motion_limits=limits)
        solution = plan_quickly(problem)
        assert solution.success
        u = solution.trajectory.sample(1e-3).u[:-1]
        assert np.max(np.abs(np.diff(u, axis=0))) < rate * 1e-3 * 1.01
        times.append(solution.T)
    assert times[0] < times[1] < times[2]
    free = plan_quickly(tm.Problem(rail, [0.0], tm.JointGoal([1.0]))).T
    assert times[0] > free * (1 - 1e-4)  # a relaxed problem is no slower


def test_torque_speed_curve_holds(rail):
    curve = EffortCurve(np.array([0.0, 1.0, 2.0]), np.array([10.0, 6.0, 0.0]))
    limits = MotionLimits(effort_curves={rail.joint_names[0]: curve})
    problem = tm.Problem(rail, [0.0], tm.JointGoal([2.0]), motion_limits=limits)
    solution = plan_quickly(problem)
    dense = solution.trajectory.sample(1e-3)
    assert solution.success
    assert np.all(np.abs(dense.u) <= curve(dense.v)[0] + 0.02)
    assert solution.T > plan_quickly(tm.Problem(rail, [0.0], tm.JointGoal([2.0]))).T


def test_effort_scale_reduces_the_torque_limit(rail):
    full = plan_quickly(tm.Problem(rail, [0.0], tm.JointGoal([0.2])))
    limits = MotionLimits(effort_scale=0.81)
    part = plan_quickly(
        tm.Problem(rail, [0.0], tm.JointGoal([0.2]), motion_limits=limits)
    )
    top = rail.limits.effort_upper[0]
    assert np.max(np.abs(part.trajectory.u)) <= 0.81 * top * (1 + 1e-5)
    assert part.T / full.T == pytest.approx(1 / 0.9, rel=1e-3)


def test_effort_scale_reduces_asymmetric_limits_by_the_same_share(rail):
    limits = replace(rail.limits, effort_lower=0.5 * rail.limits.effort_lower)
    weaker = replace(rail, limits=limits)
    scaled = MotionLimits(effort_scale=0.5)
    problem = tm.Problem(weaker, [0.0], tm.JointGoal([0.2]), motion_limits=scaled)
    u, top = plan_quickly(problem).trajectory.u, limits.effort_upper[0]
    assert np.max(u) == pytest.approx(0.5 * top, rel=1e-3)
    assert np.min(u) == pytest.approx(-0.25 * top, rel=1e-3)


@pytest.mark.parametrize("control", ["linear", "spline"])
def test_smooth_controls_converge_faster_with_the_grid(control):
    # One problem in each control: constant accelerations converge of first order only.
    fine = plan_quickly(planar(), tm.Options(method="collocation", intervals=80)).T
    constant = plan_quickly(planar(), tm.Options(control="constant"))
    smooth = plan_quickly(planar(), tm.Options(control=control))
    assert smooth.success
    assert fine * (1 - 5e-3) < smooth.T < fine * 1.01
    assert smooth.T < constant.T


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        ({"acceleration": -1.0}, "acceleration"),
        ({"jerk": [1.0, np.nan]}, "jerk"),
        ({"effort_scale": 1.5}, "effort_scale"),
        ({"effort_rate": "fast"}, "effort_rate"),
        ({"effort_curves": {"joint1": 3.0}}, "joint1"),
    ],
)
def test_invalid_motion_limit_is_named_in_the_error(arguments, word):
    with pytest.raises(ProblemError, match=word):
        MotionLimits(**arguments)


def test_motion_limits_of_other_joints_are_rejected():
    with pytest.raises(ProblemError, match="jerk has 2 numbers, expected 3"):
        planar(motion_limits=MotionLimits(jerk=[1.0, 2.0]))
    with pytest.raises(JointNotFound, match="elbow"):
        planar(motion_limits=MotionLimits(jerk={"elbow": 2.0}))
    with pytest.raises(JointNotFound, match="elbow"):
        curve = EffortCurve.droop(1.0, 2.0)
        planar(motion_limits=MotionLimits(effort_curves={"elbow": curve}))


def test_invalid_effort_curves_are_rejected_and_power_curves_are_exact():
    with pytest.raises(ProblemError, match="a torque for each of 3 speeds"):
        EffortCurve(np.array([0.0, 1.0, 2.0]), np.array([1.0, 0.0]))
    with pytest.raises(ProblemError, match="increase"):
        EffortCurve(np.array([0.0, 2.0, 1.0]), np.array([1.0, 0.5, 0.0]))
    with pytest.raises(ProblemError, match="expected torques >= 0"):
        EffortCurve(np.array([0.0, 2.0]), np.array([1.0, -0.5]))
    curve = EffortCurve.power(effort=10.0, power=20.0, top_speed=8.0, points=30)
    speed = np.linspace(0.0, 8.0, 200)
    limit = np.minimum(10.0, 20.0 / np.maximum(speed, 1e-9))
    np.testing.assert_allclose(curve(speed)[0], limit, rtol=5e-3)


def test_power_curve_stays_within_the_power_limit():
    """Up to nine times the speed at which the power limit begins, 2 rad/s."""
    speed = np.linspace(0.0, 18.0, 2001)
    share = EffortCurve.power(10.0, 20.0, 18.0)(speed)[0] * speed / 20.0
    assert np.max(share) <= 1.0 + 1e-12
    assert np.min(share[speed > 2.0]) > 0.99


def test_methods_without_jerk_limits_reject_them():
    problem = planar(motion_limits=MotionLimits(jerk=100.0))
    with pytest.raises(OptionsError, match="inverse"):
        plan_quickly(problem, tm.Options(method="collocation"))
    with pytest.raises(OptionsError, match="continuous"):
        plan_quickly(problem, tm.Options(control="constant"))


@pytest.mark.parametrize("degree", [3, 5])
def test_time_derivatives_are_pulled_back_to_the_duration(degree):
    nlp, z = build(planar(), degree)
    of = nlp.transcription
    at = of.instants(2, "")
    partials = Partials(np.arange(at.size), by_t=np.ones(at.size))
    matrix = of.pull_back(of.motion(z), at, partials).toarray()
    np.testing.assert_array_equal(matrix[:, :-1], 0.0)
    np.testing.assert_allclose(matrix[:, -1], at.times(of.shares)[:, 0])


@pytest.mark.parametrize("degree", [3, 5])
def test_jumps_of_the_jerk_count_as_accelerations_on_intervals_of_any_length(degree):
    """Regression: on the short intervals at both ends they counted a hundred times, and
    outweighed the duration of motions among obstacles (a Fetch in a cage 3.34 s for
    2.86 s).
    """
    system = ProblemFunctions.of(planar())
    shares = interval_shares("cosine", 40)
    of = BSplineTranscription(system, shares, degree)
    z = of.start(lambda t: np.outer(np.sin(3.0 * t), START), 1.0, np.array([1.0]))
    z[:-1] += 1e-3 * np.random.default_rng(0).standard_normal(z.size - 1)
    accelerations = np.abs(of.motion(z).derivative(2)).max() / of.acceleration_range
    jumps = np.abs(of.variation(z).at(z)).reshape(-1, 3)
    assert np.all(jumps.max(axis=0) < 10.0 * accelerations)
