"""Robots from objects of other libraries, from texts and modules; chains as groups."""

from __future__ import annotations

import copy
import importlib
import pickle
import re
import sys
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest
import trimesh
import yourdfpy
from robot_samples import chain, joint, link, robot, write, write_tetrahedron

import tominpmp as tm
from tominpmp.description.from_pinocchio import _triangles
from tominpmp.dynamics import RobotDynamics
from tominpmp.kinematics import RobotKinematics
from tominpmp.viz.surfaces import robot_bodies

UNALIGNED = np.array([0.0, 0.6, 0.8])


def tree() -> pin.Model:
    """Two arms whose joints are numbered level by level, unlike in a URDF file."""
    rng = np.random.default_rng(0)
    model = pin.Model()
    model.name = "tree"
    kinds = {
        "right1": (0, pin.JointModelRX()),
        "left1": (0, pin.JointModelRevoluteUnaligned(UNALIGNED)),
        "right2": (1, pin.JointModelRUBY()),
        "left2": (2, pin.JointModelPrismaticUnaligned(UNALIGNED)),
    }
    pin.seed(0)
    for name, (parent, kind) in kinds.items():
        place = pin.SE3.Random()
        number = model.addJoint(parent, kind, place, name)
        inertia = pin.Inertia.FromEllipsoid(2.0, 0.1, 0.2, 0.3)
        model.appendBodyToJoint(number, inertia, pin.SE3.Random())
    tool = pin.Frame("tool", 4, 0, pin.SE3.Random(), pin.FrameType.OP_FRAME)
    model.addFrame(tool)
    # The continuous joint has two numbers, cosine and sine, and limits beyond them.
    model.lowerPositionLimit = np.array([-2.0, -1.0, -1.01, -1.01, -0.5])
    model.upperPositionLimit = np.array([2.0, 1.5, 1.01, 1.01, 0.5])
    model.velocityLimit = np.array([1.0, 2.0, 3.0, 1e308])
    model.effortLimit = np.array([10.0, 20.0, 30.0, 40.0])
    low = model.lowerEffortLimit.copy()
    low[3] = -5.0
    model.lowerEffortLimit = low
    model.damping = rng.uniform(0.1, 1.0, 4)
    model.armature = rng.uniform(0.1, 1.0, 4)
    model.friction = np.array([0.0, 0.5, 0.0, 0.0])
    model.gravity.linear = np.array([1.0, 2.0, -3.0])
    q = pin.neutral(model)
    q[0] = 0.25
    model.referenceConfigurations["home"] = q
    return model


