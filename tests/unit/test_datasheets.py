"""Data sheets: published limits reach the problem, and missing limits are reported.

Regression: motions of a stock Panda began with 1348 rad/s^2 at a wrist, without a
message.
"""

from __future__ import annotations

import copy
import pickle
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import tominpmp as tm
from tominpmp.cli.options import ProblemOptions, RobotOptions
from tominpmp.cli.problem import load_changed_robot, load_problem
from tominpmp.datasheets import (
    FOLDER,
    datasheets,
    find_datasheet,
    read_datasheet,
)
from tominpmp.description.fields import Field, parse_toml
from tominpmp.exceptions import OptionsError, ScenarioError
from tominpmp.files.scenario import read_robot, robot_table
from tominpmp.robot.robot import Robot, load_robot

READY = [0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785]


@pytest.fixture(scope="module")
def panda() -> Robot:
    return load_robot("panda", limits="datasheet", group="arm")


def test_data_sheets_can_be_copied_and_pickled() -> None:
    """Regression: read-only mappings of data sheets could not be copied or pickled."""
    sheet = datasheets()[0]
    for other in (copy.deepcopy(sheet), pickle.loads(pickle.dumps(sheet))):
        assert other == sheet
        with pytest.raises(TypeError):
            other.values["velocity"] = ()  # type: ignore[index]


@pytest.mark.parametrize(
    "path", sorted(FOLDER.glob("*.toml")), ids=lambda path: path.stem
)
def test_data_sheets_are_complete_and_cite_their_sources(path: Path) -> None:
    sheet = read_datasheet(path)
    table = parse_toml(path.read_bytes(), path)
    assert sheet.values
    for quantity, values in sheet.values.items():
        assert len(values) == len(sheet.joints)
        if not quantity.startswith("position"):
            assert min(values) > 0.0
        table.get(quantity).only("values", "source")
        source = table.need("sources").need(table.get(quantity).need("source").text())
        assert source.need("document").text()
        assert source.need("address").text().startswith("https://")
    assert sheet in datasheets()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('speedup = {values = [1.0], source = "a"}', "speedup: there is no"),
        ('jerk = {values = [1.0, 2.0], source = "a"}', "expected 1 numbers"),
        ('jerk = {source = "a"}', "jerk.values: is missing"),
    ],
)
def test_invalid_data_sheet_is_rejected(text: str, words: str, tmp_path: Path) -> None:
    path = tmp_path / "sheet.toml"
    path.write_text(
        f'title = "T"\nnames = ["t"]\njoints = ["j"]\n{text}\n'
        '[sources.a]\ndocument = "d"\naddress = "https://x"\n'
    )
    with pytest.raises(ScenarioError, match=words):
        read_datasheet(path)


def test_data_sheet_limits_reach_robot_and_problem(panda: Robot) -> None:
    problem = tm.Problem(panda, READY, tm.JointGoal([0.1, *READY[1:]]))
    limits = problem.motion_limits
    assert limits == panda.motion_limits
    names = panda.joint_names
    expected = [15, 7.5, 10, 12.5, 15, 20, 20]
    assert limits.by_joint("acceleration", names).tolist() == expected
    assert limits.by_joint("jerk", names)[1] == 3750.0
    assert limits.by_joint("effort_rate", names).tolist() == [1000.0] * 7
    own = tm.MotionLimits(acceleration=3.0)
    slow = replace(problem, motion_limits=own).motion_limits
    assert slow.by_joint("acceleration", names).tolist() == [3.0] * 7
    assert slow.by_joint("jerk", names)[1] == 3750.0


def test_speeds_and_torques_of_a_data_sheet_override_the_urdf() -> None:
    """The UR3 of example-robot-data has the torques of a UR10."""
    assert load_robot("ur3", limits="urdf").limits.effort_upper.tolist()[:2] == [
        330.0,
        330.0,
    ]
    robot = load_robot("ur3", limits="datasheet")
    assert robot.limits.effort_upper.tolist() == [56, 56, 28, 12, 12, 12]
    np.testing.assert_allclose(robot.limits.velocity[3:], 2 * np.pi, rtol=1e-6)
    own = load_robot("ur3", limits="datasheet", effort={"elbow_joint": 20.0})
    assert own.limits.effort_upper.tolist() == [56, 56, 20, 12, 12, 12]


