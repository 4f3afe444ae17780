"""Checks of a planning problem when it is constructed."""

from __future__ import annotations

import pickle
import warnings
from dataclasses import FrozenInstanceError, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest
from robot_samples import chain, load, one_joint

from tominpmp.exceptions import (
    FrameNotFound,
    ProblemError,
    SceneError,
    TominpmpError,
    TominpmpWarning,
)
from tominpmp.goals.frames import PoseGoal, PositionGoal
from tominpmp.goals.joints import JointGoal
from tominpmp.kinematics import RobotKinematics
from tominpmp.motion_limits import MotionLimits
from tominpmp.problem.problem import Problem
from tominpmp.problem.segments import Segment
from tominpmp.problem.state_checks import SNAP
from tominpmp.robot.robot import Robot, load_robot
from tominpmp.scene.obstacles import Box, Sphere
from tominpmp.scene.scene import Scene

START = (0.5, 1.7, -1.7)
GOAL = JointGoal((0.9, -1.2, -0.9))
BALL = Scene([Sphere("O", radius=0.8, position=(4, 0, 0))])


def test_problem_of_the_paper_is_accepted(planar3r: Robot) -> None:
    problem = Problem(planar3r, START, PositionGoal("tip", (4, 1, 0)), scene=BALL)
    assert problem.robot is planar3r
    np.testing.assert_array_equal(problem.q_start, START)
    np.testing.assert_array_equal(problem.v_start, np.zeros(3))
    assert problem.scene == BALL
    assert problem.margin == 0.0


@pytest.mark.parametrize("given", [list, tuple, np.array])
def test_sequences_of_numbers_are_converted(given: type, planar3r: Robot) -> None:
    problem = Problem(planar3r, given(START), JointGoal(given([1, 0, 0])), margin=0)
    assert problem.q_start.dtype == np.float64
    assert type(problem.margin) is float
    assert problem.goal == JointGoal((1.0, 0.0, 0.0))


def test_no_scene_is_an_empty_scene(planar3r: Robot) -> None:
    problem = Problem(planar3r, START, GOAL, scene=None)  # type: ignore[arg-type]
    assert problem.scene == Scene()


def test_start_may_have_a_velocity(planar3r: Robot) -> None:
    problem = Problem(planar3r, START, GOAL, v_start=(1, -2, 3))
    np.testing.assert_array_equal(problem.v_start, [1.0, -2.0, 3.0])


# Wrong types


@pytest.mark.parametrize(
    ("changes", "field", "message"),
    [
        ({"robot": "planar3r"}, "robot", r"robot is 'planar3r', expected a Robot"),
        ({"goal": (1, 2, 3)}, "goal", r"goal is \(1, 2, 3\), expected a JointGoal"),
        ({"goal": None}, "goal", "goal is None"),
        ({"scene": {"o": 1}}, "scene", "scene is {'o': 1}, expected a Sc"),
        (
            {"margin": -0.1},
            "margin",
            r"margin is -0.1, expected a finite number >= 0 \[m\]",
        ),
        ({"margin": np.nan}, "margin", "margin is nan"),
        ({"margin": np.inf}, "margin", "margin is inf"),
        ({"margin": None}, "margin", "margin is None"),
        ({"margin": "0.1"}, "margin", "margin is '0.1'"),
        ({"margin": [0.1]}, "margin", r"margin is \[0.1\]"),
        ({"segments": "via"}, "segments", "segments is 'via', expected a list of Segm"),
        ({"segments": [None] * 101}, "segments", "has 101 items, expected .* 100 at m"),
    ],
)
def test_arguments_of_wrong_type_are_refused(
    changes: dict[str, object], field: str, message: str, planar3r: Robot
) -> None:
    values = {"robot": planar3r, "q_start": START, "goal": GOAL}
    with pytest.raises(ProblemError, match=message) as caught:
        Problem(**(values | changes))  # type: ignore[arg-type]
    assert caught.value.field == field


