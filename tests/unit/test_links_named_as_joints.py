"""A link and a joint of a URDF file may share a name, as in the hands of a Baxter.

Regression: where Pinocchio locks joints, it finds frames by name alone, and failed.
"""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import tominpmp as tm
from tominpmp.kinematics import RobotKinematics

QUICK = {"effort": "quick", "refine": None}
LINK = """<link name="{}"><inertial><origin xyz="0 0 .15"/><mass value="2"/>
<inertia ixx=".02" iyy=".02" izz=".004" ixy="0" ixz="0" iyz="0"/></inertial><collision>
<origin xyz="0 0 .15"/><geometry><cylinder radius=".04" length=".2"/></geometry>
</collision></link>"""
JOINT = """<joint name="{}" type="{}"><parent link="{}"/><child link="{}"/>
<origin xyz="0 .02 .3" rpy=".3 .2 -.5"/><axis xyz="{}"/>
<limit lower="-2" upper="2" effort="90" velocity="2"/></joint>"""


def twins(*, other: str = "hand") -> str:
    """An arm with joints that have the names of the links they carry, or of others.

    Joint a carries link a, joint b carries link c, and joint c carries link b. The
    fixed joint hand carries a link of the same name, or of the name `other`.
    """
    parts = [
        '<link name="base"/>',
        JOINT.format("a", "revolute", "base", "a", "0 0 1") + LINK.format("a"),
        JOINT.format("c", "revolute", "a", "b", "0 1 0") + LINK.format("b"),
        JOINT.format("b", "prismatic", "b", "c", "1 1 0") + LINK.format("c"),
        JOINT.format("hand", "fixed", "c", other, "0 0 1"),
        f'<link name="{other}"/>',
        JOINT.format("tip_joint", "fixed", other, "tip", "0 0 1"),
        '<link name="tip"/>',
    ]
    return f'<robot name="twins">{"".join(parts)}</robot>'


SRDF = """<robot name="twins">
<group name="arm"><joint name="a"/><joint name="c"/></group>
<group name="chain"><chain base_link="a" tip_link="c"/></group>
<group_state name="home" group="chain"><joint name="b" value="0.3"/></group_state>
<disable_collisions link1="a" link2="b"/><disable_collisions link1="b" link2="c"/>
<disable_collisions link1="a" link2="c"/></robot>"""
LOCKS = [{"a": 0.3}, {"b": 0.2}, {"c": -0.7}, {"a": 0.3, "c": 0.2}, {"b": 0.1, "c": 1}]


def placed(robot: tm.Robot, q: dict[str, float], frame: str) -> np.ndarray:
    row = np.array([q[name] for name in robot.joint_names])
    return np.asarray(RobotKinematics(robot).placement(row, frame).homogeneous)


@pytest.mark.parametrize("locks", LOCKS)
@pytest.mark.parametrize("other", ["hand", "b_hand"])
def test_locking_joints_keeps_the_placements_of_frames(
    locks: dict[str, float], other: str
) -> None:
    text = twins(other=other)
    whole, arm = tm.load_robot(text), tm.load_robot(text, locked_joints=locks)
    assert set(arm.joint_names) == set(whole.joint_names) - set(locks)
    q = {"a": 0.4, "b": 0.25, "c": -0.3} | locks
    for frame in whole.frame_names:
        there = placed(whole, q, frame)
        np.testing.assert_allclose(placed(arm, q, frame), there, atol=1e-12)
    assert whole.with_locked(locks) == arm == pickle.loads(pickle.dumps(arm))
    shapes = [str(item.name) for item in arm.collision_model.geometryObjects]
    assert shapes == ["a_0", "b_0", "c_0"]


@pytest.mark.parametrize("locks", LOCKS)
def test_locking_joints_keeps_the_torques_of_the_others(
    locks: dict[str, float],
) -> None:
    """Joints at rest load the other joints alike, whether they are locked or not."""
    whole = tm.load_robot(twins())
    arm = tm.load_robot(twins(), locked_joints=locks)
    q = {"a": 0.4, "b": 0.25, "c": -0.3} | locks
    v = {"a": 1.5, "b": -0.6, "c": 0.7} | dict.fromkeys(locks, 0.0)
    torques = []
    for robot in (whole, arm):
        rows = [np.array([x[name] for name in robot.joint_names]) for x in (q, v, v)]
        tau = pin.rnea(robot.model, robot.model.createData(), *rows)
        torques.append(dict(zip(robot.joint_names, tau.tolist(), strict=True)))
    for name in arm.joint_names:
        assert torques[1][name] == pytest.approx(torques[0][name], rel=1e-12)


