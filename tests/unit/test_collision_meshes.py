"""Meshes: convex decomposition, its cache on disk, mesh obstacles, and grids."""

from __future__ import annotations

import logging
import pickle
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pytest
from robot_samples import load, one_shape
from scipy.spatial import ConvexHull

import tominpmp as tm
from tominpmp.collision import decomposition, decomposition_cache
from tominpmp.collision.checker import CollisionChecker
from tominpmp.collision.decomposition import MOST_PIECES, Measure, decompose
from tominpmp.description.model import mesh_arrays, triangle_mesh
from tominpmp.exceptions import SceneError
from tominpmp.robot.robot import Robot, load_robot
from tominpmp.scene.grids import HeightField, OcTree
from tominpmp.scene.mesh_files import read_mesh
from tominpmp.scene.meshes import Mesh
from tominpmp.scene.obstacles import Box, Sphere
from tominpmp.scene.scene import Scene
from tominpmp.viz.surfaces import obstacle_surface

BALL = '<sphere radius="0.1"/>'
CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
QUADS = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4))
QUADS = (*QUADS, (1, 5, 7, 3))
CUBE = np.array([t for a, b, c, d in QUADS for t in ((a, b, c), (a, c, d))])


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache folder for each test, and an empty cache in memory."""
    decomposition_cache._known_pieces.cache_clear()
    folder = tmp_path / "cache"
    monkeypatch.setenv(decomposition_cache.FOLDER_VARIABLE, str(folder))
    return folder


def angle_iron(size: float = 0.3, thick: float = 0.05) -> tuple[np.ndarray, np.ndarray]:
    """An L-shaped bar along z, as one closed surface."""
    outline = np.array(
        [[0, 0], [size, 0], [size, thick], [thick, thick], [thick, size], [0, size]]
    )
    low = np.column_stack([outline, np.zeros(6)])
    vertices = np.concatenate([low, low + np.array([0, 0, 0.4])])
    caps = [(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)]
    triangles = [(c, b, a) for a, b, c in caps]
    triangles += [(a + 6, b + 6, c + 6) for a, b, c in caps]
    for i in range(6):
        k = (i + 1) % 6
        triangles += [(i, k, k + 6), (i, k + 6, i + 6)]
    return vertices, np.array(triangles)


def depth_in(corners: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Signed distances of points from a hull, negative inside."""
    equations = ConvexHull(corners).equations
    return np.asarray(np.max(points @ equations[:, :3].T + equations[:, 3], axis=1))


def outward(mesh: Any, pieces: Sequence[np.ndarray]) -> float:
    """How far pieces protrude from their mesh, on samples of their surfaces."""
    vertices, corners = mesh_arrays(mesh)
    measure = Measure(mesh, vertices[corners])
    parts = [measure.part(piece) for piece in pieces]
    return max(part.excess for part in parts if part is not None)


def inward(mesh: Any, pieces: Sequence[np.ndarray], rng: np.random.Generator) -> float:
    """How far a mesh protrudes from its pieces, at its corners and surface samples."""
    vertices, corners = mesh_arrays(mesh)
    weights = rng.dirichlet(np.ones(3), size=len(corners))
    points = np.einsum("kc,kci->ki", weights, vertices[corners])
    every = np.concatenate([vertices[np.unique(corners)], points])
    return float(np.min([depth_in(c, every) for c in pieces], axis=0).max())


# Convex pieces


def test_convex_mesh_is_one_piece(rng: np.random.Generator) -> None:
    mesh = triangle_mesh(CORNERS, CUBE)
    found = decompose(mesh)
    assert len(found) == 1
    assert outward(mesh, found) < 1e-3
    assert inward(mesh, found, rng) < 1e-9


def test_l_shaped_bar_is_decomposed_into_its_legs(rng: np.random.Generator) -> None:
    vertices, triangles = angle_iron()
    mesh = triangle_mesh(vertices, triangles)
    found = decompose(mesh)
    assert 2 <= len(found) <= 4
    assert outward(mesh, found) < 3e-3
    volume = sum(ConvexHull(corners).volume for corners in found)
    assert volume == pytest.approx((0.3 + 0.25) * 0.05 * 0.4, rel=0.2)
    # The pieces contain the bar, but not the space between its legs.
    inside = rng.uniform(size=(300, 3)) * [0.3, 0.05, 0.4]
    inside = np.concatenate([inside, inside[:, [1, 0, 2]]])
    beyond = np.min([depth_in(c, inside) for c in found], axis=0)
    assert beyond.max() < 1e-9
    between = np.array([[0.15, 0.15, 0.2], [0.2, 0.1, 0.1]])
    assert np.min([depth_in(c, between) for c in found]) > 0.02


