"""`check_export`: exported motion files, verified as their readers interpolate them."""

from __future__ import annotations

import json
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from motion_samples import START, quintic

from tominpmp.dynamics import RobotDynamics
from tominpmp.exceptions import ProblemError, TominpmpWarning
from tominpmp.files.export import export, load_motion
from tominpmp.files.export_check import check_export
from tominpmp.goals.joints import JointGoal
from tominpmp.motion.trajectory import Trajectory
from tominpmp.motion_limits import MotionLimits
from tominpmp.options import Options
from tominpmp.planner.planning import plan
from tominpmp.problem.problem import Problem
from tominpmp.robot.robot import Robot
from tominpmp.solution import Solution
from tominpmp.status import Status
from tominpmp.verification.verification import verify

ENDINGS = ("csv", "npz", "yaml", "json", "mcap")
# The torque limits of the arm are this factor times the torques of the motions.
ROOM = 1.02


def on_a_clock(robot: Robot, period: float, jump: float = 2.0) -> Trajectory:
    """A motion from rest to rest in 0.96 s whose accelerations jump at ticks.

    The period is that of a clock. Each joint accelerates, oscillates and brakes.
    """
    pattern = np.array([1.0, -0.4, 0.9, -1.0, 0.2, -0.7])
    knots = round(0.96 / period / 6)
    a = jump * np.outer(pattern, [1.0, -0.8, 0.5])
    h = knots * period
    t = h * np.arange(7)
    assert t[-1] == pytest.approx(0.96)
    v = np.vstack([np.zeros(3), np.cumsum(a * h, axis=0)])
    v[-1] = 0.0  # the pattern sums to zero, up to rounding
    q = np.vstack(
        [np.zeros(3), np.cumsum(v[:-1] * h + a * h**2 / 2, axis=0)]
    ) + np.array(START)
    inverse = RobotDynamics(robot).inverse
    u = inverse(q, v, np.vstack([a, a[-1:]]))
    return Trajectory(robot.joint_names, t, q, v, u, a, inverse)


def solved(robot: Robot, motion: Trajectory, **options: object) -> Solution:
    """A solution whose torque limits are slightly above the torques of the motion."""
    u = motion(np.linspace(0.0, motion.duration, 2000)).u
    most = ROOM * np.abs(u).max(axis=0)
    limits = replace(robot.limits, effort_lower=-most, effort_upper=most)
    problem = Problem(
        replace(robot, limits=limits), motion.q[0], JointGoal(motion.q[-1])
    )
    found = verify(problem, motion)
    assert found.ok, found.message
    return Solution(
        problem=problem,
        options=Options(**options),  # type: ignore[arg-type]
        status=Status.CONVERGED,
        message="made by hand",
        feasible=True,
        trajectory=motion,
        planning_time=1e6,
        verification=found,
    )


@pytest.mark.parametrize("ending", ENDINGS)
def test_exported_nodes_pass_in_every_format(
    planar3r: Robot, ending: str, tmp_path: Path
) -> None:
    solution = solved(planar3r, on_a_clock(planar3r, 0.004))
    path = solution.export(tmp_path / f"m.{ending}")  # a warning would be an error
    found = check_export(solution, path)
    assert found.ok, found.message
    assert found.message == f"{path} passes, interpolated by {found.joined}."
    assert verify(solution.problem, load_motion(path)).ok
    steps = ending in ("csv", "npz")
    begin = "accelerations that" if steps else "cubics through"
    assert found.joined.startswith(begin)


@pytest.mark.parametrize("ending", ENDINGS)
@pytest.mark.parametrize("period", [0.001, 0.004, 0.008, 0.01])
def test_export_at_the_control_period_passes_in_every_format(
    planar3r: Robot, period: float, ending: str, tmp_path: Path
) -> None:
    """A plan with `control_period` exports at this period by default."""
    motion = on_a_clock(planar3r, period)
    solution = solved(planar3r, motion, control_period=period)
    path = solution.export(tmp_path / f"m.{ending}")
    samples = load_motion(path)
    # Without dt, the period of the plan is taken.
    assert samples.t.size == round(0.96 / period) + 1
    np.testing.assert_allclose(samples.t, period * np.arange(samples.t.size), atol=1e-9)
    assert check_export(solution, path).ok
    assert verify(solution.problem, samples).ok


