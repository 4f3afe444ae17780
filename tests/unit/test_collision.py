"""Distances of links and obstacles, and their gradients.

`test_derivatives_problem.py` tests the gradients, too.
"""

from __future__ import annotations

import pickle
from dataclasses import dataclass, replace
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest
from distance_gradients import gradients
from robot_samples import (
    INERTIAL,
    joint,
    link,
    load,
    one_joint,
    one_shape,
    robot,
    write_tetrahedron,
)
from scipy.optimize import nnls
from scipy.spatial import ConvexHull

from tominpmp.collision import narrow, shapes
from tominpmp.collision.bodies import obstacle_shape
from tominpmp.collision.checker import CollisionChecker, Contact
from tominpmp.constraints.clearance import ClearanceConstraint
from tominpmp.exceptions import ProblemError, SceneError
from tominpmp.robot.robot import Robot, load_robot
from tominpmp.scene.obstacles import Box, Capsule, Cylinder, Obstacle, Sphere
from tominpmp.scene.scene import Scene

BALL = '<sphere radius="0.1"/>'
Q = np.array([0.5, 1.7, -1.7])
# How much nearer hulls are than convex meshes, and than the meshes of a UR5 [m].
SAME_MESH = 5e-6
UR5_HULLS = 0.04


def random_rotation(rng: np.random.Generator) -> np.ndarray:
    quaternion = rng.normal(size=4)
    return pin.Quaternion(quaternion / np.linalg.norm(quaternion)).toRotationMatrix()


# Closed forms. The link of `one_shape` turns about z, one metre from the base.


def to_box(point: np.ndarray, size: np.ndarray) -> float:
    """Signed distance of a point to a box at the origin."""
    beyond = np.abs(point) - 0.5 * size
    return float(np.linalg.norm(np.maximum(beyond, 0.0)) + min(beyond.max(), 0.0))


def to_segment(point: np.ndarray, half: float) -> float:
    return float(np.linalg.norm(point - [0, 0, np.clip(point[2], -half, half)]))


def to_cylinder(point: np.ndarray, radius: float, length: float) -> float:
    across = np.hypot(point[0], point[1]) - radius
    along = abs(point[2]) - 0.5 * length
    outside = np.hypot(max(across, 0.0), max(along, 0.0))
    return float(outside + min(max(across, along), 0.0))


@pytest.mark.parametrize("kind", ["sphere", "box", "capsule", "cylinder"])
def test_distance_of_a_ball_to_each_obstacle_matches_the_closed_form(
    kind: str, tmp_path: Path, rng: np.random.Generator
) -> None:
    arm = load(tmp_path, one_shape(BALL))
    centre = np.array([1.0, 0.0, 0.0])
    size = np.array([0.6, 0.4, 0.5])
    signs = set()
    for spread in (0.2, 0.5, 2.0) * 20:
        place = {
            "position": centre + spread * rng.normal(size=3),
            "rotation": random_rotation(rng),
        }
        seen = place["rotation"].T @ (centre - place["position"])
        obstacle: Obstacle
        if kind == "sphere":
            obstacle = Sphere("o", radius=0.3, **place)
            expected = np.linalg.norm(seen) - 0.3
        elif kind == "box":
            obstacle = Box("o", size=size, **place)
            expected = to_box(seen, size)
        elif kind == "capsule":
            obstacle = Capsule("o", radius=0.2, length=0.7, **place)
            expected = to_segment(seen, 0.35) - 0.2
        else:
            obstacle = Cylinder("o", radius=0.2, length=0.7, **place)
            expected = to_cylinder(seen, 0.2, 0.7)
        checker = CollisionChecker(arm, Scene([obstacle]))
        found = checker.distances(np.array([[0.3]]))
        assert found == pytest.approx(expected - 0.1, abs=5e-6)
        signs.add(bool(found < 0.0))
    assert signs == {True, False}


def between_segments(a: np.ndarray, b: np.ndarray) -> float:
    """Distance of two segments, given by their ends, by least squares."""
    # Convex combinations of the ends: the heavy rows make their weights add up to one.
    heavy = 1e6
    matrix = np.zeros((5, 4))
    matrix[:3, :2], matrix[:3, 2:] = a.T, -b.T
    matrix[3, :2] = matrix[4, 2:] = heavy
    weights, _ = nnls(matrix, np.array([0, 0, 0, heavy, heavy]))
    return float(np.linalg.norm(matrix[:3] @ weights))


