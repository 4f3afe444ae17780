"""Playback of motions: surfaces, bodies, the scene, the page and how it is opened."""

from __future__ import annotations

import base64
import json
import re
import sys
import urllib.request
import webbrowser
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import meshcat
import numpy as np
import pinocchio as pin
import pytest
import robot_samples
import umsgpack
from motion_samples import (
    END,
    PANDA_HOME,
    START,
    four_shapes,
    planar_motions,
    planar_problem,
    quintic,
    simple_arm,
    speed_up_and_brake,
)
from robot_samples import INERTIAL, link, write_tetrahedron
from trimesh import Trimesh
from trimesh.creation import box, icosphere
from trimesh.util import concatenate

from tominpmp.exceptions import (
    FrameNotFound,
    MissingDependency,
    OptionsError,
    ProblemError,
    ScenarioError,
    SceneError,
    TominpmpWarning,
)
from tominpmp.goals.frames import PoseGoal, PositionGoal
from tominpmp.goals.joints import JointGoal
from tominpmp.motion.trajectory import Trajectory
from tominpmp.problem.problem import Problem
from tominpmp.robot.robot import load_robot
from tominpmp.scene.obstacles import Obstacle
from tominpmp.viz.meshcat_scene import (
    Command,
    Recorder,
    draw,
    frame_times,
    node_name,
)
from tominpmp.viz.playback import build_page, play, show_page
from tominpmp.viz.shares import Shares
from tominpmp.viz.skeleton import camera_view, end_frame, skeleton
from tominpmp.viz.surfaces import (
    STEEL,
    capsule,
    cylinder,
    obstacle_surface,
    path_tube,
    robot_bodies,
    shaded,
    sphere,
)

CAMERA = "/Cameras/default/rotated"


# Surfaces


@pytest.mark.parametrize(
    ("surface", "expected"),
    [
        (sphere(0.5), 4 / 3 * np.pi * 0.5**3),
        (cylinder(0.5, 2.0), np.pi * 0.5**2 * 2.0),
        (capsule(0.5, 2.0), np.pi * 0.5**2 * 2.0 + 4 / 3 * np.pi * 0.5**3),
        (box([1.0, 2.0, 3.0]), 6.0),
        (sphere(1.0).apply_scale([0.5, 1.0, 2.0]), 4 / 3 * np.pi),
    ],
    ids=["sphere", "cylinder", "capsule", "box", "ellipsoid"],
)
def test_solids_are_closed_and_face_outwards(surface: Trimesh, expected: float) -> None:
    assert surface.volume == pytest.approx(expected, rel=0.015)
    edges = surface.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    edges = edges[(np.diff(surface.vertices[edges], axis=1) != 0).any(axis=(1, 2))]
    there = {(int(a), int(b)) for a, b in edges}
    assert all((b, a) in there for a, b in there)


def test_solids_have_their_sizes() -> None:
    np.testing.assert_allclose(np.ptp(capsule(0.5, 2.0).vertices, axis=0), [1, 1, 3])
    np.testing.assert_allclose(np.ptp(cylinder(0.5, 2.0).vertices, axis=0), [1, 1, 2])
    radii = np.linalg.norm(sphere(0.7).vertices, axis=1)
    np.testing.assert_allclose(radii, 0.7)


def test_smooth_bodies_have_smooth_normals_and_boxes_sharp_ones() -> None:
    ball = shaded(sphere(2.0))
    outwards = ball["position"] / 2.0
    assert np.abs(ball["normal"] / 127.0 - outwards).max() < 0.03
    crate = shaded(box([1, 2, 3]))
    assert len(crate["position"]) == 24
    assert set(np.abs(crate["normal"]).sum(axis=1).tolist()) == {127}
    can = shaded(cylinder(1.0, 2.0))
    heights = np.abs(can["normal"][:, 2])
    assert set(heights.tolist()) == {0, 127}


