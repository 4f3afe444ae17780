"""Derivatives of programs: every transcription with every constraint and type of goal.

Jacobians against central differences, whatever the instants of a constraint; weighted
sums of rows against the Jacobian; and programs with earlier evaluations against fresh
programs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from rollout_derivatives import differentiate_rollout

import tominpmp as tm
from tominpmp.motion_limits import EffortCurve, MotionLimits
from tominpmp.transcription import bspline
from tominpmp.transcription.adjoint import AdjointTranscription
from tominpmp.transcription.base import Transcription
from tominpmp.transcription.bspline import BSplineTranscription, InverseTranscription
from tominpmp.transcription.collocation import CollocationTranscription
from tominpmp.transcription.grid import interval_shares
from tominpmp.transcription.instants import Instants
from tominpmp.transcription.integrator import rollout, sweep_adjoint
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import NonlinearProgram, SampledRows

Array = np.ndarray

# Largest difference, as a share of the largest entry of a column or of 1; distances
# come from iterations.
DIFFERENCES, DISTANCES = 2e-6, 2e-5
EXACT = 1e-10
STEP = 1e-6
# Links that touch or cross have distances that cannot be differentiated.
APART = -5e-3
# The residual of Newton's iteration that begins from another motion.
NEWTON = 1e-8

INTERVALS = 6
START = np.array([0.5, 1.7, -1.7])
MIDDLE = np.array([0.9, 1.0, -0.6])
WRIST = np.array([0.1, -1.2, 0.8, 0.3, 0.5, 0.2])
BALL = tm.Scene([tm.Sphere("O", radius=0.8, position=(4, 0, 0))])
JOINT = tm.JointGoal((0.5, 1, 1))
CORNERS = tm.Waypoints(
    times=(0.0, 0.11, 0.26, 2.1),
    positions=[(-2.0, 6.0, 0.0), (-1.0, 5.5, 0.3), (0.5, 5.5, 0.0), (0.5, 6.5, 0.0)],
)
AT_ONCE = tm.ConstantVelocity(
    velocity=(0.5, -1.0, 0.2), angular=(0.1, 0.2, 1.5), pivot=(-4, 4.5, 0), begin=0.07
)
MOVERS = tm.Scene(
    [
        tm.Capsule("corners", radius=0.3, length=1.5, motion=CORNERS),
        tm.Capsule(
            "at once", radius=0.3, length=1.5, position=(-3, 5, 0), motion=AT_ONCE
        ),
    ]
)
CURVES = {"joint1": EffortCurve.droop(20.0, 10.0), "joint3": EffortCurve.droop(9.0, 7)}
STEADY = MotionLimits(acceleration=50.0, effort_scale=0.9, effort_curves=CURVES)
SMOOTH = replace(STEADY, jerk=500.0, effort_rate={"joint1": 200.0, "joint2": 90.0})


def planar(goal: tm.Goal = JOINT, velocity: float = 5.0, **options) -> tm.Problem:
    changed = [name for name in ("effort", "friction", "gravity") if name in options]
    changes = {name: options.pop(name) for name in changed}
    robot = tm.load_robot("planar3r", velocity=velocity, **changes)
    return tm.Problem(robot, START, goal, **options)


def pose(turn: float = 0.7) -> pin.SE3:
    return pin.SE3(pin.exp3(np.array([0.0, 0.0, turn])), np.array([4.0, 1.0, 0.0]))


LINEAR = ("linear", "spline")
PROBLEMS: dict[str, Callable[[], tm.Problem]] = {
    "position, obstacle": lambda: planar(
        tm.PositionGoal("tip", (4, 1, 0)), scene=BALL, margin=0.05
    ),
    "moving start and goal": lambda: planar(
        tm.JointGoal((0.5, 1, 1), v=(0.1, 0.2, 0.3)), v_start=(0.1, -0.2, 0.3)
    ),
    "tip velocity": lambda: planar(
        tm.PositionGoal("tip", (4, 1, 0), v=(1, 0, 0)), v_start=(0.1, 0.2, 0.3)
    ),
    "pose": lambda: planar(tm.PoseGoal("tip", pose())),
    "region": lambda: planar(
        tm.RegionGoal(
            "tip", (-0.5, -0.5, -1), (0.5, 0.5, 1), pose=pose(), angle_tolerance=0.4
        )
    ),
    "axis": lambda: planar(
        tm.AxisGoal("tip", (1, 0, 0), (0, 1, 0), position=(4, 1, 0))
    ),
    "one joint without a motor": lambda: planar(
        effort={"joint2": 0.0}, gravity=(0, 0, 0)
    ),
    "dry friction": lambda: planar(
        friction=(2.0, 1.0, 0.0), v_start=(0.1, -0.2, 0.3), motion_limits=STEADY
    ),
    "obstacles with kinks": lambda: planar(scene=MOVERS, v_start=(0.3, -0.2, 0.3)),
    "limits of accelerations and of torques over speed": lambda: planar(
        v_start=(0.4, -0.2, 0.3), motion_limits=STEADY
    ),
    "an acceleration at the start": lambda: planar(
        v_start=(0.4, -0.2, 0.3), a_start=(5.0, -3.0, 2.0), motion_limits=SMOOTH
    ),
    "limits of jerks and torque rates": lambda: planar(
        tm.PositionGoal("tip", (4, 1, 0)), scene=BALL, motion_limits=SMOOTH
    ),
    "ur5": lambda: tm.Problem(
        tm.load_robot("ur5", limits="urdf"),
        WRIST,
        tm.JointGoal(WRIST + np.array([0.3, 0.2, -0.3, -0.2, -0.3, 0.0])),
    ),
}


@cache
def problem_of(name: str) -> tm.Problem:
    """A problem of the table, whose robot is read once."""
    return PROBLEMS[name]()


GRIDS = {
    "": lambda: interval_shares("cosine", INTERVALS),
    ", two columns": lambda: np.kron(
        np.diag([0.3, 0.7]), interval_shares("uniform", INTERVALS // 2)
    ),
    ", free": lambda: np.eye(INTERVALS),
}


def lengths(shares: Array, T: float, rng: np.random.Generator) -> Array:
    """Lengths by the columns of the shares, for a motion of about T [s]."""
    eta = rng.uniform(0.8, 1.2, shares.shape[1])
    return eta * T / float(shares.sum(axis=0) @ eta)


def torques(
    system: ProblemFunctions, rng: np.random.Generator, intervals: int
) -> Array:
    limits = system.problem.robot.limits
    # Small torques: a wrist at full torque turns many times in an interval.
    share = rng.uniform(0.45, 0.55, (intervals, system.n))
    return limits.effort_lower + share * (limits.effort_upper - limits.effort_lower)


def middle(system: ProblemFunctions) -> Array:
    """A configuration near which the arm is clear of every obstacle."""
    return WRIST if system.n == 6 else MIDDLE


def near(system: ProblemFunctions, count: int, rng: np.random.Generator) -> Array:
    """Configurations from the start to a clear configuration, shape (count, n)."""
    start, end = system.problem.q_start, middle(system)
    way = np.linspace(0.0, 1.0, count)[:, None]
    return start + way * (end - start) + 0.1 * rng.normal(size=(count, system.n))


def on_spline(system, shares, rng):
    of = InverseTranscription(system, shares, 0.6)
    points = near(system, of.intervals, rng)
    end = points[-1] + 0.02 * rng.normal(size=system.n)
    points = np.vstack([system.problem.q_start, points, end])
    return of, of.unknowns(points, lengths(shares, 0.6, rng))


def lifted(system, shares, rng):
    of = CollocationTranscription(system, shares, 0.5)
    q = near(system, of.intervals + 1, rng)
    x = np.hstack([q, 0.4 * rng.normal(size=q.shape)])
    return of, of.pack(x, torques(system, rng, of.intervals), lengths(shares, 0.5, rng))


def shot(system, shares, rng):
    of = AdjointTranscription(system, shares, 0.5)
    return of, of.pack(torques(system, rng, of.intervals), lengths(shares, 0.4, rng))


def smooth(degree):
    def build(system, shares, rng):
        of = BSplineTranscription(system, shares, degree)
        points = near(system, of.intervals + degree, rng)
        return of, of.unknowns(points, np.array([0.6]))

    return build


MAKERS = {"inverse": on_spline, "collocation": lifted, "adjoint": shot}
BUILDERS = {
    f"{name}{grid}": (make, shares)
    for name, make in MAKERS.items()
    for grid, shares in GRIDS.items()
} | {name: (smooth(bspline.DEGREES[name]), GRIDS[""]) for name in LINEAR}


def has_rows(method: str, name: str) -> bool:
    """Jerks and torque rates need continuous accelerations."""
    continuous = "an acceleration at the start", "limits of jerks and torque rates"
    return method in LINEAR or name not in continuous


CASES = [
    (method, name) for method in BUILDERS for name in PROBLEMS if has_rows(method, name)
]


def with_more_instants(program: NonlinearProgram) -> NonlinearProgram:
    """The program with all path constraints at further instants, between the nodes."""
    last = program.transcription.intervals - 1
    more = Instants(np.array([0, 2, last]), np.array([0.3, 0.7, 0.2]))
    blocks = tuple(
        replace(block, fixed=block.fixed.joined(more))
        if isinstance(block, SampledRows) and block.name not in ("goal", "torque rate")
        else block
        for block in program.blocks
    )
    return replace(program, blocks=blocks)


@pytest.fixture
def everything(monkeypatch: pytest.MonkeyPatch) -> None:
    """All distances are exact, and all of them are rows, however large they are."""
    monkeypatch.setattr(bspline, "ATTENTION", 10.0)
    for kind in (BSplineTranscription, AdjointTranscription):
        monkeypatch.setattr(kind, "cutoff", 10.0)
        monkeypatch.setattr(kind, "moving_attention", 10.0)


def build(
    method: str, name: str, seed: int = 3
) -> tuple[NonlinearProgram, Array, Transcription]:
    """A program, a random iterate of it, and the transcription before centring."""
    make, shares = BUILDERS[method]
    system, rng = ProblemFunctions.of(problem_of(name)), np.random.default_rng(seed)
    of, z = make(system, shares(), rng)
    return with_more_instants(NonlinearProgram.of(of)).at(z), z, of


def differentiable(program: NonlinearProgram, values: Array) -> Array:
    """The rows that can be differentiated: all except distances of touching bodies."""
    return ~rows_of(program, "clearance") | (values < APART)


def rows_of(program: NonlinearProgram, name: str) -> Array:
    kinds = program.rows.kinds
    if name not in kinds:
        return np.zeros(program.rows.size, dtype=bool)
    return program.rows.kind == kinds.index(name)


# Rows that a case must have, so that it checks the constraints it is meant for.
REQUIRED_ROWS = {
    "position, obstacle": {"clearance", "goal"},
    "tip velocity": {"velocity", "goal"},
    "pose": {"goal"},
    "region": {"goal"},
    "axis": {"goal"},
    "obstacles with kinks": {"clearance"},
    "dry friction": {"torque over speed", "acceleration"},
    "limits of accelerations and of torques over speed": {
        "torque over speed",
        "acceleration",
    },
    "limits of jerks and torque rates": {"jerk", "torque rate", "clearance"},
}


@pytest.mark.usefixtures("everything")
@pytest.mark.parametrize(("method", "name"), CASES)
def test_jacobian_matches_differences(method: str, name: str) -> None:
    program, z, _ = build(method, name)
    values, steps = program.evaluate(z), program.step_bounds(z, 10.0)
    linearization = program.linearize(z, values, steps)
    kinds = program.rows.kinds
    assert REQUIRED_ROWS.get(name, set()) <= set(kinds)
    np.testing.assert_array_equal(linearization.rows, np.arange(program.rows.size))
    distances = rows_of(program, "clearance")
    smooth = differentiable(program, values)
    if np.any(distances):
        assert np.mean(smooth[distances]) > 0.5
    analytic = linearization.matrix.toarray()
    for i in np.flatnonzero(steps.upper > steps.lower):
        shift = np.zeros(program.size)
        shift[i] = STEP
        expected = program.evaluate(z + shift) - program.evaluate(z - shift)
        expected /= 2.0 * STEP
        error = np.abs(analytic[:, i] - expected)
        scale = max(1.0, float(np.abs(expected).max()))
        allowed = scale * np.where(distances, DISTANCES, DIFFERENCES)
        worst = int(np.argmax(np.where(smooth, error / allowed, 0.0)))
        assert error[worst] <= allowed[worst], (
            f"unknown {i}, row {worst} of {kinds[program.rows.kind[worst]]}: "
            f"{analytic[worst, i]} instead of {expected[worst]}"
        )


@pytest.mark.usefixtures("everything")
@pytest.mark.parametrize(("method", "name"), CASES)
def test_gradient_is_the_transposed_jacobian(method: str, name: str) -> None:
    program, z, _ = build(method, name)
    rng = np.random.default_rng(7)
    steps = program.step_bounds(z, 10.0)
    linearization = program.linearize(z, program.evaluate(z), steps)
    for share in (1.0, 0.3):
        weights = rng.normal(size=program.rows.size)
        weights[rng.uniform(size=weights.size) > share] = 0.0
        expected = linearization.matrix.T @ weights
        scale = max(1.0, float(np.abs(expected).max()))
        found = program.gradient(z, weights)
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=EXACT * scale)
    assert not program.gradient(z, np.zeros(weights.size)).any()


def evaluations(program: NonlinearProgram, z: Array) -> dict[str, Array]:
    """The results of all evaluations of a program at an iterate."""
    values, steps = program.evaluate(z), program.step_bounds(z, 0.3)
    variation = program.transcription.variation(z)
    motion = program.trajectory(z)
    linear = program.linearize(z, values, steps)
    jacobian = np.zeros((program.rows.size, program.size))
    jacobian[linear.rows] = linear.matrix.toarray()
    weights = np.cos(np.arange(program.rows.size))
    return {
        "values": values,
        "rows": linear.rows,
        "jacobian": jacobian,
        "gradient": program.gradient(z, weights),
        "steps": np.stack([steps.lower, steps.upper]),
        "variation": np.append(variation.offset, variation.total(z)),
        "stretched": program.time_scale(z, 1.3),
        "motion": np.hstack([motion.q, motion.v, motion.u]).ravel(),
    }


def identical(found: dict[str, Array], expected: dict[str, Array]) -> None:
    for key, value in expected.items():
        np.testing.assert_array_equal(found[key], value, err_msg=key)


@pytest.mark.parametrize(("method", "name"), CASES)
def test_program_results_do_not_depend_on_earlier_evaluations(
    method: str, name: str
) -> None:
    program, z, began = build(method, name)
    make, shares = BUILDERS[method]
    rng = np.random.default_rng(11)
    others = [make(program.system, shares(), rng)[1] for _ in range(2)]
    others += [z + 1e-3 * rng.normal(size=z.size), z + 1e-9]
    fresh = evaluations(program, z)
    used, _, _ = build(method, name)
    for other in others:
        evaluations(used, other)
        used.linearize(other, used.evaluate(other), used.step_bounds(other, 10.0))
    identical(evaluations(used, z), fresh)
    # Programs derived for other motions do not change this program either.
    blocks, transcription = used.blocks, used.transcription
    NonlinearProgram.of(began).at(others[0])
    used.at(others[0]).centred_at(others[1]).evaluate(z)
    assert used.blocks is blocks and used.transcription is transcription
    identical(evaluations(used, z), fresh)
    # The Jacobian may be evaluated first, at known values.
    again, _, _ = build(method, name)
    linear = again.linearize(z, fresh["values"], again.step_bounds(z, 0.3))
    expected = fresh["jacobian"][fresh["rows"]]
    np.testing.assert_array_equal(linear.rows, fresh["rows"])
    np.testing.assert_array_equal(linear.matrix.toarray(), expected)


@pytest.mark.parametrize("name", ["position, obstacle", "dry friction", "ur5"])
def test_integration_from_a_nearby_motion_differs_by_rounding(name: str) -> None:
    program, z, _ = build("adjoint", name)
    other = z + 1e-3 * np.random.default_rng(11).normal(size=z.size)
    found, expected = program.centred_at(other).evaluate(z), program.evaluate(z)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=NEWTON)


@pytest.mark.parametrize("name", ["position, obstacle", "tip velocity", "ur5"])
def test_adjoint_sweep_equals_forward_sensitivities(rng, name):
    problem = problem_of(name)
    system = ProblemFunctions.of(problem)
    n, intervals = system.n, 8
    x = np.concatenate([problem.q_start, rng.normal(size=n)])
    u = torques(system, rng, intervals)
    h = rng.uniform(0.02, 0.06, intervals)
    motion = rollout(system.dynamics, x, u, h)
    by = differentiate_rollout(motion)
    nodes = np.array([3, 8, 0, 5, 8, 1])
    seeds = rng.normal(size=(nodes.size, 2 * n))
    by_control, by_length = sweep_adjoint(by, nodes, seeds, np.arange(6))
    for j in range(intervals):
        # Forward sensitivities: states at all later nodes by unknowns of interval j.
        carried = np.column_stack([by.B[j], by.c[j]])
        for node in range(j + 1, intervals + 1):
            for row in np.flatnonzero(nodes == node):
                got = np.append(by_control[row, j], by_length[row, j])
                expected = seeds[row] @ carried
                scale = max(1.0, float(np.abs(expected).max()))
                np.testing.assert_allclose(got, expected, atol=EXACT * scale)
            if node < intervals:
                carried = by.A[node] @ carried
        # Later intervals do not change a node.
        early = nodes <= j
        assert not by_control[early, j].any() and not by_length[early, j].any()
