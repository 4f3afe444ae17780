"""Derivatives of the transcriptions: adjoint, sensitivities, central differences."""

from __future__ import annotations

import numpy as np
import pytest

import tominpmp as tm
from tominpmp.transcription.adjoint import AdjointTranscription
from tominpmp.transcription.collocation import CollocationTranscription
from tominpmp.transcription.integrator import differentiate_rollout, rollout
from tominpmp.transcription.sweep import sweep_adjoint
from tominpmp.transcription.system import System

# Largest difference, as a share of the largest entry of a column or of 1.
DIFFERENCES = 1e-6
EXACT = 1e-10
STEP = 1e-6

START = (0.5, 1.7, -1.7)
OBSTACLE = tm.Scene([tm.Sphere("O", radius=0.8, position=(4, 0, 0))])


def planar(goal, velocity=5.0, **options):
    robot = tm.load_robot("planar3r", velocity=velocity)
    return tm.Problem(robot, START, goal, **options)


PROBLEMS = {
    "position goal, obstacle": planar(
        tm.PositionGoal("tip", (4, 1, 0)), scene=OBSTACLE, margin=0.05
    ),
    "moving start and goal": planar(
        tm.JointGoal((0.5, 1, 1), v=(0.1, 0.2, 0.3)), v_start=(0.1, -0.2, 0.3)
    ),
    "tip velocity": planar(tm.PositionGoal("tip", (4, 1, 0), v=(1, 0, 0))),
    "one joint without a motor": tm.Problem(
        tm.load_robot("planar3r", effort={"joint2": 0.0}, gravity=(0, 0, 0)),
        START,
        tm.JointGoal((0.5, 1, 1)),
    ),
    "ur5": tm.Problem(
        tm.load_robot("ur5"),
        (0.1, -1.2, 0.8, 0.3, 0.5, 0.2),
        tm.JointGoal((0.4, -1.0, 0.5, 0.1, 0.2, 0.0)),
    ),
}


def grid(free, intervals=6):
    """Lengths by one factor, or each of them free."""
    even = np.full((intervals, 1), 1.0 / intervals)
    return np.eye(intervals) if free else even


def torques(system, rng, intervals=6):
    limits = system.problem.robot.limits
    # Small ones: a wrist at full torque turns many times in an interval.
    share = rng.uniform(0.45, 0.55, (intervals, system.n))
    return limits.effort_lower + share * (limits.effort_upper - limits.effort_lower)


def adjoint(problem, rng, free=False):
    system = System.of(problem)
    shares = grid(free)
    nlp = AdjointTranscription(system, shares, 0.5)
    eta = rng.uniform(0.05, 0.1, 6) if free else np.array([0.5])
    return nlp, nlp.pack(torques(system, rng), eta)


def collocation(problem, rng, free=False):
    system = System.of(problem)
    shares = grid(free)
    nlp = CollocationTranscription(system, shares, 0.5)
    eta = rng.uniform(0.05, 0.1, 6) if free else np.array([0.5])
    n = system.n
    x = np.concatenate([problem.q_start, np.zeros(n)])
    x = x + 0.2 * rng.normal(size=(7, 2 * n))
    return nlp, nlp.pack(x, torques(system, rng), eta)


BUILDERS = {"adjoint": adjoint, "collocation": collocation}


@pytest.mark.parametrize("name", PROBLEMS)
@pytest.mark.parametrize("method", BUILDERS)
@pytest.mark.parametrize("free", [False, True])
def test_rows_against_differences(rng, name, method, free):
    nlp, z = BUILDERS[method](PROBLEMS[name], rng, free)
    steps = nlp.step_bounds(z, 10.0)
    linearization = nlp.linearize(z, nlp.evaluate(z), steps)
    analytic = linearization.matrix.toarray()
    assert set(nlp.rows.kind[linearization.rows]) == set(nlp.rows.kind)
    for i in np.flatnonzero(steps.upper > steps.lower):
        shift = np.zeros(nlp.size)
        shift[i] = STEP
        up, down = nlp.evaluate(z + shift), nlp.evaluate(z - shift)
        expected = (up - down)[linearization.rows] / (2 * STEP)
        scale = max(1.0, float(np.abs(expected).max()))
        np.testing.assert_allclose(
            analytic[:, i], expected, atol=DIFFERENCES * scale, err_msg=f"unknown {i}"
        )


@pytest.mark.parametrize("name", PROBLEMS)
def test_adjoint_sweep_equals_forward_sensitivities(rng, name):
    system = System.of(PROBLEMS[name])
    n, intervals = system.n, 8
    x = np.concatenate([PROBLEMS[name].q_start, rng.normal(size=n)])
    u = torques(system, rng, intervals)
    h = rng.uniform(0.02, 0.06, intervals)
    motion = rollout(system.dynamics, x, u, h)
    by = differentiate_rollout(system.dynamics, motion)
    nodes = np.array([3, 8, 0, 5, 8, 1])
    seeds = rng.normal(size=(nodes.size, 2 * n))
    by_control, by_length = sweep_adjoint(by, nodes, seeds)
    for j in range(intervals):
        # Forward: how the states at all later nodes follow from interval j.
        carried = np.column_stack([by.B[j], by.c[j]])
        for node in range(j + 1, intervals + 1):
            for row in np.flatnonzero(nodes == node):
                got = np.append(by_control[row, j], by_length[row, j])
                expected = seeds[row] @ carried
                scale = max(1.0, float(np.abs(expected).max()))
                np.testing.assert_allclose(got, expected, atol=EXACT * scale)
            if node < intervals:
                carried = by.A[node] @ carried
        # What happens after a node does not change it.
        early = nodes <= j
        assert not by_control[early, j].any() and not by_length[early, j].any()


@pytest.mark.parametrize("name", PROBLEMS)
def test_pull_back_is_the_transposed_jacobian(rng, name):
    nlp, z = adjoint(PROBLEMS[name], rng)
    linearization = nlp.linearize(z, nlp.evaluate(z), nlp.step_bounds(z, 10.0))
    weights = np.zeros(nlp.rows.size)
    weights[linearization.rows] = rng.normal(size=linearization.rows.size)
    expected = linearization.matrix.T @ weights[linearization.rows]
    scale = max(1.0, float(np.abs(expected).max()))
    np.testing.assert_allclose(nlp.pull_back(z, weights), expected, atol=EXACT * scale)