def test_shading_keeps_triangles() -> None:
    plain = box([1, 1, 1])
    soup = Trimesh(
        plain.vertices[plain.faces].reshape(-1, 3),
        np.arange(36).reshape(12, 3),
        process=False,
    )
    drawn = shaded(soup)
    corners = plain.vertices[plain.faces]
    np.testing.assert_allclose(drawn["position"][drawn["index"]], corners)
    flat = shaded(Trimesh(np.eye(3), [[0, 1, 2], [0, 1, 1]], process=False))
    assert len(flat["index"]) == 1


def test_tube_keeps_its_distance_from_the_line(rng: np.random.Generator) -> None:
    line = np.cumsum(rng.normal(size=(30, 3)), axis=0)
    found = path_tube(line, 0.001, 10.0)
    assert found is not None
    assert found.volume > 0.0
    rings = found.vertices.reshape(29, 2, -1, 3)[:, ::-1]
    ends = np.stack([line[:-1], line[1:]], axis=1)[:, :, None]
    np.testing.assert_allclose(np.linalg.norm(rings - ends, axis=3), 0.01)
    there_and_back = np.array([[0.0, 0, 0], [1, 0, 0], [0, 0, 0], [0, 0, 1]])
    found = path_tube(there_and_back, 0.1, 1.0)
    assert found is not None and np.isfinite(found.vertices).all()
    assert path_tube(np.ones((5, 3)), 0.1, 1.0) is None


def test_obstacle_without_a_shape_is_refused() -> None:
    with pytest.raises(SceneError, match="'thing': there is no collision shape"):
        obstacle_surface(Obstacle("thing"))


# Bodies


def test_bodies_of_the_planar_arm_have_joints_and_places() -> None:
    bodies = {body.name: body for body in robot_bodies(load_robot("planar3r"))}
    assert set(bodies) == {
        "base_0",
        "link1_0",
        "link1_1",
        "link2_0",
        "link2_1",
        "link3_0",
        "link3_1",
    }
    assert [bodies[f"link{i}_0"].joint for i in (1, 2, 3)] == [1, 2, 3]
    assert bodies["base_0"].joint == 0
    assert bodies["link1_0"].color == pytest.approx((0.12, 0.35, 0.68, 1.0))
    # The first link is a cylinder along x from joint to joint.
    first = bodies["link1_0"]
    points = first.surface.vertices @ first.placement[:3, :3].T + first.placement[:3, 3]
    np.testing.assert_allclose(points.min(axis=0), [0, -0.07, -0.07], atol=1e-9)
    np.testing.assert_allclose(points.max(axis=0), [3, 0.07, 0.07], atol=1e-9)


def test_collision_geometry_stands_in_for_missing_visuals(tmp_path: Path) -> None:
    inside = '<collision><geometry><sphere radius="0.2"/></geometry></collision>'
    robot = simple_arm(tmp_path, ["0 0 1"] * 2, inside=inside)
    bodies = robot_bodies(robot)
    assert [body.joint for body in bodies] == [1, 2]
    assert all(body.color == STEEL for body in bodies)
    assert np.abs(bodies[0].surface.vertices).max() == pytest.approx(0.2)


def test_links_without_visuals_show_their_collision_geometry(tmp_path: Path) -> None:
    ball = '<geometry><sphere radius="{}"/></geometry>'
    solid, shown = (
        f"<{kind}>{ball.format(radius)}</{kind}>"
        for kind, radius in (("collision", 0.2), ("visual", 0.1))
    )
    joint = robot_samples.joint
    robot = robot_samples.load(
        tmp_path,
        robot_samples.robot(
            link("base", ""),
            link("seen", INERTIAL + shown + solid),
            link("unseen", INERTIAL + solid),
            link("shell", solid),
            joint("a", "base", "seen", axis="0 0 1"),
            joint("b", "seen", "unseen", axis="0 0 1"),
            joint("c", "seen", "shell", kind="fixed"),
        ),
    )
    found = {body.joint: body for body in robot_bodies(robot)}
    assert len(found) == len(robot_bodies(robot)) == 2  # no shell about visuals
    radii = {k: np.abs(body.surface.vertices).max() for k, body in found.items()}
    assert radii == pytest.approx({1: 0.1, 2: 0.2})
    assert found[1].color != STEEL
    assert found[2].color == STEEL