def test_distances_of_capsules_match_those_of_segments(
    planar3r: Robot, rng: np.random.Generator
) -> None:
    half = np.array([0.0, 0.0, 0.6])
    for _ in range(20):
        q = rng.uniform(planar3r.limits.position_lower, planar3r.limits.position_upper)
        angles = np.cumsum(q)
        steps = np.array([[3.0], [2.0], [1.0]]) * np.column_stack(
            [np.cos(angles), np.sin(angles), 0.0 * angles]
        )
        joints = np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])
        centre, R = rng.normal(size=3) * 3.0, random_rotation(rng)
        ends = centre + np.array([R @ half, -R @ half])
        scene = Scene(
            [Capsule("o", radius=0.2, length=1.2, position=centre, rotation=R)]
        )
        found = CollisionChecker(planar3r, scene).distances(q[None])[0]
        expected = [between_segments(joints[i : i + 2], ends) - 0.201 for i in range(3)]
        np.testing.assert_allclose(found, expected, atol=2e-6)


# Meshes


def hull_points(item: pin.GeometryObject) -> np.ndarray:
    points = np.array(item.geometry.vertices())
    return points[ConvexHull(points).vertices]


def fixed_link(arm: Robot, name: str) -> pin.GeometryObject:
    for item in arm.collision_model.geometryObjects:
        if item.name == name:
            return item
    raise LookupError(name)


def placement_of(arm: Robot, q: np.ndarray, item: pin.GeometryObject) -> pin.SE3:
    data = arm.model.createData()
    pin.forwardKinematics(arm.model, data, arm.expand(q))
    return data.oMi[item.parentJoint] * item.placement


@pytest.mark.parametrize(
    ("name", "geometry"),
    [("ur5", "forearm_link_0"), ("ur5", "wrist_1_link_0"), ("panda", "panda_link5_0")],
)
def test_penetration_depth_in_a_mesh_is_that_in_its_hull(
    name: str, geometry: str, rng: np.random.Generator
) -> None:
    """Non-convex meshes: the depth of a box is that of the Minkowski difference."""
    arm = load_robot(name)
    item = fixed_link(arm, geometry)
    points = hull_points(item)
    size = np.array([0.3, 0.2, 0.25])
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    q = np.full(arm.n, 0.02)
    place = placement_of(arm, q, item)
    for _ in range(10):
        centre = points.mean(axis=0) + 0.05 * rng.normal(size=3)
        R = random_rotation(rng)
        corners = centre + (0.5 * signs * size) @ R.T
        differences = (corners[None] - points[:, None]).reshape(-1, 3)
        expected = ConvexHull(differences).equations[:, 3].max()
        pose = place * pin.SE3(R, centre)
        box = Box("o", size=size, position=pose.translation, rotation=pose.rotation)
        checker = CollisionChecker(arm, Scene([box]), geometry="hull")
        index = list(checker.pairs).index((geometry.removesuffix("_0"), "o"))
        found = checker.distances(q[None])[0, index]
        assert found == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize(("name", "excess"), [("panda", SAME_MESH), ("ur5", UR5_HULLS)])
def test_hulls_are_no_farther_and_little_nearer_than_meshes(
    name: str, excess: float, rng: np.random.Generator
) -> None:
    """A hull contains its mesh, so that its distance is at most that of the mesh."""
    arm = load_robot(name)
    lower = np.maximum(arm.limits.position_lower, -3.0)
    upper = np.minimum(arm.limits.position_upper, 3.0)
    compared = 0
    for _ in range(5):
        q = rng.uniform(lower, upper)
        scene = Scene(
            [
                Sphere("ball", radius=0.1, position=rng.normal(size=3) * 0.5),
                Box("crate", size=(0.3, 0.2, 0.25), position=rng.normal(size=3) * 0.5),
            ]
        )
        checker = CollisionChecker(arm, scene, geometry="hull")
        found = iter(checker.distances(q[None])[0])
        items = [g for g in arm.collision_model.geometryObjects if g.parentJoint]
        for obstacle in scene:
            pose = coal.Transform3s(obstacle.rotation, obstacle.position)
            for item in items:
                place = placement_of(arm, q, item)
                result = coal.DistanceResult()
                exact = coal.distance(
                    item.geometry,
                    coal.Transform3s(place.rotation, place.translation),
                    obstacle_shape(obstacle),
                    pose,
                    coal.DistanceRequest(),
                    result,
                )
                hull = next(found)
                if exact > 0.0:
                    compared += 1
                    assert -SAME_MESH < exact - hull < excess
    assert compared > 60


