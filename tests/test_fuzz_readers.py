"""Damaged, swapped or hostile files: a clear error, in bounded time and memory.

Every reader gets a sound file that was damaged in its bytes, in its values and in its
structure, and the files of the other readers. It either reads the file, or raises the
library's error that names the file: no other exception, and no warning of NumPy.
"""

from __future__ import annotations

import io
import json
import re
import struct
import time
import tracemalloc
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tominpmp as tm
from tominpmp.description.srdf import read_srdf
from tominpmp.description.xacro_files import Arguments
from tominpmp.robot.robot import Robot, load_robot

pytestmark = pytest.mark.filterwarnings("ignore::tominpmp.TominpmpWarning")

# Largest memory of a reader while it rejects a small file [bytes].
MEMORY = 64 * 2**20
# Largest processor time; reading a hostile file to its end would take far longer [s].
SECONDS = 20.0
# Largest length of a message.
LONGEST = 4000

# Words that replace numbers and names.
WORDS = (
    b"", b"nan", b"inf", b"-inf", b"1e999", b"-1", b"0", b"1e308", b"1e-320", b"0x10",
    b"1e9", b"-1e9", b"9" * 5000, b"1 2 3 4", b"\xd9\xa1", b"\xff\xfe", b"\x00", b"\n",
    b"../../../../etc/passwd", b"package://../../etc/passwd", b"file:///dev/zero",
    b"http://127.0.0.1/x", b"package://", b"~", b"x" * 20_000, b"&lt;", b"&a;", b"]]>",
    b"{", b"[", b"'", b'"', b"*a", b"&a", b"!!python/object:x", b"%s", b"\\", b"none",
)  # fmt: skip

URDF = """<robot name="sample">
<link name="base"><collision><geometry><box size="0.1 0.2 0.3"/></geometry></collision>
</link>
<link name="l1"><inertial><origin xyz="0.5 0 0" rpy="0 0 0.1"/><mass value="2"/>
<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.2" iyz="0" izz="0.3"/></inertial>
<collision><origin xyz="0.4 0 0"/><geometry><sphere radius="0.05"/></geometry>
</collision>
<visual><geometry><cylinder radius="0.05" length="0.2"/></geometry>
<material name="red"><color rgba="1 0 0 1"/></material></visual></link>
<joint name="j1" type="revolute"><parent link="base"/><child link="l1"/>
<origin xyz="1 0 0" rpy="0 1 0"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="2" effort="10" velocity="3"/><dynamics damping="0.1"/></joint>
<link name="l2"><inertial><mass value="1"/>
<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial>
<collision><geometry><mesh filename="part.stl" scale="1 1 1"/></geometry></collision>
</link>
<joint name="j2" type="prismatic"><parent link="l1"/><child link="l2"/>
<axis xyz="1 0 0"/><limit lower="-1" upper="1" effort="10" velocity="3"/>
</joint>
<link name="l3"/>
<joint name="j3" type="revolute"><parent link="l2"/><child link="l3"/>
<mimic joint="j1" multiplier="-1" offset="0.1"/>
<limit lower="-3" upper="3" effort="10" velocity="3"/></joint>
</robot>
"""

XACRO = """<robot name="made" xmlns:xacro="http://wiki.ros.org/xacro">
<xacro:arg name="prefix" default="a_"/><xacro:property name="mass" value="${2 * 1.5}"/>
<xacro:macro name="arm" params="name parent:=base upper:=^|1 *more">
<joint name="$(arg prefix)${name}" type="revolute"><parent link="${parent}"/>
<child link="${name}_link"/><xacro:insert_block name="more"/>
<limit lower="${-pi / 2}" upper="${upper}" effort="10" velocity="${radians(90)}"/>
</joint><link name="${name}_link"><inertial><mass value="${mass}"/>
<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.2" iyz="0" izz="0.3"/></inertial></link>
</xacro:macro>
<link name="base"/><xacro:arm name="j1"><axis xyz="0 0 1"/></xacro:arm>
<xacro:if value="${mass > 1 and '$(arg prefix)' == 'a_'}">
<xacro:arm name="j2" parent="j1_link" upper="2"><axis xyz="0 1 0"/></xacro:arm>
</xacro:if></robot>
"""

