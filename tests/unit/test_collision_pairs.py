"""Self-collision: the pairs of links that are checked against each other."""

from __future__ import annotations

import itertools
import pickle
from pathlib import Path

import numpy as np
import pytest
from robot_samples import INERTIAL, joint, link, load, robot

from tominpmp.collision.checker import CollisionChecker
from tominpmp.exceptions import ProblemError
from tominpmp.goals.joints import JointGoal
from tominpmp.problem.problem import Problem
from tominpmp.robot.robot import Robot, load_robot
from tominpmp.scene.obstacles import Sphere
from tominpmp.scene.scene import Scene

FAR = Scene([Sphere("far", radius=0.1, position=(9, 9, 9))])


def own_pairs(arm: Robot) -> set[frozenset[str]]:
    checker = CollisionChecker(arm, Scene(), self_collision=True, geometry="hull")
    assert checker.obstacle_pairs == 0
    return {frozenset(pair) for pair in checker.pairs}


def test_self_collision_pairs_of_a_panda_follow_its_srdf() -> None:
    """All pairs that its SRDF enables, except links without relative motion."""
    arm = load_robot(
        "panda", limits="urdf", locked_joints={"panda_finger_joint1": 0.03}
    )
    names = [f"panda_link{i}" for i in range(8)]
    names += ["panda_hand", "panda_leftfinger", "panda_rightfinger"]
    assert arm.srdf is not None
    disabled = {frozenset(pair) for pair in arm.srdf.disabled_pairs}
    expected = {frozenset(pair) for pair in itertools.combinations(names, 2)} - disabled
    # The fingers are rigidly connected when their joint is locked.
    ends = frozenset(("panda_leftfinger", "panda_rightfinger"))
    found = own_pairs(arm)
    assert found == expected - {ends}
    assert frozenset(("panda_link0", "panda_hand")) in found
    assert frozenset(("panda_link1", "panda_link2")) not in found


def test_self_collision_pairs_of_a_ur5_follow_its_srdf() -> None:
    arm = load_robot("ur5", limits="urdf")
    assert arm.srdf is not None
    disabled = {frozenset(pair) for pair in arm.srdf.disabled_pairs}
    found = own_pairs(arm)
    assert not found & disabled
    assert frozenset(("wrist_1_link", "base_link")) in found
    assert frozenset(("upper_arm_link", "ee_link")) in found
    assert len(found) == 17


def test_self_collision_pairs_without_an_srdf_exclude_neighbours() -> None:
    """Pairs that always touch are excluded, too; the fixed base has pairs."""
    arm = load_robot("ur10", limits="urdf")
    assert arm.srdf is None
    found = own_pairs(arm)
    chain = ["base_link", "shoulder_link", "upper_arm_link", "forearm_link"]
    chain += ["wrist_1_link", "wrist_2_link", "wrist_3_link"]
    for pair in itertools.pairwise(chain):
        assert frozenset(pair) not in found
    assert frozenset(("base_link", "forearm_link")) in found
    assert frozenset(("upper_arm_link", "wrist_2_link")) in found


def test_planar_arm_has_no_self_collision_pairs(planar3r: Robot) -> None:
    """The paper's arm may cross itself: its SRDF disables all pairs."""
    assert own_pairs(planar3r) == set()


SHAPE = '{}<collision><geometry><sphere radius="{}"/></geometry></collision>'


def beads(folder: Path, radii: tuple[float, ...]) -> Robot:
    """Balls in a row, 1 m apart, with a joint about z between neighbours."""
    shapes = [SHAPE.format(INERTIAL, radius) for radius in radii]
    links = [link(f"l{i}", shape) for i, shape in enumerate(shapes)]
    joints = [joint(f"j{i}", f"l{i - 1}", f"l{i}") for i in range(1, len(radii))]
    return load(folder, robot(*links, *joints))


def test_pairs_of_a_chain_exclude_neighbours(tmp_path: Path) -> None:
    arm = beads(tmp_path, (0.1, 0.1, 0.1, 0.1))
    assert own_pairs(arm) == {
        frozenset(pair) for pair in (("l0", "l2"), ("l0", "l3"), ("l1", "l3"))
    }
    checker = CollisionChecker(arm, Scene(), self_collision=True)
    straight = checker.distances(np.zeros((1, 3)))[0]
    assert sorted(straight) == pytest.approx([1.8, 1.8, 2.8], abs=1e-8)
    # Folded in the middle: l3 on l1.
    folded = checker.distances(np.array([[0.0, np.pi, 0.0]]))[0]
    index = [set(pair) for pair in checker.pairs].index({"l1", "l3"})
    assert folded[index] == pytest.approx(-0.2, abs=1e-6)
    assert checker.closest(np.array([0.0, np.pi, 0.0])).own  # type: ignore[union-attr]


def test_links_that_always_touch_have_no_pair(tmp_path: Path) -> None:
    """Big balls touch their second neighbours in every configuration."""
    arm = beads(tmp_path, (0.1, 1.2, 0.1, 1.2))
    found = own_pairs(arm)
    assert frozenset(("l1", "l3")) not in found
    assert frozenset(("l0", "l2")) in found


def test_obstacle_pairs_precede_self_collision_pairs() -> None:
    arm = load_robot("ur5", limits="urdf")
    both = CollisionChecker(arm, FAR, self_collision=True, geometry="hull")
    alone = CollisionChecker(arm, FAR, geometry="hull")
    own = CollisionChecker(arm, Scene(), self_collision=True, geometry="hull")
    assert both.pairs == alone.pairs + own.pairs
    assert both.obstacle_pairs == len(alone.pairs)
    margins = both.margins(0.1)
    assert np.all(margins[: both.obstacle_pairs] == 0.1)
    assert np.all(margins[both.obstacle_pairs :] == 0.0)
    back = pickle.loads(pickle.dumps(both))
    assert back.pairs == both.pairs
    assert back.self_collision


def folded_ur5() -> tuple[Robot, np.ndarray]:
    """An arm and a configuration whose forearm overlaps its shoulder."""
    arm = load_robot("ur5", limits="urdf")
    return arm, np.array([0.0, -1.0, 3.1, 0.0, 0.0, 0.0])


def test_start_or_goal_in_self_collision_is_rejected() -> None:
    arm, q = folded_ur5()
    goal = JointGoal(np.array([0.0, -1.0, 1.0, 0.0, 0.0, 0.0]))
    with pytest.raises(ProblemError, match=r"^start in collision: links '.*overlap by"):
        Problem(arm, q, goal, scene=FAR)
    with pytest.raises(ProblemError, match=r"^goal in collision: links '"):
        Problem(arm, goal.q, JointGoal(q), scene=FAR)
    with pytest.raises(ProblemError, match="in collision"):
        Problem(arm, q, goal, self_collision=True)
    with pytest.raises(ProblemError, match="in collision"):
        Problem(arm, q, goal)
    assert Problem(arm, q, goal, self_collision=False).checker.pairs == ()
    assert Problem(arm, q, goal, scene=FAR, self_collision=False).margins.size


def test_margin_does_not_hold_between_links() -> None:
    """Some links are always nearer to each other than the margin of obstacles."""
    arm = load_robot("ur5", limits="urdf")
    q = np.array([0.3, -1.2, 1.0, 0.3, 0.4, 0.0])
    problem = Problem(arm, q, JointGoal(q + 0.1), scene=FAR, margin=0.15)
    own = problem.checker.distances(q[None])[0, problem.checker.obstacle_pairs :]
    assert 0.0 < own.min() < 0.15
    assert problem.margins.max() == 0.15