def mesh_robot(folder: Path) -> Robot:
    shape = '<mesh filename="body.obj"/>'
    return load(folder, one_shape(shape))


def test_distances_of_a_convex_mesh_match_the_closed_form(tmp_path: Path) -> None:
    write_tetrahedron(tmp_path / "body.obj")
    arm = mesh_robot(tmp_path)
    # Above the slanted face of x + y + z <= 1, and inside beside the face z = 0.
    out = np.array([1.0, 0.0, 0.0]) + np.full(3, 1.0)
    inside = np.array([1.0, 0.0, 0.0]) + np.array([0.2, 0.2, 0.1])
    scene = Scene(
        [
            Sphere("out", radius=0.3, position=out),
            Sphere("in", radius=0.02, position=inside),
        ]
    )
    found = CollisionChecker(arm, scene).distances(np.zeros((1, 1)))[0]
    np.testing.assert_allclose(found, [2.0 / np.sqrt(3.0) - 0.3, -0.12], atol=1e-8)


@pytest.mark.parametrize(
    ("vertices", "faces"),
    [
        ([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], [(1, 2, 3), (1, 3, 4)]),
        ([(0, 0, 0), (2, 0, 0), (0, 2, 0)], [(1, 2, 3)]),
        # On a slope, where the roundings do not vanish: x = z.
        ([(0, 0, 0), (1, 0, 1), (1, 1, 1), (0, 1, 0)], [(1, 2, 3), (1, 3, 4)]),
    ],
    ids=["square", "triangle", "slope"],
)
def test_flat_mesh_is_taken_as_a_thin_plate(
    vertices: list[tuple[int, ...]], faces: list[tuple[int, ...]], tmp_path: Path
) -> None:
    """Coal would end the process for the hull of a flat mesh."""
    lines = ["v {} {} {}".format(*v) for v in vertices]
    lines += ["f {} {} {}".format(*f) for f in faces]
    (tmp_path / "body.obj").write_text("\n".join(lines) + "\n", encoding="utf-8")
    arm = mesh_robot(tmp_path)
    normal = np.cross(np.subtract(vertices[1], vertices[0]), np.array([0, 1, 0]))
    normal = normal / np.linalg.norm(normal)
    inside = np.mean(vertices, axis=0) + np.array([1.0, 0.0, 0.0])
    scene = Scene(
        [
            Sphere("above", radius=0.1, position=inside + 0.4 * normal),
            Sphere("through", radius=0.1, position=inside + 0.05 * normal),
        ]
    )
    found = CollisionChecker(arm, scene).distances(np.zeros((1, 1)))[0]
    np.testing.assert_allclose(found, [0.3, -0.05], atol=shapes.THINNEST)


def test_hull_of_a_mesh_is_computed_once() -> None:
    arm = load_robot("ur5", limits="urdf")
    scene = Scene([Sphere("o", radius=0.1, position=(1, 1, 1))])
    CollisionChecker(arm, scene, geometry="hull")
    mesh = fixed_link(arm, "forearm_link_0").geometry
    # A view of the corners is at the same place as long as the hull is the same.
    before = mesh.convex.points()
    found = shapes.convex_hull(mesh).points()
    assert np.shares_memory(found, before)


# Contact and beyond


@dataclass(frozen=True)
class Overlap:
    """A link and an obstacle with one centre: no direction of escape is shortest."""

    shape: str
    obstacle: Obstacle


