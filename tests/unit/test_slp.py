"""The loop of the sequential linear program on small programs without robots."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp
from stacked_rows import stacked

from tominpmp.linear_programs.choice import make_solver
from tominpmp.linear_programs.highs import HighsSolver
from tominpmp.options import Options
from tominpmp.solvers import trust_region_step
from tominpmp.solvers.iterate import Iterate
from tominpmp.solvers.loop import first_of, iterations, solve
from tominpmp.solvers.objective import MinimumTime, Model
from tominpmp.solvers.subproblem import LEAST_ROOM, build_subproblem
from tominpmp.solvers.trust_region_step import (
    LARGEST_RADIUS,
    next_radius,
    trust_regions,
)
from tominpmp.status import Status
from tominpmp.transcription.base import Linearization, StepBounds, Variation


class Program:
    """Minimise the last unknown, subject to the given rows and a box."""

    def __init__(self, parts, function, jacobian, low, high):
        self.rows = stacked(parts)
        self.function, self.jacobian = function, jacobian
        self.low, self.high = np.array(low, float), np.array(high, float)
        self.size = self.low.size
        self.cost = np.eye(self.size)[-1]

    def evaluate(self, z, attention=np.inf):
        return np.array(self.function(z))

    def linearize(self, z, values, steps):
        rows = np.arange(self.rows.size)
        return Linearization(rows, sp.csr_matrix(np.array(self.jacobian(z))), steps)

    def curvature(self, z, multipliers):
        return sp.csr_matrix((0, self.size))

    def step_bounds(self, z, radius):
        return StepBounds(
            np.maximum(self.low - z, -radius), np.minimum(self.high - z, radius)
        )

    def attention(self, steps):
        return np.inf

    def centred_at(self, z):
        return self

    def variation(self, z):
        raise AssertionError("smoothing is off")

    def time_scale(self, z, factor):
        out = z.copy()
        out[-1] *= factor
        return out

    def slower(self, z, factor, values):
        z = self.time_scale(z, factor)
        return z, self.evaluate(z)


def circle():
    """Least t with x^2 + y^2 <= t^2 / 2 and x y >= 1: t = 2 at x = y = 1."""
    return Program(
        [("torque", [-np.inf, 1.0], [0.0, np.inf], [0, 1])],
        lambda z: [z[0] ** 2 + z[1] ** 2 - z[2] ** 2 / 2, z[0] * z[1]],
        lambda z: [[2 * z[0], 2 * z[1], -z[2]], [z[1], z[0], 0.0]],
        [-5, -5, 0.1],
        [5, 5, 20],
    )


def least_time(program, start, lp="highs", options=None, **watched):
    """The outcome of steps within trust regions."""
    options = options or Options()
    method = trust_regions(options, trust_region_step.make_solver(lp))
    least = MinimumTime.of(options)
    return solve(program, least, np.array(start, float), *method, **watched)


def first_program(program, z, radius):
    """The first iterate of steps within trust regions, and its subproblem."""
    options = Options()
    step, _ = trust_regions(options, make_solver("highs"))
    state = Iterate.of(program, z, 0.0)
    weights = [step.first_weight(kind) for kind in state.rows.kinds]
    state = replace(state, weights=state.duration * np.array(weights))
    return state, subproblem_at(program, state, radius)


def subproblem_at(program, state, radius):
    """The subproblem of a step."""
    steps = program.step_bounds(state.z, radius)
    linearization = program.linearize(state.z, state.values, steps)
    cost, flat = program.cost, sp.csr_matrix((0, program.size))
    model = Model(lambda z, _: cost @ z, cost, flat)
    return build_subproblem(state, model, linearization)


@pytest.mark.parametrize("lp", ["highs", "piqp"])
@pytest.mark.parametrize("start", [(2.0, 0.8, 3.0), (0.1, 0.2, 0.5), (4, 4, 10)])
def test_slp_converges_on_curved_constraints_from_any_start(lp, start):
    result = least_time(circle(), start, lp, Options(tolerance=1e-7))
    assert result.status is Status.CONVERGED
    assert result.best.duration == pytest.approx(2.0, abs=2e-5)
    assert result.best.duration >= 2.0 - 1e-5
    assert result.best.violation <= 1e-6


@pytest.mark.parametrize("start", [0.7, 1.2, 0.0])
def test_more_equations_of_a_goal_than_unknowns_are_satisfied(start):
    """Regression: their linearisations contradict each other away from the goal.

    No step reduced them, as with a pose and an arm of five joints.
    """
    goal = np.array([np.cos(1.0), np.sin(1.0)])
    program = Program(
        [("goal", [0.0, 0.0], [0.0, 0.0], [0, 0]), ("torque", [-np.inf], [0.0], [1])],
        lambda z: [np.cos(z[0]) - goal[0], np.sin(z[0]) - goal[1], z[0] - z[1]],
        lambda z: [[-np.sin(z[0]), 0.0], [np.cos(z[0]), 0.0], [1.0, -1.0]],
        [-2, 0.01],
        [2, 5.0],
    )
    result = least_time(program, [start, 3.0])
    assert result.status is Status.CONVERGED
    assert result.best.duration == pytest.approx(1.0, abs=1e-5)


def test_equations_of_a_goal_may_be_of_very_different_size():
    """The slopes of a velocity are far larger than those of a position."""
    program = Program(
        [("goal", [0.0, 0.0], [0.0, 0.0], [0, 0]), ("torque", [-np.inf], [0.0], [1])],
        lambda z: [z[0] - 1.0, 1e5 * (z[1] - 2.0), z[0] + z[1] - z[2]],
        lambda z: [[1.0, 0.0, 0.0], [0.0, 1e5, 0.0], [1.0, 1.0, -1.0]],
        [-2, -2, 0.01],
        [3, 3, 9.0],
    )
    result = least_time(program, [0.5, 1.9, 5.0])
    assert result.status is Status.CONVERGED
    assert result.best.duration == pytest.approx(3.0, abs=1e-5)


def test_slp_satisfies_equality_constraints():
    """Least t with x = sin(t), x >= 0.5: t = pi / 6."""
    program = Program(
        [("goal", [0.0, 0.5], [0.0, np.inf], [0, 1])],
        lambda z: [z[0] - np.sin(z[1]), z[0]],
        lambda z: [[1.0, -np.cos(z[1])], [1.0, 0.0]],
        [-2, 0.01],
        [2, 1.5],
    )
    result = least_time(program, [-1.0, 1.0])
    assert result.status is Status.CONVERGED
    assert result.best.duration == pytest.approx(np.pi / 6, abs=1e-5)


def test_contradictory_rows_end_as_infeasible():
    program = Program(
        [("goal", [1.0, -np.inf], [np.inf, 0.0], [0, 1])],
        lambda z: [z[0], z[0]],
        lambda z: [[1.0, 0.0], [1.0, 0.0]],
        [-3, 0.1],
        [3, 5],
    )
    result = least_time(program, [0.2, 1.0])
    assert result.status is Status.INFEASIBLE
    assert result.best is None


def test_merit_never_rises_and_the_iteration_limit_ends_the_loop():
    records = []
    few = Options(max_iterations=3)
    start = [4.0, 4.0, 10.0]
    result = least_time(circle(), start, options=few, callback=records.append)
    assert result.status is Status.ITERATION_LIMIT
    assert len(result.history) == len(records) == 3
    assert all(record.actual >= 0 for record in records)
    assert result.best is not None  # the incumbent survives


def test_keyboard_interrupt_keeps_a_feasible_iterate(monkeypatch):
    program = circle()
    calls = []
    evaluate = program.evaluate

    def interrupted(z, *room):
        calls.append(1)
        if len(calls) == 6:
            raise KeyboardInterrupt
        return evaluate(z, *room)

    program.evaluate = interrupted
    iterates = []

    def keep(_, iterate):
        iterates.append(iterate)

    with pytest.raises(KeyboardInterrupt):
        least_time(program, [3.0, 3.0, 10.0], keep=keep)
    assert iterates[-1].violation <= 1e-6


def test_rows_that_a_step_cannot_violate_are_dropped():
    program = circle()
    z = np.array([2.0, 2.0, 10.0])
    for radius, count in ((1e-3, 0), (2.0, 1), (3.0, 2)):
        _, sub = first_program(program, z, radius)
        assert sub.rows.size == count


def test_zero_step_is_always_feasible_for_the_subproblem():
    """Elastic variables make every linear program feasible, however bad the start."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        program = circle()
        z = rng.uniform(program.low, program.high)
        _, sub = first_program(program, z, 0.1)
        assert make_solver("highs").solve(sub.program).optimal


