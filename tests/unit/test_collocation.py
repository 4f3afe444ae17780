"""The collocation transcription: rows, bounds, guesses, and optimal durations."""

from __future__ import annotations

import numpy as np
import pytest
from planar_samples import OBSTACLE, START, planar
from sample_arms import DOWNWARD, make_arm, rod, slide

import tominpmp as tm
from tominpmp.constraints.friction import Signs
from tominpmp.linear_programs.choice import make_solver
from tominpmp.solvers import loop
from tominpmp.solvers.objective import MinimumTime
from tominpmp.solvers.trust_region_step import trust_regions
from tominpmp.status import Status
from tominpmp.transcription.collocation import CollocationTranscription
from tominpmp.transcription.integrator import rollout
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import NonlinearProgram

INTERVALS = 8


JOINT = planar(tm.JointGoal((0.5, 1, 1)))
POSITION = planar(tm.PositionGoal("tip", (4, 1, 0)), scene=OBSTACLE)
MOVING = planar(
    tm.PositionGoal("tip", (4, 1, 0), v=(1, 0, 0)), v_start=(0.1, -0.2, 0.3)
)


def build(problem, intervals=INTERVALS):
    shares = np.full((intervals, 1), 1.0 / intervals)
    transcription = CollocationTranscription(ProblemFunctions.of(problem), shares, 1.0)
    return NonlinearProgram.of(transcription)


def kind_rows(nlp, kind):
    return np.flatnonzero(nlp.rows.kind == nlp.rows.kinds.index(kind))


def fall(nlp, T=0.4):
    """States, torques and duration of the arm that falls without torques."""
    problem, N = nlp.system.problem, nlp.transcription.shares.shape[0]
    u = np.zeros((N, nlp.system.n))
    v = np.zeros(nlp.system.n) if problem.v_start is None else problem.v_start
    x = np.concatenate([problem.q_start, v])
    motion = rollout(nlp.system.dynamics, x, u, nlp.transcription.shares[:, 0] * T)
    return motion, u, np.array([T])


def test_integrated_motion_has_no_defects():
    nlp = build(MOVING)
    motion, u, eta = fall(nlp)
    values = nlp.evaluate(nlp.transcription.pack(motion.x, u, eta))
    np.testing.assert_allclose(values[kind_rows(nlp, "dynamics")], 0.0, atol=1e-10)
    # The inner stages, at a third of each interval, have velocity rows, too.
    limits = nlp.system.problem.robot.limits.velocity
    np.testing.assert_allclose(
        values[kind_rows(nlp, "velocity")].reshape(-1, 3),
        motion.inner[:, 3:] / limits,
        atol=1e-10,
    )


def test_pack_replaces_end_states_and_clips_to_the_limits(rng):
    nlp = build(JOINT)
    x = 10.0 * rng.normal(size=(INTERVALS + 1, 6))
    u = 100.0 * rng.normal(size=(INTERVALS, 3))
    states, torques, h = nlp.transcription.split(
        nlp.transcription.pack(x, u, np.array([1.5]))
    )
    limits = JOINT.robot.limits
    np.testing.assert_array_equal(states[0], [*START, 0, 0, 0])
    np.testing.assert_array_equal(states[-1], [0.5, 1, 1, 0, 0, 0])
    assert np.all(states[:, :3] >= limits.position_lower)
    assert np.all(states[:, :3] <= limits.position_upper)
    assert np.all(np.abs(torques) <= limits.effort_upper + 1e-12)
    assert h.sum() == pytest.approx(1.5)


