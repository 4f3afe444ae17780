"""Goals on joints and frames: residuals, checks of arguments, equality.

Their derivatives are tested in test_derivatives_problem.py.
"""

from __future__ import annotations

import pickle
from dataclasses import FrozenInstanceError

import numpy as np
import pinocchio as pin
import pytest

from tominpmp.exceptions import FrameNotFound, ProblemError
from tominpmp.goals.base import Goal
from tominpmp.goals.frames import PoseGoal, PositionGoal
from tominpmp.goals.joints import JointGoal
from tominpmp.kinematics import RobotKinematics
from tominpmp.robot.robot import Robot

Q = np.array([0.5, 1.7, -1.7])
V = np.array([0.3, -0.2, 0.9])
SPEED = (0.1, 0.2, 0.0)


def pose_of_tip(arm: Robot) -> pin.SE3:
    return RobotKinematics(arm).placement(Q, "tip")


def every_goal(arm: Robot) -> dict[str, Goal]:
    """A goal of each kind, reached at Q; the "moving" kinds have a final velocity."""
    pose = pose_of_tip(arm)
    return {
        "joint": JointGoal(Q),
        "joint moving": JointGoal(Q, V),
        "position": PositionGoal("tip", pose.translation),
        "position moving": PositionGoal("tip", pose.translation, SPEED),
        "pose": PoseGoal("tip", pose),
        "pose moving": PoseGoal("tip", pose, SPEED),
    }


kinds = pytest.mark.parametrize(
    "kind",
    ["joint", "joint moving", "position", "position moving", "pose", "pose moving"],
)


# Residuals


@kinds
def test_residual_is_zero_where_the_goal_is_reached(kind: str, planar3r: Robot) -> None:
    goal, kinematics = every_goal(planar3r)[kind], RobotKinematics(planar3r)
    v = np.zeros(3)
    if kind == "joint moving":
        v = V
    elif "moving" in kind:
        v = np.linalg.pinv(kinematics.jacobian(Q, "tip")[:2]) @ np.array(SPEED[:2])
    residual = goal.residual(kinematics, Q, v)
    np.testing.assert_allclose(residual.value, 0.0, atol=1e-12)
    away = goal.residual(kinematics, Q + 0.1, v).value
    assert np.abs(away).max() > 0.05


@kinds
def test_final_velocity_is_fixed_unless_a_frame_moves(
    kind: str, planar3r: Robot
) -> None:
    goal = every_goal(planar3r)[kind]
    assert goal.fixes_velocity == (kind not in ("position moving", "pose moving"))
    expected = V if kind == "joint moving" else np.zeros(3)
    np.testing.assert_array_equal(goal.final_velocity(3), expected)


def test_residual_of_joint_goal_is_the_difference(planar3r: Robot) -> None:
    value = JointGoal(Q, V).residual(RobotKinematics(planar3r), Q + 1.0, V - 2.0).value
    np.testing.assert_allclose(value, [1, 1, 1, -2, -2, -2])


def test_residual_of_position_goal_is_in_the_world(planar3r: Robot) -> None:
    goal = PositionGoal("tip", (4, 1, 0.5))
    value = goal.residual(RobotKinematics(planar3r), np.zeros(3), V).value
    np.testing.assert_allclose(value, [2, -1, -0.5, *V])


def test_residual_of_pose_goal_contains_the_rotation_angle(planar3r: Robot) -> None:
    goal = PoseGoal("tip", pose_of_tip(planar3r))
    turned = Q + np.array([0.0, 0.0, 0.7])  # the tip turns, and moves on a circle
    value = goal.residual(RobotKinematics(planar3r), turned, np.zeros(3)).value
    np.testing.assert_allclose(value[3:6], [0, 0, 0.7], atol=1e-12)


