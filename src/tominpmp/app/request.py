"""The request: the state of the page, from which the problem is made.

The problem and the equivalent lines of Python have a single source, a tree of calls of
the library: evaluating it makes the problem, formatting it gives the lines. Numbers are
rounded when they are set, so that the lines are short and exact.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import count
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from tominpmp.arrays import Array, Record
from tominpmp.datasheets import find_datasheet
from tominpmp.exceptions import RobotLoadError, quiet
from tominpmp.files.records import classes
from tominpmp.goals.frames import PoseGoal, PositionGoal
from tominpmp.goals.joints import JointGoal
from tominpmp.kinematics import RobotKinematics
from tominpmp.motion_limits import MotionLimits
from tominpmp.problem.problem import Problem
from tominpmp.problem.segments import Segment
from tominpmp.robot.robot import Robot, load_robot, read_source
from tominpmp.scene.obstacles import Obstacle
from tominpmp.scene.scene import Scene

Triple = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
UPRIGHT: Quaternion = (0.0, 0.0, 0.0, 1.0)
# Decimals of positions [m] and configurations [rad or m].
DIGITS = 4
# Least number of joints with which a frame can reach a pose in general.
JOINTS_OF_A_POSE = 6
# Largest number of joints that fits on the page and is planned quickly enough.
MOST_JOINTS = 16
# Default acceleration limit of kinematic robots [rad/s^2 or m/s^2].
MODERATE = 15.0

# Sizes by kind, with the names of the library, and their default values [m].
SIZES: dict[str, dict[str, float]] = {
    "box": {"x": 0.15, "y": 0.15, "z": 0.15},
    "sphere": {"radius": 0.1},
    "cylinder": {"radius": 0.06, "length": 0.3},
    "capsule": {"radius": 0.06, "length": 0.2},
}


def rounded(values: ArrayLike, digits: int = DIGITS) -> Any:
    """Round numbers to some decimals, as a tuple of Python numbers."""
    numbers = np.round(np.asarray(values, dtype=np.float64).ravel(), digits) + 0.0
    return tuple(numbers.tolist())


def _rounded_turn(values: ArrayLike, _: str) -> Quaternion:
    quaternion: Quaternion = rounded(values, 6)
    return UPRIGHT if quaternion[3] in (1.0, -1.0) else quaternion


# Types of fields that are rounded; the problem checks the values.
Numbers: TypeAlias = Annotated[tuple[float, ...], lambda values, _: rounded(values)]
Point: TypeAlias = Annotated[Triple, lambda values, _: rounded(values)]
Points: TypeAlias = Annotated[
    tuple[Triple, ...], lambda points, _: tuple(map(rounded, points))
]
Turn: TypeAlias = Annotated[Quaternion, _rounded_turn]


class Call:
    """A call of the library that can be evaluated, or formatted as Python expression.

    Args:
        function: The function or class to call.
        arguments: Positional arguments; calls among them are evaluated first.
        options: Arguments by name, likewise.
    """

    def __init__(
        self, function: Callable[..., Any], *arguments: Any, **options: Any
    ) -> None:
        self._function, self._arguments, self._options = function, arguments, options

    def evaluate(self) -> Any:
        """Evaluate the call."""
        options = {name: _value(value) for name, value in self._options.items()}
        return self._function(*map(_value, self._arguments), **options)

    def __str__(self) -> str:
        """The expression."""
        parts = [*map(_written, self._arguments), *_named(self._options)]
        return f"tm.{self._function.__name__}({', '.join(parts)})"


def _value(value: Any) -> Any:
    if isinstance(value, list):
        return [_value(item) for item in value]
    return value.evaluate() if isinstance(value, Call) else value


def _written(value: Any) -> str:
    """Format an argument as Python expression; calls in a list have a line each."""
    if isinstance(value, list) and value and isinstance(value[0], Call):
        return "".join(["[", *(f"\n        {call}," for call in value), "\n    ]"])
    return str(value) if isinstance(value, Call) else repr(value)


def _named(options: Mapping[str, Any]) -> list[str]:
    """Arguments by name as Python expressions."""
    return [f"{name}={_written(value)}" for name, value in options.items()]


@dataclass(frozen=True)
class RobotChoice:
    """The choice of a robot: its source, and changes of its description.

    Attributes:
        source: Name of a robot, or path of a URDF file.
        group: Group of the SRDF file whose joints move; None for all joints.
        locked: Locked joints with their positions [rad or m].
        limits: "datasheet" for the limits that the maker publishes, "urdf" for the
            limits of its file, None for the library's choice.
        kinematic: Whether torques are left out.
    """

    source: str
    group: str | None = None
    locked: tuple[tuple[str, float], ...] = ()
    limits: str | None = None
    kinematic: bool = False

    def call(self) -> Call:
        """The call that loads the robot."""
        options = {
            "limits": self.limits,
            "group": self.group,
            "locked_joints": dict(self.locked),
            "kinematic": self.kinematic,
        }
        needed = {name: value for name, value in options.items() if value}
        return Call(load_robot, self.source, **needed)


@lru_cache(maxsize=8)
@quiet()
def loaded(choice: RobotChoice) -> Robot:
    """Load a robot; the latest robots are cached.

    Raises:
        RobotLoadError: If its files cannot be read, or it has too many joints.
        OptionsError: If the group or the data sheet does not exist.
        JointNotFound: If a locked joint is unknown.
    """
    robot: Robot = choice.call().evaluate()
    if robot.n > MOST_JOINTS:
        raise RobotLoadError(
            f"{robot.name} has {robot.n} joints that move, expected {MOST_JOINTS} at "
            "most: choose a group of joints, if its SRDF file has any",
            robot.urdf_path,
        )
    return robot


# The content of a robot's files; the latest are cached.
_source = lru_cache(maxsize=8)(quiet()(read_source))


def group_names(source: str) -> tuple[str, ...]:
    """Groups of a robot's SRDF file that have joints.

    Raises:
        RobotLoadError: If the robot is unknown, or its files are wrong.
    """
    semantics = _source(source).semantics
    groups = {} if semantics is None else semantics.groups
    return tuple(name for name, group in groups.items() if group.joints)


def follows_datasheet(choice: RobotChoice) -> bool | None:
    """Whether a robot has the limits of its data sheet; None without a data sheet.

    Raises:
        RobotLoadError: If the robot is unknown, or its files are wrong.
    """
    source = _source(choice.source)
    if find_datasheet(*source.description.known_as(source.name)) is None:
        return None
    named = source.name is not None
    return named if choice.limits is None else choice.limits == "datasheet"


@dataclass(frozen=True, eq=False)
class Item(Record):
    """An obstacle of the request: its kind, sizes and placement.

    Attributes:
        kind: "box", "sphere", "cylinder" or "capsule".
        name: Its name, unique in the scene.
        size: Its sizes in the order of ``SIZES`` [m].
        position: Position of its centre [m].
        quaternion: Its orientation (x, y, z, w).
    """

    kind: str
    name: str
    size: Numbers
    position: Point
    quaternion: Turn = UPRIGHT

    def call(self) -> Call:
        """The call that makes the obstacle of the problem.

        The call raises a SceneError if a size or a position is wrong.
        """
        options: dict[str, Any] = {"size": self.size}
        if self.kind != "box":
            options = dict(zip(SIZES[self.kind], self.size, strict=True))
        options["position"] = self.position
        if self.quaternion != UPRIGHT:
            options["rotation"] = self.quaternion
        return Call(classes(Obstacle)[self.kind], self.name, **options)


def new_item(kind: str, position: ArrayLike, taken: tuple[str, ...]) -> Item:
    """An obstacle of default size, with an unused name."""
    name = next(n for k in count(1) if (n := f"{kind}{k}") not in taken)
    return Item(kind, name, tuple(SIZES[kind].values()), rounded(position))


@dataclass(frozen=True, eq=False, kw_only=True)
class Request(Record):
    """Robot, start, goal, scene and limits; plain numbers, so that requests compare.

    Attributes:
        robot: The choice of the robot.
        frame: The frame that handles move.
        q_start: Configuration at the start, n numbers [rad or m].
        q_goal: Configuration that defines the goal, n numbers [rad or m].
        goal: Kind of the goal: "joint" (the configuration ``q_goal``), "pose" (the
            frame's pose in it) or "position" (the frame's position in it).
        via: Via points of the frame [m].
        items: The obstacles.
        effort_scale: Share of the torque limits that may be used, above 0, 1 at most.
        speed_scale: Share of the speed limits, likewise.
        acceleration: Limit of all accelerations [rad/s^2 or m/s^2], beside lower ones
            of the robot; None for the robot's limits only.
        margin: Distance to keep from obstacles [m].
    """

    robot: RobotChoice
    frame: str
    q_start: Numbers
    q_goal: Numbers
    goal: Literal["joint", "pose", "position"] = "joint"
    via: Points = ()
    items: tuple[Item, ...] = ()
    effort_scale: float = 1.0
    speed_scale: float = 1.0
    acceleration: float | None = None
    margin: float = 0.02

    def items_with(self, name: str, **changes: Any) -> tuple[Item, ...]:
        """The obstacles, with fields of the named one changed."""
        return tuple(
            replace(item, **changes) if item.name == name else item
            for item in self.items
        )

    @property
    def turns(self) -> bool:
        """Whether handles control the orientation of the frame, too."""
        return len(self.q_start) >= JOINTS_OF_A_POSE

    def pose(self, q: tuple[float, ...]) -> tuple[Array, Array]:
        """Position [m] and quaternion (x, y, z, w) of the frame at a configuration."""
        kinematics = RobotKinematics(loaded(self.robot))
        both = pin.SE3ToXYZQUAT(kinematics.placement(np.array(q), self.frame))
        return both[:3], both[3:]

    def problem(self) -> Problem:
        """The problem of the request.

        Raises:
            TominpmpError: If a value is wrong, the robot cannot be loaded, or start or
                goal are in collision.
        """
        options = self._options()
        robot, scale = loaded(self.robot), self.speed_scale
        if scale != 1.0:
            robot = robot.with_changes(velocity=scale * robot.limits.velocity)
        problem: Problem = Call(Problem, robot, **options).evaluate()
        return problem

    def python(self) -> str:
        """The lines of Python that make the problem and plan it."""
        lines = ["import tominpmp as tm", "", f"robot = {self.robot.call()}"]
        if self.speed_scale != 1.0:
            speeds = f"{self.speed_scale!r} * robot.limits.velocity"
            lines.append(f"robot = robot.with_changes(velocity={speeds})")
        lines.append("problem = tm.Problem(")
        arguments = "robot", *_named(self._options())
        lines += [f"    {argument}," for argument in arguments]
        lines += [")", "solution = tm.plan(problem)", "print(solution.message)"]
        return "\n".join(lines) + "\n"

    def _options(self) -> dict[str, Any]:
        """Arguments of the problem by name, except the robot."""
        options: dict[str, Any] = {"q_start": list(self.q_start)}
        goal = self._goal()
        if self.via:
            via = [Call(PositionGoal, self.frame, point) for point in self.via]
            options["segments"] = [Call(Segment, item) for item in (*via, goal)]
        else:
            options["goal"] = goal
        if self.items:
            options["scene"] = Call(Scene, [item.call() for item in self.items])
        options["margin"] = self.margin
        limits: dict[str, Any] = {}
        if self.effort_scale != 1.0:
            limits["effort_scale"] = self.effort_scale
        if self.acceleration is not None:
            robot = loaded(self.robot)
            own = robot.motion_limits or MotionLimits()
            bounds = own.by_joint("acceleration", robot.joint_names)
            values = np.minimum(bounds, self.acceleration).tolist()
            limits["acceleration"] = values if len(set(values)) > 1 else values[0]
        if limits:
            options["motion_limits"] = Call(MotionLimits, **limits)
        return options

    def _goal(self) -> Call:
        """The call that makes the goal."""
        if self.goal == "joint":
            return Call(JointGoal, list(self.q_goal))
        position, quaternion = self.pose(self.q_goal)
        if self.goal == "position":
            return Call(PositionGoal, self.frame, rounded(position))
        return Call(PoseGoal, self.frame, (rounded(position), rounded(quaternion, 9)))
