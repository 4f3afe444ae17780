"""Small robots for the tests of the readers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin

from tominpmp.description.tree import UrdfDescription
from tominpmp.description.urdf import read_urdf
from tominpmp.robot.robot import Robot, load_robot

LIMIT = '<limit lower="-1" upper="2" effort="10" velocity="3"/>'
INERTIAL = (
    '<inertial><origin xyz="0.5 0 0"/><mass value="2"/>'
    '<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.2" iyz="0" izz="0.3"/></inertial>'
)


def link(name: str, inside: str = INERTIAL) -> str:
    """A link, by default with inertia."""
    return f'<link name="{name}">{inside}</link>'


def joint(
    name: str,
    parent: str,
    child: str,
    kind: str = "revolute",
    limit: str = LIMIT,
    inside: str = "",
    axis: str = "0 0 1",
) -> str:
    """A joint, by default revolute about z."""
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/>'
        f'<child link="{child}"/><origin xyz="1 0 0"/><axis xyz="{axis}"/>'
        f"{limit}{inside}</joint>"
    )


def robot(*parts: str) -> str:
    """A description."""
    return f'<robot name="sample">{"".join(parts)}</robot>'


def one_joint(**changes: str) -> str:
    """A description with the joint j1 from base to l1."""
    return robot(link("base", ""), link("l1"), joint("j1", "base", "l1", **changes))


def one_shape(shape: str, tag: str = "collision") -> str:
    """A description whose link l1 has a shape."""
    inside = f"{INERTIAL}<{tag}><geometry>{shape}</geometry></{tag}>"
    return robot(link("base", ""), link("l1", inside), joint("j1", "base", "l1"))


def chain(*insides: str, **changes: str) -> str:
    """A chain of joints j1, j2, ... with something inside each, from base to l1, ..."""
    parts = [link("base", "")]
    for i, inside in enumerate(insides, 1):
        parent = "base" if i == 1 else f"l{i - 1}"
        parts += [
            link(f"l{i}"),
            joint(f"j{i}", parent, f"l{i}", inside=inside, **changes),
        ]
    return robot(*parts)


def write(folder: Path, text: str, name: str = "sample.urdf") -> Path:
    """Write a description into a folder."""
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return path


def write_tetrahedron(path: Path) -> Path:
    """Write a mesh of four triangles with edges along the axes, of length 1."""
    corners = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    faces = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
    lines = [f"v {x} {y} {z}" for x, y, z in corners]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def load(folder: Path, text: str, **options: object) -> Robot:
    """Write a description into a folder and load it."""
    return load_robot(write(folder, text), **options)  # type: ignore[arg-type]


def placement(arm: Robot, q: list[float], frame: str) -> pin.SE3:
    """Placement of a frame at joint positions."""
    data = arm.model.createData()
    pin.framesForwardKinematics(arm.model, data, arm.expand(q))
    return data.oMf[arm.frame_id(frame)]


def mass_matrix(arm: Robot, q: np.ndarray) -> np.ndarray:
    """Mass matrix of the free joints."""
    data = arm.model.createData()
    upper = np.triu(pin.crba(arm.model, data, arm.expand(q)))
    full = upper + np.triu(upper, 1).T
    return arm.reduce_tangent(arm.reduce_tangent(full).T)


def read(folder: Path, text: str) -> UrdfDescription:
    """Write a description into a folder, and read it as a URDF file."""
    return read_urdf(write(folder, text))
