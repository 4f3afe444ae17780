"""Frames of a robot: placements, Jacobians, velocities, reach.

Their derivatives are tested in test_derivatives_problem.py.
"""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest
from robot_samples import chain, joint, link, load, robot

from tominpmp.exceptions import FrameNotFound
from tominpmp.kinematics import FrameMotions, RobotKinematics, prismatic_joints
from tominpmp.robot.robot import Robot, load_robot

LENGTHS = np.array([3.0, 2.0, 1.0])
Q = np.array([0.5, 1.7, -1.7])
V = np.array([0.4, -1.1, 0.8])


def planar_tip(q: np.ndarray) -> np.ndarray:
    """Position of the tip of the paper's arm, by the formula."""
    angles = np.cumsum(q)
    return np.array([LENGTHS @ np.cos(angles), LENGTHS @ np.sin(angles), 0.0])


def planar_jacobian(q: np.ndarray) -> np.ndarray:
    angles = np.cumsum(q)
    parts = LENGTHS * np.array([-np.sin(angles), np.cos(angles)])
    tails = np.cumsum(parts[:, ::-1], axis=1)[:, ::-1]
    return np.vstack([tails, np.zeros((3, 3)), np.ones(3)])


def test_placement_matches_the_closed_form(planar3r: Robot) -> None:
    place = RobotKinematics(planar3r).placement(Q, "tip")
    np.testing.assert_allclose(place.translation, planar_tip(Q), atol=1e-14)
    turn = Q.sum()
    np.testing.assert_allclose(place.rotation[0, :2], [np.cos(turn), -np.sin(turn)])


def test_jacobian_matches_the_closed_form(planar3r: Robot) -> None:
    kinematics = RobotKinematics(planar3r)
    jacobian = kinematics.jacobian(Q, "tip")
    np.testing.assert_allclose(jacobian, planar_jacobian(Q), atol=1e-14)
    local = kinematics.jacobian(Q, "tip", local=True)
    R = kinematics.placement(Q, "tip").rotation
    np.testing.assert_allclose(R @ local[:3], jacobian[:3], atol=1e-14)


def test_velocity_derivatives_match_the_closed_form(planar3r: Robot) -> None:
    slopes = FrameMotions(planar3r, "tip").velocity_slopes(Q[None], V[None])
    velocity, by_q, by_v = (part[0] for part in slopes)
    jacobian = planar_jacobian(Q)[:3]
    np.testing.assert_allclose(velocity, jacobian @ V, atol=1e-14)
    np.testing.assert_allclose(by_v, jacobian, atol=1e-14)
    # d(J v)/dq: each link turns the velocities of the links after it.
    angles, rates = np.cumsum(Q), np.cumsum(V)
    parts = -LENGTHS * rates * np.array([np.cos(angles), np.sin(angles)])
    tails = np.cumsum(parts[:, ::-1], axis=1)[:, ::-1]
    np.testing.assert_allclose(by_q[:2], tails, atol=1e-13)


def test_calls_do_not_change_earlier_results(planar3r: Robot) -> None:
    kinematics = RobotKinematics(planar3r)
    place, jacobian = kinematics.placement(Q, "tip"), kinematics.jacobian(Q, "tip")
    motions = FrameMotions(planar3r, "tip")
    motion = motions.velocity_slopes(Q[None], V[None])
    for q in (np.zeros(3), np.ones(3)):
        kinematics.placement(q, "link1")
        kinematics.jacobian(q, "tip")
        motions.velocity_slopes(q[None], -V[None])
    np.testing.assert_allclose(place.translation, planar_tip(Q), atol=1e-14)
    np.testing.assert_array_equal(jacobian, kinematics.jacobian(Q, "tip"))
    again = motions.velocity_slopes(Q[None], V[None])
    for before, after in zip(motion, again, strict=True):
        np.testing.assert_array_equal(before, after)


def test_kinematics_can_be_pickled(planar3r: Robot) -> None:
    kinematics = RobotKinematics(planar3r)
    back = pickle.loads(pickle.dumps(kinematics))
    np.testing.assert_array_equal(
        back.jacobian(Q, "tip"), kinematics.jacobian(Q, "tip")
    )