OVERLAPS = {
    "balls": Overlap(BALL, Sphere("o", radius=0.2, position=(1, 0, 0))),
    "ball in box": Overlap(BALL, Box("o", size=(1, 1, 1), position=(1, 0, 0))),
    "ball in can": Overlap(
        BALL, Cylinder("o", radius=0.5, length=1.0, position=(1, 0, 0))
    ),
    "boxes": Overlap(
        '<box size="0.2 0.2 0.2"/>', Box("o", size=(1, 1, 1), position=(1, 0, 0))
    ),
    "cans": Overlap(
        '<cylinder radius="0.2" length="0.2"/>',
        Cylinder("o", radius=0.5, length=1.0, position=(1, 0, 0)),
    ),
}


@pytest.mark.parametrize("case", OVERLAPS)
def test_gradient_is_finite_where_centres_coincide(case: str, tmp_path: Path) -> None:
    overlap = OVERLAPS[case]
    text = one_shape(overlap.shape).replace('type="revolute"', 'type="prismatic"')
    arm = load(tmp_path, text.replace('axis xyz="0 0 1"', 'axis xyz="1 0 0"'))
    checker = CollisionChecker(arm, Scene([overlap.obstacle]))
    assert checker.distances(np.zeros((1, 1)))[0, 0] < -0.1
    gradient = gradients(checker, np.zeros(1), np.zeros(1, dtype=np.int64))
    assert np.all(np.isfinite(gradient))
    assert abs(gradient[0, 0]) <= 1.0 + 1e-6


def test_crossing_capsules_are_separated_along_their_centres(tmp_path: Path) -> None:
    """Coal has no normal where the axes of capsules cross."""
    text = one_shape('<cylinder radius="0.1" length="1"/>')
    capsule = '<collision_checking><capsule name="c"/></collision_checking>'
    text = text.replace("<collision>", f'{capsule}<collision name="c">')
    text = text.replace('type="revolute"', 'type="prismatic"')
    arm = load(tmp_path, text.replace('axis xyz="0 0 1"', 'axis xyz="1 0 0"'))
    lying = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    pill = Capsule("o", radius=0.2, length=1.0, position=(1.3, 0, 0), rotation=lying)
    checker = CollisionChecker(arm, Scene([pill]))
    assert checker.distances(np.zeros((1, 1)))[0, 0] == pytest.approx(-0.3, abs=1e-9)
    gradient = gradients(checker, np.zeros(1), np.zeros(1, dtype=np.int64))
    np.testing.assert_allclose(gradient, [[-1.0]])  # away from the obstacle at x > 1


@pytest.mark.parametrize("gap", [0.0, 1e-12, -1e-12, 1e-9, -1e-9])
@pytest.mark.parametrize("kind", ["sphere", "box", "capsule", "cylinder"])
def test_distance_and_gradient_are_exact_at_contact(
    kind: str, gap: float, tmp_path: Path
) -> None:
    """A box slides along x up to the face of an obstacle, whose normal is x."""
    text = one_shape('<box size="0.2 0.2 0.2"/>')
    text = text.replace('type="revolute"', 'type="prismatic"')
    arm = load(tmp_path, text.replace('axis xyz="0 0 1"', 'axis xyz="1 0 0"'))
    place = {"position": (1.6 + gap, 0, 0)}
    obstacle: Obstacle = {
        "sphere": lambda: Sphere("o", radius=0.5, **place),
        "box": lambda: Box("o", size=(1, 1, 1), **place),
        "capsule": lambda: Capsule("o", radius=0.5, length=1, **place),
        "cylinder": lambda: Cylinder("o", radius=0.5, length=1, **place),
    }[kind]()
    checker = CollisionChecker(arm, Scene([obstacle]))
    assert checker.distances(np.zeros((1, 1)))[0, 0] == pytest.approx(gap, abs=1e-8)
    gradient = gradients(checker, np.zeros(1), np.zeros(1, dtype=np.int64))
    np.testing.assert_allclose(gradient, [[-1.0]], atol=1e-5)