def test_unreadable_visuals_cause_a_warning(tmp_path: Path) -> None:
    inside = (
        '<collision><geometry><sphere radius="0.2"/></geometry></collision>'
        '<visual><geometry><mesh filename="arm.obj"/></geometry></visual>'
    )
    mesh = write_tetrahedron(tmp_path / "arm.obj")
    robot = simple_arm(tmp_path, ["0 0 1"], inside=inside)
    mesh.write_bytes(b"nonsense")
    with pytest.warns(TominpmpWarning, match="collision geometry is shown instead"):
        (body,) = robot_bodies(robot)
    assert body.color == STEEL


def test_robot_without_geometry_is_shown_as_sticks(tmp_path: Path) -> None:
    robot = simple_arm(tmp_path, ["0 0 1", "0 1 0"])
    moving = [body for body in robot_bodies(robot) if body.joint]
    # Links are 1 m apart along x.
    longest = max(np.ptp(body.surface.vertices, axis=0)[0] for body in moving)
    assert longest == pytest.approx(1.0, abs=0.1)


def test_meshes_are_scaled_and_placed(tmp_path: Path) -> None:
    mesh = write_tetrahedron(tmp_path / "arm.obj")
    inside = (
        '<visual><origin xyz="0 0 1"/><geometry>'
        f'<mesh filename="{mesh.name}" scale="1 2 3"/></geometry></visual>'
    )
    (body,) = [b for b in robot_bodies(simple_arm(tmp_path, ["0 0 1"], inside=inside))]
    np.testing.assert_allclose(np.ptp(body.surface.vertices, axis=0), [1, 2, 3])
    np.testing.assert_allclose(body.placement[:3, 3], [0, 0, 1])
    assert body.surface.volume == pytest.approx(1.0)


def write_colored(folder: Path, stretch: float) -> str:
    """Files of a tetrahedron in red and blue, stretched along x."""
    (folder / "arm.mtl").write_text("newmtl red\nKd 1 0 0\nnewmtl blue\nKd 0 0 1\n")
    corners = [(0, 0, 0), (stretch, 0, 0), (0, 1, 0), (0, 0, 1)]
    lines = ["mtllib arm.mtl", *(f"v {x} {y} {z}" for x, y, z in corners)]
    lines += ["usemtl red", "f 1 3 2", "f 1 2 4", "usemtl blue", "f 1 4 3", "f 2 3 4"]
    (folder / "arm.obj").write_text("\n".join(lines) + "\n")
    return '<visual><geometry><mesh filename="arm.obj"/></geometry></visual>'


def test_colours_of_mesh_files_are_read(tmp_path: Path) -> None:
    inside = write_colored(tmp_path, 1.0)
    robot = simple_arm(tmp_path, ["0 0 1"], inside=inside)
    blue, red = robot_bodies(robot)
    assert blue.color == (0.0, 0.0, 1.0, 1.0) and red.color == (1.0, 0.0, 0.0, 1.0)
    assert blue.name != red.name
    assert concatenate([blue.surface, red.surface]).volume == pytest.approx(1 / 6)


def test_a_mesh_of_many_colours_has_bodies_of_a_few(tmp_path: Path) -> None:
    ball = icosphere(2)
    shares = 0.5 * (ball.triangles_center + 1.0)
    ball.visual.face_colors = (255.0 * shares).astype(np.uint8)
    ball.export(tmp_path / "ball.ply")
    inside = '<visual><geometry><mesh filename="ball.ply"/></geometry></visual>'
    bodies = robot_bodies(simple_arm(tmp_path, ["0 0 1"], inside=inside))
    assert 8 < len(bodies) <= 27
    assert len({body.name for body in bodies}) == len(bodies)
    for body in bodies:
        centers = 0.5 * (body.surface.triangles_center + 1.0)
        assert np.abs(centers - body.color[:3]).max() < 0.27
    assert sum(len(body.surface.faces) for body in bodies) == len(ball.faces)


def test_colours_are_dropped_if_their_reader_yields_another_shape(
    tmp_path: Path,
) -> None:
    inside = write_colored(tmp_path, 1.0)
    robot = simple_arm(tmp_path, ["0 0 1"], inside=inside)
    assert robot.visual_model.ngeoms == 1
    write_colored(tmp_path, 1.1)  # as if another reader saw another size
    (body,) = robot_bodies(robot)
    assert np.ptp(body.surface.vertices, axis=0)[0] == pytest.approx(1.0)