@pytest.mark.parametrize("problem", [JOINT, POSITION, MOVING])
@pytest.mark.parametrize("radius", [1e-3, 0.3, 10.0])
def test_steps_stay_within_limits_and_trust_region(rng, problem, radius):
    nlp = build(problem)
    x = np.tile([*START, 0, 0, 0], (INTERVALS + 1, 1))
    x += 0.3 * rng.normal(size=x.shape)
    u = problem.robot.limits.effort_upper * rng.uniform(-1, 1, (INTERVALS, 3))
    z = nlp.transcription.pack(x, u, np.array([0.8]))
    steps = nlp.step_bounds(z, radius)
    assert np.all(steps.lower <= 0) and np.all(steps.upper >= 0)
    limits = problem.robot.limits
    for step in (steps.lower, steps.upper):
        states, torques, h = nlp.transcription.split(z + step)
        assert np.all(states[:, :3] >= limits.position_lower - 1e-12)
        assert np.all(states[:, :3] <= limits.position_upper + 1e-12)
        assert np.all(np.abs(torques) <= limits.effort_upper + 1e-12)
        assert np.all(h > 0)
        moved = states - nlp.transcription.split(z)[0]
        assert np.abs(moved[:, :3]).max() <= radius + 1e-12
        assert not moved[0].any()
        if problem is JOINT:
            assert not moved[-1].any()
        assert moved[-1, 3:].any() == (problem is MOVING)


def test_passive_joint_keeps_a_torque_of_zero():
    problem = planar(
        tm.JointGoal((0.5, 1, 1)), effort={"joint2": 0.0}, gravity=(0, 0, 0)
    )
    nlp = build(problem)
    z = nlp.transcription.start(lambda t: np.tile(START, (t.size, 1)), 1.0, np.ones(1))
    steps = nlp.step_bounds(z, 1.0)
    _, more, _ = nlp.transcription.split(z + steps.upper)
    _, less, _ = nlp.transcription.split(z + steps.lower)
    np.testing.assert_array_equal(more[:, 1], 0.0)
    np.testing.assert_array_equal(less[:, 1], 0.0)
    assert np.all(more[:, [0, 2]] > less[:, [0, 2]])
    assert nlp.transcription.variation(z).offset.size == 2 * (INTERVALS - 1)


def test_initial_iterate_follows_the_path_of_the_guess():
    """The velocities of a parabola are exact, and the torques drive this motion."""
    nlp = build(MOVING)
    v0, a = MOVING.v_start, np.array([0.4, -0.3, 0.2])

    def parabola(t):
        return START + v0 * t[:, None] + 0.5 * a * t[:, None] ** 2

    z = nlp.transcription.start(parabola, 0.8, np.array([0.8]))
    t = np.linspace(0.0, 0.8, INTERVALS + 1)[:, None]
    states, torques, _ = nlp.transcription.split(z)
    np.testing.assert_allclose(states[:, 3:], v0 + a * t, atol=1e-12)
    middle = 0.5 * (states[:-1] + states[1:])
    expected = nlp.system.dynamics.inverse(
        middle[:, :3], middle[:, 3:], np.tile(a, (INTERVALS, 1))
    )
    limits = MOVING.robot.limits
    expected = np.clip(expected, limits.effort_lower, limits.effort_upper)
    np.testing.assert_allclose(torques, expected, atol=1e-12)


def test_clearance_rows_are_those_that_a_step_can_violate():
    nlp = build(POSITION)
    # From far above the obstacle to near it.
    end = np.array([0.63, -0.56, -2.08])
    path = START + np.linspace(0, 1, INTERVALS + 1)[:, None] * (end - START)
    z = nlp.transcription.start(lambda _: path, 1.0, np.array([1.0]))
    values = nlp.evaluate(z)
    rows = kind_rows(nlp, "clearance")
    chosen = nlp.linearize(z, values, nlp.step_bounds(z, 0.02)).rows
    near = np.intersect1d(chosen, rows)
    assert 0 < near.size < rows.size
    assert values[near].min() > values[np.setdiff1d(rows, near)].max()


def test_total_variation_is_in_ranges_of_the_torque():
    nlp = build(JOINT)
    limits = JOINT.robot.limits.effort_upper
    u = np.zeros((INTERVALS, 3))
    u[3:, 0], u[:5, 2] = limits[0], -limits[2]
    z = nlp.transcription.pack(np.zeros((INTERVALS + 1, 6)), u, np.array([1.0]))
    assert nlp.transcription.variation(z).total(z) == pytest.approx(0.5 + 0.5)


