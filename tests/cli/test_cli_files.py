"""Commands with files: scenarios, MoveIt files, joint limits, and motions to verify."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from cli_samples import (
    PANDA,
    PLAN,
    READY,
    Judge,
    Planner,
    Run,
    Verdict,
    Violation,
    needs_panda,
)

from tominpmp.files.export import load_motion
from tominpmp.files.scenario import load_scenario
from tominpmp.goals.joints import JointGoal
from tominpmp.motion.trajectory import Trajectory
from tominpmp.options import Options, Tolerances
from tominpmp.problem.problem import Problem
from tominpmp.verification.nearest import Touch

# Scenarios


def test_plan_takes_problem_and_options_from_a_scenario(
    run: Run, planner: Planner, files: None
) -> None:
    result = run("plan", "scenario.toml", "-o", "m.json", "--dt", "0.5")
    assert result.exit_code == 0, result.stderr
    expected = load_scenario("scenario.toml")
    assert planner.problem == expected.problem
    assert planner.options.intervals == 50
    assert load_motion("m.json").t.tolist() == [0.0, 0.5, 1.0, 1.5, 2.0]


def test_flags_override_options_of_the_scenario(
    run: Run, planner: Planner, files: None
) -> None:
    result = run("plan", "scenario.toml", "--margin", "0.02", "--seed", "7")
    assert result.exit_code == 0, result.stderr
    assert planner.problem.margin == 0.02
    assert (planner.options.intervals, planner.options.seed) == (50, 7)
    assert run("plan", "scenario.toml", "--intervals", "60").exit_code == 0
    assert planner.options.intervals == 60


def test_save_scenario_writes_problem_and_options_of_the_flags(
    run: Run, planner: Planner
) -> None:
    words = ("--obstacle", "sphere:o:r=0.1:at=0,5.5,0", "--velocity", "joint2=2.5")
    result = run(*PLAN, *words, "--method", "adjoint", "--save-scenario", "s.toml")
    assert result.exit_code == 0, result.stderr
    saved = load_scenario("s.toml")
    assert saved.problem == planner.problem
    assert saved.options == Options(method="adjoint")
    assert run("plan", "s.toml").exit_code == 0
    assert planner.problem == saved.problem


def test_scenario_is_saved_even_if_planning_fails(run: Run, planner: Planner) -> None:
    planner.feasible = False
    assert run(*PLAN, "--save-scenario", "s.toml").exit_code == 1
    assert Path("s.toml").is_file()


def test_play_shows_the_obstacles_of_a_scenario(
    run: Run, files: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown = []

    def play(problem: Problem, trajectory: Trajectory, path: Path) -> Path:
        shown.append((problem, trajectory))
        return path

    monkeypatch.setattr("tominpmp.viz.playback.play", play)
    result = run("play", "motion.yaml", "--robot", "scenario.toml", "-o", "a.html")
    assert result.exit_code == 0, result.stderr
    ((problem, trajectory),) = shown
    assert [item.name for item in problem.scene] == ["ball"]
    assert trajectory.duration == 2.0


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("plan scenario.toml --start 1,1,1", "--start contradicts a scenario file"),
        ("plan scenario.toml --lock joint3=1", "--lock contradicts a scenario file"),
        ("plan scenario.toml --obstacle sphere:a:r=1:at=9,9,9", "--obstacle contra"),
        ("plan scenario.toml --request request.yaml", "--request contradicts"),
        ("plan scenario.toml --degrees", "--degrees contradicts"),
        ("plan scenario.toml --intervals 1", "intervals is 1"),
        ("plan scenario.toml --margin 9", "scenario|less than the margin 9"),
        ("plan none.toml", "there is no file none.toml"),
        ("plan planar3r --goal 1,1,1", "there is no start: give --start"),
        ("plan planar3r --request request.yaml", "--request needs a --scene"),
        ("plan planar3r --scene scene.yaml --request request.yaml", "no joint"),
        (
            "plan planar3r --scene scene.yaml --request request.yaml --start 1,1,1",
            "--start contradicts --request",
        ),
        ("plan planar3r --scene motion.yaml --start 1,1,1", "there is no goal"),
        ("plan scenario.toml --save-scenario s.json", "must end in .toml"),
        ("plan scenario.toml -o m.xlsx", "must end in .csv"),
        ("plan planar3r --joint-limits motion.yaml --start start", "joint_limits"),
        ("verify planar3r motion.yaml", "'planar3r' is not a scenario file"),
        ("verify scenario.toml none.csv", "there is no file none.csv"),
        ("verify scenario.toml scene.yaml", "joint_names: is missing"),
        ("verify scenario.toml motion.txt", "motions are not kept as .txt"),
        ("verify scenario.toml", "MOTION"),
    ],
)
def test_invalid_or_contradictory_file_is_an_error(
    line: str, words: str, run: Run, planner: Planner, judge: Judge, files: None
) -> None:
    result = run(*line.split())
    assert result.exit_code == 2, (result.stdout, result.stderr)
    assert planner.problem is None
    assert judge.problem is None
    assert any(word in result.stderr for word in words.split("|")), result.stderr
    assert "Traceback" not in result.stderr


# Files of MoveIt


@needs_panda
def test_plan_takes_a_request_of_moveit(
    run: Run, planner: Planner, files: None
) -> None:
    words = ("plan", "panda", "--scene", "scene.yaml", "--request", "request.yaml")
    result = run(*words, "--margin", "0.01")
    assert result.exit_code == 0, result.stderr
    problem = planner.problem
    # The fingers, which the goal does not name, are locked.
    assert problem.robot.joint_names == tuple(PANDA)
    assert problem.robot.locked_joints["panda_finger_joint1"] == 0.04
    np.testing.assert_array_equal(problem.q_start, READY)
    assert isinstance(problem.goal, JointGoal)
    assert [item.name for item in problem.scene] == ["table"]
    assert problem.margin == 0.01
    other = run(*words, "--lock", "panda_finger_joint1=0.02")
    assert other.exit_code == 0
    assert planner.problem.robot.locked_joints["panda_finger_joint1"] == 0.02
    assert "panda_finger_joint2" in other.stderr  # the request has it elsewhere


@needs_panda
def test_obstacles_of_flags_and_of_a_scene_are_joined(
    run: Run, planner: Planner, files: None
) -> None:
    words = ("--scene", "scene.yaml", "--obstacle", "sphere:a:r=0.1:at=0,5.5,0")
    result = run(*PLAN, *words)
    assert result.exit_code == 2  # the arm lies in the plane of the table
    assert "obstacle 'table'" in result.stderr
    words = ("--lock", "panda_finger_joint1=0.04", *words)
    goal = ",".join(map(str, READY))
    result = run("plan", "panda", "--start", "default", "--goal", goal, *words)
    assert result.exit_code == 0, result.stderr
    assert [item.name for item in planner.problem.scene] == ["a", "table"]


def test_joint_limits_file_is_used_and_overridden_by_flags(
    run: Run, planner: Planner
) -> None:
    Path("limits.yaml").write_text(
        "joint_limits: {joint1: {max_velocity: 1.5}, joint2: {max_velocity: 1.25}}"
    )
    words = ("--joint-limits", "limits.yaml", "--velocity", "joint1=0.5")
    assert run(*PLAN, *words).exit_code == 0
    assert planner.problem.robot.limits.velocity[:2].tolist() == [0.5, 1.25]
    result = run("info", "planar3r", "--json", *words)
    assert [joint["velocity"] for joint in json.loads(result.stdout)["joints"]][:2] == [
        0.5,
        1.25,
    ]


# Verifying motions


def test_verify_reports_a_valid_motion(run: Run, judge: Judge, files: None) -> None:
    result = run("verify", "scenario.toml", "motion.yaml")
    assert result.exit_code == 0, result.stderr
    assert result.stdout.startswith("The motion in motion.yaml solves the problem.")
    assert "2.0000 s" in result.stdout
    assert judge.problem == load_scenario("scenario.toml").problem
    np.testing.assert_array_equal(judge.trajectory.q, load_motion("motion.yaml").q)
    assert run("verify", "scenario.toml", "motion.yaml", "--margin", "0").exit_code == 0
    assert judge.problem.margin == 0.0
    assert judge.tolerances == Tolerances()


def test_verify_reports_the_violations_of_a_motion(
    run: Run, judge: Judge, files: None
) -> None:
    torque, touch = Violation("torque", "joint2", 0.5, 3.0), Touch("a", "b", 0.25)
    judge.verdict = Verdict(False, 0.25, (torque,), touches=(touch,))
    result = run("verify", "scenario.toml", "motion.yaml")
    assert result.exit_code == 1
    assert "does not solve the problem" in result.stdout
    assert "torque of joint2 by 3.0 at 0.5 s" in result.stdout
    found = run("verify", "scenario.toml", "motion.yaml", "--json")
    assert found.exit_code == 1
    data = json.loads(found.stdout)
    assert data["ok"] is False
    assert data["T"] == 2.0
    assert data["min_clearance"] is None  # infinite
    assert "replay" not in data
    assert data["touches"] == [{"link": "a", "other": "b", "time": 0.25}]
    assert data["violations"] == [
        {"kind": "torque", "joint": "joint2", "time": 0.5, "amount": 3.0}
    ]


@needs_panda
def test_verify_takes_scene_and_request_of_moveit(
    run: Run, judge: Judge, files: None
) -> None:
    point = {"positions": READY, "time_from_start": {"sec": 0, "nanosec": 0}}
    end = {"positions": [q + 0.1 for q in READY], "time_from_start": {"sec": 2}}
    message = {"joint_names": PANDA, "points": [point, end]}
    Path("m.json").write_text(json.dumps(message))
    words = ("--scene", "scene.yaml", "--request", "request.yaml")
    result = run("verify", "panda", "m.json", *words)
    assert result.exit_code == 0, result.stderr
    assert judge.trajectory.joint_names == tuple(PANDA)


def test_warm_start_from_the_motion_of_another_robot_names_the_file(
    run: Run, tmp_path: Path
) -> None:
    path = tmp_path / "other.csv"
    path.write_text("time,q_turn\n0,1\n")
    words = ["planar3r", "--start", "start", "--goal", "1,1,1", "--start-from", path]
    result = run("plan", *map(str, words), "--no-output")
    assert result.exit_code == 2
    assert f"error: {path}: joint_names: are turn" in result.stderr
