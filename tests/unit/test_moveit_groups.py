"""Requests of MoveIt: the group is planned, other joints are locked at the start.

The start states name the joints of whole robots, as in MotionBenchMaker: grippers that
the URDF lacks, fingers beyond their limits, a head, another arm.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tominpmp.exceptions import ScenarioError, TominpmpWarning
from tominpmp.files.moveit import load_moveit, request_locks
from tominpmp.goals.joints import JointGoal
from tominpmp.problem.problem import Problem
from tominpmp.robot.robot import Robot, load_robot, read_source

UR5 = [
    f"{name}_joint"
    for name in (
        "shoulder_pan",
        "shoulder_lift",
        "elbow",
        "wrist_1",
        "wrist_2",
        "wrist_3",
    )
]
ROBOTIQ = ["robotiq_85_left_knuckle_joint", "robotiq_85_right_finger_tip_joint"]
ARMS = {
    side: [f"{side}_{name}" for name in ("s0", "s1", "e0", "e1", "w0", "w1", "w2")]
    for side in ("left", "right")
}
BAXTER = ["head_pan", *ARMS["left"], "l_gripper_l_finger_joint", *ARMS["right"]]
PANDA = [f"panda_joint{i}" for i in range(1, 8)]
READY = [0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785]


def files(
    folder: Path,
    group: str,
    start: dict[str, float],
    goal: dict[str, float] | str,
    **more: Any,
) -> tuple[Path, Path]:
    """Files of a scene with a distant ball, and of a request for joints or a link."""
    if isinstance(goal, str):
        region = {
            "primitives": [{"type": "sphere", "dimensions": [0.001]}],
            "primitive_poses": [{"position": [0.5, 0.5, 0.5]}],
        }
        wanted: Any = {
            "position_constraints": [{"link_name": goal, "constraint_region": region}]
        }
    else:
        wanted = {
            "joint_constraints": [
                {"joint_name": name, "position": value} for name, value in goal.items()
            ]
        }
    request = {
        "group_name": group,
        "start_state": {
            "joint_state": {"name": list(start), "position": list(start.values())}
        },
        "goal_constraints": [wanted],
        **more,
    }
    ball = {
        "id": "ball",
        "primitives": [{"type": "sphere", "dimensions": [0.1]}],
        "primitive_poses": [{"position": [5, 5, 5]}],
    }
    paths = folder / "scene.yaml", folder / "request.yaml"
    paths[0].write_text(json.dumps({"world": {"collision_objects": [ball]}}))
    paths[1].write_text(json.dumps(request))
    return paths


def test_joints_of_a_gripper_that_the_urdf_lacks_give_a_warning(tmp_path: Path) -> None:
    start = dict(zip(UR5, [0, -1.5, 1.5, -1.5, -1.5, 0], strict=True))
    goal = dict(zip(UR5, [1, -1.2, 1.2, -1.5, -1.5, 0], strict=True))
    grip = dict.fromkeys(ROBOTIQ, 0.0)
    paths = files(tmp_path, "manipulator", {**grip, **start}, goal)
    with pytest.warns(TominpmpWarning, match="no joints 'robotiq_85_left_knuckle") as w:
        problem = load_moveit("ur5", *paths)
    assert len(w) == 1
    assert problem.robot.n == 6
    np.testing.assert_array_equal(problem.q_start, list(start.values()))
    with pytest.warns(TominpmpWarning, match="robotiq_85_right_finger_tip_joint"):
        assert load_moveit(load_robot("ur5"), *paths) == problem


@pytest.mark.parametrize("sides", [("left",), ("left", "right")])
def test_baxter_group_is_planned_and_all_other_joints_are_locked(
    sides: tuple[str, ...], tmp_path: Path
) -> None:
    """The head, the fingers and an arm without a goal are locked at the start."""
    start = dict.fromkeys(BAXTER, 0.0)
    start |= {"left_s1": -1.0, "right_s1": -0.9, "head_pan": 0.1}
    start |= {"l_gripper_l_finger_joint": 0.05}
    moved = [joint for side in sides for joint in ARMS[side]]
    goal = {joint: start[joint] + 0.05 for joint in moved}
    group = "both_arms" if len(sides) == 2 else "left_arm"
    paths = files(tmp_path, group, {**start, "virtual_joint": 0.0}, goal)
    with pytest.warns(TominpmpWarning) as caught:
        problem = load_moveit("baxter", *paths)
    messages = " ".join(str(item.message) for item in caught)
    assert (
        "l_gripper_l_finger_joint is locked at 0.05 m, outside its limits" in messages
    )
    assert "no joints 'virtual_joint'" in messages
    assert "r_gripper_l_finger_joint" in messages  # the start has no value for it
    assert set(problem.robot.joint_names) == set(moved)
    assert problem.robot.locked_joints["head_pan"] == 0.1
    assert problem.robot.locked_joints["l_gripper_l_finger_joint"] == 0.05


@pytest.mark.parametrize("named", [True, False])
@pytest.mark.parametrize("goal", ["joints", "link"])
def test_panda_fingers_beyond_their_limits_are_locked_with_a_warning(
    named: bool, goal: str, tmp_path: Path
) -> None:
    start = dict(zip(PANDA, READY, strict=True))
    wanted = (
        {k: v + 0.1 for k, v in start.items()} if goal == "joints" else "panda_hand"
    )
    fingers = {"panda_finger_joint1": 0.065, "panda_finger_joint2": 0.065}
    paths = files(tmp_path, "panda_arm", {**start, **fingers}, wanted)
    robot: str | Robot = "panda" if named else load_robot("panda", limits="urdf")
    with pytest.warns(TominpmpWarning, match="locked at 0.065 m, outside its limits"):
        problem = load_moveit(robot, *paths)
    assert problem.robot.joint_names == tuple(PANDA)
    assert problem.robot.locked_joints == fingers
    assert problem.robot.limits.velocity.shape == (7,)


def test_joints_that_the_user_locked_remain_locked(tmp_path: Path) -> None:
    start = dict(zip(PANDA, READY, strict=True))
    goal = {k: v + 0.1 for k, v in start.items() if k != "panda_joint7"}
    fingers = {"panda_finger_joint1": 0.02, "panda_finger_joint2": 0.02}
    robot = load_robot("panda", limits="urdf", locked_joints={"panda_joint7": 0.785})
    paths = files(tmp_path, "arm", {**start, **fingers}, goal)
    problem = load_moveit(robot, *paths)
    assert problem.robot.joint_names == tuple(PANDA[:6])
    assert problem.goal == JointGoal([v + 0.1 for v in READY[:6]])


def test_locks_beside_a_request_also_set_mimic_joints(tmp_path: Path) -> None:
    start = dict(zip(PANDA, READY, strict=True))
    fingers = {"panda_finger_joint1": 0.02, "panda_finger_joint2": 0.02}
    paths = files(tmp_path, "panda_arm", {**start, **fingers}, start)
    locks = request_locks(read_source("panda"), paths[1])
    assert load_robot("panda", locked_joints=locks).locked_joints == fingers
    locks["panda_finger_joint1"] = 0.01  # as --lock sets it
    robot = load_robot("panda", locked_joints=locks)
    assert robot.locked_joints == dict.fromkeys(fingers, 0.01)


def test_unknown_group_with_a_link_goal_moves_the_chain_of_the_link(
    tmp_path: Path,
) -> None:
    """The joints that carry the link are planned."""
    start = dict.fromkeys(BAXTER, 0.0) | {"left_s1": -1.0, "right_s1": -1.0}
    start |= {"l_gripper_l_finger_joint": 0.01, "r_gripper_l_finger_joint": 0.01}
    paths = files(tmp_path, "arms", start, "left_wrist")
    with pytest.warns(TominpmpWarning, match=r"no group 'arms' \(it has: whole_body\)"):
        robot = load_moveit("baxter", *paths).robot
    assert set(robot.joint_names) <= set(ARMS["left"])
    assert robot.locked_joints["right_s1"] == -1.0


def test_start_without_a_joint_of_the_group_is_refused(tmp_path: Path) -> None:
    start = dict(zip(PANDA[:6], READY[:6], strict=True))
    paths = files(tmp_path, "arm", {**start, "x": 1.0}, dict.fromkeys(PANDA, 0.1))
    with (
        pytest.raises(
            ScenarioError, match=r"for the joints panda_joint7, and .* no joint 'x'"
        ),
        pytest.warns(TominpmpWarning, match="has no value for panda_finger_joint1"),
    ):
        load_moveit("panda", *paths)


def test_moving_locked_joints_warn_and_duplicate_joints_are_refused(
    tmp_path: Path,
) -> None:
    start = dict(zip(PANDA, READY, strict=True))
    goal = {k: v + 0.1 for k, v in start.items()}
    paths = files(tmp_path, "arm", start | {"panda_finger_joint1": 0.02}, goal)
    request = json.loads(paths[1].read_text())
    state = request["start_state"]["joint_state"]
    state["velocity"] = [0.0] * 7 + [0.1]
    paths[1].write_text(json.dumps(request))
    with pytest.warns(TominpmpWarning, match="panda_finger_joint1 move at the start"):
        assert isinstance(load_moveit("panda", *paths), Problem)
    state["name"][1] = "panda_joint1"
    paths[1].write_text(json.dumps(request))
    with pytest.raises(ScenarioError, match="'panda_joint1' occurs twice"):
        load_moveit("panda", *paths)


@pytest.mark.parametrize("wrong", [1, len(UR5)])
def test_unknown_joint_of_the_goal_is_named_in_the_error(
    tmp_path: Path, wrong: int
) -> None:
    """Regression: all joints were locked, or the message left the right joint out."""
    start = dict.fromkeys(UR5, 0.0)
    goal = dict(zip([*UR5[wrong:], *"abcdef"[:wrong]], [0.5] * len(UR5), strict=True))
    with pytest.raises(ScenarioError) as caught:
        load_moveit("ur5", *files(tmp_path, "manipulator", start, goal))
    assert "joint_name: there is no joint 'a'" in str(caught.value)
    assert all(name in str(caught.value) for name in UR5)
