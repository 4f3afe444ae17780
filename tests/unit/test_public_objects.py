"""Public objects: truth value, one-line repr, copies, times outside of a motion."""

from __future__ import annotations

import copy
import math
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from motion_samples import simple_arm

import tominpmp as tm
from tominpmp.cli.report import report_data, report_text


@pytest.fixture(scope="module")
def solution() -> tm.Solution:
    scene = tm.Scene([tm.Sphere("O", radius=0.3, position=(9.0, 0.0, 0.0))])
    robot = tm.load_robot("planar3r")
    problem = tm.Problem(robot, [0.5, 1.7, -1.7], tm.JointGoal([2, -1, 0.5]), scene)
    return tm.plan(problem, tm.Options(intervals=20))


@pytest.fixture(scope="module")
def failed(solution: tm.Solution) -> tm.Solution:
    return replace(solution, feasible=False, status=tm.Status.INFEASIBLE)


def test_failed_solution_is_false_and_has_an_infinite_duration(
    solution: tm.Solution, failed: tm.Solution
) -> None:
    assert solution
    assert solution.T == solution.trajectory.duration < math.inf
    assert not failed
    assert failed.T == math.inf
    assert failed.gap is None
    assert failed.roughness == math.inf
    # The best attempt is available as the trajectory.
    assert failed.trajectory.duration == solution.T


def test_report_of_a_failed_solution_has_no_duration(failed: tm.Solution) -> None:
    data = report_data(failed, {})
    assert data["T"] is None
    assert data["best_attempt"] == failed.trajectory.duration
    assert "best attempt" in report_text(data)


def test_repr_of_each_object_is_one_short_line(solution: tm.Solution) -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(9.0, 10.0, size=(5000, 3))
    solution_parts = [
        solution, solution.problem, solution.trajectory, solution.options,
        solution.trajectory.sample(1e-3), solution.verification, solution.certificate,
        solution.problem.robot, solution.problem.scene, solution.trajectory(0.0),
        solution.trajectory([0.0] * 500), solution.problem.robot.limits,
        solution.problem.robot.description, solution.prove_clearance(),
        tm.JointGoal(np.zeros(3000)), tm.Options(initial_control=np.zeros((4000, 3))),
        tm.Scene([tm.Sphere(f"s{i}", radius=1.0) for i in range(3000)]),
        tm.OcTree("o", points=points, resolution=0.1),
        tm.HeightField("h", heights=np.zeros((50, 50)), size=(1, 1)),
        tm.Mesh("m", vertices=points, triangles=np.arange(4500).reshape(-1, 3)),
        tm.Waypoints(times=np.arange(5000.0), positions=points),
    ]  # fmt: skip
    for item in solution_parts:
        text = repr(item)
        assert type(item).__name__ in text
        assert "\n" not in text
        assert len(text) <= 320, text


def test_repr_of_a_single_thing_has_its_noun_in_the_singular(tmp_path: Path) -> None:
    robot = simple_arm(tmp_path, ["0 0 1"])
    assert "with 1 joint:" in repr(robot)
    segments = [tm.Segment(tm.JointGoal([0.5]))]
    problem = tm.Problem(robot, [0.0], segments=segments)
    assert "with 1 joint: " in repr(problem)
    assert repr(problem).endswith(", 1 segment>")
    row = np.zeros((1, 1))
    samples = tm.Samples(("j1",), [0.0], row, row, row, row)
    assert repr(samples) == "<Samples of 1 joint (j1): 1 row, 0 to 0 s>"


def test_repr_of_options_leaves_defaults_out() -> None:
    assert repr(tm.Options()) == "Options()"
    assert repr(tm.MotionLimits()) == "MotionLimits()"
    assert repr(tm.Options(seed=3)) == "Options(seed=3)"


@pytest.mark.parametrize("time", [99.0, -0.1, math.inf, -math.inf, [0.0, 99.0]])
def test_times_outside_of_a_motion_are_refused(
    solution: tm.Solution, time: float
) -> None:
    with pytest.raises(tm.ProblemError, match="outside of the motion") as error:
        solution.trajectory(time)
    assert error.value.field == "time"


