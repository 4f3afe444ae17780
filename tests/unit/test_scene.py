"""Obstacles and scenes: defaults, conversions, wrong values, equality."""

from __future__ import annotations

import copy
import pickle
from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from tominpmp.exceptions import SceneError
from tominpmp.scene.motion import ConstantVelocity
from tominpmp.scene.obstacles import Box, Capsule, Cylinder, Obstacle, Sphere
from tominpmp.scene.scene import Scene

QUARTER_TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])

MAKERS = {
    "sphere": lambda **given: Sphere("o", **({"radius": 0.5} | given)),
    "box": lambda **given: Box("o", **({"size": (1, 2, 3)} | given)),
    "cylinder": lambda **given: Cylinder("o", **({"radius": 0.5, "length": 2} | given)),
    "capsule": lambda **given: Capsule("o", **({"radius": 0.5, "length": 2} | given)),
}
kinds = pytest.mark.parametrize("kind", MAKERS)


@kinds
def test_obstacle_is_unrotated_at_the_origin_by_default(kind: str) -> None:
    obstacle = MAKERS[kind]()
    assert obstacle.name == "o"
    np.testing.assert_array_equal(obstacle.position, np.zeros(3))
    np.testing.assert_array_equal(obstacle.rotation, np.eye(3))


def test_sizes_and_velocities_may_be_given_by_named_axes() -> None:
    box = Box("o", size={"z": 3.0, "x": 1.0, "y": 2.0})
    assert box == Box("o", size=(1.0, 2.0, 3.0))
    up = ConstantVelocity({"x": 0.0, "y": 0.0, "z": 0.1})
    assert up == ConstantVelocity((0.0, 0.0, 0.1))
    with pytest.raises(SceneError, match=r"size is .*, expected three"):
        Box("o", size={"x": 1.0})


@kinds
def test_dimensions_of_obstacles_become_floats(kind: str) -> None:
    obstacle = MAKERS[kind](position=(1, 2, 3))
    assert obstacle.position.dtype == np.float64
    for key in ("radius", "length"):
        if hasattr(obstacle, key):
            assert type(getattr(obstacle, key)) is float
    if kind == "box":
        np.testing.assert_array_equal(obstacle.size, [1.0, 2.0, 3.0])


# Rotations


@pytest.mark.parametrize(
    ("rotation", "matrix"),
    [
        (None, np.eye(3)),
        ((0, 0, 0, 1), np.eye(3)),
        ((0, 0, 0, -2), np.eye(3)),  # of any length
        ((0, 0, 1, 1), QUARTER_TURN),
        ((0, 0, 1e200, 1e200), QUARTER_TURN),
        (QUARTER_TURN.tolist(), QUARTER_TURN),
        ((1, 0, 0, 0), np.diag([1.0, -1.0, -1.0])),
    ],
)
def test_rotation_is_a_quaternion_or_a_matrix(
    rotation: object, matrix: np.ndarray
) -> None:
    obstacle = Box("o", size=(1, 1, 1), rotation=rotation)  # type: ignore[arg-type]
    np.testing.assert_allclose(obstacle.rotation, matrix, atol=1e-15)


@given(st.tuples(*[st.floats(-10, 10)] * 4))
def test_quaternion_becomes_a_rotation_about_its_vector_part(
    quaternion: tuple[float, ...],
) -> None:
    assume(np.linalg.norm(quaternion) > 1e-6)
    R = Sphere("o", radius=1, rotation=quaternion).rotation  # type: ignore[arg-type]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) > 0.0
    # The vector part is the axis.
    axis = np.array(quaternion[:3])
    np.testing.assert_allclose(R @ axis, axis, atol=1e-9)