def test_failed_distance_queries_are_repeated(monkeypatch: pytest.MonkeyPatch) -> None:
    """Coal returns huge numbers if a tolerance is too tight; here all count as huge."""
    arm = load_robot("ur5", limits="urdf")
    q = np.array([0.1, -1.2, 1.1, 0.3, 0.2, 0.1])
    item = fixed_link(arm, "forearm_link_0")
    middle = placement_of(arm, q, item).act(hull_points(item).mean(axis=0))
    can = Cylinder("o", radius=0.15, length=0.3, position=middle, rotation=(1, 2, 3, 4))
    checker = CollisionChecker(arm, Scene([can]), geometry="hull")
    expected = checker.distances(q[None])
    assert expected.min() < -0.1
    assert expected.max() > 0.01
    monkeypatch.setattr(narrow, "FAILED", -1.0)
    found = checker.distances(q[None])
    assert not np.array_equal(found, expected)  # the tolerance was another
    np.testing.assert_allclose(found, expected, atol=1e-5)
    assert np.all(np.isfinite(gradients(checker, q, np.arange(7))))
    monkeypatch.setattr(narrow, "FAILED", 1e100)
    np.testing.assert_allclose(checker.distances(q[None]), expected, atol=2e-6)


@pytest.mark.parametrize("tolerance", [1e-12, 1e-16])
def test_distances_are_finite_at_tight_tolerances(
    tolerance: float, monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator
) -> None:
    """Coal does fail now and then at these tolerances."""
    monkeypatch.setattr(narrow, "EPA_TOLERANCE", tolerance)
    arm = load_robot("ur5", limits="urdf")
    q = np.array([0.1, -1.2, 1.1, 0.3, 0.2, 0.1])
    item = fixed_link(arm, "forearm_link_0")
    middle = placement_of(arm, q, item).act(hull_points(item).mean(axis=0))
    for _ in range(40):
        can = Cylinder(
            "o",
            radius=0.15,
            length=0.3,
            position=middle + 0.05 * rng.normal(size=3),
            rotation=random_rotation(rng),
        )
        checker = CollisionChecker(arm, Scene([can]), geometry="hull")
        assert np.abs(checker.distances(q[None])).max() < 1.0
        assert np.all(np.isfinite(gradients(checker, q, np.arange(7))))


# Pairs


def test_pairs_are_named_by_link(planar3r: Robot) -> None:
    scene = Scene(
        [Sphere("O", radius=0.8, position=(4, 0, 0)), Box("wall", size=(1, 1, 1))]
    )
    checker = CollisionChecker(planar3r, scene)
    assert checker.pairs == tuple(
        (name, obstacle)
        for obstacle in ("O", "wall")
        for name in ("link1", "link2", "link3")
    )


def test_penetration_of_ball_and_cylinder_is_continuous(tmp_path: Path) -> None:
    """The ball enters through the flat end; either body may be that of the arm."""
    heights = np.linspace(-0.2, 0.2, 41)
    for shape, obstacle in (
        ('<sphere radius="0.1"/>', Cylinder("o", radius=0.3, length=1.0)),
        ('<cylinder radius="0.3" length="1"/>', Sphere("o", radius=0.1)),
    ):
        text = one_shape(shape).replace('type="revolute"', 'type="prismatic"')
        arm = load(tmp_path, text, position_lower=-3.0)
        obstacle = replace(obstacle, position=(1.02, 0.0, 0.5))
        upwards = isinstance(obstacle, Cylinder)
        q = -0.1 + heights if upwards else 1.1 - heights
        found = CollisionChecker(arm, Scene([obstacle])).distances(q[:, None])[:, 0]
        np.testing.assert_allclose(found, -heights, atol=2e-6)


def test_fixed_links_have_no_pairs_and_every_shape_has_one() -> None:
    scene = Scene([Sphere("o", radius=0.1, position=(1, 1, 1))])
    panda = load_robot(
        "panda", limits="urdf", locked_joints={"panda_finger_joint1": 0.03}
    )
    names = [name for name, _ in CollisionChecker(panda, scene).pairs]
    assert "panda_link0" not in names  # fixed to the world
    assert names.count("panda_leftfinger") == 4  # its shapes
    assert {f"panda_link{i}" for i in range(1, 8)} < set(names)