def shapes(model: pin.Model) -> pin.GeometryModel:
    """Shapes on the joints, also shapes that neither URDF nor mesh files hold."""
    geometry = pin.GeometryModel()
    corners = np.vstack([np.zeros(3), np.eye(3)])
    solids = [
        coal.Box(0.1, 0.2, 0.3),
        coal.Capsule(0.1, 0.4),
        coal.Ellipsoid(0.1, 0.2, 0.3),
        coal.Cone(0.1, 0.4),
    ]
    mesh = coal.BVHModelOBBRSS()
    mesh.beginModel(4, 4)
    mesh.addSubModel(
        _vectors(corners),
        _faces([(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]),
    )
    mesh.endModel()
    for number, solid in enumerate([*solids, mesh]):
        at = min(number + 1, model.njoints - 1)
        item = pin.GeometryObject(f"shape{number}", at, at, pin.SE3.Random(), solid)
        geometry.addGeometryObject(item)
    return geometry


def _vectors(points: np.ndarray) -> object:
    found = pin.StdVec_Vector3()
    for point in points:
        found.append(point)
    return found


def _faces(faces: list[tuple[int, int, int]]) -> object:
    found = coal.StdVec_Triangle()
    for face in faces:
        found.append(coal.Triangle(*face))
    return found


@pytest.fixture(scope="module")
def model() -> pin.Model:
    return tree()


def full(model: pin.Model, q: np.ndarray) -> np.ndarray:
    """Configuration of the model at joint positions, in the order of the model."""
    return np.array([q[0], q[1], np.cos(q[2]), np.sin(q[2]), q[3]])


def test_pinocchio_model_keeps_joint_order_and_dynamics(model: pin.Model) -> None:
    arm = tm.load_robot(model)
    assert arm.joint_names == ("right1", "left1", "right2", "left2")
    rng = np.random.default_rng(1)
    data = model.createData()
    for q, v, a in rng.uniform(-0.5, 0.5, (5, 3, 4)):
        expected = pin.rnea(model, data, full(model, q), v, a) + model.damping * v
        expected += model.friction * np.sign(v)
        found = RobotDynamics(arm).inverse(q[None], v[None], a[None])[0]
        np.testing.assert_allclose(found, expected, atol=1e-9)
        pin.framesForwardKinematics(model, data, full(model, q))
        for index, frame in enumerate(model.frames[1:], 1):
            found = RobotKinematics(arm).placement(q, frame.name)
            expected = data.oMf[index].homogeneous
            np.testing.assert_allclose(found.homogeneous, expected, atol=1e-12)


@pytest.mark.parametrize("size", [1e-4, 1.0, 100.0])
def test_curved_shapes_are_inside_their_meshes(size: float) -> None:
    turn = np.linspace(0.0, 2.0 * np.pi, 500)
    circle = np.stack([np.cos(turn), np.sin(turn), -2.0 + 0.0 * turn], axis=1)
    cone = size * np.vstack([circle, [[0.0, 0.0, 2.0]]])
    ball = np.random.default_rng(0).normal(size=(2000, 3))
    radii = size * np.array([0.5, 2.0, 1.0])
    ball *= radii / np.linalg.norm(ball, axis=1, keepdims=True)
    for solid, points, volume in (
        (coal.Cone(size, 4.0 * size), cone, 4.0 / 3.0 * np.pi * size**3),
        (coal.Ellipsoid(*radii), ball, 4.0 / 3.0 * np.pi * np.prod(radii)),
    ):
        triangles = _triangles(solid)
        assert triangles is not None
        mesh = trimesh.Trimesh(*triangles, process=False)
        assert mesh.is_watertight and volume < mesh.volume < 1.007 * volume
        heights = np.einsum("kj,kj->k", mesh.face_normals, mesh.triangles[:, 0])
        assert np.all(points @ mesh.face_normals.T <= heights + 1e-9 * size)


def test_all_shapes_of_a_pinocchio_model_are_drawn(model: pin.Model) -> None:
    arm, given = tm.load_robot(model, geometry=shapes(model)), shapes(model)
    drawn = [abs(body.surface.volume) for body in robot_bodies(arm)]
    volumes = [abs(item.geometry.computeVolume()) for item in given.geometryObjects]
    np.testing.assert_allclose(sorted(drawn), sorted(volumes), rtol=0.02)


def test_limits_of_a_pinocchio_model_are_read(model: pin.Model) -> None:
    limits = tm.load_robot(model).limits
    np.testing.assert_array_equal(limits.position_upper, [2.0, 1.5, np.inf, 0.5])
    np.testing.assert_array_equal(limits.velocity, [1.0, 2.0, 3.0, np.inf])
    np.testing.assert_array_equal(limits.effort_lower, [-10.0, -20.0, -30.0, -5.0])
    np.testing.assert_array_equal(limits.effort_upper, [10.0, 20.0, 30.0, 40.0])
    changed = tm.load_robot(model, effort={"left2": 7.0}, gravity=(0, 0, 0))
    assert changed.limits.effort_lower[3] == -7.0
    assert not changed.gravity.any()
    np.testing.assert_array_equal(
        tm.load_robot(model).group_state("home"), [0.25, 0.0, 0.0, 0.0]
    )


def test_robot_of_a_model_has_the_methods_of_other_robots(model: pin.Model) -> None:
    geometry = shapes(model)
    arm = tm.load_robot(model, geometry=geometry)
    for twin in (pickle.loads(pickle.dumps(arm)), copy.deepcopy(arm)):
        assert twin == arm
        assert len(twin.collision_model.geometryObjects) == 5
    assert arm.with_locked({"left1": 0.0}).joint_names == ("right1", "right2", "left2")
    loaded = arm.with_payload(tm.Payload(2.0, "tool"))
    assert loaded.joint_names == arm.joint_names
    pair = tm.combine_robots([("a", arm, (0, 0, 0)), ("b", arm, (9, 0, 0))])
    names = [f"{part}/{name}" for part in "ab" for name in arm.joint_names]
    assert pair.joint_names == tuple(names)
    problem = tm.Problem(arm, [0.0] * 4, tm.JointGoal([0.1] * 4), self_collision=False)
    with pytest.raises(tm.TominpmpError, match="another order of them"):
        tm.save_scenario("never.toml", problem)


def test_shapes_of_a_model_keep_their_placements(model: pin.Model) -> None:
    geometry = shapes(model)
    arm = tm.load_robot((model, geometry, geometry))
    kinds = [type(g.geometry).__name__ for g in arm.collision_model.geometryObjects]
    assert sorted(kinds) == sorted(
        ["Box", "Capsule", "BVHModelOBBRSS", "BVHModelOBBRSS", "BVHModelOBBRSS"]
    )
    assert len(arm.visual_model.geometryObjects) == 5
    data, q = model.createData(), np.array([0.3, -0.2, 0.4, 0.1])
    own = pin.GeometryData(geometry)
    pin.updateGeometryPlacements(model, data, geometry, own, full(model, q))
    twin = arm.model.createData()
    placed = pin.GeometryData(arm.collision_model)
    pin.updateGeometryPlacements(
        arm.model, twin, arm.collision_model, placed, arm.expand(q)
    )
    bounds = [_box(geometry, own, i) for i in range(5)]
    for i in range(5):
        low, high = _box(arm.collision_model, placed, i)
        near = [abs(low - a).max() + abs(high - b).max() for a, b in bounds]
        # A round shape has become a polyhedron around it.
        assert min(near) < 0.01


def _box(
    geometry: pin.GeometryModel, data: pin.GeometryData, index: int
) -> tuple[np.ndarray, np.ndarray]:
    """Corners of the box around a shape, along the axes of the world."""
    request = coal.CollisionObject(
        geometry.geometryObjects[index].geometry,
        coal.Transform3s(data.oMg[index].rotation, data.oMg[index].translation),
    )
    request.computeAABB()
    box = request.getAABB()
    return np.array(box.min_), np.array(box.max_)


def test_collision_pairs_are_those_of_the_model(model: pin.Model) -> None:
    geometry = shapes(model)
    assert tm.load_robot(model, geometry=geometry).srdf.disabled_pairs == ()
    geometry.addAllCollisionPairs()
    assert tm.load_robot(model, geometry=geometry).srdf.disabled_pairs == ()
    geometry.removeCollisionPair(pin.CollisionPair(0, 1))
    found = tm.load_robot(model, geometry=geometry).srdf.disabled_pairs
    assert found == (("left1_link", "right1_link"),)


def test_mimic_joints_of_a_model_follow_their_leader() -> None:
    follow = '<mimic joint="j1" multiplier="-2" offset="0.1"/>'
    text = chain("", follow, axis="0 -0.6 0.8")
    pin_model = pin.buildModelFromXML(text, mimic=True)
    arm, same = tm.load_robot(pin_model), tm.load_robot(text, velocity=3.0)
    assert arm.joint_names == same.joint_names == ("j1",)
    for q in ([0.0], [0.3]):
        found = RobotKinematics(arm).placement(q, "l2").homogeneous
        expected = RobotKinematics(same).placement(q, "l2").homogeneous
        np.testing.assert_allclose(found, expected, atol=1e-12)


@pytest.mark.parametrize(
    ("kind", "match"),
    [
        (pin.JointModelFreeFlyer(), "'odd' is a JointModelFreeFlyer; only"),
        (pin.JointModelSpherical(), "buildReducedModel"),
        (pin.JointModelHX(0.1), "'odd' is a JointModelHX"),
    ],
)
def test_unsupported_joint_types_are_refused(kind: object, match: str) -> None:
    pin_model = pin.Model()
    pin_model.addJoint(0, kind, pin.SE3.Identity(), "odd")
    with pytest.raises(tm.RobotLoadError, match=match):
        tm.load_robot(pin_model)


def test_unsupported_shapes_are_refused(model: pin.Model) -> None:
    geometry = pin.GeometryModel()
    plane = coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)
    item = pin.GeometryObject("floor", 1, 1, pin.SE3.Identity(), plane)
    geometry.addGeometryObject(item)
    with pytest.raises(tm.RobotLoadError, match="'floor' is a Halfspace, expected"):
        tm.load_robot(model, geometry=geometry)


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e7])
def test_models_with_lengths_that_are_not_finite_are_refused(value: float) -> None:
    """Regression: the first joint, and shapes, could be nowhere or far away."""
    for spoilt in ("joint turn", "link turn_link, collision 1", "link turn_link"):
        moved = pin.SE3(np.eye(3), np.array([0.0, value, 0.0]))
        places = {spoilt: moved}
        model, still = pin.Model(), pin.SE3.Identity()
        ends = (np.array([size]) for size in (10.0, 3.0, -3.0, 3.0))
        at = places.get("joint turn", still)
        joint = model.addJoint(0, pin.JointModelRZ(), at, "turn", *ends)
        com = places.get("link turn_link", still).translation
        inertia = pin.Inertia(1.0, com, np.eye(3))
        model.inertias[joint] = inertia
        geometry = pin.GeometryModel()
        at = places.get("link turn_link, collision 1", still)
        item = pin.GeometryObject("ball", joint, 0, at, coal.Sphere(0.1))
        geometry.addGeometryObject(item)
        with pytest.raises(tm.RobotLoadError, match=f"{spoilt}: .* number {value}, "):
            tm.load_robot(model, geometry=geometry)