def test_coarse_samples_fail_and_the_message_names_passing_periods(
    planar3r: Robot, tmp_path: Path
) -> None:
    """The torques of the motion jump between its samples."""
    solution = solved(planar3r, on_a_clock(planar3r, 0.002))
    path = tmp_path / "m.yaml"
    with pytest.warns(TominpmpWarning, match="does not pass, interpolated by cubics"):
        solution.export(path, dt=0.1)
    assert path.is_file()  # the file is kept
    found = check_export(solution, path, dt=0.1)
    assert not found  # a failed check is false
    effort = next(item for item in found.violations if item.kind == "effort")
    exact = verify(solution.problem, load_motion(path))
    assert not exact.ok
    assert effort.amount == pytest.approx(exact.worst["effort"].amount, rel=0.05)
    assert f"{effort.amount:.3g} N m beyond its effort limit" in found.message
    # 0.16 s between jumps: samples at 10, 8, 4 and 2 ms meet all jumps.
    assert found.holding == (None, 0.01)
    assert "the nodes of the motion (without dt), dt = 0.01 s" in found.message
    assert "the option control_period = 0.1." in found.message
    for dt in found.holding:
        assert check_export(solution, solution.export(path, dt=dt), dt=dt)


def test_check_without_dt_uses_the_control_period_of_the_plan(
    planar3r: Robot, tmp_path: Path
) -> None:
    """An export without dt has rows at the control period."""
    motion = on_a_clock(planar3r, 0.002)
    solution = solved(planar3r, motion, control_period=0.1)
    with pytest.warns(TominpmpWarning, match="does not pass"):
        path = solution.export(tmp_path / "m.yaml")
    found = check_export(solution, path)
    assert found.tried[0] is None  # the nodes of the motion
    assert found.message == check_export(solution, path, dt=0.1).message


def test_message_recommends_no_invalid_control_period(
    planar3r: Robot, tmp_path: Path
) -> None:
    motion = on_a_clock(planar3r, 0.002)
    slow = replace(planar3r.limits, velocity=np.full(3, 0.01))
    robot = replace(planar3r, limits=slow)
    problem = Problem(robot, motion.q[0], JointGoal(motion.q[-1]))
    solution = replace(solved(planar3r, motion), problem=problem)
    with pytest.warns(TominpmpWarning, match="does not pass") as warned:
        solution.export(tmp_path / "m.yaml", dt=8)  # meant as milliseconds
    assert "control_period" not in str(warned[0].message)


def test_recommended_periods_have_been_tried(planar3r: Robot, tmp_path: Path) -> None:
    """Recommended periods pass, and the other tried periods do not."""
    solution = solved(planar3r, later(on_a_clock(planar3r, 0.004), 0.0013))
    path = solution.export(tmp_path / "m.yaml", dt=0.1, verify=False)
    found = check_export(solution, path, dt=0.1)
    assert not found.ok
    assert len(found.tried) > 1
    for dt in found.tried:
        export(solution.trajectory, path, dt=dt)  # type: ignore[arg-type]
        held = verify(solution.problem, load_motion(path)).ok
        assert held == (dt in found.holding), dt


def later(motion: Trajectory, wait: float) -> Trajectory:
    """The motion after a pause that is not a multiple of a period."""
    assert motion.a is not None
    inverse = motion.inverse_dynamics
    assert inverse is not None
    t = np.concatenate([[0.0], motion.t + wait])
    q, v = (np.vstack([part[:1], part]) for part in (motion.q, motion.v))
    a = np.vstack([np.zeros(3), motion.a])
    u = inverse(q, v, np.vstack([a, a[-1:]]))
    return Trajectory(motion.joint_names, t, q, v, u, a, inverse)


