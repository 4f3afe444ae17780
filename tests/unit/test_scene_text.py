"""Planning scenes in MoveIt's text format, as RViz exports them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import tominpmp as tm

HALF = 0.5**0.5
# The box is turned about z by a quarter of a turn; objects have no poses of their own.
OLD = f"""(noname)
* a box
1
box
0.1 0.2 0.3
1 2 3
0 0 {HALF} {HALF}
0.8 0 0 1
* many
3
sphere
0.25
1 0 0
0 0 0 1
0 0 0 0
cylinder
0.1 0.4
0 1 0
0 0 0 1
0 0 0 0
mesh
4 4
0 0 0
1 0 0
0 1 0
0 0 1
0 1 2
0 1 3
0 2 3
1 2 3
0 0 5
0 0 0 1
0 0 0 0
.
"""
NEW = f"""my scene+
* desk
0 0 1
0 0 {HALF} {HALF}
2
box
1 1 0.1
2 0 0
0 0 0 1
0 0 0 0
sphere
0.1
0 0 0
0 0 0 1
0 0 0 0
1
corner
0 0 0
0 0 0 1
* floor
0 0 0
0 0 0 1
1
plane
0 0 2 1
0 0 0
0 0 0 1
0 0 0 0
0
.
"""


def scene_file(folder: Path, text: str, name: str = "desk.scene") -> Path:
    path = folder / name
    path.write_text(text)
    return path


@pytest.mark.parametrize("name", ["desk.scene", "desk.txt"])
def test_old_text_format_has_no_poses_of_objects(tmp_path: Path, name: str) -> None:
    scene = tm.load_moveit_scene(scene_file(tmp_path, OLD, name))
    assert [item.name for item in scene] == ["a box", "many.0", "many.1", "many.2"]
    box, ball, rod, mesh = scene
    assert isinstance(box, tm.Box)
    np.testing.assert_array_equal(box.size, [0.1, 0.2, 0.3])
    np.testing.assert_array_equal(box.position, [1.0, 2.0, 3.0])
    np.testing.assert_allclose(box.rotation[:, 0], [0.0, 1.0, 0.0], atol=1e-15)
    assert isinstance(ball, tm.Sphere)
    assert ball.radius == 0.25
    assert isinstance(rod, tm.Cylinder)
    assert (rod.radius, rod.length) == (0.1, 0.4)
    assert isinstance(mesh, tm.Mesh)
    assert mesh.vertices.shape == (4, 3)
    np.testing.assert_array_equal(mesh.position, [0.0, 0.0, 5.0])


def test_new_text_format_has_poses_of_objects(tmp_path: Path) -> None:
    scene = tm.load_moveit_scene(scene_file(tmp_path, NEW))
    assert [item.name for item in scene] == ["desk.0", "desk.1", "floor"]
    # The desk is 1 m up and turned by a quarter.
    np.testing.assert_allclose(scene["desk.0"].position, [0, 2, 1], atol=1e-15)
    np.testing.assert_allclose(scene["desk.1"].position, [0, 0, 1], atol=1e-15)
    # 2 z + 1 = 0: the upper side of the board is half a metre down.
    floor = scene["floor"]
    assert isinstance(floor, tm.Box)
    assert floor.position[2] + 0.5 * floor.size[2] == pytest.approx(-0.5)


def test_planes_in_messages_and_in_text_become_equal_boxes(tmp_path: Path) -> None:
    planes = "{id: floor, planes: [{coef: [0, 0, 2, 1]}], plane_poses: [{}]}"
    text = f"world: {{collision_objects: [{planes}]}}"
    scene = tm.load_moveit_scene(scene_file(tmp_path, text, "scene.yaml"))
    other = tm.load_moveit_scene(scene_file(tmp_path, NEW))
    assert scene["floor"] == other["floor"]


def test_text_scene_and_request_become_a_problem(tmp_path: Path) -> None:
    names = "[joint1, joint2, joint3]"
    request = scene_file(
        tmp_path,
        f"start_state: {{joint_state: {{name: {names}, position: [0.5, 1.7, -1.7]}}}}\n"
        "goal_constraints: [{joint_constraints: ["
        + ", ".join(f"{{joint_name: joint{i}, position: 0.4}}" for i in (1, 2, 3))
        + "]}]\n",
        "request.yaml",
    )
    path = scene_file(tmp_path, OLD.replace("1 2 3\n0 0 0.7", "9 9 3\n0 0 0.7"))
    problem = tm.load_moveit("planar3r", path, request)
    assert "a box" in [item.name for item in problem.scene]


def test_text_scene_without_objects_is_empty(tmp_path: Path) -> None:
    assert len(tm.load_moveit_scene(scene_file(tmp_path, "(noname)\n.\n"))) == 0


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "sphere",
            "torus",
            "line 11: found 'torus', expected mesh, plane, box",
        ),
        (
            "0.1 0.2 0.3",
            "0.1 wide 0.3",
            "line 5: found '0.1 wide 0.3', expected 3 numbers",
        ),
        (
            "0.1 0.2 0.3",
            "0.1 0.2 0.3_0",
            "line 5: found '0.1 0.2 0.3_0', expected 3 numbers",
        ),
        ("4 4", "4 -4", "line 22: found '-4', expected how many faces it has"),
        (".\n", "", r"found the end, expected '\*' or '\.'"),
        (".\n", "+\n", r"found '\+', expected '\*' before an object"),
        ("* a box", "*", "id: is '', expected a text"),
        ("0.25", "-1", r"primitives\[0\]: .*radius"),
        ("cylinder", "cone", "there is no shape 'cone'"),
        ("1 2 3\n", "1 nan 3\n", r"position\[1\]: is nan, expected a finite number"),
    ],
)
def test_message_about_a_wrong_text_scene_names_the_line(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    path = scene_file(tmp_path, OLD.replace(old, new, 1))
    with pytest.raises(tm.ScenarioError, match=message) as caught:
        tm.load_moveit_scene(path)
    assert caught.value.path == path
