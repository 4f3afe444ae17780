"""The command `plan`: flags of problem, robot and options, and the written files."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path

import numpy as np
import pytest
from cli_samples import (
    GOAL,
    PLAN,
    START,
    Planner,
    Run,
    needs_panda,
)

from tominpmp.files.export import load_motion
from tominpmp.goals.frames import PoseGoal, PositionGoal
from tominpmp.goals.joints import JointGoal
from tominpmp.options import Options
from tominpmp.planner.planning import plan
from tominpmp.problem.problem import Problem
from tominpmp.robot.robot import load_robot
from tominpmp.scene.obstacles import Box, Sphere
from tominpmp.solution import Solution
from tominpmp.status import Status


def test_start_and_goal_flags_reach_the_problem(run: Run, planner: Planner) -> None:
    run("plan", "planar3r", "--start", "0.5", "1.7", "-1.7", "--goal", "2 -1,  0.5")
    problem = planner.problem
    np.testing.assert_array_equal(problem.q_start, [0.5, 1.7, -1.7])
    assert isinstance(problem.goal, JointGoal)
    np.testing.assert_array_equal(problem.goal.q, [2.0, -1.0, 0.5])
    np.testing.assert_array_equal(problem.v_start, 0.0)
    assert problem.goal.v is None


def test_start_and_goal_velocity_flags_reach_the_problem(
    run: Run, planner: Planner
) -> None:
    result = run(
        *PLAN, "--start-velocity", "joint2=-0.5", "--goal-velocity", 0.1, -0.2, 0.3
    )
    assert result.exit_code == 0
    np.testing.assert_array_equal(planner.problem.v_start, [0.0, -0.5, 0.0])
    np.testing.assert_array_equal(planner.problem.goal.v, [0.1, -0.2, 0.3])


def test_start_acceleration_flag_reaches_the_problem(
    run: Run, planner: Planner
) -> None:
    assert run(*PLAN, "--start-acceleration", "joint3=0.2").exit_code == 0
    np.testing.assert_array_equal(planner.problem.a_start, [0.0, 0.0, 0.2])


def test_goal_position_flag_reaches_the_problem(run: Run, planner: Planner) -> None:
    args = ["plan", "planar3r", "--start", "start", "--goal-position", "tip", 4, -1, 0]
    assert run(*args, "--goal-velocity", 0, 1, 0).exit_code == 0
    goal = planner.problem.goal
    assert isinstance(goal, PositionGoal)
    assert goal.frame == "tip"
    np.testing.assert_array_equal(goal.position, [4.0, -1.0, 0.0])
    np.testing.assert_array_equal(goal.v, [0.0, 1.0, 0.0])
    np.testing.assert_array_equal(planner.problem.q_start, [0.5, 1.7, -1.7])


def test_goal_pose_flag_reaches_the_problem(run: Run, planner: Planner) -> None:
    pose = ["tip", 4, 1, 0, 0, 0, 3, 3]  # a quarter turn about z
    assert (
        run("plan", "planar3r", "--start", START, "--goal-pose", *pose).exit_code == 0
    )
    goal = planner.problem.goal
    assert isinstance(goal, PoseGoal)
    np.testing.assert_array_equal(goal.pose.translation, [4.0, 1.0, 0.0])
    turn = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    np.testing.assert_allclose(goal.pose.rotation, turn, atol=1e-15)


def test_obstacle_and_margin_flags_reach_the_problem(
    run: Run, planner: Planner
) -> None:
    result = run(
        *PLAN,
        "--obstacle=sphere:ball:r=0.1:at=9,0,0",
        "--obstacle",
        "box:table:size=1,2,3:at=0,-9,0:quat=0,0,1,1",
        "--margin",
        0.02,
    )
    assert result.exit_code == 0
    assert planner.problem.margin == 0.02
    ball, table = planner.problem.scene
    assert isinstance(ball, Sphere)
    assert (ball.name, ball.radius) == ("ball", 0.1)
    np.testing.assert_array_equal(ball.position, [9.0, 0.0, 0.0])
    assert isinstance(table, Box)
    np.testing.assert_array_equal(table.size, [1.0, 2.0, 3.0])
    np.testing.assert_allclose(table.rotation[:, 0], [0.0, 1.0, 0.0], atol=1e-15)


def test_robot_flags_reach_the_robot(run: Run, planner: Planner) -> None:
    result = run(
        *["plan", "planar3r", "--start", 0.5, 1.7, "--goal", "joint2=1"],
        *["--lock", "joint3=-0.3", "--gravity", 0, -1.5, 0, "--effort", "joint2=9"],
        *["--velocity", 4, "--damping", 1, 2, "--armature", "0.1,0.2"],
    )
    assert result.exit_code == 0, result.stderr
    robot = planner.problem.robot
    assert dict(robot.locked_joints) == {"joint3": -0.3}
    np.testing.assert_array_equal(robot.gravity, [0.0, -1.5, 0.0])
    np.testing.assert_array_equal(robot.limits.effort_upper, [20.0, 9.0])
    np.testing.assert_array_equal(robot.limits.velocity, [4.0, 4.0])
    np.testing.assert_array_equal(robot.damping, [1.0, 2.0])
    np.testing.assert_array_equal(robot.armature, [0.1, 0.2])
    np.testing.assert_array_equal(planner.problem.goal.q, [0.5, 1.0])


def test_package_dir_and_srdf_flags_reach_the_robot(
    run: Run, planner: Planner, tmp_path: Path
) -> None:
    source = load_robot("planar3r")
    (tmp_path / "arm.urdf").write_bytes(source.urdf_path.read_bytes())
    srdf = tmp_path / "other.srdf"
    srdf.write_text(
        '<robot name="planar3r"><group_state name="left wing" group="arm">'
        '<joint name="joint1" value="1"/><joint name="joint2" value="2"/>'
        '<joint name="joint3" value="0"/></group_state></robot>',
        encoding="utf-8",
    )
    options = ["--srdf", srdf, "--package-dir", tmp_path, "--goal", GOAL]
    result = run("plan", tmp_path / "arm.urdf", "--start", "left wing", *options)
    assert result.exit_code == 0, result.stderr
    np.testing.assert_array_equal(planner.problem.q_start, [1.0, 2.0, 0.0])
    assert planner.problem.robot.package_dirs == (tmp_path,)


def test_planning_flags_reach_the_planner(run: Run, planner: Planner) -> None:
    result = run(
        *PLAN,
        *["--method", "collocation", "--intervals", 20, "--smoothing", 0.001],
        *["--starts", 3, "--seed", 7, "--max-time", 250.0, "--max-iterations", 9],
        *["--lp-solver", "highs"],
    )
    assert result.exit_code == 0
    given = {
        "method": "collocation",
        "intervals": 20,
        "smoothing": 0.001,
        "starts": 3,
        "seed": 7,
        "max_planning_time": 250.0,
        "max_iterations": 9,
        "lp_solver": "highs",
    }
    for name in Options.names():
        if name != "callback":
            expected = given.get(name, getattr(Options(), name))
            assert getattr(planner.options, name) == expected, name


# Files


def test_default_file_name_is_not_taken(run: Run, planner: Planner) -> None:
    Path("motion.csv").write_text("mine", encoding="utf-8")
    assert "motion-2.csv" in run(*PLAN).stdout
    assert "motion-3.csv" in run(*PLAN).stdout
    assert Path("motion.csv").read_text(encoding="utf-8") == "mine"
    assert load_motion("motion-3.csv").t[-1] == 2.0


def test_default_file_name_is_chosen_when_the_motion_is_written(
    run: Run, planner: Planner, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Regression: only the last motion remained of commands that ran in one folder.

    The commands planned at the same time.
    """

    def plan_while_another_writes(*args: object) -> Solution:
        Path("motion.csv").write_text("other", encoding="utf-8")
        return planner(*args)

    monkeypatch.setattr("tominpmp.planner.planning.plan", plan_while_another_writes)
    assert "motion-2.csv" in run(*PLAN).stdout
    assert Path("motion.csv").read_text(encoding="utf-8") == "other"


