"""The rivals of the benchmarks are correct: a wrong rival would prove nothing.

The minimum time of a mass on a rail is known in closed form, also with friction.
"""

from __future__ import annotations

import sys
import warnings
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray
from scipy.optimize import brentq

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # of third parties, at their first import
    ca = pytest.importorskip("casadi")
    toppra = pytest.importorskip("toppra")

ROOT = str(Path(__file__).resolve().parents[1])
if ROOT not in sys.path:
    sys.path.insert(0, ROOT)

from benchmarks import random_goals  # noqa: E402
from benchmarks.rivals.arm import Arm, TorqueModel, limit_excess  # noqa: E402
from benchmarks.rivals.ipopt_inverse import InverseTranscription, rnea  # noqa: E402
from benchmarks.rivals.toppra_line import solve_line  # noqa: E402

pytestmark = pytest.mark.slow

Array = NDArray[np.float64]

DISTANCE, FORCE, MASS = 2.0, 6.0, 1.5


def make_arm(model: Any, effort: Array, velocity: Array, **changes: Any) -> Arm:
    n = model.nv
    free = {
        "position_lower": np.full(n, -np.inf),
        "position_upper": np.full(n, np.inf),
        "damping": np.zeros(n),
        "armature": np.zeros(n),
    }
    return Arm(
        model=model,
        velocity=velocity,
        effort_lower=-effort,
        effort_upper=effort,
        **{**free, **changes},
    )