MJCF = """<mujoco model="sample"><compiler angle="degree" autolimits="true"/>
<default><joint damping="1" armature="0.1"/><default class="big">
<geom type="capsule" size="0.05 0.1"/></default></default>
<asset><mesh name="part" file="part.stl" scale="1 1 1"/></asset>
<worldbody><geom type="plane" size="1 1 0.1"/><body name="one" pos="0 0 0.1">
<joint name="j1" axis="0 0 1" range="-90 90"/><geom class="big" fromto="0 0 0 0.4 0 0"/>
<site name="eye" size="0.01"/><body name="two" pos="0.5 0 0" euler="0 30 0">
<inertial mass="1" pos="0 0 0.1" diaginertia="0.1 0.1 0.1"/>
<joint name="j2" type="slide" axis="1 0 0" range="0 1" ref="0.1"/>
<joint name="j3" axis="0 1 0" range="-90 90" frictionloss="0.1"/>
<geom type="mesh" mesh="part"/><geom type="box" size="0.1 0.1 0.1" contype="0"/>
</body></body></worldbody>
<actuator><motor joint="j1" gear="60" ctrlrange="-1 1"/>
<position joint="j2" kp="9" forcerange="-9 9"/><general joint="j3" gainprm="5"
ctrlrange="-2 2"/></actuator><contact><exclude body1="one" body2="two"/></contact>
<keyframe><key name="home" qpos="0 0.1 0.2"/></keyframe></mujoco>
"""

SRDF = """<robot name="sample"><group name="arm"><joint name="j1"/></group>
<group_state name="home" group="arm"><joint name="j1" value="0.5"/>
<joint name="j2" value="0.1"/></group_state>
<disable_collisions link1="base" link2="l1" reason="Adjacent"/></robot>
"""

TOML = """
margin = 0.02
[robot]
path = "sample.urdf"
locked_joints = {j2 = 0.1}
velocity = {j1 = 2.5}
joint_limits = "joint_limits.yaml"
[[robot.payloads]]
mass = 0.1
frame = "l3"
geometry = [{type = "sphere", name = "ball", radius = 0.01}]
[start]
q = [0.5]
v = [0.0]
[goal]
type = "any"
[[goal.goals]]
type = "position"
frame = "l1"
position = [1, 0, 0]
[[goal.goals]]
type = "region"
frame = "l3"
lower = [-1, -2, -inf]
upper = [1, 2, 3]
pose = {position = [1, 0, 0], rotation = [0, 0, 0.6, 0.8]}
[[scene.obstacles]]
type = "box"
name = "a"
size = [0.1, 0.2, 0.3]
position = [0, 9, 0]
[[scene.obstacles]]
type = "height_field"
name = "b"
heights = [[0, 0.1], [0.1, 0.2]]
size = [0.2, 0.2]
position = [0, -9, 0]
[[scene.obstacles]]
type = "oc_tree"
name = "c"
points = [[0, 0, 9], [0.1, 0, 9]]
resolution = 0.05
[[scene.obstacles]]
type = "mesh"
name = "d"
path = "part.stl"
position = [0, 0, -9]
motion = {type = "constant_velocity", velocity = [0, 0.1, 0], end = 3.0}
[[scene.obstacles]]
type = "sphere"
name = "e"
radius = 0.1
[scene.obstacles.motion]
type = "waypoints"
times = [0, 1]
positions = [[0, 0, 8], [0, 1, 8]]
rotations = [[0, 0, 0, 1], [0, 0, 0.6, 0.8]]
[motion_limits]
acceleration = [10]
effort_curves.j1 = {speed = [0.0, 1.0], effort = [10.0, 5.0]}
[options]
intervals = 50
"""

