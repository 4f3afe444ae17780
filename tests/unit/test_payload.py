"""Payloads: inertia as Pinocchio adds it, shapes, frames, checks of arguments."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from robot_samples import chain, load, placement, write_tetrahedron

from tominpmp.collision.checker import CollisionChecker
from tominpmp.dynamics import RobotDynamics
from tominpmp.exceptions import FrameNotFound, ProblemError
from tominpmp.goals.joints import JointGoal
from tominpmp.problem.problem import Problem
from tominpmp.robot.payload import Payload
from tominpmp.robot.robot import Robot, load_robot
from tominpmp.scene.meshes import Mesh
from tominpmp.scene.obstacles import Box, Capsule, Cylinder, Sphere
from tominpmp.scene.scene import Scene

INERTIA = np.array([[0.02, 0.001, 0.002], [0.001, 0.03, 0.003], [0.002, 0.003, 0.025]])
COM = (0.01, 0.02, 0.1)
TURN = pin.exp3(np.array([0.3, -0.2, 0.9]))
SHAPES = (
    Box("crate", size=(0.05, 0.06, 0.2), position=(0, 0, 0.15), rotation=TURN),
    Capsule("pill", radius=0.02, length=0.1, position=(0, 0.1, 0.2)),
    Cylinder("can", radius=0.03, length=0.1, position=(0.1, 0, 0.2)),
    Sphere("ball", radius=0.04),
)


@pytest.fixture(scope="module")
def panda() -> Robot:
    return load_robot(
        "panda", limits="urdf", locked_joints={"panda_finger_joint1": 0.03}
    )


@pytest.fixture(scope="module")
def loaded(panda: Robot) -> Robot:
    return panda.with_payload(Payload(1.5, "panda_hand", COM, INERTIA, SHAPES))


def test_inertia_is_added_to_the_link(
    panda: Robot, loaded: Robot, rng: np.random.Generator
) -> None:
    model = panda.model.copy()
    frame = model.frames[model.getBodyId("panda_hand")]
    body = pin.Inertia(1.5, np.array(COM), INERTIA)
    model.appendBodyToJoint(frame.parentJoint, body, frame.placement)
    q, v, a = rng.normal(size=(3, 7))
    expected = pin.rnea(model, model.createData(), q, v, a) + panda.damping * v
    found = RobotDynamics(loaded).inverse(q[None], v[None], a[None])[0]
    np.testing.assert_allclose(found, expected, atol=1e-12)
    without = RobotDynamics(panda).inverse(q[None], v[None], a[None])[0]
    assert np.abs(found - without).max() > 1.0


def test_payload_equals_a_link_fixed_in_the_file(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    plain = chain("", "")
    moments = " ".join(
        f'i{one}{other}="{INERTIA["xyz".index(one), "xyz".index(other)]}"'
        for one, other in ("xx", "xy", "xz", "yy", "yz", "zz")
    )
    link = (
        '<link name="tool"><inertial><origin xyz="0.01 0.02 0.1"/><mass value="1.5"/>'
        f'<inertia {moments}/></inertial></link><joint name="weld" type="fixed">'
        '<parent link="l2"/><child link="tool"/></joint>'
    )
    welded = load(tmp_path, plain.replace("</robot>", f"{link}</robot>"))
    robot = load(tmp_path, plain).with_payload(Payload(1.5, "j2", COM, INERTIA))
    q, v, a = rng.normal(size=(3, 4, 2))
    np.testing.assert_allclose(
        RobotDynamics(robot).inverse(q, v, a),
        RobotDynamics(welded).inverse(q, v, a),
        atol=1e-13,
    )


def test_robot_with_a_payload_keeps_joints_limits_and_changes(
    panda: Robot, loaded: Robot
) -> None:
    assert loaded.joint_names == panda.joint_names
    assert loaded.limits == panda.limits
    assert loaded != panda
    assert pickle.loads(pickle.dumps(loaded)) == loaded
    slow = panda.with_changes(velocity=1.0, armature=0.1, gravity=(0, 1, 0))
    changed = slow.with_payload(Payload(2.0, "panda_hand"))
    np.testing.assert_array_equal(changed.limits.velocity, 1.0)
    np.testing.assert_array_equal(changed.model.armature, 0.1)
    np.testing.assert_array_equal(changed.model.gravity.linear, (0, 1, 0))
    assert changed.with_changes(velocity=2.0).frame_id("payload")
    mass = sum(i.mass for i in changed.model.inertias)
    assert mass == pytest.approx(sum(i.mass for i in panda.model.inertias) + 2.0)


def test_mimic_joints_still_follow_with_a_payload() -> None:
    panda = load_robot("panda", limits="urdf")
    loaded = panda.with_payload(Payload(0.1, "panda_leftfinger"))
    assert panda.expansion_matrix is not None
    np.testing.assert_array_equal(loaded.expand(np.ones(8)), panda.expand(np.ones(8)))


def test_payload_is_a_frame(panda: Robot, loaded: Robot) -> None:
    q = [0.1, -0.5, 0.2, -2.0, 0.3, 1.5, 0.7]
    hand, carried = placement(panda, q, "panda_hand"), placement(loaded, q, "payload")
    assert carried.isApprox(hand, 1e-12)


def test_shapes_have_their_placements_on_the_link(panda: Robot, loaded: Robot) -> None:
    hand = panda.model.frames[panda.model.getBodyId("panda_hand")]
    for geometry in (loaded.collision_model, loaded.visual_model):
        found = list(geometry.geometryObjects)[-len(SHAPES) :]
        for item, shape in zip(found, SHAPES, strict=True):
            placed = pin.SE3(np.array(shape.rotation), np.array(shape.position))
            assert item.parentJoint == hand.parentJoint
            assert item.placement.isApprox(hand.placement * placed, 1e-12)
    shapes = [item.geometry for item in loaded.collision_model.geometryObjects]
    kinds = [type(shape).__name__ for shape in shapes[-4:]]
    assert kinds == ["Box", "Capsule", "Cylinder", "Sphere"]


@pytest.mark.parametrize("pitch", [np.pi / 2, -np.pi / 2, np.pi / 2 - 1e-7, 0.3])
def test_rotated_shapes_keep_their_rotation(panda: Robot, pitch: float) -> None:
    turn = pin.rpy.rpyToMatrix(0.4, pitch, -1.2)
    box = Box("box", size=(1, 1, 1), rotation=turn)
    robot = panda.with_payload(Payload(1.0, "panda_link0", geometry=[box]))
    found = list(robot.collision_model.geometryObjects)[-1].placement.rotation
    np.testing.assert_allclose(found, turn, atol=1e-9)


def test_payload_meshes_come_from_files_with_a_scale(
    panda: Robot, tmp_path: Path
) -> None:
    file = write_tetrahedron(tmp_path / "tip.obj")
    mesh = Mesh("tip", path=file, scale=0.1, position=(0, 0, 0.1))
    robot = panda.with_payload(Payload(1.0, "panda_hand", geometry=[mesh]))
    item = list(robot.collision_model.geometryObjects)[-1]
    np.testing.assert_allclose(item.meshScale, 0.1)
    assert item.meshPath == str(file)
    arrays = Mesh("tip", vertices=mesh.vertices, triangles=mesh.triangles)
    with pytest.raises(ProblemError, match=r"holds Mesh.*, expected a list of Box"):
        Payload(1.0, "panda_hand", geometry=[arrays])


def test_shapes_may_be_of_a_callers_subclass(panda: Robot) -> None:
    """Regression: subclasses ended in a KeyError, although scenes accept them."""

    class Crate(Box):
        pass

    size = (0.1, 0.2, 0.3)
    crate = Payload(1.0, "panda_hand", geometry=[Crate("crate", size=size)])
    shapes = panda.with_payload(crate).collision_model.geometryObjects
    assert (2.0 * shapes[len(shapes) - 1].geometry.halfSide).tolist() == list(size)


def test_payload_is_checked_against_obstacles_and_distant_links(loaded: Robot) -> None:
    post = Sphere("post", radius=0.1, position=(0.8, 0, 0.3))
    checker = CollisionChecker(loaded, Scene([post]), self_collision=True)
    mates = {name for pair in checker.pairs for name in pair if "payload" in pair} - {
        "payload"
    }
    assert mates == {"post", *(f"panda_link{i}" for i in range(6))}


def test_payload_in_collision_or_too_heavy_is_refused(
    panda: Robot, loaded: Robot
) -> None:
    q = np.array([0.1, -0.5, 0.2, -2.0, 0.3, 1.5, 0.7])
    place = placement(loaded, q.tolist(), "payload").act(np.array([0, 0.1, 0.2]))
    post = Scene([Sphere("post", radius=0.03, position=place)])
    Problem(panda, q, JointGoal(q + 0.1), post)
    with pytest.raises(ProblemError, match="'payload' and obstacle 'post' overlap"):
        Problem(loaded, q, JointGoal(q + 0.1), post)
    heavy = panda.with_payload(Payload(40.0, "panda_hand"))
    with pytest.raises(ProblemError, match="cannot hold the arm"):
        Problem(heavy, q, JointGoal([0, 1.2, 0, -0.3, 0, 1.5, 0]))


def test_two_payloads_need_two_names(loaded: Robot) -> None:
    with pytest.raises(
        ProblemError, match="'payload', expected a name that no"
    ) as caught:
        loaded.with_payload(Payload(1.0, "panda_hand"))
    assert caught.value.field == "payload.name"
    both = loaded.with_payload(Payload(1.0, "payload", name="tip"))
    assert both.frame_id("tip")


def test_payload_of_unknown_frame_or_wrong_type_is_refused(panda: Robot) -> None:
    with pytest.raises(FrameNotFound, match="no frame 'gripper'"):
        panda.with_payload(Payload(1.0, "gripper"))
    with pytest.raises(ProblemError, match=r"payload is 1\.0, expected a Payload"):
        panda.with_payload(1.0)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("values", "field"),
    [
        ({"mass": -1.0}, "mass"),
        ({"mass": np.nan}, "mass"),
        ({"mass": "1"}, "mass"),
        ({"frame": ""}, "frame"),
        ({"name": None}, "name"),
        ({"com": (1, 2)}, "com"),
        ({"com": (1, 2, np.inf)}, "com"),
        ({"inertia": np.ones(3)}, "inertia"),
        ({"inertia": np.diag([1.0, 1.0, 3.0])}, "inertia"),
        ({"inertia": np.diag([1.0, 1.0, -0.1])}, "inertia"),
        ({"inertia": np.triu(np.ones((3, 3)))}, "inertia"),
        ({"geometry": 5}, "geometry"),
        ({"geometry": ["box"]}, "geometry"),
    ],
)
def test_bad_values_are_refused(values: dict[str, object], field: str) -> None:
    arguments = {"mass": 1.0, "frame": "panda_hand"} | values
    with pytest.raises(ProblemError, match=rf"^payload\.{field} ") as caught:
        Payload(**arguments)  # type: ignore[arg-type]
    assert caught.value.field == f"payload.{field}"


def test_capsules_are_capsules_in_both_geometry_models(planar3r: Robot) -> None:
    body = Payload(1.0, "tip", geometry=Capsule("c", radius=0.05, length=0.2))
    arm = planar3r.with_payload(body)
    for shapes in (arm.collision_model, arm.visual_model):
        item = shapes.geometryObjects[-1]
        assert item.name == "payload_0"
        assert type(item.geometry).__name__ == "Capsule"
        assert (item.geometry.radius, item.geometry.halfLength) == (0.05, 0.1)
