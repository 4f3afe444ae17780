"""Workcells: one problem for several robots, and the split of its motion."""

from __future__ import annotations

import pickle

import numpy as np
import pinocchio as pin
import pytest
from robot_samples import placement

from tominpmp.exceptions import FrameNotFound, ProblemError
from tominpmp.goals.base import Goal
from tominpmp.goals.frames import PoseGoal, PositionGoal
from tominpmp.goals.joints import JointGoal, JointRegionGoal
from tominpmp.goals.sets import AllGoals, AnyGoal
from tominpmp.options import Options, Tolerances
from tominpmp.planner.planning import plan
from tominpmp.problem.problem import Problem
from tominpmp.problem.segments import Segment
from tominpmp.problem.workcell import Workcell
from tominpmp.robot.payload import Payload
from tominpmp.robot.robot import Robot, load_robot
from tominpmp.scene.obstacles import Sphere
from tominpmp.scene.scene import Scene
from tominpmp.verification.verification import verify

# The planar arm, turned about its own axis z and set aside; gravity lies in its plane.
TURNED = pin.SE3(pin.exp3(np.array([0.0, 0.0, 2.0])), np.array([30.0, 0.0, 0.0]))
START = np.array([0.5, 1.7, -1.7])
ENDS = {"b": np.array([1.2, 1.0, -1.0]), "a": np.array([0.7, 1.5, 0.0])}
QUICK = Options(intervals=16, effort="quick", refine=None)


@pytest.fixture(scope="module")
def cell(planar3r: Robot) -> Workcell:
    """The names are not in alphabetical order, and a base is turned against gravity."""
    return Workcell({"b": (planar3r, (0, 0, 0)), "a": (planar3r, TURNED)})


@pytest.fixture(scope="module")
def pair() -> Workcell:
    """Two UR5s facing each other."""
    arm = load_robot("ur5", limits="urdf")
    turned = pin.SE3(np.diag([-1.0, -1.0, 1.0]), np.array([1.2, 0.0, 0.0]))
    return Workcell({"one": (arm, (0, 0, 0)), "two": (arm, turned)})


def test_workcell_has_names_bases_and_one_robot(
    cell: Workcell, planar3r: Robot
) -> None:
    assert cell.names == ("b", "a")
    assert cell.robot.joint_names[:3] == ("b/joint1", "b/joint2", "b/joint3")
    assert cell.base("a").isApprox(TURNED)
    np.testing.assert_array_equal(
        cell.stack({"a": [1, 2, 3], "b": [4, 5, 6]}), [4, 5, 6, 1, 2, 3]
    )
    listed = Workcell([("b", planar3r, (0, 0, 0)), ("a", planar3r, TURNED)])  # type: ignore[arg-type]
    assert listed == cell
    assert pickle.loads(pickle.dumps(cell)) == cell
    assert Workcell({"b": (planar3r, (0, 0, 0))}) != cell


def test_gravity_is_expressed_in_the_axes_of_each_base(
    cell: Workcell, planar3r: Robot
) -> None:
    np.testing.assert_array_equal(cell.alone("b").gravity, planar3r.gravity)
    np.testing.assert_allclose(
        TURNED.rotation @ cell.alone("a").gravity, planar3r.gravity, atol=1e-12
    )


# Goals


def test_joint_goals_are_combined_into_one(cell: Workcell) -> None:
    goal = cell.goal({"b": JointGoal(START), "a": JointGoal(ENDS["a"], [0.1, 0, 0])})
    assert goal == JointGoal(
        np.concatenate([START, ENDS["a"]]), [0, 0, 0, 0.1, 0.0, 0.0]
    )


def test_goals_of_different_types_are_combined(cell: Workcell, planar3r: Robot) -> None:
    point = (1.0, 4.0, 0.0)
    goal = cell.goal({"a": JointGoal(ENDS["a"]), "b": PositionGoal("tip", point)})
    names = [f"a/{joint}" for joint in planar3r.joint_names]
    assert goal == AllGoals(
        [PositionGoal("b/tip", point), JointRegionGoal(ENDS["a"], 0.0, names)]
    )
    pose = PoseGoal("tip", pin.SE3(np.eye(3), np.array(point)))
    some = JointRegionGoal([0.1], 0.05, ["joint2"], wrap=("joint2",))
    both = AllGoals([pose, some])
    assert cell.goal({"b": None, "a": both}) == AllGoals(
        [
            PoseGoal("a/tip", pin.SE3(np.eye(3), np.array(point))),
            JointRegionGoal([0.1], 0.05, ["a/joint2"], wrap=("a/joint2",)),
        ]
    )


def test_alternative_goals_are_combined_pairwise(cell: Workcell) -> None:
    one, two = JointGoal(START), JointGoal(ENDS["a"])
    goal = cell.goal({"b": AnyGoal([one, two]), "a": AnyGoal([one, two])})
    assert isinstance(goal, AnyGoal)
    q = {tuple(item.q.tolist()) for item in goal.goals if isinstance(item, JointGoal)}
    assert q == {(*x, *y) for x in (START, ENDS["a"]) for y in (START, ENDS["a"])}


