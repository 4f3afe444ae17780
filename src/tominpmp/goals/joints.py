"""Goals on joint positions."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Annotated, Any, ClassVar, TypeAlias, TypeVar

import numpy as np

from tominpmp.arrays import (
    Array,
    BoolArray,
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
    known_joints,
    named_row,
    names,
    one_per_joint,
    text,
    vector,
    whole,
    wrong,
)
from tominpmp.exceptions import ProblemError
from tominpmp.goals.base import Goal, goal_tolerance, joint_row, robot_of
from tominpmp.goals.place import Place, joint_labels
from tominpmp.goals.turns import MOST_WAYS, TURN, equivalent_positions
from tominpmp.kinematics import RobotKinematics, endless_joints, prismatic_joints
from tominpmp.robot.robot import Robot


def _checked_wrap(given: object, name: str) -> bool | tuple[str, ...]:
    """Check which joints a caller takes as angles."""
    try:
        return bool(given) if isinstance(given, bool | np.bool_) else names(given)
    except ProblemError as error:
        raise wrong(given, name, "True, False or names of joints") from error


Wrap: TypeAlias = Annotated[bool | Sequence[str], _checked_wrap]
_G = TypeVar("_G", bound="GoalOnJoints")


class GoalOnJoints(Record, Goal):
    """A goal that has numbers for all joints, or for those that are named.

    Joints that are angles may meet it after any number of turns. A problem, which knows
    the start, takes the nearest, and those the other way round as alternatives.
    """

    q: Converted[JointsLike, Array]
    joints: Sequence[str] | None
    wrap: Wrap

    _owner = "goal."
    # Positions that a problem has found to be the same place, the nearest first.
    _ways: ClassVar[tuple[Array, ...]] = ()

    def __post_init__(self) -> None:
        """Check and copy the positions, and the names that belong to them."""
        super().__post_init__()
        joints, q = named_row(self.q, "goal.q")
        if joints is not None and self.joints is not None:
            expected = "None, as goal.q is by joint name"
            raise wrong(self.joints, "goal.joints", expected)
        q = vector(q, "goal.q", "one number for each joint [rad or m]")
        self._keep(q=q, joints=self.joints if joints is None else joints)
        if self.joints is not None:
            self._keep(joints=names(self.joints, "goal.joints"))
            one_per_joint(self.q, "goal.q", self.joints)

    def _in_order(self, given: Any, name: str, missing: float | None = None) -> Any:
        """Values by joint name in the order of the joints of the goal; others as is."""
        named = by_joint(given)
        if named is None:
            return given
        if self.joints is None:
            message = f"{name} is given by joint name, expected goal.q to be so, too"
            raise ProblemError(message, name)
        return in_order(named, self.joints, name, missing=missing)

    @property
    def ways(self) -> tuple[Array, ...]:
        """Positions that will do, as far as turns were chosen; the nearest first."""
        return self._ways or (self.q,)

    @cached_property
    def alternatives(self) -> tuple[GoalOnJoints, ...]:
        """The goal with each of the turns that will do."""
        if len(self.ways) == 1:
            return (self,)
        return tuple(self._by(q) for q in self.ways)

    def _by(self: _G, *ways: Array) -> _G:
        """The goal with some turns."""
        return self._altered("alternatives", _ways=ways)

    @property
    def turning(self) -> bool:
        """Whether its alternatives are turns of angles: they are."""
        return True

    def _rows(self, robot: Robot) -> IntArray:
        """Indices of the joints."""
        if self.joints is None:
            return np.arange(robot.n)
        return np.array([robot.joint_names.index(name) for name in self.joints])

    def nearest(self, kinematics: RobotKinematics, q: Array, v: Array) -> GoalOnJoints:
        """The goal with the turns that are nearest to a final state."""
        if len(self.ways) == 1:
            return self
        own = np.asarray(q)[self._rows(robot_of(kinematics))]
        away = [float(np.max(np.abs(way - own))) for way in self.ways]
        return self.alternatives[int(np.argmin(away))]

    def wrapped(
        self: _G, robot: Robot, q: Array, v: Array, most: int = MOST_WAYS
    ) -> _G:
        """The goal with the turns of its angles that are near to a start."""
        most, n = whole(most, "most", least=1), instance(robot, Robot, "robot").n
        q, v = (array(x, name, (n,), JOINTS) for x, name in ((q, "q"), (v, "v")))
        rows, limits = self._rows(robot), robot.limits
        angles = self._angles(robot)[rows]
        if not np.any(angles):
            return self
        moving = (v[rows] != 0.0) | (self.final_velocity(robot.n)[rows] != 0.0)
        ends = limits.position_lower[rows], limits.position_upper[rows]
        ways = equivalent_positions(self.q, q[rows], angles, ends, moving, most)
        return self._by(*ways)

    def _angles(self, robot: Robot) -> BoolArray:
        """Which joints of a robot are angles, shape (n,)."""
        asked = () if isinstance(self.wrap, bool) else self.wrap
        known = np.array(robot.joint_names)
        turning = known[~prismatic_joints(robot)].tolist()
        known_joints(asked, turning)
        found = np.isin(known, asked)
        return found if self.wrap is False else found | endless_joints(robot)

    def _asked(self, robot: Robot, given: Array) -> tuple[IntArray, Array, Array]:
        """Indices of the joints, their positions, and the largest distance from these.

        Args:
            robot: The robot.
            given: The positions, by some turns.
        """
        return self._rows(robot), given, np.zeros(given.size)

    def place(self, kinematics: RobotKinematics, q: Array) -> Place:
        """Difference to the positions asked for [rad or m]."""
        robot, q = robot_of(kinematics), joint_row(kinematics, q, "q")
        given = self.nearest(kinematics, q, q).ways[0]
        rows, target, room = self._asked(robot, given)
        every = joint_labels(robot)
        labels = tuple(every[i] for i in rows)
        return Place(q[rows] - target, np.eye(q.size)[rows], -room, room, labels)

    def joint_ranges(self, robot: Robot) -> tuple[Array, Array]:
        """The ranges of the joints, over all turns."""
        lower, upper = super().joint_ranges(robot)
        each = [self._asked(robot, way) for way in self.ways]
        rows = each[0][0]
        lower[rows] = np.min([target - room for _, target, room in each], axis=0)
        upper[rows] = np.max([target + room for _, target, room in each], axis=0)
        return lower, upper

    def turns(self, robot: Robot) -> dict[str, int]:
        """Whole turns from the numbers that were given, by joint."""
        every = instance(robot, Robot, "robot").joint_names
        named = every if self.joints is None else self.joints
        counts = np.round((self.ways[0] - self.q) / TURN).astype(int).tolist()
        return {name: k for name, k in zip(named, counts, strict=True) if k}


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
        wrap: Which joints are angles, reached by the nearest whole turn from the start:
            True for continuous joints, those without position limits; False for none,
            the numbers being taken as they are; or names of further joints, as far as
            their limits allow.
    """

    q: Converted[JointsLike, Array]
    v: Converted[JointsLike | None, Array | None] = default(None)
    joints: Sequence[str] | None = None
    wrap: Wrap = True

    def __post_init__(self) -> None:
        """Copy the arrays; their lengths are checked against the robot."""
        super().__post_init__()
        if self.v is not None:
            v, expected = self.v, "one number for each joint [rad/s or m/s]"
            v = vector(self._in_order(v, "goal.v", 0.0), "goal.v", expected)
            self._keep(v=v)

    def resolved(self, robot: Robot, before: Array | None = None) -> JointGoal:
        """The same in the order of the robot."""
        if self.joints is None:
            return self
        locked = instance(robot, Robot, "robot").locked_joints
        known, rest = robot.joint_names, dict[str, float]()
        if before is not None:
            before = array(before, "before", (len(known),), JOINTS)
            rest = dict(zip(known, before.tolist(), strict=True))
        places = dict(zip(self.joints, self.q.tolist(), strict=True))
        q = in_order({**rest, **places}, known, "goal.q", others=locked)
        if self.v is None:
            return JointGoal(q, wrap=self.wrap)
        one_per_joint(self.v, "goal.v", self.joints)
        speeds = dict(zip(self.joints, self.v.tolist(), strict=True))
        still = dict.fromkeys(locked, 0.0)
        v = in_order(speeds, known, "goal.v", others=still, missing=0.0)
        return JointGoal(q, v, wrap=self.wrap)

    @property
    def configuration(self) -> Array:
        """The configuration, by the nearest turns."""
        return self.ways[0]

    def validate(self, robot: Robot) -> None:
        """Check lengths against the number of joints."""
        names = instance(robot, Robot, "robot").joint_names
        self._angles(robot)
        for name, value in (("goal.q", self.q), ("goal.v", self.v)):
            if value is not None:
                one_per_joint(value, name, names)

    def with_state(self, q: Array, v: Array) -> JointGoal:
        """A goal at another configuration and velocity."""
        q = array(q, "q", (self.q.size,), JOINTS)
        v = array(v, "v", (None,), JOINTS)
        same = np.array_equal(v, self.final_velocity(v.size))
        given = self.q + (q - self.ways[0])
        moved = replace(self, q=given, v=self.v if same else v)
        return moved._by(q) if self._ways else moved

    def prefixed(self, prefix: str, robot: Robot) -> JointRegionGoal:
        """The configuration as positions of some joints, those of one robot."""
        same = JointRegionGoal(self.resolved(robot).q, wrap=self.wrap)
        return same.prefixed(prefix, robot)

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
        wrap: Which joints are angles, reached by the nearest whole turn from the start:
            True for continuous joints, those without position limits; False for none,
            the numbers being taken as they are; or names of further joints, as far as
            their limits allow.
    """

    q: Converted[JointsLike, Array]
    tolerance: Converted[JointsLike, float | Array] = default(0.0)
    joints: Sequence[str] | None = None
    wrap: Wrap = True

    def __post_init__(self) -> None:
        """Check and copy the values."""
        super().__post_init__()
        self._keep(tolerance=self._checked_tolerance())

    def _checked_tolerance(self) -> float | Array:
        name = "goal.tolerance"
        given = self._in_order(self.tolerance, name)
        if is_single(given):
            return goal_tolerance(given, name, "rad or m")
        expected = "numbers >= 0, one for each joint of the goal [rad or m]"
        given = vector(given, name, expected, self.q.size)
        if np.any(given < 0.0):
            raise wrong(given.tolist(), name, expected)
        return given

    def validate(self, robot: Robot) -> None:
        """Check names and lengths."""
        known = instance(robot, Robot, "robot").joint_names
        names = known if self.joints is None else tuple(self.joints)
        known_joints(names, known)
        one_per_joint(self.q, "goal.q", names)
        self._angles(robot)

    def _asked(self, robot: Robot, given: Array) -> tuple[IntArray, Array, Array]:
        """Indices of the joints, their positions, and the largest distance from these.

        What is asked for beyond a limit is asked for at the limit.
        """
        rows, limits = self._rows(robot), robot.limits
        target = np.clip(
            given, limits.position_lower[rows], limits.position_upper[rows]
        )
        room = np.broadcast_to(self.tolerance, rows.shape)
        return rows, target, np.maximum(room - np.abs(target - given), 0.0)

    def positions(self, robot: Robot) -> Array:
        """The positions asked for, or the ends of their ranges towards the limits."""
        found, given = super().positions(robot), self.ways[0]
        rows, target, _ = self._asked(robot, given)
        found[rows] = np.clip(target, given - self.tolerance, given + self.tolerance)
        return found

    def prefixed(self, prefix: str, robot: Robot) -> JointRegionGoal:
        """The ranges for joints as they are named beside other robots."""
        own = instance(robot, Robot, "robot").joint_names
        before, named = text(prefix, "prefix"), self.joints or own
        wrap = self.wrap
        if not isinstance(wrap, bool):
            wrap = [before + joint for joint in wrap]
        return replace(self, joints=[before + joint for joint in named], wrap=wrap)


def nearest_turns(robot: Robot, rows: Iterable[Array], near: Array) -> list[Array]:
    """Configurations, shape (n,) each, by the nearest turns of endless joints.

    Also by those the other way round; as they are where no joint is endless.
    """
    goals = (JointGoal(q).wrapped(robot, near, 0.0 * near, 2) for q in rows)
    return [way for goal in goals for way in goal.ways]