def rail(**changes: Any) -> Arm:
    """Build a mass on a level rail."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "slide")
    sphere = pin.Inertia.FromSphere(MASS, 0.1)
    model.appendBodyToJoint(joint, sphere, pin.SE3.Identity())
    arm = make_arm(model, np.array([FORCE]), np.array([100.0]))
    return replace(arm, **changes)


def planar_arm() -> Arm:
    """Build three links in a vertical plane, with friction and rotor inertia."""
    model = pin.Model()
    model.gravity.linear = np.array([0.0, -9.81, 0.0])
    parent, offset = 0, 0.0
    for k, (length, mass) in enumerate([(0.5, 2.0), (0.4, 1.2), (0.2, 0.5)]):
        placement = pin.SE3(np.eye(3), np.array([offset, 0.0, 0.0]))
        parent = model.addJoint(parent, pin.JointModelRZ(), placement, f"joint{k}")
        inertia = np.diag([1e-3, 1.0, 1.0]) * mass * length**2 / 12
        body = pin.Inertia(mass, np.array([length / 2, 0.0, 0.0]), inertia)
        model.appendBodyToJoint(parent, body, pin.SE3.Identity())
        offset = length
    return make_arm(
        model,
        effort=np.array([40.0, 15.0, 4.0]),
        velocity=np.array([5.0, 6.0, 7.0]),
        position_lower=np.full(3, -2.5),
        position_upper=np.full(3, 2.5),
        damping=np.array([1.5, 0.8, 0.2]),
        armature=np.array([0.05, 0.02, 0.01]),
    )


def random_tree(rng: np.random.Generator) -> Arm:
    """Build a branching robot with every kind of one-coordinate joint."""
    kinds: list[Any] = [
        pin.JointModelRX(),
        pin.JointModelRY(),
        pin.JointModelRZ(),
        pin.JointModelPX(),
        pin.JointModelPY(),
        pin.JointModelPZ(),
    ]
    for unaligned in (
        pin.JointModelRevoluteUnaligned,
        pin.JointModelPrismaticUnaligned,
    ):
        axis = rng.normal(size=3)
        kinds.append(unaligned(axis / np.linalg.norm(axis)))
    model = pin.Model()
    model.gravity.linear = rng.normal(size=3)
    for k, kind in enumerate(kinds):
        parent = int(rng.integers(0, model.njoints))
        rotation = pin.Quaternion(pin.Quaternion(*_unit(rng, 4))).toRotationMatrix()
        placement = pin.SE3(rotation, rng.normal(size=3))
        joint = model.addJoint(parent, kind, placement, f"joint{k}")
        model.appendBodyToJoint(joint, pin.Inertia.Random(), pin.SE3.Identity())
    n = model.nv
    return make_arm(
        model,
        np.ones(n),
        np.ones(n),
        damping=rng.uniform(0, 2, n),
        armature=rng.uniform(0, 2, n),
    )


def _unit(rng: np.random.Generator, size: int) -> Array:
    vector = rng.normal(size=size)
    return np.asarray(vector / np.linalg.norm(vector))


@pytest.mark.parametrize("seed", range(5))
def test_symbolic_inverse_dynamics_equals_pinocchio(seed: int) -> None:
    rng = np.random.default_rng(seed)
    arm = random_tree(rng)
    symbols = [ca.SX.sym(name, arm.n) for name in "qva"]
    function = ca.Function("rnea", symbols, [rnea(arm, *symbols)])
    for _ in range(5):
        q, v, a = rng.normal(size=(3, arm.n))
        data = arm.model.createData()
        expected = pin.rnea(arm.model, data, q, v, a)
        expected = expected + arm.armature * a + arm.damping * v
        np.testing.assert_allclose(
            np.asarray(function(q, v, a)).ravel(), expected, rtol=1e-9, atol=1e-9
        )
        np.testing.assert_allclose(
            TorqueModel(arm)(q, v, a), expected, rtol=1e-12, atol=1e-12
        )


def test_torque_model_counts_rotor_inertia_once() -> None:
    arm = planar_arm()
    q, v, a = np.random.default_rng(0).normal(size=(3, 3))
    expected = TorqueModel(arm)(q, v, a)
    arm.model.armature = arm.armature
    np.testing.assert_allclose(TorqueModel(arm)(q, v, a), expected, rtol=1e-14)


def rail_time_with_friction(friction: float) -> float:
    """Minimum time by full force, then full braking, switched by the distance."""
    rate, top = friction / MASS, FORCE / friction

    def distance_and_time(push: float) -> tuple[float, float]:
        speed = top * (1.0 - np.exp(-rate * push))
        brake = np.log1p(speed / top) / rate
        there = top * push - speed / rate
        there += speed / rate - top * brake
        return float(there), float(push + brake)

    switch = brentq(lambda push: distance_and_time(push)[0] - DISTANCE, 1e-3, 100.0)
    return distance_and_time(float(switch))[1]


def test_closed_form_with_friction_tends_to_the_frictionless_one() -> None:
    bang_bang = 2.0 * np.sqrt(DISTANCE * MASS / FORCE)
    assert rail_time_with_friction(1e-4) == pytest.approx(bang_bang, rel=1e-4)
    assert rail_time_with_friction(3.0) > 1.02 * bang_bang


ENDS = (np.array([0.0]), np.array([DISTANCE]))


class TestMassOnARail:
    bang_bang = 2.0 * np.sqrt(DISTANCE * MASS / FORCE)

    def test_ipopt_reaches_the_minimum_time(self) -> None:
        # The switch is at the middle node, so the grid contains the optimum.
        result = InverseTranscription(rail(), 20).solve(*ENDS)
        assert result.success
        assert result.T == pytest.approx(self.bang_bang, rel=1e-5)

    def test_toppra_reaches_the_minimum_time(self) -> None:
        result = solve_line(rail(), *ENDS)
        assert result.success
        assert result.passes == 1
        assert self.bang_bang * (1 - 1e-7) < result.T < self.bang_bang * 1.0005

    def test_rivals_reach_the_minimum_time_with_a_speed_limit(self) -> None:
        speed = 1.0
        arm = rail(velocity=np.array([speed]))
        best = DISTANCE / speed + speed * MASS / FORCE
        line = solve_line(arm, *ENDS)
        assert best * (1 - 1e-6) < line.T < best * 1.001
        collocated = InverseTranscription(arm, 40).solve(*ENDS)
        assert best * (1 - 1e-6) < collocated.T < best * 1.01

    def test_dense_ends_reach_full_speed_sooner(self) -> None:
        """Equal intervals lose one interval to ramps; short ones at the ends do not."""
        arm = rail(velocity=np.array([0.1]))
        best = DISTANCE / 0.1 + 0.1 * MASS / FORCE
        equal = InverseTranscription(arm, 20).solve(*ENDS)
        assert equal.T == pytest.approx(DISTANCE / 0.1 * 20 / 19, rel=1e-4)
        shares = random_goals.interval_shares("cosine", 20)
        dense = InverseTranscription(arm, 20, fractions=shares).solve(*ENDS)
        assert best * (1 - 1e-6) < dense.T < 1.01 * best
        with pytest.raises(ValueError, match="add up to 1"):
            InverseTranscription(arm, 20, fractions=2 * shares)

    @pytest.mark.parametrize("friction", [0.3, 3.0, 20.0])
    def test_rivals_reach_the_minimum_time_with_friction(self, friction: float) -> None:
        arm = rail(damping=np.array([friction]))
        best = rail_time_with_friction(friction)
        line = solve_line(arm, *ENDS)
        assert best * (1 - 1e-6) < line.T < best * 1.005
        transcribed = InverseTranscription(arm, 100).solve(*ENDS)
        assert transcribed.success
        assert best * (1 - 1e-5) < transcribed.T < best * 1.02

    def test_rotor_inertia_acts_as_mass(self) -> None:
        arm = rail(armature=np.array([3.0 * MASS]))
        for T in (
            InverseTranscription(arm, 20).solve(*ENDS).T,
            solve_line(arm, *ENDS).T,
        ):
            assert pytest.approx(2.0 * self.bang_bang, rel=1e-3) == T

    def test_impossible_motion_is_no_success(self) -> None:
        arm = rail()
        arm.model.gravity.linear = np.array([-2.0 * FORCE / MASS, 0.0, 0.0])
        assert not solve_line(arm, *ENDS).success
        result = InverseTranscription(arm, 10, max_iterations=50).solve(*ENDS)
        assert not result.success
        assert np.isnan(result.T)


def test_line_that_cannot_be_timed_is_no_success() -> None:
    """The torques cannot hold the arm against gravity in the middle of the line."""
    arm = planar_arm()
    weak = replace(
        arm,
        effort_lower=arm.effort_lower * 0.2,
        effort_upper=arm.effort_upper * 0.2,
        velocity=arm.velocity * 0.01,
    )
    up, down = np.array([np.pi / 2, 0.0, 0.0]), np.array([-np.pi / 2, 0.0, 0.0])
    result = solve_line(weak, up, down)
    assert not result.success
    assert np.isnan(result.T)
    assert result.status


@pytest.fixture(scope="module")
def planar_results() -> list[tuple[Arm, Array, Array, Any, Any]]:
    arm = planar_arm()
    program = InverseTranscription(arm, 40)
    return [
        (arm, *ends, program.solve(*ends), solve_line(arm, *ends))
        for ends in random_goals.sample_problems(arm, 3, seed=1)
    ]


def test_limits_hold_between_grid_points(
    planar_results: list[tuple[Arm, Array, Array, Any, Any]],
) -> None:
    for arm, q_start, q_goal, ipopt, line in planar_results:
        for result, allowed in ((ipopt, 0.02), (line, 2e-3)):
            assert result.success
            excess = limit_excess(arm, result.motion, result.T, q_start, q_goal)
            assert excess.torque < allowed
            assert excess.velocity < 1e-6
            assert excess.start_error < 1e-6
            assert excess.goal_error < 1e-6


def test_interior_points_reduce_the_torque_excess() -> None:
    arm = planar_arm()
    (ends,) = random_goals.sample_problems(arm, 1, seed=1)
    excess = []
    for points in (0, 1):
        program = InverseTranscription(arm, 8, interior_points=points)
        result = program.solve(*ends)
        assert result.success
        excess.append(limit_excess(arm, result.motion, result.T, *ends).torque)
    assert excess[0] > 1e-3  # the grid is coarse enough to see the difference
    assert excess[1] < 0.5 * excess[0]


def test_straight_line_is_not_faster_than_the_free_path(
    planar_results: list[tuple[Arm, Array, Array, Any, Any]],
) -> None:
    for *_, ipopt, line in planar_results:
        assert line.T > 0.98 * ipopt.T  # up to the coarse grid of the free path


def test_limit_excess_detects_a_motion_that_is_too_fast(
    planar_results: list[tuple[Arm, Array, Array, Any, Any]],
) -> None:
    arm, q_start, q_goal, _, line = planar_results[0]

    def hurried(times: Array) -> tuple[Array, Array, Array]:
        q, v, a = line.motion(times * 1.25)
        return q, 1.25 * v, 1.25**2 * a

    excess = limit_excess(arm, hurried, line.T / 1.25, q_start, q_goal)
    assert max(excess.torque, excess.velocity) > 0.1
    short = limit_excess(arm, line.motion, line.T, q_start, q_goal + 0.01)
    assert short.goal_error == pytest.approx(0.01, rel=1e-6)


def test_torque_constraint_without_friction_equals_toppras() -> None:
    arm = replace(planar_arm(), damping=np.zeros(3))
    torque = TorqueModel(arm)
    for q_start, q_goal in random_goals.sample_problems(arm, 3, seed=2):
        ours = solve_line(arm, q_start, q_goal, gridpoints=100)
        # The same grid, to compare the constraint alone.
        step = q_goal - q_start
        grid = (ours.q[:, 0] - q_start[0]) / step[0]
        grid[[0, -1]] = 0.0, 1.0
        constraints = [
            toppra.constraint.JointVelocityConstraint(
                np.stack([-arm.velocity, arm.velocity], axis=1)
            ),
            toppra.constraint.JointTorqueConstraint(
                torque,
                np.stack([arm.effort_lower, arm.effort_upper], axis=1),
                np.zeros(3),
                toppra.constraint.DiscretizationType.Interpolation,
            ),
        ]
        path = toppra.SplineInterpolator([0.0, 1.0], np.stack([q_start, q_goal]))
        algorithm = toppra.algorithm.TOPPRA(
            constraints, path, gridpoints=grid, solver_wrapper="seidel"
        )
        _, sd, _ = algorithm.compute_parameterization(0.0, 0.0)
        T = np.sum(2.0 * np.diff(grid) / (sd[1:] + sd[:-1]))
        assert ours.T == pytest.approx(T, rel=1e-6)


def test_sampled_problems_are_reproducible_and_can_be_held() -> None:
    arm = replace(planar_arm(), position_upper=np.array([2.5, np.inf, 2.5]))
    few = random_goals.sample_problems(arm, 3, seed=4)
    many = random_goals.sample_problems(arm, 10, seed=4)
    np.testing.assert_array_equal(np.array(few), np.array(many[:3]))
    assert not np.array_equal(few, random_goals.sample_problems(arm, 3, seed=5))
    twin = planar_arm()
    twin.model.name = "twin"
    assert not np.array_equal(few, random_goals.sample_problems(twin, 3, seed=4))
    torque = TorqueModel(arm)
    for q in np.array(many).reshape(-1, 3):
        assert np.all(q >= np.array([-2.5, -np.pi, -2.5]))
        assert np.all(q <= np.array([2.5, np.pi, 2.5]))
        assert np.all(np.abs(torque.holding(q)) <= 0.9 * arm.effort_upper)


def test_speed_factor_changes_speed_limits_alone() -> None:
    slow = Arm.of(random_goals.load_arm("planar3r"))
    fast = Arm.of(random_goals.load_arm("planar3r", 4.0))
    np.testing.assert_allclose(fast.velocity, 4.0 * slow.velocity)
    np.testing.assert_array_equal(fast.effort_upper, slow.effort_upper)
    np.testing.assert_array_equal(
        random_goals.sample_problems(fast, 2, seed=0),
        random_goals.sample_problems(slow, 2, seed=0),
    )


@pytest.fixture
def small_benchmark(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> tuple[Path, list[str]]:
    """The benchmark with the planar arm of this file, and its command."""
    arm = planar_arm()
    robot = SimpleNamespace(
        model=arm.model, limits=arm, damping=arm.damping, armature=arm.armature
    )
    monkeypatch.setattr(random_goals, "load_arm", lambda *arguments: robot)
    path = tmp_path / "rows.csv"
    command = ["--only", "ipopt,toppra", "--robots", "three", "--intervals", "10"]
    return path, [*command, "--csv", str(path)]


def test_benchmark_resumes_after_the_stored_rows(
    small_benchmark: tuple[Path, list[str]],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path, command = small_benchmark
    random_goals.main([*command, "--goals", "1"])
    first = random_goals.read_rows(path)
    assert len(first) == 1
    runs: list[str] = []
    real = random_goals.Contest.run

    def counted(self: Any, method: str, *ends: Array) -> random_goals.Row:
        runs.append(method)
        return real(self, method, *ends)

    monkeypatch.setattr(random_goals.Contest, "run", counted)
    random_goals.main([*command, "--goals", "1"])
    assert runs == []
    capsys.readouterr()
    random_goals.main([*command, "--goals", "2"])
    # One problem more, after a round to warm up.
    assert runs == ["ipopt", "toppra"] * 2
    rows = random_goals.read_rows(path)
    assert len(rows) == 2
    for key, row in first.items():
        assert rows[key] == row
    assert "| three | 2 / 2 |" in capsys.readouterr().out
    runs.clear()
    random_goals.main([*command, "--goals", "2", "--rerun"])
    assert len(runs) == 6
    assert len(random_goals.read_rows(path)) == 2


def test_table_counts_failures_and_compares_solved_problems() -> None:
    def row(robot: str, **values: object) -> random_goals.Row:
        return {"robot": robot, **{k: str(v) for k, v in values.items()}}

    rows = [
        row(
            "a",
            ours_success=True,
            ours_T=1.01,
            ours_seconds=0.2,
            ipopt_success=True,
            ipopt_T=1.0,
            ipopt_seconds=0.4,
        ),
        row(
            "b",
            ours_success=True,
            ours_T=1.0,
            ours_seconds=0.1,
            ipopt_success=False,
            ipopt_T="nan",
            ipopt_seconds=9.0,
        ),
    ]
    table = random_goals.markdown_table(rows, ["ours", "ipopt"])
    *_, overall = table.splitlines()
    cells = [cell.strip() for cell in overall.strip("|").split("|")]
    assert cells[:4] == ["all", "2 / 2", "0.150", "0.200"]
    assert cells[6:9] == ["1 / 2", "4.700", "9.000"]
    assert cells[-2:] == ["1.00 %", "1.00 %"]
