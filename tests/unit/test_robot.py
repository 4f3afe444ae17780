"""Robots from files: values, frames, shapes; changed and pickled robots."""

from __future__ import annotations

import dataclasses
import math
import pickle
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
from robot_samples import (
    INERTIAL,
    chain,
    joint,
    link,
    load,
    mass_matrix,
    one_joint,
    one_shape,
    placement,
    robot,
    write,
    write_tetrahedron,
)

from tominpmp.exceptions import (
    FrameNotFound,
    ProblemError,
    RobotLoadError,
)
from tominpmp.robot.robot import Robot, load_robot

FINGER = {"panda_finger_joint1": 0.03}


# The bundled arm


def test_planar_arm_has_the_published_data() -> None:
    arm = load_robot("planar3r")
    assert arm.name == "planar3r"
    assert arm.n == 3
    assert arm.joint_names == ("joint1", "joint2", "joint3")
    limits = arm.limits
    np.testing.assert_array_equal(limits.position_lower, [0.18, -3, -3])
    np.testing.assert_array_equal(limits.position_upper, [3, 3, 3])
    np.testing.assert_array_equal(limits.effort_upper, [20, 7, 2.3])
    np.testing.assert_array_equal(limits.effort_lower, [-20, -7, -2.3])
    np.testing.assert_array_equal(arm.damping, [5, 3, 2])
    np.testing.assert_array_equal(arm.armature, [0, 0, 0])
    np.testing.assert_array_equal(arm.gravity, [0, -9.81, 0])
    bodies = list(arm.model.inertias)[1:]
    assert [body.mass for body in bodies] == [0.3, 0.2, 0.1]
    about_z = [body.inertia[2, 2] for body in bodies]
    np.testing.assert_allclose(about_z, [0.225, 0.067, 0.0083], rtol=1e-15)
    for body, length in zip(bodies, (3, 2, 1), strict=True):
        np.testing.assert_array_equal(body.lever, [length / 2, 0, 0])
    assert arm.expansion_matrix is None
    assert arm.expansion_offset is None
    assert arm.passive_joints == ()


def test_planar_arm_matches_closed_form_position_and_gravity() -> None:
    arm = load_robot("planar3r")
    q = [0.5, 1.7, -1.7]
    angles = np.cumsum(q)
    lengths = np.array([3.0, 2.0, 1.0])
    tip = [lengths @ np.cos(angles), lengths @ np.sin(angles), 0]
    np.testing.assert_allclose(placement(arm, q, "tip").translation, tip, atol=1e-14)
    # Torques that hold the arm: the moments of the weights about each joint.
    x = np.concatenate([[0], np.cumsum(lengths * np.cos(angles))])
    centres = (x[:-1] + x[1:]) / 2
    weights = 9.81 * np.array([0.3, 0.2, 0.1])
    moments = [weights[i:] @ (centres[i:] - x[i]) for i in range(3)]
    data = arm.model.createData()
    holding = pin.rnea(arm.model, data, np.array(q), np.zeros(3), np.zeros(3))
    np.testing.assert_allclose(holding, moments, rtol=1e-12)


def test_collision_shapes_of_the_planar_arm_are_thin_capsules() -> None:
    arm = load_robot("planar3r")
    shapes = list(arm.collision_model.geometryObjects)
    assert [type(shape.geometry).__name__ for shape in shapes] == ["Capsule"] * 3
    assert [shape.geometry.halfLength for shape in shapes] == [1.5, 1.0, 0.5]
    assert {shape.geometry.radius for shape in shapes} == {0.001}
    for shape, length in zip(shapes, (3, 2, 1), strict=True):
        # The axis of the capsule is its z; it lies on the x axis of the link.
        for end in (-1, 1):
            point = shape.placement.act(
                np.array([0, 0, end * shape.geometry.halfLength])
            )
            np.testing.assert_allclose(
                point, [length * (end + 1) / 2, 0, 0], atol=1e-15
            )
    assert len(arm.visual_model.geometryObjects) == 7
    colors = {tuple(g.meshColor) for g in arm.visual_model.geometryObjects}
    assert len(colors) == 4


def test_planar_arm_has_a_group_state_start() -> None:
    arm = load_robot("planar3r")
    np.testing.assert_array_equal(arm.group_state("start"), [0.5, 1.7, -1.7])
    assert arm.srdf is not None
    assert ("link1", "link3") in arm.srdf.disabled_pairs
    with pytest.raises(ProblemError, match=r"no group state 'home'.* has: start"):
        arm.group_state("home")


