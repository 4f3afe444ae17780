"""Goals on joint positions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from tominpmp.arrays import (
    Array,
    Converted,
    IntArray,
    Record,
    default,
    is_single,
    record,
)
from tominpmp.checks import (
    JOINTS,
    JointsLike,
    array,
    by_joint,
    in_order,
    instance,
    named_row,
    text,
    vector,
    whole,
    wrong,
)
from tominpmp.exceptions import JointNotFound, ProblemError
from tominpmp.goals.base import Goal, goal_tolerance, joint_row, robot_of
from tominpmp.goals.place import Place, joint_labels
from tominpmp.kinematics import RobotKinematics
from tominpmp.robot import Robot


class GoalOnJoints(Record, Goal):
    """A goal that has numbers for all joints, or for those that are named."""

    q: Converted[JointsLike, Array]
    joints: Sequence[str] | None

    def __post_init__(self) -> None:
        """Check and copy the positions, and the names that belong to them."""
        joints, q = named_row(self.q, "goal.q")
        if joints is not None:
            self._keep(joints=joints)
        expected = "one number for each joint [rad or m]"
        self._keep(q=vector(q, "goal.q", expected))
        if self.joints is not None:
            self._keep(joints=_checked_names(self.joints, self.q))


@record
class JointGoal(GoalOnJoints):
    """Reach a configuration.

    Attributes:
        q: Joint positions, shape (n,) [rad or m]; or by joint name: joints that are not
            named stay where they are at the start, or where the goal of the segment
            before leaves them.
        v: Final joint velocities, shape (n,) [rad/s or m/s]; by joint name where the
            positions are, those not named at rest; None for rest.
        joints: Names of the joints that the numbers belong to; None for those of the
            robot, in its order. A problem puts the numbers into that order.
    """

    q: Converted[JointsLike, Array]
    v: Converted[JointsLike | None, Array | None] = default(None)
    joints: Sequence[str] | None = None

    def __post_init__(self) -> None:
        """Copy the arrays; their lengths are checked against the robot."""
        super().__post_init__()
        if self.v is not None:
            self._keep(v=self._checked_velocity())

    def _checked_velocity(self) -> Array:
        expected = "one number for each joint [rad/s or m/s]"
        speeds = by_joint(self.v)
        if speeds is None:
            return vector(self.v, "goal.v", expected)
        if self.joints is None:
            raise ProblemError(
                "goal.v is given by joint name, expected goal.q to be so, too", "goal.v"
            )
        v = in_order(speeds, self.joints, "goal.v", missing=0.0)
        return vector(v, "goal.v", expected)

    def resolved(self, robot: Robot, before: Array | None = None) -> JointGoal:
        """The same in the order of the robot."""
        if self.joints is None:
            return self
        others = instance(robot, Robot, "robot").locked_joints
        known, rest = robot.joint_names, dict[str, float]()
        if before is not None:
            before = array(before, "before", (len(known),), JOINTS)
            rest = dict(zip(known, before.tolist(), strict=True))
        rows: list[Array | None] = []
        for name, locked, unnamed in (
            ("q", dict(others), rest),
            ("v", dict.fromkeys(others, 0.0), dict.fromkeys(rest, 0.0)),
        ):
            values, what = getattr(self, name), f"goal.{name}"
            if values is not None:
                _check_length(what, values, self.joints)
                given = dict(zip(self.joints, values.tolist(), strict=True))
                values = in_order({**unnamed, **given}, known, what, others=locked)
            rows.append(values)
        return JointGoal(rows[0], rows[1])  # type: ignore[arg-type]

    @property
    def configuration(self) -> Array:
        """The configuration."""
        return self.q

    def validate(self, robot: Robot) -> None:
        """Check lengths against the number of joints."""
        names = instance(robot, Robot, "robot").joint_names
        for name, value in (("goal.q", self.q), ("goal.v", self.v)):
            if value is not None:
                _check_length(name, value, names)

    def place(self, kinematics: RobotKinematics, q: Array) -> Place:
        """Difference of the positions [rad or m]."""
        q = joint_row(kinematics, q, "q")
        zero = np.zeros(q.size)
        labels = joint_labels(kinematics.robot)
        return Place(q - self.q, np.eye(q.size), zero, zero, labels)

    def with_state(self, q: Array, v: Array) -> JointGoal:
        """A goal at another configuration and velocity."""
        v = array(v, "v", (None,), JOINTS)
        same = np.array_equal(v, self.final_velocity(v.size))
        return replace(self, q=q, v=self.v if same else v)

    def joint_ranges(self, robot: Robot) -> tuple[Array, Array]:
        """The configuration itself."""
        return self.q, self.q

    def prefixed(self, prefix: str, robot: Robot) -> JointRegionGoal:
        """The configuration as positions of some joints, those of one robot."""
        return JointRegionGoal(self.resolved(robot).q).prefixed(prefix, robot)

    def final_velocity(self, n: int) -> Array:
        """Final joint velocity, shape (n,)."""
        return np.zeros(whole(n, "n")) if self.v is None else self.v


@record
class JointRegionGoal(GoalOnJoints):
    """Bring some joints, or all, into ranges; the others end wherever is fastest.

    MoveIt's joint constraints say this: a position and a tolerance for each of some
    joints. The arm ends at rest.

    Attributes:
        q: Positions, shape (k,) [rad or m]; or by joint name.
        tolerance: Largest distance from them, one for all, shape (k,), or by joint name
            [rad or m].
        joints: Names of the k joints; None for all, in the order of the robot.
    """

    q: Converted[JointsLike, Array]
    tolerance: Converted[ArrayLike, float | Array] = default(0.0)
    joints: Sequence[str] | None = None

    def __post_init__(self) -> None:
        """Check and copy the values."""
        super().__post_init__()
        self._keep(tolerance=self._checked_tolerance())

    def _checked_tolerance(self) -> float | Array:
        if is_single(self.tolerance):
            return goal_tolerance(self.tolerance, "goal.tolerance", "rad or m")
        expected = "numbers >= 0, one for each joint of the goal [rad or m]"
        given = vector(self.tolerance, "goal.tolerance", expected, self.q.size)
        if np.any(given < 0.0):
            raise wrong(given.tolist(), "goal.tolerance", expected)
        return given

    def validate(self, robot: Robot) -> None:
        """Check names and lengths."""
        known = instance(robot, Robot, "robot").joint_names
        names = known if self.joints is None else tuple(self.joints)
        for name in names:
            if name not in known:
                raise JointNotFound(name, known)
        _check_length("goal.q", self.q, names)

    def place(self, kinematics: RobotKinematics, q: Array) -> Place:
        """Difference to the positions asked for [rad or m]."""
        rows, target, room = self._asked(robot_of(kinematics))
        q = joint_row(kinematics, q, "q")
        every = joint_labels(kinematics.robot)
        labels = tuple(every[i] for i in rows)
        return Place(q[rows] - target, np.eye(q.size)[rows], -room, room, labels)

    def _asked(self, robot: Robot) -> tuple[IntArray, Array, Array]:
        """Indices of the joints, their positions, and the largest distance from these.

        What is asked for beyond a limit is asked for at the limit.
        """
        rows = np.arange(robot.n)
        if self.joints is not None:
            rows = np.array([robot.joint_names.index(name) for name in self.joints])
        limits = robot.limits
        target = np.clip(
            self.q, limits.position_lower[rows], limits.position_upper[rows]
        )
        room = np.broadcast_to(self.tolerance, rows.shape)
        return rows, target, np.maximum(room - np.abs(target - self.q), 0.0)

    def positions(self, robot: Robot) -> Array:
        """The positions asked for, or the ends of their ranges towards the limits."""
        found = super().positions(robot)
        rows, target, _ = self._asked(robot)
        found[rows] = np.clip(target, self.q - self.tolerance, self.q + self.tolerance)
        return found

    def joint_ranges(self, robot: Robot) -> tuple[Array, Array]:
        """The ranges of the joints that are named."""
        lower, upper = super().joint_ranges(robot)
        rows, target, room = self._asked(robot)
        lower[rows], upper[rows] = target - room, target + room
        return lower, upper

    def prefixed(self, prefix: str, robot: Robot) -> JointRegionGoal:
        """The ranges for joints as they are named beside other robots."""
        own = instance(robot, Robot, "robot").joint_names
        before, named = text(prefix, "prefix"), self.joints or own
        return replace(self, joints=[before + joint for joint in named])


def _check_length(name: str, value: Array, joints: Sequence[str]) -> None:
    if value.size != len(joints):
        raise ProblemError(
            f"{name} has {value.size} numbers, expected {len(joints)}, one for "
            f"each of: {', '.join(joints)}",
            field=name,
        )


def _checked_names(joints: Sequence[str], q: Array) -> tuple[str, ...]:
    """Check that there is a name for each of the numbers."""
    listed = isinstance(joints, Sequence) and not isinstance(joints, str)
    # Looked at one by one: a range may be longer than the memory.
    named = listed and all(isinstance(name, str) for name in joints)
    names = tuple(joints) if named else ()
    if not names:
        raise wrong(joints, "goal.joints", "names of joints")
    if len(set(names)) < len(names):
        raise ProblemError(
            f"goal.joints names a joint twice: {', '.join(names)}", "goal.joints"
        )
    _check_length("goal.q", q, names)
    return names