def test_check_tries_no_periods_without_planning_time(
    planar3r: Robot, tmp_path: Path
) -> None:
    solution = solved(planar3r, on_a_clock(planar3r, 0.002))
    hurried = replace(solution, planning_time=0.0)
    path = solution.export(tmp_path / "m.yaml", dt=0.1, verify=False)
    found = check_export(hurried, path, dt=0.1)
    assert not found.ok
    assert found.tried == ()
    assert "What passes" not in found.message


def test_held_torques_are_recognised_in_csv_and_npz(
    planar3r: Robot, tmp_path: Path
) -> None:
    """Cubics through the nodes of a motion with held torques need other torques."""
    motion = quintic(planar3r, START, (0.6, 1.5, -1.6), 2.0, 40)
    limits = replace(
        planar3r.limits,
        effort_lower=np.full(3, -500.0),
        effort_upper=np.full(3, 500.0),
    )
    robot = replace(planar3r, limits=limits)
    problem = Problem(robot, motion.q[0], JointGoal(motion.q[-1]))
    options = Options(goal_tolerance=0.5, speed_tolerance=0.5)
    found = verify(problem, motion, options.tolerances)
    assert found.ok, found.message
    solution = Solution(
        problem=problem,
        options=options,
        status=Status.CONVERGED,
        message="",
        feasible=True,
        trajectory=motion,
        verification=found,
    )
    for ending in ("csv", "npz"):
        path = solution.export(tmp_path / f"m.{ending}")
        held = check_export(solution, path)
        assert held.ok
        assert "torques held as recorded" in held.joined


def test_message_that_a_controller_refuses_fails_the_check(
    planar3r: Robot, tmp_path: Path
) -> None:
    solution = solved(planar3r, on_a_clock(planar3r, 0.004))
    path = solution.export(tmp_path / "m.json")
    message = json.loads(path.read_text())
    message["points"][-1]["velocities"][0] = 5e-6
    path.write_text(json.dumps(message))
    found = check_export(solution, path)
    assert not found.ok
    assert "a controller would refuse it: points[6].velocities, joint" in found.message


def test_exported_efforts_are_noted_in_the_check(
    planar3r: Robot, tmp_path: Path
) -> None:
    solution = solved(planar3r, on_a_clock(planar3r, 0.004))
    path = solution.export(tmp_path / "m.yaml", with_effort=True)
    found = check_export(solution, path)
    assert found.ok
    assert found.refusals == ()
    assert "only controllers that command efforts" in found.notes[0]


def test_export_of_a_failed_solution_is_not_checked(
    planar3r: Robot, tmp_path: Path
) -> None:
    solution = solved(planar3r, on_a_clock(planar3r, 0.002))
    failed = replace(solution, feasible=False)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        failed.export(tmp_path / "m.yaml", dt=0.1)
        solution.export(tmp_path / "m.yaml", dt=0.1, verify=False)
    with pytest.raises(ProblemError, match="there is no motion"):
        check_export(replace(solution, trajectory=None), tmp_path / "m.yaml")
    with pytest.raises(ProblemError, match="expected a Solution"):
        check_export("solution", tmp_path / "m.yaml")  # type: ignore[arg-type]
    with pytest.raises(ProblemError, match="expected the path of a file"):
        check_export(solution, 5)  # type: ignore[arg-type]


def test_jerk_between_exact_samples_is_checked(planar3r: Robot, tmp_path: Path) -> None:
    """The samples are exact, but the jerk between them is beyond its limit."""
    limits = MotionLimits(acceleration=8.0, jerk=300.0)
    goal = JointGoal([2.0, -1.0, 0.5])
    most = np.full(3, 9000.0)  # shares of these torques do not show the difference
    strong = replace(planar3r.limits, effort_lower=-most, effort_upper=most)
    robot = replace(planar3r, limits=strong)
    problem = Problem(robot, np.array(START), goal, motion_limits=limits)
    solution = plan(problem, intervals=24)
    path = solution.export(tmp_path / "m.csv", dt=0.002, verify=False)
    found = check_export(solution, path, dt=0.002)
    assert [item.kind for item in found.violations] == ["jerk"]
    assert not verify(problem, load_motion(path)).ok