def test_frame_velocity_leaves_joint_velocities_in_its_null_space_free(
    planar3r: Robot,
) -> None:
    kinematics = RobotKinematics(planar3r)
    goal = PositionGoal("tip", pose_of_tip(planar3r).translation, SPEED)
    jacobian = kinematics.jacobian(Q, "tip")[:2]
    least = np.linalg.pinv(jacobian) @ np.array(SPEED[:2])
    free = np.linalg.svd(jacobian)[2][-1]
    for v in (least, least + 3.0 * free):
        np.testing.assert_allclose(
            goal.residual(kinematics, Q, v).value, 0.0, atol=1e-12
        )


# Checks against the robot


@kinds
def test_goals_are_valid_for_their_robot(kind: str, planar3r: Robot) -> None:
    every_goal(planar3r)[kind].validate(planar3r)


@pytest.mark.parametrize(
    ("goal", "message"),
    [
        (
            JointGoal([1, 2]),
            "^goal.q has 2 numbers, expected 3, one for each of: joint1",
        ),
        (JointGoal([]), "^goal.q has 0 numbers, expected 3"),
        (
            JointGoal([1, 2, 3], [0, 0]),
            "^goal.v has 2 numbers, .*joint1, joint2, joint3",
        ),
    ],
)
def test_wrong_number_of_joint_values_is_refused(
    goal: JointGoal, message: str, planar3r: Robot
) -> None:
    with pytest.raises(ProblemError, match=message):
        goal.validate(planar3r)


@pytest.mark.parametrize("make", [PositionGoal, PoseGoal])
def test_error_on_an_unknown_frame_lists_the_frames_of_the_robot(
    make: type, planar3r: Robot
) -> None:
    place = (1, 1, 0) if make is PositionGoal else pin.SE3.Identity()
    with pytest.raises(FrameNotFound, match=r"no frame 'hand'.* has: .*tip") as caught:
        make("hand", place).validate(planar3r)
    assert caught.value.name == "hand"
    assert set(caught.value.available) >= {"base", "link1", "joint1", "tip"}


# Bad values

BAD_TRIPLES = [
    None,
    "here",
    "123",
    5.0,
    (1, 2),
    (1, 2, 3, 4),
    [[1], [2], [3]],
    [[1, 2], [3]],
    (1, 2, None),
    (1, 2, "3"),
    (True, False, True),
    (1, 2, 1j),
    {},
]


@pytest.mark.parametrize("position", BAD_TRIPLES)
def test_bad_positions_are_refused(position: object) -> None:
    with pytest.raises(
        ProblemError, match=r"^goal\.position .*three coordin.* \[m\]"
    ) as e:
        PositionGoal("tip", position)  # type: ignore[arg-type]
    assert e.value.field == "goal.position"


@pytest.mark.parametrize("v", [v for v in BAD_TRIPLES if v is not None])
def test_bad_frame_velocities_are_refused(v: object) -> None:
    for make, place in ((PositionGoal, (1, 1, 1)), (PoseGoal, pin.SE3.Identity())):
        with pytest.raises(ProblemError, match=r"^goal\.v .*three comp.* \[m/s\]") as e:
            make("tip", place, v)  # type: ignore[operator]
        assert e.value.field == "goal.v"


@pytest.mark.parametrize(
    "value", ["123", 5.0, [[1, 2], [3]], [[1, 2, 3]], (1, 2, None), {}, [1j], object()]
)
def test_bad_joint_values_are_refused(value: object) -> None:
    with pytest.raises(
        ProblemError, match=r"^goal\.q .*one number for each .*\[rad"
    ) as e:
        JointGoal(value)  # type: ignore[arg-type]
    assert e.value.field == "goal.q"
    with pytest.raises(ProblemError, match=r"^goal\.v .*one number .*\[rad/s or m/s\]"):
        JointGoal([1, 2, 3], value)  # type: ignore[arg-type]