def test_colour_of_the_urdf_replaces_colours_of_the_mesh_file(tmp_path: Path) -> None:
    inside = write_colored(tmp_path, 1.0).replace(
        "</visual>", '<material name="m"><color rgba="0 1 0 0.5"/></material></visual>'
    )
    (body,) = robot_bodies(simple_arm(tmp_path, ["0 0 1"], inside=inside))
    assert body.color == pytest.approx((0.0, 1.0, 0.0, 0.5))


# Skeleton and view


def test_end_frame_is_the_frame_of_the_goal_or_the_last_frame() -> None:
    assert end_frame(planar_problem()) == "tip"
    assert end_frame(planar_problem(JointGoal(END))) == "tip"
    locked = {"panda_finger_joint1": 0.03}
    panda = load_robot("panda", limits="urdf", locked_joints=locked)
    problem = Problem(panda, PANDA_HOME, JointGoal(PANDA_HOME))
    assert end_frame(problem) == "panda_hand_tcp"


def test_skeleton_follows_the_arm() -> None:
    problem = planar_problem()
    q = np.array([START, END])
    pose = skeleton(problem.robot, q, "tip")
    chain = pose.points
    assert chain.shape == (2, 5, 3)
    np.testing.assert_allclose(
        np.linalg.norm(np.diff(chain, axis=1), axis=2), [[0, 3, 2, 1]] * 2
    )
    angles = np.cumsum(q, axis=1)
    tip = [3, 2, 1] * np.stack([np.cos(angles), np.sin(angles)])
    np.testing.assert_allclose(chain[:, -1, :2], tip.sum(axis=2).T)


@pytest.mark.parametrize(
    ("turn", "axes"),
    [
        (np.eye(3), "xy"),
        (np.diag([1.0, -1.0, -1.0]), "xy"),
        (pin.utils.rotate("x", np.pi / 2), "xz"),
        (pin.utils.rotate("x", -np.pi / 2), "xz"),
        (pin.utils.rotate("y", np.pi / 2), "yz"),
    ],
    ids=["xy", "yx", "xz", "zx", "yz"],
)
def test_planar_motions_are_viewed_along_the_normal(
    turn: np.ndarray, axes: str
) -> None:
    q = np.linspace(START, END, 9)
    points = skeleton(load_robot("planar3r"), q, "tip").points @ turn.T
    view = camera_view(points)
    assert view.planar
    np.testing.assert_allclose(np.abs(view.normal @ turn[:, 2]), 1.0)
    np.testing.assert_allclose(points @ view.normal, 0.0, atol=1e-9)
    right, up = np.eye(3)[["xyz".index(axis) for axis in axes]]
    np.testing.assert_allclose([view.right, view.up], [right, up], atol=1e-9)


def test_motions_in_a_tilted_plane_are_viewed_along_the_normal(
    rng: np.random.Generator,
) -> None:
    turn = pin.rpy.rpyToMatrix(0.3, -0.4, 1.1)
    flat = np.zeros((10, 4, 3))
    flat[..., :2] = rng.normal(size=(10, 4, 2))
    view = camera_view(flat @ turn.T)
    assert view.planar
    np.testing.assert_allclose(np.abs(view.normal @ turn[:, 2]), 1.0)
    assert view.up[2] > 0.0
    np.testing.assert_allclose(np.cross(view.right, view.up), view.normal)


def test_spatial_motions_are_viewed_from_above(rng: np.random.Generator) -> None:
    cloud = rng.normal(size=(20, 5, 3)) * [0.1, 2.0, 1.0]
    view = camera_view(cloud)
    assert not view.planar
    assert view.normal[2] > 0.0
    still = np.tile(cloud[:1], (5, 1, 1))
    assert not camera_view(still).planar


# The scene