@pytest.mark.parametrize("name", ["damping", "armature", "friction"])
@pytest.mark.parametrize("value", [-1.0, np.inf, np.nan, 2e150])
def test_losses_that_are_negative_or_not_finite_are_refused(
    name: str, value: float, model: pin.Model
) -> None:
    """Regression: a plan with such a value had no motion, or gained energy."""
    model, values = model.copy(), np.zeros(4)
    values[1] = value
    setattr(model, name, values)
    shown = re.escape(str(value))
    message = rf"{name} is \[0\.0, {shown}, .*numbers from 0 to .*: give {name}="
    with pytest.raises(tm.RobotLoadError, match=message) as caught:
        tm.load_robot(model)
    joint = model.names[2]
    assert f"{{'{joint}': ...}}" in str(caught.value)
    assert getattr(tm.load_robot(model, **{name: {joint: 0.5}}), name).max() == 0.5


def test_contact_points_are_left_out(model: pin.Model) -> None:
    geometry = pin.GeometryModel()
    for name, radius in (("foot", 0.0), ("knee", 0.1)):
        ball = coal.Sphere(radius)
        item = pin.GeometryObject(name, 1, 1, pin.SE3.Identity(), ball)
        geometry.addGeometryObject(item)
    with pytest.warns(tm.TominpmpWarning, match="no size are left out: 'foot'$"):
        arm = tm.load_robot(model, geometry=geometry)
    assert arm.collision_model.ngeoms == 1