# Motions


def test_distant_robots_take_as_long_as_the_slower_robot(cell: Workcell) -> None:
    alone = {
        name: plan(Problem(cell.alone(name), START, JointGoal(end)), QUICK)
        for name, end in ENDS.items()
    }
    problem = cell.problem(
        dict.fromkeys(ENDS, START), {k: JointGoal(end) for k, end in ENDS.items()}
    )
    together = plan(problem, QUICK)
    assert together.success
    assert min(s.T for s in alone.values()) < 0.95 * max(s.T for s in alone.values())
    assert together.T == pytest.approx(max(s.T for s in alone.values()), rel=5e-3)
    # Each part of the motion replays alone, on the robot at its own base.
    motions = cell.split(together.trajectory)
    assert tuple(motions) == cell.names
    for name, motion in motions.items():
        robot = cell.alone(name)
        assert motion.joint_names == robot.joint_names
        assert motion.duration == together.T
        task = Problem(robot, START, JointGoal(ENDS[name]))
        assert verify(task, motion, Tolerances()).ok, name
        # The torques between the nodes equal those of the whole motion.
        columns = [cell.robot.joint_names.index(f"{name}/joint{i}") for i in (1, 2, 3)]
        times = np.linspace(0.0, together.T, 57)
        for own, whole in zip(motion(times), together.trajectory(times), strict=True):
            np.testing.assert_allclose(own, whole[:, columns], atol=1e-9)


def test_robot_without_a_goal_ends_at_rest(cell: Workcell) -> None:
    problem = cell.problem(
        dict.fromkeys(ENDS, START),
        {"b": PositionGoal("tip", (1.0, 4.0, 0.0)), "a": None},
        v_start={"a": [0.3, 0.0, 0.0]},
    )
    few = Options(intervals=12, starts=1, effort="quick", refine=None)
    solution = plan(problem, few)
    assert solution.success
    motions = cell.split(solution.trajectory)
    tip = placement(cell.alone("b"), motions["b"].q[-1].tolist(), "tip").translation
    np.testing.assert_allclose(tip, (1.0, 4.0, 0.0), atol=1e-5)
    np.testing.assert_allclose(motions["a"].v[-1], 0.0, atol=1e-6)
    np.testing.assert_allclose(motions["a"].v[0], [0.3, 0.0, 0.0], atol=1e-12)


def test_split_motion_of_collocation_replays_alone(cell: Workcell) -> None:
    start = dict.fromkeys(ENDS, START)
    goal = {k: JointGoal(end) for k, end in ENDS.items()}
    options = Options(intervals=24, method="collocation", effort="quick", refine=None)
    solution = plan(cell.problem(start, goal), options)
    assert solution.success
    after = solution.T + 1.0
    held = solution.trajectory(after, hold=True).u.reshape(2, -1)
    for own, (name, motion) in zip(
        held, cell.split(solution.trajectory).items(), strict=True
    ):
        task = Problem(cell.alone(name), START, JointGoal(ENDS[name]))
        assert motion.inverse_dynamics is None
        assert verify(task, motion, Tolerances()).ok, name
        np.testing.assert_allclose(motion(after, hold=True).u, own, atol=1e-9)


def test_split_motions_have_segments_and_payloads_of_the_whole(cell: Workcell) -> None:
    goals = (
        cell.goal({k: JointGoal(end) for k, end in ENDS.items()}),
        cell.goal(dict.fromkeys(ENDS, JointGoal(START))),
    )
    load = Payload(0.05, "a/tip")
    segments = [Segment(goals[0], stop=True), Segment(goals[1], payload=load)]
    start = cell.stack(dict.fromkeys(ENDS, START))
    solution = plan(Problem(cell.robot, start, segments=segments), QUICK)
    assert solution.success
    whole, motions = solution.trajectory, cell.split(solution.trajectory)
    times = np.linspace(0.0, whole.duration, 57)
    for own, motion in zip(
        np.split(whole(times).u, 2, axis=1), motions.values(), strict=True
    ):
        np.testing.assert_array_equal(motion.segment_ends, whole.segment_ends)
        np.testing.assert_allclose(motion(times).u, own, atol=1e-9)


# Clearance between robots