def test_locked_joints_groups_and_workcells_keep_data_sheet_limits(
    panda: Robot,
) -> None:
    part = load_robot(
        "panda", limits="datasheet", group="arm", locked_joints={"panda_joint2": -0.5}
    )
    expected = [15, 10, 12.5, 15, 20, 20]
    limits = part.motion_limits
    assert limits.by_joint("acceleration", part.joint_names).tolist() == expected
    further = panda.with_locked({"panda_joint2": -0.5})
    assert further.motion_limits.by_joint("jerk", further.joint_names)[1] == 5000.0
    loaded = panda.with_payload(tm.Payload(1.0, "panda_hand"))
    assert loaded.motion_limits == panda.motion_limits
    arm = load_robot("ur5", limits="datasheet")
    cell = tm.Workcell({"a": (panda, (0, 0, 0)), "b": (arm, (2, 0, 0))})
    both = cell.robot.motion_limits
    rows = both.by_joint("acceleration", cell.robot.joint_names)
    assert sorted(rows.tolist()) == sorted([15, 7.5, 10, 12.5, 15, 20, 20, *[5.0] * 6])
    fingers = load_robot("panda", limits="datasheet")
    free = fingers.motion_limits.by_joint("acceleration", fingers.joint_names)
    assert np.isinf(free[-1])  # no limits of the hand are published


def test_data_sheet_is_found_by_robot_name_and_joint_prefix() -> None:
    joints = [f"left_panda_joint{i}" for i in range(1, 8)]
    joints += [f"right_panda_joint{i}" for i in range(1, 8)]
    sheet = find_datasheet(["dual_panda"], joints)
    assert sheet is not None and sheet.title == "Franka Emika Panda"
    assert set(sheet.by_joint(joints)["jerk"]) == set(joints)
    assert find_datasheet(["panda"], joints[:5]) is None
    assert find_datasheet(["pandas"], joints) is None
    six = [f"joint_{i}" for i in range(1, 7)]
    found = find_datasheet(["GEN3-7DOF-VISION"], [*six, "joint_7"])
    assert found is not None and len(found.joints) == 7
    found = find_datasheet(["gen3"], six)
    assert found is not None and len(found.joints) == 6
    urs = load_robot("ur5").joint_names
    names = ("ur5e_robot", "ur10e", "UR3e", "ur5_joint_limited_robot", "ur16e", "UR20")
    for name in names:
        found = find_datasheet([name], urs)
        assert found is not None and found.names[0] in name.lower()
    iiwa = [f"lbr_iiwa_joint_{i}" for i in range(1, 8)]
    found = find_datasheet(["lbr_iiwa_14_r820"], iiwa)
    assert found is not None and "acceleration" not in found.values
    for name, title in (
        ("m1013", "Doosan M1013"),
        ("abb_irb1200_7_70", "ABB IRB 1200"),
        ("abb_irb6640_185_280", "ABB IRB 6640-185/2.8"),
        ("fanuc_lrmate200id7l", "FANUC LR Mate 200iD/7L"),
    ):
        found = find_datasheet([name], six)
        assert found is not None and found.title == title
    assert find_datasheet(["irb6640_235_255"], six) is None  # another arm
    found = find_datasheet(["crx10ia_l"], [f"left_J{i}" for i in range(1, 7)])
    assert found is not None and found.title == "FANUC CRX-10iA"


@pytest.mark.parametrize("name", ["so100", "so101"])
def test_servo_arms_keep_their_acceleration_limits(name: str) -> None:
    """With its URDF file alone, a motion of the SO-101 begins with 94 807 rad/s^2."""
    robot = load_robot(name, locked_joints={"gripper": 0.0})
    low, high = robot.limits.position_lower, robot.limits.position_upper
    middle = (low + high) / 2
    turn = np.array([0.6, -0.3, 0.3, -0.3, 0.3])
    goal = tm.JointGoal(middle + turn)
    solution = tm.plan(tm.Problem(robot, middle, goal, self_collision=False))
    assert solution.verification.ok, solution.message
    assert 30.0 < solution.peak_acceleration.value < 39.1


def test_missing_data_sheet_or_invalid_limits_option_is_an_error() -> None:
    with pytest.raises(
        OptionsError, match=r"no data sheet for 'planar3r'.*known: .*Panda \(panda\)"
    ) as caught:
        load_robot("planar3r", limits="datasheet")
    assert caught.value.option == "limits"
    for wrong in ("data sheet", 3, True):
        with pytest.raises(OptionsError, match="expected 'datasheet', 'urdf' or"):
            load_robot("ur5", limits=wrong)


def test_named_robots_have_data_sheet_limits_by_default(
    tmp_path: Path, panda: Robot
) -> None:
    assert load_robot("panda", group="arm") == panda
    assert load_changed_robot("ur5", RobotOptions()) == load_robot("ur5")
    assert load_robot("ur5") == load_robot("ur5", limits="datasheet")
    plain = load_robot("ur5", limits="urdf")
    assert plain.motion_limits is None and plain != load_robot("ur5")
    # A robot of a file, or without a data sheet, has the limits of its URDF alone.
    assert load_robot(plain.urdf_path).motion_limits is None
    assert load_robot("planar3r") == load_robot("planar3r", limits="urdf")
    for robot in (plain, load_robot("ur5")):
        written = robot_table(robot, tmp_path / "s.toml")
        assert read_robot(Field(written, tmp_path / "s.toml", "robot")) == robot


