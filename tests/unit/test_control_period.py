"""The option `control_period`: motions on the clock of a controller.

The motions are sampled at the period, and interpolated by SciPy's polynomials as the
joint trajectory controller does it (cubics through positions and velocities; degree 5
through accelerations, where these do not jump). Torques are computed anew by
Pinocchio's ``rnea``.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from clock_samples import LIMITS, UR5_END, planar_problem, ur5_problem
from sample_arms import make_arm, slide
from scipy.interpolate import BPoly, CubicHermiteSpline

import tominpmp as tm
from tominpmp.exceptions import OptionsError
from tominpmp.planner import candidate
from tominpmp.planner import control_period as clock
from tominpmp.planner.planning import plan
from tominpmp.transcription.grid import knots_near, ticks_of
from tominpmp.verification.limit_violations import LimitViolation

PERIODS = (0.001, 0.004, 0.008)
# Instants of every period at which the interpolated motion is examined.
SHARES = np.array([0.0, 0.07, 0.21, 0.4, 0.5, 0.63, 0.79, 0.94, 1.0])

TIP = "ee_link"
# The tests examine the clock, not the multi-start search.
QUICK = {"effort": "quick", "refine": None}


def plan_quickly(problem, **options):
    return tm.plan(problem, **{**QUICK, **options})


@pytest.fixture(scope="module")
def free(planar3r):
    """The motion of the planar arm without a clock."""
    return plan_quickly(planar_problem(planar3r))


@pytest.fixture(scope="module")
def clocked(planar3r):
    """The motion of the planar arm on a clock of ten milliseconds."""
    return plan_quickly(planar_problem(planar3r), control_period=0.01)


def torques(robot, q, v, a):
    """Torques by Pinocchio with viscous friction."""
    model = robot.model
    data = model.createData()
    rows = [pin.rnea(model, data, *row) for row in zip(q, v, a, strict=True)]
    return np.array(rows) + robot.damping * v


def as_interpolated(samples, *, quintic):
    """Positions, velocities, accelerations between samples, as a controller has them.

    Each period is interpolated separately: values at its end are those before a jump.
    """
    t, state = samples.t, (samples.q, samples.v, samples.a)
    times = (t[:-1, None] + np.diff(t)[:, None] * SHARES).ravel()
    parts = [[], [], []]
    for k, (begin, end) in enumerate(pairwise(t)):
        inside = begin + (end - begin) * SHARES
        if quintic:
            ends = [[part[j] for part in state] for j in (k, k + 1)]
            curve = BPoly.from_derivatives([begin, end], np.array(ends))
        else:
            curve = CubicHermiteSpline(
                [begin, end], samples.q[k : k + 2], samples.v[k : k + 2]
            )
        for order, rows in enumerate(parts):
            rows.append(curve.derivative(order)(inside) if order else curve(inside))
    return times, *(np.concatenate(rows) for rows in parts)


def check(solution, period, *, limits=None):
    """Assert that a motion on the clock of a controller holds when interpolated."""
    assert solution.success, solution.message
    assert solution.verification.ok
    assert solution.options.control_period == period
    robot, motion = solution.problem.robot, solution.trajectory
    ticks = motion.t / period
    assert np.all(np.abs(ticks - np.rint(ticks)) <= 1e-12 * np.maximum(ticks, 1.0))
    samples = motion.sample(period)
    count = round(motion.duration / period)
    assert samples.t.size == count + 1
    np.testing.assert_allclose(samples.t, np.arange(count + 1) * period, rtol=4e-16)
    assert np.all(np.isin(motion.t, samples.t))  # knots are samples to the last bit
    np.testing.assert_allclose(motion.q[0], solution.problem.q_start, atol=1e-12)
    smooth = motion.a is None or motion.a.shape[0] == motion.t.size
    cubic = motion.a is None or motion.a.shape[0] == motion.t.size - 1
    bound = robot.limits
    for quintic in [False] * cubic + [True] * smooth:
        times, q, v, a = as_interpolated(samples, quintic=quintic)
        planned = motion(times)
        speed = np.max(np.abs(planned.v))
        np.testing.assert_allclose(q, planned.q, atol=1e-9)
        np.testing.assert_allclose(v, planned.v, atol=1e-7 * max(speed, 1.0))
        u = torques(robot, q, v, a)
        half = 0.5 * (bound.effort_upper - bound.effort_lower)
        assert np.all(u <= bound.effort_upper + 5e-3 * half)
        assert np.all(u >= bound.effort_lower - 5e-3 * half)
        assert np.all(np.abs(v) <= bound.velocity * 1.005)
        assert np.all(q <= bound.position_upper + 1e-6)
        assert np.all(q >= bound.position_lower - 1e-6)
        if limits is not None:
            names = robot.joint_names
            assert np.all(np.abs(a) <= 1.005 * limits.by_joint("acceleration", names))
            inside = a.reshape(count, SHARES.size, -1)
            jerk = np.diff(inside, axis=1) / (period * np.diff(SHARES)[:, None])
            assert np.all(np.abs(jerk) <= 1.005 * limits.by_joint("jerk", names) + 1e-3)


OF_MOTIONS = {"torques": None, "limits": LIMITS}


@cache
def without_a_clock(limits):
    """A motion of the UR5 by default, with limits of that name."""
    robot = tm.load_robot("ur5", limits="urdf")
    return tm.plan(ur5_problem(robot, motion_limits=OF_MOTIONS[limits]))


@pytest.mark.parametrize("period", PERIODS)
@pytest.mark.parametrize("limits", OF_MOTIONS)
def test_interpolated_motion_equals_the_planned_motion(period, limits):
    free = without_a_clock(limits)
    problem, limits = free.problem, OF_MOTIONS[limits]
    solution = tm.plan(problem, control_period=period)
    check(solution, period, limits=limits)
    # The motion on the clock is a little slower, and not faster.
    assert solution.T >= free.T * (1.0 - 1e-3)
    assert solution.T <= 1.03 * free.T
    np.testing.assert_allclose(solution.trajectory.q[-1], problem.goal.q, atol=1e-9)
    assert f"{period:g} s" in solution.message


def test_without_a_period_samples_break_torque_limits(ur5):
    """Regression: a controller interpolated another motion than the planned one."""
    problem = ur5_problem(ur5)
    samples = plan_quickly(problem, control="constant").trajectory.sample(0.008)
    _, q, v, a = as_interpolated(samples, quintic=False)
    excess = np.abs(torques(ur5, q, v, a)) - ur5.limits.effort_upper
    assert np.max(excess) > 1.0


@pytest.mark.parametrize(
    "options",
    [
        {"control": "constant"},
        {"control": "linear"},
        {"control": "spline"},
        {"method": "collocation"},
        {"method": "adjoint"},
        {"refine": "grid"},
        {"intervals": 8},
        {"grid": "uniform"},
        {"starts": 3, "seed": 4},
        {"objective": "feasible"},
        {"slack": 0.02},
        {"slack": 0.02, "control": "constant"},
        {"lp_solver": "highs"},
        {"smoothing": 0.0},
    ],
    ids=str,
)
def test_clock_holds_with_every_option(planar3r, options):
    problem = planar_problem(planar3r)
    free = plan_quickly(problem, **options)
    solution = plan_quickly(problem, control_period=0.01, **options)
    check(solution, 0.01)
    if options.get("objective") != "feasible":
        assert solution.T <= 1.03 * free.T + 0.01


def test_spline_motion_is_interpolated_by_quintic_polynomials(planar3r):
    solution = plan_quickly(
        planar_problem(planar3r), control="spline", control_period=0.01
    )
    motion = solution.trajectory
    assert motion.a is not None and motion.a.shape == motion.q.shape
    check(solution, 0.01)


def test_motion_of_the_penalty_method_is_brought_to_the_clock(planar3r):
    problem = planar_problem(planar3r)
    options = {"method": "penalty", "intervals": 16}
    solution = plan_quickly(problem, control_period=0.01, **options)
    if plan_quickly(problem, **options).success:
        check(solution, 0.01)
    else:
        assert not solution.success


@pytest.mark.parametrize(
    "goal",
    [
        tm.PositionGoal(TIP, (0.4, 0.3, 0.5)),
        tm.PositionGoal(TIP, (0.4, 0.3, 0.5), (0.2, 0.0, 0.1)),
        tm.JointGoal(UR5_END, (0.5, 0.2, -0.3, 0.1, 0.0, 1.0)),
        tm.JointRegionGoal(UR5_END, np.full(6, 0.1)),
        tm.AnyGoal([tm.JointGoal(UR5_END), tm.PositionGoal(TIP, (0.4, 0.3, 0.5))]),
    ],
    ids=["position", "moving position", "moving joints", "region", "any"],
)
@pytest.mark.parametrize("moving", [False, True])
def test_clock_holds_with_all_goals_and_moving_starts(ur5, goal, moving):
    v_start = (0.6, -0.4, 0.2, 0.0, 0.5, -0.5) if moving else np.zeros(6)
    problem = replace(ur5_problem(ur5), goal=goal, v_start=v_start)
    quick = {"starts": 1, "intervals": 20}
    solution = plan_quickly(problem, control_period=0.008, **quick)
    check(solution, 0.008)
    free = plan_quickly(problem, **quick)
    assert solution.T <= 1.03 * free.T + 0.008
    np.testing.assert_allclose(solution.trajectory.v[0], v_start, atol=1e-9)


@pytest.mark.parametrize("control", ["constant", "linear"])
def test_clock_keeps_the_clearance_to_moving_obstacles(planar3r, control):
    """The motion must not merely be stretched in time."""
    ball = tm.Sphere(
        "ball",
        radius=0.6,
        position=(3.2, -3.0, 0.0),
        motion=tm.ConstantVelocity(velocity=(0.0, 2.5, 0.0)),
    )
    problem = planar_problem(planar3r, scene=tm.Scene([ball]), margin=0.02)
    solution = plan_quickly(problem, control=control, intervals=20, control_period=0.01)
    check(solution, 0.01)
    # Interpolated as the controller does, with the obstacle at the same times.
    times, q, _, _ = as_interpolated(solution.trajectory.sample(0.01), quintic=False)
    room = problem.checker.distances(q, times=times)
    assert np.min(room) > 0.02 - 2e-5
    assert solution.verification.min_clearance > 0.02 - 2e-5


def test_clock_keeps_the_clearance_to_static_obstacles(ur5):
    post = tm.Cylinder("post", radius=0.05, length=1.0, position=(0.5, 0.1, 0.5))
    problem = ur5_problem(ur5, scene=tm.Scene([post]), margin=0.01)
    solution = plan_quickly(problem, control_period=0.004)
    check(solution, 0.004)
    _, q, _, _ = as_interpolated(solution.trajectory.sample(0.004), quintic=False)
    assert np.min(problem.checker.distances(q)) > 0.01 - 2e-5


@pytest.mark.parametrize(
    "limits",
    [
        tm.MotionLimits(effort_scale=0.8),
        tm.MotionLimits(effort_curves={"joint2": tm.EffortCurve.droop(60.0, 6.0)}),
        tm.MotionLimits(effort_rate=400.0),
        tm.MotionLimits(jerk=60.0),
        tm.MotionLimits(acceleration=8.0),
    ],
    ids=["share", "torque over speed", "torque rate", "jerk", "acceleration"],
)
def test_clock_holds_with_motion_limits_of_all_kinds(planar3r, limits):
    if limits.effort_curves:
        curve = next(iter(limits.effort_curves.values()))
        limits = replace(limits, effort_curves={planar3r.joint_names[1]: curve})
    problem = planar_problem(planar3r, motion_limits=limits)
    solution = plan_quickly(problem, control_period=0.01)
    check(solution, 0.01)
    assert solution.T <= 1.03 * plan_quickly(problem).T + 0.01


def test_warm_start_is_brought_to_the_clock(planar3r, free, clocked):
    near = planar_problem(planar3r, goal=tm.JointGoal((0.92, -1.18, -0.9)))
    for start in (clocked, free.trajectory):
        check(plan_quickly(near, start=start, control_period=0.01), 0.01)
    same = plan_quickly(clocked.problem, start=clocked, control_period=0.01)
    check(same, 0.01)
    assert same.T <= clocked.T + 1e-9


def test_smoothed_motion_stays_on_the_clock(clocked):
    quiet = tm.smooth(clocked, 0.03)
    check(quiet, 0.01)
    assert quiet.roughness < clocked.roughness
    count = round(quiet.T / 0.01)
    assert 1.03 * clocked.T <= quiet.T + 1e-9 < 1.03 * clocked.T + 0.01
    assert quiet.T == pytest.approx(count * 0.01, rel=1e-15)


def test_motion_on_a_coarse_clock_has_a_knot_at_every_tick(free):
    """The period is up to half of the motion: with few ticks, all of them are knots."""
    for period in (0.05, free.T / 7.5, free.T / 2.1):
        check(plan_quickly(free.problem, control_period=period), period)


@pytest.mark.parametrize(
    "period",
    [0, 0.0, -0.004, np.nan, np.inf, "0.004", "4ms", [0.004], True, 1j, {}],
    ids=repr,
)
def test_invalid_control_period_is_named_in_the_error(planar3r, period):
    with pytest.raises(OptionsError, match=r"^control_period is ") as caught:
        tm.plan(planar_problem(planar3r), control_period=period)
    assert caught.value.option == "control_period"


@pytest.mark.parametrize("share", [0.3, 0.6])
def test_motion_shorter_than_four_periods_takes_four_periods(free, share):
    period = share * free.T
    solution = plan_quickly(free.problem, control_period=period)
    check(solution, period)
    assert solution.status is tm.Status.CONVERGED
    assert pytest.approx(4 * period) == solution.T


@pytest.mark.parametrize("period", [1.01, 4, 1e9])
def test_control_period_above_one_second_is_rejected(planar3r, period):
    expected = r"expected a positive number \[s\], at most 1"
    with pytest.raises(OptionsError, match=expected):
        tm.plan(planar_problem(planar3r), control_period=period)


@pytest.mark.parametrize("period", [1e-9, 1e-300, 5e-324])
def test_control_period_with_too_many_samples_is_rejected(period):
    rail = tm.Problem(make_arm(slide(1.0), effort=1.0), [0.0], tm.JointGoal([1.0]))
    with pytest.raises(OptionsError, match="too short"):
        plan_quickly(rail, control_period=period)


def test_exact_switching_times_are_rejected_with_a_clock(planar3r):
    with pytest.raises(OptionsError, match="between ticks"):
        tm.plan(planar_problem(planar3r), refine="switching", control_period=0.01)


def test_clock_is_rejected_for_joints_without_motors():
    arm = tm.load_robot("planar3r", effort=[50.0, 50.0, 0.0], gravity=(0, 0, 0))
    assert arm.passive_joints
    with pytest.raises(OptionsError, match="has no motor"):
        tm.plan(planar_problem(arm), control_period=0.01)


def test_options_may_be_given_by_name_and_override_the_record(planar3r):
    problem = planar_problem(planar3r)
    given = tm.Options(intervals=12, control_period=0.02, starts=2, **QUICK)
    solution = tm.plan(problem, given, intervals=16, control_period=0.01)
    assert (solution.options.intervals, solution.options.starts) == (16, 2)
    check(solution, 0.01)
    off = plan(problem, given, control_period=None)
    assert off.options.control_period is None
    assert given.intervals == 12
    with pytest.raises(OptionsError, match=r"did you mean intervals\?") as caught:
        tm.plan(problem, interval_s=60)
    assert caught.value.option == "interval_s"
    with pytest.raises(OptionsError, match=r"did you mean control_period or"):
        tm.plan(problem, given, controlperiod=0.01)
    with pytest.raises(OptionsError, match="there are: method, intervals"):
        tm.plan(problem, zzz=1)
    with pytest.raises(OptionsError, match=r"^intervals is "):
        tm.plan(problem, intervals=0)


def count_calls(problem):
    """The number of calls of the callback without a clock."""
    calls = []
    plan_quickly(problem, callback=calls.append)
    return len(calls)


def test_motion_interrupted_before_the_clock_is_still_brought_to_it(planar3r):
    """A motion off the clock is not a result: it is still brought to the clock."""
    problem, calls = planar_problem(planar3r), []
    before = count_calls(problem)

    def stop(record):
        calls.append(record)
        return len(calls) > before

    solution = plan_quickly(problem, callback=stop, control_period=0.01)
    assert len(calls) == before + 1
    assert solution.status is tm.Status.INTERRUPTED
    check(solution, 0.01)


@pytest.mark.parametrize("how", ["callback", "signal"])
def test_interrupted_search_brings_its_motion_to_the_clock(ur5, how):
    def stop(record):
        ended = record.violation < 1e-6 and record.iteration >= 2
        if ended and how == "signal":
            raise KeyboardInterrupt
        return ended

    problem = ur5_problem(ur5)
    assert plan_quickly(problem, callback=stop).success
    solution = plan_quickly(problem, callback=stop, control_period=0.004)
    assert solution.status is tm.Status.INTERRUPTED
    check(solution, 0.004)


def test_interrupt_during_the_clock_programs_is_no_success(planar3r, monkeypatch):
    def interrupt(*given, **named):
        raise KeyboardInterrupt

    monkeypatch.setattr("tominpmp.planner.control_period.solve", interrupt)
    solution = plan_quickly(planar_problem(planar3r), control_period=0.01)
    assert not solution.success
    assert solution.status is tm.Status.INTERRUPTED
    assert solution.trajectory is not None


def test_motion_of_objective_feasible_is_shortened_to_the_tick(planar3r, monkeypatch):
    """Regression: a feasible motion ended the iteration, and took a period more."""
    known, objectives = clock.solve, []

    def solved(program, objective, *given, **named):
        objectives.append(objective)
        return known(program, objective, *given, **named)

    monkeypatch.setattr(clock, "solve", solved)
    problem = planar_problem(planar3r)
    plan_quickly(problem, objective="feasible", control_period=0.01)
    assert [objective.any_will_do for objective in objectives] == [False]


@pytest.mark.parametrize("readings", [20.0, 60.0, 200.0, 700.0])
def test_planning_time_is_reserved_for_the_clock(planar3r, request, readings):
    """However short the planning time, a motion called a success is on the clock.

    Time passes with every reading of the clock, of which there would be 930.
    """
    request.getfixturevalue("clock").tick = 1.0
    problem = planar_problem(planar3r)
    solution = tm.plan(problem, max_planning_time=readings, control_period=0.01)
    assert solution.status is tm.Status.TIME_LIMIT
    assert solution.success or readings < 700.0
    if solution.success:
        check(solution, 0.01)


def test_plan_without_a_motion_on_the_clock_is_infeasible(planar3r, monkeypatch):
    """The message says that no motion on the clock was found, and success is false."""
    monkeypatch.setattr("tominpmp.planner.control_period.TRIALS", 1)
    monkeypatch.setattr(
        "tominpmp.planner.control_period.ticks_of",
        lambda T, period: int(0.8 * T / period),
    )
    solution = plan_quickly(planar_problem(planar3r), control_period=0.01)
    assert not solution.success
    assert solution.status is tm.Status.INFEASIBLE
    assert "No motion on a clock of 0.01 s was found" in solution.message


def test_control_period_survives_a_scenario_file(planar3r, tmp_path: Path):
    path = tmp_path / "problem.toml"
    options = tm.Options(control_period=0.004, **QUICK)
    tm.save_scenario(path, planar_problem(planar3r), options)
    assert "control_period = 0.004" in path.read_text()
    scenario = tm.load_scenario(path)
    assert scenario.options.control_period == 0.004
    check(tm.plan(scenario.problem, scenario.options), 0.004)


def test_knots_near_are_the_ticks_nearest_to_the_nodes():
    nodes = np.array([0.0, 0.001, 0.4, 0.404, 0.9, 1.0])
    assert knots_near(nodes, 10).tolist() == [0, 4, 9, 10]
    assert knots_near(2.0 + 0.3 * nodes, 10).tolist() == [0, 4, 9, 10]
    # Further ticks fill up the requested number of intervals, up to every tick.
    assert knots_near(nodes, 10, 5).tolist() == [0, 2, 4, 6, 9, 10]
    assert knots_near(nodes, 10, 99).tolist() == list(range(11))
    assert ticks_of(1.0, 0.1) == 10
    assert ticks_of(1.0 + 1e-9, 0.1) == 10
    assert ticks_of(1.0 + 1e-4, 0.1) == 11


@pytest.mark.parametrize("control", ["constant", "linear"])
def test_clock_holds_with_dry_friction(control):
    """Torques jump where joints reverse: between ticks as well as at ticks."""
    arm = tm.load_robot("ur5", limits="urdf", friction=4.0)
    problem = ur5_problem(arm)
    solution = plan_quickly(problem, control=control, control_period=0.008)
    assert solution.success and solution.verification.ok
    _, q, v, a = as_interpolated(solution.trajectory.sample(0.008), quintic=False)
    moving = np.abs(v) > 1e-6
    u = torques(arm, q, v, a) + 4.0 * np.sign(v) * moving
    # A joint at rest is held by as much friction as necessary.
    assert np.all(np.abs(u) <= arm.limits.effort_upper * 1.005 + 4.0 * ~moving)
    assert solution.T <= 1.03 * plan_quickly(problem, control=control).T + 0.008


def test_self_collision_on_the_clock_adds_rows_of_links(ur5, monkeypatch):
    """Rows of link pairs join the program after a self-collision on the clock."""
    seen, touching = [], iter([True])
    original_solve, original_verify = clock.solve, candidate.verify

    def solve(program, *given, **named):
        seen.append(program.system.clearance is not None)
        return original_solve(program, *given, **named)

    def verify(problem, motion, *given, **named):
        found, ticks = (
            original_verify(problem, motion, *given, **named),
            motion.t / 0.008,
        )
        free = np.any(np.abs(ticks - np.rint(ticks)) > 1e-9)
        if free or not next(touching, False):
            return found
        touch = LimitViolation("clearance", "a and b", 0.1, 0.01, "m", 0.01, True)
        return replace(found, ok=False, violations=(touch,))

    monkeypatch.setattr(clock, "solve", solve)
    monkeypatch.setattr(candidate, "verify", verify)
    solution = tm.plan(ur5_problem(ur5), control_period=0.008)
    check(solution, 0.008)
    assert seen[0] is False and seen[-1] is True
