"""Robots of MJCF files agree with MuJoCo, and with those of equivalent URDF files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import trimesh

import tominpmp as tm
from tominpmp.description.model import _inertia
from tominpmp.description.tree import LinkDescription

pytestmark = pytest.mark.filterwarnings("error")

URDF = """<robot name="arm">
  <tominpmp gravity="0 0 -9.5"/>
  <link name="world"/><link name="base"/>
  <joint name="base_fixed" type="fixed">
    <parent link="world"/><child link="base"/><origin xyz="0 0 0.2"/>
  </joint>
  <joint name="turn" type="revolute">
    <parent link="base"/><child link="upper"/><origin xyz="0 0 0.1"/>
    <axis xyz="0 1 0"/><dynamics damping="1.5" friction="0.3"/>
    <limit lower="-1.5707963267948966" upper="1.5707963267948966"
           effort="60" velocity="2"/>
  </joint>
  <link name="upper"><inertial><origin xyz="0 0 0.15"/><mass value="2"/>
    <inertia ixx="0.02" iyy="0.02" izz="0.004" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><origin xyz="0 0 0.15"/>
      <geometry><capsule radius="0.04" length="0.2"/></geometry></collision></link>
  <joint name="slide" type="prismatic">
    <parent link="upper"/><child link="tool"/><origin xyz="0 0 0.3"/>
    <axis xyz="0 0 1"/><dynamics damping="4" friction="0.3"/>
    <limit lower="0" upper="0.4" effort="80" velocity="2"/>
  </joint>
  <link name="tool"><inertial><origin xyz="0 0 0.05"/><mass value="1.5"/>
    <inertia ixx="0.01" iyy="0.01" izz="0.002" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><origin xyz="0 0 0.1"/>
      <geometry><box size="0.06 0.06 0.1"/></geometry></collision></link>
</robot>"""
# Degrees, classes, actuators with gears, and a base above the origin of the world.
MJCF = """<mujoco model="arm">
  <compiler angle="degree"/>
  <option gravity="0 0 -9.5"/>
  <default>
    <joint armature="0.02" frictionloss="0.3"/>
    <motor ctrlrange="-1 1"/>
    <default class="big">
      <joint damping="1.5" range="-90 90" axis="0 1 0"/>
      <default class="bigger"><general gear="60"/></default>
    </default>
  </default>
  <worldbody>
    <geom type="plane" size="1 1 0.1"/>
    <body name="base" pos="0 0 0.2">
      <body name="upper" pos="0 0 0.1" childclass="big">
        <inertial pos="0 0 0.15" mass="2" diaginertia="0.02 0.02 0.004"/>
        <joint name="turn"/>
        <geom type="capsule" fromto="0 0 0.05 0 0 0.25" size="0.04"/>
        <body name="tool" pos="0 0 0.3">
          <inertial pos="0 0 0.05" mass="1.5" diaginertia="0.01 0.01 0.002"/>
          <joint name="slide" type="slide" axis="0 0 1" range="0 0.4" damping="4"
                 actuatorfrcrange="-80 80"/>
          <geom type="box" pos="0 0 0.1" size="0.03 0.03 0.05"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor joint="turn" class="bigger"/>
    <position joint="slide" kp="900" ctrlrange="0 0.4" forcerange="-200 200"/>
  </actuator>
  <keyframe><key name="home" qpos="0.5 0.1"/></keyframe>