@pytest.mark.parametrize("field", ["q_start", "v_start", "a_start"])
@pytest.mark.parametrize(
    ("value", "message"),
    [
        (
            "abc",
            "is 'abc', expected 3 numbers, one for each of: joint1, joint2, joint3",
        ),
        ("123", "is '123', expected 3 numbers"),
        ([1, None, 0], r"is \[1, None, 0\], expected 3 numbers"),
        ([[1], [2, 3]], r"is \[\[1\], \[2, 3\]\], expected 3 numbers"),
        ({}, r"is \{\}, expected 3 numbers"),
        ([1, 2j, 0], r"is \[1, 2j, 0\], expected 3 numbers"),
        (
            [1, 0],
            r"has 2 numbers, expected 3, one .*: joint1, joint2, joint3",
        ),
        ([[1, 0, 0]], r"has shape \(1, 3\), expected \(m,\): 3 numbers"),
        (1.0, r"has shape \(\), expected \(m,\): 3 numbers"),
        ([1, np.nan, 0], "joint 'joint2' is nan, expected a finite number"),
        ([1, 0, -np.inf], "joint 'joint3' is -inf, expected a finite number"),
    ],
)
def test_bad_vectors_are_refused(
    field: str, value: object, message: str, planar3r: Robot
) -> None:
    values = {"q_start": START, field: value}
    with pytest.raises(ProblemError, match=f"^{field}:? {message}") as caught:
        Problem(planar3r, goal=GOAL, **values)  # type: ignore[arg-type]
    assert caught.value.field == field


def test_start_is_needed(planar3r: Robot) -> None:
    with pytest.raises(ProblemError, match=r"^q_start is None, expected 3 numbers"):
        Problem(planar3r, None, GOAL)  # type: ignore[arg-type]


# Limits


@pytest.mark.parametrize(
    ("field", "values", "message"),
    [
        (
            "q_start",
            {"q_start": (0.1, 0, 0)},
            r"joint 'joint1' is 0.1 rad, outside its position limits \[0.18, 3\] rad",
        ),
        (
            "q_start",
            {"q_start": (0.5, 0, -3.00011)},
            r"'joint3' is -3.00011 rad, outside its position limits \[-3, 3\] rad",
        ),
        (
            "v_start",
            {"v_start": (0, -101, 0)},
            r"'joint2' is -101 rad/s, outside its velocity limits \[-100, 100\] rad/s$",
        ),
        (
            "a_start",
            {
                "a_start": (0, -6, 0),
                "motion_limits": MotionLimits(acceleration=5.0, jerk=9.0),
            },
            r"'joint2' is -6 rad/s\^2, outside its acceleration limits \[-5, 5\] rad",
        ),
        (
            "goal.q",
            {"goal": JointGoal((0.5, 3.5, 0))},
            r"joint 'joint2' is 3.5 rad, outside its position limits \[-3, 3\] rad",
        ),
        (
            "goal.v",
            {"goal": JointGoal((0.5, 0, 0), (0, 0, 200))},
            r"joint 'joint3' is 200 rad/s, outside its velocity limits",
        ),
    ],
)
def test_values_outside_limits_are_refused(
    field: str, values: dict[str, object], message: str, planar3r: Robot
) -> None:
    values = {"q_start": START, "goal": GOAL} | values
    with pytest.raises(ProblemError, match=f"^{field}: .*{message}") as caught:
        Problem(planar3r, **values)  # type: ignore[arg-type]
    assert caught.value.field == field


def test_start_accelerations_are_read_by_joint_name(planar3r: Robot) -> None:
    problem = Problem(planar3r, START, GOAL, a_start={"joint2": 2.0})
    np.testing.assert_array_equal(problem.a_start, [0.0, 2.0, 0.0])
    # A joint state has no accelerations; its positions must not be taken for them.
    state = SimpleNamespace(name=planar3r.joint_names, position=[1.0, 2.0, 3.0])
    with pytest.raises(ProblemError, match=r"^a_start is .*, expected 3 numbers"):
        Problem(planar3r, START, GOAL, a_start=state)


