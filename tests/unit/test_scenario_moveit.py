"""Loading planning scenes and motion plan requests of MoveIt."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree.ElementTree import fromstring, tostring

import numpy as np
import pinocchio as pin
import pytest
import yaml
from scenario_samples import (
    GOAL,
    JOINTS,
    MISSING,
    REQUEST,
    SCENE,
    START,
    changed,
    write,
)

from tominpmp.exceptions import ProblemError, ScenarioError, TominpmpWarning
from tominpmp.files.moveit import load_moveit, load_moveit_scene
from tominpmp.goals.frames import AxisGoal, PoseGoal, PositionGoal, RegionGoal
from tominpmp.goals.joints import JointGoal, JointRegionGoal
from tominpmp.goals.sets import AllGoals, AnyGoal
from tominpmp.robot.robot import Robot, load_robot
from tominpmp.scene.meshes import Mesh
from tominpmp.scene.obstacles import Box, Cylinder, Sphere


def place(link: str = "tip", **changes: Any) -> dict[str, Any]:
    """Goal constraints with a position."""
    constraint = {
        "link_name": link,
        "constraint_region": {
            "primitives": [{"type": "sphere", "dimensions": [0.001]}],
            "primitive_poses": [{"position": [4.0, 1.0, 0.0]}],
        },
    }
    return {"position_constraints": [constraint | changes]}


def turn(link: str = "tip", **changes: Any) -> dict[str, Any]:
    """Goal constraints with an orientation."""
    constraint = {"link_name": link, "orientation": [0.0, 0.0, 0.6, 0.8]}
    return {"orientation_constraints": [constraint | changes]}


def within(kind: str, size: list[float], **changes: Any) -> dict[str, Any]:
    """Goal constraints with a region."""
    region = {
        "primitives": [{"type": kind, "dimensions": size}],
        "primitive_poses": [
            {"position": [4.0, 1.0, 0.0], "orientation": [0.0, 0.0, 0.6, 0.8]}
        ],
    }
    return place(constraint_region=region, **changes)


def free(goal: dict[str, Any], *widths: float) -> dict[str, Any]:
    """The goal constraints with tolerances of the orientation about x, y and z."""
    keys = [f"absolute_{axis}_axis_tolerance" for axis in "xyz"]
    one = goal["orientation_constraints"][0] | dict(zip(keys, widths, strict=True))
    return goal | {"orientation_constraints": [one]}


TURNS = turn()["orientation_constraints"]
NINE: dict[str, Any] = {"primitives": [], "primitive_poses": 9 * [{}]}
SPOTS = place(constraint_region=NINE)["position_constraints"]
FOUR: dict[str, Any] = {"primitives": [], "primitive_poses": 4 * [{}]}
# They have 2**64 combinations, which 64 bits would count as none.
MANY = 32 * place(constraint_region=FOUR)["position_constraints"]


def goal_of(robot: Robot, folder: Path, goal: dict[str, Any], **scene: Any) -> Any:
    request = changed(REQUEST, "goal_constraints", [goal])
    return load_moveit(robot, *write(folder, request=request, **scene)).goal


def test_joint_constraints_become_a_joint_goal(planar3r: Robot, tmp_path: Path) -> None:
    problem = load_moveit(planar3r, *write(tmp_path), margin=0.01)
    np.testing.assert_array_equal(problem.q_start, START)
    assert problem.goal == JointGoal(np.array(GOAL))
    assert problem.margin == 0.01
    assert problem.robot is planar3r
    assert not np.any(problem.v_start)


@pytest.mark.parametrize("argument", ["margin", "self_collision", "constraints"])
def test_wrong_argument_of_load_moveit_is_not_attributed_to_a_file(
    planar3r: Robot, tmp_path: Path, argument: str
) -> None:
    wrong: dict[str, Any] = {argument: "far"}
    with pytest.raises(ProblemError, match=f"^{argument} is 'far', expected") as error:
        load_moveit(planar3r, *write(tmp_path), **wrong)
    assert error.value.field == argument


def test_collision_objects_become_obstacles_in_the_world_frame(
    planar3r: Robot, tmp_path: Path
) -> None:
    scene = load_moveit_scene(write(tmp_path)[0])
    assert scene == load_moveit(planar3r, *write(tmp_path)).scene
    assert [item.name for item in scene] == ["box", "pair.0", "pair.1"]
    box, sphere, cylinder = scene
    assert isinstance(box, Box)
    np.testing.assert_array_equal(box.size, [0.1, 0.2, 0.3])
    np.testing.assert_array_equal(box.position, [5.0, 4.0, 0.0])
    np.testing.assert_allclose(box.rotation[0], [0.28, -0.96, 0.0], atol=1e-15)
    # The desk is 2 m up and turned about z by half a turn.
    assert isinstance(sphere, Sphere)
    assert sphere.radius == 0.25
    np.testing.assert_allclose(sphere.position, [4.0, 0.0, 3.0], atol=1e-15)
    assert isinstance(cylinder, Cylinder)
    assert (cylinder.length, cylinder.radius) == (0.4, 0.1)
    np.testing.assert_allclose(cylinder.position, [4.0, -1.0, 3.0], atol=1e-15)


def test_poses_are_transformed_to_the_base_of_the_robot(tmp_path: Path) -> None:
    """The base is at (1, 0, 0), turned about z by a quarter of a turn."""
    half = 0.5**0.5
    base = {"translation": [1.0, 0.0, 0.0], "rotation": [0.0, 0.0, half, half]}
    steps = ("robot_state", "multi_dof_joint_state", "transforms", [base])
    scene = changed(SCENE, *steps)
    found = load_moveit_scene(write(tmp_path, scene)[0])["box"]
    np.testing.assert_allclose(found.position, [4.0, -4.0, 0.0], atol=1e-12)
    robot = load_robot("planar3r", gravity=[0.0, 0.0, -9.81])
    goal = goal_of(robot, tmp_path, place(), scene=scene)
    np.testing.assert_allclose(goal.position, [1.0, -3.0, 0.0], atol=1e-12)
    link = {"frame_id": robot.description.root}
    goal = goal_of(robot, tmp_path, place(header=link), scene=scene)
    np.testing.assert_allclose(goal.position, [4.0, 1.0, 0.0], atol=1e-12)
    sideways = load_robot("planar3r", gravity=[0.0, -9.81, 0.0])
    with pytest.raises(ScenarioError, match=r"tilted.*gravity") as caught:
        goal_of(sideways, tmp_path, place(), scene=scene)
    assert caught.value.key == "robot_state.multi_dof_joint_state"


def test_base_is_the_root_link_whatever_the_order_of_links(tmp_path: Path) -> None:
    """Regression: the first link of the file was taken for the base, even if a joint
    carried it.
    """
    root = fromstring(load_robot("planar3r").urdf_path.read_text())
    root[:] = sorted(root, key=lambda item: item.get("name") != "tip")
    (tmp_path / "arm.urdf").write_bytes(tostring(root))
    robot = load_robot(tmp_path / "arm.urdf")
    assert robot.description.links[0] == "tip"
    header = ("world", "collision_objects", 0, "header")
    scene = write(tmp_path, changed(SCENE, *header, {"frame_id": "base"}))[0]
    assert load_moveit_scene(scene, robot)["box"].position.tolist() == [5.0, 4.0, 0.0]
    scene = write(tmp_path, changed(SCENE, *header, {"frame_id": "tip"}))[0]
    with pytest.raises(
        ScenarioError, match=r"no fixed frame 'tip'; there are: world, "
    ):
        load_moveit_scene(scene, robot)


def test_links_fixed_to_the_root_are_frames_of_the_scene(tmp_path: Path) -> None:
    """Regression: only the root was known as a frame, not the base of an arm on a
    table.
    """
    root = fromstring(load_robot("planar3r").urdf_path.read_text())
    root.append(fromstring('<link name="table"/>'))
    root.append(
        fromstring(
            '<joint name="mount" type="fixed"><origin xyz="0 0 2"/>'
            '<parent link="table"/><child link="base"/></joint>'
        )
    )
    (tmp_path / "arm.urdf").write_bytes(tostring(root))
    robot = load_robot(tmp_path / "arm.urdf")
    placed = {}
    for frame in ("table", "base", "/base"):
        header = ("world", "collision_objects", 0, "header")
        scene = write(tmp_path, changed(SCENE, *header, {"frame_id": frame}))[0]
        placed[frame] = load_moveit_scene(scene, robot)["box"].position.tolist()
    above = [5.0, 4.0, 2.0]
    assert placed == {"table": [5.0, 4.0, 0.0], "base": above, "/base": above}


@pytest.mark.parametrize("parent", ["base", "/base", "world", "/world", ""])
def test_parent_of_a_fixed_frame_may_have_a_leading_slash(
    parent: str, tmp_path: Path
) -> None:
    """Regression: a frame whose parent was written with a slash, as "/base", was left
    out.
    """
    robot = load_robot("planar3r")
    frame = {**SCENE["fixed_frame_transforms"][0], "header": {"frame_id": parent}}
    placed = load_moveit_scene(write(tmp_path, SCENE)[0], robot)["pair.0"]
    scene = write(tmp_path, changed(SCENE, "fixed_frame_transforms", [frame]))[0]
    assert load_moveit_scene(scene, robot)["pair.0"].position == pytest.approx(
        placed.position
    )


def test_position_and_orientation_constraints_become_frame_goals(
    planar3r: Robot, tmp_path: Path
) -> None:
    assert goal_of(planar3r, tmp_path, place()) == PositionGoal("tip", [4.0, 1.0, 0.0])
    rotation = np.array([[0.28, -0.96, 0.0], [0.96, 0.28, 0.0], [0.0, 0.0, 1.0]])
    goal = goal_of(planar3r, tmp_path, place() | turn())
    assert isinstance(goal, PoseGoal)
    np.testing.assert_allclose(goal.pose.rotation, rotation, atol=1e-15)
    np.testing.assert_allclose(goal.pose.translation, [4.0, 1.0, 0.0])
    # The target point is 1 m ahead of the frame.
    offset = {"target_point_offset": {"x": 1.0, "y": 0.0, "z": 0.0}}
    goal = goal_of(planar3r, tmp_path, place(**offset) | turn())
    np.testing.assert_allclose(goal.pose.translation, [3.72, 0.04, 0.0], atol=1e-15)
    assert isinstance(goal.pose, pin.SE3)


def test_wide_tolerances_become_region_goals(planar3r: Robot, tmp_path: Path) -> None:
    def read(goal: dict[str, Any]) -> Any:
        return goal_of(planar3r, tmp_path, goal)

    centre, rotation = [4.0, 1.0, 0.0], pin.Quaternion(0.8, 0.0, 0.0, 0.6).matrix()
    pose = pin.SE3(rotation, np.array(centre))
    ball = read(within("sphere", [0.2]))
    assert ball == PositionGoal("tip", centre, tolerance=0.2)
    box = read(within("box", [0.2, 0.4, 0.6]))
    assert box == RegionGoal("tip", [-0.1, -0.2, -0.3], [0.1, 0.2, 0.3], box.pose)
    assert box.pose.isApprox(pose)
    # A box as small as the usual accuracy of a tool becomes a point.
    assert read(within("box", [0.02, 0.02, 0.02])) == PositionGoal("tip", centre)
    can = read(within("cylinder", [0.5, 0.1]))
    assert np.hypot(*can.upper[:2]) == pytest.approx(0.1)
    assert (can.lower[2], can.upper[2]) == (-0.25, 0.25)
    # With a free yaw, only the direction of z is constrained.
    axis = read(free(turn(), 0.1, 0.2, 4.0))
    assert axis == AxisGoal("tip", [0, 0, 1], [0, 0, 1], angle_tolerance=0.1)
    askew = read(free(turn(), 0.1, 0.005, 0.3))
    np.testing.assert_array_equal(askew.angle_tolerance, [0.1, 0.0, 0.3])
    np.testing.assert_allclose(askew.pose.rotation, rotation, atol=1e-15)
    assert not np.any(np.isfinite(askew.lower))
    both = read(within("sphere", [0.2]) | turn())
    assert isinstance(both, AllGoals)
    assert [type(goal) for goal in both.goals] == [PositionGoal, RegionGoal]
    two = read(place() | turn("link1"))
    assert [goal.frame for goal in two.goals] == ["tip", "link1"]


def test_wide_joint_tolerances_become_joint_regions(
    planar3r: Robot, tmp_path: Path
) -> None:
    wide = {"joint_name": "joint2", "position": -1.0, "tolerance_above": 0.3}
    goal = goal_of(planar3r, tmp_path, {"joint_constraints": [wide]})
    assert isinstance(goal, JointRegionGoal)
    np.testing.assert_allclose(goal.q, [START[0], -0.85, START[2]])
    np.testing.assert_allclose(goal.tolerance, [0.0, 0.15, 0.0])
    # Beside a goal for a frame, the joints that are not named are free.
    goal = goal_of(planar3r, tmp_path, place() | {"joint_constraints": [wide]})
    assert goal == AllGoals(
        [
            JointRegionGoal([-0.85], [0.15], ("joint2",)),
            PositionGoal("tip", [4.0, 1.0, 0.0]),
        ]
    )


def test_several_goal_constraints_become_alternatives(
    planar3r: Robot, tmp_path: Path
) -> None:
    """Each set of constraints, and each of several regions for one link, is an
    alternative.
    """
    request = changed(
        REQUEST, "goal_constraints", [*REQUEST["goal_constraints"], {}, place()]
    )
    paths = write(tmp_path, request=request)
    goal = load_moveit(planar3r, *paths).goal
    places = PositionGoal("tip", [4.0, 1.0, 0.0])
    assert goal == AnyGoal([JointGoal(GOAL), places])
    assert load_moveit("planar3r", *paths).robot.locked_joints == {}
    twice = place()["position_constraints"][0]["constraint_region"]
    region = {key: value * 2 for key, value in twice.items()}
    region["primitive_poses"] = [twice["primitive_poses"][0], {"position": [3, 2, 0]}]
    goal = goal_of(planar3r, tmp_path, place(constraint_region=region))
    assert goal == AnyGoal([places, PositionGoal("tip", [3.0, 2.0, 0.0])])
    many = [place()] * 65
    with pytest.raises(ScenarioError, match="65 alternatives, expected 64"):
        load_moveit(
            planar3r, *write(tmp_path, None, changed(REQUEST, "goal_constraints", many))
        )


CORNERS = [[0, 0, 0], [0.3, 0, 0], [0, 0.3, 0], [0, 0, 0.3]]
FACES = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]


def meshes(*shapes: dict[str, Any]) -> dict[str, Any]:
    """A scene with one object that consists of meshes."""
    poses = [{"position": [5, 4, 0]} for _ in shapes]
    item = {"id": "part", "meshes": list(shapes), "mesh_poses": poses}
    return changed(SCENE, "world", "collision_objects", [item])


def test_meshes_are_read_from_triangles_and_from_files(
    planar3r: Robot, tmp_path: Path
) -> None:
    """Vertices and triangles in both notations of ROS, and mesh files."""
    lines = [f"v {x} {y} {z}" for x, y, z in CORNERS]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in FACES]
    (tmp_path / "pkg" / "meshes").mkdir(parents=True)
    (tmp_path / "pkg" / "meshes" / "part.obj").write_text("\n".join(lines))
    ros = {
        "vertices": [dict(zip("xyz", corner, strict=True)) for corner in CORNERS],
        "triangles": [{"vertex_indices": face} for face in FACES],
    }
    scene = meshes(
        {"vertices": CORNERS, "triangles": FACES},
        ros,
        {"resource": "package://pkg/meshes/part.obj", "dimensions": [1, 2, 3]},
        {"mesh_path": "pkg/meshes/part.obj"},
    )
    paths = write(tmp_path, scene)
    found = load_moveit(planar3r, *paths).scene
    assert [item.name for item in found] == [f"part.{i}" for i in range(4)]
    for item in found:
        assert isinstance(item, Mesh)
        np.testing.assert_array_equal(item.position, [5.0, 4.0, 0.0])
        corners = {tuple(row) for row in item.points.tolist()}
        scale = [1, 2, 3] if item.name == "part.2" else [1, 1, 1]
        assert corners == {tuple(np.multiply(row, scale)) for row in CORNERS}
    np.testing.assert_array_equal(found["part.0"].triangles, FACES)
    assert len(load_moveit_scene(paths[0])) == 4
    shape = {"vertices": CORNERS, "triangles": FACES}
    region = {"meshes": [shape], "mesh_poses": [{"position": [4.0, 1.0, 0.0]}]}
    inside = goal_of(planar3r, tmp_path, place(constraint_region=region), scene=scene)
    assert isinstance(inside, PositionGoal)
    expected = np.array([4.0, 1.0, 0.0]) + np.mean(CORNERS, axis=0)
    np.testing.assert_allclose(inside.position, expected)


@pytest.mark.parametrize(
    ("mesh", "key", "words"),
    [
        ({}, "", "neither a type"),
        ({"vertices": CORNERS}, "", "neither a type"),
        ({"vertices": CORNERS, "triangles": [[0, 1, 4]]}, "", "not among its 4"),
        ({"vertices": CORNERS, "triangles": [[0, 1, 0.5]]}, ".triangles[0]", "three"),
        ({"vertices": [[0, 0]], "triangles": FACES}, ".vertices[0]", "3 numbers"),
        ({"resource": "gone.stl"}, ".resource", "'gone.stl' does not exist; tried /"),
        ({"resource": "package://a/../../x.stl"}, ".resource", "leads out of"),
        ({"resource": "http://a/x.stl"}, ".resource", "nothing is fetched"),
        ({"resource": "scene.yaml"}, "", "cannot be read"),
    ],
)
def test_message_about_a_wrong_mesh_names_its_key(
    mesh: dict[str, Any], key: str, words: str, tmp_path: Path
) -> None:
    path = write(tmp_path, meshes(mesh))[0]
    with pytest.raises(ScenarioError, match=words) as caught:
        load_moveit_scene(path)
    assert caught.value.path == path
    assert caught.value.key == f"world.collision_objects[0].meshes[0]{key}"


def test_request_in_place_of_a_scene_is_rejected(
    planar3r: Robot, tmp_path: Path
) -> None:
    _, request = write(tmp_path)
    with pytest.raises(ScenarioError, match="is not a planning scene"):
        load_moveit(planar3r, request, request)


def test_start_velocity_and_velocity_scaling_are_read(
    planar3r: Robot, tmp_path: Path
) -> None:
    state = {**REQUEST["start_state"]["joint_state"], "velocity": [0.3, 0.2, 0.1]}
    request = changed(REQUEST, "start_state", "joint_state", state)
    request["max_velocity_scaling_factor"] = 0.5
    problem = load_moveit(planar3r, *write(tmp_path, request=request))
    np.testing.assert_array_equal(problem.v_start, [0.1, 0.2, 0.3])
    np.testing.assert_array_equal(
        problem.robot.limits.velocity, 0.5 * planar3r.limits.velocity
    )


def test_joints_without_a_goal_stay_at_the_start_or_are_locked(
    planar3r: Robot, tmp_path: Path
) -> None:
    """The joints stay where they start, or are locked if the robot is given by its
    name.
    """
    constraints = REQUEST["goal_constraints"][0]["joint_constraints"][:2]
    request = changed(REQUEST, "goal_constraints", [{"joint_constraints": constraints}])
    paths = write(tmp_path, request=request)
    goal = load_moveit(planar3r, *paths).goal
    assert goal == JointGoal([*GOAL[:2], START[2]])
    robot = load_moveit("planar3r", *paths).robot
    assert robot.joint_names == ("joint1", "joint2")
    assert robot.locked_joints == {"joint3": START[2]}
    locked = load_robot("planar3r", locked_joints={"joint3": -1.0})
    with pytest.warns(TominpmpWarning, match=r"joint3 is at -1\.7 .* locked at -1"):
        load_moveit(locked, *paths)
    elsewhere = pytest.raises(
        ScenarioError, match=r"is 0\.5, but joint 'joint3' is locked"
    )
    with pytest.warns(TominpmpWarning), elsewhere:
        load_moveit(locked, *write(tmp_path))


@pytest.mark.parametrize(
    ("scene", "key", "words"),
    [
        (("world", "collision_objects", 0, "id", MISSING), "[0].id", "is missing"),
        (
            ("world", "collision_objects", 1, SCENE["world"]["collision_objects"][0]),
            "collision_objects",
            "two obstacles are named 'box'",
        ),
        (
            ("world", "collision_objects", 0, "primitives", 0, "type", "torus"),
            "[0].primitives[0].type",
            "no shape 'torus'; beside meshes there are: box, sphere, cylinder",
        ),
        (
            ("world", "collision_objects", 0, "primitives", 0, "type", 4),
            "[0].primitives[0].type",
            "no shape 'cone'",
        ),
        (
            ("world", "collision_objects", 0, "primitives", 0, "dimensions", [1, 2]),
            "[0].primitives[0].dimensions",
            "expected x, y and z of a box",
        ),
        (
            ("world", "collision_objects", 0, "primitives", 0, "dimensions", [1, 0, 2]),
            "[0].primitives[0]",
            "positive length",
        ),
        (
            ("world", "collision_objects", 0, "primitives", []),
            "primitive_poses",
            "1 poses for 0 primitives",
        ),
        (
            ("world", "collision_objects", 0, "planes", [{"coef": [0, 0, 0, 1]}]),
            "[0].planes[0].coef",
            "expected a normal",
        ),
        (
            ("world", "collision_objects", 0, "operation", 1),
            "[0].operation",
            "that are added",
        ),
        (
            ("world", "collision_objects", 0, "primitive_poses", 0, "position", [1, 2]),
            "[0].primitive_poses[0].position",
            "3 numbers",
        ),
        (
            ("world", "collision_objects", 0, "primitive_poses", 0, "position", "x"),
            "[0].primitive_poses[0].position",
            "3 numbers",
        ),
        (
            ("world", "collision_objects", 1, "header", "frame_id", "tool"),
            "[1].header.frame_id",
            "no fixed frame 'tool'.* world, .*desk",
        ),
        (
            ("world", "octomap", {"octomap": {"data": [1, 2]}}),
            "world.octomap.octomap.data",
            "octrees",
        ),
        (
            ("robot_state", "attached_collision_objects", [{"object": {"id": "cup"}}]),
            "robot_state.attached_collision_objects",
            "attached .*: cup",
        ),
        (("world", 7), "world", "a table"),
        (
            ("robot_state", "multi_dof_joint_state", "transforms", [{}, {}]),
            "robot_state.multi_dof_joint_state.transforms",
            "holds 2 transforms",
        ),
    ],
)
def test_message_about_a_wrong_planning_scene_names_its_key(
    planar3r: Robot, scene: tuple[Any, ...], key: str, words: str, tmp_path: Path
) -> None:
    paths = write(tmp_path, changed(SCENE, *scene))
    with pytest.raises(ScenarioError, match=words) as caught:
        load_moveit(planar3r, *paths)
    assert caught.value.path == paths[0]
    assert str(paths[0]) in str(caught.value)
    assert caught.value.key is not None
    assert caught.value.key.endswith(key)


@pytest.mark.parametrize(
    ("request_", "key", "words"),
    [
        (("start_state", MISSING), "start_state.joint_state.name", "is missing"),
        (
            ("start_state", "joint_state", "name", ["joint1", "joint2", "elbow"]),
            "start_state.joint_state.name",
            "no joint 'elbow'; the robot has: joint1",
        ),
        (
            ("start_state", "joint_state", "name", ["joint1", "joint2"]),
            "start_state.joint_state.position",
            "3 numbers for 2 joints",
        ),
        (
            ("start_state", "joint_state", {"name": JOINTS[:2], "position": [1, 1]}),
            "start_state.joint_state.name",
            "has no values for the joints joint3",
        ),
        (
            ("start_state", "joint_state", "position", [-1.7, 1.7, float("nan")]),
            "start_state.joint_state.position[2]",
            "expected a (finite )?number",
        ),
        (
            ("start_state", "joint_state", "position", [-1.7, 1.7, 9.0]),
            "start_state",
            "joint 'joint1' is 9 rad, outside its position limits",
        ),
        (("goal_constraints", []), "goal_constraints", "expected a goal"),
        (("goal_constraints", MISSING), "goal_constraints", "is missing"),
        (
            ("goal_constraints", 0, "joint_constraints", 1, "joint_name", "elbow"),
            "goal_constraints[0].joint_constraints[1].joint_name",
            "no joint 'elbow'",
        ),
        (
            ("goal_constraints", 0, "joint_constraints", 1, "joint_name", "joint1"),
            "goal_constraints[0].joint_constraints[1].joint_name",
            "occurs twice",
        ),
        (
            ("goal_constraints", 0, "joint_constraints", 0, "position", 7.0),
            "goal_constraints",
            "outside its position limits",
        ),
        (
            ("goal_constraints", [place("hand")]),
            "goal_constraints[0].position_constraints[0].link_name",
            "no frame 'hand'; the robot has",
        ),
        (
            ("goal_constraints", [free(turn(), 4.0, 4.0, 4.0)]),
            "goal_constraints[0]",
            "every orientation satisfies it",
        ),
        (
            ("goal_constraints", [{"orientation_constraints": 2 * TURNS}]),
            "goal_constraints[0].orientation_constraints[1].link_name",
            "the link 'tip' occurs twice",
        ),
        (
            ("goal_constraints", [{"position_constraints": 2 * SPOTS}]),
            "goal_constraints[0]",
            "more than 64 combinations of regions",
        ),
        (
            ("goal_constraints", [{"position_constraints": MANY}]),
            "goal_constraints[0]",
            "more than 64 combinations of regions",
        ),
        (
            ("goal_constraints", [free(turn(), 0.0, -0.1, 0.0)]),
            "goal_constraints[0].orientation_constraints[0].absolute_y_axis_tolerance",
            "expected a number >= 0",
        ),
        (
            ("goal_constraints", [place(target_point_offset=[1, 0, 0])]),
            "goal_constraints[0].position_constraints[0].target_point_offset",
            "without an exact orientation",
        ),
        (
            ("goal_constraints", [place(constraint_region={"primitives": []})]),
            "goal_constraints[0].position_constraints[0].constraint_region",
            "holds 0 regions",
        ),
        (
            ("goal_constraints", [within("sphere", [-1.0])]),
            "goal_constraints[0].position_constraints[0].constraint_region"
            ".primitives[0].dimensions",
            "positive",
        ),
        (
            ("path_constraints", {"joint_constraints": [{"joint_name": "joint1"}]}),
            "path_constraints.joint_constraints",
            "path constraints are not read",
        ),
        (("path_constraints", ["upright"]), "path_constraints", "a table"),
        (
            ("start_state", "attached_collision_objects", [{"object": {"id": "cup"}}]),
            "start_state.attached_collision_objects",
            "cup",
        ),
    ],
)
def test_message_about_a_wrong_request_names_its_key(
    planar3r: Robot, request_: tuple[Any, ...], key: str, words: str, tmp_path: Path
) -> None:
    paths = write(tmp_path, request=changed(REQUEST, *request_))
    with pytest.raises(ScenarioError, match=words) as caught:
        load_moveit(planar3r, *paths)
    assert caught.value.path == paths[1]
    assert caught.value.key == key


def test_start_in_collision_names_the_pair(planar3r: Robot, tmp_path: Path) -> None:
    steps = ("world", "collision_objects", 0, "primitive_poses", 0, "position")
    paths = write(tmp_path, changed(SCENE, *steps, [1.0, 0.5, 0.0]))
    words = r"start_state: start in collision: link '\w+' and obstacle 'box' overlap"
    with pytest.raises(ScenarioError, match=words) as caught:
        load_moveit(planar3r, *paths)
    assert caught.value.path == paths[1]
    with pytest.raises(ProblemError, match="margin is -1"):
        load_moveit(planar3r, *write(tmp_path), margin=-1.0)


def test_padding_and_allowed_collision_matrix_are_warned_about(
    planar3r: Robot, tmp_path: Path
) -> None:
    scene = SCENE | {
        "link_padding": [{"link_name": "link1", "padding": 0.01}],
        "allowed_collision_matrix": {
            "entry_names": ["link1", "box"],
            "entry_values": [[True, True], [True, True]],
        },
    }
    with pytest.warns(TominpmpWarning, match=r"link_padding.*allowed_collision_mat"):
        load_moveit(planar3r, *write(tmp_path, scene))


def test_scaling_factor_outside_its_range_is_warned_about_and_ignored(
    planar3r: Robot, tmp_path: Path
) -> None:
    request = REQUEST | {"max_velocity_scaling_factor": 50}
    with pytest.warns(TominpmpWarning, match=r"max_vel.*_factor is 50, outside \(0"):
        problem = load_moveit(planar3r, *write(tmp_path, request=request))
    assert problem.robot.limits == planar3r.limits


def test_files_without_a_ros_message_are_rejected(
    planar3r: Robot, tmp_path: Path
) -> None:
    scene, request = write(tmp_path)
    with pytest.raises(ScenarioError, match="there is no file"):
        load_moveit(planar3r, tmp_path / "none.yaml", request)
    for text in ("", "[1, 2]", "word"):
        request.write_text(text)
        with pytest.raises(ScenarioError, match="expected a table"):
            load_moveit(planar3r, scene, request)


def test_block_style_yaml_is_read_like_json(planar3r: Robot, tmp_path: Path) -> None:
    """``ros2 topic echo`` prints messages in this style."""
    paths = write(tmp_path)
    paths[0].write_text(yaml.safe_dump(SCENE, default_flow_style=False) + "---\n")
    paths[1].write_text(yaml.safe_dump(REQUEST, default_flow_style=False))
    assert load_moveit(planar3r, *paths) == load_moveit(planar3r, *write(tmp_path))


def paths_to_values(message: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """The paths of keys and indices that lead to each value of a message."""
    if isinstance(message, dict):
        inner: Any = message.items()
    elif isinstance(message, list):
        inner = enumerate(message)
    else:
        return [path]
    found = [path] if path else []
    for key, value in inner:
        found += paths_to_values(value, (*path, key))
    return found


ODD = (None, "", "x", -1, 1e300, float("nan"), float("inf"), True, [], {}, [[]], [1, 2])


@pytest.mark.filterwarnings("ignore::tominpmp.TominpmpWarning")
def test_odd_values_in_messages_raise_only_scenario_error(
    planar3r: Robot, rng: np.random.Generator, tmp_path: Path
) -> None:
    refused = 0
    for case in range(200):
        message = (SCENE, REQUEST)[case % 2]
        places = paths_to_values(message)
        where = places[rng.integers(len(places))]
        damaged = changed(message, *where, ODD[rng.integers(len(ODD))])
        scene, request = (damaged, None) if case % 2 == 0 else (None, damaged)
        paths = write(tmp_path, scene, request)
        try:
            load_moveit(planar3r, *paths)
        except ScenarioError as error:
            # A misplaced obstacle may hit the arm at the start of the request.
            message = str(error)
            assert str(paths[case % 2]) in message or "start in collision" in message
            refused += 1
    assert 80 < refused < 200
