"""Groups of SRDF files: which joints move, and where the other joints are locked."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest
from robot_samples import chain, write

from tominpmp.description.fields import Field
from tominpmp.exceptions import (
    JointNotFound,
    OptionsError,
    ProblemError,
    TominpmpWarning,
)
from tominpmp.files.scenario import read_robot, robot_table
from tominpmp.robot.robot import load_robot

ALL = """
<group name="chain"><chain base_link="l1" tip_link="l3"/></group>
<group name="links"><link name="l2"/><link name="base"/></group>
<group name="names"><joint name="sample/j4"/></group>
<group name="both"><group name="names"/><group name="links"/></group>
<group name="l_hand"><joint name="j1"/></group>
<group_state name="up" group="both"><joint name="j1" value="0.25"/></group_state>
<group_state name="home" group="both"><joint name="j1" value="-0.5"/></group_state>
"""


def arm(folder: Path, groups: str = ALL, **arguments: object) -> object:
    urdf = write(folder, chain("", "", "", ""))
    write(folder, f'<robot name="sample">{groups}</robot>', f"{urdf.stem}.srdf")
    return load_robot(urdf, **arguments)


@pytest.mark.parametrize(
    ("group", "joints"),
    [
        ("chain", ("j2", "j3")),
        ("links", ("j2",)),
        ("names", ("j4",)),
        ("both", ("j2", "j4")),
        ("left_hand", ("j1",)),
        ("sample_both", ("j2", "j4")),
    ],
)
def test_group_moves_its_joints_and_locks_the_others(
    group: str, joints: tuple[str, ...], tmp_path: Path
) -> None:
    found = arm(tmp_path, group=group)
    assert found.joint_names == joints
    rest = {"j1": -0.5, "j2": 0.0, "j3": 0.0, "j4": 0.0}
    assert found.locked_joints == {k: v for k, v in rest.items() if k not in joints}
    assert pickle.loads(pickle.dumps(found)) == found


def test_group_state_of_a_shared_name_is_that_of_the_loaded_group(
    tmp_path: Path,
) -> None:
    both = """<group name="one"><joint name="j1"/></group>
    <group name="two"><joint name="j1"/><joint name="j2"/></group>
    <group_state name="up" group="one"><joint name="j1" value="0.1"/></group_state>
    <group_state name="up" group="two">
      <joint name="j1" value="0.7"/><joint name="j2" value="0.5"/>
    </group_state>"""
    two, one = (arm(tmp_path, both, group=name) for name in ("two", "one"))
    assert two.group_state("up").tolist() == [0.7, 0.5]
    assert one.group_state("up").tolist() == [0.1]
    assert two.with_locked({"j2": 0.0}).group_state("up").tolist() == [0.1]
    table = Field(robot_table(one, tmp_path / "s.toml"), tmp_path / "s.toml")
    assert read_robot(table) == one


def test_locked_joints_of_the_caller_replace_positions_of_the_file(
    tmp_path: Path,
) -> None:
    found = arm(tmp_path, group="chain", locked_joints={"j4": 0.75, "j3": 0.5})
    assert found.joint_names == ("j2",)
    assert found.locked_joints == {"j1": -0.5, "j3": 0.5, "j4": 0.75}
    with pytest.raises(JointNotFound, match="no joint 'j9'"):
        arm(tmp_path, group="chain", locked_joints={"j9": 0.0})


def test_unknown_groups_are_refused(tmp_path: Path) -> None:
    with pytest.raises(OptionsError, match=r"'arm'; .* chain, links, names") as caught:
        arm(tmp_path, group="arm")
    assert caught.value.option == "group"
    with pytest.raises(OptionsError, match="no group 3"):
        arm(tmp_path, group=3)
    with pytest.raises(OptionsError, match="has: none; or give an SRDF file"):
        arm(tmp_path, "", group="arm")
    with pytest.raises(OptionsError, match="no joint moves"):
        arm(tmp_path, '<group name="a"/>', group="a")


def test_groups_of_the_same_name_give_a_warning(tmp_path: Path) -> None:
    two = '<group name="a"><joint name="j1"/></group>'
    two += '<group name="a"><joint name="j2"/></group>'
    with pytest.warns(TominpmpWarning, match=r"srdf: of the groups 'a' the last"):
        assert arm(tmp_path, two, group="a").joint_names == ("j2",)


def test_joint_limits_file_repeats_no_warning(tmp_path: Path) -> None:
    limits = write(tmp_path, "joint_limits: {j1: {max_velocity: 1.0}}", "limits.yaml")
    text = '<group name="a"><joint name="j1"/><joint name="gone"/></group>'
    with pytest.warns(TominpmpWarning) as warned:
        arm(tmp_path, text)
        table = {"path": "sample.urdf", "group": "a", "joint_limits": str(limits)}
        read_robot(Field(table, tmp_path / "s.toml"))
    assert [str(item.message).partition(" names")[0] for item in warned] == [
        "the group 'a'"
    ]


def test_members_of_a_group_that_the_robot_lacks_give_a_warning(tmp_path: Path) -> None:
    inside = '<joint name="j1"/><joint name="gone"/><link name="no"/>'
    text = f'<group name="a">{inside}<group name="none"/></group>'
    with pytest.warns(TominpmpWarning, match="'a' names gone, no, none, which"):
        arm(tmp_path, text, group="a")
    base = '<virtual_joint name="v" type="floating" child_link="base"/>'
    text = f'{base}<group name="a"><joint name="v"/><joint name="j1"/></group>'
    with pytest.warns(TominpmpWarning, match="moves the base, which .* standing"):
        arm(tmp_path, text, group="a")
    assert arm(tmp_path, text).n == 4  # without a group, the free base is fixed


def test_passive_joints_with_torque_give_a_warning(tmp_path: Path) -> None:
    text = '<passive_joint name="j2"/>'
    with pytest.warns(TominpmpWarning, match=r"calls j2 passive.*effort=\{'j2': 0\}"):
        arm(tmp_path, text)
    arm(tmp_path, text, effort={"j2": 0})
    arm(tmp_path, text, locked_joints={"j2": 0.0})


def test_unknown_elements_of_an_srdf_file_give_a_warning(tmp_path: Path) -> None:
    with pytest.warns(TominpmpWarning, match="not read: <disable_collision>"):
        arm(tmp_path, '<disable_collision link1="l1" link2="l2"/>')
    arm(tmp_path, '<link_sphere_approximation link="l1"/><end_effector name="e"/>')


def test_disabled_default_collisions_apply_to_all_pairs_of_a_link(
    tmp_path: Path,
) -> None:
    text = (
        '<disable_default_collisions link="l1"/>'
        '<enable_collisions link1="l3" link2="l1"/>'
    )
    found = arm(tmp_path, text)
    expected = {("base", "l1"), ("l1", "l2"), ("l1", "l4")}
    assert set(found.srdf.disabled_pairs) == expected


def test_rotor_inertia_of_an_srdf_file_is_the_armature(tmp_path: Path) -> None:
    text = '<rotor_params><joint name="j2" mass="1e-4" gear_ratio="50"/></rotor_params>'
    found = arm(tmp_path, text)
    np.testing.assert_allclose(found.armature, [0.0, 0.25, 0.0, 0.0])
    assert not np.any(arm(tmp_path, text, armature=0.0).armature)


def test_group_that_contains_itself_is_refused(tmp_path: Path) -> None:
    ring = [f'<group name="{a}"><group name="{b}"/></group>' for a, b in ("ab", "ba")]
    text = "".join(ring)
    with pytest.raises(Exception, match="group 'a' holds itself"):
        arm(tmp_path, text)


def test_groups_in_groups_are_read_once_each(tmp_path: Path) -> None:
    """Regression: 2^30 visits of groups that hold each other twice, or a deep chain
    of groups, had no end or ended with a RecursionError.
    """
    inside = '<group name="g{0}"/>'
    for count, copies in ((30, 2), (1500, 1)):
        names = range(count)
        groups = [f'<group name="g{k}">{inside.format(k + 1) * copies}' for k in names]
        text = "</group>".join([*groups, f'<group name="g{count}"><joint name="j1"/>'])
        text += '<joint name="gone"/></group>'
        with pytest.warns(TominpmpWarning, match="group 'g0' names gone, which"):
            assert arm(tmp_path, text, group="g0").joint_names == ("j1",)


def test_joint_may_have_the_name_of_its_group(tmp_path: Path) -> None:
    text = '<group name="j1"><joint name="j1"/></group>'
    assert arm(tmp_path, text, group="j1").joint_names == ("j1",)


def test_groups_of_bundled_and_example_robots_load() -> None:
    """One call loads a group; the base of a humanoid is fixed."""
    panda = load_robot("panda", limits="urdf", group="panda_arm")
    assert panda.n == 7 and panda.locked_joints["panda_finger_joint1"] == 0.001
    talos = load_robot("talos", group="left_arm")
    assert talos.joint_names == tuple(f"arm_left_{i}_joint" for i in range(1, 8))
    assert talos.locked_joints["leg_left_4_joint"] == 0.859395  # half sitting
    np.testing.assert_allclose(talos.armature, 0.1)
    with pytest.raises(OptionsError, match="has: r_leg, l_leg, r_arm, l_arm"):
        load_robot("talos", group="tail")


def test_groups_survive_saving_in_a_scenario_file(tmp_path: Path) -> None:
    table = {"name": "panda", "group": "arm"}
    found = read_robot(Field(table, tmp_path / "s.toml", "robot"))
    assert found == load_robot("panda", group="arm")
    saved = Field(robot_table(found, tmp_path / "s.toml"), tmp_path / "s.toml", "robot")
    assert read_robot(saved) == found


def test_locking_further_joints_equals_loading_with_them_locked(tmp_path: Path) -> None:
    whole = arm(tmp_path, velocity=[1, 2, 3, 4])
    part = whole.with_locked({"j1": 0.5, "j3": 0.0})
    expected = arm(
        tmp_path, locked_joints={"j1": 0.5, "j3": 0.0}, velocity={"j2": 2, "j4": 4}
    )
    assert part == expected
    assert part.collision_model.ngeoms == expected.collision_model.ngeoms
    with pytest.raises(Exception, match="no joint is left"):
        part.with_locked({"j2": 0.0, "j4": 0.0})


def test_locking_joints_keeps_the_dry_friction_of_the_others(tmp_path: Path) -> None:
    whole = arm(tmp_path, friction=[1, 2, 3, 4])
    np.testing.assert_array_equal(whole.with_locked({"j2": 0.0}).friction, [1, 3, 4])
    with pytest.raises(ProblemError, match="positions is 3, expected positions by"):
        whole.with_locked(3)