@pytest.mark.parametrize(
    "rotation",
    [
        (0, 0, 0, 0),
        (1, 0, 0),
        np.eye(2),
        np.zeros((3, 3)),
        np.diag([1.0, 1.0, -1.0]),  # a mirror
        2.0 * np.eye(3),
        np.full((3, 3), 1e200),
        np.full((3, 3), np.nan),
        (0, 0, np.nan, 1),
        (0, 0, 0, np.inf),
        "turned",
        (0, 0, 0, "1"),
        [[1, 0, 0], [0, 1]],
        5,
    ],
)
def test_wrong_rotation_is_rejected_with_the_name_of_the_obstacle(
    rotation: object,
) -> None:
    with pytest.raises(SceneError, match=r"^obstacle 'o': .*rotation") as caught:
        Sphere("o", radius=1, rotation=rotation)  # type: ignore[arg-type]
    assert caught.value.obstacle == "o"


# Bad values


@pytest.mark.parametrize(
    "value", [0, -1, np.nan, np.inf, None, "1", [1.0], True, 1j, {}]
)
@pytest.mark.parametrize(
    ("kind", "key"),
    [
        ("sphere", "radius"),
        ("cylinder", "radius"),
        ("cylinder", "length"),
        ("capsule", "radius"),
        ("capsule", "length"),
    ],
)
def test_wrong_radius_or_length_is_rejected(kind: str, key: str, value: object) -> None:
    with pytest.raises(SceneError, match=f"'o': {key} is .*, expected a positive"):
        MAKERS[kind](**{key: value})


@pytest.mark.parametrize(
    ("size", "message"),
    [
        ((1, 0, 1), "size along y is 0.0, expected a positive length"),
        ((1, 1, -2), "size along z is -2.0"),
        ((1, 1), "size is .*, expected three edge lengths"),
        (1.0, "expected three edge lengths"),
        ((1, 1, np.nan), "expected three edge lengths"),
        ("abc", "expected three edge lengths"),
        (None, "expected three edge lengths"),
    ],
)
def test_wrong_size_of_a_box_is_rejected(size: object, message: str) -> None:
    with pytest.raises(SceneError, match=message) as caught:
        Box("o", size=size)  # type: ignore[arg-type]
    assert caught.value.obstacle == "o"


@kinds
@pytest.mark.parametrize(
    "position",
    [(1, 2), np.zeros((3, 1)), (0, 0, np.nan), (0, np.inf, 0), None, "abc", 1],
)
def test_wrong_position_is_rejected(kind: str, position: object) -> None:
    with pytest.raises(SceneError, match=r"(?s)'o': position is .*three coordinates"):
        MAKERS[kind](position=position)


def test_position_of_two_numbers_is_shown_whole_in_the_error() -> None:
    """Regression: only the first of the two numbers was shown as the position."""
    with pytest.raises(SceneError, match=r"position is \(1, 2\), expected three"):
        Sphere("o", radius=1, position=(1, 2))


@pytest.mark.parametrize("name", ["", None, 3])
def test_wrong_name_of_an_obstacle_is_rejected(name: object) -> None:
    with pytest.raises(SceneError, match="an obstacle needs a name"):
        Sphere(name, radius=1)  # type: ignore[arg-type]


# Obstacles as values


@kinds
def test_obstacles_are_frozen(kind: str) -> None:
    obstacle = MAKERS[kind]()
    with pytest.raises(FrozenInstanceError):
        obstacle.name = "p"
    restored = pickle.loads(pickle.dumps(obstacle))
    for item in (obstacle, copy.deepcopy(obstacle), restored):
        for key in ("position", "rotation", "size"):
            if hasattr(item, key):
                with pytest.raises(ValueError, match="read-only"):
                    getattr(item, key)[0] = 5.0


@kinds
def test_obstacles_are_equal_by_value(kind: str) -> None:
    obstacle = MAKERS[kind](position=(1, 2, 3), rotation=(0, 0, 1, 1))
    same = MAKERS[kind](position=np.array([1.0, 2.0, 3.0]), rotation=obstacle.rotation)
    assert obstacle == same
    assert hash(obstacle) == hash(same)
    assert pickle.loads(pickle.dumps(obstacle)) == obstacle
    assert obstacle != replace(obstacle, name="p")
    assert obstacle != replace(obstacle, position=(1, 2, 4))
    assert obstacle != replace(obstacle, rotation=None)
    for key, value in (("radius", 0.6), ("length", 2.1), ("size", (1, 2, 3.1))):
        if hasattr(obstacle, key):
            assert obstacle != replace(obstacle, **{key: value})
    assert obstacle != "o"