def staged(
    problem: Problem, trajectory: Trajectory, **appearance: Any
) -> dict[tuple[str, str], Command]:
    """Commands to the viewer, by their type and path."""
    recorder = Recorder()
    viewer = meshcat.Visualizer(window=recorder)
    draw(viewer, problem, trajectory, **appearance)
    commands = recorder.commands
    found = {(command["type"], command["path"]): command for command in commands}
    properties = sum(command["type"] == "set_property" for command in commands)
    assert len([k for k in found if k[0] != "set_property"]) + properties == len(
        commands
    )
    return found


@pytest.fixture(scope="module")
def planar() -> tuple[Problem, Trajectory, dict[tuple[str, str], Command]]:
    problem, held, _ = planar_motions()
    return problem, held, staged(problem, held)


def matrix(command: Command) -> np.ndarray:
    return np.reshape(command["matrix"], (4, 4)).T


def positions(command: Command) -> np.ndarray:
    (geometry,) = command["object"]["geometries"]
    raw = geometry["data"]["attributes"]["position"]["array"].data
    return np.frombuffer(raw, dtype=np.float32).reshape(-1, 3)


def test_scene_has_robot_obstacle_goal_and_path(
    planar: tuple[Problem, Trajectory, dict[tuple[str, str], Command]],
) -> None:
    _, held, found = planar
    objects = {path for kind, path in found if kind == "set_object"}
    assert objects == {
        "/meshcat/robot/universe/base_0",
        "/meshcat/robot/joint1/link1_0",
        "/meshcat/robot/joint1/link1_1",
        "/meshcat/robot/joint2/link2_0",
        "/meshcat/robot/joint2/link2_1",
        "/meshcat/robot/joint3/link3_0",
        "/meshcat/robot/joint3/link3_1",
        "/meshcat/obstacles/O",
        "/meshcat/goal",
        "/meshcat/path of tip",
        CAMERA,
    }
    ball = positions(found["set_object", "/meshcat/obstacles/O"])
    np.testing.assert_allclose(np.linalg.norm(ball, axis=1), 0.8, rtol=1e-6)
    place = matrix(found["set_transform", "/meshcat/obstacles/O"])
    np.testing.assert_array_equal(place[:3, 3], [4, 0, 0])
    (material,) = found["set_object", "/meshcat/obstacles/O"]["object"]["materials"]
    assert material["transparent"]
    red, green, blue = material["color"].to_bytes(3, "big")
    assert red > 2 * max(green, blue)
    goal = matrix(found["set_transform", "/meshcat/goal"])
    np.testing.assert_array_equal(goal[:3, 3], [4, 1, 0])
    # The line goes from where the tip starts to where it ends.
    line = positions(found["set_object", "/meshcat/path of tip"])
    tips = skeleton(load_robot("planar3r"), held.q[[0, -1]], "tip").points[:, -1]
    for tip in tips:
        assert np.linalg.norm(line - tip, axis=1).min() < 0.03


def test_animation_moves_the_joints_in_real_time(
    planar: tuple[Problem, Trajectory, dict[tuple[str, str], Command]],
) -> None:
    problem, held, found = planar
    animation = found["set_animation", ""]
    clips = {item["path"]: item["clip"] for item in animation["animations"]}
    assert set(clips) == {f"/meshcat/robot/joint{i}" for i in (1, 2, 3)}
    for joint in (1, 2, 3):
        clip = clips[f"/meshcat/robot/joint{joint}"]
        assert clip["fps"] == 1.0
        by_name = {track["name"]: track for track in clip["tracks"]}
        keys = by_name[".quaternion"]["keys"]
        times = np.array([key["time"] for key in keys])
        assert times[0] == 0.0
        assert times[-1] == held.duration
        assert np.diff(times).max() <= 1 / 60 + 1e-12
        pose = skeleton(problem.robot, held(times).q, "tip").placements[:, joint]
        values = np.array([key["value"] for key in keys])
        turned = np.array(
            [pin.Quaternion(*row[[3, 0, 1, 2]]).matrix() for row in values]
        )
        np.testing.assert_allclose(turned, pose[:, :3, :3], atol=1e-12)
        assert np.einsum("ij,ij->i", values[1:], values[:-1]).min() > 0.0
        moved = [key["value"] for key in by_name[".position"]["keys"]]
        np.testing.assert_allclose(moved, pose[:, :3, 3], atol=1e-12)
    first = matrix(found["set_transform", "/meshcat/robot/joint3"])
    start = skeleton(problem.robot, held.q[:1], "tip").placements[0, 3]
    np.testing.assert_allclose(first, start, atol=1e-12)