def test_margin_holds_between_robots_and_not_within_one(pair: Workcell) -> None:
    # The forearms point at each other, about 21 cm apart; links of the same arm are
    # nearer to each other.
    q = np.array([0.0, -1.2, 1.9, -0.7, -1.571, 0.0])
    arms = {"one": q, "two": q}
    goal = {name: JointGoal(value) for name, value in arms.items()}
    free = pair.problem(arms, goal)
    own = free.checker.closest(free.q_start)
    nearest = free.checker.closest(free.q_start, free.checker.margins(1.0))
    assert own is not None
    assert nearest is not None
    assert own.distance < nearest.distance - 0.01
    assert nearest.own
    assert {nearest.link[:3], nearest.obstacle[:3]} == {"one", "two"}
    margins = free.checker.margins(0.25)
    between = [{a[:3], b[:3]} == {"one", "two"} for a, b in free.checker.pairs]
    np.testing.assert_array_equal(margins, np.where(between, 0.25, 0.0))
    message = r"start in collision: links '(one|two)/.*less than the margin"
    with pytest.raises(ProblemError, match=message) as caught:
        pair.problem(arms, goal, margin=nearest.distance + 0.01)
    # Advice on meshes is for links that overlap, not for a margin.
    assert "meshes" not in str(caught.value)
    pair.problem(arms, goal, margin=nearest.distance - 0.01)


def test_margin_holds_between_robots_and_obstacles(pair: Workcell) -> None:
    q = np.array([0.0, -1.2, 1.9, -0.7, -1.571, 0.0])
    ball = Scene([Sphere("ball", radius=0.05, position=(0.6, 0.0, 2.0))])
    problem = pair.problem(
        {"one": q, "two": q},
        {"one": JointGoal(q + 0.1), "two": JointGoal(q + 0.1)},
        scene=ball,
        margin=0.02,
    )
    first = problem.margins[: problem.checker.obstacle_pairs]
    np.testing.assert_array_equal(first, 0.02)


# Wrong arguments


def test_wrong_robots_are_rejected(planar3r: Robot) -> None:
    here = (0.0, 0.0, 0.0)
    for robots, message in (
        (
            [("a", planar3r, here), ("a", planar3r, (9, 0, 0))],
            "another one for each",
        ),
        ({"a": (planar3r, here), "b": (planar3r, here)}, "the bases of 'a' and 'b'"),
        ({"a": planar3r}, r"robots\['a'\] is <Robot .*, expected .robot, base"),
        ({"a": (planar3r,)}, r"robots\['a'\] is .*, expected .robot, base"),
        ({"a/b": (planar3r, here)}, "expected a text without '/'"),
        ({}, "expected a list of .name, robot, base"),
        (planar3r, "expected a list of .name, robot, base"),
    ):
        with pytest.raises(ProblemError, match=message) as caught:
            Workcell(robots)  # type: ignore[arg-type]
        assert caught.value.field in ("robots", "robots['a']")


def test_wrong_goals_and_starts_name_the_robot(cell: Workcell) -> None:
    fine = JointGoal(START)
    goals: list[tuple[dict[str, Goal | None], str]] = [
        ({"a": fine}, "no goal is given for 'b'"),
        ({"a": fine, "c": fine}, "there is no robot 'c'; there are: b, a"),
        ({"a": None, "b": None}, "no robot has a goal"),
        ({"a": fine, "b": JointGoal([1, 2])}, "b: goal.q has 2 numbers, expected 3"),
        ({"a": None, "b": JointGoal(START, [1, 0, 0])}, "JointGoals for the other"),
        (START, "goal is .*, expected goals by the name"),  # type: ignore[list-item]
        ({"a": fine, "b": START}, "the goal of 'b' is .*, expected a goal"),  # type: ignore[dict-item]
        ({"a": None, "b": PositionGoal("tip", (1, 4, 0), (1, 0, 0))}, "at rest"),
    ]
    for goal, message in goals:
        with pytest.raises(ProblemError, match=message):
            cell.problem({"a": START, "b": START}, goal)
    with pytest.raises(FrameNotFound, match="no frame 'hand'"):
        cell.goal({"a": fine, "b": PositionGoal("hand", (1, 0, 0))})
    with pytest.raises(ProblemError, match="values for 'b' are missing"):
        cell.problem({"a": START}, {"a": fine, "b": fine})
    with pytest.raises(ProblemError, match="values for 'c' are given"):
        cell.problem(
            {"a": START, "b": START}, {"a": fine, "b": fine}, v_start={"c": START}
        )
    with pytest.raises(ProblemError, match="there is no robot 'c'"):
        cell.alone("c")


def test_unreachable_goal_is_rejected(cell: Workcell) -> None:
    # Within reach of the base, but beside the plane of the arm.
    goal = {"b": None, "a": PositionGoal("tip", (35.0, 0.0, 1.0))}
    with pytest.raises(ProblemError, match="no configuration within the position lim"):
        plan(cell.problem({"a": START, "b": START}, goal), QUICK)


def test_split_rejects_motions_of_other_robots(cell: Workcell, planar3r: Robot) -> None:
    alone = plan(Problem(planar3r, START, JointGoal(ENDS["a"])), QUICK)
    with pytest.raises(ProblemError, match=r"of joint1, .*expected a motion of b/"):
        cell.split(alone.trajectory)
    with pytest.raises(
        ProblemError, match=r"trajectory is <Solution .*, expected a Trajectory"
    ):
        cell.split(alone)  # type: ignore[arg-type]