def test_named_files_are_written_and_replaced(run: Run, planner: Planner) -> None:
    Path("a.npz").write_text("old", encoding="utf-8")
    result = run(*PLAN, "-o", "a.npz", "--dt", 0.3, "--html", "a.html")
    assert result.exit_code == 0, result.stderr
    np.testing.assert_allclose(load_motion("a.npz").t, [*np.arange(0, 2, 0.3), 2.0])
    assert "<html" in Path("a.html").read_text(encoding="utf-8").lower()
    assert sorted(os.listdir()) == ["a.html", "a.npz"]
    assert "a.html" in result.stdout


def test_output_dash_writes_the_motion_to_standard_output(
    run: Run, planner: Planner, tmp_path: Path
) -> None:
    result = run(*PLAN, "--output", "-")
    assert result.exit_code == 0
    assert os.listdir() == []
    (tmp_path / "read.csv").write_text(result.stdout, encoding="utf-8")
    assert load_motion(tmp_path / "read.csv").q.shape == (5, 3)
    assert Status.CONVERGED.value in result.stderr


def test_no_output_flag_writes_no_file(run: Run, planner: Planner) -> None:
    result = run(*PLAN, "--no-output")
    assert result.exit_code == 0
    assert os.listdir() == []
    assert run(*PLAN, "--no-output", "-o", "x.csv").exit_code == 2