def test_quaternions_do_not_jump_in_a_full_turn(tmp_path: Path) -> None:
    text = simple_arm(tmp_path, ["0 0 1"]).with_changes(
        position_lower=-20.0, position_upper=20.0
    )
    problem = Problem(text, [0.0], JointGoal([12.0]))
    motion = quintic(text, [0.0], [12.0], 4.0, 40)
    (clip,) = staged(problem, motion)["set_animation", ""]["animations"]
    keys = clip["clip"]["tracks"][1]["keys"]
    values = np.array([key["value"] for key in keys])
    assert np.einsum("ij,ij->i", values[1:], values[:-1]).min() > 0.9


def test_planar_arm_is_viewed_from_above(
    planar: tuple[Problem, Trajectory, dict[tuple[str, str], Command]],
) -> None:
    found = planar[2]
    # The camera's axes have y upwards.
    across, up, towards = found["set_property", f"{CAMERA}/<object>"]["value"]
    assert (across, towards) == (0.0, 0.0)
    assert 5.0 < up < 20.0
    # The view is centred.
    center = -matrix(found["set_transform", "/meshcat"])[:3, 3]
    assert 0.0 < center[0] < 4.8
    assert -0.8 < center[1] < 4.0
    floor = matrix(found["set_transform", "/Grid"])[2, 3]
    assert floor + center[2] < -0.8


def test_spatial_arm_is_viewed_from_the_side(tmp_path: Path) -> None:
    robot = simple_arm(tmp_path, ["0 0 1", "0 1 0", "0 1 0"])
    problem = Problem(robot, np.zeros(3), PositionGoal("l3", (1.0, 1.0, 0.5)))
    motion = quintic(robot, np.zeros(3), np.ones(3), 1.0, 5)
    found = staged(problem, motion)
    across, up, towards = found["set_property", f"{CAMERA}/<object>"]["value"]
    assert up > 0.0
    assert np.hypot(across, towards) > up


def test_all_obstacles_and_a_pose_goal_are_drawn() -> None:
    pose = pin.SE3(pin.utils.rotate("z", 0.5), np.array([1.0, 2.0, 0.0]))
    problem = planar_problem(PoseGoal("tip", pose), four_shapes())
    motion = quintic(problem.robot, START, END, 1.0, 5)
    found = staged(problem, motion)
    sizes = {
        "ball": [1.0, 1.0, 1.0],
        "crate": [1.0, 2.0, 3.0],
        "can": [0.8, 0.8, 1.0],
        "pill": [0.6, 0.6, 1.6],
    }
    for name, size in sizes.items():
        points = positions(found["set_object", f"/meshcat/obstacles/{name}"])
        np.testing.assert_allclose(np.ptp(points, axis=0), size, rtol=4e-3)
    np.testing.assert_allclose(
        matrix(found["set_transform", "/meshcat/goal"]), pose.homogeneous
    )
    for axis, letter in enumerate("xyz"):
        rod = positions(found["set_object", f"/meshcat/goal/{letter}"])
        extent = np.ptp(rod, axis=0)
        assert np.argmax(extent) == axis
        assert rod.min(axis=0)[axis] == pytest.approx(0.0, abs=1e-6)


def test_ghosts_share_their_geometry(
    planar: tuple[Problem, Trajectory, dict[tuple[str, str], Command]],
) -> None:
    problem, held, found = planar
    assert ("set_object", "/meshcat/ghosts") not in found
    ghosts = staged(problem, held, ghosts=4)["set_object", "/meshcat/ghosts"]["object"]
    assert len(ghosts["geometries"]) == 6
    assert all(material["opacity"] < 0.3 for material in ghosts["materials"])
    meshes = ghosts["object"]["children"]
    assert len(meshes) == 24
    last = np.reshape(meshes[3]["matrix"], (4, 4)).T
    bodies = {body.name: body for body in robot_bodies(problem.robot)}
    end = skeleton(problem.robot, held.q[-1:], "tip").placements[0, 1]
    np.testing.assert_allclose(last, end @ bodies["link1_0"].placement, atol=1e-12)


