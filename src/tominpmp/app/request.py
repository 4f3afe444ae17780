"""What was asked for: the state of the page, from which the problem is made.

The problem and the lines of Python that make the same are told once, as calls of the
library: they are made for the one, and written for the other. Numbers are rounded where
they are set, so that the lines are short and exact.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from typing import Annotated, Any, TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from tominpmp.arrays import Record
from tominpmp.checks import choice, number, wrong
from tominpmp.datasheets import find_datasheet
from tominpmp.exceptions import RobotLoadError, SceneError, TominpmpWarning
from tominpmp.goals.frames import PoseGoal, PositionGoal
from tominpmp.goals.joints import JointGoal
from tominpmp.kinematics import RobotKinematics
from tominpmp.motion_limits import MotionLimits
from tominpmp.problem.problem import Problem
from tominpmp.problem.segments import Segment
from tominpmp.robot.robot import Robot, RobotSource, load_robot, read_source
from tominpmp.scene.obstacles import Box, Capsule, Cylinder, Obstacle, Sphere
from tominpmp.scene.scene import Scene

Triple = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
UPRIGHT: Quaternion = (0.0, 0.0, 0.0, 1.0)
# Digits after the point of positions [m] and of configurations [rad or m].
DIGITS = 4
# More joints than this do not fit on a page, nor can they be planned while one drags.
MOST_JOINTS = 16
# Accelerations that arms keep, where one must be given [rad/s^2 or m/s^2].
MODERATE = 15.0
# What must hold at the end, beside "joint" the pose of the frame or its position only.
GOALS = ("joint", "pose", "position")

KINDS: dict[str, Callable[..., Obstacle]] = {
    kind.__name__.lower(): kind for kind in (Box, Sphere, Cylinder, Capsule)
}
# Sizes by kind, as the library's obstacles call them, and what a new one has [m].
SIZES: dict[str, dict[str, float]] = {
    "box": {"x": 0.15, "y": 0.15, "z": 0.15},
    "sphere": {"radius": 0.1},
    "cylinder": {"radius": 0.06, "length": 0.3},
    "capsule": {"radius": 0.06, "length": 0.2},
}


def rounded(values: ArrayLike, digits: int = DIGITS) -> Any:
    """Numbers of Python with so many digits after the point, as a tuple."""
    numbers = np.round(np.asarray(values, dtype=np.float64).ravel(), digits) + 0.0
    return tuple(numbers.tolist())


def _rounded_turn(values: ArrayLike, _: str) -> Quaternion:
    turned: Quaternion = rounded(values, 6)
    return UPRIGHT if turned[3] in (1.0, -1.0) else turned


# Types of fields that are rounded, or checked.
Numbers: TypeAlias = Annotated[tuple[float, ...], lambda values, _: rounded(values)]
Point: TypeAlias = Annotated[Triple, lambda values, _: rounded(values)]
Points: TypeAlias = Annotated[
    tuple[Triple, ...], lambda points, _: tuple(map(rounded, points))
]
Turn: TypeAlias = Annotated[Quaternion, _rounded_turn]
GoalKind: TypeAlias = Annotated[str, lambda value, name: choice(value, GOALS, name)]
SpeedShare: TypeAlias = Annotated[
    float, partial(number, expected="a share above 0, 1 at most", above=0.0, most=1.0)
]


@dataclass(frozen=True)
class Call:
    """A call of the library that can be made, and written as an expression of Python.

    Attributes:
        function: What is called.
        given: Its arguments; calls among them are made first.
        options: Its arguments by name.
        module: What its module is called in Python.
    """

    function: Callable[..., Any]
    given: tuple[Any, ...] = ()
    options: Mapping[str, Any] = field(default_factory=dict)
    module: str = "tm"

    def made(self) -> Any:
        """Make the call."""
        options = {name: _made(value) for name, value in self.options.items()}
        return self.function(*map(_made, self.given), **options)

    def __str__(self) -> str:
        """The expression."""
        parts = [*map(_written, self.given)]
        parts += [f"{name}={_written(value)}" for name, value in self.options.items()]
        return f"{self.module}.{self.function.__name__}({', '.join(parts)})"


def _made(value: Any) -> Any:
    if isinstance(value, list):
        return [_made(item) for item in value]
    return value.made() if isinstance(value, Call) else value


def _written(value: Any) -> str:
    """An argument of the problem in Python; of calls in a list, one a line."""
    if isinstance(value, list) and value and isinstance(value[0], Call):
        return "".join(["[", *(f"\n        {call}," for call in value), "\n    ]"])
    return str(value) if isinstance(value, Call) else repr(value)


@dataclass(frozen=True)
class RobotChoice:
    """Which robot: where it is read from, and what is different from its files.

    Attributes:
        source: Name of a robot, or path of a URDF file.
        group: Group of the SRDF file whose joints move; None for all.
        locked: Joints that do not move, and where they are [rad or m].
        limits: "datasheet" for those that the maker publishes, "urdf" for those of its
            file, None for the library's choice.
        kinematic: Whether it is planned without torques.
    """

    source: str
    group: str | None = None
    locked: tuple[tuple[str, float], ...] = ()
    limits: str | None = None
    kinematic: bool = False

    def call(self) -> Call:
        """The call that loads it."""
        options = {
            "limits": self.limits,
            "group": self.group,
            "locked_joints": dict(self.locked),
            "kinematic": self.kinematic,
        }
        needed = {name: value for name, value in options.items() if value}
        return Call(load_robot, (self.source,), needed)


@lru_cache(maxsize=8)
def loaded(choice: RobotChoice) -> Robot:
    """Load a robot, once.

    Raises:
        RobotLoadError: If its files cannot be read, or it has too many joints.
        OptionsError: If there is no such group or data sheet.
        JointNotFound: If a locked joint is unknown.
    """
    with warnings.catch_warnings():
        # What is odd about a description was said when it was chosen.
        warnings.simplefilter("ignore", TominpmpWarning)
        robot: Robot = choice.call().made()
    if robot.n > MOST_JOINTS:
        raise RobotLoadError(
            f"{robot.name} has {robot.n} joints that move, expected {MOST_JOINTS} at "
            "most: choose a group of joints, if its SRDF file has any",
            robot.urdf_path,
        )
    return robot


@lru_cache(maxsize=8)
def _said(source: str) -> RobotSource:
    """What the files of a robot say, read once.

    Raises:
        RobotLoadError: If there is no such robot, or its files are wrong.
    """
    return read_source(source)


def group_names(source: str) -> tuple[str, ...]:
    """Groups of joints that a robot's SRDF file has and that can move.

    Raises:
        RobotLoadError: If there is no such robot, or its files are wrong.
    """
    said = _said(source).semantics
    if said is None:
        return ()
    return tuple(name for name, group in said.groups.items() if group.joints)


def follows_datasheet(choice: RobotChoice) -> bool | None:
    """Whether its limits are those that the maker publishes; None if none are known.

    Raises:
        RobotLoadError: If there is no such robot, or its files are wrong.
    """
    source = _said(choice.source)
    joints = [joint.name for joint in source.description.joints]
    if find_datasheet(source.names, joints) is None:
        return None
    named = source.files.name is not None
    return named if choice.limits is None else choice.limits == "datasheet"


@dataclass(frozen=True, eq=False)
class Item(Record):
    """An obstacle as one drags it: a kind, its sizes, and where it is.

    Attributes:
        kind: "box", "sphere", "cylinder" or "capsule".
        name: Its name, unique in the scene.
        size: Its sizes in the order of ``SIZES`` [m].
        position: Where its centre is [m].
        quaternion: How it is turned (x, y, z, w).

    Raises:
        SceneError: If there is no such kind, or the number of sizes is wrong.
    """

    kind: str
    name: str
    size: Numbers
    position: Point
    quaternion: Turn = UPRIGHT

    def __post_init__(self) -> None:
        """Check kind and number of sizes; the obstacle checks the rest."""
        super().__post_init__()

        def error(message: str, _: str) -> SceneError:
            return SceneError(f"obstacle {self.name!r}: {message}", self.name)

        choice(self.kind, tuple(SIZES), "kind", error=error)
        sizes = SIZES[self.kind]
        if len(self.size) != len(sizes):
            expected = f"{len(sizes)} lengths: {', '.join(sizes)} [m]"
            raise wrong(self.size, "size", expected, error)

    def call(self) -> Call:
        """The call that makes the obstacle that the library plans around.

        The call raises SceneError if a size or a position is wrong.
        """
        given: dict[str, Any] = {"size": self.size}
        if self.kind != "box":
            given = dict(zip(SIZES[self.kind], self.size, strict=True))
        given["position"] = self.position
        if self.quaternion != UPRIGHT:
            given["rotation"] = self.quaternion
        return Call(KINDS[self.kind], (self.name,), given)


def new_item(kind: str, position: ArrayLike, taken: tuple[str, ...]) -> Item:
    """An obstacle of usual size, with a name that is not taken yet.

    Raises:
        SceneError: If there is no such kind.
    """
    number = 1
    while f"{kind}{number}" in taken:
        number += 1
    sizes = tuple(SIZES.get(kind, {}).values())
    return Item(kind, f"{kind}{number}", sizes, rounded(position))


@dataclass(frozen=True, eq=False)
class Limits(Record):
    """Limits as sliders set them.

    Attributes:
        effort_scale: Share of the torque limits that may be used, above 0, 1 at most.
        speed_scale: Share of the speed limits likewise.
        acceleration: Limit of all accelerations [rad/s^2 or m/s^2]; None for none
            beyond the robot's.
        margin: Distance to keep from obstacles [m].

    Raises:
        ProblemError: If the share of the speed limits is none; the problem checks the
            rest.
    """

    effort_scale: float = 1.0
    speed_scale: SpeedShare = 1.0
    acceleration: float | None = None
    margin: float = 0.02


@dataclass(frozen=True, eq=False, kw_only=True)
class Request(Record):
    """Robot, start, goal, scene and limits; plain numbers, so that requests compare.

    Attributes:
        robot: Which robot.
        frame: The frame that handles move.
        q_start: Configuration at the start, n numbers [rad or m].
        q_goal: Configuration at the end [rad or m], of which ``goal`` may ask less.
        goal: What must hold at the end: "joint" (that configuration), "pose" (the
            frame's pose in it) or "position" (the frame's position).
        via: Points that the frame passes on its way [m].
        items: The obstacles.
        limits: The limits.

    Raises:
        ProblemError: If there is no such kind of goal.
    """

    robot: RobotChoice
    frame: str
    q_start: Numbers
    q_goal: Numbers
    goal: GoalKind = "joint"
    via: Points = ()
    items: tuple[Item, ...] = ()
    limits: Limits = field(default_factory=Limits)

    def items_with(self, name: str, **changes: Any) -> tuple[Item, ...]:
        """The obstacles, with fields of one of them changed."""
        return tuple(
            replace(item, **changes) if item.name == name else item
            for item in self.items
        )

    def problem(self) -> Problem:
        """The problem that is planned.

        Raises:
            TominpmpError: If a value is wrong, the robot cannot be loaded, or start or
                goal are in collision.
        """
        options = self._options()
        robot, scale = loaded(self.robot), self.limits.speed_scale
        if scale != 1.0:
            robot = robot.with_changes(velocity=scale * robot.limits.velocity)
        problem: Problem = Call(Problem, (robot,), options).made()
        return problem

    def python(self) -> str:
        """The lines of Python that make the same problem and plan it."""
        arguments = [
            f"{name}={_written(value)}" for name, value in self._options().items()
        ]
        lines = ["import tominpmp as tm", "", f"robot = {self.robot.call()}"]
        if self.goal == "pose":
            lines[:0] = ["import numpy as np", "import pinocchio as pin"]
        if self.limits.speed_scale != 1.0:
            speeds = f"{self.limits.speed_scale!r} * robot.limits.velocity"
            lines.append(f"robot = robot.with_changes(velocity={speeds})")
        lines.append("problem = tm.Problem(")
        lines += [f"    {argument}," for argument in ("robot", *arguments)]
        lines += [")", "solution = tm.plan(problem)", "print(solution.message)"]
        return "\n".join(lines) + "\n"

    def _options(self) -> dict[str, Any]:
        """Arguments of the problem by name, but for the robot."""
        options: dict[str, Any] = {"q_start": list(self.q_start)}
        goal = self._goal()
        if self.via:
            passed = [Call(PositionGoal, (self.frame, point)) for point in self.via]
            options["segments"] = [Call(Segment, (one,)) for one in (*passed, goal)]
        else:
            options["goal"] = goal
        if self.items:
            options["scene"] = Call(Scene, ([item.call() for item in self.items],))
        options["margin"] = self.limits.margin
        limits: dict[str, float] = {}
        if self.limits.effort_scale != 1.0:
            limits["effort_scale"] = self.limits.effort_scale
        if self.limits.acceleration is not None:
            limits["acceleration"] = self.limits.acceleration
        if limits:
            options["motion_limits"] = Call(MotionLimits, (), limits)
        return options

    def _goal(self) -> Call:
        """What must hold at the end."""
        if self.goal == "joint":
            return Call(JointGoal, (list(self.q_goal),))
        kinematics = RobotKinematics(loaded(self.robot))
        place = pin.SE3ToXYZQUAT(
            kinematics.placement(np.array(self.q_goal), self.frame)
        )
        position = rounded(place[:3])
        if self.goal == "position":
            return Call(PositionGoal, (self.frame, position))
        numbers = [*position, *rounded(place[3:], 9)]
        array = Call(np.array, (numbers,), module="np")
        pose = Call(pin.XYZQUATToSE3, (array,), module="pin")
        return Call(PoseGoal, (self.frame, pose))