def test_times_beyond_the_ends_by_rounding_are_accepted(solution: tm.Solution) -> None:
    motion = solution.trajectory
    T = motion.duration
    late, early = motion(T * (1 + 1e-12) + 1e-10), motion(-1e-10)
    for state, end in ((late, motion(T)), (early, motion(0.0))):
        for part, same in zip(state, end, strict=True):
            np.testing.assert_array_equal(part, same)


@pytest.mark.parametrize("method", ["inverse", "collocation", "adjoint"])
def test_held_ends_have_the_torque_against_gravity(
    solution: tm.Solution, method: str
) -> None:
    motion = tm.plan(solution.problem, method_options(method)).trajectory
    assert motion is not None
    inverse = solution.trajectory.inverse_dynamics
    times = [-1.0, 0.5 * motion.duration, motion.duration + 99.0, math.inf]
    held = motion(times, hold=True)
    for row, q in ((0, motion.q[0]), (2, motion.q[-1]), (3, motion.q[-1])):
        np.testing.assert_allclose(held.q[row], q, atol=1e-12)
        assert not held.v[row].any()
        assert not held.a[row].any()
        zero = np.zeros((1, 3))
        gravity = inverse(q[None], zero, zero)[0]
        assert np.abs(gravity).max() > 0.1
        np.testing.assert_allclose(held.u[row], gravity, atol=1e-9)
    inside = motion(times[1])
    np.testing.assert_array_equal(held.q[1], inside.q)
    np.testing.assert_array_equal(held.u[1], inside.u)


def method_options(method: str) -> tm.Options:
    # The ends do not depend on the quality of the motion.
    return tm.Options(method=method, intervals=12, max_iterations=3)


def test_held_end_of_a_motion_without_dynamics_has_nan_torques() -> None:
    q = np.array([[0.0], [1.0]])
    motion = tm.Trajectory(("j",), [0.0, 1.0], q, 0 * q, 0 * q + 5.0)
    held = motion(2.0, hold=True)
    assert held.q == [1.0]
    assert held.v == [0.0]
    assert np.isnan(held.u).all()


def test_copies_equal_their_original(solution: tm.Solution) -> None:
    assert solution.certificate is not None  # stored from now on
    calls: list[object] = []
    loud = replace(
        solution, options=replace(solution.options, callback=lambda _: calls.append(0))
    )
    for original in (solution, loud):
        for other in (
            pickle.loads(pickle.dumps(original)),
            copy.deepcopy(original),
            copy.copy(original),
        ):
            assert other
            assert other.T == solution.T
            assert other.problem == solution.problem
            assert other.trajectory == solution.trajectory
            assert other.options == solution.options
            np.testing.assert_array_equal(
                other.trajectory(0.3).u, solution.trajectory(0.3).u
            )
            assert other.certificate.ok == solution.certificate.ok
            assert not other.trajectory.q.flags.writeable
    for part in (solution.problem, solution.problem.robot, solution.trajectory):
        assert pickle.loads(pickle.dumps(part)) == part
        assert copy.deepcopy(part) == part


@pytest.mark.parametrize(
    "names", [5, None, "ab", ("a", 1), ("a", "a"), (), ("a", ""), {"a": 1}, b"ab"]
)
@pytest.mark.parametrize("kind", ["Trajectory", "Samples"])
def test_invalid_joint_names_are_refused(kind: str, names: object) -> None:
    x = np.zeros((2, 2))
    with pytest.raises(tm.ProblemError, match="joint_names is"):
        if kind == "Samples":
            tm.Samples(names, [0.0, 1.0], x, x, x, x)
        else:
            tm.Trajectory(names, [0.0, 1.0], x, x, x)


@pytest.mark.parametrize("field", ["t", "q", "v", "a", "u"])
@pytest.mark.parametrize("value", ["x", None, {}, [[1, 2], [3]], np.zeros(7), 5])
def test_invalid_samples_are_refused(field: str, value: object) -> None:
    x = np.zeros((2, 2))
    values = {"t": [0.0, 1.0]} | dict.fromkeys("qvau", x) | {field: value}
    with pytest.raises(tm.ProblemError) as error:
        tm.Samples(("a", "b"), **values)
    assert error.value.field in (field, "q")