def test_messages_on_sliding_joints_have_metres_and_newtons(tmp_path: Path) -> None:
    arm = load(tmp_path, one_joint(kind="prismatic"), gravity=(0, 0, 0))
    goal = JointGoal([0.5])
    with pytest.raises(ProblemError, match=r"is 3 m, .*position limits \[-1, 2\] m"):
        Problem(arm, [3.0], goal)
    with pytest.raises(
        ProblemError, match=r"is 4 m/s, .*velocity limits \[-3, 3\] m/s"
    ):
        Problem(arm, [0.0], goal, v_start=[4.0])
    heavy = arm.with_changes(gravity=(0, 0, -9.81), effort=5.0)
    with pytest.raises(ProblemError, match=r"19.62 N needed, \[-5, 5\] allowed"):
        Problem(heavy, [0.0], goal)


@pytest.mark.parametrize("excess", [1e-9, 0.9 * SNAP])
@pytest.mark.parametrize("side", ["lower", "upper"])
@pytest.mark.parametrize("where", ["q_start", "v_start", "goal.q", "goal.v"])
def test_values_slightly_outside_limits_are_corrected_with_a_warning(
    where: str, side: str, excess: float, planar3r: Robot
) -> None:
    sign = -1.0 if side == "lower" else 1.0
    bounds = {"q": getattr(planar3r.limits, f"position_{side}")[1], "v": sign * 100.0}
    kind = where.removeprefix("goal.")[0]
    vector = np.array([0.5, bounds[kind] + sign * excess, 0.1])
    values: dict[str, object] = {"q_start": START, "goal": GOAL}
    if where.startswith("goal"):
        values["goal"] = JointGoal(**({"q": (0.5, 0, 0)} | {kind: vector}))
    else:
        values[where] = vector
    message = f"^{where}: joint 'joint2' is .* outside its .* was set to the limit$"
    with pytest.warns(TominpmpWarning, match=message) as caught:
        problem = Problem(planar3r, **values)  # type: ignore[arg-type]
    assert len(caught) == 1
    assert caught[0].filename == __file__
    holder = problem.goal if where.startswith("goal") else problem
    mended = getattr(holder, kind if where.startswith("goal") else where)
    np.testing.assert_array_equal(mended, [0.5, bounds[kind], 0.1])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        replace(problem)  # nothing is left to mend


def test_values_at_the_limits_are_accepted(planar3r: Robot) -> None:
    limits = planar3r.limits
    light = planar3r.with_changes(gravity=(0, 0, 0))
    goal = JointGoal(limits.position_upper)
    problem = Problem(light, limits.position_lower, goal, v_start=limits.velocity)
    np.testing.assert_array_equal(problem.q_start, limits.position_lower)
    assert problem.goal is goal


@pytest.mark.parametrize("last", [True, False])
def test_velocity_out_of_the_position_range_at_an_end_is_refused(
    planar3r: Robot, last: bool
) -> None:
    at_limit, out = (3.0, 0.5, 0.5), (1.0, 0.0, 0.0)
    says = "joint 'joint1' {} its range there: it has {} rad/s at its limit of 3 rad"
    for sign, way in ((1, "leaves"), (-1, "enters")):
        goal = JointGoal(at_limit, sign * np.array(out))
        segments = [Segment(goal)] if last else [Segment(goal), Segment(GOAL)]
        with pytest.raises(ProblemError, match=f"goal: {says.format(way, sign)}"):
            Problem(planar3r, START, segments=segments)
    with pytest.raises(ProblemError, match=f"start: {says.format('leaves', 1)}"):
        Problem(planar3r, at_limit, GOAL, v_start=out)
    Problem(planar3r, at_limit, GOAL, v_start=(-1.0, 0.0, 0.0))
    Problem(planar3r, at_limit, GOAL, v_start=(1e-3, 0.0, 0.0))