def test_group_state_must_name_every_joint(tmp_path: Path) -> None:
    state = '<group_state name="a"><joint name="j1" value="1"/></group_state>'
    write(tmp_path, f"<robot>{state}</robot>", "sample.srdf")
    arm = load(tmp_path, chain("", ""))
    with pytest.raises(ProblemError, match="'a' has no value for j2"):
        arm.group_state("a")


# Arms of example-robot-data


@pytest.mark.parametrize(
    ("name", "n"),
    [
        ("panda", 7),
        ("ur3", 6),
        ("ur5", 6),
        ("ur10", 6),
        ("xarm7", 7),
        ("z1", 7),
        ("kinova", 6),
    ],
)
def test_example_arms_have_the_values_of_their_files(name: str, n: int) -> None:
    locked = FINGER if name == "panda" else None
    arm = load_robot(name, limits="urdf", locked_joints=locked)
    assert arm.n == arm.model.nq == arm.model.nv == n
    root = ElementTree.parse(arm.urdf_path).getroot()
    elements = {element.get("name"): element for element in root.findall("joint")}
    for i, joint_name in enumerate(arm.joint_names):
        limit = elements[joint_name].find("limit")
        dynamics = elements[joint_name].find("dynamics")
        assert arm.limits.effort_upper[i] == float(limit.get("effort"))
        assert arm.limits.effort_lower[i] == -float(limit.get("effort"))
        assert arm.limits.velocity[i] == float(limit.get("velocity"))
        damping = "0" if dynamics is None else dynamics.get("damping", "0")
        assert arm.damping[i] == float(damping)
        if elements[joint_name].get("type") == "continuous":
            assert arm.limits.position_upper[i] == math.inf
            assert arm.limits.position_lower[i] == -math.inf
        else:
            assert arm.limits.position_upper[i] == float(limit.get("upper"))
            assert arm.limits.position_lower[i] == float(limit.get("lower"))
    np.testing.assert_array_equal(arm.gravity, [0, 0, -9.81])
    assert arm.name == name


def test_panda_fingers_follow_or_are_locked() -> None:
    free = load_robot("panda", limits="urdf")
    assert free.n == 8
    assert free.joint_names[-1] == "panda_finger_joint1"
    assert free.model.nv == 9
    q = np.append(np.zeros(7), 0.02)
    np.testing.assert_array_equal(free.expand(q)[-2:], [0.02, 0.02])
    # The friction of both fingers adds up.
    assert free.damping[-1] == 0.6

    locked = load_robot("panda", limits="urdf", locked_joints=FINGER)
    assert locked.n == locked.model.nv == 7
    assert dict(locked.locked_joints) == {
        "panda_finger_joint1": 0.03,
        "panda_finger_joint2": 0.03,
    }
    q = np.array([0.1, -0.2, 0.3, -1.5, 0.4, 1.6, -0.7])
    for finger in ("panda_leftfinger", "panda_rightfinger"):
        same = placement(free, np.append(q, 0.03), finger)
        assert placement(locked, q, finger).isApprox(same, 1e-12)
    np.testing.assert_allclose(
        mass_matrix(locked, q),
        mass_matrix(free, np.append(q, 0.03))[:7, :7],
        atol=1e-12,
    )


def test_panda_geometry_is_that_of_the_files() -> None:
    arm = load_robot("panda", limits="urdf", locked_joints=FINGER)
    names = {g.name for g in arm.collision_model.geometryObjects}
    assert {"panda_link0_0", "panda_leftfinger_0", "panda_rightfinger_0"} <= names
    assert len(names) == 17
    assert arm.srdf is not None
    assert len(arm.srdf.disabled_pairs) == 35


def test_geometry_of_locked_fingers_is_where_the_fingers_are() -> None:
    def fingers(arm: Robot, q: list[float]) -> list[pin.SE3]:
        data, shapes = arm.model.createData(), arm.collision_model.createData()
        pin.updateGeometryPlacements(
            arm.model, data, arm.collision_model, shapes, arm.expand(q)
        )
        return [
            shapes.oMg[arm.collision_model.getGeometryId(f"panda_{side}finger_0")]
            for side in ("left", "right")
        ]

    q = [0.1, -0.2, 0.3, -1.5, 0.4, 1.6, -0.7]
    locked = fingers(load_robot("panda", limits="urdf", locked_joints=FINGER), q)
    free = fingers(load_robot("panda", limits="urdf"), [*q, 0.03])
    for one, other in zip(locked, free, strict=True):
        assert one.isApprox(other, 1e-12)


