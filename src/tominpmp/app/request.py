"""The request: the state of the page, from which the problem is made.

The problem and the equivalent lines of Python have a single source, the goals,
obstacles and limits of the library: the lines are the calls that make these records.
Numbers are rounded when they are set, so that the lines are short and exact.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import count
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from tominpmp.arrays import Array, Record, changed_fields
from tominpmp.datasheets import find_datasheet
from tominpmp.exceptions import RobotLoadError, quiet
from tominpmp.files.records import rotation_values
from tominpmp.goals.base import Goal
from tominpmp.goals.frames import PoseGoal, PositionGoal
from tominpmp.goals.joints import JointGoal
from tominpmp.kinematics import RobotKinematics
from tominpmp.motion_limits import MotionLimits
from tominpmp.problem.problem import Problem
from tominpmp.problem.segments import Segment
from tominpmp.robot.robot import Robot, load_robot, read_source
from tominpmp.scene.obstacles import Box, Capsule, Cylinder, Obstacle, Sphere

Triple = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
UPRIGHT: Quaternion = (0.0, 0.0, 0.0, 1.0)
# Decimals of positions [m] and configurations [rad or m], and of quaternions.
DIGITS, TURN_DIGITS = 4, 9
# Least number of joints with which a frame can reach a pose in general.
JOINTS_OF_A_POSE = 6
# Largest number of joints that fits on the page and is planned quickly enough.
MOST_JOINTS = 16
# Default acceleration limit of kinematic robots [rad/s^2 or m/s^2].
MODERATE = 15.0

# Obstacles to add, by the names of their kinds, in their default sizes [m].
SHAPES: dict[str, Obstacle] = {
    "box": Box("box", size=(0.15, 0.15, 0.15)),
    "sphere": Sphere("sphere", radius=0.1),
    "cylinder": Cylinder("cylinder", radius=0.06, length=0.3),
    "capsule": Capsule("capsule", radius=0.06, length=0.2),
}


def rounded(values: ArrayLike, digits: int = DIGITS) -> Any:
    """Round numbers to some decimals, as a tuple of Python numbers."""
    numbers = np.round(np.asarray(values, dtype=np.float64).ravel(), digits) + 0.0
    return tuple(numbers.tolist())


# Types of fields that are rounded; the problem checks the values.
Numbers: TypeAlias = Annotated[tuple[float, ...], lambda values, _: rounded(values)]
Points: TypeAlias = Annotated[
    tuple[Triple, ...], lambda points, _: tuple(map(rounded, points))
]


def _written(value: Any) -> str:
    """A value as a Python expression; records of a list have a line each."""
    if isinstance(value, Record):
        return f"tm.{type(value).__name__}({', '.join(_named(changed_fields(value)))})"
    if isinstance(value, pin.SE3):
        return _written([value.translation.tolist(), rotation_values(value.rotation)])
    if isinstance(value, np.ndarray):
        return repr(rotation_values(value) if value.ndim == 2 else value.tolist())
    if isinstance(value, list) and value and isinstance(value[0], Record):
        return "".join(["[", *(f"\n        {_written(k)}," for k in value), "\n    ]"])
    return repr(value)


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

    @property
    def options(self) -> dict[str, Any]:
        """Arguments with which the robot is loaded, after its source."""
        options = {
            "limits": self.limits,
            "group": self.group,
            "locked_joints": dict(self.locked),
            "kinematic": self.kinematic,
        }
        return {name: value for name, value in options.items() if value}


@lru_cache(maxsize=8)
@quiet()
def loaded(choice: RobotChoice) -> Robot:
    """Load a robot; the latest robots are cached.

    Raises:
        RobotLoadError: If its files cannot be read, or it has too many joints.
        OptionsError: If the group or the data sheet does not exist.
        JointNotFound: If a locked joint is unknown.
    """
    robot = load_robot(choice.source, **choice.options)
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


def sizes_of(obstacle: Obstacle) -> dict[str, float]:
    """Sizes of an obstacle by their names [m]."""
    if isinstance(obstacle, Box):
        return dict(zip("xyz", obstacle.size.tolist(), strict=True))
    names = (name for name in ("radius", "length") if hasattr(obstacle, name))
    return {name: getattr(obstacle, name) for name in names}


def resized(obstacle: Obstacle, sizes: Sequence[float]) -> Obstacle:
    """An obstacle with other sizes, in the order of :func:`sizes_of` [m].

    Raises:
        SceneError: If a size is wrong.
    """
    by_name = dict(zip(sizes_of(obstacle), sizes, strict=True))
    changes = {"size": sizes} if isinstance(obstacle, Box) else by_name
    return replace(obstacle, **changes)


def placed(
    obstacle: Obstacle, position: ArrayLike, quaternion: ArrayLike = UPRIGHT
) -> Obstacle:
    """An obstacle at another place, in rounded numbers.

    Args:
        obstacle: The obstacle.
        position: Position of its centre [m].
        quaternion: Its orientation (x, y, z, w).

    Raises:
        SceneError: If the position is wrong.
    """
    turn = rounded(quaternion, TURN_DIGITS)
    return replace(obstacle, position=rounded(position), rotation=turn)


def new_item(kind: str, position: ArrayLike, taken: Collection[str]) -> Obstacle:
    """An obstacle of default size, with an unused name."""
    name = next(n for k in count(1) if (n := f"{kind}{k}") not in taken)
    return placed(replace(SHAPES[kind], name=name), position)


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
    items: tuple[Obstacle, ...] = ()
    effort_scale: float = 1.0
    speed_scale: float = 1.0
    acceleration: float | None = None
    margin: float = 0.02

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
        return Problem(robot, **options)

    def python(self) -> str:
        """The lines of Python that make the problem and plan it."""
        choice = ", ".join((repr(self.robot.source), *_named(self.robot.options)))
        lines = ["import tominpmp as tm", "", f"robot = tm.load_robot({choice})"]
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
            via = [PositionGoal(self.frame, point) for point in self.via]
            options["segments"] = [Segment(item) for item in (*via, goal)]
        else:
            options["goal"] = goal
        if self.items:
            options["scene"] = list(self.items)
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
            options["motion_limits"] = MotionLimits(**limits)
        return options

    def _goal(self) -> Goal:
        """The goal of the problem, in rounded numbers."""
        if self.goal == "joint":
            return JointGoal(self.q_goal)
        position, quaternion = self.pose(self.q_goal)
        if self.goal == "position":
            return PositionGoal(self.frame, rounded(position))
        pose = rounded(position), rounded(quaternion, TURN_DIGITS)
        return PoseGoal(self.frame, pose)