</mujoco>"""
START, GOAL = [0.0, 0.05], [0.9, 0.3]


def changed(*pairs: tuple[str, str]) -> str:
    text = MJCF
    for old, new in pairs:
        assert old in text
        text = text.replace(old, new)
    return text


def test_both_formats_give_the_same_motion(tmp_path: Path) -> None:
    file = tmp_path / "arm.xml"
    file.write_text(MJCF)
    one = tm.load_robot(URDF, armature=0.02)
    other = tm.load_robot(file, velocity=2.0)
    for name in ("position_lower", "position_upper", "effort_lower", "effort_upper"):
        assert getattr(other.limits, name) == pytest.approx(
            getattr(one.limits, name), abs=1e-12
        )
    scene = tm.Scene([tm.Sphere("ball", radius=0.1, position=(0.5, 0.0, 1.0))])
    plans = [
        tm.plan(tm.Problem(arm, START, tm.JointGoal(GOAL), scene=scene), effort="quick")
        for arm in (one, other)
    ]
    assert plans[0].success
    assert plans[1].T == pytest.approx(plans[0].T, rel=1e-9)


def test_dynamics_match_mujoco() -> None:
    mujoco = pytest.importorskip("mujoco")
    arm = tm.load_robot(MJCF, velocity=2.0)
    model = mujoco.MjModel.from_xml_string(MJCF)
    data = mujoco.MjData(model)
    rng = np.random.default_rng(3)
    mine = arm.model.createData()
    for q in rng.uniform([-1.5, 0.0], [1.5, 0.4], (5, 2)):
        data.qpos[:], data.qvel[:] = q, rng.normal(size=2)
        mujoco.mj_forward(model, data)
        mass = np.zeros((2, 2))
        mujoco.mj_fullM(model, data, mass)
        assert np.allclose(pin.crba(arm.model, mine, q), mass, rtol=1e-9)
        bias = pin.nle(arm.model, mine, q, np.array(data.qvel))
        assert np.allclose(bias, data.qfrc_bias, rtol=1e-9)


@pytest.mark.parametrize("inherited", ["", 'quat="1 1 0 0"', 'axisangle="1 0 0 70"'])
@pytest.mark.parametrize(
    ("order", "rotation"),
    [
        ("xyz", 'axisangle="1 2 2 40"'),
        ("XYZ", 'euler="30 -40 20"'),
        ("zYx", 'euler="30 -40 20"'),
        ("xyz", 'quat="1 2 3 4"'),
        ("xyz", 'zaxis="1 2 3"'),
    ],
)
def test_rotations_match_mujoco(order: str, rotation: str, inherited: str) -> None:
    """Regression: the rotation of a class often replaced that of the element."""
    mujoco = pytest.importorskip("mujoco")
    text = changed(
        ('angle="degree"', f'angle="degree" eulerseq="{order}"'),
        ('name="tool"', f'name="tool" {rotation}'),
        ('pos="0 0 0.05"', f'pos="0 0 0.05" {rotation}'),
        ('type="box"', f'type="box" name="box" {rotation}'),
        ('<default class="bigger">', f'<geom {inherited}/><default class="bigger">'),
    )
    arm, model = tm.load_robot(text, velocity=2), mujoco.MjModel.from_xml_string(text)
    data, mine, mass = mujoco.MjData(model), arm.model.createData(), np.zeros((2, 2))
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, mass)
    assert np.allclose(pin.crba(arm.model, mine, np.zeros(2)), mass, rtol=1e-9)
    shapes, places = arm.collision_model, arm.collision_model.createData()
    pin.updateGeometryPlacements(arm.model, mine, shapes, places, np.zeros(2))
    box = places.oMg[len(places.oMg) - 1]
    assert np.allclose(box.rotation, data.geom("box").xmat.reshape(3, 3), atol=1e-9)


def test_gravity_is_zero_if_disabled() -> None:
    text = changed(('gravity="0 0 -9.5"/>', '><flag gravity="disable"/></option>'))
    assert tm.load_robot(text, velocity=2).gravity.tolist() == [0.0, 0.0, 0.0]


def test_inertia_of_shapes_matches_mujoco(tmp_path: Path) -> None:
    mujoco = pytest.importorskip("mujoco")
    inertial = '<inertial pos="0 0 0.05" mass="1.5" diaginertia="0.01 0.01 0.002"/>'
    seen = '<geom size="0.05" pos="0.2 0 0" contype="0" conaffinity="0"/>'
    text = changed((inertial, seen))
    arm, model = tm.load_robot(text, velocity=2), mujoco.MjModel.from_xml_string(text)
    data, mine, mass = mujoco.MjData(model), arm.model.createData(), np.zeros((2, 2))
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, mass)
    assert np.allclose(pin.crba(arm.model, mine, np.zeros(2)), mass, rtol=1e-9)
    # Meshes have a mass, too.
    trimesh.creation.box((0.1, 0.1, 0.1)).export(tmp_path / "b.stl")
    text = text.replace("<worldbody>", '<asset><mesh file="b.stl"/></asset><worldbody>')
    text = text.replace(seen, '<geom type="mesh" mesh="b"/>')
    (tmp_path / "arm.xml").write_text(text)
    arm = tm.load_robot(tmp_path / "arm.xml", velocity=2)
    assert arm.model.inertias[2].mass == pytest.approx(1.36)  # 1000 kg/m^3
    assert sum(len(link.visuals) for link in arm.description.bodies) == 3


@pytest.mark.parametrize("of_shapes", ["true", "false", "auto"])
def test_inertiafromgeom_matches_mujoco(of_shapes: str) -> None:
    """Regression: fixed bodies without <inertial> and mass of shapes were refused."""
    mujoco = pytest.importorskip("mujoco")
    text = changed(
        ('angle="degree"', f'angle="degree" inertiafromgeom="{of_shapes}"'),
        ('pos="0 0 0.2">', 'pos="0 0 0.2"><geom size="0.1"/>'),
    )
    arm, model = tm.load_robot(text, velocity=2), mujoco.MjModel.from_xml_string(text)
    data, mine, mass = mujoco.MjData(model), arm.model.createData(), np.zeros((2, 2))
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, mass)
    assert np.allclose(pin.crba(arm.model, mine, np.zeros(2)), mass, rtol=1e-9)


def test_keyframes_are_group_states() -> None:
    arm = tm.load_robot(MJCF, velocity=2.0)
    assert list(arm.group_states) == ["home"]
    np.testing.assert_allclose(arm.group_state("home"), [0.5, 0.1])


def test_velocity_limits_are_infinite_by_default() -> None:
    arm = tm.load_robot(MJCF)
    assert np.all(np.isinf(arm.limits.velocity))


@pytest.mark.parametrize(
    ("pairs", "upper"),
    [
        # The lower of two limits; the sum of two actuators.
        ((("<motor joint", '<motor forcerange="-0.5 0.5" joint'),), 30.0),
        ((("</actuator>", '<motor joint="turn" gear="5"/></actuator>'),), 65.0),
        ((('joint="turn" class="bigger"', 'joint="turn" gear="-7"'),), 7.0),
        # A motor has no bias, whatever its class says; a class may be of servos.
        ((('gear="60"', 'gear="60" gainprm="3" biastype="affine"'),), 60.0),
        (
            (
                ('<general gear="60"/>', '<position gear="60" forcerange="-2 2"/>'),
                ("<motor joint", "<general joint"),
            ),
            120.0,
        ),
        # The force of an integrator follows from its activation, not from its control.
        (
            (
                (
                    '<motor joint="turn" class="bigger"/>',
                    '<general joint="turn" class="bigger" dyntype="integrator" '
                    'ctrlrange="-1 1" actlimited="true" actrange="-0.4 0.4"/>',
                ),
            ),
            24.0,
        ),
    ],
)
def test_actuators_set_effort_limits(
    pairs: tuple[tuple[str, str], ...], upper: float
) -> None:
    arm = tm.load_robot(changed(*pairs), velocity=2.0)
    assert arm.limits.effort_upper[0] == pytest.approx(upper)
    assert arm.limits.effort_lower[0] == pytest.approx(-upper)


def test_effort_limits_may_be_asymmetric() -> None:
    arm = tm.load_robot(changed(('ctrlrange="-1 1"', 'ctrlrange="-0.5 1"')), velocity=2)
    assert arm.limits.effort_lower[0] == pytest.approx(-30.0)
    assert arm.limits.effort_upper[0] == pytest.approx(60.0)


def test_unlimited_hinges_are_continuous_joints() -> None:
    text = changed(('<joint name="turn"/>', '<joint name="turn" limited="false"/>'))
    assert tm.load_robot(text, velocity=2).description.joints[0].kind == "continuous"


def test_joint_references_shift_positions_as_in_mujoco() -> None:
    text = changed(('<joint name="turn"/>', '<joint name="turn" ref="30"/>'))
    plain, moved = (tm.load_robot(t, velocity=2) for t in (MJCF, text))
    q = np.array([0.3, 0.1])
    places = []
    for arm, at in ((plain, q), (moved, q + np.array([np.pi / 6, 0.0]))):
        data = arm.model.createData()
        pin.framesForwardKinematics(arm.model, data, at)
        places.append(data.oMf[arm.frame_id("tool")].homogeneous)
    assert np.allclose(*places)


def test_included_files_are_read(tmp_path: Path) -> None:
    start, end = MJCF.index("<actuator>"), MJCF.index("</mujoco>")
    (tmp_path / "more.xml").write_text(f"<mujoco>{MJCF[start:end]}</mujoco>")
    text = MJCF[:start] + '<include file="more.xml"/></mujoco>'
    (tmp_path / "arm.xml").write_text(text)
    arm = tm.load_robot(tmp_path / "arm.xml", velocity=2.0)
    assert arm.limits.effort_upper[0] == pytest.approx(60.0)
    (tmp_path / "more.xml").write_text('<mujoco><include file="more.xml"/></mujoco>')
    with pytest.raises(tm.RobotLoadError, match="already included"):
        tm.load_robot(tmp_path / "arm.xml")


def test_meshes_are_found_and_scaled(tmp_path: Path) -> None:
    (tmp_path / "assets").mkdir()
    trimesh.creation.box((100.0, 100.0, 100.0)).export(tmp_path / "assets" / "b.stl")
    text = changed(
        ('type="box" pos="0 0 0.1" size="0.03 0.03 0.05"', 'type="box" mesh="b"'),
        ("<worldbody>", '<asset><mesh file="b.stl"/></asset><worldbody>'),
        ('angle="degree"', 'meshdir="assets"'),
        ("<motor ctrl", '<mesh scale="0.001 0.001 0.002"/><motor ctrl'),
    )
    (tmp_path / "arm.xml").write_text(text)
    for arm in (
        tm.load_robot(tmp_path / "arm.xml", velocity=2.0),
        tm.load_robot(text, velocity=2.0, package_dirs=[tmp_path]),
    ):
        mesh = arm.collision_model.geometryObjects[-1].geometry
        mesh.computeLocalAABB()
        assert mesh.aabb_local.depth() == pytest.approx(0.2)
        assert mesh.aabb_local.width() == pytest.approx(0.1)


def test_missing_visual_meshes_give_a_warning() -> None:
    seen = '<geom type="mesh" mesh="m" contype="0" conaffinity="0"/><geom type="box" '
    text = changed(
        ('<geom type="box" ', seen),
        ("<worldbody>", '<asset><mesh file="m.stl"/></asset><worldbody>'),
    )
    with pytest.warns(tm.TominpmpWarning, match="not shown.*body tool .'m'.*package"):
        arm = tm.load_robot(text, velocity=2)
    assert sum(len(link.visuals) for link in arm.description.bodies) == 2
    # Without <inertial> the mass of a body is that of its shapes.
    inertial = '<inertial pos="0 0 0.05" mass="1.5" diaginertia="0.01 0.01 0.002"/>'
    with pytest.raises(tm.RobotLoadError, match="body tool: the mesh 'm"):
        tm.load_robot(text.replace(inertial, ""), velocity=2)
    # A fixed body needs neither <inertial> nor a mesh, if shapes have no mass.
    shape, _, rest = seen.partition("/>")
    text = text.replace(seen, f"<body name='shell'>{shape}/></body>{rest}")
    with pytest.raises(tm.RobotLoadError, match="body shell: the mesh 'm"):
        tm.load_robot(text, velocity=2)
    text = text.replace("<compiler ", "<compiler inertiafromgeom='false' ")
    with pytest.warns(tm.TominpmpWarning, match="not shown.*body shell .'m'"):
        tm.load_robot(text, velocity=2)


def test_a_body_may_have_several_joints() -> None:
    mujoco = pytest.importorskip("mujoco")
    text = changed(
        (
            '<joint name="turn"/>',
            '<joint name="x" type="slide" axis="1 0 0" range="-1 1" actuatorfrcrange='
            '"-9 9"/><joint axis="1 0 0" actuatorfrcrange="-9 9"/><joint name="turn"/>',
        ),
        ('qpos="0.5 0.1"', 'qpos="0.3 0.4 0.5 0.1"'),
    )
    arm, model = tm.load_robot(text, velocity=2), mujoco.MjModel.from_xml_string(text)
    assert (arm.n, len(set(arm.joint_names))) == (4, 4)
    assert arm.group_state("home").tolist() == [0.3, 0.4, 0.5, 0.1]
    data, mine, mass = mujoco.MjData(model), arm.model.createData(), np.zeros((4, 4))
    data.qpos[:] = q = np.array([0.3, 0.4, 0.5, 0.1])
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, mass)
    assert np.allclose(pin.crba(arm.model, mine, q), mass, rtol=1e-9)
    pin.framesForwardKinematics(arm.model, mine, q)
    tool = mine.oMf[arm.frame_id("tool")].translation
    assert np.allclose(tool, data.body("tool").xpos)


def test_sites_of_nested_bodies_match_mujoco() -> None:
    """Nested bodies, below a joint beside the origin of its body."""
    mujoco = pytest.importorskip("mujoco")
    site = '<site name="{}" pos="0 0.1 0.2" euler="0 20 0"/>'
    inner = f'<body name="flange" pos="0.1 0 0" euler="0 0 30">{site.format("tip")}'
    body = f'<body name="wrist" pos="0 0.3 0">{inner}{site.format("flange")}</body>'
    text = changed(
        ('name="slide"', 'name="slide" pos="0.1 0.2 0"'),
        ('<geom type="box"', f'{body}</body><geom type="box"'),
    )
    arm, model = tm.load_robot(text, velocity=2), mujoco.MjModel.from_xml_string(text)
    data, mine = mujoco.MjData(model), arm.model.createData()
    data.qpos[:] = q = np.array([0.3, 0.2])
    mujoco.mj_forward(model, data)
    pin.framesForwardKinematics(arm.model, mine, q)
    # MuJoCo's sites may have the name of a body.
    for frame, place in (("tip", "tip"), ("flange_2", "flange")):
        found, site = mine.oMf[arm.frame_id(frame)], data.site(place)
        assert np.allclose(found.translation, site.xpos)
        assert np.allclose(found.rotation, site.xmat.reshape(3, 3))


def test_boxes_by_fromto_are_oriented_as_in_mujoco() -> None:
    """Regression: boxes were turned about the long axis, towards the other end."""
    mujoco = pytest.importorskip("mujoco")
    capsule = 'type="capsule" fromto="0 0 0.05 0 0 0.25"'
    box = 'type="box" fromto="0 0 0.05 0.1 0.2 0.25"'
    assert capsule in MJCF
    text = MJCF.replace(capsule, box)
    arm, model = tm.load_robot(text, velocity=2), mujoco.MjModel.from_xml_string(text)
    data, mine = mujoco.MjData(model), arm.model.createData()
    mujoco.mj_forward(model, data)
    placed = arm.collision_model.createData()
    start = np.zeros(arm.model.nq)
    pin.updateGeometryPlacements(arm.model, mine, arm.collision_model, placed, start)
    shapes = zip(arm.collision_model.geometryObjects, placed.oMg, strict=True)
    [turned] = [M.rotation for shape, M in shapes if shape.name.startswith("upper")]
    near = [np.abs(turned.ravel() - other).max() for other in data.geom_xmat]
    assert min(near) < 1e-9


def test_inertia_of_shapes_replaces_inertial_as_in_mujoco() -> None:
    """Bodies without shapes keep their <inertial>."""
    mujoco = pytest.importorskip("mujoco")
    tool = '<geom type="box" pos="0 0 0.1" size="0.03 0.03 0.05"/>'
    text = changed((tool, ""), ('"degree"/', '"degree" inertiafromgeom="true"/'))
    arm, model = tm.load_robot(text, velocity=2), mujoco.MjModel.from_xml_string(text)
    data, mine, mass = mujoco.MjData(model), arm.model.createData(), np.zeros((2, 2))
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, mass)
    assert np.allclose(pin.crba(arm.model, mine, np.zeros(2)), mass, rtol=1e-9)


def test_site_sizes_are_accepted() -> None:
    box = 'size="0.03 0.03 0.05"/>'
    text = changed((box, f'{box}<site size="0.01"/><site size="1 1"/>'))
    assert tm.load_robot(text, velocity=2).n == 2


def test_excluded_pairs_are_disabled() -> None:
    text = changed(
        (
            "</mujoco>",
            '<contact><exclude body1="upper" body2="tool"/></contact></mujoco>',
        )
    )
    assert ("tool", "upper") in tm.load_robot(text, velocity=2).srdf.disabled_pairs


def test_pairs_with_the_world_stay_enabled_beside_excluded_pairs() -> None:
    """Bodies in the world are its children, but may collide with it."""
    exclude = '<contact><exclude body1="base" body2="tool"/></contact></mujoco>'
    text = changed(("</mujoco>", exclude))
    pairs = tm.load_robot(text, velocity=2).srdf.disabled_pairs
    assert ("base", "upper") in pairs
    assert not any("world" in pair for pair in pairs)


def test_collision_masks_and_fixed_bodies_disable_pairs_as_in_mujoco() -> None:
    """A flange fixed to the tool, and a sensor that may not collide with the tool."""
    box = '<geom type="box" size="0.03 0.03 0.05"'
    flange = f'<body name="flange">{box} contype="3"/></body>'
    sensor = f'<body name="sensor">{box} contype="2" conaffinity="2"/></body>'
    last = '<geom type="box" pos="0 0 0.1" size="0.03 0.03 0.05"/>'
    text = changed(
        (last, last + flange), ('<body name="tool"', sensor + '<body name="tool"')
    )
    pairs = tm.load_robot(text, velocity=2).srdf.disabled_pairs
    assert ("sensor", "tool") in pairs
    assert ("flange", "upper") in pairs
    assert ("base", "tool") not in pairs


def test_keyframes_without_names_are_numbered() -> None:
    keys = '<keyframe><key qpos="0.1 0.2"/><key qpos="0.3 0.1"/></keyframe></mujoco>'
    text = changed(("</mujoco>", keys))
    states = tm.load_robot(text, velocity=2).group_states
    assert [states[name]["turn"] for name in ("key 1", "key 2")] == [0.1, 0.3]


def test_dampers_set_no_effort_limit() -> None:
    """The force of a damper does not follow from its control alone."""
    damper = '<damper joint="turn" kv="3" ctrlrange="0 1"/></actuator>'
    arm = tm.load_robot(
        changed(
            ('<motor joint="turn" class="bigger"/>', ""),
            ('<joint name="turn"/>', '<joint name="turn" actuatorfrcrange="-9 9"/>'),
            ("</actuator>", damper),
        ),
        velocity=2,
    )
    assert arm.limits.effort_upper[0] == pytest.approx(9.0)


def test_excluded_pairs_add_to_adjacent_pairs() -> None:
    """Links that overlap where they are joined, beside a pair that is excluded."""
    text = changed(
        ('pos="0 0 0.1" size="0.03 0.03 0.05"', 'pos="0 0 0" size="0.03 0.03 0.2"'),
        (
            "</mujoco>",
            '<contact><exclude body1="base" body2="tool"/></contact></mujoco>',
        ),
    )
    robot = tm.load_robot(text, velocity=2)
    assert tm.Problem(robot, START, tm.JointGoal(GOAL)).checker.pairs == ()


def test_unsupported_elements_give_a_warning() -> None:
    text = changed(('<joint name="turn"/>', '<joint name="turn" stiffness="5"/>'))
    asset = '<hfield name="ground" nrow="2" ncol="2" size="1 1 1 0.1"/>'
    ground = '<geom type="hfield" hfield="ground"/>'
    text = text.replace("<worldbody>", f"<asset>{asset}</asset><worldbody>{ground}")
    expected = "not read: hfield; stiffness"
    with pytest.warns(tm.TominpmpWarning, match=expected):
        tm.load_robot(text, velocity=2)


@pytest.mark.parametrize(
    ("pairs", "message"),
    [
        ((('<joint name="turn"/>', "<freejoint/>"),), "'upper' has a free joint"),
        (
            (('<joint name="turn"/>', "<joint type='ball'/>"),),
            "'upper' has a ball joint",
        ),
        ((('"turn" class="bigger"', '"turn" class="huge"'),), "class name 'huge'"),
        (
            (
                ('type="box" pos', 'type="mesh" mesh="m" pos'),
                ("<worldbody>", '<asset><mesh file="m.stl"/></asset><worldbody>'),
            ),
            "body tool: the mesh 'm.stl' does not exist; tried .*m.stl",
        ),
        ((('range="-90 90"', 'range="-90"'),), "'range' does not .* line 8"),
        ((('mass="2"', 'mass="two"'),), "'mass' Element 'inertial', line 16"),
        # A product that overflows is no limit.
        (
            (("<motor joint", '<general gainprm="1e308" ctrlrange="-1 1" joint'),),
            "no effort limit for turn",
        ),
        (
            (('pos="0 0 0.15"', 'pos="0 inf 0.15"'),),
            "link upper: com has .* inf",
        ),
        ((('mass="2"', 'mass="-2"'),), "mass .* must be larger .*'upper'"),
        ((('size="0.03 0.03 0.05"', 'size="0.03"'),), "size 1 must be positive"),
        (
            (('pos="0 0 0.1" c', 'pos="0 inf 0" c'),),
            "joint turn: placement .* inf",
        ),
        (
            (('0 0 0.25"', '0.4 -1e9 0"'),),
            "link upper, collision 1: placement .* -500000000.0, .*at most 1e[+]06 in",
        ),
        (
            (('name="slide"', 'name="slide" ref="1e9"'),),
            "joint slide: placement .*1e[+]06",
        ),
        ((('mass="2"', 'mass="2" quat="inf 0 0 0"'),), "link upper: inertia .* nan"),
        (
            (('armature="0.02"', 'armature="inf"'),),
            "armature is .inf, .*'turn'",
        ),
    ],
)
def test_errors_name_the_wrong_element(
    pairs: tuple[tuple[str, str], ...], message: str
) -> None:
    with pytest.raises(tm.RobotLoadError, match=message):
        tm.load_robot(changed(*pairs))


URDF_OF_ONE_BODY = """
<robot name="a"><link name="base"/><link name="l"><inertial>
  <origin xyz="0 0 0" rpy="0.3 0.2 1.1"/><mass value="1e6"/>
  <inertia ixx="1e5" ixy="0" ixz="0" iyy="2e5" iyz="0" izz="2.5e5"/>
