"""Motion files written by `plan`, and their check by `plan` and `verify`."""

from __future__ import annotations

import json
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from cli_samples import PLAN, Judge, Planner, Run

from tominpmp.files.export import load_motion
from tominpmp.files.ros import controller_refusals
from tominpmp.files.scenario import load_scenario

NAMES = ["joint1", "joint2", "joint3"]


@pytest.fixture
def free(run: Run, tmp_path: Path) -> None:
    """A scenario that is planned within a moment."""
    (tmp_path / "free.toml").write_text(
        '[robot]\nname = "planar3r"\n[start]\nq = [0.5, 1.7, -1.7]\n'
        '[goal]\ntype = "joint"\nq = [0.9, 1.2, -0.9]\n'
        '[options]\nintervals = 20\nmethod = "inverse"\ncontrol = "constant"\n'
        'effort = "quick"\nrefine = "none"\n'
    )


def test_plan_and_verify_agree_on_files_of_all_formats(run: Run, free: None) -> None:
    """The message of plan on its file names the same interpolation as verify."""
    for ending in ("csv", "npz", "yaml", "json", "mcap"):
        result = run("plan", "free.toml", "-o", f"m.{ending}", "--json")
        assert result.exit_code == 0, (result.stdout, result.stderr)
        data = json.loads(result.stdout)
        assert data["file_holds"] is True
        assert data["file_joined"] in data["file_message"]
        verified = run("verify", "free.toml", f"m.{ending}")
        assert verified.exit_code == 0, verified.stdout
        assert data["file_joined"] in verified.stdout


def test_plan_reports_and_keeps_a_file_with_coarse_samples(
    run: Run, free: None
) -> None:
    result = run("plan", "free.toml", "-o", "m.yaml", "--dt", "0.05")
    assert result.exit_code == 1
    assert Path("m.yaml").is_file()
    assert "as read" in result.stdout
    assert "does not pass, interpolated by cubics" in result.stdout
    error = " ".join(result.stderr.split())
    assert "beyond its effort limit at" in error
    assert "What passes: the nodes of the motion (without dt)" in error
    assert "the option control_period = 0.05." in error
    verified = run("verify", "free.toml", "m.yaml")
    assert verified.exit_code == 1
    assert "beyond its effort limit" in verified.stdout
    # The recommended file passes.
    assert run("plan", "free.toml", "-o", "m.yaml").exit_code == 0
    assert run("verify", "free.toml", "m.yaml").exit_code == 0
    quiet = run("plan", "free.toml", "-o", "m.yaml", "--dt", "0.05", "-q")
    assert quiet.exit_code == 1
    assert quiet.stdout == ""
    assert "m.yaml does not pass" in quiet.stderr


@pytest.mark.parametrize("period", ["0.004", "0.01"])
def test_plan_with_control_period_writes_points_on_the_clock(
    run: Run, free: None, period: str
) -> None:
    words = ("--control-period", period, "-o", "goal.yaml")
    result = run("plan", "free.toml", *words, "--ros-message", "FollowJointTrajectory")
    assert result.exit_code == 0, (result.stdout, result.stderr)
    goal = yaml.safe_load(Path("goal.yaml").read_text())
    assert list(goal) == ["trajectory"]
    assert controller_refusals(goal, NAMES) == ()
    points = goal["trajectory"]["points"]
    ticks = [
        point["time_from_start"]["sec"] * 10**9 + point["time_from_start"]["nanosec"]
        for point in points
    ]
    step = round(float(period) * 1e9)
    assert ticks == [k * step for k in range(len(ticks))]
    assert points[0]["positions"] == [0.5, 1.7, -1.7]
    assert points[-1]["velocities"] == [0.0, 0.0, 0.0]
    assert all(point["effort"] == [] for point in points)
    assert run("verify", "free.toml", "goal.yaml").exit_code == 0


def test_motion_on_standard_output_is_checked_too(run: Run, free: None) -> None:
    result = run("plan", "free.toml", "-o", "-", "--dt", "0.09")
    assert result.stdout.startswith("time,q_joint1")
    assert result.exit_code == 1
    assert "standard output does not pass" in " ".join(result.stderr.split())


def test_effort_is_written_on_request_only(run: Run, planner: Planner) -> None:
    assert run(*PLAN, "-o", "m.yaml").exit_code == 0
    assert np.isnan(load_motion("m.yaml").u).all()
    assert run(*PLAN, "-o", "m.yaml", "--with-effort").exit_code == 0
    assert np.isfinite(load_motion("m.yaml").u).all()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("-o m.csv --with-effort", "--with-effort is for ROS messages (.yaml"),
        ("-o m.npz --ros-message JointTrajectory", "message is for ROS messages"),
        ("-o m.yaml --ros-message JointState", "message is 'JointState', expected one"),
        ("-o - --with-effort", "not for standard output"),
        ("--no-output --ros-message JointTrajectory", "not for --no-output"),
        ("--with-effort", "--with-effort is for ROS messages"),
    ],
)
def test_invalid_export_options_are_reported_before_planning(
    words: str, message: str, run: Run, planner: Planner
) -> None:
    result = run(*PLAN, *words.split())
    assert result.exit_code == 2, (result.stdout, result.stderr)
    assert message in " ".join(result.stderr.split())
    assert planner.problem is None