SCENE = """
robot_state:
  joint_state: {name: [joint1, joint2, joint3], position: [0, 0, 0]}
  multi_dof_joint_state:
    joint_names: [virtual_joint]
    transforms:
    - {translation: [0, 0, 0], rotation: [0, 0, 0, 1]}
fixed_frame_transforms:
- child_frame_id: desk
  transform: {translation: [0, 0, 2], rotation: [0, 0, 1, 0]}
world:
  collision_objects:
  - id: box
    primitives: [{type: box, dimensions: [0.1, 0.2, 0.3]}]
    primitive_poses: [{position: [5, 4, 0], orientation: [0, 0, 0.6, 0.8]}]
  - id: pair
    header: {frame_id: desk}
    pose: {position: {x: -4.0, y: 0.0, z: 1.0}, orientation: {x: 0, y: 0, z: 0, w: 0}}
    primitives:
    - {type: 2, dimensions: [0.25]}
    - {type: CYLINDER, dimensions: [0.4, 0.1]}
    primitive_poses:
    - {position: [0, 0, 0], orientation: [0, 0, 0, 1]}
    - {position: [0, 1, 0], orientation: [0, 0, 0, 1]}
  - id: wedge
    meshes:
    - vertices: [[0, 0, 0], {x: 0.1, y: 0, z: 0}, [0, 0.1, 0], [0, 0, 0.1]]
      triangles: [{vertex_indices: [0, 2, 1]}, [0, 1, 3], [1, 2, 3], [0, 3, 2]]
    - {resource: part.stl, dimensions: [1, 1, 2]}
    mesh_poses: [{position: [0, 9, 0]}, {position: [0, 0, 9]}]
"""

REQUEST = """
group_name: arm
max_velocity_scaling_factor: 0.5
start_state:
  joint_state: {name: [joint1, joint2, joint3], position: [0.5, 1.7, -1.7]}
goal_constraints:
- joint_constraints:
  - {joint_name: joint1, position: 2.0, tolerance_above: 0.001, tolerance_below: 0.001}
  - {joint_name: joint2, position: -1.0, tolerance_above: 0.1, tolerance_below: 0.2}
  - {joint_name: joint3, position: 0.5, weight: 1.0}
- position_constraints:
  - link_name: tip
    constraint_region:
      primitives: [{type: 1, dimensions: [0.1, 0.1, 0.1]}]
      primitive_poses: [{position: [2, 4, 0], orientation: [0, 0, 0, 1]}]
  orientation_constraints:
  - link_name: tip
    orientation: [0, 0, 0.6, 0.8]
    absolute_x_axis_tolerance: 0.1
    absolute_y_axis_tolerance: 0.1
    absolute_z_axis_tolerance: 3.2
"""

JOINT_LIMITS = """
default_velocity_scaling_factor: 0.5
joint_limits:
  j1: {has_velocity_limits: true, max_velocity: 2.0, has_jerk_limits: true, max_jerk: 9}
  j2: {max_acceleration: 3.0}
"""

MOTION_LIMITS = """
effort_scale: 0.9
effort_rate: 1000
joints:
  j1:
    acceleration: 15
    effort_curve: {speed: [0, 1, 2.5], effort: [9, 9, 4]}
  j2:
    effort_curve: {stall: 8, no_load_speed: 3}
"""


def stl() -> bytes:
    """A tetrahedron, binary."""
    points = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]], "<f4")
    faces = ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2))
    rows = (struct.pack("<3f", 0, 0, 0) + points[list(f)].tobytes() for f in faces)
    return bytes(80) + struct.pack("<I", 4) + b"".join(row + b"\0\0" for row in rows)


OBJ = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1/1 2/2 4/3\nf 2 3 -1\nf 1 4 3\n"


def samples() -> tm.Samples:
    t = np.linspace(0.0, 1.0, 6)
    q = np.stack([t, -t], axis=1)
    return tm.Samples(("j1", "j2"), t, q, np.gradient(q, t, axis=0), 0 * q, q)


def written(write: Callable[[Any, Any], None]) -> bytes:
    file = io.BytesIO()
    write(samples(), file)
    return file.getvalue()


