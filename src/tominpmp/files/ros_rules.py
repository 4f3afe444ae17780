"""What ROS 2's joint trajectory controller refuses, or does not follow as meant.

The rules are those of its documentation and of its messages in the log, from Humble on.
Drivers that take the same message (Universal Robots, Franka, MoveIt) have them too.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tominpmp.checks import instance, wrong
from tominpmp.description.fields import Field
from tominpmp.exceptions import ProblemError, brief, shortened
from tominpmp.files.ros import POINT_FIELDS, find_trajectory
from tominpmp.motion.samples import BILLION, Samples

# A velocity at the end up to this is rest [rad/s or m/s]: rounding of single precision.
REST = float(np.finfo(np.float32).eps)
# Seconds of a Duration are 32 bits wide.
MAX_SECONDS = 2**31
TOLERANCES = (
    "path_tolerance",
    "goal_tolerance",
    "component_path_tolerance",
    "component_goal_tolerance",
)


@dataclass(frozen=True)
class Refusal:
    """A rule that a message breaks.

    Attributes:
        reason: What is wrong, in a clause.
        field: Field of the message or point.
        point: Index of the point, from 0; None if it is about the whole.
        joint: The joint, if it is about one.
    """

    reason: str
    field: str
    point: int | None = None
    joint: str | None = None

    def __str__(self) -> str:
        """Say where, and what is wrong."""
        where = self.field if self.point is None else f"points[{self.point}]"
        if self.point is not None and self.field:
            where += f".{self.field}"
        if self.joint is not None:
            where += f", joint {shortened(self.joint)}"
        return f"{where}: {self.reason}"


def controller_refusals(
    message: object,
    joint_names: Sequence[str] | None = None,
    *,
    effort_interface: bool = False,
    moving_end: bool = False,
    partial: bool = False,
) -> tuple[Refusal, ...]:
    """Hold a message against the rules of the joint trajectory controller.

    Args:
        message: A JointTrajectory, or a goal of FollowJointTrajectory or a
            RobotTrajectory that holds one, of plain values, as YAML and JSON are read.
        joint_names: Joints of the controller; None takes those of the message.
        effort_interface: Whether the controller commands efforts, without which it
            refuses them; those before ROS 2 Jazzy always do.
        moving_end: Whether its ``allow_nonzero_velocity_at_trajectory_end`` is set.
        partial: Whether its ``allow_partial_joints_goal`` is.

    Returns:
        The rules that are broken, one entry a field and point; empty for a message that
        the controller takes and follows.

    Raises:
        ProblemError: If the message is no table of fields, or names are none.
        ScenarioError: If it holds no trajectory, or more than joints.
    """
    if not isinstance(message, Mapping):
        raise wrong(message, "message", "a table of fields")
    if joint_names is not None:
        instance(joint_names, (list, tuple), "joint_names", "a list of names")
        for name in joint_names:
            instance(name, str, "joint_names", "a list of names")
    outer = dict(message)
    field = Field(outer, Path("the message"))
    found = find_trajectory(field, mention=False).value
    if not isinstance(found, Mapping):
        raise ProblemError("the message holds no JointTrajectory", "message")
    names, points = found.get("joint_names"), found.get("points")
    if not isinstance(names, list) or not names:
        return (Refusal("there are no joint names", "joint_names"),)
    if not isinstance(points, list) or not points:
        return (Refusal("there are no points", "points"),)
    if not all(isinstance(name, str) for name in names):
        return (Refusal(f"are {brief(names)}, expected names", "joint_names"),)
    rules = _Rules(names, points)
    broken = [
        *rules.joints(joint_names, partial),
        *_goal(outer, rules.names),
        *_stamp(found.get("header")),
        *rules.times(),
        *rules.values(effort_interface),
        *rules.uniform(),
        *([] if moving_end else rules.end()),
    ]
    return tuple(broken)


def controller_needs(samples: Samples, moving: bool) -> list[str]:
    """What a controller must be set to for a message, in sentences."""
    notes = []
    if np.any(np.isfinite(samples.u)):
        notes.append(
            "The points have efforts: only controllers that command efforts take them."
        )
    if moving:
        notes.append(
            "The motion ends in motion: the controller needs "
            "allow_nonzero_velocity_at_trajectory_end."
        )
    return notes


@dataclass(frozen=True)
class _Rules:
    """The rules for joints and points."""

    names: list[str]
    points: list[Any]

    def joints(self, known: Sequence[str] | None, partial: bool) -> Iterator[Refusal]:
        """Names are those of the controller, each once, and all of them."""
        for index, name in enumerate(self.names):
            if not name:
                yield Refusal("is empty", "joint_names")
            if name in self.names[:index]:
                yield Refusal("is named twice", "joint_names", joint=name)
            if known is not None and name not in known:
                reason = "is no joint of the controller"
                yield Refusal(reason, "joint_names", joint=name)
        for name in () if known is None or partial else known:
            if name not in self.names:
                reason = "is missing: the controller expects all of its joints"
                yield Refusal(reason, "joint_names", joint=name)

    def times(self) -> Iterator[Refusal]:
        """Times are whole nanoseconds that increase, and none lies before the start."""
        before = -1
        for index, point in enumerate(self.points):
            now = _ticks(point)
            if now is None:
                reason = "is no time: expected sec and nanosec, whole numbers"
                yield Refusal(reason, "time_from_start", index)
                continue
            if now < 0:
                yield Refusal("lies before the start", "time_from_start", index)
            elif now <= before:
                reason = (
                    f"is {now / BILLION:.9f} s, not after the {before / BILLION:.9f} s "
                    "of the point before"
                )
                yield Refusal(reason, "time_from_start", index)
            before = max(before, now)

    def values(self, effort_interface: bool) -> Iterator[Refusal]:
        """Arrays hold a finite number for each joint, or nothing."""
        for index, point in enumerate(self.points):
            for field in POINT_FIELDS.values():
                yield from self._array(index, field, _values(point, field))
            if _values(point, "effort") and not effort_interface:
                reason = "is refused by controllers that do not command efforts"
                yield Refusal(reason, "effort", index)
                return  # the same for all others

    def _array(self, index: int, field: str, row: Any) -> Iterator[Refusal]:
        if not isinstance(row, list | tuple):
            yield Refusal("is no list of numbers", field, index)
            return
        if len(row) != len(self.names) and (row or field == "positions"):
            reason = f"holds {len(row)} numbers for {len(self.names)} joints"
            yield Refusal(reason, field, index)
            return
        for name, value in zip(self.names, row, strict=False):
            if not _is_finite(value):
                reason = f"is {brief(value)}, expected a finite number"
                yield Refusal(reason, field, index, name)

    def uniform(self) -> Iterator[Refusal]:
        """All points say the same, or stretches are followed by straight lines."""
        first = self.points[0]
        for index, point in enumerate(self.points):
            for field in POINT_FIELDS.values():
                given = bool(_values(point, field))
                if given != bool(_values(first, field)):
                    has = "has them, the first point has not"
                    lacks = "is empty, that of the first point is not"
                    yield Refusal(has if given else lacks, field, index)
                    return
        if _values(first, "accelerations") and not _values(first, "velocities"):
            yield Refusal("is not followed without velocities", "accelerations", 0)

    def end(self) -> Iterator[Refusal]:
        """The motion ends at rest."""
        last = len(self.points) - 1
        row = _values(self.points[last], "velocities")
        for name, value in zip(self.names, row, strict=False):
            if _is_finite(value) and abs(value) > REST:
                reason = f"is {value:.3g} at the end, expected 0"
                yield Refusal(reason, "velocities", last, name)


def _values(point: Any, field: str) -> Any:
    """Numbers of a point; none if it does not say."""
    row = point.get(field) if isinstance(point, Mapping) else None
    if isinstance(row, np.ndarray):
        row = row.tolist()
    return [] if row is None else row


def _is_finite(value: Any) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:
        return False


def _ticks(point: Any) -> int | None:
    """Time of a point [ns]; None if it has none that ROS could hold."""
    time = point.get("time_from_start") if isinstance(point, Mapping) else None
    if not isinstance(time, Mapping) or not set(time) <= {"sec", "nanosec"}:
        return None
    sec, nanosec = time.get("sec", 0), time.get("nanosec", 0)
    for part in (sec, nanosec):
        if isinstance(part, bool) or not isinstance(part, int):
            return None
    if not -MAX_SECONDS <= sec < MAX_SECONDS or not 0 <= nanosec < BILLION:
        return None
    return int(sec) * BILLION + int(nanosec)


def _stamp(header: Any) -> Iterator[Refusal]:
    """A motion in a file begins when it is sent."""
    stamp = header.get("stamp") if isinstance(header, Mapping) else None
    if isinstance(stamp, Mapping) and any(stamp.values()):
        reason = "is not zero: the motion would have to be sent before that time"
        yield Refusal(reason, "header.stamp")


def _goal(outer: dict[str, Any], names: list[str]) -> Iterator[Refusal]:
    """Tolerances of a goal are those of its joints."""
    inner = outer.get("goal")
    goal = inner if isinstance(inner, Mapping) else outer
    for field in TOLERANCES:
        items = goal.get(field) or []
        for item in items if isinstance(items, list) else [items]:
            table = item if isinstance(item, Mapping) else {}
            name = table.get("name", table.get("joint_name"))
            if name not in names:
                reason = f"is for {brief(name)}, which is no joint of the message"
                yield Refusal(reason, field)
    wait = goal.get("goal_time_tolerance")
    seconds = wait.get("sec") if isinstance(wait, Mapping) else None
    # -1 s stands for any time.
    if isinstance(seconds, int | float) and seconds < -1:
        yield Refusal("is negative", "goal_time_tolerance")
