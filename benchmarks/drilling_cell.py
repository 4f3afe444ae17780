"""The drilling cell of RoboTSP: a DENSO VS060 with a drill in front of a panel.

Suárez-Ruiz, Lembono, Pham: RoboTSP, a fast solution to the robotic task sequencing
problem, ICRA 2018. The cell is that of github.com/crigroup/raveutils (BSD-3-Clause,
CRI Group, 2017): kinematics, limits and sizes are taken from it, links are boxes around
its meshes. The holes are read from a copy of that repository.
"""

from __future__ import annotations

import tempfile
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np

import tominpmp as tm

PANEL = Path("data/objects/airbus_panel.kinbody.xml")
# Limits that the benchmark sets.
VELOCITY = [1.0, 0.7, 0.7, 1.0, 0.7, 1.57]
ACCELERATION = [5.0, 4.25, 4.25, 5.25, 6.0, 8.0]
HOME = np.deg2rad([0.0, -20.0, 130.0, 0.0, 70.0, 0.0])
# Distance of the drill from each hole at a stop [m].
STANDOFF = 0.01
# Margin of all collision pairs [m].
MARGIN = 0.001
# The panel's frame is at this point of the world, its x along -y, its y along -z.
CORNER = np.array([0.57, 0.25, 0.445])
INTO_PANEL = (1.0, 0.0, 0.0)
# Numbers of holes, and the shortest published durations [s]: home to home, with stops.
PUBLISHED = {25: 17.69, 50: 25.03, 100: 39.26, 150: 52.96, 200: 64.54, 245: 74.74}

# Joints: position on the preceding link, axis, position limits [deg].
JOINTS = [
    ((0.0, 0.0, 0.182), "z", -170.0, 170.0),
    ((0.0, 0.0, 0.163), "y", -120.0, 120.0),
    ((0.0, 0.0, 0.305), "y", -125.0, 155.0),
    ((-0.01, 0.0, 0.165), "z", -270.0, 270.0),
    ((0.0, 0.0, 0.135), "y", -95.0, 95.0),
    ((0.0, 0.0, 0.07), "z", -185.0, 185.0),
]
# Boxes around the links, corners in the world where all joints are at zero [m].
BOXES = [
    ((-0.204, -0.087, 0.0), (0.087, 0.087, 0.182)),
    ((-0.088, -0.094, 0.151), (0.088, 0.099, 0.411)),
    ((-0.076, -0.079, 0.279), (0.066, 0.080, 0.700)),
    ((-0.056, -0.065, 0.591), (0.052, 0.048, 0.815)),
    ((-0.066, -0.051, 0.795), (0.036, 0.052, 0.930)),
    ((-0.050, -0.040, 0.900), (0.036, 0.032, 1.013)),
    ((-0.030, -0.020, 1.000), (0.010, 0.020, 1.020)),
]
# The fork of the wrist: a cylinder about the fifth joint, its radius and half length.
FORK = 0.049, 0.0495
# The tool, on the flange: boxes (half edges, middle) and cylinders along z (radius,
# length, middle) [m]: coupling, camera, bracket, drill.
TOOL_BOXES = [
    ((0.065, 0.028, 0.005), (-0.0365, 0.0, 0.005)),
    ((0.030, 0.105, 0.0312), (-0.0735, 0.0, 0.0412)),
    ((0.030, 0.0925, 0.031), (-0.0735, -0.05, 0.031)),
    ((0.0315, 0.095, 0.0075), (0.0, 0.0665, 0.0175)),
    ((0.100, 0.020, 0.0325), (0.07185, 0.12, -0.1622)),
    ((0.050, 0.00825, 0.00825), (0.22185, 0.12, -0.17195)),
]
TOOL_CYLINDERS = [
    (0.0247, 0.0207, (0.0, 0.12, 0.01565)),
    (0.0210, 0.04265, (0.0, 0.12, 0.047325)),
    (0.0160, 0.0224, (0.0, 0.12, 0.07985)),
    (0.0050, 0.1390, (0.0, 0.12, 0.09105)),
    (0.03315, 0.200, (0.0, 0.12, -0.0947)),
    (0.0409, 0.200, (0.02245, 0.12, -0.0947)),
]
TIP = (0.0, 0.12, 0.16155)


