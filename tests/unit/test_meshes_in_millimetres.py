"""A mesh in millimetres that nobody scales is told of; one that is scaled is not."""

from __future__ import annotations

import warnings
from pathlib import Path

import pytest
import trimesh

import tominpmp as tm

URDF = """<robot name="gantry"><link name="world"/><link name="bridge"><inertial>
<mass value="800"/><inertia ixx="9" iyy="9" izz="9" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><geometry><mesh filename="box.stl"{scale}/></geometry></collision></link>
<joint name="x" type="prismatic"><parent link="world"/><child link="bridge"/>
<axis xyz="1 0 0"/><limit lower="0" upper="30" effort="20000" velocity="2"/></joint>
</robot>"""


def test_units_of_meshes(tmp_path: Path) -> None:
    trimesh.creation.box((2000, 500, 300)).export(tmp_path / "box.stl")
    path = tmp_path / "gantry.urdf"
    path.write_text(URDF.format(scale=""))
    with pytest.warns(tm.TominpmpWarning, match="bridge is .* millimetres") as told:
        tm.Problem(tm.load_robot(path), [1.0], tm.JointGoal([20.0]))
    assert [item.filename for item in told] == [__file__]
    path = tmp_path / "scaled.urdf"
    path.write_text(URDF.format(scale=' scale="0.001 0.001 0.001"'))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tm.Problem(tm.load_robot(path), [1.0], tm.JointGoal([20.0]))