def test_time_scaling_keeps_the_path():
    nlp = build(JOINT)
    line = START + np.linspace(0, 1, INTERVALS + 1)[:, None] * (JOINT.goal.q - START)
    z = nlp.transcription.start(lambda _: line, 2.0, np.array([2.0]))
    fast, slow = nlp.trajectory(z), nlp.trajectory(nlp.time_scale(z, 3.0))
    np.testing.assert_allclose(slow.q, fast.q)
    np.testing.assert_allclose(slow.v, fast.v / 3.0)
    np.testing.assert_allclose(slow.t, 3.0 * fast.t)
    assert slow.duration == pytest.approx(nlp.cost @ nlp.time_scale(z, 3.0))
    np.testing.assert_array_equal(fast.u[-1], fast.u[-2])


def solve(nlp, z, **options):
    options = tm.Options(tolerance=1e-6, **options)
    method = trust_regions(options, make_solver("highs"))
    return loop.solve(nlp, MinimumTime.of(options), z, *method)


def on_a_rail(velocity=1e3):
    """A mass moves one metre with 2 m/s^2 at most, from rest to rest."""
    robot = make_arm(slide(2.0), effort=4.0, velocity=velocity)
    nlp = build(tm.Problem(robot, [0.0], tm.JointGoal([1.0])), 20)
    return nlp, nlp.transcription.start(lambda t: t[:, None], 1.0, np.array([4.0]))


def test_mass_on_a_rail_is_time_optimal():
    result = solve(*on_a_rail())
    assert result.status is Status.CONVERGED
    assert result.best.duration == pytest.approx(2.0 * np.sqrt(1.0 / 2.0), rel=1e-6)


def test_mass_on_a_rail_is_time_optimal_within_its_speed_limit():
    nlp, z = on_a_rail(0.8)
    result = solve(nlp, z)
    # d / v + v / a; the switches lie within intervals.
    least = 1.0 / 0.8 + 0.8 / 2.0
    assert least * (1 - 1e-9) <= result.best.duration <= 1.01 * least
    motion = nlp.trajectory(result.best.z)
    assert np.abs(motion.v).max() <= 0.8 * (1 + 1e-9)


def test_effort_scale_holds_from_the_first_iterate():
    """Regression: the first iterate had torques above the scaled limit.

    No step had to reduce them.
    """
    share = tm.MotionLimits(effort_scale=0.5)
    problem = planar(tm.JointGoal((1.3, 1.3, -1.14)), motion_limits=share)
    of = build(problem).transcription
    z = of.pack(np.zeros((INTERVALS + 1, 6)), np.full((INTERVALS, 3), 1e3), np.ones(1))
    np.testing.assert_array_equal(of.shares_at(z), 1.0)
    solution = tm.plan(problem, method="collocation", effort="quick")
    assert solution.verification.ok


@pytest.mark.parametrize(
    ("free", "gravity", "end", "least", "most"),
    [
        (True, True, (-0.08, 1.49, -2.22), 0.830, 0.835),
        (False, True, (0.18, 0.58, -2.74), 1.080, 1.085),
        (True, False, (-0.45, 1.84, -1.03), 0.714, 0.716),
        (False, False, (0.63, -0.56, -2.08), 0.859, 0.861),
    ],
)
def test_durations_of_the_papers_example(free, gravity, end, least, most):
    """The guess is a straight line that violates dynamics and clearance."""
    changes = {} if gravity else {"gravity": (0, 0, 0)}
    if free:
        changes |= {"position_lower": -np.inf, "position_upper": np.inf}
    scene = tm.Scene() if free else OBSTACLE
    problem = planar(tm.PositionGoal("tip", (4, 1, 0)), scene=scene, **changes)
    nlp = build(problem, 75)
    path = START + np.linspace(0, 1, 76)[:, None] * (np.array(end) - START)
    result = solve(nlp, nlp.transcription.start(lambda _: path, 1.5, np.array([1.5])))
    assert result.status is Status.CONVERGED
    assert len(result.history) <= 25
    assert least <= result.best.duration <= most
    assert result.best.violation <= 1e-6
    motion = nlp.trajectory(result.best.z)
    limits = problem.robot.limits
    full = np.abs(motion.u[:-1]) >= (1 - 1e-6) * limits.effort_upper
    assert np.mean(full.any(axis=1)) >= 0.95
    tip = nlp.system.kinematics.placement(motion.q[-1], "tip").translation
    np.testing.assert_allclose(tip, (4, 1, 0), atol=1e-6)
    np.testing.assert_allclose(motion.v[-1], 0.0, atol=1e-9)
    assert np.all(motion.q >= limits.position_lower - 1e-9)
    if not free:
        assert nlp.system.clearance.values(motion.q).max() <= 1e-6


