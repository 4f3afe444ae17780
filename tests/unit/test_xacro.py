"""xacro files in the style of makers: includes, properties, macros, conditionals."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

import tominpmp as tm
from benchmarks import every_description
from tominpmp.description.files import find_robot

NAMESPACE = 'xmlns:xacro="http://www.ros.org/wiki/xacro"'
ARM = f"""<?xml version="1.0"?>
<robot name="maker_arm" {NAMESPACE}>
  <xacro:arg name="prefix" default=""/>
  <xacro:arg name="with_tool" default="false"/>
  <xacro:arg name="model" default="m5"/>
  <xacro:include filename="$(find maker_description)/urdf/materials.xacro"/>
  <xacro:include filename="link.xacro"/>
  <xacro:property name="joints"
    value="${{xacro.load_yaml('$(find maker_description)/config/$(arg model).yaml')}}"/>
  <xacro:property name="reach" value="${{2 * 0.15}}"/>
  <link name="$(arg prefix)base"/>
  <xacro:arm_link name="one" parent="base" axis="0 0 1" height="0.1"/>
  <xacro:arm_link name="two" parent="one" axis="0 1 0" height="${{reach}}"/>
  <xacro:if value="$(arg with_tool)">
    <link name="$(arg prefix)tool"/>
    <joint name="$(arg prefix)tool_mount" type="fixed">
      <parent link="$(arg prefix)two"/><child link="$(arg prefix)tool"/>
    </joint>
  </xacro:if>
</robot>"""
LINK = f"""<robot {NAMESPACE}>
  <xacro:macro name="arm_link" params="name parent axis height mass:=2">
    <joint name="$(arg prefix)${{name}}" type="revolute">
      <parent link="$(arg prefix)${{parent}}"/><child link="$(arg prefix)${{name}}"/>
      <origin xyz="0 0 ${{height}}"/><axis xyz="${{axis}}"/>
      <xacro:property name="own" value="${{joints[name]}}"/>
      <limit lower="${{-own['range']}}" upper="${{radians(120)}}"
             velocity="${{own.velocity}}" effort="${{max(60, 10)}}"/>
    </joint>
    <link name="$(arg prefix)${{name}}">
      <visual><geometry><box size="0.1 0.1 0.1"/></geometry>
        <material name="grey"/></visual>
      <inertial><origin xyz="0 0 0.15"/><mass value="${{mass}}"/>
        <inertia ixx="${{mass * 0.01}}" iyy="${{mass * 0.01}}" izz="0.004"
                 ixy="0" ixz="0" iyz="0"/></inertial>
    </link>
  </xacro:macro>