def test_obstacles_may_have_the_same_names_as_links(planar3r: Robot) -> None:
    scene = Scene(
        [
            Sphere("link1_0", radius=0.8, position=(9, 0, 0)),
            Box("link2", size=(1, 1, 1), position=(0, -9, 0)),
        ]
    )
    checker = CollisionChecker(planar3r, scene)
    assert checker.pairs[0] == ("link1", "link1_0")
    assert checker.pairs[3] == ("link1", "link2")
    assert checker.distances(Q[None]).shape == (1, 6)


def test_without_obstacles_there_are_no_pairs(planar3r: Robot) -> None:
    checker = CollisionChecker(planar3r, Scene())
    assert checker.pairs == ()
    assert checker.distances(Q[None]).shape == (1, 0)
    assert gradients(checker, Q, np.zeros(0, dtype=np.int64)).shape == (0, 3)
    assert checker.closest(Q) is None
    assert ClearanceConstraint(checker, 0.0, 1.0).count == 0


def test_robot_without_collision_geometry_rejects_obstacles(tmp_path: Path) -> None:
    arm = load(tmp_path, one_joint())
    assert CollisionChecker(arm, Scene()).pairs == ()
    with pytest.raises(SceneError, match="'sample' has no collision geometry"):
        CollisionChecker(arm, Scene([Sphere("o", radius=1)]))


def test_fixed_link_is_not_checked_against_obstacles(tmp_path: Path) -> None:
    shape = f"{INERTIAL}<collision><geometry>{BALL}</geometry></collision>"
    arm = load(
        tmp_path,
        robot(link("base", shape), link("l1", shape), joint("j1", "base", "l1")),
    )
    checker = CollisionChecker(arm, Scene([Sphere("o", radius=0.5)]))  # at the base
    assert checker.pairs == (("l1", "o"),)
    assert checker.closest(np.zeros(1)) == Contact("l1", "o", pytest.approx(0.4))