def test_continuous_joints_have_no_position_limits(tmp_path: Path) -> None:
    arm = load(tmp_path, one_joint(kind="continuous"))
    problem = Problem(arm, [100.0], JointGoal([-1e6]))
    assert problem.q_start[0] == 100.0


# Goals


def test_joint_goal_of_the_wrong_length_names_the_joints(planar3r: Robot) -> None:
    with pytest.raises(ProblemError, match=r"^goal.q has 2 .*joint1, joint2, joint3"):
        Problem(planar3r, START, JointGoal((1, 2)))


def test_error_on_an_unknown_frame_lists_the_frames(planar3r: Robot) -> None:
    with pytest.raises(FrameNotFound, match=r"'hand'; the robot has: .*tip"):
        Problem(planar3r, START, PositionGoal("hand", (4, 1, 0)))


@pytest.mark.parametrize(
    ("frame", "point", "reach"),
    [("tip", (0.0, 6.5, 0.0), 6.0), ("link3", (4.0, 4.0, 0.0), 5.0)],
)
@pytest.mark.parametrize("make", [PositionGoal, PoseGoal])
def test_goal_beyond_reach_is_refused(
    make: type, frame: str, point: tuple[float, ...], reach: float, planar3r: Robot
) -> None:
    place = point if make is PositionGoal else pin.SE3(np.eye(3), np.array(point))
    beyond = np.linalg.norm(point) - reach
    message = (
        f"frame '{frame}' reaches {reach:g} m at most: outside reach by {beyond:.4g} m"
    )
    with pytest.raises(ProblemError, match=message) as caught:
        Problem(planar3r, START, make(frame, place))
    assert caught.value.field == "goal"


@pytest.mark.parametrize("far", [6.0, 6.0 * (1 + 1e-12)])
def test_goal_at_full_reach_is_accepted(far: float, planar3r: Robot) -> None:
    Problem(planar3r, START, PositionGoal("tip", (far, 0, 0)))


@pytest.mark.parametrize("far", [1e6, 1e200])
def test_goal_far_beyond_reach_is_refused(far: float, planar3r: Robot) -> None:
    with pytest.raises(ProblemError, match="outside reach"):
        Problem(planar3r, START, PositionGoal("tip", (far, far, 0)))


def test_goals_of_random_configurations_are_accepted(rng: np.random.Generator) -> None:
    arm = load_robot("ur5", limits="urdf")
    kinematics = RobotKinematics(arm)
    for _ in range(20):
        q = rng.uniform(-3.0, 3.0, size=6)
        for frame in ("ee_link", "wrist_1_link"):
            place = kinematics.placement(q, frame)
            Problem(arm, np.zeros(6), PositionGoal(frame, place.translation))
            Problem(arm, np.zeros(6), PoseGoal(frame, place))


# Gravity


def test_goal_where_gravity_exceeds_the_torque_limit_is_refused(
    planar3r: Robot,
) -> None:
    # Stretched out, the links have their centres of mass at 1.5, 4 and 5.5 m.
    moment = 9.81 * (0.3 * 1.5 + 0.2 * 4.0 + 0.1 * 5.5)
    weak = planar3r.with_changes(effort={"joint1": 17.0}, position_lower=-3.0)
    goal = JointGoal((0.0, 0.0, 0.0))
    with pytest.raises(
        ProblemError,
        match=rf"'joint1' cannot hold .* {moment:.4g} N m needed, \[-17, 17\] allowed",
    ) as caught:
        Problem(weak, START, goal)
    assert caught.value.field == "goal"
    Problem(weak.with_changes(effort={"joint1": moment * 1.0001}), START, goal)