def test_report_is_printed_although_a_file_fails(
    run: Run, planner: Planner, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(self: Solution, path: Path) -> None:
        raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr(Solution, "plot", fail)
    result = run(*PLAN, "--plot", "motion.png")
    assert result.exit_code == 2
    assert Status.CONVERGED.value in result.stdout
    assert result.stderr == "error: motion.png: No space left on device\n"
    assert Path("motion.csv").exists()


# With the true planner


def test_plan_command_agrees_with_the_library(run: Run) -> None:
    few = ("--intervals", 20, "--planning-effort", "quick")
    result = run(*PLAN, "--json", *few)
    assert result.exit_code == 0
    data = json.loads(result.stdout)
    problem = Problem(
        load_robot("planar3r"), [0.5, 1.7, -1.7], JointGoal(np.array([2.0, -1.0, 0.5]))
    )
    solution = plan(problem, Options(intervals=20, effort="quick"))
    assert data["T"] == pytest.approx(solution.T, rel=1e-9)
    assert data["status"] == solution.status.name
    assert max(data["violations"].values()) <= Options().feasibility
    motion = load_motion("motion.csv")
    np.testing.assert_allclose(motion.q[0], problem.q_start, atol=1e-9)
    np.testing.assert_allclose(motion.q[-1], [2.0, -1.0, 0.5], atol=1e-6)
    assert motion.t[-1] == data["T"]


@needs_panda
def test_plan_command_plans_a_panda_with_goals_in_degrees(run: Run) -> None:
    result = run(
        *["plan", "panda", "--lock", "panda_finger_joint1=0.04", "--start", "default"],
        *["--goal", "panda_joint1=90,panda_joint4=-60", "--degrees", "-o", "p.npz"],
        *["--intervals", 20, "--json"],
    )
    assert result.exit_code == 0, result.stderr
    data = json.loads(result.stdout)
    # Joint 1 turns a quarter at 2.175 rad/s at most.
    assert math.pi / 2 / 2.175 < data["T"] < 1.5 * math.pi / 2 / 2.175
    motion = load_motion("p.npz")
    np.testing.assert_allclose(motion.q[-1, [0, 3]], [math.pi / 2, -math.pi / 3])
    assert data["limited_share"] > 0.5


def test_report_says_that_the_planning_time_was_used_up(run: Run) -> None:
    result = run(*PLAN, "--max-time", 0.002)
    assert result.exit_code in (0, 1)  # the first guess may be feasible
    assert "planning time was used up" in result.stdout
    assert "0.002 s were allowed" in " ".join(result.stdout.split())


def test_control_refine_and_processes_flags_reach_the_planner(
    run: Run, planner: Planner
) -> None:
    chosen = ("--control", "linear", "--refine", "grid", "--processes", 2)
    assert run(*PLAN, *chosen).exit_code == 0
    assert planner.options.control == "linear"
    assert planner.options.refine == "grid"
    assert planner.options.processes == 2


def test_motion_limits_file_reaches_the_problem(run: Run, planner: Planner) -> None:
    Path("limits.yaml").write_text("jerk: 50\njoints:\n  joint2: {acceleration: 3}\n")
    assert run(*PLAN, "--motion-limits", "limits.yaml").exit_code == 0
    limits = planner.problem.motion_limits
    names = planner.problem.robot.joint_names
    np.testing.assert_array_equal(limits.by_joint("jerk", names), 50.0)
    np.testing.assert_array_equal(
        limits.by_joint("acceleration", names), [np.inf, 3.0, np.inf]
    )


def test_certificate_flag_reports_and_plots_the_certificate(run: Run) -> None:
    words = (*PLAN, "--planning-effort", "quick", "--no-output", "--json")
    result = run(*words, "--certificate", "proof.png")
    assert result.exit_code == 0
    data = json.loads(result.stdout)
    assert data["certified"] and "first-order conditions" in data["certificate"]
    assert data["files"] == {"certificate plot": "proof.png"}
    assert Path("proof.png").read_bytes().startswith(b"\x89PNG")