</inertial></link><joint name="j" type="revolute"><parent link="base"/>
<child link="l"/><limit lower="-1" upper="1" effort="1e6" velocity="1"/></joint></robot>
"""


def test_heavy_bodies_with_turned_axes_are_read() -> None:
    """Regression: rounding made their inertias asymmetric, which Pinocchio refuses."""
    heavy = 'mass="1e6" quat="0.3 0.2 0.1 0.8"'
    moments = "1e5 2e5 2.5e5"
    pairs = ('mass="2"', heavy), ("0.02 0.02 0.004", moments)
    for text in (changed(*pairs), URDF_OF_ONE_BODY):
        found = np.linalg.eigvalsh(tm.load_robot(text).model.inertias[1].inertia)
        np.testing.assert_allclose(found, np.fromstring(moments, sep=" "))


def test_slightly_asymmetric_inertias_are_read_as_pinocchio_reads_them() -> None:
    """Regression: moments of turned URDF links changed in their last digit."""
    uneven = np.eye(3) + 1e-15 * np.arange(9.0).reshape(3, 3)
    expected = pin.Inertia.Zero()
    expected.inertia = uneven
    found = _inertia(LinkDescription("l", 1.0, inertia=uneven)).inertia
    np.testing.assert_array_equal(found, expected.inertia)


def test_reference_poses_of_meshes_match_mujoco(tmp_path: Path) -> None:
    """Regression: the reference pose was not read, so that the mesh was elsewhere."""
    mujoco = pytest.importorskip("mujoco")
    cube = trimesh.creation.box((0.1, 0.2, 0.3))
    cube.apply_translation((0.1, 0.0, 0.2))
    cube.export(tmp_path / "b.stl")
    reference = 'refpos="0.1 0 0.05" refquat="1 0.3 0.2 0" scale="2 1 0.5"'
    for attributes in ("", reference):
        mesh = f'<asset><mesh name="b" file="b.stl" {attributes}/></asset><worldbody>'
        text = changed(
            ("<worldbody>", mesh),
            ('type="box" pos="0 0 0.1" size="0.03 0.03 0.05"', 'type="mesh" mesh="b"'),
        )
        (tmp_path / "arm.xml").write_text(text)
        arm = tm.load_robot(tmp_path / "arm.xml", velocity=2)
        model = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml"))
        data, shapes = mujoco.MjData(model), arm.collision_model
        mujoco.mj_forward(model, data)
        expected = model.mesh_vert @ data.geom_xmat[-1].reshape(3, 3).T
        placed = shapes.createData()
        at = np.zeros(arm.model.nq)
        pin.updateGeometryPlacements(
            arm.model, arm.model.createData(), shapes, placed, at
        )
        points = shapes.geometryObjects[-1].geometry.vertices()
        place = placed.oMg[len(placed.oMg) - 1]
        found = points @ place.rotation.T + place.translation
        expected = expected + data.geom_xpos[-1]
        assert np.allclose(found.min(axis=0), expected.min(axis=0), atol=1e-6)
        assert np.allclose(found.max(axis=0), expected.max(axis=0), atol=1e-6)


def test_mujoco_warnings_are_raised_and_not_written_to_a_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """MuJoCo writes its warnings to a file in the working folder."""
    monkeypatch.chdir(tmp_path)
    text = changed(('name="turn"', 'name="turn" range="NaN 90"'))
    with pytest.warns(tm.TominpmpWarning, match="contains a 'NaN'"):
        tm.load_robot(text, velocity=2)
    assert not list(tmp_path.iterdir())


def test_bodies_generated_by_replicate_are_read() -> None:
    """Regression: files with <replicate> or <frame> were refused."""
    fingers = (
        '<replicate count="2" euler="0 0 180"><body name="finger" pos="0.05 0 0.1">'
        '<joint name="grip" type="slide" axis="1 0 0" range="0 0.04" '
        'actuatorfrcrange="-5 5"/><geom size="0.01"/></body></replicate>'
    )
    text = changed(('<geom type="box"', f'{fingers}<geom type="box"'))
    text = text.replace(' qpos="0.5 0.1"', "")
    arm = tm.load_robot(text, velocity=2)
    assert arm.n == 4
    assert arm.limits.effort_upper[-2:].tolist() == [5.0, 5.0]


def test_missing_effort_limit_is_refused() -> None:
    text = changed(('<motor joint="turn" class="bigger"/>', ""))
    with pytest.raises(tm.RobotLoadError, match="turn"):
        tm.load_robot(text, velocity=2)


def test_scenario_file_refers_to_the_mjcf_file(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(MJCF)
    arm = tm.load_robot(tmp_path / "arm.xml", velocity=2.0)
    problem = tm.Problem(arm, arm.group_state("home"), tm.JointGoal(GOAL))
    tm.save_scenario(tmp_path / "arm.toml", problem)
    assert "srdf" not in (tmp_path / "arm.toml").read_text()
    again = tm.load_scenario(tmp_path / "arm.toml").problem.robot
    assert again.group_state("home").tolist() == [0.5, 0.1]