def test_goal_with_a_velocity_need_not_be_held_against_gravity(planar3r: Robot) -> None:
    weak = planar3r.with_changes(effort={"joint1": 1.0})
    Problem(weak, START, JointGoal((0.5, 0.0, 0.0), (1.0, 0.0, 0.0)))
    with pytest.raises(ProblemError, match="cannot hold"):
        Problem(weak, START, JointGoal((0.5, 0.0, 0.0), (0.0, 0.0, 0.0)))


def test_torque_limits_of_one_sign_are_checked_against_gravity(planar3r: Robot) -> None:
    pulling = planar3r.with_changes(effort={"joint3": (-2.0, -0.1)})
    with pytest.raises(ProblemError, match=r"'joint3' .*\[-2, -0.1\] allowed"):
        Problem(pulling, START, JointGoal((0.5, 0.0, 0.0)))


def test_passive_joints_rest_in_equilibrium_only(tmp_path: Path) -> None:
    arm = load(tmp_path, chain("", ""), gravity=(0, -9.81, 0), effort={"j2": 0.0})
    arm = arm.with_changes(effort={"j1": 100.0}, position_upper=4.0)
    hanging = (0.3, -0.5 * np.pi - 0.3)
    arm = arm.with_changes(position_lower=-4.0)
    Problem(arm, hanging, JointGoal(hanging))
    with pytest.raises(ProblemError, match="'j2' cannot hold the arm"):
        Problem(arm, hanging, JointGoal((0.0, 0.0)))


# Collisions


def test_start_in_collision_is_refused(planar3r: Robot) -> None:
    scene = Scene([Box("far", size=(1, 1, 1), position=(0, -9, 0)), *BALL])
    with pytest.raises(
        ProblemError,
        match=r"^start in collision: link 'link2' and obstacle 'O' overlap by "
        r"0\.08\d+ m at q = \[0.18, 0.0, 0.0\]$",
    ) as caught:
        Problem(planar3r, (0.18, 0, 0), GOAL, scene=scene)
    assert caught.value.field == "q_start"


def test_all_pairs_in_collision_are_named_the_deepest_first(planar3r: Robot) -> None:
    """Regression: each repaired pair led to an error about the next one."""
    scene = [*BALL, Sphere("post", radius=0.4, position=(1.0, -0.2, 0.0))]
    pairs = ("link 'link2' and obstacle 'O'", "link 'link1' and obstacle 'post'")
    words = "; ".join(rf"{pair} overlap by 0\.\d+ m" for pair in pairs)
    with pytest.raises(ProblemError, match=f"^goal in collision: {words} at q = "):
        Problem(planar3r, START, JointGoal((0.18, 0.0, 0.0)), scene=scene)


def test_goal_in_collision_is_refused(planar3r: Robot) -> None:
    with pytest.raises(
        ProblemError, match=r"^goal in collision: link 'link2' and obstacle 'O' overlap"
    ) as caught:
        Problem(planar3r, START, JointGoal((0.19, 0.0, 0.0)), scene=BALL)
    assert caught.value.field == "goal"


def test_margin_counts_at_start_and_goal(planar3r: Robot) -> None:
    """The tip of the stretched arm is 0.8 m below the centre of a ball."""
    q = (1.0, 0.0, 0.0)
    scene = Scene(
        [Sphere("o", radius=0.5, position=(6 * np.cos(1), 6 * np.sin(1) + 0.8, 0))]
    )
    problem = Problem(planar3r, START, JointGoal(q), scene=scene)
    gap = 0.8 - 0.5 - 0.001
    assert replace(problem, margin=gap - 1e-6).margin > 0.0
    message = (
        rf"link 'link3' and obstacle 'o' are {gap:.4g} m apart, less than the margin"
    )
    with pytest.raises(ProblemError, match=f"^goal in collision: {message}"):
        replace(problem, margin=gap + 0.01)
    with pytest.raises(ProblemError, match=f"^start in collision: {message}"):
        Problem(planar3r, q, GOAL, scene=scene, margin=gap + 0.01)


