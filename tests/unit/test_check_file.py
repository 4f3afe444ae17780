"""`check_file`: motion files of any planner, verified with their interpolation."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from motion_samples import END, START, quintic

from tominpmp.exceptions import ProblemError, ScenarioError
from tominpmp.files.export import export, load_motion
from tominpmp.files.export_check import check_file
from tominpmp.goals.joints import JointGoal
from tominpmp.options import Tolerances
from tominpmp.problem.problem import Problem
from tominpmp.robot.robot import Robot, load_robot
from tominpmp.verification.verification import verify


@pytest.fixture
def robot() -> Robot:
    return load_robot("planar3r", effort=500.0, velocity=50.0)


@pytest.mark.parametrize("ending", ["csv", "npz", "yaml", "json", "mcap"])
def test_motion_file_is_verified_without_a_solution(
    robot: Robot, ending: str, tmp_path: Path
) -> None:
    motion = quintic(robot, START, END, 2.0, 60)
    problem = Problem(robot, START, JointGoal(END))
    path = export(motion, tmp_path / f"m.{ending}", dt=0.01)
    found = check_file(problem, path)
    assert found.ok, found.message
    assert found.duration == pytest.approx(2.0)
    assert found.verification is not None and found.verification.ok
    assert found.tried == () and found.replan is None
    weak = Problem(load_robot("planar3r", effort=15.0), START, JointGoal(END))
    broken = check_file(weak, path)
    assert not broken.ok
    assert "beyond its effort limit" in broken.message
    assert broken.violations == verify(weak, load_motion(path)).violations


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(("row", "column"), [(-1, 0), (2, 1), (2, 5), (2, 7)])
def test_overflowing_numbers_in_a_motion_file_fail(
    robot: Robot, row: int, column: int, tmp_path: Path
) -> None:
    """Regression: NumPy warned of each operation that overflows."""
    problem = Problem(robot, START, JointGoal(END))
    path = export(quintic(robot, START, END, 2.0, 60), tmp_path / "m.csv")
    rows = [line.split(",") for line in path.read_text().splitlines()]
    rows[row][column] = "1e300"
    path.write_text("\n".join(map(",".join, rows)))
    assert not check_file(problem, path).ok


def test_check_file_uses_tolerances_and_interpolation(
    robot: Robot, tmp_path: Path
) -> None:
    motion = quintic(robot, START, END, 2.0, 60)
    far = [END[0] + 0.01, *END[1:]]
    problem = Problem(robot, START, JointGoal(far))
    path = export(motion, tmp_path / "m.csv", dt=0.02)
    assert not check_file(problem, path).ok
    assert check_file(problem, path, tolerances=Tolerances(goal=0.02)).ok
    straight = check_file(problem, path, interpolation="linear")
    assert straight.joined.startswith("straight lines")
    assert not straight.ok


def test_motion_file_that_a_controller_refuses_fails(
    robot: Robot, tmp_path: Path
) -> None:
    path = export(quintic(robot, START, END, 2.0, 60), tmp_path / "m.json", dt=0.02)
    message = json.loads(path.read_text())
    message["points"][-1]["velocities"][1] = 1e-5
    path.write_text(json.dumps(message))
    found = check_file(Problem(robot, START, JointGoal(END)), path)
    assert not found.violations and not found.ok
    assert len(found.refusals) == 1
    assert "a controller would refuse it" in found.message


def test_repeated_joint_name_in_a_message_is_an_error(
    robot: Robot, tmp_path: Path
) -> None:
    path = export(quintic(robot, START, END, 2.0, 60), tmp_path / "m.json", dt=0.02)
    message = json.loads(path.read_text())
    message["joint_names"][2] = message["joint_names"][0]
    path.write_text(json.dumps(message))
    with pytest.raises(ScenarioError, match="all of them different") as error:
        check_file(Problem(robot, START, JointGoal(END)), path)
    assert (error.value.path, error.value.key) == (path, "joint_names")


def test_check_file_names_the_invalid_argument(robot: Robot, tmp_path: Path) -> None:
    problem = Problem(robot, START, JointGoal(END))
    with pytest.raises(ProblemError, match="expected a Problem"):
        check_file(robot, "m.csv")  # type: ignore[arg-type]
    with pytest.raises(ProblemError, match="expected one of: auto"):
        check_file(problem, "m.csv", interpolation="cubical")  # type: ignore[arg-type]
    with pytest.raises(ProblemError, match="tolerances"):
        check_file(problem, "m.csv", tolerances=0.1)  # type: ignore[arg-type]
    with pytest.raises(ScenarioError, match="there is no file"):
        check_file(problem, tmp_path / "none.csv")
    with pytest.raises(ProblemError, match="expected the path of a file"):
        check_file(problem, 5)  # type: ignore[arg-type]
