"""Curvature of constraints: its values, the programs that use it, and its benefit."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
from stacked_rows import stacked

import tominpmp as tm
from tests.sample_arms import Link, make_arm
from tominpmp.constraints.base import States
from tominpmp.linear_programs.choice import make_solver
from tominpmp.linear_programs.program import LinearProgram
from tominpmp.solvers.trust_region_step import trust_regions
from tominpmp.transcription.bspline import InverseTranscription
from tominpmp.transcription.grid import interval_shares
from tominpmp.transcription.instants import Instants
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import NonlinearProgram

TENSOR = np.diag([2e-3, 3e-3, 4e-3])
SQUARE = [(-0.03, -0.02), (0.05, -0.02), (0.05, 0.04), (-0.03, 0.04)]
CENTER = (0.01, 0.0, 0.1)
# The values of these constraints are norms of vectors, linear in velocities here,
# linear in accelerations below.
IN_V = (tm.ToolSpeed("tool0", 0.3),)
IN_A = (
    tm.ToolAcceleration("tool0", 2.0),
    tm.StableContact("tool0", CENTER, 0.4, SQUARE, 0.7, TENSOR),
    tm.StableContact("tool0", CENTER, 0.4, 0.05, 0.7, None, 30.0),
    tm.FirmGrasp("tool0", 40.0, 0.6, 0.8, (0.0, 0.01, 0.05), inertia=TENSOR),
)
STEP = 1e-3


@pytest.fixture(scope="module")
def ur5():
    return tm.load_robot("ur5", limits="urdf")


@pytest.mark.parametrize("item", [*IN_V, *IN_A])
def test_curvature_equals_second_differences_of_the_values(item, ur5):
    ready, n = item.on(ur5), ur5.n
    rng = np.random.default_rng(2)
    q, v, a = (rng.uniform(-1.0, 1.0, (1, n)) for _ in range(3))
    in_v = item in IN_V

    def values(x):
        count = len(x)
        rest = np.repeat(v, count, axis=0), np.repeat(a, count, axis=0)
        moved = (x, rest[1]) if in_v else (rest[0], x)
        return ready.value_rows(np.repeat(q, count, axis=0), *moved)

    middle, unit = (v if in_v else a), STEP * np.eye(n)
    count = ready.count
    state = States(np.zeros(1), q, v, a)
    rows = np.arange(count)
    found = ready.bend(state, np.zeros(count, dtype=np.int64), rows)
    slopes = found.by_v if in_v else found.by_a
    for k in range(count):
        root = slopes[found.row == k]
        for i in range(n):
            for j in range(i + 1):
                corners = [
                    middle[0] + s * unit[i] + t * unit[j]
                    for s in (1, -1)
                    for t in (1, -1)
                ]
                one = values(np.array(corners))[:, k]
                bend = (one[0] - one[1] - one[2] + one[3]) / (4.0 * STEP**2)
                # The error of the differences grows with the curvature: slow tools.
                expected = pytest.approx(bend, rel=2e-5, abs=2e-5)
                assert root[:, i] @ root[:, j] == expected


def test_region_constraints_report_no_curvature(ur5):
    """The curvature of their rows may have any sign."""
    box = tm.WithinRegion("tool0", (-1, -1, 0), (1, 1, 1))
    away = tm.KeepAway("tool0", (0.2, 0.2, 0.5), 0.1)
    empty = np.zeros((1, 0))
    for item in (box, away):
        ready = item.on(ur5)
        assert not ready.bends
        assert ready.bend_rows(np.zeros((1, 6)), empty, empty) is None


def two_links(limit: float, during=None) -> tm.Problem:
    robot = make_arm(
        Link(mass=1.0, length=1.0, inertia=0.5),
        Link(mass=1.0, length=1.0, inertia=0.5),
        effort=np.array([60.0, 30.0]),
    )
    slow = tm.ToolSpeed("tip", limit, during=during)
    return tm.Problem(robot, [0.0, 0.4], tm.JointGoal([1.6, 1.4]), constraints=(slow,))


@pytest.mark.parametrize("during", [None, (0.1, np.inf)])
def test_program_curvature_is_the_weighted_curvature_of_its_rows(during):
    """The curvature is compared along a small step at constant duration."""
    system = ProblemFunctions.of(two_links(0.5, during))
    shares = interval_shares("uniform", 12)
    of = InverseTranscription(system, shares, 4.0)
    ends = system.problem.q_start, system.final_configuration
    T = np.array([4.0])
    z = of.start(lambda t: ends[0] + t[:, None] / 4.0 * (ends[1] - ends[0]), 4.0, T)
    program = NonlinearProgram.of(of)
    index = next(k for k, b in enumerate(program.blocks) if "speed of" in b.name)
    if during is not None:
        blocks = list(program.blocks)
        ready = blocks[index].constraint.with_times(np.array([0.4, 1.7, 3.0]))
        blocks[index] = type(blocks[index])(of, ready, Instants.of_pairs(()))
        program = NonlinearProgram(of, tuple(blocks))
    mine = program.rows.kind == index
    assert mine.sum() >= 3
    weights = np.where(mine, 0.3, 0.0)
    root = program.curvature(z, weights)
    assert root.shape[1] == program.size
    # The vectors are linearised; only the curvature of their norm counts.
    rng = np.random.default_rng(0)
    step = 1e-3 * rng.normal(size=program.size)
    step[-1] = 0.0
    along = [
        weights @ (program.evaluate(z + s * step) * mine) for s in (-1.0, 0.0, 1.0)
    ]
    bend = along[0] - 2.0 * along[1] + along[2]
    assert float(np.sum((root @ step) ** 2)) == pytest.approx(bend, rel=0.15)
    none = 0, program.size
    assert program.curvature(z, np.zeros(weights.size)).shape == none
    assert program.curvature(z, -weights).shape == none


def test_values_are_carried_from_former_rows_to_later_rows():
    def rows(**counts):
        return stacked(
            [(name, [0.0] * n, [1.0] * n, [0] * n) for name, n in counts.items()]
        )

    former, later = rows(a=2, b=3), rows(b=4, c=1, a=2)
    carried = later.carried(former, np.arange(1.0, 6.0))
    assert carried.tolist() == [3.0, 4.0, 5.0, 0.0, 0.0, 1.0, 2.0]


@pytest.mark.parametrize("name", ["piqp", "clarabel", "highs"])
def test_solvers_with_curvature_solve_the_quadratic_program(name):
    """The minimum of x^2/2 + y^2/2 - x - y with x + y <= 1 is at x = y = 1/2."""
    try:
        solver = make_solver(name)
    except tm.TominpmpError:
        pytest.skip(f"the optional solver {name} is not installed")
    program = LinearProgram(
        sp.csc_matrix(np.array([[1.0, 1.0]])),
        np.array([-1.0, -1.0]),
        np.zeros(2),
        np.full(2, 5.0),
        np.array([-np.inf]),
        np.array([1.0]),
        sp.csc_matrix(np.eye(2)),
    )
    found = solver.solve(program)
    assert found.optimal
    assert found.curved is solver.curved is (name != "highs")
    if found.curved:
        np.testing.assert_allclose(found.x, 0.5, atol=1e-5)
        np.testing.assert_allclose(found.row_duals, 0.5, atol=1e-4)


@pytest.mark.parametrize(
    ("kind", "weight"),
    [
        ("torque", 0.7),
        ("torque on segment 2", 0.7),
        ("velocity", 2.0),
        ("speed of frame tip", 2.0),
        ("speed of frame tip on segment 1", 2.0),
        ("torque over speed", 10.0),
        ("lack of grip of frame tip", 10.0),
        ("clearance", 10.0),
    ],
)
def test_initial_merit_weight_of_each_kind_of_violation(kind, weight):
    """The weight is the cost of slowing down; kinds of segments have the same weight.

    With a larger weight, steps along curved constraints are cut.
    """
    step, _ = trust_regions(tm.Options(), make_solver("piqp"))
    assert step.first_weight(kind) == weight


def test_plan_at_a_tool_speed_limit_converges_in_few_iterations():
    """Linear programs without curvature oscillate across the limit."""
    solution = tm.plan(two_links(0.5), effort="quick", refine=None)
    assert solution.status is tm.Status.CONVERGED
    assert len(solution.history) <= 18  # linear programs take 94
    # The tip moves straight, except while it speeds up and brakes.
    way = np.linalg.norm(_tip(1.6, 1.4) - _tip(0.0, 0.4))
    assert way / 0.5 < solution.T < 1.02 * way / 0.5


def _tip(one: float, two: float) -> np.ndarray:
    return np.array([np.cos(one) + np.cos(one + two), np.sin(one) + np.sin(one + two)])
