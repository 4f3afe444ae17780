"""Distances with a cutoff: exact below the cutoff, lower bounds above it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin
import pytest
from distance_gradients import gradients

from tominpmp.collision.broad import BALLS, BoundingVolumes
from tominpmp.collision.checker import CollisionChecker
from tominpmp.collision.placements import JointPlacements
from tominpmp.constraints.clearance import ClearanceConstraint
from tominpmp.robot.robot import Robot, load_robot
from tominpmp.scene.motion import ConstantVelocity
from tominpmp.scene.obstacles import Box, Capsule, Cylinder, Obstacle, Sphere
from tominpmp.scene.scene import Scene

# Exact queries end within Coal's tolerances [m]; penetration depths are less precise.
EXACT = 1e-8
DEPTHS = 5e-6


@pytest.fixture(scope="module")
def panda() -> Robot:
    return load_robot(
        "panda", limits="urdf", locked_joints={"panda_finger_joint1": 0.03}
    )


def clutter(rng: np.random.Generator, number: int = 8) -> Scene:
    """A table, a pole, and obstacles around the base of the arm in random poses."""
    obstacles: list[Obstacle] = [
        Box("table", size=(1.2, 1.6, 0.05), position=(0.6, 0.0, -0.1)),
        Cylinder("pole", radius=0.03, length=1.5, position=(0.45, 0.3, 0.5)),
    ]
    for i in range(number):
        name, size = f"o{i}", rng.uniform(0.05, 0.4, size=3)
        # So far away that no obstacle is always in contact.
        angle, away = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.45, 1.0)
        height = rng.uniform(-0.2, 1.0)
        position = [away * np.cos(angle), away * np.sin(angle), height]
        place = {"position": position, "rotation": rng.normal(size=4)}
        thin = 0.3 * float(size[0])
        obstacles.append(
            (
                Box(name, size=size, **place),
                Cylinder(name, radius=thin, length=size[1], **place),
                Capsule(name, radius=thin, length=size[1], **place),
                Sphere(name, radius=thin, position=position),
            )[i % 4]
        )
    return Scene(obstacles)


def configurations(arm: Robot, count: int, rng: np.random.Generator) -> np.ndarray:
    low, high = arm.limits.position_lower, arm.limits.position_upper
    return rng.uniform(np.maximum(low, -3.0), np.minimum(high, 3.0), (count, arm.n))


def motion(arm: Robot, count: int, rng: np.random.Generator) -> np.ndarray:
    ends = configurations(arm, 2, rng)
    share = np.linspace(0.0, 1.0, count)[:, None]
    bend = np.sin(np.pi * share) * 0.3 * rng.normal(size=arm.n)
    return np.asarray(ends[0] + share * (ends[1] - ends[0]) + bend)


def check(
    found: np.ndarray, exact: np.ndarray, cutoff: float | np.ndarray
) -> np.ndarray:
    """Assert exact distances below the cutoff, and lower bounds beyond it.

    Returns the entries that are mere bounds.
    """
    cutoff = np.broadcast_to(cutoff, exact.shape)
    near = exact < cutoff - DEPTHS
    error = np.abs(found - exact)
    assert np.all(error[near & (exact > 0.0)] < EXACT)
    assert np.all(error[near] < DEPTHS)
    assert np.all(found <= exact + DEPTHS)
    assert np.all(found[~near] >= cutoff[~near] - DEPTHS)
    return np.asarray(error > EXACT)


# Balls and boxes


@pytest.mark.parametrize("count", [1, 2, 3, 4, 8, 40])
def test_bounding_volumes_contain_their_points(
    count: int, rng: np.random.Generator
) -> None:
    for _ in range(20):
        points = rng.normal(size=(count, 3)) * rng.uniform(0.0, 1.0, size=3)
        points += rng.normal(size=3)
        found = BoundingVolumes.of(points, 0.1)
        assert np.linalg.det(found.R) == pytest.approx(1.0)
        weights = rng.dirichlet(np.full(count, 0.3), size=200)
        inside = (weights @ points - found.t) @ found.R
        assert np.all(np.abs(inside) <= found.half + 1e-9)
        assert np.all(np.linalg.norm(inside, axis=1) <= found.radius - 0.1 + 1e-9)
        away = np.linalg.norm(inside[:, None] - found.centres, axis=2)
        assert np.all(np.min(away, axis=1) <= found.cover - 0.1 + 1e-9)
        assert found.swell == 0.1


def test_bounding_balls_of_a_stick_are_small() -> None:
    stick = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    found = BoundingVolumes.of(stick, 0.05)
    assert found.radius == pytest.approx(0.55)
    assert found.cover == pytest.approx(0.5 / BALLS + 0.05)


@pytest.mark.filterwarnings("ignore:.*safety_controller")
@pytest.mark.parametrize("name", ["panda", "ur5", "planar3r", "tiago"])
def test_joint_placements_and_jacobians_match_pinocchio(
    name: str, rng: np.random.Generator
) -> None:
    arm = load_robot(name)
    q = arm.expand(configurations(arm, 4, rng))
    model, data = arm.model, arm.model.createData()
    placements = JointPlacements(model)
    R, t = placements.joints(q)
    for i, row in enumerate(q):
        pin.computeJointJacobians(model, data, row)
        for joint in range(model.njoints):
            place = data.oMi[joint]
            np.testing.assert_allclose(R[i, joint], place.rotation, atol=1e-12)
            np.testing.assert_allclose(t[i, joint], place.translation, atol=1e-12)
    joint = np.array([model.njoints - 1, model.njoints // 2, 0])
    point, normal = rng.normal(size=(3, 3)), rng.normal(size=(3, 3))
    instants = np.array([2, 0, 1])
    found = placements.jacobian_rows((R, t), instants, joint, point, normal)
    for k in range(2):
        pin.computeJointJacobians(model, data, q[instants[k]])
        jacobian = pin.getJointJacobian(
            model, data, int(joint[k]), pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        )
        lever = np.cross(point[k] - t[instants[k], joint[k]], normal[k])
        expected = normal[k] @ jacobian[:3] + lever @ jacobian[3:]
        np.testing.assert_allclose(found[k], expected, atol=1e-12)
    assert not np.any(found[2])  # the world does not move


# Cutoffs


@pytest.mark.parametrize("cutoff", [-0.05, 0.0, 0.02, 0.1, 0.5])
def test_distances_with_a_cutoff_are_exact_or_lower_bounds(
    panda: Robot, cutoff: float, rng: np.random.Generator
) -> None:
    checker = CollisionChecker(panda, clutter(rng), self_collision=True)
    q = configurations(panda, 60, rng)
    exact = checker.distances(q)
    bounds = check(checker.distances(q, cutoff), exact, cutoff)
    if cutoff < 0.05:
        assert np.mean(bounds) > 0.8
    assert np.any(exact < -0.02)


def test_cutoff_may_differ_for_each_pair(
    panda: Robot, rng: np.random.Generator
) -> None:
    checker = CollisionChecker(panda, clutter(rng), self_collision=True)
    q = configurations(panda, 20, rng)
    exact, count = checker.distances(q), len(checker.pairs)
    # Every pair has as many distances below its cutoff as another beyond it.
    cutoff = np.sort(exact, axis=0)[rng.integers(20, size=count), np.arange(count)]
    bounds = check(checker.distances(q, cutoff), exact, cutoff)
    assert 0.1 < np.mean(bounds) < 0.9


@pytest.mark.parametrize("name", ["panda", "ur5", "planar3r"])
def test_distances_with_a_cutoff_hold_along_motions(
    name: str, rng: np.random.Generator
) -> None:
    arm = load_robot(name)
    scene = clutter(rng)
    checker = CollisionChecker(arm, scene, self_collision=True, geometry="hull")
    q = motion(arm, 30, rng)
    for step in (0.0, 0.3, 0.1, 0.01, 2.0):
        q = q + step * rng.normal(size=q.shape)
        for cutoff in (0.05, 0.2, 0.0):
            check(checker.distances(q, cutoff), checker.distances(q), cutoff)


def test_distances_of_a_fine_motion_use_bounds_of_groups_of_rows(
    panda: Robot, rng: np.random.Generator
) -> None:
    """Distant pairs are excluded for all rows at once, in any order of the rows."""
    aside = ConstantVelocity(velocity=(0.3, -0.2, 0.1))
    drone = Box("drone", size=(0.2, 0.1, 0.1), position=(0.5, 0.2, 0.5), motion=aside)
    scene = Scene([*clutter(rng).obstacles, drone])
    checker = CollisionChecker(panda, scene, self_collision=True)
    q, times = motion(panda, 150, rng), np.linspace(0.0, 1.0, 150)
    cutoff = rng.uniform(0.0, 0.1, size=len(checker.pairs))
    least = np.min(checker.distances(q, times=times), axis=0)
    nearest = np.argmin(least)
    cutoff[nearest] = max(cutoff[nearest], least[nearest] + 0.01)
    shuffled = rng.permutation(150)
    for order in (np.arange(150), shuffled, np.concatenate([shuffled[:20], shuffled])):
        exact = checker.distances(q[order], times=times[order])
        found = checker.distances(q[order], cutoff, times[order])
        check(found, exact, cutoff)
        assert np.any(exact < cutoff)
    broad, placed = checker.broad, checker._place(panda.expand(q), times)
    least = broad._grouped(placed, broad._centres(placed))
    assert least is not None
    assert np.all(least <= np.min(broad.by_balls(placed), axis=0))
    assert np.mean(least > cutoff) > 0.5


def test_narrow_phase_measures_only_near_pairs(
    panda: Robot, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    checker = CollisionChecker(panda, clutter(rng), self_collision=True)
    q = motion(panda, 40, rng)
    exact = checker.distances(q)
    # Some motions keep away from all obstacles.
    cutoff = max(0.05, float(np.sort(exact, axis=None)[20]))
    near = int(np.sum(exact < cutoff))
    usual, measured = checker.narrow.distances, list[int]()

    def counting(pairs: Sequence[int]) -> list[float]:
        measured.extend(pairs)
        return usual(pairs)

    monkeypatch.setattr(checker.narrow, "distances", counting)
    found = checker.distances(q, cutoff)
    # Bounding volumes may be near where the bodies in them are not.
    assert near <= len(measured) <= 2 * near + 0.05 * exact.size
    np.testing.assert_array_equal(found >= cutoff, exact >= cutoff)


def test_distances_without_pairs_or_configurations_are_empty(planar3r: Robot) -> None:
    empty = CollisionChecker(planar3r, Scene())
    assert empty.distances(np.zeros((4, 3)), 0.1).shape == (4, 0)
    assert empty.is_free(np.zeros(3))
    checker = CollisionChecker(planar3r, Scene([Sphere("o", radius=1)]))
    assert checker.distances(np.zeros((0, 3)), 0.1).shape == (0, 3)
    none = np.zeros(0, dtype=np.int64)
    assert checker.derivatives_at(np.zeros((2, 3)), none, none).gradients.shape == (
        0,
        3,
    )


# Queries with a margin


def test_is_free_agrees_with_distances(panda: Robot, rng: np.random.Generator) -> None:
    checker = CollisionChecker(panda, clutter(rng, 4), self_collision=True)
    q = configurations(panda, 150, rng)
    distances = checker.distances(q)
    by_pair = rng.uniform(0.0, 0.05, size=len(checker.pairs))
    for margin in (0.0, 0.03, by_pair, 0.0):
        room = np.min(distances - margin, axis=1)
        found = np.array([checker.is_free(row, margin) for row in q])
        clear = np.abs(room) > 1e-5
        np.testing.assert_array_equal(found[clear], room[clear] > 0.0)
        assert 0.1 < np.mean(found) < 0.95


# Gradients


def test_gradients_at_several_instants_equal_single_ones(
    panda: Robot, rng: np.random.Generator
) -> None:
    checker = CollisionChecker(panda, clutter(rng), self_collision=True)
    q = motion(panda, 12, rng)
    instants = rng.integers(12, size=40)
    pairs = rng.integers(len(checker.pairs), size=40)
    found = checker.derivatives_at(q, instants, pairs).gradients
    for k in range(40):
        alone = gradients(checker, q[instants[k]], pairs[k : k + 1])[0]
        np.testing.assert_allclose(found[k], alone, atol=1e-4)


def test_gradients_between_links_match_differences(rng: np.random.Generator) -> None:
    arm, step = load_robot("ur5", limits="urdf"), 1e-6
    checker = CollisionChecker(arm, Scene(), self_collision=True, geometry="hull")
    pairs = np.arange(len(checker.pairs))
    errors = []
    for q in configurations(arm, 6, rng):
        steps = step * np.eye(arm.n)
        values = checker.distances(np.vstack([q + steps, q - steps]))
        numeric = (values[: arm.n] - values[arm.n :]).T / (2.0 * step)
        apart = checker.distances(q[None])[0] > 1e-3
        error = np.abs(gradients(checker, q, pairs) - numeric).max(axis=1)
        errors += error[apart].tolist()
    assert len(errors) > 60
    assert np.quantile(errors, 0.95) < 1e-4  # the remaining pairs are nearest at edges


# The constraint


def test_clearance_constraint_is_exact_within_its_attention(
    panda: Robot, rng: np.random.Generator
) -> None:
    checker = CollisionChecker(panda, clutter(rng))
    margin = rng.uniform(0.0, 0.02, size=len(checker.pairs))
    constraint = ClearanceConstraint(checker, margin, length=2.0)
    q = motion(panda, 25, rng)
    exact = (margin - checker.distances(q)) / 2.0
    for attention in (0.05, 0.0, 0.1):
        found = constraint.values(q, attention)
        near = exact > -attention + DEPTHS
        np.testing.assert_allclose(found[near], exact[near], atol=DEPTHS)
        assert np.all(found >= exact - DEPTHS)
        assert np.all(found[~near] <= -attention + DEPTHS)
    np.testing.assert_allclose(constraint.values(q, np.inf), exact, atol=DEPTHS)
    free = np.array([checker.is_free(row, margin) for row in q])
    np.testing.assert_array_equal(free, np.all(exact < 0.0, axis=1))
    pairs = np.array([3, 0])
    instants = np.array([24, 1])
    np.testing.assert_allclose(
        constraint.derivatives_at(q, instants, pairs).gradients,
        -checker.derivatives_at(q, instants, pairs).gradients / 2.0,
        atol=1e-4,
    )


@pytest.mark.parametrize("moves", [False, True])
def test_clearance_values_depend_on_the_states_alone(
    panda: Robot, rng: np.random.Generator, moves: bool
) -> None:
    """Former queries of the same object change no digit of the values."""
    scene = clutter(rng)
    if moves:
        motion_of = ConstantVelocity(velocity=(0.3, -0.2, 0.1))
        scene = Scene([*scene, Box("b", size=(0.2, 0.3, 0.1), motion=motion_of)])

    def fresh() -> ClearanceConstraint:
        checker = CollisionChecker(panda, scene, self_collision=True)
        return ClearanceConstraint(checker, 0.01, length=2.0)

    used = fresh()
    m, q, times = 25, motion(panda, 25, rng), np.linspace(0.0, 1.0, 25)
    pairs = np.arange(used.count)[:40]
    at = rng.integers(m, size=pairs.size)
    for attention in (0.05, 0.0, 0.2, np.inf):
        for step in (1e-9, 1e-4, 1e-2, 0.3):
            near = q + step * rng.normal(size=q.shape)
            used.values(near, attention, times)
            used.derivatives_at(near, at, pairs, times)
        expected = fresh().values(q, attention, times)
        np.testing.assert_array_equal(used.values(q, attention, times), expected)
        found = used.derivatives_at(q, at, pairs, times)
        for part, alone in zip(
            found, fresh().derivatives_at(q, at, pairs, times), strict=True
        ):
            np.testing.assert_array_equal(part, alone)


def test_distances_in_a_box_decrease_by_at_most_their_bound(
    panda: Robot, rng: np.random.Generator
) -> None:
    flying = Sphere(
        "flying",
        radius=0.1,
        position=(0.5, 0.4, 0.6),
        motion=ConstantVelocity(np.array([1.0, 0.0, -2.0])),
    )
    obstacles = (*clutter(rng, 4), flying)
    checker = CollisionChecker(panda, Scene(obstacles), self_collision=True)
    q, swing = configurations(panda, 6, rng), rng.uniform(0.0, 0.2, (6, panda.n))
    begin, end = np.full(6, 0.2), np.full(6, 0.3)
    bound = checker.decrease(q, swing, begin, end)
    some = np.array([len(checker.pairs) - 1, 0, 7])
    np.testing.assert_allclose(
        checker.decrease(q, swing, begin, end, some), bound[:, some], rtol=1e-13
    )
    middle = checker.distances(q, times=np.full(6, 0.25))
    for _ in range(20):
        there = q + swing * rng.uniform(-1.0, 1.0, swing.shape)
        found = checker.distances(there, times=rng.uniform(0.2, 0.3, 6))
        assert np.all((found >= middle - bound - DEPTHS)[middle > 0.0])