def test_elastic_variables_have_room_for_interior_points():
    program = circle()
    z = np.zeros(program.size)
    state, _ = first_program(program, z, 0.1)
    rows = program.rows
    for violation, room in ((2e-9, LEAST_ROOM), (1e-3, 1e-3)):
        values = np.where(np.isfinite(rows.upper), rows.upper, rows.lower) + violation
        sub = subproblem_at(program, replace(state, values=values), 0.1)
        elastic = sub.program.upper[sub.free.size :]
        assert elastic.size > 0
        assert elastic == pytest.approx(np.full(elastic.size, room), rel=1e-6)


def test_trust_region_radius_follows_the_model_error():
    assert next_radius(1.0, 1.0, 1.0) > 2.0  # a perfect model
    assert next_radius(1.0, 0.5, 1.0) == pytest.approx(1.0)  # half is lost: unchanged
    assert next_radius(1.0, -3.0, 1.0) == pytest.approx(0.5)
    assert next_radius(1.0, -3.0, 0.4) == pytest.approx(0.4)
    assert next_radius(1.0, -3.0, 0.1) == pytest.approx(0.3)  # the smallest factor
    assert next_radius(LARGEST_RADIUS, 1.0, 1.0) == LARGEST_RADIUS


def test_unknowns_without_influence_on_the_duration_stay_in_place():
    """A linear program may leave these unknowns anywhere in the trust region."""
    program = Program(
        [("torque", [1.0], [np.inf], [0])],
        lambda z: [z[2] - 0.5 * z[1]],
        lambda z: [[0.0, -0.5, 1.0]],
        [-5, -5, 0.1],
        [5, 5, 20],
    )
    result = least_time(program, [0.3, 2.0, 3.0], "piqp", Options(tolerance=1e-7))
    assert result.status is Status.CONVERGED
    assert result.best.z[0] == pytest.approx(0.3, abs=1e-6)
    # The unknown that the duration depends on moves to its bound.
    assert result.best.duration == pytest.approx(0.1, abs=1e-6)