def robot() -> tm.Robot:
    """The arm with the drill; its frame ``tip`` is at the end of the bit, z along it.

    Its torques are not limited, as in the benchmark.
    """
    where = np.cumsum([np.zeros(3), *(offset for offset, *_ in JOINTS)], axis=0)
    parts = ['<robot name="vs060_drill">']
    for number, (low, high) in enumerate(BOXES):
        low, high = np.array(low) - where[number], np.array(high) - where[number]
        shapes = [_box(0.5 * (high - low), 0.5 * (high + low))]
        if number == 4:
            radius, half = FORK
            turned = ' rpy="1.5707963267948966 0 0"'
            shape = f'<cylinder radius="{radius}" length="{2 * half}"/>'
            shapes.append(_shape(shape, (0.0, 0.0, 0.135), turned))
        if number == 6:
            shapes += [_box(half, middle) for half, middle in TOOL_BOXES]
            shapes += [_cylinder(*item) for item in TOOL_CYLINDERS]
        parts.append(_link(f"link{number}", shapes))
    for number, (offset, axis, low, high) in enumerate(JOINTS, start=1):
        parts.append(
            f'<joint name="J{number}" type="revolute"><parent link="link{number - 1}"/>'
            f'<child link="link{number}"/><origin xyz="{_text(offset)}"/>'
            f'<axis xyz="{"0 1 0" if axis == "y" else "0 0 1"}"/>'
            f'<limit lower="{np.deg2rad(low)}" upper="{np.deg2rad(high)}" '
            f'velocity="{VELOCITY[number - 1]}" effort="10000"/></joint>'
        )
    parts.append(
        '<link name="tip"/><joint name="tip_joint" type="fixed"><parent link="link6"/>'
        f'<child link="tip"/><origin xyz="{_text(TIP)}"/></joint></robot>'
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "vs060_drill.urdf"
        path.write_text("".join(parts))
        found = tm.load_robot(path)
        _ = found.collision_model, found.visual_model  # while the file is there
    return found


def limits() -> tm.MotionLimits:
    """Limits of acceleration of the benchmark."""
    return tm.MotionLimits(acceleration=ACCELERATION)


def scene() -> tm.Scene:
    """Panel, its jig, and the support of the arm."""
    boxes = {
        "base": ((-0.1825, -0.15, -0.426), (0.1175, 0.15, -0.006)),
        "panel": ((0.570001, -0.35, 0.095), (0.624001, 0.35, 0.795)),
        "left side": ((0.08, 0.366, -0.405), (1.06, 0.378, 0.4)),
        "right side": ((0.08, -0.378, -0.405), (1.06, -0.366, 0.4)),
        "left clamp": ((0.51, 0.366, 0.36), (0.63, 0.406, 0.488)),
        "right clamp": ((0.51, -0.406, 0.36), (0.63, -0.366, 0.488)),
        "left brace": ((0.225, 0.378, -0.405), (0.237, 0.598, 0.175)),
        "right brace": ((0.225, -0.598, -0.405), (0.237, -0.378, 0.175)),
        "front foot": ((0.07, -0.608, -0.42), (0.27, 0.608, -0.405)),
        "back foot": ((0.87, -0.608, -0.42), (1.07, 0.608, -0.405)),
    }
    return tm.Scene(
        [
            tm.Box(
                name,
                size=np.subtract(high, low),
                position=0.5 * np.add(low, high),
            )
            for name, (low, high) in boxes.items()
        ]
    )


def holes(folder: Path) -> np.ndarray:
    """Positions of all holes, shape (245, 3) [m], from a copy of raveutils."""
    found = []
    for body in ET.parse(folder / PANEL).getroot().findall("body"):
        if str(body.get("name")).startswith("hole"):
            text = body.findall("translation")[-1].text or ""
            x, y, z = map(float, text.split())
            found.append(CORNER + np.array([z, -x, -y]))
    return np.array(found)


def subsets(count: int) -> dict[int, list[int]]:
    """The holes of each task, drawn as in the published benchmark."""
    random = np.random.RandomState(1)
    return {
        number: random.choice(count, size=number, replace=False).tolist()
        for number in PUBLISHED
    }


def stations(places: np.ndarray) -> dict[str, tm.Goal]:
    """The drill in front of the holes, with a free spin about its axis."""
    return {
        f"hole {number}": tm.AxisGoal(
            "tip", (0, 0, 1), INTO_PANEL, place - STANDOFF * np.array(INTO_PANEL)
        )
        for number, place in enumerate(places)
    }


def _text(values: tuple[float, ...] | np.ndarray) -> str:
    return " ".join(map(str, values))


def _box(half: np.ndarray | tuple, middle: np.ndarray | tuple) -> str:
    size = _text(2.0 * np.asarray(half))
    return _shape(f'<box size="{size}"/>', middle)


def _cylinder(radius: float, length: float, middle: tuple) -> str:
    return _shape(f'<cylinder radius="{radius}" length="{length}"/>', middle)


def _shape(geometry: str, middle: np.ndarray | tuple, turned: str = "") -> str:
    place = f'<origin xyz="{_text(middle)}"{turned}/>'
    body = f"{place}<geometry>{geometry}</geometry>"
    return f"<collision>{body}</collision><visual>{body}</visual>"


def _link(name: str, shapes: list[str]) -> str:
    inertia = '<inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.02"/>'
    mass = f'<inertial><mass value="4"/>{inertia}</inertial>'
    return f'<link name="{name}">{mass}{"".join(shapes)}</link>'
