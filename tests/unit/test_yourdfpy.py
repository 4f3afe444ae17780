"""Elements of URDF files that yourdfpy drops, guesses or cannot read."""

from __future__ import annotations

import math
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import yourdfpy
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

from tominpmp.description.model import build_geometry, build_model
from tominpmp.description.tree import Mimic
from tominpmp.description.urdf import read_parsed, read_urdf
from tominpmp.description.xml_reader import MAX_TEXT
from tominpmp.exceptions import RobotLoadError, TominpmpWarning
from tominpmp.robot.robot import load_robot


def test_acceleration_and_jerk_limits_are_read(tmp_path: Path) -> None:
    limit = '<limit lower="-1" upper="2" effort="10" velocity="3" {}/>'
    more = 'acceleration="5" deceleration="4" jerk="1e16"'
    (found,) = read(tmp_path, one_joint(limit=limit.format(more))).joints
    assert (found.acceleration, found.jerk) == (4.0, math.inf)
    (found,) = read(tmp_path, one_joint(limit=limit.format('jerk="7"'))).joints
    assert (found.acceleration, found.jerk) == (math.inf, 7.0)


def test_missing_moments_of_inertia_are_zero(tmp_path: Path) -> None:
    """yourdfpy takes 1 kg m^2 for missing moments on the diagonal."""
    inside = '<inertial><mass value="2"/><inertia izz="0.3"/></inertial>'
    for text in (inside, inside.replace('<inertia izz="0.3"/>', "")):
        parts = link("base", ""), link("l1", text), joint("j1", "base", "l1")
        model = build_model(read(tmp_path, robot(*parts)), {})
        expected = np.diag([0.0, 0.0, 0.3 if "izz" in text else 0.0])
        np.testing.assert_array_equal(model.inertias[1].inertia, expected)


@pytest.mark.parametrize(
    "shape",
    [
        '<collision><geometry><capsule radius="0.1" length="0.4"/></geometry>',
        '<collision_checking><capsule name="c"/></collision_checking><collision '
        'name="c"><geometry><cylinder radius="0.1" length="0.4"/></geometry>',
    ],
)
def test_collision_capsules_are_read(tmp_path: Path, shape: str) -> None:
    """yourdfpy knows no capsules, and ends with an error."""
    box = '<collision><geometry><box size="1 1 1"/></geometry></collision>'
    parts = link("base", ""), link("l1", f"{INERTIAL}{box}{shape}</collision>")
    description = read(tmp_path, robot(*parts, joint("j1", "base", "l1")))
    found = build_geometry(
        description, build_model(description, {}), pin.GeometryType.COLLISION
    )
    kinds = [type(item.geometry).__name__ for item in found.geometryObjects]
    assert kinds == ["Box", "Capsule"]
    assert found.geometryObjects[1].geometry.radius == 0.1
    assert found.geometryObjects[1].geometry.halfLength == 0.2


def test_visual_capsules_are_read(tmp_path: Path) -> None:
    text = one_shape('<capsule radius="0.1" length="0.4"/>', "visual")
    description = read(tmp_path, text)
    found = build_geometry(
        description, build_model(description, {}), pin.GeometryType.VISUAL
    )
    (item,) = found.geometryObjects
    assert type(item.geometry).__name__ == "Capsule"
    assert (item.geometry.radius, item.geometry.halfLength) == (0.1, 0.2)


def test_material_may_be_defined_by_another_link(tmp_path: Path) -> None:
    def visual(material: str) -> str:
        return f'<visual><geometry><sphere radius="1"/></geometry>{material}</visual>'

    named = '<material name="red"/>'
    defined = '<material name="red"><color rgba="1 0 0 1"/></material>'
    parts = (
        link("base", visual(named)),
        link("l1", INERTIAL + visual(defined)),
        joint("j1", "base", "l1"),
    )
    description = read(tmp_path, robot(*parts))
    found = build_geometry(
        description, build_model(description, {}), pin.GeometryType.VISUAL
    )
    for item in found.geometryObjects:
        np.testing.assert_array_equal(item.meshColor, [1, 0, 0, 1])