@dataclass(frozen=True)
class Reader:
    """A reader, and a sound file for it.

    Attributes:
        name: Name of the file.
        content: The file.
        read: Function that reads the file of a path.
        errors: The errors that it may raise.
    """

    name: str
    content: bytes
    read: Callable[[Path], Any]
    errors: type[tm.TominpmpError] | tuple[type[tm.TominpmpError], ...]


def read_motion(path: Path) -> None:
    tm.load_motion(path)


@pytest.fixture(scope="module")
def planar() -> Robot:
    return load_robot("planar3r")


def make_readers(folder: Path, planar: Robot) -> dict[str, Reader]:
    """All readers; files that their samples refer to are put into the folder."""
    from tominpmp.files import ros, tables

    good = folder / "good"
    good.mkdir(exist_ok=True)
    for name, content in {
        "sample.urdf": URDF.encode(), "part.stl": stl(),
        "joint_limits.yaml": JOINT_LIMITS.encode(),
        "scene.yaml": SCENE.encode(),
        "request.yaml": REQUEST.encode(),
    }.items():  # fmt: skip
        (good / name).write_bytes(content)
        (folder / name).write_bytes(content)
    arm = load_robot(good / "sample.urdf")
    scenario, robot = tm.ScenarioError, tm.RobotLoadError
    table = [
        Reader("urdf.urdf", URDF.encode(), load_robot, robot),
        Reader("arm.xml", MJCF.encode(), load_robot, robot),
        Reader(
            "srdf.srdf",
            SRDF.encode(),
            lambda p: read_srdf(p, arm.description, Arguments()),
            robot,
        ),
        Reader("scenario.toml", TOML.encode(), tm.load_scenario, scenario),
        Reader(
            "moveit_scene.yaml",
            SCENE.encode(),
            lambda p: tm.load_moveit(planar, p, good / "request.yaml"),
            scenario,
        ),
        Reader(
            "moveit_request.yaml",
            REQUEST.encode(),
            lambda p: tm.load_moveit(planar, good / "scene.yaml", p),
            scenario,
        ),
        Reader("limits.yaml", JOINT_LIMITS.encode(), tm.load_joint_limits, scenario),
        Reader(
            "motion_limits.yaml",
            MOTION_LIMITS.encode(),
            lambda p: tm.load_motion_limits(p, arm),
            scenario,
        ),
        Reader("motion.csv", written(tables.write_csv), read_motion, scenario),
        Reader("motion.npz", written(tables.write_npz), read_motion, scenario),
        Reader("motion.json", written(ros.write_json), read_motion, scenario),
        Reader("motion.yaml", written(ros.write_yaml), read_motion, scenario),
        Reader("motion.mcap", written(ros.write_bag), read_motion, scenario),
        Reader("mesh.stl", stl(), lambda p: tm.Mesh("m", path=p), tm.SceneError),
        Reader("mesh.obj", OBJ, lambda p: tm.Mesh("m", path=p), tm.SceneError),
    ]
    if find_spec("xacrodoc") is not None:
        table.append(Reader("arm.xacro", XACRO.encode(), load_robot, robot))
    return {reader.name: reader for reader in table}


@pytest.fixture(scope="module")
def readers(
    tmp_path_factory: pytest.TempPathFactory, planar: Robot
) -> tuple[Path, dict[str, Reader]]:
    folder = tmp_path_factory.mktemp("fuzz")
    return folder, make_readers(folder, planar)


NAMES = (
    "urdf.urdf", "arm.xml", "srdf.srdf", "scenario.toml", "moveit_scene.yaml",
    "moveit_request.yaml", "limits.yaml", "motion_limits.yaml", "motion.csv",
    "motion.npz", "motion.json", "motion.yaml", "mesh.stl", "mesh.obj",
    *(("arm.xacro",) if find_spec("xacrodoc") is not None else ()),
)  # fmt: skip
# A reader of robots reads all of these formats.
ROBOTS = {"urdf.urdf", "arm.xml", "arm.xacro"}
# Formats in which most damages leave a sound file: the least share of rejections.
FORGIVING = {"motion.csv": 0.2, "mesh.stl": 0.05, "mesh.obj": 0.1, "srdf.srdf": 0.1}


