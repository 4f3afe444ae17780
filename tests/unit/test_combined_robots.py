"""`combine_robots`: several robots in one workspace become one robot."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from robot_samples import chain, load, one_shape, placement

from tominpmp.collision.checker import CollisionChecker
from tominpmp.combined_robots import combine_robots
from tominpmp.dynamics import RobotDynamics
from tominpmp.exceptions import ProblemError
from tominpmp.goals.frames import PositionGoal
from tominpmp.goals.joints import JointGoal, JointRegionGoal
from tominpmp.goals.sets import AllGoals
from tominpmp.options import Options
from tominpmp.planner.planning import plan
from tominpmp.problem.problem import Problem
from tominpmp.robot.payload import Payload
from tominpmp.robot.robot import Robot, load_robot
from tominpmp.scene.scene import Scene

TILTED = pin.SE3(pin.exp3(np.array([0.0, 0.4, 2.0])), np.array([1.0, 1.0, 0.3]))
FAR = (5.0, 0.0, 0.0)
HOME = np.array([0.0, -1.2, 1.2, -1.5, -1.5, 0.0])


@pytest.fixture(scope="module")
def ur5() -> Robot:
    return load_robot(
        "ur5", limits="urdf", effort=0.9 * np.array([150, 150, 150, 28, 28, 28.0])
    )


@pytest.fixture(scope="module")
def panda() -> Robot:
    return load_robot("panda", limits="urdf")  # eight joints, and a finger that follows


@pytest.fixture(scope="module")
def cell(ur5: Robot, panda: Robot) -> Robot:
    """A UR5 and a Panda, whose names are not in alphabetical order."""
    return combine_robots([("right", ur5, (0, 0, 0)), ("left", panda, TILTED)])


def test_combined_robot_stacks_joints_and_limits(
    cell: Robot, ur5: Robot, panda: Robot
) -> None:
    assert cell.joint_names == (
        *(f"right/{name}" for name in ur5.joint_names),
        *(f"left/{name}" for name in panda.joint_names),
    )
    assert cell.parts == ("right", "left")
    assert ur5.parts == ()
    for field in ("position_lower", "position_upper", "velocity", "effort_lower"):
        values = [getattr(robot.limits, field) for robot in (ur5, panda)]
        np.testing.assert_array_equal(
            getattr(cell.limits, field), np.concatenate(values)
        )
    np.testing.assert_array_equal(
        cell.damping, np.concatenate([ur5.damping, panda.damping])
    )


def test_dynamics_of_a_combined_robot_are_those_of_its_parts(
    cell: Robot, ur5: Robot, panda: Robot, rng: np.random.Generator
) -> None:
    # The base of the second robot is tilted, so that gravity differs in its axes.
    gravity = TILTED.rotation.T @ panda.gravity
    tilted = panda.with_changes(gravity=gravity)
    q, v, a = rng.normal(size=(3, 4, 14))
    found = RobotDynamics(cell).inverse_jacobians(q, v, a)
    for robot, rows in ((ur5, slice(0, 6)), (tilted, slice(6, 14))):
        one = RobotDynamics(robot).inverse_jacobians(q[:, rows], v[:, rows], a[:, rows])
        for mine, whole in zip(one, found, strict=True):
            part = whole[:, rows] if whole.ndim == 2 else whole[:, rows, rows]
            np.testing.assert_allclose(part, mine, atol=1e-10)
    for whole in (found.tau_q, found.tau_v, found.tau_a):
        assert not np.any(whole[:, :6, 6:])
        assert not np.any(whole[:, 6:, :6])


def test_frames_are_placed_by_the_base_of_their_robot(
    cell: Robot, panda: Robot
) -> None:
    q = np.array([0.1, -0.5, 0.2, -2.0, 0.3, 1.5, 0.7, 0.02])
    alone = placement(panda, q.tolist(), "panda_hand")
    both = placement(cell, cell.stack(right=HOME, left=q).tolist(), "left/panda_hand")
    assert both.isApprox(TILTED * alone, 1e-10)


def test_stack_orders_values_and_names_missing_ones(cell: Robot) -> None:
    values = cell.stack(left=np.arange(8), right=-np.ones(6))
    np.testing.assert_array_equal(values, [-1] * 6 + [0, 1, 2, 3, 4, 5, 6, 7])
    with pytest.raises(ProblemError, match="values for 'left' are missing"):
        cell.stack(right=HOME)
    with pytest.raises(ProblemError, match=r"'middle' are given; .*: right, left"):
        cell.stack(right=HOME, left=np.zeros(8), middle=HOME)
    with pytest.raises(ProblemError, match=r"left is array.*, expected 8 numbers, one"):
        cell.stack(right=HOME, left=HOME)
    with pytest.raises(ProblemError, match="not combined from several"):
        load_robot("planar3r").stack()
    with pytest.raises(ProblemError, match=r"right is \[0.*nan.*\], .* all finite"):
        cell.stack(right=[0.0, 0.0, 0.0, 0.0, 0.0, np.nan], left=np.zeros(8))


def test_pairs_within_a_robot_are_those_of_the_single_robot(
    cell: Robot, ur5: Robot, panda: Robot
) -> None:
    """The UR5 has no list of disabled pairs, the Panda has one."""
    whole = CollisionChecker(cell, Scene(), self_collision=True).pairs
    for name, robot in (("right", ur5), ("left", panda)):
        own = CollisionChecker(robot, Scene(), self_collision=True).pairs
        expected = {frozenset(f"{name}/{link}" for link in pair) for pair in own}
        found = {
            frozenset(pair)
            for pair in whole
            if all(link.startswith(f"{name}/") for link in pair)
        }
        assert found == expected
    between = {frozenset(p) for p in whole if p[0][:4] != p[1][:4]}
    assert frozenset(("right/wrist_3_link", "left/panda_hand")) in between
    assert frozenset(("right/shoulder_link", "left/panda_link0")) in between


def test_start_with_colliding_robots_is_rejected(ur5: Robot) -> None:
    pair = combine_robots([("a", ur5, (0, 0, 0)), ("b", ur5, (0.6, 0, 0))])
    # The arms lie along -x of their bases or turn to the other one.
    apart = pair.stack(a=[0, 0.0, 0, 0, 0, 0], b=[np.pi, 0, 0, 0, 0, 0])
    with pytest.raises(ProblemError, match=r"start in collision: links '[ab]/.*'[ab]/"):
        Problem(pair, pair.stack(a=HOME * 0, b=HOME * 0), JointGoal(apart))


def test_combined_robot_has_equality_pickle_and_changes(
    cell: Robot, ur5: Robot, panda: Robot
) -> None:
    assert pickle.loads(pickle.dumps(cell)) == cell
    again = combine_robots([("right", ur5, (0, 0, 0)), ("left", panda, TILTED)])
    assert again == cell
    moved = combine_robots([("right", ur5, (0, 0, 0.1)), ("left", panda, TILTED)])
    assert moved != cell
    slow = cell.with_changes(velocity={"left/panda_joint1": 0.5})
    assert slow.limits.velocity[6] == 0.5
    assert cell.locked_joints == {}


def test_combined_robot_keeps_payloads_and_locked_joints_of_its_parts(
    ur5: Robot,
) -> None:
    panda = load_robot(
        "panda", limits="urdf", locked_joints={"panda_finger_joint1": 0.03}
    )
    loaded = panda.with_payload(Payload(1.0, "panda_hand"))
    cell = combine_robots([("a", ur5, (0, 1, 0)), ("b", loaded, (0, 0, 0))])
    assert cell.locked_joints["b/panda_finger_joint2"] == 0.03
    assert "b/payload" in cell.frame_names
    q = np.array([0.1, -0.5, 0.2, -2.0, 0.3, 1.5, 0.7])
    zero = np.zeros((1, 7))
    alone = RobotDynamics(loaded).inverse(q[None], zero, zero)[0]
    whole, rest = cell.stack(a=HOME, b=q)[None], np.zeros((1, 13))
    found = RobotDynamics(cell).inverse(whole, rest, rest)[0]
    np.testing.assert_allclose(found[6:], alone, atol=1e-12)
    other = cell.with_payload(Payload(1.0, "a/tool0", name="a/load"))
    assert other.parts == ("a", "b")
    assert np.abs(RobotDynamics(other).inverse(whole, rest, rest)[0] - found).max() > 1


def test_group_state_of_all_robots_is_stacked(tmp_path: Path) -> None:
    robots = []
    for number, value in enumerate((0.2, 0.4)):
        folder = tmp_path / str(number)
        folder.mkdir()
        (folder / "sample.srdf").write_text(
            '<robot name="x"><group_state name="home" group="g">'
            f'<joint name="j1" value="{value}"/></group_state></robot>'
        )
        robots.append(load(folder, chain("")))
    cell = combine_robots([("a", robots[0], (0, 0, 0)), ("b", robots[1], (3, 0, 0))])
    np.testing.assert_array_equal(cell.group_state("home"), [0.2, 0.4])


# Plans of several robots


def test_distant_robots_take_as_long_as_the_slower_robot(planar3r: Robot) -> None:
    ends = [np.array([[0.5, 1.7, -1.7], q]) for q in ([1.2, 1.0, -1.0], [0.7, 1.5, 0])]
    options = Options(intervals=20, effort="quick", refine=None)
    alone = [plan(Problem(planar3r, a, JointGoal(b)), options).T for a, b in ends]
    cell = combine_robots([("a", planar3r, (0, 0, 0)), ("b", planar3r, (30, 0, 0))])
    start, end = (cell.stack(a=a, b=b) for a, b in zip(*ends, strict=True))
    together = plan(Problem(cell, start, JointGoal(end)), options)
    assert together.feasible
    assert alone[0] < 0.9 * alone[1]
    assert together.T == pytest.approx(alone[1], rel=5e-3)


def test_every_robot_may_have_a_goal_of_its_own(planar3r: Robot) -> None:
    cell = combine_robots([("a", planar3r, (0, 0, 0)), ("b", planar3r, (30, 0, 0))])
    start = np.array([0.5, 1.7, -1.7])
    goal = AllGoals(
        [
            PositionGoal("a/tip", (1.0, 4.0, 0.0)),
            JointRegionGoal([0.7, 1.5, 0.0], 0.1, [f"b/joint{i}" for i in (1, 2, 3)]),
        ]
    )
    problem = Problem(cell, cell.stack(a=start, b=start), goal)
    few = Options(intervals=12, starts=1, effort="quick", refine=None)
    solution = plan(problem, few)
    assert solution.feasible
    assert solution.trajectory is not None
    q = solution.trajectory.q[-1]
    tip = placement(cell, q.tolist(), "a/tip").translation
    np.testing.assert_allclose(tip, (1.0, 4.0, 0.0), atol=1e-5)
    assert np.abs(q[3:] - [0.7, 1.5, 0.0]).max() <= 0.1 + 1e-5


# Invalid input


def test_invalid_robot_of_a_combination_is_named_in_the_error(ur5: Robot) -> None:
    one = ("a", ur5, (0, 0, 0))
    for parts, message in (
        ([one, ("a", ur5, (2, 0, 0))], "a name is 'a', .*another one for each"),
        ([one, ("", ur5, FAR)], "a name is ''"),
        ([one, ("b/c", ur5, FAR)], "expected a text without '/'"),
        ([one, ("b", "ur5", FAR)], "'b' is 'ur5', expected a Robot"),
        ([one, ("b", ur5)], r"robots\[1\] is .*, expected .name, robot, base"),
        ([], r"robots is \[\], expected a list of .name, robot, base"),
        ([one, ("b", ur5, (1, 2))], "the base of 'b' is"),
        ([one, ("b", ur5, "there")], "the base of 'b' is 'there'"),
        ([one, ("b", ur5, (0, np.nan, 0))], "three finite coordinates"),
        ([one, ("b", ur5, pin.SE3(2 * np.eye(3), np.zeros(3)))], "the base of 'b'"),
        ([one, ("b", ur5, (0.05, 0, 0))], "the bases of 'a' and 'b' overlap by 0.0"),
    ):
        with pytest.raises(ProblemError, match=message):
            combine_robots(parts)  # type: ignore[arg-type]


def test_bases_without_geometry_must_differ_in_position(tmp_path: Path) -> None:
    arm = load(tmp_path, one_shape('<sphere radius="0.1"/>'))
    with pytest.raises(ProblemError, match=r"are at one place, \[0.0, 0.0, 1.0\]"):
        combine_robots([("a", arm, (0, 0, 1)), ("b", arm, (0, 0, 1))])
    combine_robots([("a", arm, (0, 0, 1)), ("b", arm, (0, 0.1, 1))])


def test_different_gravity_of_robots_needs_an_explicit_value(ur5: Robot) -> None:
    light = ur5.with_changes(gravity=(0, 0, -1.6))
    parts = [("a", ur5, (0, 0, 0)), ("b", light, FAR)]
    with pytest.raises(ProblemError, match=r"gravity differs, .'a': \(.*-9.81\)"):
        combine_robots(parts)
    cell = combine_robots(parts, gravity=(0, 0, -3.7))
    np.testing.assert_array_equal(cell.gravity, (0, 0, -3.7))