@pytest.mark.parametrize("geometry", [5, "x", (1, 2), [None] * 3, np.zeros(3), {}])
def test_invalid_geometry_is_refused(geometry: object, model: pin.Model) -> None:
    with pytest.raises(tm.RobotLoadError, match=r"geometry is .*, expected"):
        tm.load_robot(model, geometry=geometry)
    with pytest.raises(tm.RobotLoadError, match=r"belongs to a pinocchio\.Model"):
        tm.load_robot("planar2r", geometry=geometry)


def test_models_with_geometry_and_robot_wrappers_are_read(tmp_path: Path) -> None:
    path = write(tmp_path, chain("", ""))
    parts = pin.buildModelsFromUrdf(str(path))
    plain = tm.load_robot(path)
    for source in (parts, parts[0], pin.RobotWrapper(*parts)):
        arm = tm.load_robot(source)
        assert arm.joint_names == plain.joint_names
        np.testing.assert_array_equal(arm.limits.velocity, plain.limits.velocity)


def test_urdf_texts_yield_the_same_robot_as_files(tmp_path: Path) -> None:
    text = chain("", "")
    plain = tm.load_robot(write(tmp_path, text))
    declared = f'<?xml version="1.0" encoding="utf-8"?>\n{text}'
    semantic = '<robot name="sample"><group name="a"><joint name="j1"/></group></robot>'
    for given in (text, f"  \n{declared}", declared.encode()):
        arm = tm.load_robot(given)
        assert arm.joint_names == plain.joint_names
        assert arm.limits == plain.limits
        assert tm.load_robot(given, srdf=semantic, group="a").joint_names == ("j1",)
    with pytest.raises(tm.RobotLoadError, match="<sdf>, not <robot>"):
        tm.load_robot("<sdf/>")
    with pytest.raises(tm.RobotLoadError, match="is not XML"):
        tm.load_robot("<robot")