def test_command_line_and_scenario_files_select_the_data_sheet(tmp_path: Path) -> None:
    changes = RobotOptions(limits="datasheet", velocity="2")
    robot = load_changed_robot("ur5", changes)
    expected = load_robot("ur5", limits="datasheet", velocity=2.0)
    assert robot == expected
    table = {"name": "ur5", "limits": "datasheet", "velocity": 2.0}
    found = read_robot(Field(table, tmp_path / "s.toml", "robot"))
    assert found == expected
    written = robot_table(found, tmp_path / "s.toml")
    assert read_robot(Field(written, tmp_path / "s.toml", "robot")) == expected
    assert written["motion_limits"]["acceleration"]["elbow_joint"] == 5.0
    with pytest.raises(ScenarioError, match=r"robot\.limits: .*no data sheet"):
        wrong = {"name": "planar3r", "limits": "datasheet"}
        read_robot(Field(wrong, tmp_path / "s.toml", "robot"))
    file = tmp_path / "limits.yaml"
    file.write_text("joint_limits: {elbow_joint: {max_acceleration: 2, max_jerk: 9}}")
    start = "0 -1.5 1.5 -1.5 -1.5 0"
    both = ProblemOptions(
        limits="datasheet",
        joint_limits=file,
        start=start,
        goal=start.replace("0 ", "0.5 "),
    )
    limits = load_problem("ur5", both)[0].motion_limits
    assert limits.by_joint("acceleration", robot.joint_names)[2] == 2.0
    assert limits.by_joint("acceleration", robot.joint_names)[1] == 5.0
    assert np.isfinite(limits.by_joint("jerk", robot.joint_names)).sum() == 1


def test_motion_without_acceleration_limits_reports_its_peak(panda: Robot) -> None:
    goal = tm.JointGoal([0.4, -0.5, 0.2, -2.0, 0.1, 1.8, 0.5])
    limited = tm.plan(panda_problem(panda, goal))
    assert limited.success and limited.verification.ok, limited.message
    assert limited.peak_acceleration.limited
    assert "acceleration" not in limited.message
    motion, names = limited.trajectory, panda.joint_names
    t = np.linspace(0.0, motion.duration, 2000)
    limit = panda.motion_limits.by_joint("acceleration", names)
    assert np.all(np.abs(motion(t).a) <= 1.005 * limit)
    free = tm.plan(panda_problem(load_robot("panda", limits="urdf", group="arm"), goal))
    peak = free.peak_acceleration
    assert not peak.limited and peak.unit == "rad/s^2" and peak.value > 50.0
    samples = np.abs(free.trajectory(np.linspace(0.0, free.T, 5000)).a)
    assert peak.value >= np.max(samples) * (1.0 - 1e-6)
    words = (
        f"No acceleration limits: the peak is {peak.value:.0f} rad/s^2 at {peak.joint}"
    )
    assert free.message.endswith(f"{words}; limits='datasheet' has them.")
    assert free.message.startswith(free.status.value)


@pytest.mark.parametrize(("name", "hinted"), [("ur5", True), ("planar3r", False)])
def test_error_of_a_kinematic_robot_suggests_its_data_sheet(
    name: str, hinted: bool
) -> None:
    robot = load_robot(load_robot(name).urdf_path, kinematic=True)
    q = 0.5 * (robot.limits.position_lower + robot.limits.position_upper)
    with pytest.raises(tm.ProblemError, match="no acceleration limit for") as caught:
        tm.Problem(robot, q, tm.JointGoal(q))
    assert str(caught.value).endswith("; limits='datasheet' has them") == hinted


def panda_problem(robot: Robot, goal: tm.JointGoal) -> tm.Problem:
    return tm.Problem(robot, READY, goal)


def test_message_suggests_no_data_sheet_if_it_does_not_exist(planar3r: Robot) -> None:
    problem = tm.Problem(planar3r, [0.5, 1.7, -1.7], tm.JointGoal([1.0, 1.0, -1.0]))
    message = tm.plan(problem, intervals=20).message
    assert "No acceleration limits: the peak is" in message
    assert "datasheet" not in message
    some = tm.MotionLimits(acceleration={"joint1": 500.0, "joint2": 500.0})
    message = tm.plan(replace(problem, motion_limits=some), intervals=20).message
    assert "No acceleration limit for joint3: the peak is" in message


def test_loading_with_a_data_sheet_gives_no_warning() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for name in ("panda", "ur3", "ur5", "ur10", "ur5_limited", "xarm7"):
            load_robot(name, limits="datasheet")


def test_robot_report_lists_data_sheet_limits(panda: Robot) -> None:
    from tominpmp.cli.report import robot_data

    data = robot_data(panda)
    assert [joint["acceleration"] for joint in data["joints"]][:2] == [15.0, 7.5]
    assert data["joints"][0]["effort_rate"] == 1000.0
    assert data["groups"]["hand"] == ["panda_finger_joint1"]
    assert (
        "acceleration" not in robot_data(load_robot("ur5", limits="urdf"))["joints"][0]
    )