@pytest.mark.parametrize("size", [(0.5, 0.4, 0.3), (0.7, 0.4, 0.2), (0.4, 0.3, 0.3)])
def test_pieces_of_an_open_box_leave_its_inside_free(
    size: tuple[float, float, float],
) -> None:
    """Regression: the pieces filled the box.

    The hull protrudes as far until the last of the four walls is cut off.
    """
    wall = 0.02
    inner = CORNERS * (np.array(size) - [2 * wall, 2 * wall, wall]) + wall
    rim = (1, 5, 13, 9), (5, 7, 15, 13), (7, 3, 11, 15), (3, 1, 9, 11)
    inside = [tuple(corner + 8 for corner in reversed(quad)) for quad in QUADS[:5]]
    quads = [*QUADS[:5], *inside, *rim]
    triangles = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    vertices = np.concatenate([CORNERS * size, inner])
    found = decompose(triangle_mesh(vertices, np.array(triangles)))
    assert len(found) <= MOST_PIECES
    middle = 0.5 * np.array([size])
    assert np.min([depth_in(c, middle) for c in found]) > 0.0


def test_decomposition_checks_the_time_limit_before_each_hull(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Regression: decomposition checked the time limit between cuts only.

    A cut took a second for a link of 15 000 triangles. A plan of half a second took
    three times as long.
    """
    hulls_since_check = [0]

    def hull(points: np.ndarray) -> ConvexHull:
        hulls_since_check[0] += 1
        assert hulls_since_check[0] == 1
        return ConvexHull(points)

    monkeypatch.setattr(decomposition, "ConvexHull", hull)
    monkeypatch.setattr(
        decomposition, "check", lambda: hulls_since_check.__setitem__(0, 0)
    )
    found = decompose(triangle_mesh(*angle_iron()))
    assert len(found) > 1


def test_flat_mesh_has_no_pieces() -> None:
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]])
    assert decompose(triangle_mesh(square, np.array([[0, 1, 2], [0, 2, 3]]))) == []


def mesh_of(arm: Robot, name: str) -> coal.BVHModelBase:
    for item in arm.collision_model.geometryObjects:
        if item.name == name:
            return item.geometry
    raise LookupError(name)


def test_pieces_of_a_ur5_forearm_protrude_less_than_its_hull(
    rng: np.random.Generator,
) -> None:
    """The hull of the forearm of a UR5 protrudes by 37 mm."""
    mesh = mesh_of(load_robot("ur5", limits="urdf"), "forearm_link_0")
    found = [hull.points() for hull in decomposition_cache.pieces_of(mesh)]
    assert 2 <= len(found) <= MOST_PIECES
    assert outward(mesh, found) < 0.012
    assert inward(mesh, found, rng) < 1e-9


def bar_robot(folder: Path) -> Robot:
    vertices, triangles = angle_iron()
    lines = [f"v {x} {y} {z}" for x, y, z in vertices]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in triangles]
    (folder / "bar.obj").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return load(folder, one_shape('<mesh filename="bar.obj"/>'))


def test_link_geometry_convex_uses_the_pieces_of_the_mesh(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    arm = bar_robot(tmp_path)
    # Between the legs of the bar, 0.1 m from both, inside its hull.
    ball = Sphere("o", radius=0.02, position=(1.15, 0.15, 0.2))
    found = {
        geometry: CollisionChecker(arm, Scene([ball]), geometry=geometry)
        for geometry in ("convex", "hull", "mesh")
    }
    q = np.zeros((1, 1))
    assert found["hull"].distances(q).shape == (1, 1)
    assert found["hull"].distances(q)[0, 0] < 0.0
    exact = found["mesh"].distances(q)
    assert exact[0, 0] == pytest.approx(0.08, abs=1e-6)
    assert len(found["convex"].pairs) >= 2
    assert found["convex"].distances(q).min() == pytest.approx(0.08, abs=1e-6)
    assert found["convex"].distances(q, 0.01).min() >= 0.01
    mesh = mesh_of(arm, "l1_0")
    pieces = [hull.points() for hull in decomposition_cache.pieces_of(mesh)]
    assert len(pieces) == len(found["convex"].pairs)
    assert {link for link, _ in found["convex"].pairs} == {"l1"}
    assert inward(mesh, pieces, rng) < 1e-9
    assert outward(mesh, pieces) < 3e-3
    assert pickle.loads(pickle.dumps(found["mesh"])).geometry == "mesh"


def test_lower_bounds_of_non_convex_meshes_hold(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    """No plane separates a non-convex mesh: its bound uses motion in any direction."""
    arm = bar_robot(tmp_path)
    scene = Scene(
        [
            Sphere(f"o{i}", radius=0.02, position=p)
            for i, p in enumerate(
                np.array([1.15, 0.15, 0.2]) + 0.05 * rng.normal(size=(6, 3))
            )
        ]
    )
    checker = CollisionChecker(arm, scene, geometry="mesh")
    q = np.linspace(-0.4, 0.4, 20)[:, None]
    for step in (0.0, 0.1, 0.01):
        q = q + step * rng.normal(size=q.shape)
        exact, found = checker.distances(q), checker.distances(q, 0.03)
        apart = exact > 1e-6
        assert np.all(found[apart] <= exact[apart] + 1e-8)
        near = apart & (exact < 0.03)
        np.testing.assert_allclose(found[near], exact[near], atol=1e-8)
        assert np.all(found[exact >= 0.03] >= 0.03)


# The cache on disk


def test_pieces_are_read_from_the_cache(
    own_cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mesh = triangle_mesh(*angle_iron())
    first = decomposition_cache.pieces_of(mesh)
    (path,) = own_cache.iterdir()
    assert path.suffix == ".npz"
    decomposition_cache._known_pieces.cache_clear()

    def unexpected(mesh: object) -> None:
        raise AssertionError("cut again")

    monkeypatch.setattr(decomposition_cache.decomposition, "decompose", unexpected)
    again = decomposition_cache.pieces_of(triangle_mesh(*angle_iron()))
    assert len(first) > 1
    for one, other in zip(first, again, strict=True):
        np.testing.assert_array_equal(one.points(), other.points())
    with pytest.raises(AssertionError, match="cut again"):
        decomposition_cache.pieces_of(triangle_mesh(*angle_iron(0.31)))


def cached_file(mesh: Any, folder: Path) -> Path:
    """The cache file of the pieces of a mesh; the cache in memory is emptied."""
    decomposition_cache.pieces_of(mesh)
    decomposition_cache._known_pieces.cache_clear()
    (path,) = folder.iterdir()
    return path


@pytest.mark.parametrize("content", [b"", b"not a file", b"PK\x03\x04 broken"])
def test_unreadable_cache_file_is_replaced(
    content: bytes, own_cache: Path, caplog: pytest.LogCaptureFixture
) -> None:
    mesh = triangle_mesh(*angle_iron())
    cached_file(mesh, own_cache).write_bytes(content)
    with caplog.at_level(logging.WARNING):
        assert decomposition_cache.pieces_of(mesh)
    assert "cannot be read" in caplog.text
    decomposition_cache._known_pieces.cache_clear()
    caplog.clear()
    assert decomposition_cache.pieces_of(mesh)
    assert not caplog.text


def test_cached_pieces_of_nan_are_computed_anew(own_cache: Path) -> None:
    mesh = triangle_mesh(*angle_iron())
    path = cached_file(mesh, own_cache)
    np.savez(path, points=np.full((4, 3), np.nan), counts=[4], deviation=[0.0, 0.0])
    found = [hull.points() for hull in decomposition_cache.pieces_of(mesh)]
    assert all(np.all(np.isfinite(corners)) for corners in found)


def test_unwritable_cache_folder_keeps_pieces_in_memory(
    own_cache: Path, caplog: pytest.LogCaptureFixture
) -> None:
    own_cache.write_text("in the way", encoding="utf-8")
    mesh = triangle_mesh(*angle_iron())
    with caplog.at_level(logging.WARNING):
        first = decomposition_cache.pieces_of(mesh)
    assert first is not None
    assert "cannot be kept" in caplog.text
    assert decomposition_cache.pieces_of(mesh) is first  # from the cache in memory


def test_cache_folder_follows_the_environment(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    assert decomposition_cache.cache_folder() == tmp_path / "cache"
    monkeypatch.delenv(decomposition_cache.FOLDER_VARIABLE)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert decomposition_cache.cache_folder().name in ("tominpmp", "cache")
    monkeypatch.delenv("XDG_CACHE_HOME")
    assert decomposition_cache.cache_folder().is_absolute()


# Mesh obstacles


def clearance(arm: Robot, *obstacles: tm.Obstacle) -> float:
    checker = CollisionChecker(arm, Scene(obstacles))
    return float(checker.distances(np.zeros((1, 1))).min())


@pytest.fixture
def ball(tmp_path: Path) -> Robot:
    """A ball of 0.1 m at (1, 0, 0)."""
    return load(tmp_path, one_shape(BALL))


def test_mesh_obstacle_has_its_position_rotation_and_scale(ball: Robot) -> None:
    place = {"position": (2.0, 0.0, 0.0), "rotation": (0, 0, 1, 1)}
    mesh = Mesh("m", vertices=CORNERS, triangles=CUBE, scale=(0.4, 0.6, 0.8), **place)
    # A quarter turn about z: x of the cube points along y, y along -x.
    centre = (2.0 - 0.3, 0.2, 0.4)
    box = Box("b", size=(0.6, 0.4, 0.8), position=centre)
    assert clearance(ball, mesh) == pytest.approx(clearance(ball, box), abs=1e-9)
    assert clearance(ball, mesh) == pytest.approx(0.3, abs=1e-9)
    assert mesh == Mesh(
        "m", vertices=CORNERS, triangles=CUBE, scale=(0.4, 0.6, 0.8), **place
    )
    assert pickle.loads(pickle.dumps(mesh)) == mesh


@pytest.mark.parametrize("convex", ["auto", "hull", "none"])
def test_option_convex_determines_the_shape_of_a_mesh(ball: Robot, convex: str) -> None:
    vertices, triangles = angle_iron(1.0, 0.05)
    mesh = Mesh(
        "m",
        vertices=vertices,
        triangles=triangles,
        convex=convex,  # type: ignore[arg-type]
        position=(0.6, -0.4, -0.2),
    )
    found = clearance(ball, mesh)
    if convex == "hull":
        assert found < -0.1
    else:
        assert found == pytest.approx(0.35 - 0.1, abs=1e-6)


def write_stl(path: Path, points: np.ndarray) -> None:
    kind = np.dtype([("normal", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])
    table = np.zeros(len(points), kind)
    table["v"] = points
    count = np.array(len(points), "<u4").tobytes()
    path.write_bytes(b"solid of a kind".ljust(80) + count + table.tobytes())


def test_mesh_files_of_all_formats_have_the_same_volume(tmp_path: Path) -> None:
    write_stl(tmp_path / "cube.stl", CORNERS[CUBE])
    text = "solid\n" + "".join(
        "facet normal 0 0 0\nouter loop\n"
        + "".join(f"vertex {x} {y} {z}\n" for x, y, z in triangle)
        + "endloop\nendfacet\n"
        for triangle in CORNERS[CUBE]
    )
    (tmp_path / "text.STL").write_text(text + "endsolid\n", encoding="utf-8")
    lines = [f"v {x} {y} {z} 1 1 1" for x, y, z in CORNERS] + ["vn 0 0 1", "", "# -"]
    lines += [f"f {a + 1}/1/1 {b + 1}//1 {c - 8} {d + 1}" for a, b, c, d in QUADS]
    (tmp_path / "cube.obj").write_text("\n".join(lines), encoding="utf-8")
    for name in ("cube.stl", "text.STL", "cube.obj"):
        vertices, triangles = read_mesh(tmp_path / name)
        assert vertices.shape == (8, 3)
        assert triangles.shape == (12, 3)
        normal = np.cross(
            vertices[triangles[:, 1]] - vertices[triangles[:, 0]],
            vertices[triangles[:, 2]] - vertices[triangles[:, 0]],
        )
        volume = np.einsum("ki,ki->", vertices[triangles[:, 0]], normal) / 6.0
        assert abs(volume) == pytest.approx(1.0)
        mesh = Mesh("m", path=tmp_path / name, scale=0.1)
        assert mesh.points.max() == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("m.stl", b"x" * 90, "is not an STL file"),
        ("m.stl", b"solid\nvertex 1 2\n", "line 2: expected three numbers"),
        ("m.stl", b"solid\nvertex 1 2 3\n", "not a multiple of three"),
        ("m.stl", b"solid\nendsolid", "has no triangles"),
        ("m.stl", b"solid\nvertex 1 2 3_0\n", "line 2: expected three numbers"),
        ("m.obj", b"v 1 2 x", "line 1: expected three numbers"),
        ("m.obj", b"v 1 2 3_0", "line 1: expected three numbers"),
        (
            "m.obj",
            b"v 1 2 3\nf 1 2 3",
            "line 2: a corner refers to a vertex that is not",
        ),
        ("m.obj", b"v 1 2 3\nf 1 1", "line 2: expected a face of three corners"),
        ("m.obj", b"v 1 2 3\nf a b c", "line 2: a corner is not a whole number"),
        ("m.obj", b"v 1 2 3\nf 1 1_0 1", "line 2: a corner is not a whole number"),
        ("m.obj", b"v 1 2 3\nf 1 1.0 1", "line 2: a corner is not a whole number"),
        ("m.obj", b"v 1 2 nan\nf 1 1 1", "not finite"),
        ("m.xyz", b"nothing", "cannot be read"),
    ],
)
def test_invalid_mesh_file_is_named_in_the_error(
    name: str, content: bytes, message: str, tmp_path: Path
) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(SceneError, match=message) as caught:
        Mesh("post", path=path)
    assert str(path) in str(caught.value)
    assert caught.value.obstacle == "post"


def test_missing_mesh_file_is_named_in_the_error(tmp_path: Path) -> None:
    for path in (tmp_path / "a.stl", tmp_path / "nowhere" / "a.stl"):
        with pytest.raises(SceneError, match=f"there is no file {path}"):
            Mesh("post", path=path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"vertices": None}, "needs a path, or vertices and triangles"),
        ({"vertices": None, "triangles": None}, "needs a path"),
        ({"vertices": CORNERS[:, :2]}, r"vertices has shape \(8, 2\)"),
        ({"vertices": CORNERS * np.nan}, "not finite"),
        ({"vertices": "abc"}, "vertices is 'abc', expected 3 coordinates"),
        ({"triangles": CUBE + 1}, "not among its 8 vertices"),
        ({"triangles": CUBE * 1.0}, "expected numbers of vertices, integers"),
        ({"triangles": CUBE[:, :2]}, r"triangles has shape \(12, 2\)"),
        ({"triangles": CUBE[:0]}, "no triangles"),
        ({"scale": 0.0}, "scale is 0.0"),
        ({"scale": (1, 2)}, "one or three numbers"),
        ({"convex": "maybe"}, "convex is 'maybe'"),
        ({"path": 3}, "expected the path of a file"),
    ],
)
def test_invalid_mesh_argument_is_named_in_the_error(
    change: dict[str, object], message: str
) -> None:
    with pytest.raises(SceneError, match=message) as caught:
        Mesh("m", **{"vertices": CORNERS, "triangles": CUBE, **change})
    assert caught.value.obstacle == "m"


# Grids


def test_height_field_has_distances_surface_and_pickle(ball: Robot) -> None:
    heights = np.zeros((3, 5))
    heights[1, 3] = 0.5  # a peak at x = 1, y = 0
    low = (0, 0, -1)
    ground = HeightField("g", heights=heights, size=(4.0, 2.0), position=low)
    assert ground.grid[0].tolist() == [-2, -1, 0, 1, 2]
    assert ground.cells.shape == (8, 8, 3)
    assert ground.base == pytest.approx(-0.04)
    assert clearance(ball, ground) == pytest.approx(1.0 - 0.5 - 0.1, abs=1e-8)
    flat = HeightField("f", heights=np.full((2, 2), 0.2), size=(4, 4), base=-0.3)
    box = Box("b", size=(4, 4, 0.5), position=(0, 0, -0.05))
    assert clearance(ball, flat) == pytest.approx(clearance(ball, box), abs=1e-6)
    # Coal would end the process for cells that are so thin for their length.
    wide = HeightField(
        "w", heights=np.full((2, 2), 0.2), size=(1e5, 1e-3), position=low
    )
    assert clearance(ball, wide) == pytest.approx(1.0 - 0.2 - 0.1, abs=1e-6)
    surface = obstacle_surface(ground)
    used = surface.vertices[surface.faces]
    assert used[..., 2].max() == 0.5
    assert pickle.loads(pickle.dumps(ground)) == ground


def test_octree_merges_cubes_and_contains_its_points(
    ball: Robot, rng: np.random.Generator
) -> None:
    points = rng.uniform(size=(3000, 3)) * [0.4, 0.4, 0.1] + [0.8, 0.5, 0.0]
    cloud = OcTree("c", points=points, resolution=0.1)
    centres, sizes = cloud.boxes
    assert len(centres) == 1  # 4 x 4 x 1 cubes, all of them occupied
    np.testing.assert_allclose(centres[0], [1.0, 0.7, 0.05])
    np.testing.assert_allclose(sizes[0], [0.4, 0.4, 0.1])
    assert clearance(ball, cloud) == pytest.approx(0.4, abs=1e-8)
    sparse = OcTree("s", points=rng.normal(size=(200, 3)), resolution=0.25)
    centres, sizes = sparse.boxes
    beyond = np.abs(sparse.points[:, None] - centres) - 0.5 * sizes
    inside = np.all(beyond <= 1e-9, axis=2)
    assert np.all(np.any(inside, axis=1))
    cubes = len(np.unique(np.floor(sparse.points / 0.25), axis=0))
    assert np.sum(np.prod(sizes, axis=1)) == pytest.approx(cubes * 0.25**3)
    surface = obstacle_surface(sparse)
    assert len(surface.faces) == 12 * len(centres)
    far = OcTree("f", points=np.array([[1e20, 0.0, 0.0]]), resolution=0.1)
    assert far.boxes[0][0, 0] == pytest.approx(1e20)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"heights": np.zeros(3)}, "at least two rows and two columns"),
        ({"heights": np.zeros((1, 3))}, "at least two rows and two columns"),
        ({"heights": np.full((2, 2), np.nan)}, "not finite"),
        ({"heights": "abc"}, "heights is 'abc', expected numbers"),
        ({"heights": np.zeros((300, 300))}, "at most 2500 cells"),
        ({"size": (1, 0)}, "two positive extents"),
        ({"size": 1.0}, "two positive extents"),
        ({"base": 0.0}, "expected a height below"),
    ],
)
def test_invalid_height_field_is_rejected(
    change: dict[str, object], message: str
) -> None:
    with pytest.raises(SceneError, match=message):
        HeightField("g", **{"heights": np.zeros((2, 2)), "size": (1, 1), **change})


@pytest.mark.parametrize(
    ("points", "resolution", "message"),
    [
        (np.zeros((0, 3)), 0.1, "expected 1 to 5000000 points"),
        (np.zeros(3), 0.1, "expected \\(m, 3\\)"),
        (np.full((2, 3), np.inf), 0.1, "finite"),
        (np.zeros((2, 3)), 0.0, "resolution is 0.0"),
        (np.array([[0, 0, 0], [1e3, 1e3, 1e3]]), 1e-3, "too fine"),
    ],
)
def test_invalid_octree_is_rejected(
    points: np.ndarray, resolution: float, message: str
) -> None:
    with pytest.raises(SceneError, match=message):
        OcTree("c", points=points, resolution=resolution)


@pytest.mark.parametrize("size", [1e-100, 1e-200, 1e-320])
def test_mesh_of_a_tiny_size_is_a_point(size: float, planar3r: Robot) -> None:
    """Regression: areas that underflow ended with a ValueError of NumPy."""
    mesh = Mesh("m", vertices=size * CORNERS, triangles=CUBE, position=(0, 8, 0))
    problem = tm.Problem(
        planar3r, [0.5, 1.7, -1.7], tm.JointGoal([2.0, -1.0, 0.5]), mesh
    )
    assert problem.scene["m"] is not None


@pytest.mark.parametrize("scale", [1e200, -1e200, 1e-320, [1, 1, 1e160]])
def test_scale_of_any_size_is_refused_with_its_value(scale: Any) -> None:
    """Regression: a scale of 1e200 ended with a LinAlgError of NumPy."""
    with pytest.raises(SceneError, match=r"'m': scale is .*1e-150 to 1e\+150 in size"):
        Mesh("m", vertices=CORNERS, triangles=CUBE, scale=scale)


def test_vertices_of_a_mesh_are_far_away_by_their_scale() -> None:
    far = 1e4 * CORNERS
    assert Mesh("m", vertices=100 * far, triangles=CUBE, scale=1e-3).points.max() < 1e5
    with pytest.raises(SceneError, match="vertices that are not finite, or 1e"):
        Mesh("m", vertices=far, triangles=CUBE, scale=1000.0)