def test_robots_of_yourdfpy_are_read(tmp_path: Path) -> None:
    write_tetrahedron(tmp_path / "meshes" / "a.obj")
    shape = '<mesh filename="meshes/a.obj"/>'
    inside = f"<collision><geometry>{shape}</geometry></collision>"
    text = chain("", "").replace("</inertial>", f"</inertial>{inside}", 1)
    path = write(tmp_path, text)
    parsed = yourdfpy.URDF.load(str(path), load_meshes=False)
    arm, plain = tm.load_robot(parsed), tm.load_robot(path)
    assert arm.limits == plain.limits
    assert len(arm.collision_model.geometryObjects) == 1


def test_modules_of_robot_descriptions_are_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write(tmp_path, chain("", ""), "arm/urdf/arm.urdf")
    with pytest.raises(tm.RobotLoadError, match="pip install robot_descriptions"):
        tm.load_robot("sample_description")
    paths = f"URDF_PATH, PACKAGE_PATH = {str(path)!r}, {str(tmp_path / 'arm')!r}"
    write(tmp_path, "", "robot_descriptions/__init__.py")
    write(tmp_path, paths, "robot_descriptions/sample_description.py")
    write(tmp_path, "SDF_PATH = 'x'", "robot_descriptions/other_mj_description.py")
    write(tmp_path, "import nowhere_at_all", "robot_descriptions/bad_description.py")
    monkeypatch.syspath_prepend(tmp_path)
    names = ["", ".sample_description", ".other_mj_description", ".bad_description"]
    for name in names:  # forgotten again after the test
        monkeypatch.setitem(sys.modules, f"robot_descriptions{name}", None)
        del sys.modules[f"robot_descriptions{name}"]
    module, other = (
        importlib.import_module(f"robot_descriptions{name}") for name in names[1:3]
    )
    for source in (module, "sample_description"):
        arm = tm.load_robot(source)
        assert arm.urdf_path == path
        assert arm.name == "sample_description"
    with pytest.raises(tm.RobotLoadError, match="mean sample_description"):
        tm.load_robot("sampl_description")
    with pytest.raises(tm.RobotLoadError, match=r"cannot be loaded: .*nowhere_at_all"):
        tm.load_robot("bad_description")
    with pytest.raises(
        tm.RobotLoadError, match=r"other_mj_description.* a URDF_PATH, XACRO_PATH"
    ):
        tm.load_robot(other)


@pytest.mark.parametrize("source", [5, None, [], {}, 3.5, np.zeros(2), object(), b"a"])
def test_values_that_are_not_robots_are_refused(source: object) -> None:
    with pytest.raises(tm.RobotLoadError, match=r"expected the name of a robot, the"):
        tm.load_robot(source)


def forked() -> str:
    parts = [link(name) for name in ("base", "l1", "l2", "r1", "r2")]
    ends = {"l1": "base", "l2": "l1", "r1": "base", "r2": "r1"}
    return robot(*parts, *(joint(f"j{c}", p, c) for c, p in ends.items()))


@pytest.mark.parametrize(
    ("group", "joints"),
    [
        ("l2", ("jl1", "jl2")),
        (("l1", "l2"), ("jl2",)),
        (["l1", "r1"], ("jl1", "jr1")),
        (["jr2", "jl1"], ("jl1", "jr2")),
        ({"jr2"}, ("jr2",)),
    ],
)
def test_group_may_be_a_chain_or_joint_names(group: object, joints: tuple) -> None:
    arm = tm.load_robot(forked(), group=group, locked_joints={"jr1": 0.5})
    assert arm.joint_names == tuple(name for name in joints if name != "jr1")
    assert arm.locked_joints["jr1"] == 0.5


@pytest.mark.parametrize("group", ["l9", 3, ["l1", "l9"], ["jl1", 3], [], b"l1", {}])
def test_invalid_groups_are_refused(group: object) -> None:
    with pytest.raises(tm.OptionsError, match=r"no group .*two links") as caught:
        tm.load_robot(forked(), group=group)
    assert caught.value.option == "group"
    with pytest.raises(tm.OptionsError, match="no joint moves 'base'"):
        tm.load_robot(forked(), group="base")


def test_error_suggests_a_similar_group_name() -> None:
    semantic = '<robot name="x"><group name="left"><joint name="jl1"/></group></robot>'
    with pytest.raises(tm.OptionsError, match="did you mean left"):
        tm.load_robot(forked(), srdf=semantic, group="lefft")
