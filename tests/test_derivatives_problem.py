"""Analytic derivatives of dynamics, kinematics, goals and distances against
differences.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from distance_gradients import gradients
from numpy.typing import NDArray

from tominpmp.collision.checker import CollisionChecker
from tominpmp.constraints.clearance import ClearanceConstraint
from tominpmp.dynamics import RobotDynamics
from tominpmp.goals.base import Goal
from tominpmp.goals.frames import PoseGoal, PositionGoal
from tominpmp.goals.joints import JointGoal
from tominpmp.kinematics import FrameMotions, RobotKinematics
from tominpmp.robot.robot import Robot, load_robot
from tominpmp.scene.obstacles import Box, Capsule, Cylinder, Obstacle, Sphere
from tominpmp.scene.scene import Scene

Array = NDArray[np.float64]

# Largest difference, as a share of the largest entry or of 1.
SMOOTH = 1e-6
# Distances come from iterations: with this step, their noise is a millionth in the
# differences if the bodies are apart, but a hundredth in the depth of curved bodies.
STEP = 1e-4  # [rad or m]
APART = 1e-5
DEEP = {"ball": 5e-4, "pill": 5e-4, "crate": 1e-5, "can": 2e-2}
# One-sided differences that differ by more than this have a kink between them, for
# example where another edge of a box becomes the nearest; the gradient is between them.
KINK = 0.02

ARMS = ("planar3r", "ur5", "panda", "tree")
# A frame at the end of each arm, and a link in its middle.
TIPS = {"planar3r": "tip", "ur5": "ee_link", "panda": "panda_leftfinger", "tree": "l5"}
MIDDLES = {
    "planar3r": "link2",
    "ur5": "forearm_link",
    "panda": "panda_link4",
    "tree": "l2",
}


def random_tree(rng: np.random.Generator) -> str:
    """Two branches with revolute and prismatic joints, one of which is a
    mimic joint.
    """
    parents = {1: 0, 2: 1, 3: 2, 4: 1, 5: 4, 6: 4}
    parts = ['<link name="l0"/>']
    for child, parent in parents.items():
        mass, size = rng.uniform(0.5, 3.0), rng.uniform(0.02, 0.2, 3)
        moments = mass * (np.sum(size**2) - size**2)
        axis, origin, centre, rpy = rng.normal(size=(4, 3))
        kind = "prismatic" if child in (2, 6) else "revolute"
        mimic = (
            '<mimic joint="j2" multiplier="-0.7" offset="0.1"/>' if child == 6 else ""
        )
        triple = "{:.6f} {:.6f} {:.6f}".format
        parts.append(
            f'<link name="l{child}"><inertial><mass value="{mass:.4f}"/>'
            f'<origin xyz="{triple(*(0.1 * centre))}" rpy="{triple(*rpy)}"/>'
            f'<inertia ixx="{moments[0]:.6f}" iyy="{moments[1]:.6f}" '
            f'izz="{moments[2]:.6f}" ixy="0" ixz="0" iyz="0"/></inertial>'
            f'<collision><origin xyz="{triple(*(0.1 * centre))}"/>'
            f'<geometry><box size="0.1 0.2 0.3"/></geometry></collision></link>'
            f'<joint name="j{child}" type="{kind}"><parent link="l{parent}"/>'
            f'<child link="l{child}"/><axis xyz="{triple(*axis)}"/>'
            f'<origin xyz="{triple(*(0.3 * origin))}" rpy="{triple(*rpy)}"/>'
            f'<limit lower="-2" upper="2" effort="50" velocity="3"/>'
            f'<dynamics damping="{rng.uniform(0.1, 20):.4f}"/>{mimic}</joint>'
        )
    return f'<robot name="tree">{"".join(parts)}</robot>'


@pytest.fixture(scope="module", params=ARMS)
def arm(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Robot:
    if request.param != "tree":
        return load_robot(request.param)  # the panda with its fingers free: 8 joints
    rng = np.random.default_rng(5)
    path: Path = tmp_path_factory.mktemp("tree") / "tree.urdf"
    path.write_text(random_tree(rng), encoding="utf-8")
    return load_robot(
        path, armature=list(rng.uniform(0.01, 0.5, 5)), gravity=(1, -2, 9)
    )


def state(arm: Robot, rng: np.random.Generator) -> tuple[Array, Array]:
    """Positions within the limits, and velocities."""
    lower = np.maximum(arm.limits.position_lower, -3.0)
    upper = np.minimum(arm.limits.position_upper, 3.0)
    return rng.uniform(lower, upper), rng.normal(size=arm.n)


def difference(function: Callable[[Array], Array], x: Array, step: float) -> Array:
    """Central differences, the coordinates of x last."""
    ways = step * np.eye(x.size)
    columns = [(function(x + d) - function(x - d)) / (2.0 * step) for d in ways]
    return np.stack(columns, axis=-1)


def assert_derivative(
    analytic: Array, function: Callable[[Array], Array], x: Array, step: float = 1e-6
) -> None:
    numeric = difference(function, x, step)
    scale = max(1.0, float(np.abs(numeric).max()))
    np.testing.assert_allclose(analytic, numeric, rtol=0.0, atol=SMOOTH * scale)


def test_panda_has_a_mimic_joint() -> None:
    panda = load_robot("panda", limits="urdf")
    assert panda.n == 8
    assert panda.model.nv == 9


# Dynamics


def test_forward_dynamics_derivatives_match_differences(
    arm: Robot, rng: np.random.Generator
) -> None:
    dynamics, n = RobotDynamics(arm), arm.n
    for _ in range(3):
        x = np.concatenate(state(arm, rng))
        u = rng.uniform(arm.limits.effort_lower, arm.limits.effort_upper)
        jacobians = dynamics.forward_jacobians(x[None], u[None])
        assert jacobians.f_x.shape == (1, 2 * n, 2 * n)
        assert jacobians.f_u.shape == (1, 2 * n, n)
        assert_derivative(
            jacobians.f_x[0], lambda y, u=u: dynamics.forward(y[None], u[None])[0], x
        )
        assert_derivative(
            jacobians.f_u[0],
            lambda w, x=x: dynamics.forward(x[None], w[None])[0],
            u,
            1e-3,
        )
        np.testing.assert_allclose(
            jacobians.f, dynamics.forward(x[None], u[None]), rtol=1e-9, atol=1e-9
        )


def test_inverse_dynamics_derivatives_match_differences(
    arm: Robot, rng: np.random.Generator
) -> None:
    dynamics = RobotDynamics(arm)

    def torque(q: Array, v: Array, a: Array) -> Array:
        return dynamics.inverse(q[None], v[None], a[None])[0]

    for _ in range(3):
        (q, v), a = state(arm, rng), rng.normal(size=arm.n)
        jacobians = dynamics.inverse_jacobians(q[None], v[None], a[None])
        # Torques near zero are differences of torques that are not.
        found, expected = jacobians.tau[0], torque(q, v, a)
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)
        assert_derivative(jacobians.tau_q[0], lambda y, v=v, a=a: torque(y, v, a), q)
        assert_derivative(jacobians.tau_v[0], lambda y, q=q, a=a: torque(q, y, a), v)
        assert_derivative(jacobians.tau_a[0], lambda y, q=q, v=v: torque(q, v, y), a)


# Kinematics and goals


def test_frame_jacobian_matches_differences(
    arm: Robot, rng: np.random.Generator
) -> None:
    kinematics, frame = RobotKinematics(arm), TIPS[arm.name]
    q, _ = state(arm, rng)
    place = kinematics.placement(q, frame)

    def twist(y: Array) -> Array:
        return np.asarray(pin.log6(place.actInv(kinematics.placement(y, frame))).vector)

    local = kinematics.jacobian(q, frame, local=True)
    assert_derivative(local, twist, q)
    turned = np.vstack([place.rotation @ local[:3], place.rotation @ local[3:]])
    np.testing.assert_allclose(kinematics.jacobian(q, frame), turned, atol=1e-12)


def test_frame_velocity_derivatives_match_differences(
    arm: Robot, rng: np.random.Generator
) -> None:
    kinematics, frame = RobotKinematics(arm), TIPS[arm.name]
    motions = FrameMotions(arm, frame)

    def velocity(q: Array, v: Array) -> Array:
        return motions.velocities(q[None], v[None])[0]

    for _ in range(3):
        q, v = state(arm, rng)
        found, by_q, by_v = (x[0] for x in motions.velocity_slopes(q[None], v[None]))
        along = difference(
            lambda s, q=q, v=v: kinematics.placement(q + s * v, frame).translation,
            np.zeros(1),
            1e-6,
        )
        np.testing.assert_allclose(found, along[:, 0], atol=1e-8)
        np.testing.assert_array_equal(found, velocity(q, v))
        assert_derivative(by_q, lambda y, v=v: velocity(y, v), q)
        assert_derivative(by_v, lambda y, q=q: velocity(q, y), v)


def goals(arm: Robot, rng: np.random.Generator) -> list[Goal]:
    """Goals of all types, at rest and moving, that the arm does not satisfy."""
    frame, velocity = TIPS[arm.name], rng.normal(size=3)
    pose = pin.SE3.Random()
    pose.translation, turn = rng.normal(size=3), rng.normal(size=4)
    pose.rotation = pin.Quaternion(turn / np.linalg.norm(turn)).toRotationMatrix()
    return [
        JointGoal(rng.normal(size=arm.n)),
        JointGoal(rng.normal(size=arm.n), rng.normal(size=arm.n)),
        PositionGoal(frame, rng.normal(size=3)),
        PositionGoal(frame, rng.normal(size=3), velocity),
        PoseGoal(frame, pose),
        PoseGoal(frame, pose, velocity),
    ]


@pytest.mark.parametrize("kind", range(6))
def test_goal_derivatives_match_differences(
    arm: Robot, kind: int, rng: np.random.Generator
) -> None:
    goal, kinematics = goals(arm, rng)[kind], RobotKinematics(arm)
    for _ in range(3):
        q, v = state(arm, rng)
        residual = goal.residual(kinematics, q, v)
        if isinstance(goal, PoseGoal) and np.linalg.norm(residual.value[3:6]) > 2.8:
            continue  # the logarithm of half a turn is not differentiable
        k = residual.value.size
        assert residual.by_q.shape == residual.by_v.shape == (k, arm.n)
        assert_derivative(
            residual.by_q, lambda y, v=v: goal.residual(kinematics, y, v).value, q
        )
        assert_derivative(
            residual.by_v, lambda y, q=q: goal.residual(kinematics, q, y).value, v
        )


# Distances


def obstacles_at(point: Array, size: float, rng: np.random.Generator) -> list[Obstacle]:
    """One obstacle of each type at the same place, each with another rotation."""
    turns = rng.normal(size=(3, 4))
    return [
        Sphere("ball", radius=0.5 * size, position=point),
        Box(
            "crate",
            size=size * np.array([1.5, 1.0, 1.2]),
            position=point,
            rotation=turns[0],
        ),
        Capsule(
            "pill", radius=0.5 * size, length=size, position=point, rotation=turns[1]
        ),
        Cylinder(
            "can", radius=0.5 * size, length=size, position=point, rotation=turns[2]
        ),
    ]


def middle(arm: Robot, q: Array) -> Array:
    """A point within a link in the middle of an arm."""
    frame = MIDDLES[arm.name]
    for item in arm.collision_model.geometryObjects:
        if arm.model.frames[item.parentFrame].name == frame:
            data = arm.model.createData()
            pin.forwardKinematics(arm.model, data, arm.expand(q))
            item.geometry.computeLocalAABB()
            centre = item.placement.act(np.asarray(item.geometry.aabb_center))
            return np.asarray(data.oMi[item.parentJoint].act(centre))
    raise LookupError(frame)


def compared(checker: CollisionChecker, q: Array) -> tuple[Array, Array, Array]:
    """Distances, errors of the gradients, and the spread of one-sided differences."""
    pairs = np.arange(len(checker.pairs))
    steps = STEP * np.eye(q.size)
    values = checker.distances(np.vstack([q[None], q + steps, q - steps]))
    here, ahead, behind = values[0], values[1 : q.size + 1], values[q.size + 1 :]
    numeric = (ahead - behind).T / (2.0 * STEP)
    bend = np.abs(ahead + behind - 2.0 * here).max(axis=0) / STEP
    error = np.abs(gradients(checker, q, pairs) - numeric).max(axis=1)
    return here, error, bend


def test_gradients_of_positive_distances_match_differences(
    arm: Robot, rng: np.random.Generator
) -> None:
    errors, bends = [], []
    for _ in range(8):
        q, _ = state(arm, rng)
        scene = Scene(obstacles_at(rng.normal(size=3), 0.2, rng))
        distance, error, bend = compared(CollisionChecker(arm, scene), q)
        apart = distance > 2.0 * STEP
        assert np.all(error[apart] < APART + 2.0 * bend[apart])
        errors += error[apart & (bend < KINK)].tolist()
        bends += bend[apart].tolist()
    assert len(bends) >= 8 * 4 * 2
    assert len(errors) >= 0.9 * len(bends)
    assert np.quantile(errors, 0.9) < APART


def test_gradients_of_penetration_depths_match_differences(
    arm: Robot, rng: np.random.Generator
) -> None:
    size = 0.3 if arm.name != "planar3r" else 1.5
    errors, bends = [], []
    for _ in range(12):
        q, _ = state(arm, rng)
        point = middle(arm, q) + rng.normal(size=3) * 0.1 * size
        checker = CollisionChecker(arm, Scene(obstacles_at(point, size, rng)))
        distance, error, bend = compared(checker, q)
        for i in np.flatnonzero(distance < -2.0 * STEP):
            allowed = DEEP[checker.pairs[i][1]]
            assert error[i] < allowed + 2.0 * bend[i], checker.pairs[i]
            bends.append(bend[i])
            if bend[i] < KINK:
                errors.append(error[i] / allowed)
    assert len(bends) >= 30
    assert len(errors) >= 0.7 * len(bends)
    assert np.quantile(errors, 0.9) < 1.0


def test_distance_gradient_leads_out_of_an_overlap(
    arm: Robot, rng: np.random.Generator
) -> None:
    size = 0.3 if arm.name != "planar3r" else 1.5
    found = 0
    for _ in range(6):
        q, _ = state(arm, rng)
        point = middle(arm, q) + rng.normal(size=3) * 0.1 * size
        checker = CollisionChecker(arm, Scene(obstacles_at(point, size, rng)))
        distance = checker.distances(q[None])[0]
        overlapping = np.flatnonzero(distance < -1e-3)
        for i, way in zip(overlapping, gradients(checker, q, overlapping), strict=True):
            slope = np.linalg.norm(way)
            if slope < 0.02:
                continue  # the link hardly moves, or the way out leaves the plane
            found += 1
            after = checker.distances((q + 1e-4 * way / slope)[None])[0, i]
            assert after > distance[i] + 0.5e-4 * slope
    assert found >= 12


@pytest.mark.parametrize("depth", [0.0, 1e-9, 1e-4, 0.05])
def test_distance_gradient_is_continuous_through_contact(
    arm: Robot, depth: float, rng: np.random.Generator
) -> None:
    """The radius of a ball changes the distance to the ball, but not its gradient."""
    q, _ = state(arm, rng)
    index = np.zeros(1, dtype=np.int64)
    for _ in range(4):
        centre = middle(arm, q) + rng.normal(size=3) * 1.0
        checker = CollisionChecker(
            arm, Scene([Sphere("o", radius=1e-3, position=centre)])
        )
        nearest = np.argmin(checker.distances(q[None])[0])
        index[0] = nearest
        distance = checker.distances(q[None])[0, nearest]
        if distance < 0.05:
            continue
        apart = gradients(checker, q, index)
        radius = 1e-3 + distance + depth
        touching = Scene([Sphere("o", radius=radius, position=centre)])
        checker = CollisionChecker(arm, touching)
        np.testing.assert_allclose(
            checker.distances(q[None])[0, nearest], -depth, atol=1e-8
        )
        np.testing.assert_allclose(gradients(checker, q, index), apart, atol=1e-5)


def test_clearance_constraint_derivatives_match_differences(
    arm: Robot, rng: np.random.Generator
) -> None:
    q, _ = state(arm, rng)
    scene = Scene(obstacles_at(rng.normal(size=3), 0.2, rng)[:2])
    checker = CollisionChecker(arm, scene)
    constraint = ClearanceConstraint(checker, margin=0.03, length=0.8)
    which = np.arange(constraint.count)
    _, _, bend = compared(checker, q)
    plain = bend < KINK
    numeric = difference(lambda y: constraint.values(y[None])[0], q, STEP)
    error = np.abs(gradients(constraint, q, which) - numeric).max(axis=1)
    assert np.sum(plain) >= constraint.count // 2
    assert error[plain].max() < APART / 0.8