def refused(reader: Reader, path: Path, content: bytes) -> bool:
    """Whether a reader rejects a file; any error other than its own is a failure."""
    path.write_bytes(content)
    try:
        reader.read(path)
    except reader.errors as error:
        message = str(error)
        assert len(message) < LONGEST
        assert message.strip()
        return True
    return False


def damages(content: bytes, rng: np.random.Generator, count: int) -> Iterator[bytes]:
    """Versions of a file that are cut, damaged, shuffled, or have odd words."""
    words = [m.span() for m in re.finditer(rb"[-+.\w]+", content)]
    # A binary file may have no words.
    words = words or [(i, i + 4) for i in range(0, len(content) - 4, 4)]
    for case in range(count):
        kind = case % 5
        if kind == 0:
            yield content[: int(rng.integers(len(content)))]
        elif kind == 1:
            spoilt = bytearray(content)
            for place in rng.integers(len(content), size=int(rng.integers(1, 4))):
                spoilt[place] = int(rng.integers(256))
            yield bytes(spoilt)
        elif kind == 2:
            a, b, c = np.sort(rng.integers(len(content) + 1, size=3)).tolist()
            yield content[:a] + content[b:c] + content[a:b] + content[c:]
        elif kind == 3:
            a, b = np.sort(rng.integers(len(content) + 1, size=2)).tolist()
            yield content[:a] + content[a:b] * int(rng.choice([0, 2, 30])) + content[b:]
        else:
            a, b = words[rng.integers(len(words))]
            yield content[:a] + WORDS[rng.integers(len(WORDS))] + content[b:]


@pytest.mark.parametrize("name", NAMES)
def test_sound_file_is_read(name: str, readers: tuple[Path, dict[str, Reader]]) -> None:
    folder, table = readers
    assert not refused(table[name], folder / name, table[name].content)


COUNT = 120


# MuJoCo says so of bodies that are 1e9 m long.
@pytest.mark.filterwarnings("ignore:Inertia matrix is too close to singular")
@pytest.mark.parametrize("name", NAMES)
def test_damaged_files_raise_errors_of_the_library(
    name: str, readers: tuple[Path, dict[str, Reader]], rng: np.random.Generator
) -> None:
    folder, table = readers
    reader = table[name]
    count = sum(
        refused(reader, folder / name, content)
        for content in damages(reader.content, rng, COUNT)
    )
    assert count > FORGIVING.get(name, 0.3) * COUNT


@pytest.mark.parametrize("name", NAMES)
def test_files_of_other_readers_are_rejected(
    name: str, readers: tuple[Path, dict[str, Reader]]
) -> None:
    folder, table = readers
    for other in table.values():
        if other.name == name:
            continue
        # Readers of robots ignore unknown joints; JSON is YAML.
        alike = {name, other.name} <= {*ROBOTS, "srdf.srdf"} or (
            (name, other.name) == ("motion.yaml", "motion.json")
        )
        assert refused(table[name], folder / name, other.content) or alike
    for content in (b"", b"\n", b"\0", b"\xff" * 100, b"null", b"[]", b"{}", b"<a/>"):
        # An empty semantic description is valid.
        harmless = name == "srdf.srdf"
        assert refused(table[name], folder / name, content) or harmless


def expanding_entities(root: str) -> bytes:
    """A billion words by XML entities that expand into each other."""
    entities = ['<!ENTITY a0 "ha">']
    entities += [f'<!ENTITY a{i} "{f"&a{i - 1};" * 10}">' for i in range(1, 10)]
    return (
        f"<!DOCTYPE {root} [{''.join(entities)}]><{root} name='&a9;'>&a9;</{root}>"
    ).encode()


def expanding_aliases() -> bytes:
    """A billion words by YAML aliases that expand into each other."""
    rows = ["a0: &a0 [ha, ha]"]
    rows += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, 10)]
    return "\n".join(rows).encode()