def test_motion_that_stands_still_has_no_path() -> None:
    problem = planar_problem(JointGoal(START))
    motion = quintic(problem.robot, START, START, 1.0, 3)
    found = staged(problem, motion)
    assert not [path for _, path in found if "path of" in path]


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("O", "O"),
        ("a/b", "a%2Fb"),
        ("50%", "50%25"),
        ("constructor", "constructor_"),
        ("__proto__", "__proto___"),
    ],
)
def test_names_of_nodes_are_escaped(name: str, expected: str) -> None:
    assert node_name(name) == expected


def test_key_frames_are_even_and_reach_the_end() -> None:
    np.testing.assert_allclose(frame_times(0.1, 60.0), np.arange(7) / 60.0)
    odd = frame_times(0.105, 60.0)
    assert len(odd) == 8
    assert odd[-1] == 0.105
    assert frame_times(1e-6, 60.0).tolist() == [0.0, 1e-6]


# The page


def page_commands(page: str) -> list[Command]:
    (found,) = re.findall(r"^const commands = (\[.*\]);$", page, re.MULTILINE)
    return [umsgpack.unpackb(base64.b64decode(text)) for text in json.loads(found)]


def test_page_contains_title_caption_and_all_objects(tmp_path: Path) -> None:
    problem, held, _ = planar_motions()
    path = play(problem, held, path=tmp_path / "motion.html", rate=0.25)
    assert path == tmp_path / "motion.html"
    page = path.read_text("utf-8")
    assert page.startswith("<!DOCTYPE html>")
    assert "<title>planar3r: T = 1.1 s</title>" in page
    assert "<p>3 joints, 1 obstacle</p>" in page
    assert "const INITIAL_RATE = 0.25;" in page
    assert "Copyright (c) 2018 Robin Deits" in page
    assert "{{" not in page.split("MeshCat")[-1]
    commands = page_commands(page)
    assert commands[-1]["type"] == "set_animation"
    paths = {command["path"] for command in commands}
    assert {"/meshcat/robot/joint3/link3_0", "/meshcat/obstacles/O"} <= paths


def test_page_needs_no_network(tmp_path: Path) -> None:
    problem, held, _ = planar_motions()
    page = play(problem, held, path=tmp_path / "motion.html").read_text("utf-8")
    head, body = page.split("<body>", 1)
    assert "default-src 'none'" in head
    outside = re.compile(r"""(?:src|href)\s*=\s*["']?(?!data:)[\w/.:]""")
    markup = re.sub(r"<script>.*?</script>", "", head + body, flags=re.DOTALL)
    assert outside.findall(re.sub(r"<!--.*?-->", "", markup, flags=re.DOTALL)) == []
    addresses = set(re.findall(r"https?://[\w./-]+", page.split("-->", 1)[1]))
    assert addresses <= {"http://www.w3.org/1999/xhtml"}


def test_page_is_the_same_every_time(tmp_path: Path) -> None:
    problem, held, _ = planar_motions()
    first = play(problem, held, path=tmp_path / "a.html").read_bytes()
    assert play(problem, held, path=tmp_path / "b.html").read_bytes() == first


def test_names_cannot_break_the_page() -> None:
    nasty = "</title></script><script>alert(1)</script>{{VIEWER}}<!-- --><!--<script>"
    shares = Shares((nasty,), np.array([0.0, 1.0]), np.zeros((2, 1)), np.zeros((2, 1)))
    page = build_page(
        [{"type": "delete", "path": nasty}],
        title=nasty,
        caption=nasty,
        rate=1.0,
        shares=shares,
    )
    assert "alert(1)</script>" not in page
    assert page.count("</script>") == 3
    assert "<!--<script" not in page  # inside a script, its end would not be found
    assert page_commands(page) == [{"type": "delete", "path": nasty}]


