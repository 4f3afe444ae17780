"""A planning problem: robot, start, goal, scene; checked when it is made."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from tominpmp.arrays import Array, frozen_array
from tominpmp.collision import CollisionChecker
from tominpmp.dynamics import RobotDynamics
from tominpmp.exceptions import ProblemError, TominpmpWarning
from tominpmp.goals import FrameGoal, Goal, JointGoal, PoseGoal, PositionGoal
from tominpmp.kinematics import RobotKinematics
from tominpmp.robot import Robot
from tominpmp.scene import Scene

# A start or goal that is this little outside a limit is taken to be on it [rad or m]:
# encoders and files round.
SNAP = 1e-6


@dataclass(frozen=True, eq=False)
class Problem:
    """Bring a robot from a state to a goal in minimum time.

    Attributes:
        robot: The robot.
        q_start: Positions at the start, shape (n,) [rad or m].
        goal: What must hold at the end.
        scene: The obstacles.
        margin: Distance that the links keep from them [m].
        v_start: Velocities at the start, shape (n,) [rad/s or m/s]; None for rest.

    Raises:
        ProblemError: If a value is wrong: the message names the joint, the value and
            what was expected.
        FrameNotFound: If the goal is on a frame that the robot has not.
    """

    robot: Robot
    q_start: Array
    goal: Goal
    scene: Scene = field(default_factory=Scene)
    margin: float = 0.0
    v_start: Array | None = None

    def __post_init__(self) -> None:
        """Check everything that can be told without planning."""
        if not isinstance(self.robot, Robot):
            raise ProblemError(
                f"robot is a {type(self.robot).__name__}, expected a Robot "
                "(see load_robot)",
                "robot",
            )
        if not isinstance(self.goal, Goal):
            raise ProblemError(
                f"goal is a {type(self.goal).__name__}, expected a JointGoal, "
                "PositionGoal or PoseGoal",
                "goal",
            )
        scene = Scene() if self.scene is None else self.scene
        if not isinstance(scene, Scene):
            raise ProblemError(
                f"scene is a {type(scene).__name__}, expected a Scene", "scene"
            )
        object.__setattr__(self, "scene", scene)
        if not (np.isfinite(self.margin) and self.margin >= 0.0):
            raise ProblemError(
                f"margin is {self.margin}, expected a length >= 0 [m]", "margin"
            )
        robot = self.robot
        v_start = np.zeros(robot.n) if self.v_start is None else self.v_start
        q = self._vector(self.q_start, "q_start")
        v = self._vector(v_start, "v_start")
        self._set("q_start", self._inside_position(q, "q_start"))
        self._set("v_start", self._inside_velocity(v, "v_start"))
        self.goal.validate(robot)
        checker = CollisionChecker(robot, scene)
        self._check_clear(checker, self.q_start, "start")
        if isinstance(self.goal, JointGoal):
            self._check_joint_goal(self.goal, checker)
        elif isinstance(self.goal, FrameGoal):
            self._check_reach(self.goal)

    def _set(self, name: str, value: Array) -> None:
        object.__setattr__(self, name, frozen_array(value))

    def _vector(self, value: ArrayLike, name: str) -> Array:
        try:
            array = np.asarray(value, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise ProblemError(
                f"{name} is {value!r}, expected {self.robot.n} numbers", name
            ) from error
        joints = self.robot.joint_names
        if array.shape != (self.robot.n,):
            raise ProblemError(
                f"{name} has shape {array.shape}, expected {self.robot.n} numbers, one "
                f"for each of: {', '.join(joints)}",
                name,
            )
        for joint, number in zip(joints, array, strict=True):
            if not np.isfinite(number):
                raise ProblemError(
                    f"{name}: joint {joint!r} is {number}, expected a finite number",
                    name,
                )
        return array

    def _inside_position(self, q: Array, name: str) -> Array:
        limits = self.robot.limits
        lower, upper = limits.position_lower, limits.position_upper
        clipped = np.clip(q, lower, upper)
        for i, joint in enumerate(self.robot.joint_names):
            if abs(clipped[i] - q[i]) > SNAP:
                raise ProblemError(
                    f"{name}: joint {joint!r} is {q[i]:.6g}, outside its limits "
                    f"[{lower[i]:.6g}, {upper[i]:.6g}]",
                    name,
                )
            if clipped[i] != q[i]:
                warnings.warn(
                    f"{name}: joint {joint!r} is {abs(clipped[i] - q[i]):.1e} outside "
                    "its limits and was set to the limit",
                    TominpmpWarning,
                    stacklevel=5,
                )
        return clipped

    def _inside_velocity(self, v: Array, name: str) -> Array:
        limit = self.robot.limits.velocity
        for i, joint in enumerate(self.robot.joint_names):
            if abs(v[i]) > limit[i] + SNAP:
                raise ProblemError(
                    f"{name}: joint {joint!r} moves at {v[i]:.6g}, beyond its velocity "
                    f"limit {limit[i]:.6g}",
                    name,
                )
        return np.clip(v, -limit, limit)

    def _check_clear(self, checker: CollisionChecker, q: Array, which: str) -> None:
        contact = checker.closest(q)
        if contact is None or contact.distance >= self.margin - SNAP:
            return
        depth = (
            f"overlap by {-contact.distance:.4g} m"
            if contact.distance < 0.0
            else f"are {contact.distance:.4g} m apart, less than the margin "
            f"{self.margin:.4g} m"
        )
        raise ProblemError(
            f"{which} in collision: {contact.link!r} and {contact.obstacle!r} {depth} "
            f"at q = {np.round(q, 4).tolist()}",
            "q_start" if which == "start" else "goal",
        )

    def _check_joint_goal(self, goal: JointGoal, checker: CollisionChecker) -> None:
        q = self._inside_position(self._vector(goal.q, "goal.q"), "goal.q")
        v = self._inside_velocity(goal.final_velocity(self.robot.n), "goal.v")
        if not np.array_equal(q, goal.q):
            object.__setattr__(self, "goal", JointGoal(q, goal.v))
        self._check_clear(checker, q, "goal")
        if np.any(v):
            return
        tau = RobotDynamics(self.robot).inverse(q[None], v[None], 0.0 * v[None])[0]
        limits = self.robot.limits
        for i, joint in enumerate(self.robot.joint_names):
            low, high = limits.effort_lower[i], limits.effort_upper[i]
            slack = 1e-9 * max(1.0, abs(low), abs(high))
            if not low - slack <= tau[i] <= high + slack:
                raise ProblemError(
                    f"goal: joint {joint!r} cannot hold the arm against gravity there: "
                    f"{tau[i]:.4g} N m needed, [{low:.4g}, {high:.4g}] allowed",
                    "goal",
                )

    def _check_reach(self, goal: FrameGoal) -> None:
        if isinstance(goal, PositionGoal):
            target = goal.position
        elif isinstance(goal, PoseGoal):
            target = goal.pose.translation
        else:
            return
        reach = RobotKinematics(self.robot).reach()
        distance = float(np.linalg.norm(target))
        if distance > reach * (1.0 + 1e-9):
            raise ProblemError(
                f"goal: {np.round(target, 4).tolist()} is {distance:.4g} m from the base, "
                f"and frame {goal.frame!r} reaches {reach:.4g} m at most: outside reach "
                f"by {distance - reach:.4g} m",
                "goal",
            )