</robot>"""
MATERIALS = f"""<robot {NAMESPACE}>
  <material name="grey"><color rgba="0.5 0.5 0.5 1"/></material></robot>"""
CONFIG = "one: {range: !degrees 120, velocity: 2.0}\ntwo: {range: 2.0, velocity: 2.5}\n"


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    """The xacro file of a robot, in a package whose folder has another name."""
    pytest.importorskip("xacrodoc", reason="the extra xacro is not installed")
    package = tmp_path / "checkout"
    for name, text in (
        ("package.xml", "<package><name> maker_description </name></package>"),
        ("urdf/arm.urdf.xacro", ARM),
        ("urdf/link.xacro", LINK),
        ("urdf/materials.xacro", MATERIALS),
        ("config/m5.yaml", CONFIG),
    ):
        (package / name).parent.mkdir(parents=True, exist_ok=True)
        (package / name).write_text(text)
    return package / "urdf" / "arm.urdf.xacro"


def expand(folder: Path, body: str, **more: object) -> tm.Robot:
    """Load a xacro file with this body."""
    pytest.importorskip("xacrodoc", reason="the extra xacro is not installed")
    file = folder / "robot.xacro"
    file.write_text(f'<robot name="r" {NAMESPACE}>{body}</robot>')
    return tm.load_robot(file, **more)  # type: ignore[arg-type]


def test_includes_macros_and_properties_are_expanded(arm: Path) -> None:
    robot = tm.load_robot(arm)
    assert robot.name == "maker_arm"
    assert robot.joint_names == ("one", "two")
    np.testing.assert_allclose(robot.limits.position_lower, [-2 * np.pi / 3, -2.0])
    np.testing.assert_allclose(robot.limits.velocity, [2.0, 2.5])
    # The units of xacro files do not leak into other YAML files.
    with pytest.raises(yaml.YAMLError):
        yaml.safe_load("!degrees 3")


def test_xacro_arguments_survive_saving_and_loading(arm: Path, tmp_path: Path) -> None:
    given = {"prefix": "left_", "with_tool": True}
    robot = tm.load_robot(arm, xacro_args=given)
    assert robot.joint_names == ("left_one", "left_two")
    assert "left_tool" in robot.description.links
    problem = tm.Problem(robot, [0.0, 0.1], tm.JointGoal([0.1, 0.2]))
    tm.save_scenario(tmp_path / "arm.toml", problem)
    again = tm.load_scenario(tmp_path / "arm.toml").problem.robot
    assert again.description.links == robot.description.links


def test_srdf_xacro_files_are_expanded(arm: Path, tmp_path: Path) -> None:
    """Current MoveIt configurations have ``NAME.srdf.xacro``."""
    srdf = arm.parents[1] / "config" / "arm.srdf.xacro"
    srdf.write_text(f"""<robot name="maker_arm" {NAMESPACE}>
      <xacro:arg name="prefix" default=""/>
      <xacro:macro name="arm_group" params="name">
        <group name="${{name}}"><joint name="$(arg prefix)one"/></group>
        <group_state name="rest" group="${{name}}">
          <joint name="$(arg prefix)one" value="${{pi / 4}}"/>
        </group_state>
      </xacro:macro>
      <xacro:arm_group name="$(arg prefix)turn"/>
      <disable_collisions link1="$(arg prefix)one" link2="$(arg prefix)base"/>
    </robot>""")
    # The SRDF does not declare the argument "model".
    given = {"prefix": "left_", "model": "m5"}
    robot = tm.load_robot(arm, srdf=srdf, xacro_args=given, group="left_turn")
    assert robot.joint_names == ("left_one",)
    assert robot.srdf is not None
    assert robot.srdf.disabled_pairs == (("left_base", "left_one"),)
    np.testing.assert_allclose(robot.group_state("rest"), [np.pi / 4])
    problem = tm.Problem(robot, robot.group_state("rest"), tm.JointGoal([0.1]))
    tm.save_scenario(tmp_path / "arm.toml", problem)
    again = tm.load_scenario(tmp_path / "arm.toml").problem.robot
    assert again.group_states == robot.group_states
    # The SRDF of a robot without xacro may be a xacro file.
    with pytest.raises(tm.RobotLoadError, match="no value"):
        tm.load_robot(
            "planar3r", srdf=f'<robot name="$(arg a)" {NAMESPACE}><xacro:x/></robot>'
        )
    with pytest.raises(tm.OptionsError, match="no xacro argument 'prefx'"):
        tm.load_robot(arm, srdf=srdf, xacro_args={"prefx": "left_"})


def test_arguments_declared_only_by_the_srdf_are_accepted(
    arm: Path, tmp_path: Path
) -> None:
    """Regression: these arguments were rejected, as the robot's own file does not
    declare them.
    """
    text = f"""<robot name="r" {NAMESPACE}><xacro:arg name="rest" default="0"/>
      <group_state name="rest" group="all"><joint name="%s" value="$(arg rest)"/>
      </group_state></robot>"""
    given = {"rest": 0.25, "model": "m5"}
    robot = tm.load_robot(arm, srdf=text % "one", xacro_args=given)
    assert robot.group_states["rest"] == {"one": 0.25}
    srdf = tmp_path / "planar.srdf.xacro"
    srdf.write_text(text % "joint2")
    plain = tm.load_robot("planar3r", srdf=srdf, xacro_args={"rest": 0.25})
    assert plain.group_states["rest"] == {"joint2": 0.25}
    problem = tm.Problem(plain, [0.5, 0.1, 0.2], tm.JointGoal([0.6, 0.2, 0.2]))
    tm.save_scenario(tmp_path / "a.toml", problem)
    again = tm.load_scenario(tmp_path / "a.toml").problem.robot
    assert again.group_states == plain.group_states
    with pytest.raises(tm.OptionsError, match=r"planar3r\.urdf: .* argument 'model'"):
        tm.load_robot("planar3r", srdf=srdf, xacro_args=given)


def test_srdf_beside_the_xacro_file_is_found(arm: Path) -> None:
    """Regression:

    MoveIt writes NAME.urdf.xacro and NAME.srdf; NAME.urdf.srdf was searched.
    """
    (arm.parent / "arm.srdf").write_text(
        '<robot name="maker_arm"><group name="turn"><joint name="one"/></group></robot>'
    )
    assert tm.load_robot(arm, group="turn").joint_names == ("one",)


def test_unknown_xacro_arguments_are_rejected(arm: Path) -> None:
    with pytest.raises(tm.OptionsError, match=r"'prefx' .did you mean prefix"):
        tm.load_robot(arm, xacro_args={"prefx": "a"})
    plain = find_robot("planar3r").urdf.read_text()
    without = plain.replace("<link", f"<xacro:if {NAMESPACE} value='0'/><link", 1)
    for source in ("planar3r", without):
        with pytest.raises(tm.OptionsError, match="files declare no xacro argument"):
            tm.load_robot(source, xacro_args={"prefix": "a"})
    with pytest.raises(tm.OptionsError, match="expected values by name"):
        tm.load_robot(arm, xacro_args="prefix:=a")  # type: ignore[arg-type]


def test_packages_are_found_in_package_dirs(arm: Path, tmp_path: Path) -> None:
    body = '<xacro:include filename="$(find maker_description)/urdf/arm.urdf.xacro"/>'
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    with pytest.raises(tm.RobotLoadError, match=r"'maker_description'.*package_dirs"):
        expand(elsewhere, body)
    robot = expand(elsewhere, body, package_dirs=[tmp_path / "checkout"])
    assert robot.n == 2


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ('<link name="$(arg none)"/><xacro:if value="0"/>', "'none' has no value"),
        ("<xacro:unknown_macro/>", "unknown macro name"),
        ('<xacro:include filename="none.xacro"/>', "none.xacro"),
        ('<xacro:if value="${1/0}"/>', "division by zero"),
        ('<xacro:macro name="m" params=""><xacro:m/></xacro:macro><xacro:m/>', "xacro"),
    ],
)
def test_errors_of_xacro_raise_robot_load_error(
    tmp_path: Path, body: str, message: str
) -> None:
    with pytest.raises(tm.RobotLoadError, match=message):
        expand(tmp_path, body)


@pytest.mark.parametrize(
    "expression",
    [
        "${[c for c in [().__class__]]}",
        "$(eval ${code})",
        "${[g.gi_frame.f_back for g in [(i for i in [1])]]}",
        "${python.vars(python.type(xacro.load_yaml))}",
        "${open('FILE', 'w')}",
        "${(lambda: __import__('os'))()}",
    ],
)
def test_xacro_expressions_cannot_run_arbitrary_code(
    tmp_path: Path, expression: str
) -> None:
    written = tmp_path / "written"
    expression = expression.replace("FILE", str(written))
    code = f"""<xacro:property name="code" value="open('{written}', 'w')"/>"""
    body = f'<link name="a"/><xacro:property name="p" value="{expression}"/>'
    with pytest.raises(tm.RobotLoadError, match=r"refused|not defined"):
        expand(tmp_path, f'{code}{body}<link name="${{p}}"/>')
    assert not written.exists()


def test_included_files_must_not_declare_entities(tmp_path: Path) -> None:
    (tmp_path / "more.xacro").write_text(
        '<!DOCTYPE r [<!ENTITY a "b">]><robot><link name="&a;"/></robot>'
    )
    with pytest.raises(tm.RobotLoadError, match="document type"):
        expand(tmp_path, '<xacro:include filename="more.xacro"/>')


def test_missing_extra_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "xacrodoc", None)
    file = tmp_path / "arm.xacro"
    file.write_text(ARM)
    with pytest.raises(tm.MissingDependency, match=r"xacrodoc.*tominpmp\[xacro\]"):
        tm.load_robot(file)


def test_benchmark_of_descriptions_measures_each_file(
    arm: Path, tmp_path: Path
) -> None:
    (tmp_path / "bad.urdf").write_text("<robot")
    (tmp_path / "package.xml").write_text("<package/>")
    rows = {
        path.name: every_description.measure(
            path, tmp_path, 20.0, {"package_dirs": [tmp_path]}, 2.0
        )
        for path in tmp_path.rglob("*.*")
        if path.suffix in every_description.ENDINGS
    }
    assert {name for name, row in rows.items() if row} == {"bad.urdf", arm.name}
    row = rows[arm.name]
    assert row["loads"] and row["plans"] and row["verified"]
    assert 0.0 < row["T"] < 1.0
    assert rows["bad.urdf"]["loads"] is False
    assert "is not XML" in rows["bad.urdf"]["why"]


def test_warnings_of_xacro_are_shown_once(arm: Path) -> None:
    macro = '<xacro:macro name="part" params="len"/>'
    uses = '<xacro:part len="1"/><xacro:part len="2"/>'
    arm.write_text(arm.read_text().replace("</robot>", f"{macro}{uses}</robot>"))
    with pytest.warns(tm.TominpmpWarning, match="redefining global symbol") as caught:
        tm.load_robot(arm)
    (text,) = (str(item.message) for item in caught if "len" in str(item.message))
    assert text.count("redefining") == 1
    assert "\\n" not in text
