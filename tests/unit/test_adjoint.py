"""The adjoint transcription: its rows, its selection of rows, and optimal durations."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
from planar_samples import OBSTACLE, START, planar
from sample_arms import DOWNWARD, make_arm, rod, slide

import tominpmp as tm
from tominpmp.linear_programs.choice import make_solver
from tominpmp.solvers import loop
from tominpmp.solvers.objective import MinimumTime
from tominpmp.solvers.trust_region_step import trust_regions
from tominpmp.status import Status
from tominpmp.transcription.adjoint import AdjointTranscription
from tominpmp.transcription.base import NOT_INTEGRATED
from tominpmp.transcription.collocation import CollocationTranscription
from tominpmp.transcription.exchange import exchanged
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import ATTAINED, NonlinearProgram

INTERVALS = 10


POSITION = planar(tm.PositionGoal("tip", (4, 1, 0)), scene=OBSTACLE)
JOINT = planar(tm.JointGoal((0.5, 1, 1), v=(0.1, 0.2, 0.3)), velocity=2.0)


def build(problem, intervals=INTERVALS, T=1.0, selection="near"):
    shares = np.full((intervals, 1), 1.0 / intervals)
    transcription = AdjointTranscription(ProblemFunctions.of(problem), shares, T)
    return NonlinearProgram.of(transcription, selection)


def throw(nlp, rng, T=0.6):
    limits = nlp.system.problem.robot.limits
    u = limits.effort_upper * rng.uniform(-0.5, 0.5, (INTERVALS, nlp.system.n))
    return nlp.transcription.pack(u, np.array([T]))


def kind_rows(nlp, kind):
    if kind not in nlp.rows.kinds:
        return np.zeros(0, dtype=int)
    return np.flatnonzero(nlp.rows.kind == nlp.rows.kinds.index(kind))


def test_rows_are_computed_from_the_states_of_the_motion(rng):
    nlp = build(JOINT, T=2.0)
    z = throw(nlp, rng)
    values, motion = nlp.evaluate(z), nlp.trajectory(z)
    goal = values[kind_rows(nlp, "goal")]
    np.testing.assert_allclose(goal[:3], motion.q[-1] - (0.5, 1, 1))
    # Velocities in units of 5 rad over the duration.
    np.testing.assert_allclose(goal[3:], (motion.v[-1] - (0.1, 0.2, 0.3)) / 2.5)
    position = values[kind_rows(nlp, "position")].reshape(-1, 3)
    np.testing.assert_allclose(position, motion.q[1:])
    velocity = values[kind_rows(nlp, "velocity")].reshape(-1, 3)
    np.testing.assert_allclose(velocity, motion.v[1:] / 2.0)
    assert motion.duration == pytest.approx(nlp.cost @ z)


def test_joints_without_limits_have_no_rows():
    free = planar(
        tm.JointGoal((0.5, 1, 1)),
        position_lower=-np.inf,
        position_upper={"joint1": np.inf, "joint3": np.inf},
        velocity=np.inf,
    )
    nlp = build(free)
    assert kind_rows(nlp, "position").size == INTERVALS  # joint2 from above
    assert kind_rows(nlp, "velocity").size == 0
    assert kind_rows(nlp, "clearance").size == 0


def test_exact_selection_linearizes_the_extremal_rows(rng):
    nlp = build(POSITION, selection="exact")
    z = throw(nlp, rng)
    values = nlp.evaluate(z)
    steps = nlp.step_bounds(z, 1.0)
    chosen = nlp.linearize(z, values, steps).rows
    at_end = [*kind_rows(nlp, "goal"), *kind_rows(nlp, "holding torque")]
    assert np.isin(at_end, chosen).all()
    expected = set(at_end)
    for kind, bounds in (("position", 2), ("velocity", 2), ("clearance", 1)):
        rows = kind_rows(nlp, kind).reshape(INTERVALS, -1)
        for excess in (values[rows], -values[rows])[:bounds]:
            # Other instants may be as extreme but for a tolerance.
            attained = excess >= excess.max(axis=0) - ATTAINED
            expected.update(rows[attained])
    assert set(chosen) == expected


def test_near_selection_leaves_out_rows_far_from_the_obstacle(rng):
    aside = tm.Scene([tm.Sphere("O", radius=0.3, position=(0, 1.5, 0))])
    nlp = build(planar(tm.JointGoal((0.5, 1, 1)), scene=aside))
    z = throw(nlp, rng)
    values = nlp.evaluate(z)
    chosen = nlp.linearize(z, values, nlp.step_bounds(z, 1.0)).rows
    left_out = np.setdiff1d(np.arange(nlp.rows.size), chosen)
    assert left_out.size > 0
    rows = kind_rows(nlp, "clearance")
    assert np.isin(left_out, rows).all() and np.isin(rows, chosen).any()
    assert values[left_out].max() < values[np.intersect1d(chosen, rows)].min()


def test_fixed_step_bounds_are_in_newton_metres_and_seconds(rng):
    nlp = build(POSITION)
    z = throw(nlp, rng)
    steps = nlp.transcription.fixed_steps(z, 0.05, 0.01)
    of = nlp.transcription
    u, T = of.torques(z), of.lengths(z).sum()
    for bound, sign in ((steps.lower, -1.0), (steps.upper, 1.0)):
        np.testing.assert_allclose(of.torques(z + bound) - u, sign * 0.05)
        assert of.lengths(z + bound).sum() - T == pytest.approx(sign * 0.01)
    full = nlp.transcription.pack(
        np.tile(POSITION.robot.limits.effort_upper, (10, 1)), z[-1:]
    )
    assert not nlp.transcription.fixed_steps(full, 0.05, 0.01).upper[:-1].any()
    # The duration stays positive, however large epsilon is.
    assert z[-1] + nlp.transcription.fixed_steps(z, 0.05, 100.0).lower[-1] > 0


@pytest.mark.parametrize("radius", [1e-3, 0.2, 10.0])
def test_trust_region_steps_stay_within_the_torque_limits(rng, radius):
    nlp = build(POSITION)
    z = throw(nlp, rng)
    steps = nlp.step_bounds(z, radius)
    for bound in (steps.lower, steps.upper):
        of = nlp.transcription
        torque, h = of.torques(z + bound), of.lengths(z + bound)
        assert np.all(np.abs(torque) <= POSITION.robot.limits.effort_upper + 1e-12)
        assert np.all(h > 0)
    # A share of the whole range, which is 2 in these units.
    assert np.abs([steps.lower[:-1], steps.upper[:-1]]).max() <= 4.0 * radius + 1e-12


def test_collocation_without_its_states_has_the_adjoint_rows(rng):
    adjoint = build(POSITION)
    z = throw(adjoint, rng)
    shot = adjoint.transcription
    lifted = NonlinearProgram.of(
        CollocationTranscription(adjoint.system, shot.shares, 1.0)
    )
    x = shot.motion(z).x
    point = np.concatenate([x.ravel(), z])
    values = lifted.evaluate(point)
    rows = lifted.linearize(point, values, lifted.step_bounds(point, 1.0))
    matrix = rows.matrix.tocsc()
    dynamics = lifted.rows.kind[rows.rows] == lifted.rows.kinds.index("dynamics")
    goal = lifted.rows.kind[rows.rows] == lifted.rows.kinds.index("goal")
    step = rng.normal(size=z.size)
    states = slice(6, x.size)  # all but the start
    by_control = matrix[dynamics][:, x.size :] @ step
    moved = sp.linalg.spsolve(matrix[dynamics][:, states], -by_control)
    got = matrix[goal][:, states] @ moved
    linear = adjoint.linearize(z, adjoint.evaluate(z), adjoint.step_bounds(z, 1.0))
    aim = adjoint.rows.kinds.index("goal")
    expected = (linear.matrix @ step)[adjoint.rows.kind[linear.rows] == aim]
    expected[3:] *= 5.0  # velocities are scaled there
    np.testing.assert_allclose(got, expected, rtol=1e-8, atol=1e-9)


def test_motion_that_cannot_be_integrated_violates_every_row():
    # A light wrist at full torque for a long interval.
    robot = tm.load_robot("ur5", limits="urdf")
    goal = tm.JointGoal((0.4, -1.0, 0.5, 0.1, 0.2, 0.0))
    nlp = build(tm.Problem(robot, (0.1, -1.2, 0.8, 0.3, 0.5, 0.2), goal), 4)
    z = nlp.transcription.pack(
        np.tile(robot.limits.effort_upper, (4, 1)), np.array([20.0])
    )
    values = nlp.evaluate(z)
    np.testing.assert_array_equal(values, NOT_INTEGRATED)
    linear = nlp.linearize(z, values, nlp.step_bounds(z, 1.0))
    assert linear.rows.size == 0 and linear.matrix.shape == (0, z.size)


def test_time_scaling_keeps_the_path_and_lengthens_the_duration(rng):
    problem = planar(tm.JointGoal((0.5, 1, 1)))
    nlp = build(problem, 200)
    t = np.linspace(0, 1, 200)[:, None]
    u = 2.0 * np.sin(np.pi * t) * [1.0, 0.5, 0.1]
    hold = problem.robot
    u = u + nlp.system.dynamics.inverse(START[None], np.zeros((1, 3)), np.zeros((1, 3)))
    z = nlp.transcription.pack(
        np.clip(u, hold.limits.effort_lower, hold.limits.effort_upper), [0.5]
    )
    fast, slow = nlp.trajectory(z), nlp.trajectory(nlp.time_scale(z, 1.5))
    assert slow.duration == pytest.approx(1.5 * fast.duration)
    assert np.abs(fast.q[-1] - START).max() > 0.05
    np.testing.assert_allclose(slow.q, fast.q, atol=5e-3)


def solve(nlp, z, **options):
    options = tm.Options(tolerance=1e-6, **options)
    method = trust_regions(options, make_solver("highs"))
    return loop.solve(nlp, MinimumTime.of(options), z, *method)


RAILS = [("near", 20), ("near", 40), ("exact", 20), ("exact", 30)]


@pytest.mark.parametrize(("selection", "N"), RAILS)
def test_mass_on_a_rail_is_time_optimal_within_its_speed_limit(selection, N):
    # Instants that become rows once they are violated, the paper's choice, make no
    # smooth constraints: a trust region may end at a kink (with 25 intervals, for
    # example), which depends on the vertex that the solver takes. Plans use "near".
    robot = make_arm(slide(2.0), effort=4.0, velocity=0.8)
    nlp = build(tm.Problem(robot, [0.0], tm.JointGoal([1.0])), N, selection=selection)
    result = solve(nlp, nlp.transcription.pack(np.zeros((N, 1)), np.array([1.0])))
    assert result.status is Status.CONVERGED
    least = 1.0 / 0.8 + 0.8 / 2.0  # d / v + v / a; the switches lie within intervals
    assert least * (1 - 1e-6) <= result.best.duration <= 1.01 * least
    assert np.abs(nlp.trajectory(result.best.z).v).max() <= 0.8 * (1 + 1e-6)


def test_row_exchange_adds_rows_for_speeds_between_nodes():
    """Regression: joints were up to 14 % too fast between nodes; no repair helped."""
    # Under constant torque a joint may be fastest within an interval.
    nlp = build(planar(tm.JointGoal((0.5, 1, 1)), velocity=np.inf), T=0.6)
    z = throw(nlp, np.random.default_rng(1))
    motion = nlp.trajectory(z)
    between = np.abs(motion(np.linspace(0.0, motion.duration, 2001)).v).max(axis=0)
    nodes = np.abs(motion.v).max(axis=0)
    joint = int(np.argmax(between / nodes))
    assert between[joint] > 1.02 * nodes[joint]
    limit = 0.5 * (between[joint] + nodes[joint])
    problem = planar(tm.JointGoal((0.5, 1, 1)), velocity={f"joint{joint + 1}": limit})
    nlp = build(problem, T=0.6)
    speeds = kind_rows(nlp, "velocity")
    assert nlp.rows.violation(nlp.evaluate(z))[speeds].max() == 0.0
    more = exchanged(nlp, z)
    assert more is not None
    speeds = kind_rows(more, "velocity")
    assert more.rows.violation(more.evaluate(z))[speeds].max() > 5e-3


SWINGING = tm.Problem(
    make_arm(
        *(rod(3.2, 0.28), rod(3.3, 0.86), rod(2.0, 0.78)),
        effort=(430.0, 83.0, 26.0),
        velocity=(4.1, 1.7, 3.6),
        gravity=DOWNWARD,
    ),
    (1.07, -0.29, -0.59),
    tm.JointGoal((-0.10, 0.38, -0.96)),
    self_collision=False,
)


def test_tracking_torques_follow_the_states_without_drift():
    nlp, eta = build(SWINGING, 40, T=1.0), np.array([1.0])
    start, way = SWINGING.q_start, SWINGING.goal.q - SWINGING.q_start
    s = np.linspace(0.0, 1.0, 41)[:, None]
    q = start + (3 * s**2 - 2 * s**3) * way
    x = np.hstack([q, (6 * s - 6 * s**2) * way])
    open_loop = nlp.system.driving_torque(q, x[:, 3:], np.full(40, 1 / 40))
    drifting = nlp.trajectory(nlp.transcription.pack(open_loop, eta))
    tracking = nlp.trajectory(nlp.transcription.tracking(x, eta))
    assert np.abs(drifting.q - q).max() > 0.5
    assert np.abs(tracking.q - q).max() < 2e-3
    limit = SWINGING.robot.limits.effort_upper
    assert np.all(np.abs(tracking.u) <= limit * (1 + 1e-12))


def test_adjoint_method_plans_a_three_link_arm_without_given_torques():
    solution = tm.plan(SWINGING, method="adjoint", starts=1, max_planning_time=np.inf)
    assert solution.status is Status.CONVERGED and solution.verification.ok
    assert solution.T <= 1.002 * tm.plan(SWINGING).T


@pytest.mark.parametrize(
    ("free", "gravity", "least", "most"),
    [
        (True, True, 0.830, 0.835),
        (False, True, 1.080, 1.085),
        (True, False, 0.714, 0.716),
        (False, False, 0.859, 0.861),
    ],
)
def test_durations_of_the_papers_example(free, gravity, least, most):
    """The guess is the paper's: no torque, T = 1.5, and every constraint violated."""
    changes = {} if gravity else {"gravity": (0, 0, 0)}
    if free:
        changes |= {"position_lower": -np.inf, "position_upper": np.inf}
    scene = tm.Scene() if free else OBSTACLE
    problem = planar(tm.PositionGoal("tip", (4, 1, 0)), scene=scene, **changes)
    nlp = build(problem, 75, T=1.5)
    z = nlp.transcription.pack(np.zeros((75, 3)), np.array([1.5]))
    result = solve(nlp, z)
    assert result.status is Status.CONVERGED
    assert least <= result.best.duration <= most
    assert result.best.violation <= 1e-6
    motion = nlp.trajectory(result.best.z)
    limits = problem.robot.limits
    full = np.abs(motion.u[:-1]) >= (1 - 1e-6) * limits.effort_upper
    assert np.mean(full.any(axis=1)) >= 0.95
    tip = nlp.system.kinematics.placement(motion.q[-1], "tip").translation
    np.testing.assert_allclose(tip, (4, 1, 0), atol=1e-6)
    if not free:
        assert np.all(motion.q >= limits.position_lower - 1e-6)
        assert nlp.system.clearance.values(motion.q).max() <= 1e-6


def test_failed_adjoint_plan_suggests_the_inverse_method():
    """Regression: the message advised another goal.

    Torques without feedback were the cause.
    """
    arm = make_arm(rod(1.0, 1.0), rod(0.5, 0.5), effort=np.full(2, 20.0))
    problem = tm.Problem(arm, np.zeros(2), tm.JointGoal(np.full(2, 2.0)))
    solution = tm.plan(problem, method="adjoint", intervals=5, starts=1)
    assert solution.status is Status.UNVERIFIED
    assert "its verification failed: joint" in solution.message
    assert "'inverse', for robots with all motors, does not" in solution.message