def npz_that_grows(true_size: bool) -> bytes:
    """An archive of a few bytes with an array of gigabytes."""
    file, count = io.BytesIO(), 2**27
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name in ("t", "q", "v", "a", "u", "joint_names"):
            head = io.BytesIO()
            np.lib.format.write_array_header_1_0(
                head, {"descr": "<f8", "fortran_order": False, "shape": (count, 1)}
            )
            with archive.open(f"{name}.npy", "w", force_zip64=True) as entry:
                entry.write(head.getvalue())
                for _ in range(300 if true_size else 1):
                    entry.write(bytes(2**20))
    return file.getvalue()


def stl_of(count: int) -> bytes:
    return bytes(80) + struct.pack("<I", count) + bytes(50)


HOSTILE: dict[str, tuple[str, bytes | Callable[[], bytes]]] = {
    "expanding entities in a URDF": ("urdf.urdf", expanding_entities("robot")),
    "expanding entities in an SRDF": ("srdf.srdf", expanding_entities("robot")),
    "external entity": (
        "urdf.urdf",
        b'<!DOCTYPE r [<!ENTITY x SYSTEM "file:///etc/passwd">]><robot name="&x;"/>',
    ),
    "deep XML": ("urdf.urdf", b"<robot>" + b"<a>" * 100_000),
    "expanding aliases in a scene": ("moveit_scene.yaml", expanding_aliases()),
    "expanding aliases in limits": ("motion_limits.yaml", expanding_aliases()),
    "deep YAML": ("limits.yaml", b"[" * 100_000),
    "deep TOML": ("scenario.toml", b"a = " + b"[" * 100_000),
    "deep JSON": ("motion.json", b"[" * 100_000),
    "long number": ("scenario.toml", b"margin = " + b"9" * 1_000_000),
    "long number in JSON": ("motion.json", b"[" + b"9" * 1_000_000 + b"]"),
    # Made only when needed: gigabytes of zeros take seconds to compress.
    "archive that grows": ("motion.npz", partial(npz_that_grows, True)),
    "archive that says it grows": ("motion.npz", partial(npz_that_grows, False)),
    "pickle": ("motion.npz", written(lambda _, f: np.savez(f, t=np.array([{}])))),
    "triangles that are not there": ("mesh.stl", stl_of(2**32 - 1)),
    "row of many columns": ("motion.csv", b"t" + b",q" * 100_000),
}


@pytest.mark.parametrize("case", HOSTILE)
def test_hostile_files_are_rejected_in_bounded_time_and_memory(
    case: str, readers: tuple[Path, dict[str, Reader]]
) -> None:
    folder, table = readers
    name, given = HOSTILE[case]
    content = given() if callable(given) else given
    path = folder / f"hostile{Path(name).suffix}"
    tracemalloc.start()
    try:
        begin = time.process_time()
        assert refused(table[name], path, content)
        seconds = time.process_time() - begin
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < MEMORY + len(content)
    # To expand the files would take longer by orders of magnitude.
    assert seconds < SECONDS


@pytest.mark.parametrize(
    "mesh",
    [
        "package://sample/../../../../../etc/passwd",
        "package://../secret.stl",
        "package:///../secret.stl",
        "/dev/zero",
        "file:///dev/zero",
        "file:///dev/stdin",
        "http://127.0.0.1/part.stl",
        "..",
        "",
        "part.stl\0.png",
        "x" * 3000,
    ],
    ids=range(11),
)
def test_mesh_paths_outside_the_package_are_rejected(
    mesh: str, readers: tuple[Path, dict[str, Reader]]
) -> None:
    """Neither robot descriptions nor scenes read devices, or leave the folder of a
    package.
    """
    folder, table = readers
    (folder.parent / "secret.stl").write_bytes(stl())
    urdf = URDF.replace("part.stl", mesh.replace("\0", "&#0;")).encode()
    assert refused(table["urdf.urdf"], folder / "reach.urdf", urdf)
    shape = json.dumps({"resource": mesh})
    scene = f"world: {{collision_objects: [{{id: a, meshes: [{shape}]}}]}}".encode()
    assert refused(table["moveit_scene.yaml"], folder / "reach.yaml", scene)