def test_error_without_meshcat_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    problem, held, _ = planar_motions()
    monkeypatch.setitem(sys.modules, "meshcat", None)
    with pytest.raises(MissingDependency, match=r"tominpmp\[viz\]") as caught:
        play(problem, held, path="motion.html")
    assert caught.value.extra == "viz"
    assert not Path("motion.html").exists()


def test_wrong_arguments_are_refused_and_no_file_is_written(tmp_path: Path) -> None:
    problem, held, _ = planar_motions()
    for name, value in [
        ("rate", 0.0),
        ("rate", float("nan")),
        ("fps", -1.0),
        ("ghosts", -1),
        ("ghosts", 2.5),
    ]:
        with pytest.raises(OptionsError, match=name) as caught:
            play(problem, held, path=tmp_path / "m.html", **{name: value})
        assert caught.value.option == name
    with pytest.raises(FrameNotFound, match="hand"):
        play(problem, held, path=tmp_path / "m.html", frame="hand")
    robot = simple_arm(tmp_path, ["0 0 1"] * 2)
    other = speed_up_and_brake(robot, [0.0, 0.0], [0.1, 0.2], 1.0, 4)
    with pytest.raises(ProblemError, match="this is a motion of j1, j2"):
        play(problem, other, path=tmp_path / "m.html")
    with pytest.raises(ScenarioError, match="there is no folder"):
        play(problem, held, path=tmp_path / "nowhere" / "m.html")
    assert list(tmp_path.glob("*.html")) == []
    for name in ("motion.pdf", "motion"):
        with pytest.raises(ProblemError, match=r"pages are not written as .*\.html"):
            play(problem, held, path=tmp_path / name)
        assert not (tmp_path / name).exists()


# Showing it


def visitor(seen: list[bytes]) -> Callable[..., bool]:
    """A browser that loads the page it is sent to."""

    def open_page(address: str, new: int = 0) -> bool:
        assert address.startswith("http://127.0.0.1:")
        with urllib.request.urlopen(address, timeout=20) as answer:
            assert answer.headers["Content-Type"] == "text/html; charset=utf-8"
            seen.append(answer.read())
        return True

    return open_page


def test_browser_gets_the_page_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    seen: list[bytes] = []
    monkeypatch.setattr(webbrowser, "open", visitor(seen))
    problem, held, _ = planar_motions()
    path = play(problem, held)
    assert path.parent == tmp_path
    assert seen == [path.read_bytes()]


def test_browser_is_not_opened_with_a_path_or_if_switched_off(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    seen: list[bytes] = []
    monkeypatch.setattr(webbrowser, "open", visitor(seen))
    problem, held, _ = planar_motions()
    assert play(problem, held, open_browser=False).suffix == ".html"
    play(problem, held, path=tmp_path / "page.html")
    assert seen == []


def test_missing_browser_gives_a_warning_with_the_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr(webbrowser, "open", lambda address, new=0: False)
    problem, held, _ = planar_motions()
    with pytest.warns(TominpmpWarning, match="no browser could be opened") as warned:
        path = play(problem, held)
    assert str(path) in str(warned[0].message)
    assert path.exists()


def test_show_page_gives_up_if_the_browser_never_loads_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(webbrowser, "open", lambda address, new=0: True)
    assert not show_page(b"page", patience=0.01)


def test_viewer_of_the_caller_gets_the_commands() -> None:
    sent: list[Command] = []
    deleted: list[str] = []

    class Viewer:
        window = SimpleNamespace(send=lambda message: sent.append(message.lower()))

        def __getitem__(self, path: str) -> SimpleNamespace:
            return SimpleNamespace(delete=lambda: deleted.append(path))

    problem, held, _ = planar_motions()
    viewer = Viewer()
    assert play(problem, held, viewer=viewer) is viewer
    assert deleted == ["/meshcat"]
    recorder = Recorder()
    draw(meshcat.Visualizer(window=recorder), problem, held)
    assert sent == recorder.commands
    # Meshcat's server knows these commands only.
    assert {command["type"] for command in sent} == {
        "set_animation",
        "set_object",
        "set_property",
        "set_transform",
    }
    assert all(umsgpack.packb(command) for command in sent)
