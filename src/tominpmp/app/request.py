"""What was asked for: the state of the page, from which the problem is made."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pinocchio as pin

from tominpmp.app.choice import RobotChoice, loaded
from tominpmp.app.items import Item, Triple
from tominpmp.app.numbers import list_text, rounded, tuple_text
from tominpmp.exceptions import ProblemError, brief
from tominpmp.goals import Goal, JointGoal, PoseGoal, PositionGoal
from tominpmp.kinematics import RobotKinematics
from tominpmp.motion_limits import MotionLimits
from tominpmp.problem import Problem
from tominpmp.problem.segments import Segment
from tominpmp.robot import Robot
from tominpmp.scene import Scene

# What must hold at the end, beside "joint" the pose of the frame or its position only.
GOALS = ("joint", "pose", "position")


@dataclass(frozen=True)
class Limits:
    """Limits as sliders set them.

    Attributes:
        effort_scale: Share of the torque limits that may be used, above 0, 1 at most.
        speed_scale: Share of the speed limits likewise.
        acceleration: Limit of all accelerations [rad/s^2 or m/s^2]; None for none
            beyond the robot's.
        margin: Distance to keep from obstacles [m].
    """

    effort_scale: float = 1.0
    speed_scale: float = 1.0
    acceleration: float | None = None
    margin: float = 0.02

    def __post_init__(self) -> None:
        """Check what nothing else checks."""
        if not 0.0 < self.speed_scale <= 1.0:
            raise ProblemError(
                f"speed_scale is {brief(self.speed_scale)}, expected a share above 0, "
                "1 at most",
                "speed_scale",
            )

    def arguments(self) -> dict[str, Any]:
        """Arguments of ``MotionLimits``, without those not needed."""
        found = {}
        if self.effort_scale != 1.0:
            found["effort_scale"] = self.effort_scale
        if self.acceleration is not None:
            found["acceleration"] = self.acceleration
        return found


@dataclass(frozen=True, kw_only=True)
class Request:
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
    q_start: tuple[float, ...]
    q_goal: tuple[float, ...]
    goal: str = "joint"
    via: tuple[Triple, ...] = ()
    items: tuple[Item, ...] = ()
    limits: Limits = field(default_factory=Limits)

    def __post_init__(self) -> None:
        """Round the numbers, so that the lines of Python say them all."""
        if self.goal not in GOALS:
            raise ProblemError(
                f"goal is {brief(self.goal)}, expected one of: {', '.join(GOALS)}",
                "goal",
            )
        for name in ("q_start", "q_goal"):
            object.__setattr__(self, name, rounded(getattr(self, name)))
        object.__setattr__(self, "via", tuple(rounded(point) for point in self.via))

    def with_item(self, changed: Item) -> Request:
        """The same with one of the obstacles, told by its name, changed."""
        items = tuple(changed if i.name == changed.name else i for i in self.items)
        return replace(self, items=items)

    def without_item(self, name: str) -> Request:
        """The same without one of the obstacles."""
        return replace(self, items=tuple(i for i in self.items if i.name != name))

    @property
    def final_pose(self) -> tuple[Triple, tuple[float, ...]]:
        """Position of the frame at the goal, and its quaternion (x, y, z, w)."""
        kinematics = RobotKinematics(loaded(self.robot))
        place = pin.SE3ToXYZQUAT(
            kinematics.placement(np.array(self.q_goal), self.frame)
        )
        return rounded(place[:3]), rounded(place[3:], 9)

    def ready_robot(self) -> Robot:
        """The robot with its speed limits scaled.

        Raises:
            TominpmpError: If it cannot be loaded.
        """
        robot = loaded(self.robot)
        scale = self.limits.speed_scale
        if scale == 1.0:
            return robot
        return robot.with_changes(velocity=scale * robot.limits.velocity)

    def final_goal(self) -> Goal:
        """What must hold at the end."""
        if self.goal == "joint":
            return JointGoal(self.q_goal)
        position, quaternion = self.final_pose
        if self.goal == "position":
            return PositionGoal(self.frame, position)
        return PoseGoal(self.frame, pose(position, quaternion))

    def problem(self) -> Problem:
        """The problem that is planned.

        Raises:
            TominpmpError: If a value is wrong, the robot cannot be loaded, or start or
                goal are in collision.
        """
        goal = self.final_goal()
        given = self.limits.arguments()
        passed = [PositionGoal(self.frame, point) for point in self.via]
        return Problem(
            self.ready_robot(),
            self.q_start,
            None if self.via else goal,  # type: ignore[arg-type]
            scene=Scene([item.obstacle() for item in self.items]),
            margin=self.limits.margin,
            motion_limits=MotionLimits(**given) if given else None,
            segments=[Segment(one) for one in (*passed, goal)] if self.via else (),
        )

    def python(self) -> str:
        """The lines of Python that make the same problem and plan it."""
        lines = ["import tominpmp as tm"]
        goal = self._goal_lines(lines)
        lines += ["", *self._robot_lines(), *self._scene_lines(), ""]
        arguments = ["robot", f"q_start={list_text(self.q_start)}"]
        if self.via:
            inner = [
                f"tm.PositionGoal({self.frame!r}, {tuple_text(p)})" for p in self.via
            ]
            lines += ["segments = ["]
            lines += [f"    tm.Segment({one})," for one in (*inner, goal)]
            lines += ["]"]
            arguments.append("segments=segments")
        else:
            arguments.append(f"goal={goal}")
        if self.items:
            arguments.append("scene=scene")
        arguments.append(f"margin={self.limits.margin!r}")
        given = self.limits.arguments()
        if given:
            inside = ", ".join(f"{name}={value!r}" for name, value in given.items())
            arguments.append(f"motion_limits=tm.MotionLimits({inside})")
        lines += ["problem = tm.Problem(", *(f"    {one}," for one in arguments), ")"]
        lines += ["solution = tm.plan(problem)", "print(solution.message)"]
        return "\n".join(lines) + "\n"

    def _goal_lines(self, lines: list[str]) -> str:
        """The goal as an expression; what it needs first is added to the lines."""
        if self.goal == "joint":
            return f"tm.JointGoal({list_text(self.q_goal)})"
        position, quaternion = self.final_pose
        if self.goal == "position":
            return f"tm.PositionGoal({self.frame!r}, {tuple_text(position)})"
        lines[:0] = ["import numpy as np", "import pinocchio as pin"]
        numbers = list_text((*position, *quaternion))
        return f"tm.PoseGoal({self.frame!r}, pin.XYZQUATToSE3(np.array({numbers})))"

    def _robot_lines(self) -> list[str]:
        given = [repr(self.robot.source)]
        given += [f"{name}={value!r}" for name, value in self.robot.arguments().items()]
        lines = [f"robot = tm.load_robot({', '.join(given)})"]
        scale = self.limits.speed_scale
        if scale != 1.0:
            speeds = f"{scale!r} * robot.limits.velocity"
            lines.append(f"robot = robot.with_changes(velocity={speeds})")
        return lines

    def _scene_lines(self) -> list[str]:
        if not self.items:
            return []
        return [
            "scene = tm.Scene(",
            "    [",
            *(f"        {item.python()}," for item in self.items),
            "    ]",
            ")",
        ]


def pose(position: Triple, quaternion: tuple[float, ...]) -> pin.SE3:
    """Placement from a position [m] and a quaternion (x, y, z, w)."""
    return pin.XYZQUATToSE3(np.array([*position, *quaternion]))