def test_sensitivities_with_arrival_times_are_rejected_before_planning(
    run: Run, planner: Planner, free: None
) -> None:
    segment = "[[segments]]\narrival = [1.0, 2.0]\n[segments.goal]\n"
    text = Path("free.toml").read_text().replace("[goal]\n", segment)
    Path("timed.toml").write_text(text)
    result = run("plan", "timed.toml", "--sensitivities", "s.png")
    assert result.exit_code == 2
    assert "segment 1 has arrival times" in result.stderr
    assert planner.problem is None


@pytest.mark.parametrize("option", ["--certificate", "--sensitivities"])
def test_certificate_of_dwells_among_moving_obstacles_is_rejected_first(
    option: str, run: Run, planner: Planner, free: None
) -> None:
    """Regression: the motion was planned and written before the error."""
    segment = "[[segments]]\ndwell = 0.2\n[segments.goal]\n"
    text = Path("free.toml").read_text().replace("[goal]\n", segment)
    ball = 'type = "sphere"\nname = "a"\nradius = 0.1\nposition = [0, 9, 0]\n'
    motion = 'motion = {type = "constant_velocity", velocity = [0, 1, 0]}\n'
    text += f"[[scene.obstacles]]\n{ball}{motion}"
    Path("moving.toml").write_text(text)
    result = run("plan", "moving.toml", option, "c.png")
    assert result.exit_code == 2
    assert "dwells among moving obstacles" in result.stderr
    assert planner.problem is None


# The command verify


def change(path: str, **changes: Any) -> None:
    message = json.loads(Path(path).read_text())
    message["points"][-1] |= changes
    Path(path).write_text(json.dumps(message))


def test_verify_names_the_value_that_a_controller_refuses(run: Run, free: None) -> None:
    assert run("plan", "free.toml", "-o", "m.json").exit_code == 0
    change("m.json", velocities=[0.0, 1e-6, 0.0])
    result = run("verify", "free.toml", "m.json")
    assert result.exit_code == 1
    assert "solves the problem, but a controller would refuse it" in result.stdout
    assert "velocities, joint joint2: is 1e-06 at the end" in result.stdout
    data = json.loads(run("verify", "free.toml", "m.json", "--json").stdout)
    assert data["ok"] is False
    assert len(data["refusals"]) == 1


def test_verify_notes_that_a_file_has_efforts(run: Run, free: None) -> None:
    assert run("plan", "free.toml", "-o", "m.json", "--with-effort").exit_code == 0
    result = run("verify", "free.toml", "m.json")
    assert result.exit_code == 0
    assert "only controllers that command efforts" in result.stdout


def test_verify_uses_the_chosen_interpolation(run: Run, free: None) -> None:
    """One table is verified as a record, and as a controller would interpolate it."""
    assert run("plan", "free.toml", "-o", "m.csv").exit_code == 0
    record = run("verify", "free.toml", "m.csv")
    assert record.exit_code == 0
    assert "interpolation" in record.stdout
    assert "accelerations that jump, as recorded" in record.stdout
    cubic = run("verify", "free.toml", "m.csv", "--interpolation", "cubic")
    assert cubic.exit_code == 0
    assert "cubics through positions and velocities" in cubic.stdout
    # Accelerations that jump make polynomials of degree 5 overshoot.
    controller = run("verify", "free.toml", "m.csv", "--interpolation", "controller")
    assert controller.exit_code == 1
    assert "polynomials of degree 5" in controller.stdout
    linear = run("verify", "free.toml", "m.csv", "--interpolation", "linear")
    assert linear.exit_code == 1
    assert "velocities jump, by" in linear.stdout
    wrong = run("verify", "free.toml", "m.csv", "--interpolation", "quadratic")
    assert wrong.exit_code == 2
    assert "expected one of: auto, controller" in wrong.stderr


def test_verify_warns_of_ignored_tolerances_of_a_message(
    run: Run, judge: Judge, files: None
) -> None:
    message = yaml.safe_load(Path("motion.yaml").read_text())
    goal = {"trajectory": message, "path_tolerance": [{"name": "joint1"}]}
    Path("goal.json").write_text(json.dumps(goal))
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        result = run("verify", "scenario.toml", "goal.json")
    assert result.exit_code == 0, result.stderr
    assert "path_tolerance is ignored" in " ".join(result.stderr.split())


def test_plan_notes_that_a_controller_must_allow_a_moving_end(
    run: Run, free: None
) -> None:
    """If the controller allows a moving end, the final velocity is not refused."""
    text = Path("free.toml").read_text()
    text = text.replace("q = [0.9, 1.2, -0.9]", "q = [0.9, 1.2, -0.9]\nv = [0.2, 0, 0]")
    Path("moving.toml").write_text(text)
    assert load_scenario("moving.toml").problem.goal.v is not None  # type: ignore[attr-defined]
    result = run("plan", "moving.toml", "-o", "m.yaml")
    assert result.exit_code == 0, (result.stdout, result.stderr)
    assert "allow_nonzero_velocity_at_trajectory_end" in result.stdout
    message = yaml.safe_load(Path("m.yaml").read_text())
    (found,) = controller_refusals(message)
    assert found == replace(found, field="velocities", joint="joint1")