def test_start_that_only_touches_an_obstacle_is_accepted(planar3r: Robot) -> None:
    scene = Scene([Sphere("o", radius=0.999, position=(0, -1, 0))])
    with pytest.raises(ProblemError, match="start in collision"):
        Problem(planar3r, START, GOAL, scene=scene, margin=0.1)
    Problem(planar3r, START, GOAL, scene=scene)


def test_robot_without_shapes_is_refused_in_a_scene(tmp_path: Path) -> None:
    arm = load(tmp_path, one_joint())
    Problem(arm, [0.0], JointGoal([1.0]))
    with pytest.raises(SceneError, match="no collision geometry"):
        Problem(arm, [0.0], JointGoal([1.0]), scene=BALL)


# Problems as values


def test_problems_are_frozen(planar3r: Robot) -> None:
    problem = Problem(planar3r, START, GOAL, scene=BALL)
    with pytest.raises(FrozenInstanceError):
        problem.margin = 1.0  # type: ignore[misc]
    for item in (problem, pickle.loads(pickle.dumps(problem))):
        for array in (item.q_start, item.v_start, item.goal.q):
            with pytest.raises(ValueError, match="read-only"):
                array[0] = 1.0


def test_problem_copies_the_arrays_of_the_caller(planar3r: Robot) -> None:
    q = np.array(START)
    problem = Problem(planar3r, q, GOAL)
    q[:] = 9.0
    np.testing.assert_array_equal(problem.q_start, START)


def test_problems_of_one_robot_are_equal_by_value(planar3r: Robot) -> None:
    problem = Problem(planar3r, START, GOAL, scene=BALL, margin=0.01)
    same = Problem(planar3r, START, GOAL, scene=BALL, margin=0.01, v_start=(0, 0, 0))
    assert problem == same
    assert hash(problem) == hash(same)
    assert problem != replace(problem, margin=0.02)
    assert problem != replace(problem, scene=None)
    assert problem != replace(problem, v_start=(0, 0, 1))


def test_problem_can_be_pickled(planar3r: Robot) -> None:
    problem = Problem(planar3r, START, GOAL, scene=BALL, margin=0.01)
    back = pickle.loads(pickle.dumps(problem))
    for name in ("goal", "scene", "margin"):
        assert getattr(back, name) == getattr(problem, name)
    np.testing.assert_array_equal(back.q_start, problem.q_start)
    assert back.robot.joint_names == planar3r.joint_names


@pytest.mark.parametrize(
    "changes",
    [
        {"q_start": object()},
        {"v_start": "still"},
        {"margin": object()},
        {"scene": "empty"},
        {"goal": "tip"},
        {"robot": None},
        {"q_start": 10**400},
    ],
)
def test_errors_have_one_base_class(
    changes: dict[str, object], planar3r: Robot
) -> None:
    values = {"robot": planar3r, "q_start": START, "goal": GOAL}
    with pytest.raises(TominpmpError):
        Problem(**(values | changes))  # type: ignore[arg-type]


def test_frame_goal_within_an_obstacle_is_refused(planar3r: Robot) -> None:
    ball = Sphere("O", radius=0.8, position=(4.0, 1.0, 0.0))
    start, scene = (0.5, 1.7, -1.7), Scene([ball])
    for goal in (
        PositionGoal("tip", (4.0, 1.2, 0.0)),
        PoseGoal("tip", pin.SE3(np.eye(3), np.array([4.0, 1.2, 0.0]))),
    ):
        with pytest.raises(ProblemError, match=r"0\.6 m deep in obstacle 'O'.*'link3'"):
            Problem(planar3r, start, goal, scene)
    # A goal on the surface of the ball is accepted, or one with enough tolerance.
    Problem(planar3r, start, PositionGoal("tip", (4.0, 1.80001, 0.0)), scene)
    Problem(planar3r, start, PositionGoal("tip", (4.0, 1.2, 0.0), tolerance=0.7), scene)
