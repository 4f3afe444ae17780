"""Convex hulls of fine meshes, whose corners have more neighbours than Coal allows."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from robot_samples import INERTIAL, joint, link, load, robot
from scipy.spatial import ConvexHull

import tominpmp as tm
from tominpmp.collision import shapes
from tominpmp.collision.checker import CollisionChecker

RADIUS, HALF = 0.05, 0.12
# As a share of the diagonal: how far the points may protrude from a hull, and a hull
# from the exact hull of the points.
ROUNDING, STATED = 1e-9, 1e-6


def circle(count: int, radius: float = 1.0, z: float = 0.0) -> np.ndarray:
    angle = 2.0 * np.pi * np.arange(count) / count
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    return np.column_stack([x, y, np.full(count, z)])


def can(count: int) -> np.ndarray:
    return np.vstack([circle(count, RADIUS, z) for z in (-HALF, HALF)])


def cone(count: int) -> np.ndarray:
    return np.vstack([circle(count, RADIUS, -HALF), [[0.0, 0.0, HALF]]])


def fan(count: int) -> np.ndarray:
    """A tip whose neighbours are all to one side of it."""
    angle = np.linspace(0.0, 0.5, count)
    rim = np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
    return np.vstack([rim, [[0, 0, 0.5], [-0.1, 0, 0], [0, 0, -0.1]]])


def moment_curve(count: int) -> np.ndarray:
    """Points on a curve, whose ends are neighbours of all others."""
    t = np.linspace(-1.0, 1.0, count)
    return np.column_stack([t, t**2, t**3])


def ball(count: int, rng: np.random.Generator) -> np.ndarray:
    points = rng.normal(size=(count, 3))
    return points / np.linalg.norm(points, axis=1)[:, None]


KINDS: dict[str, Callable[[np.random.Generator], np.ndarray]] = {
    "can of 254 sides": lambda rng: can(254),
    "can of 300 sides": lambda rng: can(300),
    "can of 300 sides, in float32": lambda rng: can(300).astype(np.float32),
    "cone of 255 sides": lambda rng: cone(255),
    "cone of 1000 sides": lambda rng: cone(1000),
    "cone, each point three times": lambda rng: np.repeat(cone(1000), 3, axis=0),
    "needle": lambda rng: cone(600) * [1e-3, 1e-3, 1.0],
    "shield": lambda rng: cone(600) * [1.0, 1.0, 1e-3],
    "two tips": lambda rng: np.vstack([cone(600), [[0.0, 0.0, -1.0]]]),
    "fan": lambda rng: fan(1000),
    "curve": lambda rng: moment_curve(600),
    "ball": lambda rng: ball(1000, rng),
    "ball with a horn": lambda rng: np.vstack([ball(1000, rng), [[0, 0, 200.0]]]),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("unit", (1e-5, 1.0, 1e4))
def test_hulls_contain_their_points_and_protrude_within_tolerance(
    kind: str, unit: float, rng: np.random.Generator
) -> None:
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    points = unit * (KINDS[kind](rng) @ turn + rng.normal(size=3))
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    corners = np.array(shapes.hull_of(points).points())
    exact = ConvexHull(points)
    outer = points[exact.vertices]
    for tested, planes, most in (
        (outer, ConvexHull(corners).equations, ROUNDING),
        (corners, exact.equations, STATED),
    ):
        beyond = tested @ planes[:, :3].T + planes[:, 3]
        assert np.max(beyond) <= most * size
    # No new corner of the hull is farther from its nearest corner of the exact hull.
    new = corners[~np.all(np.isin(corners, outer), axis=1)]
    for corner in new:
        assert np.min(np.linalg.norm(outer - corner, axis=1)) <= STATED * size


def test_hull_of_100_000_points_is_exact(rng: np.random.Generator) -> None:
    points = ball(100_000, rng)
    corners = np.array(shapes.hull_of(points).points())
    rays = ball(20, rng).T
    most = np.max(points @ rays, axis=0)
    np.testing.assert_allclose(np.max(corners @ rays, axis=0), most, rtol=0, atol=1e-9)


def write_hull_mesh(path: Path, points: np.ndarray) -> np.ndarray:
    """Write the hull of points to a mesh file, and return its triangles."""
    triangles = ConvexHull(points).simplices
    lines = ["v {} {} {}".format(*point) for point in points]
    lines += ["f {} {} {}".format(*(corner + 1)) for corner in triangles]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return np.asarray(triangles)


def carrier(folder: Path, shape: str) -> tm.Robot:
    inside = f"{INERTIAL}<collision><geometry>{shape}</geometry></collision>"
    parts = link("base", ""), link("l1", inside), joint("j1", "base", "l1")
    return load(folder, robot(*parts))


@pytest.mark.parametrize(
    ("points", "height", "room"),
    [
        (can(300), 0.3, 0.3 - HALF),
        (cone(300), 0.3, 0.3 - HALF),
        (cone(300), -0.3, 0.3 - HALF),
    ],
    ids=["can", "tip", "base"],
)
def test_distances_of_links_and_obstacles_with_many_sides_are_exact(
    points: np.ndarray, height: float, room: float, tmp_path: Path
) -> None:
    triangles = write_hull_mesh(tmp_path / "body.obj", points)
    middle = np.array([1.0, 0.0, 0.0])
    away = np.array([0.0, 0.0, height])
    arm = carrier(tmp_path, '<sphere radius="0.01"/>')
    found = []
    for taken_as in ("auto", "hull"):
        for given in (
            {"path": tmp_path / "body.obj"},
            {"vertices": points, "triangles": triangles},
        ):
            mesh = tm.Mesh("m", **given, convex=taken_as, position=middle - away)
            checker = CollisionChecker(arm, tm.Scene([mesh]))
            found.append(checker.distances(np.zeros((1, 1)))[0, 0])
    arm = carrier(tmp_path, '<mesh filename="body.obj"/>')
    pearl = tm.Sphere("s", radius=0.01, position=middle + away)
    checker = CollisionChecker(arm, tm.Scene([pearl]))
    found.append(checker.distances(np.zeros((1, 1)))[0, 0])
    np.testing.assert_allclose(found, room - 0.01, atol=1e-6)


def test_link_of_300_sides_moves_as_fast_as_one_of_200(tmp_path: Path) -> None:
    durations = []
    for count in (200, 300):
        write_hull_mesh(tmp_path / "body.obj", can(count))
        arm = carrier(tmp_path, '<mesh filename="body.obj"/>')
        post = tm.Box("post", size=(0.1, 0.1, 0.5), position=(1.0, 0.2, 0.0))
        problem = tm.Problem(arm, [0.0], tm.JointGoal([1.0]), scene=tm.Scene([post]))
        solution = tm.plan(problem)
        assert solution.success, solution.message
        durations.append(solution.T)
    assert durations[0] == pytest.approx(durations[1], rel=1e-6)


@pytest.mark.parametrize("unit", (1e-4, 1.0, 1e3))
def test_disc_with_many_corners_is_taken_as_a_thin_plate(
    unit: float, tmp_path: Path
) -> None:
    """A disc without thickness becomes a thin plate with corners on two flat faces."""
    rim = np.vstack([circle(600, unit), [[0.0, 0.0, 0.0]]])
    triangles = [(i, (i + 1) % 600, 600) for i in range(600)]
    arm = carrier(tmp_path, '<sphere radius="0.01"/>')
    plate = tm.Mesh("m", vertices=rim, triangles=triangles, position=(1.0, 0.0, -0.5))
    checker = CollisionChecker(arm, tm.Scene([plate]))
    found = checker.distances(np.zeros((1, 1)))[0, 0]
    # The largest disc is 2 km wide: its least thickness is a share of that.
    room = max(shapes.THINNEST, shapes.THIN_SHARE * unit)
    assert found == pytest.approx(0.49, abs=room * (1.0 + 1e-6))