# Robots as values


def test_changes_leave_the_original_robot_unchanged() -> None:
    arm = load_robot("planar3r")
    fast = arm.with_changes(velocity=4 * arm.limits.velocity, gravity=(0, 0, 0))
    np.testing.assert_array_equal(fast.limits.velocity, [400, 400, 400])
    np.testing.assert_array_equal(arm.limits.velocity, [100, 100, 100])
    np.testing.assert_array_equal(fast.model.gravity.linear, [0, 0, 0])
    np.testing.assert_array_equal(arm.model.gravity.linear, [0, -9.81, 0])
    np.testing.assert_array_equal(fast.limits.effort_upper, arm.limits.effort_upper)
    assert fast.collision_model is arm.collision_model
    same = arm.with_changes()
    np.testing.assert_array_equal(same.gravity, arm.gravity)


def test_robot_is_read_only() -> None:
    arm = load_robot("planar3r")
    for array in (arm.damping, arm.armature, arm.gravity, arm.limits.velocity):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
    with pytest.raises(TypeError):
        arm.locked_joints["joint1"] = 0.0  # type: ignore[index]
    with pytest.raises(dataclasses.FrozenInstanceError):
        arm.name = "other"  # type: ignore[misc]


def test_robot_survives_pickling() -> None:
    arm = load_robot(
        "panda", limits="urdf", locked_joints=FINGER, effort=50, gravity=(0, 1, 2)
    )
    text = pickle.dumps(arm)
    assert len(text) < 200_000
    copy = pickle.loads(text)
    assert copy.joint_names == arm.joint_names
    assert copy.model == arm.model
    assert dict(copy.locked_joints) == dict(arm.locked_joints)
    assert copy.srdf == arm.srdf
    np.testing.assert_array_equal(copy.limits.effort_upper, arm.limits.effort_upper)
    np.testing.assert_array_equal(copy.gravity, [0, 1, 2])
    with pytest.raises(ValueError, match="read-only"):
        copy.limits.velocity[0] = 1.0
    assert copy.collision_model == arm.collision_model


def test_error_on_an_unknown_frame_lists_the_frames() -> None:
    arm = load_robot("planar3r")
    assert arm.model.frames[arm.frame_id("tip")].name == "tip"
    assert set(arm.frame_names) == {
        *("base", "link1", "link2", "link3", "tip"),
        *("joint1", "joint2", "joint3", "tip_joint"),
    }
    with pytest.raises(FrameNotFound, match=r"'hand'; the robot has: .*tip"):
        arm.frame_id("hand")


def test_frame_name_of_link_and_joint_refers_to_the_link(tmp_path: Path) -> None:
    text = robot(link("base", ""), link("arm"), joint("arm", "base", "arm"))
    arm = load(tmp_path, text)
    assert arm.model.frames[arm.frame_id("arm")].type == pin.FrameType.BODY


# Files


def test_capsules_and_cylinders_are_distinguished(tmp_path: Path) -> None:
    arm = load(tmp_path, one_shape('<capsule radius="0.1" length="0.6"/>'))
    (shape,) = arm.collision_model.geometryObjects
    assert type(shape.geometry).__name__ == "Capsule"
    assert (shape.geometry.radius, shape.geometry.halfLength) == (0.1, 0.3)
    arm = load(tmp_path, one_shape('<cylinder radius="0.1" length="0.6"/>'))
    (shape,) = arm.collision_model.geometryObjects
    assert type(shape.geometry).__name__ == "Cylinder"


def test_scaled_mesh_is_read(tmp_path: Path) -> None:
    write_tetrahedron(tmp_path / "meshes" / "a.obj")
    text = one_shape('<mesh filename="meshes/a.obj" scale="2 3 4"/>')
    arm = load(tmp_path, text)
    (shape,) = arm.collision_model.geometryObjects
    shape.geometry.computeLocalAABB()
    box = shape.geometry.aabb_local
    np.testing.assert_allclose(box.max_ - box.min_, [2, 3, 4], atol=1e-6)


def test_invalid_mesh_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path, "not a mesh", "a.stl")
    with pytest.raises(RobotLoadError, match=r"geometry cannot be read.*a\.stl"):
        load(tmp_path, one_shape(f'<mesh filename="{path}"/>'))