def test_joint_goal_needs_positions() -> None:
    with pytest.raises(ProblemError, match=r"^goal\.q is None, expected one number"):
        JointGoal(None)  # type: ignore[arg-type]


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_numbers_that_are_not_finite_are_refused(bad: float) -> None:
    values = [0.0, bad, 0.0]
    makers = {
        "goal.q": lambda: JointGoal(values),
        "goal.v": lambda: JointGoal([0, 0, 0], values),
        "goal.position": lambda: PositionGoal("tip", values),
        "goal.pose": lambda: PoseGoal("tip", pin.SE3(np.eye(3), np.array(values))),
    }
    for field, make in makers.items():
        with pytest.raises(ProblemError, match="finite") as caught:
            make()
        assert caught.value.field == field


@pytest.mark.parametrize("frame", [None, "", 3, ["tip"]])
def test_bad_frame_names_are_refused(frame: object) -> None:
    for make, place in ((PositionGoal, (1, 1, 1)), (PoseGoal, pin.SE3.Identity())):
        with pytest.raises(
            ProblemError, match=r"goal\.frame is .*name of a frame"
        ) as e:
            make(frame, place)  # type: ignore[operator]
        assert e.value.field == "goal.frame"


@pytest.mark.parametrize(
    ("pose", "message"),
    [
        (np.eye(3), r"is array\(.*\), expected a pinocchio.SE3, a 4x4 matrix"),
        (None, "is None, expected a pinocchio.SE3, a 4x4 matrix"),
        (pin.SE3(2.0 * np.eye(3), np.zeros(3)), "expected a rotation matrix"),
        (pin.SE3(np.diag([1.0, 1.0, -1.0]), np.zeros(3)), "expected a rotation matrix"),
    ],
)
def test_bad_poses_are_refused(pose: object, message: str) -> None:
    with pytest.raises(ProblemError, match=message) as caught:
        PoseGoal("tip", pose)
    assert caught.value.field == "goal.pose"


def test_position_and_rotation_apart_are_refused_as_a_pose() -> None:
    """Regression: the message was about the velocity, which comes after the pose."""
    with pytest.raises(ProblemError, match="a pair of a position") as caught:
        PoseGoal("tip", (1, 1, 1), (0, 0, 0, 1))
    assert caught.value.field == "goal.pose"


# Goals as values


@kinds
def test_goals_are_equal_by_value(kind: str, planar3r: Robot) -> None:
    goals = every_goal(planar3r)
    goal, same = goals[kind], every_goal(planar3r)[kind]
    assert goal == same
    assert hash(goal) == hash(same)
    assert pickle.loads(pickle.dumps(goal)) == goal
    assert [other for other in goals.values() if other == goal] == [goal]


def test_goals_of_different_values_are_unequal(planar3r: Robot) -> None:
    assert JointGoal([1, 2, 3]) != JointGoal([1, 2, 4])
    assert JointGoal([1, 2, 3]) != JointGoal([1, 2, 3], [0, 0, 0])
    assert JointGoal([1, 2, 3]) == JointGoal(np.array([1.0, 2.0, 3.0]))
    assert PositionGoal("tip", (1, 2, 0)) != PositionGoal("link3", (1, 2, 0))
    pose = pose_of_tip(planar3r)
    moved = pose * pin.SE3(np.eye(3), np.array([0.0, 0.0, 1e-9]))
    assert PoseGoal("tip", pose) != PoseGoal("tip", moved)


@kinds
def test_goals_are_frozen(kind: str, planar3r: Robot) -> None:
    goal = every_goal(planar3r)[kind]
    with pytest.raises(FrozenInstanceError):
        goal.v = None  # type: ignore[attr-defined]
    for item in (goal, pickle.loads(pickle.dumps(goal))):
        for key in ("q", "v", "position"):
            value = getattr(item, key, None)
            if value is not None:
                with pytest.raises(ValueError, match="read-only"):
                    value[0] = 5.0


def test_goal_stores_a_copy_of_its_pose(planar3r: Robot) -> None:
    pose = pose_of_tip(planar3r)
    goal = PoseGoal("tip", pose)
    pose.translation = np.array([9.0, 9.0, 9.0])
    assert goal.pose.translation[0] < 9.0
