"""Tests of files that are judged as their readers join them."""

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
# The torque limits of the arm are this far apart from what the motions here take.
ROOM = 1.02


def on_a_clock(robot: Robot, period: float, jump: float = 2.0) -> Trajectory:
    """Accelerations that jump at whole numbers of periods, from rest to rest in 0.96 s.

    Each joint speeds up, swings about and slows down again.
    """
    pattern = np.array([1.0, -0.4, 0.9, -1.0, 0.2, -0.7])
    knots = round(0.96 / period / 6)
    a = jump * np.outer(pattern, [1.0, -0.8, 0.5])
    h = knots * period
    t = h * np.arange(7)
    assert t[-1] == pytest.approx(0.96)
    v = np.vstack([np.zeros(3), np.cumsum(a * h, axis=0)])
    v[-1] = 0.0  # the pattern sums to nothing, up to rounding
    q = np.vstack(
        [np.zeros(3), np.cumsum(v[:-1] * h + a * h**2 / 2, axis=0)]
    ) + np.array(START)
    inverse = RobotDynamics(robot).inverse
    u = inverse(q, v, np.vstack([a, a[-1:]]))
    return Trajectory(robot.joint_names, t, q, v, u, a, inverse)


def solved(robot: Robot, motion: Trajectory, **options: object) -> Solution:
    """A solution whose torque limits are what the motion just needs."""
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
def test_nodes_hold_in_every_format(
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
def test_knots_on_the_clock_hold_when_sampled(
    planar3r: Robot, period: float, ending: str, tmp_path: Path
) -> None:
    """What a plan with control_period promises."""
    motion = on_a_clock(planar3r, period)
    solution = solved(planar3r, motion, control_period=period)
    path = solution.export(tmp_path / f"m.{ending}")
    samples = load_motion(path)
    # Without dt, the period of the plan is taken.
    assert samples.t.size == round(0.96 / period) + 1
    np.testing.assert_allclose(samples.t, period * np.arange(samples.t.size), atol=1e-9)
    assert check_export(solution, path).ok
    assert verify(solution.problem, samples).ok


def test_samples_that_cut_corners_are_told_of_with_what_would_hold(
    planar3r: Robot, tmp_path: Path
) -> None:
    """A motion whose torques jump, sampled more coarsely than it jumps."""
    solution = solved(planar3r, on_a_clock(planar3r, 0.002))
    path = tmp_path / "m.yaml"
    with pytest.warns(TominpmpWarning, match="does not pass, interpolated by cubics"):
        solution.export(path, dt=0.1)
    assert path.is_file()  # the file is kept
    found = check_export(solution, path, dt=0.1)
    assert not found  # false as any other verdict that fails
    effort = next(item for item in found.violations if item.kind == "effort")
    exact = verify(solution.problem, load_motion(path))
    assert not exact.ok
    assert effort.amount == pytest.approx(exact.worst["effort"].amount, rel=0.05)
    assert f"{effort.amount:.3g} N m beyond its effort limit" in found.message
    # 0.16 s between jumps: all of 10, 8, 4, 2 ms meet them.
    assert found.holding == (None, 0.01)
    assert "the nodes of the motion (without dt), dt = 0.01 s" in found.message
    assert "the option control_period = 0.1." in found.message
    for dt in found.holding:
        assert check_export(solution, solution.export(path, dt=dt), dt=dt)


def test_a_check_without_dt_advises_for_the_period_of_the_plan(
    planar3r: Robot, tmp_path: Path
) -> None:
    """An export without dt has rows at that period."""
    motion = on_a_clock(planar3r, 0.002)
    solution = solved(planar3r, motion, control_period=0.1)
    with pytest.warns(TominpmpWarning, match="does not pass"):
        path = solution.export(tmp_path / "m.yaml")
    found = check_export(solution, path)
    assert found.tried[0] is None  # the nodes of the motion
    assert found.message == check_export(solution, path, dt=0.1).message


def test_a_period_that_no_option_allows_is_not_recommended(
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


def test_advice_was_measured(planar3r: Robot, tmp_path: Path) -> None:
    """Periods that are named hold, and those that were tried before do not."""
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
    """A motion after a time that no clock knows."""
    assert motion.a is not None
    inverse = motion.inverse_dynamics
    assert inverse is not None
    t = np.concatenate([[0.0], motion.t + wait])
    q, v = (np.vstack([part[:1], part]) for part in (motion.q, motion.v))
    a = np.vstack([np.zeros(3), motion.a])
    u = inverse(q, v, np.vstack([a, a[-1:]]))
    return Trajectory(motion.joint_names, t, q, v, u, a, inverse)


def test_check_takes_no_longer_than_planning(planar3r: Robot, tmp_path: Path) -> None:
    solution = solved(planar3r, on_a_clock(planar3r, 0.002))
    hurried = replace(solution, planning_time=0.0)
    path = solution.export(tmp_path / "m.yaml", dt=0.1, verify=False)
    found = check_export(hurried, path, dt=0.1)
    assert not found.ok
    assert found.tried == ()
    assert "What passes" not in found.message


def test_held_torques_are_recognised_in_tables(planar3r: Robot, tmp_path: Path) -> None:
    """What makes such a motion is its torques: cubics through its nodes need others."""
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


def test_message_that_a_controller_refuses(planar3r: Robot, tmp_path: Path) -> None:
    solution = solved(planar3r, on_a_clock(planar3r, 0.004))
    path = solution.export(tmp_path / "m.json")
    message = json.loads(path.read_text())
    message["points"][-1]["velocities"][0] = 5e-6
    path.write_text(json.dumps(message))
    found = check_export(solution, path)
    assert not found.ok
    assert "a controller would refuse it: points[6].velocities, joint" in found.message


def test_efforts_that_were_asked_for_are_noted(planar3r: Robot, tmp_path: Path) -> None:
    solution = solved(planar3r, on_a_clock(planar3r, 0.004))
    path = solution.export(tmp_path / "m.yaml", with_effort=True)
    found = check_export(solution, path)
    assert found.ok
    assert found.refusals == ()
    assert "only controllers that command efforts" in found.notes[0]


def test_nothing_is_judged_where_nothing_was_solved(
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


def test_jerks_of_a_motion_with_the_planned_states_are_judged(
    planar3r: Robot, tmp_path: Path
) -> None:
    """The samples are exact, but the jerk between them is beyond its limit."""
    limits = MotionLimits(acceleration=8.0, jerk=300.0)
    goal = JointGoal([2.0, -1.0, 0.5])
    most = np.full(3, 9000.0)  # shares of these torques do not show the difference
    strong = replace(planar3r.limits, effort_lower=-most, effort_upper=most)
    robot = replace(planar3r, limits=strong)
    problem = Problem(robot, np.array(START), goal, motion_limits=limits)
    solution = plan(problem, intervals=20)
    path = solution.export(tmp_path / "m.csv", dt=0.002, verify=False)
    found = check_export(solution, path, dt=0.002)
    assert [item.kind for item in found.violations] == ["jerk"]
    assert not verify(problem, load_motion(path)).ok