def test_slow_motion_has_intervals_short_enough_for_its_dynamics():
    """Regression: torques held for 0.3 s drove the arm 444 units from the line."""
    arm = make_arm(
        rod(2.486, 1.049),
        rod(1.476, 1.077).with_payload(1.221),
        effort=np.array([161.476, 84.352]),
        gravity=DOWNWARD,
        velocity=0.14514,
    )
    goal = tm.JointGoal((0.38757, 0.65488))
    problem = tm.Problem(arm, (0.77989, -1.17228), goal)
    solution = tm.plan(problem, method="collocation", starts=1)
    assert solution.success, solution.message
    assert solution.lower_bound is not None
    assert solution.T < 1.05 * solution.lower_bound.T


def test_fast_motion_gets_a_grid_fine_enough_for_its_replay():
    """Regression: two refinements of the grid were too few.

    Every start failed its replay, for 100 s.
    """
    start = [-0.492, 2.918, 1.347, -2.1, -3.037, 2.053]
    goal = tm.JointGoal([2.45, -3.074, -2.031, -2.455, 1.546, -0.541])
    problem = tm.Problem(tm.load_robot("ur5", limits="urdf"), start, goal)
    solution = tm.plan(problem, method="collocation", starts=1, max_iterations=100)
    assert solution.success, solution.message
    smooth = tm.plan(problem, starts=1)
    assert solution.T < 1.05 * smooth.T


def test_message_names_the_length_of_too_long_intervals():
    """At 2 mrad/s the finest grid holds torques for seconds."""
    arm = make_arm(
        rod(1.0, 1.0),
        rod(1.0, 0.7),
        effort=np.array([40.0, 20.0]),
        gravity=DOWNWARD,
        velocity=0.002,
    )
    problem = tm.Problem(arm, (1.0, 0.5), tm.JointGoal((-0.5, -0.3)))
    few = {"intervals": 10, "starts": 1, "max_iterations": 3}
    solution = tm.plan(problem, method="collocation", **few)
    assert not solution.success
    assert "keeps torques for up to" in solution.message


def test_torques_include_the_friction_of_the_actual_direction() -> None:
    """An assumed direction may be wrong where no torque is near its limit."""
    robot = make_arm(slide(2.0), effort=100.0, friction=3.0)
    problem = tm.Problem(robot, [0.0], tm.JointGoal([1.0]))
    system = ProblemFunctions.of(problem)
    transcription = CollocationTranscription(system, np.full((4, 1), 0.25), 1.0)
    x = np.array([[0.0, 0.0], [0.125, 1.0], [0.5, 2.0], [0.875, 1.0], [1.0, 0.0]])
    force = 8.0 * np.array([[1.0], [1.0], [-1.0], [-1.0]])
    z = transcription.pack(x, force, np.ones(1))
    backwards = Signs.of(system.friction, -np.ones((4, 1)))
    assert transcription.with_signs(1.0, backwards).with_signs_of(z) is None
    motion = transcription.with_signs(1.0, backwards).trajectory(z)
    assert motion.u[:4, 0] == pytest.approx([11.0, 11.0, -5.0, -5.0])


def test_initial_torques_are_within_the_limits_of_their_direction():
    """Regression: initial torques beyond these limits stayed there.

    Step bounds only keep torques within the limits from leaving them.
    """
    arm = make_arm(slide(1.0), effort=np.array([1.0]), friction=0.3)
    problem = tm.Problem(arm, [0.0], tm.JointGoal([1.0]))
    shares = np.full((INTERVALS, 1), 1.0 / INTERVALS)
    of = CollocationTranscription(ProblemFunctions.of(problem), shares, 1.0)
    # The guess is so fast that the torques of all intervals are at their limits.
    z = of.start(lambda t: t[:, None] ** 2, 1.0, np.array([0.01]))
    directed = of.scaled_at(z)
    lower, upper = directed.torque_bounds
    assert np.all(directed.signs.sign == 1.0)
    assert np.all(lower <= directed.shares_at(z))
    assert np.all(directed.shares_at(z) <= upper)