def test_unknown_frame_is_named_in_the_error(planar3r: Robot) -> None:
    kinematics = RobotKinematics(planar3r)
    for ask in (
        lambda: kinematics.placement(Q, "hand"),
        lambda: kinematics.jacobian(Q, "hand"),
        lambda: FrameMotions(planar3r, "hand"),
        lambda: kinematics.reach("hand"),
    ):
        with pytest.raises(FrameNotFound, match="'hand'"):
            ask()


# Mimic joints


def test_mimic_fingers_move_together() -> None:
    panda = load_robot("panda", limits="urdf")
    kinematics = RobotKinematics(panda)
    q = np.array([0.1, -0.5, 0.2, -2.0, 0.3, 1.5, 0.7, 0.03])
    hand = kinematics.placement(q, "panda_hand")
    for side, sign in (("left", 1.0), ("right", -1.0)):
        frame = f"panda_{side}finger"
        place = hand.actInv(kinematics.placement(q, frame))
        np.testing.assert_allclose(place.translation[:2], [0, sign * 0.03], atol=1e-12)
        column = kinematics.jacobian(q, frame)[:3, 7]
        np.testing.assert_allclose(column, sign * hand.rotation[:, 1], atol=1e-12)


# Reach


def test_reach_of_the_planar_arm_is_the_sum_of_its_links(planar3r: Robot) -> None:
    kinematics = RobotKinematics(planar3r)
    assert kinematics.reach() == pytest.approx(6.0)
    assert kinematics.reach("tip") == pytest.approx(6.0)
    assert kinematics.reach("link3") == pytest.approx(5.0)
    assert kinematics.reach("link1") == pytest.approx(0.0)


@pytest.mark.parametrize("name", ["planar3r", "ur5", "panda"])
def test_no_frame_gets_beyond_its_reach(name: str, rng: np.random.Generator) -> None:
    arm = load_robot(name)
    kinematics = RobotKinematics(arm)
    lower = np.maximum(arm.limits.position_lower, -np.pi)
    upper = np.minimum(arm.limits.position_upper, np.pi)
    samples = rng.uniform(lower, upper, size=(50, arm.n))
    reaches = []
    for frame in arm.frame_names:
        reaches.append(kinematics.reach(frame))
        far = [
            np.linalg.norm(kinematics.placement(q, frame).translation) for q in samples
        ]
        assert max(far) <= reaches[-1] + 1e-12
    assert kinematics.reach() == max(reaches)


def test_reach_includes_the_travel_of_sliding_joints(tmp_path: Path) -> None:
    # Joints sit 1 m from their parents; the limits are -1 and 2.
    arm = load(tmp_path, chain("", "", kind="prismatic"))
    kinematics = RobotKinematics(arm)
    assert kinematics.reach("l1") == pytest.approx(3.0)
    assert kinematics.reach("l2") == pytest.approx(6.0)
    far = RobotKinematics(arm.with_changes(position_upper={"j2": np.inf}))
    assert far.reach("l1") == pytest.approx(3.0)
    assert far.reach("l2") == np.inf


def test_reach_is_computed_along_each_branch(tmp_path: Path) -> None:
    parts = [link("base", ""), link("l1"), link("l2"), link("l3")]
    parts += [
        joint("j1", "base", "l1"),
        joint("j2", "l1", "l2"),
        joint("j3", "l1", "l3", kind="prismatic"),
    ]
    kinematics = RobotKinematics(load(tmp_path, robot(*parts)))
    assert kinematics.reach("l2") == pytest.approx(2.0)
    assert kinematics.reach("l3") == kinematics.reach() == pytest.approx(4.0)


def test_prismatic_joints_are_detected_for_any_axis(
    tmp_path: Path, planar3r: Robot
) -> None:
    assert prismatic_joints(planar3r).tolist() == [False] * 3
    panda = prismatic_joints(load_robot("panda", limits="urdf"))
    assert panda.tolist() == [False] * 7 + [True]
    parts = [link("base", ""), *(link(f"l{i}") for i in range(1, 5))]
    kinds = ("prismatic", "revolute", "continuous", "prismatic")
    axes = ("0 0 1", "1 2 3", "0 1 1", "1 -1 2")  # also not along the axes of a frame
    for i, (kind, axis) in enumerate(zip(kinds, axes, strict=True), 1):
        parent = "base" if i == 1 else f"l{i - 1}"
        parts.append(joint(f"j{i}", parent, f"l{i}", kind=kind, axis=axis))
    arm = load(tmp_path, robot(*parts))
    assert prismatic_joints(arm).tolist() == [True, False, False, True]