def test_obstacles_of_different_types_are_unequal() -> None:
    assert Cylinder("o", radius=1, length=2) != Capsule("o", radius=1, length=2)


def test_zeros_of_either_sign_are_equal() -> None:
    plus = Sphere("o", radius=1, position=(0.0, 0, 0))
    minus = Sphere("o", radius=1, position=(-0.0, 0, 0))
    assert plus == minus
    assert hash(plus) == hash(minus)


# Scenes


def obstacles() -> list[Obstacle]:
    return [replace(make(), name=kind) for kind, make in MAKERS.items()]


@pytest.mark.parametrize("container", [list, tuple, iter, Scene])
def test_scene_accepts_any_iterable_of_obstacles(container: type) -> None:
    scene = Scene(container(obstacles()))
    assert scene.obstacles == tuple(obstacles())
    assert [item.name for item in scene] == list(MAKERS)
    assert len(scene) == 4
    assert scene["box"] == obstacles()[1]


def test_a_scene_takes_a_single_obstacle() -> None:
    ball = Sphere("ball", radius=1.0)
    assert Scene(ball) == Scene([ball])  # type: ignore[arg-type]


def test_scene_is_empty_by_default() -> None:
    scene = Scene()
    assert scene.obstacles == ()
    assert len(scene) == 0
    assert scene == Scene([])
    with pytest.raises(SceneError, match="no obstacle 'x'; there are: none"):
        scene["x"]


def test_message_about_an_unknown_obstacle_lists_the_obstacles() -> None:
    with pytest.raises(SceneError, match=r"'x' .*; there are: sphere, box") as caught:
        Scene(obstacles())["x"]
    assert caught.value.obstacle == "x"


def test_scenes_are_frozen_and_equal_by_value() -> None:
    scene = Scene(obstacles())
    with pytest.raises(FrozenInstanceError):
        scene.obstacles = ()  # type: ignore[misc]
    assert scene == Scene(obstacles())
    assert hash(scene) == hash(Scene(obstacles()))
    assert pickle.loads(pickle.dumps(scene)) == scene
    assert scene != Scene(obstacles()[:-1])
    assert scene != Scene(reversed(obstacles()))  # type: ignore[arg-type]
    assert scene != tuple(obstacles())


def test_obstacles_with_equal_names_are_rejected() -> None:
    with pytest.raises(SceneError, match="two obstacles are named 'box'") as caught:
        Scene([*obstacles(), obstacles()[1]])
    assert caught.value.obstacle == "box"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (["a box"], "a scene holds obstacles .*, not str"),
        ([None], "a scene holds obstacles .*, not NoneType"),
        ("boxes", "a scene holds obstacles .*, not str"),
        (None, "a scene holds obstacles .*, not NoneType"),
        (np.array(2.0), "a scene holds obstacles .*, not ndarray"),
    ],
)
def test_wrong_content_of_a_scene_is_rejected(content: object, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        Scene(content)  # type: ignore[arg-type]


def test_moving_obstacle_may_leave_the_region_of_placement() -> None:
    """Regression: long motions ended in an error, though the obstacle began nearby."""
    motion = ConstantVelocity((1, 0, 0))
    box = Box("box", size=(0.1, 0.1, 0.1), motion=motion)
    there = box.frozen(3e6)
    assert there.motion is None
    np.testing.assert_array_equal(there.position, [3e6, 0.0, 0.0])
    with pytest.raises(SceneError, match=r"within 1e\+06"):
        Box("box", size=(0.1, 0.1, 0.1), position=(3e6, 0, 0))