def test_errors_of_a_mesh_name_its_link_and_file(tmp_path: Path) -> None:
    """Regression: an invalid binary glTF file was said to lack a value in line 1."""
    path = write(tmp_path, "not a mesh", "a.glb")
    with pytest.raises(RobotLoadError, match=r"link l1, .*a\.glb: the geometry"):
        load(tmp_path, one_shape(f'<mesh filename="{path}"/>'))


@pytest.mark.parametrize("number", ["nan", "1e300"])
def test_mesh_with_vertices_that_are_not_finite_is_refused(
    number: str, tmp_path: Path
) -> None:
    """Regression: a link with this mesh was loaded, and its distances were wrong."""
    corners = f"v {number} 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
    path = write(tmp_path, corners, "a.obj")
    with pytest.raises(
        RobotLoadError, match=r"a\.obj: .* vertices that are not finite"
    ):
        load(tmp_path, one_shape(f'<mesh filename="{path}"/>'))


def test_missing_package_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RobotLoadError, match="package_dirs: there is no folder"):
        load(tmp_path, one_joint(), package_dirs=[tmp_path / "none"])
    with pytest.raises(RobotLoadError, match="is 5, expected paths of folders"):
        load(tmp_path, one_joint(), package_dirs=5)
    # One folder instead of a list of folders is accepted, as many will write it.
    arm = load(tmp_path, one_joint(), package_dirs=str(tmp_path))
    assert arm.package_dirs == (tmp_path,)


def test_srdf_of_another_robot_is_refused(tmp_path: Path) -> None:
    path = write(
        tmp_path, "<robot><disable_collisions link1='x' link2='y'/></robot>", "b.srdf"
    )
    with pytest.raises(RobotLoadError, match="belongs to another robot"):
        load(tmp_path, one_joint(), srdf=path)
    assert load(tmp_path, one_joint()).srdf is None


def test_relative_path_of_a_urdf_file_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(tmp_path, one_joint())
    monkeypatch.chdir(tmp_path)
    arm = load_robot("sample.urdf")
    assert arm.name == "sample"
    assert arm.urdf_path == tmp_path / "sample.urdf"
    with pytest.raises(RobotLoadError, match=r"there is no file .*other\.urdf"):
        load_robot("other.urdf")


def test_inertia_in_a_rotated_frame_is_transformed(tmp_path: Path) -> None:
    turned = INERTIAL.replace(
        'xyz="0.5 0 0"', 'xyz="0 0 0" rpy="1.5707963267948966 0 0"'
    )
    arm = load(
        tmp_path, robot(link("base"), link("l1", turned), joint("j", "base", "l1"))
    )
    # A quarter turn about x exchanges the moments about y and z.
    np.testing.assert_allclose(mass_matrix(arm, np.zeros(1)), [[0.2]], rtol=1e-12)


def test_lower_limits_of_the_model_are_the_negative_upper_limits(
    tmp_path: Path,
) -> None:
    arm = load(tmp_path, one_joint()).with_changes(effort=7.0, velocity=2.5)
    assert arm.model.lowerEffortLimit.tolist() == [-7.0]
    assert arm.model.upperEffortLimit.tolist() == [7.0]
    assert arm.model.lowerVelocityLimit.tolist() == [-2.5]
    assert arm.model.upperVelocityLimit.tolist() == [2.5]


def test_robots_with_fixed_joints_and_capsules_are_pickled(tmp_path: Path) -> None:
    shape = '<capsule radius="0.1" length="0.4"/>'
    text = one_shape(shape).replace("</robot>", "") + (
        link("tool", "") + joint("fix", "l1", "tool", "fixed", "") + "</robot>"
    )
    arm = load(tmp_path, text)
    again = pickle.loads(pickle.dumps(arm))
    assert again == arm
    assert hash(again) == hash(arm)
    (item,) = again.collision_model.geometryObjects
    assert type(item.geometry).__name__ == "Capsule"


def test_joints_of_a_link_are_in_the_order_of_their_names(tmp_path: Path) -> None:
    parts = [link("base", "")]
    for name in ("b", "a10", "a9", "Z"):
        parts += [link(f"l{name}"), joint(name, "base", f"l{name}")]
    parts += [link("tip"), joint("c", "la9", "tip")]
    arm = load(tmp_path, robot(*parts))
    assert arm.joint_names == ("Z", "a10", "a9", "c", "b")
    expected = pin.buildModelFromXML(robot(*parts))
    assert arm.joint_names == tuple(expected.names)[1:]
    assert arm.frame_names == tuple(frame.name for frame in expected.frames)[1:]
