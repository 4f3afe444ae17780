"""Reading URDF and SRDF files: wrong files, joints, mimic joints, shapes."""

from __future__ import annotations

import math
import pickle
import warnings
from pathlib import Path

import pytest
from robot_samples import (
    INERTIAL,
    chain,
    joint,
    link,
    one_joint,
    one_shape,
    read,
    robot,
    write,
    write_tetrahedron,
)

from tominpmp.description import urdf, xml_reader
from tominpmp.description.files import find_robot
from tominpmp.description.joint_table import Linkage
from tominpmp.description.model import build_model
from tominpmp.description.srdf import read_srdf, srdf_file
from tominpmp.description.tree import Mimic
from tominpmp.description.urdf import read_urdf
from tominpmp.description.xacro_files import Arguments
from tominpmp.exceptions import (
    JointNotFound,
    OptionsError,
    RobotLoadError,
    TominpmpWarning,
)
from tominpmp.robot.robot import load_robot

# Wrong files


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is not XML"),
        ("hello", "is not XML"),
        ("<robot><link name='a'></robot>", "is not XML"),
        ("<robot><link name=</robot>", "is not XML"),
        ("<?xml version='1.0' encoding='nonsense'?><robot/>", "is not XML"),
        ("<mujoco/>", "root is <mujoco>, not <robot>"),
        ("<robot/>", "it has no <link>"),
        (robot(link("a"), link("a")), "two links named 'a'"),
        (robot("<link/>"), "<link> lacks the attribute 'name'"),
        (robot(link("a"), link("b")), "2 links without a parent joint.*a, b"),
        (robot(link("a"), joint("j", "a", "b")), "child link 'b' does not exist"),
        (robot(link("a"), joint("j", "b", "a")), "parent link 'b' does not exist"),
        (
            robot(link("a"), link("b"), '<joint name="j" type="fixed"/>'),
            "joint j lacks <parent>",
        ),
        (
            robot(
                *map(link, "abc"),
                joint("j", "a", "c"),
                joint("k", "b", "c"),
            ),
            "link c is the child of two joints, j and k",
        ),
        (
            robot(
                *map(link, "abc"),
                joint("j", "b", "c"),
                joint("k", "c", "b"),
            ),
            "links b, c form a loop",
        ),
        (
            robot(*map(link, "abc"), joint("j", "a", "b"), joint("j", "b", "c")),
            "two joints named 'j'",
        ),
        (one_joint(kind="floating"), "joint j1 has the type 'floating'.*make it fixed"),
        (one_joint(kind="planar"), "joint j1 has the type 'planar'"),
        (one_joint(kind="ball"), "joint j1 has the type 'ball'"),
        (one_joint(axis="0 0 0"), "joint j1: the axis .* has no direction"),
        (one_joint(axis="0 0"), "axis xyz='0 0', expected 3 numbers"),
        (one_joint(axis="0 0 nan"), "expected 3 numbers"),
        # Other readers would stop at the underscore.
        (one_joint(axis="0 0 1_0"), "expected 3 numbers"),
        (one_joint(limit='<limit effort="1_0"/>'), "effort='1_0', expected a number"),
        (one_joint(axis="0 0 1e300"), "expected 3 numbers"),
        (one_joint(limit='<limit effort="x"/>'), "limit effort='x', expected a number"),
        (one_joint(limit='<limit effort="nan"/>'), "effort='nan', expected a number"),
        (one_joint(limit='<limit effort="-1"/>'), "effort=-1 is negative"),
        (one_joint(inside='<dynamics damping="-1"/>'), "damping='-1'"),
        (one_joint(inside="<mimic/>"), "joint j1: <mimic> lacks .*'joint'"),
        (one_joint(inside='<mimic joint="x"/>'), "joint j1 follows 'x', which is no"),
        (
            one_shape('<sphere radius="-1"/>'),
            "sphere radius='-1', expected a number from 0 to",
        ),
        (one_shape("<sphere/>"), "lacks the attribute 'radius'"),
        (one_shape('<box size="1 1"/>'), "box size='1 1', expected 3 numbers"),
        (one_shape("<heightmap/>"), "collision 1: <geometry> has <heightmap>"),
        (one_shape(""), "<geometry> has nothing"),
        (
            robot(link("a", '<inertial><mass value="-1"/></inertial>')),
            "link a: mass value='-1'",
        ),
        (robot(link("a", "<inertial/>")), "link a: <inertial> lacks <mass>"),
    ],
)
def test_message_about_a_wrong_urdf_names_the_element(
    tmp_path: Path, text: str, message: str, capfd: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(RobotLoadError, match=message) as caught:
        read(tmp_path, text)
    assert caught.value.path == tmp_path / "sample.urdf"
    assert str(tmp_path / "sample.urdf") in str(caught.value)
    assert capfd.readouterr() == ("", "")


def test_missing_file_and_folder_are_rejected(tmp_path: Path) -> None:
    with pytest.raises(RobotLoadError, match="there is no file"):
        read_urdf(tmp_path / "none.urdf")
    with pytest.raises(RobotLoadError, match="is a folder"):
        read_urdf(tmp_path)
    with pytest.raises(RobotLoadError, match="is a folder"):
        read_urdf(find_robot("/").urdf)
    with pytest.raises(RobotLoadError, match=r"there is no file|cannot be read"):
        read_urdf(tmp_path / "a\0b.urdf")


def test_binary_file_is_rejected_as_no_xml(tmp_path: Path) -> None:
    path = tmp_path / "sample.urdf"
    path.write_bytes(bytes(range(256)) * 40)
    with pytest.raises(RobotLoadError, match="is not XML"):
        read_urdf(path)


@pytest.mark.parametrize("name", ["scenario.yaml", "scenario.toml"])
def test_scenario_in_place_of_a_urdf_names_load_scenario(
    name: str, tmp_path: Path
) -> None:
    """Regression: the live page, which takes robots only, called a scenario no XML."""
    path = tmp_path / name
    path.write_text("robot: panda\n", encoding="utf-8")
    expected = r"is not a URDF file; 'plan' and load_scenario\(\) take TOML files"
    with pytest.raises(RobotLoadError, match=expected):
        read_urdf(path)


def test_internal_entities_are_rejected(tmp_path: Path) -> None:
    lines = ['<!ENTITY e0 "lol">']
    lines += [f'<!ENTITY e{i} "{f"&e{i - 1};" * 10}">' for i in range(1, 12)]
    text = f"<!DOCTYPE robot [{''.join(lines)}]><robot name='&e11;'/>"
    with pytest.raises(RobotLoadError, match="declares a document type"):
        read(tmp_path, text)


def test_external_entities_are_rejected(tmp_path: Path) -> None:
    secret = write(tmp_path, "secret", "secret.txt")
    text = f"<!DOCTYPE r [<!ENTITY x SYSTEM 'file://{secret}'>]><robot>&x;</robot>"
    with pytest.raises(RobotLoadError, match="declares a document type"):
        read(tmp_path, text)


def test_size_depth_and_number_of_elements_are_limited(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    size = write_tetrahedron(tmp_path / "a.obj").stat().st_size
    monkeypatch.setattr(urdf, "MAX_MESH_BYTES", size - 1)
    with pytest.raises(RobotLoadError, match=f"a.obj has more than {size - 1} bytes"):
        read(tmp_path, one_shape('<mesh filename="a.obj"/>'))
    with pytest.raises(RobotLoadError, match="nests them deeper"):
        read(tmp_path, "<robot>" + "<a>" * 10_000 + "</a>" * 10_000 + "</robot>")
    monkeypatch.setattr(xml_reader, "MAX_ELEMENTS", 100)
    with pytest.raises(RobotLoadError, match="more than 100 elements"):
        read(tmp_path, "<robot>" + "<a/>" * 200 + "</robot>")
    monkeypatch.setattr(xml_reader, "MAX_BYTES", 100)
    with pytest.raises(RobotLoadError, match="bytes, more than"):
        read(tmp_path, one_joint())


def test_more_than_2000_links_are_rejected(tmp_path: Path) -> None:
    with pytest.raises(RobotLoadError, match="has 2001 links"):
        read(tmp_path, chain(*[""] * 2000))


# Joints, limits and shapes


def test_limits_and_damping_of_a_joint_are_read(tmp_path: Path) -> None:
    text = one_joint(inside='<dynamics damping="0.5" friction="1"/>')
    (found,) = read(tmp_path, text).joints
    assert (found.name, found.kind) == ("j1", "revolute")
    assert (found.lower, found.upper) == (-1, 2)
    assert (*found.effort, found.velocity, found.damping) == (-10, 10, 3, 0.5)
    assert found.mimic is None


def test_continuous_joint_has_no_position_limits(tmp_path: Path) -> None:
    description = read(tmp_path, one_joint(kind="continuous"))
    (found,) = description.joints
    assert (found.lower, found.upper) == (-math.inf, math.inf)
    assert build_model(description, {}).nq == 1


def test_missing_limits_are_unknown_or_zero(tmp_path: Path) -> None:
    (found,) = read(tmp_path, one_joint(limit="")).joints
    values = (found.lower, found.upper, found.velocity, *found.effort)
    assert all(map(math.isnan, values))
    # By the URDF specification, a position limit missing beside the other one is zero.
    (found,) = read(tmp_path, one_joint(limit='<limit upper="0.04"/>')).joints
    assert (found.lower, found.upper) == (0, 0.04)


def test_infinite_limits_are_read(tmp_path: Path) -> None:
    limit = '<limit lower="-inf" upper="1e16" velocity="INF" effort="1"/>'
    (found,) = read(tmp_path, one_joint(limit=limit)).joints
    assert (found.lower, found.upper, found.velocity) == (-math.inf, math.inf, math.inf)


def test_mimic_elements_are_read(tmp_path: Path) -> None:
    text = chain(
        "", '<mimic joint="j1"/>', '<mimic joint="j2" multiplier="-2" offset="1"/>'
    )
    first, second, third = read(tmp_path, text).joints
    assert first.mimic is None
    assert second.mimic == Mimic("j1", 1.0, 0.0)
    assert third.mimic == Mimic("j2", -2.0, 1.0)


def test_gravity_and_name_of_the_robot_are_read(tmp_path: Path) -> None:
    description = read(tmp_path, one_joint())
    assert description.gravity is None
    assert description.name == "sample"
    text = one_joint().replace("<link", '<tominpmp gravity="1 2 3"/><link', 1)
    assert read(tmp_path, text).gravity == (1, 2, 3)
    with pytest.raises(RobotLoadError, match="gravity='1 2', expected 3 numbers"):
        read(tmp_path, text.replace("1 2 3", "1 2"))
    nameless = one_joint().replace(' name="sample"', "")
    assert read_urdf(write(tmp_path, nameless, "arm.urdf")).name == "arm"


def test_elements_of_other_tools_are_ignored(tmp_path: Path) -> None:
    text = one_joint(inside='<safety_controller soft_lower_limit="no"/>').replace(
        "</robot>",
        "<gazebo><sensor:camera/></gazebo><transmission><joint name='j1'/>"
        "</transmission></robot>",
    )
    description = read(tmp_path, text)
    assert [found.name for found in description.joints] == ["j1"]
    assert build_model(description, {}).nq == 1


def test_materials_with_one_name_keep_their_own_colours(tmp_path: Path) -> None:
    def visual(color: str) -> str:
        return (
            '<visual><geometry><sphere radius="1"/></geometry><material name="m">'
            f'<color rgba="{color}"/></material></visual>'
        )

    inside = INERTIAL + visual("1 0 0 1") + visual("0 1 0 1") + visual("no colour")
    (found,) = read(tmp_path, robot(link("a", inside))).bodies
    colours = [shape.colour for shape in found.visuals]
    assert colours == [(1.0, 0.0, 0.0, 1.0), (0.0, 1.0, 0.0, 1.0), None]


# Mimic joints and locked joints


def linkage(folder: Path, *insides: str, **locked: float) -> Linkage:
    return Linkage.resolve(read(folder, chain(*insides)), locked)


FOLLOW_1 = '<mimic joint="j1" multiplier="2" offset="0.5"/>'
FOLLOW_2 = '<mimic joint="j2" multiplier="-3" offset="1"/>'


def test_chain_of_mimic_joints_is_resolved_to_one_leader(tmp_path: Path) -> None:
    found = linkage(tmp_path, "", FOLLOW_1, FOLLOW_2)
    assert found.locked == {}
    # q3 = -3 (2 q1 + 0.5) + 1
    assert found.followers == {"j2": Mimic("j1", 2, 0.5), "j3": Mimic("j1", -6, -0.5)}


def test_locked_leader_locks_its_mimic_joints(tmp_path: Path) -> None:
    found = linkage(tmp_path, "", FOLLOW_1, FOLLOW_2, j1=0.25)
    assert found.locked == {"j1": 0.25, "j2": 1.0, "j3": -2.0}
    assert found.followers == {}
    assert found.reasons() == dict.fromkeys(("j1", "j2", "j3"), "is locked")


def test_locked_mimic_joint_must_agree_with_its_leader(tmp_path: Path) -> None:
    assert linkage(tmp_path, "", FOLLOW_1, j1=0.25, j2=1.0).locked["j2"] == 1.0
    with pytest.raises(OptionsError, match=r"j2 got 2, but it follows j1.* at 1"):
        linkage(tmp_path, "", FOLLOW_1, j1=0.25, j2=2.0)
    with pytest.raises(OptionsError, match="j2 follows j1; lock that one"):
        linkage(tmp_path, "", FOLLOW_1, j2=1.0)


def test_cycle_of_mimic_joints_is_rejected(tmp_path: Path) -> None:
    with pytest.raises(RobotLoadError, match=r"\.urdf: joint j1 follows itself"):
        linkage(tmp_path, '<mimic joint="j2"/>', '<mimic joint="j1"/>')


@pytest.mark.parametrize("value", [math.nan, math.inf, 1e300, "0", None, [0.0]])
def test_locked_position_must_be_a_number(tmp_path: Path, value: object) -> None:
    with pytest.raises(OptionsError, match=r"joint j1 is .*, expected a finite"):
        linkage(tmp_path, "", j1=value)  # type: ignore[arg-type]


def test_unknown_locked_joint_is_named(tmp_path: Path) -> None:
    with pytest.raises(JointNotFound, match="'j9'; the robot has: j1, j2"):
        linkage(tmp_path, "", "", j9=0.0)


# SRDF


def test_written_srdf_file_is_read_again(tmp_path: Path) -> None:
    text = """<robot name="sample"><virtual_joint name="v" type="floating"/>
      <group name="arm"><joint name="v"/><joint name="j1"/><joint name="x"/></group>
      <passive_joint name="j2"/></robot>"""
    description = read(tmp_path, chain("", ""))
    found = read_srdf(text, description, Arguments())
    assert found.groups["arm"].moves_base and found.passive == ("j2",)
    written = srdf_file(found, "sample", ())
    assert read_srdf(written, description, Arguments()) == found  # type: ignore[arg-type]


def test_srdf_groups_states_and_disabled_pairs_are_read(tmp_path: Path) -> None:
    text = """<robot name="sample">
      <group_state name="home" group="arm"><joint name="j1" value="0.5"/>
        <joint name="other" value="1 2 3"/></group_state>
      <group_state name="home" group="hand"><joint name="j2" value="-1"/></group_state>
      <disable_collisions link1="l2" link2="l1" reason="Adjacent"/>
      <disable_collisions link1="l1" link2="l2"/>
      <disable_collisions link1="l1" link2="tool"/>
    </robot>"""
    path = write(tmp_path, text, "sample.srdf")
    found = read_srdf(path, read(tmp_path, chain("", "")), Arguments())
    assert found.disabled_pairs == (("l1", "l2"),)
    assert found.group_states(["j1", "j2"]) == {"home": {"j1": 0.5, "j2": -1.0}}
    assert found.path == path
    with pytest.raises(TypeError):
        found.states["arm", "home"]["j1"] = 0.0  # type: ignore[index]
    assert pickle.loads(pickle.dumps(found)) == found


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<sdf/>", "is not an SRDF file: its root is <sdf>"),
        ("<robot><disable_collisions link1='l1'/></robot>", "lacks .*'link2'"),
        ("<robot><group_state/></robot>", "lacks .*'name'"),
        (
            "<robot><group_state name='a'><joint name='j1' value='x'/></group_state>"
            + "</robot>",
            "group_state a, joint j1: joint value='x', expected a number",
        ),
        (
            "<robot><rotor_params><joint name='j1' mass='-1'/></rotor_params></robot>",
            "rotor_params, joint j1: joint mass='-1', expected a number from 0 to",
        ),
        (
            "<robot><disable_collisions link1='x' link2='y'/></robot>",
            "belongs to another robot: it names the links x, y",
        ),
    ],
)
def test_message_about_a_wrong_srdf_names_the_element(
    tmp_path: Path, text: str, message: str
) -> None:
    path = write(tmp_path, text, "sample.srdf")
    with pytest.raises(RobotLoadError, match=message):
        read_srdf(path, read(tmp_path, one_joint()), Arguments())


POINTS = (
    '<box size="0 0 0"/>',
    '<sphere radius="0"/>',
    '<cylinder radius="0" length="0"/>',
    '<capsule radius="0.0" length="0"/>',
)


@pytest.mark.parametrize("tag", ["collision", "visual"])
@pytest.mark.parametrize("shape", POINTS)
def test_shapes_of_zero_size_are_dropped_with_a_warning(
    tmp_path: Path, shape: str, tag: str
) -> None:
    path = write(tmp_path, one_shape(shape, tag))
    with pytest.warns(TominpmpWarning, match=f"no size .*: link l1, {tag} 1$"):
        arm = load_robot(path)
    assert arm.collision_model.ngeoms == 0


def test_flat_box_gets_a_small_thickness(tmp_path: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        flat = read(tmp_path, one_shape('<box size="1 0.5 0"/>'))
    assert flat.bodies[1].collisions[0].sizes == (1.0, 0.5, 1e-6)
