"""Arguments in the types of other libraries: SciPy, Pinocchio, pandas, ROS messages."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace as Message

import numpy as np
import pinocchio as pin
import pytest
from robot_samples import chain
from scipy.spatial.transform import Rotation

import tominpmp as tm

POINT = (0.1, 0.2, 0.3)
TURN = Rotation.from_rotvec([0.3, -0.4, 0.5])
MATRIX, QUATERNION = TURN.as_matrix(), TURN.as_quat()
POSE = pin.SE3(MATRIX, np.array(POINT))
QUAT = pin.Quaternion(QUATERNION)
XYZ = dict(zip("xyz", POINT, strict=True))
XYZW = dict(zip("xyzw", QUATERNION.tolist(), strict=True))

ROTATIONS = [
    MATRIX, MATRIX.tolist(), QUATERNION, tuple(QUATERNION), TURN, QUAT, XYZW,
    Message(**XYZW), np.asfortranarray(MATRIX), 2.0 * QUATERNION, pin.AngleAxis(QUAT),
]  # fmt: skip
POSES = [
    POSE, POSE.homogeneous, POSE.homogeneous.tolist(), (POINT, TURN),
    [POINT, QUATERNION], (np.array(POINT), MATRIX), (POINT, QUAT), (XYZ, XYZW),
    [*POINT, *QUATERNION],
    {"position": POINT, "orientation": QUATERNION}, {"xyz": POINT, "rotation": TURN},
    {"translation": XYZ, "quaternion": XYZW},
    Message(position=Message(**XYZ), orientation=Message(**XYZW)),
    Message(translation=POINT, rotation=TURN),
]  # fmt: skip
POINTS = [POINT, list(POINT), np.array(POINT), np.float32(POINT), XYZ, Message(**XYZ)]


def assert_pose(pose: pin.SE3) -> None:
    np.testing.assert_allclose(pose.homogeneous, POSE.homogeneous, atol=1e-7)


@pytest.mark.parametrize("pose", POSES, ids=lambda x: type(x).__name__)
def test_poses_are_accepted_in_every_form(pose: object) -> None:
    assert_pose(tm.PoseGoal("tip", pose).pose)
    assert_pose(tm.RegionGoal("tip", (-1, -1, -1), (1, 1, 1), pose=pose).pose)
    assert_pose(tm.WithinRegion("tip", (-1, -1, -1), (1, 1, 1), pose=pose).pose)
    box = tm.Box("box", size=(1, 1, 1), position=pose)
    assert_pose(pin.SE3(np.array(box.rotation), np.array(box.position)))
    moving = tm.Box("box", size=(1, 1, 1), motion=lambda t: pose)
    assert_pose(pin.SE3(np.array(moving.rotation), np.array(moving.position)))
    robot = tm.load_robot(chain("", ""))
    assert_pose(tm.Workcell({"a": (robot, pose)}, gravity=(0, 0, 0)).base("a"))


@pytest.mark.parametrize("rotation", ROTATIONS, ids=lambda x: type(x).__name__)
def test_rotations_are_accepted_in_every_form(rotation: object) -> None:
    found = tm.Sphere("s", radius=1, rotation=rotation).rotation
    np.testing.assert_allclose(found, MATRIX, atol=1e-12)
    kept = tm.KeepOrientation("tip", rotation, tolerance=0.1)
    np.testing.assert_allclose(kept.rotation, MATRIX, atol=1e-12)
    assert_pose(tm.PoseGoal("tip", (POINT, rotation)).pose)


def test_waypoints_accept_rows_of_rotations() -> None:
    turns = Rotation.from_rotvec([[0, 0, 0.1 * k] for k in range(3)])
    for given in (turns, list(turns), turns.as_quat(), [QUAT] * 3):
        path = tm.Waypoints(times=[0, 1, 2], rotations=given)
        assert path.rotations.shape == (3, 3, 3)


@pytest.mark.parametrize("point", POINTS, ids=lambda x: type(x).__name__)
def test_points_are_accepted_in_every_form(point: object) -> None:
    for found in (
        tm.PositionGoal("tip", point).position,
        tm.Sphere("s", radius=1, position=point).position,
        tm.Payload(1.0, "tip", com=point).com,
        tm.AxisGoal("tip", (0, 0, 1), (0, 0, 1), position=point).position,
    ):
        np.testing.assert_allclose(found, POINT, atol=1e-7)


NOT_POSES = [
    5, None, "x", [], {}, np.zeros(3), np.eye(3), np.zeros((4, 4)), 2 * np.eye(4),
    ((0, 0), QUATERNION), (POINT, (0, 0, 0, 0)), (POINT, "x"), (POINT, None),
    {"position": POINT}, {"position": POINT, "frame": "x"}, object(), pin.SE3,
    (POINT, 2 * np.eye(3)), {"xyz": POINT, "position": POINT}, Rotation, TURN,
    ((0, 0, np.nan), MATRIX), Message(position=5, orientation=6), np.zeros(7),
]  # fmt: skip


@pytest.mark.parametrize("pose", NOT_POSES, ids=lambda x: type(x).__name__)
def test_values_that_are_not_poses_are_refused(pose: object) -> None:
    with pytest.raises(tm.ProblemError, match=r"goal\.pose") as error:
        tm.PoseGoal("tip", pose)
    assert error.value.field == "goal.pose"
    assert len(str(error.value)) < 300


def test_rotation_beside_a_pose_with_a_rotation_is_refused() -> None:
    with pytest.raises(
        tm.SceneError, match="pose with a rotation, and rotation is given"
    ):
        tm.Box("box", size=(1, 1, 1), position=POSE, rotation=TURN.inv())


@pytest.fixture(scope="module")
def robot() -> tm.Robot:
    return tm.load_robot(
        chain("", "", "").replace('"j', '"joint'),
        locked_joints={"joint2": 0.5},
        gravity=(0, 0, 0),
    )


class Series:
    """Values with an index of names, as in pandas."""

    def __init__(self, values: dict[str, float]) -> None:
        self.values, self.index = values, list(values)

    def to_dict(self) -> dict[str, float]:
        return dict(self.values)


NAMED = [
    {"joint3": 0.2, "joint1": 0.1},
    {"joint3": 0.2, "joint1": 0.1, "joint2": 0.5},
    Message(name=["joint3", "joint1"], position=[0.2, 0.1]),
    Series({"joint3": 0.2, "joint1": 0.1}),
]


@pytest.mark.parametrize("q", NAMED, ids=lambda x: type(x).__name__)
def test_configurations_are_read_by_joint_name(q: object, robot: tm.Robot) -> None:
    goals = [
        tm.JointGoal(q),
        tm.AnyGoal([tm.JointGoal(q), tm.JointGoal([0.3, 0.3])]),
        tm.JointGoal([0.2, 0.1], joints=["joint3", "joint1"]),
    ]
    for goal in goals:
        problem = tm.Problem(robot, q, goal, v_start={"joint3": 0.25})
        np.testing.assert_array_equal(problem.q_start, [0.1, 0.2])
        np.testing.assert_array_equal(problem.v_start, [0.0, 0.25])
        first = problem.goal.alternatives[0]
        np.testing.assert_array_equal(first.q, [0.1, 0.2])
    ways = [tm.Segment(tm.JointGoal(q)), tm.Segment(tm.JointGoal([0, 0]))]
    problem = tm.Problem(robot, q, segments=ways)
    np.testing.assert_array_equal(problem.segments[0].goal.q, [0.1, 0.2])
    region = tm.JointRegionGoal({"joint3": 0.2}, tolerance=0.1)
    assert region.joints == ("joint3",)


def test_limits_are_read_by_joint_name(robot: tm.Robot) -> None:
    """Values with names are assigned by name, not in the order of the joints."""
    values = {"joint3": 2.0, "joint1": 1.0}
    for given in (values, Series(values)):
        limits = robot.with_changes(velocity=given, effort=given).limits
        assert limits.velocity.tolist() == limits.effort_upper.tolist() == [1.0, 2.0]
        limits = tm.MotionLimits(acceleration=given)
        assert limits.by_joint("acceleration", robot.joint_names).tolist() == [1.0, 2.0]


def test_velocities_are_read_from_the_velocities_of_a_message(robot: tm.Robot) -> None:
    """Regression: the positions of a message were taken for velocities."""
    names = ["joint3", "joint1"]
    state = Message(name=names, position=[0.2, 0.1], velocity=[0.5, 0.25])
    problem = tm.Problem(robot, state, tm.JointGoal(state, v=state), v_start=state)
    np.testing.assert_array_equal(problem.v_start, [0.25, 0.5])
    np.testing.assert_array_equal(problem.goal.v, [0.25, 0.5])
    silent = Message(name=names, position=[0.2, 0.1], velocity=[])
    with pytest.raises(tm.ProblemError, match="v_start"):
        tm.Problem(robot, state, tm.JointGoal(state), v_start=silent)


def test_goal_velocities_are_read_by_joint_name(robot: tm.Robot) -> None:
    goal = tm.JointGoal({"joint3": 0.2, "joint1": 0.1}, v={"joint3": 1.0})
    problem = tm.Problem(robot, [0, 0], goal)
    np.testing.assert_array_equal(problem.goal.v, [0.0, 1.0])
    with pytest.raises(tm.ProblemError, match=r"expected goal\.q by name, too"):
        tm.JointGoal([0, 0], v={"joint1": 1.0})


@pytest.mark.parametrize(
    ("q", "match"),
    [
        ({"joint1": 0.0}, "has no value for joint3"),
        ({"joint1": 0.0, "joint3": 0.0, "joint9": 1.0}, "has a value for 'joint9'"),
        ({"joint1": 0.0, "joint3": 0.0, "joint2": 1.0}, "is 1.0, but it is locked at"),
        ({"joint1": 0.0, "joint3": "x"}, "joint 'joint3' is 'x', expected a number"),
        ({"joint1": 0.0, "joint3": np.nan}, "nan|NaN"),
        ({}, "expected .* numbers?|one number for each"),
        ({3: 0.0}, "expected numbers|has a value for 3"),
    ],
)
def test_wrong_values_by_joint_name_are_refused(
    q: object, match: str, robot: tm.Robot
) -> None:
    with pytest.raises(tm.ProblemError, match=match):
        tm.Problem(robot, q, tm.JointGoal([0, 0]))
    if "no value" in match:
        return  # joints that a goal does not name stay at the start
    with pytest.raises(tm.ProblemError, match=match):
        tm.Problem(robot, [0, 0], tm.JointGoal(q))


def test_error_on_an_unknown_joint_names_argument_and_known_joints(
    robot: tm.Robot,
) -> None:
    """Regression: messages on angles and couplings did not name the argument."""
    turning = tm.JointGoal([0, 0], wrap=["joint9"])
    region = tm.JointRegionGoal([0.0], 0.1, ["joint9"])
    coupled = tm.JointCoupling(["joint1", "joint9"], [1, 1], 1.0, -1.0)
    fast = tm.MotionLimits(jerk={"joint9": 1.0})
    refused: dict[str, Callable[[], object]] = {
        "locked_joints": lambda: robot.with_locked({"joint9": 0.0}),
        "effort": lambda: robot.with_changes(effort={"joint9": 1.0}),
        "jerk": lambda: tm.Problem(robot, [0, 0], region, motion_limits=fast),
        "goal.wrap": lambda: turning.validate(robot),
        "goal.joints": lambda: region.validate(robot),
        "joints": lambda: coupled.validate(robot),
    }
    for argument, call in refused.items():
        known = "joint1, joint(2, joint)?3"
        said = rf"{argument}: there is no joint 'joint9'.*; the robot has: {known}"
        with pytest.raises(tm.JointNotFound, match=f"^{said}$"):
            call()


def test_workcell_stacks_values_by_joint_name(robot: tm.Robot) -> None:
    cell = tm.Workcell({"a": (robot, (0, 0, 0)), "b": (robot, (9, 0, 0))})
    found = cell.stack({"a": [1, 2], "b": {"joint3": 4, "joint1": 3}})
    np.testing.assert_array_equal(found, [1, 2, 3, 4])
    goal = cell.goal({"a": tm.JointGoal({"joint3": 0.2, "joint1": 0.1}), "b": None})
    problem = tm.Problem(cell.robot, np.zeros(4), goal)
    low, _ = problem.goal.joint_ranges(cell.robot)
    np.testing.assert_allclose(low[:2], [0.1, 0.2])


def test_scenes_may_be_lists_of_obstacles() -> None:
    robot, start = tm.load_robot("planar3r"), [0.5, 1.7, -1.7]
    ball = tm.Sphere("ball", radius=0.1, position=(9, 0, 0))
    goal = tm.JointGoal([1.0, 1.0, 0.0])
    for scene in ([ball], (ball,), ball, tm.Scene([ball])):
        problem = tm.Problem(robot, start, goal, scene=scene)
        assert problem.scene == tm.Scene([ball])
        assert tm.Segment(goal, scene=scene).scene == tm.Scene([ball])
    loaded = tm.Payload(1.0, "tip", geometry=tm.Sphere("ball", radius=0.01))
    assert len(loaded.geometry) == 1
    with pytest.raises(tm.SceneError, match="two obstacles"):
        tm.Problem(robot, start, goal, scene=[ball, ball])
    with pytest.raises(tm.ProblemError, match=r"scene is {.*}, expected a Scene"):
        tm.Problem(robot, start, goal, scene={})