class Chained(Program):
    """Two unknowns without influence on the duration, between controls -1 and 2."""

    @property
    def transcription(self):
        return self

    def variation(self, z):
        matrix = np.array([[1.0, 0.0, 0.0], [-1.0, 1.0, 0.0], [0.0, -1.0, 0.0]])
        return Variation(sp.csr_matrix(matrix), np.array([1.0, 0.0, 2.0]))


def chained():
    """Least t with t >= 1, whatever the controls between are."""
    return Chained(
        [("torque", [1.0], [np.inf], [0])],
        lambda z: [z[2]],
        lambda z: [[0.0, 0.0, 1.0]],
        [-5, -5, 0.1],
        [5, 5, 20],
    )


def test_squared_variation_spaces_controls_evenly():
    program = chained()
    options = Options(tolerance=1e-8)
    least = MinimumTime.of(options, 0.1, squared=True)
    step, stop = trust_regions(options, make_solver("piqp"))
    found = solve(program, least, np.array([1.5, -0.5, 3.0]), step, stop)
    assert found.best is not None
    # Equal jumps have the least squares; all orders have the same total variation.
    assert found.best.z == pytest.approx([0.0, 1.0, 1.0], abs=1e-3)


def test_model_of_the_squared_variation_is_exact(monkeypatch):
    monkeypatch.setattr("tominpmp.solvers.objective.PROXIMAL", 0.0)
    program = chained()
    least = MinimumTime.of(Options(), 0.1, squared=True)
    z, step = np.array([1.5, -0.5, 3.0]), np.array([0.3, -0.2, 0.1])
    state = Iterate.of(program, z, 0.0)
    steps = program.step_bounds(z, 1.0)
    model = least.model(program, state, program.linearize(z, state.values, steps))
    curvature = model.curvature_term(step)
    change = model.value(z + step, state.values) - model.value(z, state.values)
    assert model.gradient @ step + curvature == pytest.approx(change, rel=1e-12)


def test_group_violation_is_that_of_its_worst_row_in_any_order():
    lower, values = np.zeros(4), np.array([-1.0, 2.0, -3.0, -0.5])
    for groups, worst in (([0, 0, 1, 1], [1.0, 3.0]), ([0, 1, 0, 1], [3.0, 0.5])):
        rows = stacked([("torque", lower, lower + 9.0, groups)])
        np.testing.assert_array_equal(rows.group_violation(values), worst)


def test_failed_linear_program_ends_as_numerical_failure(monkeypatch):
    class Failing(HighsSolver):
        def solve(self, program):
            return replace(super().solve(program), optimal=False)

    monkeypatch.setattr(trust_region_step, "make_solver", lambda name: Failing())
    result = least_time(circle(), [2.0, 0.8, 3.0])
    assert result.status is Status.NUMERICAL_FAILURE
    assert result.best is None


def test_first_stop_rule_that_fires_decides_the_status():
    seen = []

    def after(count, status):
        def rule(loop):
            seen.append(count)
            return status if len(loop.history) >= count else None

        return rule

    options, start = Options(tolerance=1e-9), np.array([4.0, 4.0, 10.0])
    step, _ = trust_regions(options, make_solver("highs"))
    rules = after(3, Status.STALLED), after(2, Status.FEASIBLE), iterations(2)
    found = solve(circle(), MinimumTime.of(options), start, step, first_of(*rules))
    assert found.status is Status.FEASIBLE
    assert len(found.history) == 2
    assert seen == [3, 2, 3, 2]