def test_distance_of_exactly_zero_is_measured_again(
    planar3r: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Coal returns zero for distant hulls at rare configurations and tolerances."""
    scene = Scene([Box("o", size=(1.0, 1.0, 1.0), position=(0.0, 5.0, 0.0))])
    checker = CollisionChecker(planar3r, scene)
    expected, exact = checker.distances(np.zeros((1, 3))), pin.computeDistance

    def failing(model: object, data: pin.GeometryData, index: int) -> object:
        result = exact(model, data, index)
        if data.distanceRequests[index].gjk_tolerance < 1e-9:
            result.min_distance = 0.0
        return result

    monkeypatch.setattr(pin, "computeDistance", failing)
    found = checker.distances(np.zeros((1, 3)))
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_closest_returns_the_pair_of_least_distance(planar3r: Robot) -> None:
    scene = Scene(
        [
            Sphere("far", radius=0.1, position=(0, -5, 0)),
            Sphere("near", radius=0.1, position=(6.2, 0.05, 0)),
        ]
    )
    contact = CollisionChecker(planar3r, scene).closest(np.zeros(3))
    assert contact is not None
    assert (contact.link, contact.obstacle) == ("link3", "near")
    assert contact.distance == pytest.approx(np.hypot(0.2, 0.05) - 0.101, abs=1e-9)


def test_margin_array_may_change_in_place(planar3r: Robot) -> None:
    """Regression: the result for the former margins was reused for the same array."""
    scene = Scene([Sphere("ball", radius=0.1, position=(0, -5, 0))])
    checker = CollisionChecker(planar3r, scene)
    margin = np.zeros(len(checker.pairs))
    assert checker.is_free(np.zeros(3), margin)
    margin[:] = 10.0
    assert not checker.is_free(np.zeros(3), margin)


def test_obstacle_without_a_collision_shape_is_named_in_the_error() -> None:
    with pytest.raises(
        SceneError, match="'o': there is no collision shape for a Obst"
    ) as e:
        obstacle_shape(Obstacle("o"))
    assert e.value.obstacle == "o"


# Rows


def scene_of_four() -> Scene:
    return Scene(
        [
            Sphere("ball", radius=0.8, position=(4, 0, 0)),
            Box("crate", size=(1, 2, 3), position=(-2, 1, 0)),
            Cylinder("can", radius=0.4, length=1.0, position=(0, 4, 0)),
            Capsule("pill", radius=0.3, length=1.0, position=(2, 3, 0)),
        ]
    )


def test_distances_of_a_row_do_not_depend_on_other_rows(
    planar3r: Robot, rng: np.random.Generator
) -> None:
    limits = planar3r.limits
    q = rng.uniform(limits.position_lower, limits.position_upper, size=(6, 3))
    checker = CollisionChecker(planar3r, scene_of_four())
    together = checker.distances(q)
    assert together.shape == (6, 12)
    assert checker.distances(q[:0]).shape == (0, 12)
    tolerance = np.where(together > 0.0, 1e-9, 5e-6)
    for i in (4, 0, 2):
        alone = checker.distances(q[i : i + 1])[0]
        assert np.all(np.abs(alone - together[i]) < tolerance[i])
    assert np.all(np.abs(checker.distances(q[::-1])[::-1] - together) < tolerance)


def test_gradients_of_selected_pairs_equal_those_of_all_pairs(planar3r: Robot) -> None:
    checker = CollisionChecker(planar3r, scene_of_four())
    every = gradients(checker, Q, np.arange(12))
    assert every.shape == (12, 3)
    some = np.array([7, 0, 11])
    np.testing.assert_allclose(gradients(checker, Q, some), every[some], atol=1e-4)
    # The distances of the first link do not depend on the other joints.
    assert not np.any(every[0::3, 1:])


def test_checker_can_be_pickled(planar3r: Robot) -> None:
    checker = CollisionChecker(planar3r, scene_of_four())
    back = pickle.loads(pickle.dumps(checker))
    assert back.pairs == checker.pairs
    found = back.distances(Q[None])
    np.testing.assert_allclose(found, checker.distances(Q[None]), atol=1e-9)


# The constraint


def test_clearance_constraint_is_negative_beyond_the_margin(planar3r: Robot) -> None:
    checker = CollisionChecker(planar3r, scene_of_four())
    constraint = ClearanceConstraint(checker, margin=0.1, length=6.0)
    assert constraint.count == 12
    distances = checker.distances(Q[None])
    values = constraint.values(Q[None])
    np.testing.assert_allclose(6.0 * values, 0.1 - distances, atol=1e-9)
    assert np.array_equal(values <= 0.0, distances >= 0.1)
    some = np.array([5, 2])
    np.testing.assert_allclose(
        6.0 * gradients(constraint, Q, some), -gradients(checker, Q, some), atol=1e-4
    )


def test_clearance_constraint_can_be_pickled(planar3r: Robot) -> None:
    constraint = ClearanceConstraint(
        CollisionChecker(planar3r, scene_of_four()), margin=0.1, length=6.0
    )
    back = pickle.loads(pickle.dumps(constraint))
    np.testing.assert_allclose(
        back.values(Q[None]), constraint.values(Q[None]), atol=1e-9
    )


@pytest.mark.parametrize(
    ("q", "margin", "match"),
    [
        (np.full(3, np.nan), 0.0, "q is .*nan.*expected .*finite"),
        (np.zeros(2), 0.0, r"q is array\(\[0.*expected numbers, one for each joint"),
        (np.zeros(3), np.zeros(99), r"margin has shape \(99,\), expected"),
        (np.zeros(3), "wide", "margin"),
    ],
)
def test_invalid_configuration_or_margin_is_named_in_the_error(
    planar3r: Robot, q: np.ndarray, margin: object, match: str
) -> None:
    """Regression: a configuration of NaN was free of collisions."""
    scene = Scene([Sphere("ball", radius=0.1, position=(2.0, 2.0, 0.0))])
    checker = CollisionChecker(planar3r, scene)
    for query in (checker.is_free, checker.closest):
        with pytest.raises(ProblemError, match=match):
            query(q, margin)


@pytest.mark.parametrize("cutoff", ["wide", None, [0.1, 0.2, 0.3, 0.4, 0.5]])
def test_invalid_cutoff_is_named_in_the_error(planar3r: Robot, cutoff: object) -> None:
    """Regression: invalid cutoffs raised the errors of NumPy."""
    checker = CollisionChecker(planar3r, Scene([Sphere("ball", radius=0.1)]))
    with pytest.raises(ProblemError, match="cutoff"):
        checker.distances(np.zeros((1, 3)), cutoff)
