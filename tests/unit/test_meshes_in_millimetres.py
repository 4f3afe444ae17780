"""Meshes, obstacles and payloads in millimetres give a warning, but not in metres."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
import trimesh

import tominpmp as tm

URDF = """<robot name="gantry"><link name="world"/><link name="bridge"><inertial>
<mass value="800"/><inertia ixx="9" iyy="9" izz="9" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><geometry><mesh filename="box.stl"{scale}/></geometry></collision></link>
<joint name="x" type="prismatic"><parent link="world"/><child link="bridge"/>
<axis xyz="1 0 0"/><limit lower="0" upper="30" effort="20000" velocity="2"/></joint>
</robot>"""


def test_meshes_in_millimetres_give_a_warning(tmp_path: Path) -> None:
    trimesh.creation.box((2000, 500, 300)).export(tmp_path / "box.stl")
    path = tmp_path / "gantry.urdf"
    path.write_text(URDF.format(scale=""))
    with pytest.warns(tm.TominpmpWarning, match="bridge is .* millimetres") as warned:
        tm.Problem(tm.load_robot(path), [1.0], tm.JointGoal([20.0]))
    assert [item.filename for item in warned] == [__file__]
    path = tmp_path / "scaled.urdf"
    path.write_text(URDF.format(scale=' scale="0.001 0.001 0.001"'))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tm.Problem(tm.load_robot(path), [1.0], tm.JointGoal([20.0]))


CORNERS = 400.0 * np.eye(4)[:, :3]
FACES = [[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]]


@pytest.mark.parametrize(
    "obstacle",
    [
        tm.Box("it", size=(1000.0, 1000.0, 50.0), position=(600.0, 0.0, -100.0)),
        tm.Box("it", size=(1000.0, 1000.0, 50.0)),
        tm.Box("it", size=(40.0, 40.0, 40.0), position=(600.0, 0.0, 40.0)),
        tm.Sphere("it", radius=80.0),
        tm.Cylinder("it", radius=30.0, length=500.0),
        tm.Capsule("it", radius=30.0, length=500.0, position=(0.0, 400.0, 0.0)),
        tm.Mesh("it", vertices=CORNERS, triangles=FACES),
    ],
)
def test_obstacles_in_millimetres_give_a_warning(obstacle: tm.Obstacle) -> None:
    with pytest.warns(tm.TominpmpWarning, match="'it' is .* millimetres") as warned:
        scene = tm.Scene([obstacle])
    assert [item.filename for item in warned] == [__file__]
    # The warning comes once, not for each scene that is derived from this scene.
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert scene.sorted.at(0.5).resting()["it"] is obstacle


@pytest.mark.parametrize(
    "obstacle",
    [
        tm.Box("floor", size=(1000.0, 1000.0, 1.0), position=(0.0, 0.0, -0.5)),
        tm.Box("wall", size=(20.0, 0.2, 20.0), position=(5.0, 3.0, 1.0)),
        tm.Mesh("part", vertices=CORNERS, triangles=FACES, scale=0.001),
        tm.HeightField("hill", heights=np.eye(3), size=(300.0, 300.0)),
    ],
)
def test_obstacles_in_metres_give_no_warning(obstacle: tm.Obstacle) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tm.Scene([obstacle])


def test_centre_of_mass_in_millimetres_gives_a_warning() -> None:
    with pytest.warns(tm.TominpmpWarning, match="com is 80 m .* millimetres") as warned:
        tm.Payload(1.0, "tip", com=(0.0, 0.0, 80.0))
    assert warned[0].filename == __file__
    tm.Payload(1.0, "tip", com=(0.0, 0.0, 0.08))