@pytest.mark.parametrize(
    "remains",
    [
        "<a:b xmlns:a='x'><a:c/></a:b>",
        "<sensor:camera/>",
        '<safety_controller soft_upper_limit="none" k_velocity="x"/>',
        '<calibration rising="somewhere"/>',
        "<transmission><joint/><actuator><mechanicalReduction/></actuator>"
        "</transmission>",
        "<!-- a comment -->",
    ],
)
def test_elements_of_other_programs_are_ignored(
    tmp_path: Path, remains: str, capfd: pytest.CaptureFixture[str]
) -> None:
    text = one_joint(inside=remains).replace("</robot>", f"{remains}</robot>")
    assert len(read(tmp_path, text).joints) == 1
    assert capfd.readouterr() == ("", "")


def test_long_and_unusual_names_are_rejected_or_read(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """libxml2 gives up on attributes of 10 MB, and yourdfpy then prints."""
    long = f'"{"x" * (MAX_TEXT + 1)}"'
    for old in ('"l1"', '"revolute"', '"j1"'):
        with pytest.raises(RobotLoadError, match="longer than"):
            read(tmp_path, one_joint().replace(old, long))
    description = read(tmp_path, one_joint().replace('"l1"', '"ä &lt;&#10;&quot;"'))
    assert description.links == ("base", 'ä <\n"')
    assert [str(f.name) for f in build_model(description, {}).frames][-1] == 'ä <\n"'
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("pitch", [math.pi / 2, -math.pi / 2, 1.5708, 1.5707963, 3.0])
def test_rotations_of_origins_are_exact_within_rounding(
    tmp_path: Path, pitch: float
) -> None:
    """Conversions of angles are sensitive near right angles."""
    rng = np.random.default_rng(0)
    for roll, yaw in rng.uniform(-math.pi, math.pi, (20, 2)).tolist():
        origin = f'<origin xyz="0.1 0.2 0.3" rpy="{roll!r} {pitch!r} {yaw!r}"/>'
        text = one_joint().replace('<origin xyz="1 0 0"/>', origin)
        place = build_model(read(tmp_path, text), {}).jointPlacements[1]
        expected = pin.rpy.rpyToMatrix(roll, pitch, yaw)
        np.testing.assert_allclose(place.rotation, expected, atol=4e-15)
        np.testing.assert_array_equal(place.translation, [0.1, 0.2, 0.3])


def test_visual_meshes_are_read_only_when_needed(tmp_path: Path) -> None:
    write(tmp_path, "no mesh at all", "a.stl")
    description = read(tmp_path, one_shape('<mesh filename="a.stl"/>', "visual"))
    assert build_model(description, {}).nv == 1


def test_parsed_yourdfpy_robot_equals_the_robot_of_the_file(tmp_path: Path) -> None:
    write_tetrahedron(tmp_path / "a.obj")
    text = chain(
        '<dynamics damping="0.5" friction="0.25"/>',
        '<mimic joint="j1" multiplier="-2" offset="0.1"/>',
    ).replace(
        INERTIAL,
        f'{INERTIAL}<visual><geometry><mesh filename="a.obj" scale="1 2 3"/>'
        "</geometry></visual>",
    )
    path = write(tmp_path, text)
    parsed = yourdfpy.URDF.load(str(path), load_meshes=False)
    from_file, taken = read_urdf(path), read_parsed(parsed, path)
    assert taken == from_file
    assert taken.joints[1].mimic == Mimic("j1", -2.0, 0.1)
    parsed.robot.joints[0].limit.effort = -1.0
    with pytest.raises(RobotLoadError, match="joint j1: limit effort=-1 is negative"):
        read_parsed(parsed, path)


def test_warnings_have_the_file_of_the_caller(tmp_path: Path) -> None:
    path = write(tmp_path, one_joint(inside='<dynamic friction="3"/>'))
    with pytest.warns(TominpmpWarning, match="<dynamic> of joint j1") as caught:
        load_robot(path)
    assert caught[0].filename == __file__


def test_pickled_robot_is_loaded_without_importing_readers() -> None:
    """Processes that receive a robot from another process need neither yourdfpy nor
    trimesh.
    """
    program = (
        "import pickle, sys, tominpmp; robot = pickle.loads(sys.stdin.buffer.read()); "
        "robot.collision_model; print({'yourdfpy', 'trimesh'} & set(sys.modules))"
    )
    result = subprocess.run(
        [sys.executable, "-c", program],
        input=pickle.dumps(load_robot("planar3r")),
        capture_output=True,
        check=True,
    )
    assert result.stdout.split() == [b"set()"], result