def test_frame_names_are_unique() -> None:
    names = tm.load_robot(twins()).frame_names
    assert len(names) == len(set(names)) and {"a", "b", "c"} <= set(names)


def test_groups_and_states_of_an_srdf_file_refer_to_joints(tmp_path: Path) -> None:
    urdf = tmp_path / "twins.urdf"
    urdf.write_text(twins())
    urdf.with_suffix(".srdf").write_text(SRDF)
    arm = tm.load_robot(urdf, group="arm")
    assert arm.joint_names == ("a", "c") and arm.locked_joints == {"b": 0.3}
    assert tm.load_robot(urdf, group="chain").joint_names == ("c", "b")
    assert tm.load_robot(urdf, group="hand").joint_names == ("a", "c", "b")
    assert tm.load_robot(urdf, group=["b"]).locked_joints == {"a": 0.0, "c": 0.0}
    problem = tm.Problem(arm, (0, 0), tm.JointGoal((0.3, 0.2)))
    assert not problem.checker.pairs


@pytest.mark.parametrize("frame", ["a", "b", "c", "hand"])
def test_payload_is_mounted_on_the_link_of_a_shared_name(frame: str) -> None:
    arm = tm.load_robot(twins(), locked_joints={"c": 0.2})
    load = tm.Payload(1.5, frame, geometry=[tm.Sphere("ball", radius=0.05)])
    loaded = arm.with_payload(load)
    q = {"a": 0.4, "b": 0.25}
    np.testing.assert_allclose(
        placed(loaded, q, "payload"), placed(arm, q, frame), atol=1e-12
    )
    own, whole = (
        sum(inertia.mass for inertia in robot.model.inertias) for robot in (arm, loaded)
    )
    assert whole == pytest.approx(own + 1.5)


@pytest.mark.parametrize("frame", ["a", "b", "c", "hand"])
def test_position_goal_refers_to_the_link_of_a_shared_name(frame: str) -> None:
    arm = tm.load_robot(twins(), locked_joints={"c": 0.2})
    there = placed(arm, {"a": 0.4, "b": 0.25}, frame)[:3, 3]
    problem = tm.Problem(arm, (0, 0), tm.PositionGoal(frame, there))
    solution = tm.plan(problem, **QUICK)
    assert solution.success
    end = dict(zip(arm.joint_names, solution.trajectory.q[-1].tolist(), strict=True))
    np.testing.assert_allclose(placed(arm, end, frame)[:3, 3], there, atol=1e-6)


def test_workcell_of_two_arms_keeps_placements_and_is_planned() -> None:
    one = tm.load_robot(twins(), locked_joints={"a": 0.3})
    two = tm.load_robot(twins())
    cell = tm.Workcell({"one": (one, (0, 0, 0)), "two": (two, (5, 0, 0))})
    assert cell.robot.locked_joints == {"one/a": 0.3}
    q = dict.fromkeys(cell.robot.joint_names, 0.2)
    for name, robot, base in (("one", one, 0.0), ("two", two, 5.0)):
        alone = placed(robot, dict.fromkeys("abc", 0.2), "hand")
        alone[0, 3] += base
        there = placed(cell.robot, q, f"{name}/hand")
        np.testing.assert_allclose(there, alone, atol=1e-12)
    goals = {
        "one": tm.PositionGoal("hand", placed(one, {"b": 0.2, "c": 0.1}, "hand")[:3, 3])
    }
    goals |= {"two": tm.JointGoal((0.3, 0.3, 0.1))}
    starts = {"one": np.zeros(2), "two": np.zeros(3)}
    assert tm.plan(cell.problem(starts, goals), **QUICK).success


def test_added_links_and_joints_get_unused_names() -> None:
    """A payload adds a joint; another placement of the base adds a link and a joint."""
    text = twins().replace('"c" type', '"payload_joint" type')
    text = text.replace('"base"', '"ground"')
    arm = tm.load_robot(text)
    loaded = arm.with_payload(tm.Payload(1.0, "hand"))
    assert loaded.joint_names == arm.joint_names
    for place in (np.zeros(3), np.array([1.0, 2.0, 3.0])):
        moved = tm.robot_at(tm.robot_at(loaded, (9, 9, 9)), place)
        assert len(moved.frame_names) == len(loaded.frame_names) + 2
        q = dict.fromkeys(moved.joint_names, 0.2)
        for frame in ("ground", "hand", "payload"):
            there = placed(loaded, q, frame)
            there[:3, 3] += place
            np.testing.assert_allclose(placed(moved, q, frame), there, atol=1e-12)
