"""Collision queries agree with distances: `is_free`, and checks of problems."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import coal
import numpy as np
import pytest
from robot_samples import INERTIAL, joint, link, load, robot
from scipy.spatial import ConvexHull

import tominpmp as tm
from tominpmp.collision.checker import CollisionChecker

# Cylinders of a link and an obstacle (radius, length), the rotation of the link about
# y, whether the obstacle lies along y, its position relative to the link, and the
# depth of the overlap [m]. Coal's query for collisions alone finds no collision.
OVERLAPPING = [
    ((0.22, 0.34), (0.36, 0.29), 1.71, True, (0.18, 0.14, -0.17), 0.225),
    ((0.37, 0.39), (0.11, 0.35), 1.51, False, (-0.03, -0.36, -0.31), 0.0869),
    ((0.27, 0.14), (0.26, 0.30), -0.11, True, (-0.32, 0.20, 0.28), 0.01557),
    ((0.05, 0.14), (0.35, 0.13), -0.27, False, (-0.13, 0.19, -0.14), 0.0058),
    ((0.14, 0.12), (0.15, 0.27), 1.59, True, (0.21, 0.00, 0.16), 0.00116),
]
LYING = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
KINDS = ("cylinder", "box", "capsule", "hull")


def turning(folder: Path, shapes: str) -> tm.Robot:
    """A link with shapes, which turns about y, one metre from the base."""
    parts = link("base", ""), link("l1", INERTIAL + shapes)
    return load(folder, robot(*parts, joint("j1", "base", "l1", axis="0 1 0")))


@pytest.mark.parametrize("case", OVERLAPPING)
def test_problem_rejects_overlapping_cylinders_with_their_depth(
    case: tuple, tmp_path: Path
) -> None:
    (radius, length), other, q, lies, away, depth = case
    shape = f'<cylinder radius="{radius}" length="{length}"/>'
    arm = turning(tmp_path, f"<collision><geometry>{shape}</geometry></collision>")
    can = tm.Cylinder(
        "can",
        radius=other[0],
        length=other[1],
        position=np.array([1.0, 0.0, 0.0]) + away,
        rotation=LYING if lies else None,
    )
    refused = "^start in collision: link 'l1' and obstacle 'can' overlap by"
    with pytest.raises(tm.ProblemError, match=refused) as caught:
        tm.Problem(arm, [q], tm.JointGoal([0.5]), scene=tm.Scene([can]))
    found = float(str(caught.value).split("overlap by ")[1].split(" m")[0])
    assert found == pytest.approx(depth, rel=0.01)


def mesh_file(path: Path, rng: np.random.Generator) -> np.ndarray:
    """Write a convex mesh to a file, and return its corners."""
    points = rng.normal(size=(24, 3)) * [0.2, 0.1, 0.15]
    hull = ConvexHull(points)
    lines = ["v {} {} {}".format(*point) for point in points]
    lines += ["f {} {} {}".format(*(corner + 1)) for corner in hull.simplices]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return points


def placed(kind: str, folder: Path, rng: np.random.Generator) -> tm.Obstacle:
    """An obstacle beside or in the link, rotated at random or by right angles."""
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    if rng.random() < 0.5:
        turn = np.eye(3)[rng.permutation(3)]
    turn = turn * np.sign(np.linalg.det(turn))
    where = {
        "position": np.array([1.0, 0.0, 0.0]) + rng.normal(size=3) * 0.2,
        "rotation": turn,
    }
    a, b, c = rng.uniform(0.05, 0.5, 3)
    if kind == "cylinder":
        return tm.Cylinder("o", radius=0.5 * a, length=b, **where)
    if kind == "box":
        return tm.Box("o", size=(a, b, c), **where)
    if kind == "capsule":
        return tm.Capsule("o", radius=0.5 * a, length=b, **where)
    return tm.Mesh("o", path=folder / "body.obj", convex="hull", **where)


@pytest.mark.parametrize(("mine", "other"), list(product(KINDS, KINDS)))
def test_is_free_where_distances_exceed_the_margin(
    mine: str, other: str, tmp_path: Path, rng: np.random.Generator
) -> None:
    mesh_file(tmp_path / "body.obj", rng)
    shape = {
        "cylinder": '<cylinder radius="0.1" length="0.3"/>',
        "box": '<box size="0.1 0.2 0.3"/>',
        "capsule": '<cylinder radius="0.1" length="0.3"/>',
        "hull": '<mesh filename="body.obj"/>',
    }[mine]
    shapes = f'<collision name="c"><geometry>{shape}</geometry></collision>'
    if mine == "capsule":
        shapes += '<collision_checking><capsule name="c"/></collision_checking>'
    arm = turning(tmp_path, shapes)
    seen = set()
    for _ in range(40):
        scene = tm.Scene([placed(other, tmp_path, rng)])
        checker = CollisionChecker(arm, scene)
        q = rng.uniform(-1.0, 1.0, 1)
        distance = float(checker.distances(q[None])[0, 0])
        for trace in (1e-7, -1e-7, 1e-5, -1e-5, 1e-3, -1e-3):
            if distance - trace >= 0.0:
                assert checker.is_free(q, distance - trace) is (trace > 0.0)
        if abs(distance) > 1e-9:
            assert checker.is_free(q) is (distance > 0.0)
        seen.add(distance > 0.0)
    assert seen == {True, False}


def test_distances_to_boxes_do_not_depend_on_the_first_query_of_the_process() -> None:
    """Regression: the first scene decided whether Coal enlarges all boxes by 1e-10.

    A Fetch took 2.949 s or 2.969 s for the same problem, depending on the problem that
    was planned before. Run alone, this test makes the first query, along an axis.
    """
    box, point = coal.Box(100.0, 100.0, 100.0), coal.Capsule(0.5, 0.0)
    at = coal.Transform3s(np.eye(3), np.array([-53.0, 0.0, 0.0]))
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    request.gjk_tolerance = 1e-12
    distance = coal.distance(box, coal.Transform3s(), point, at, request, result)
    assert distance == pytest.approx(2.5, abs=1e-10)
