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
    non_negative,
    one_per_joint,
    text,
    vector,
    whole,
    wrong,
)
from tominpmp.exceptions import ProblemError, brief
from tominpmp.goals.base import Goal, joint_row, robot_of
from tominpmp.goals.place import Place, joint_labels
from tominpmp.goals.turns import MOST_WAYS, TURN, equivalent_positions
from tominpmp.kinematics import RobotKinematics, endless_joints, prismatic_joints
from tominpmp.robot.robot import Robot


def joint_vector(
    robot: Robot, value: object, name: str, quantity: str = "position"
) -> Array:
    """Check a caller's joint vector, and bring it into the order of the joints.

    Args:
        robot: The robot.
        value: Numbers in the order of the joints, or values by joint name. Locked
            joints may be named, with the value at which they are locked; velocities
            and accelerations of joints that are not named are zero, those of all
            joints for None.
        name: Name of the values in messages.
        quantity: "position", "velocity" or "acceleration".

    Raises:
        ProblemError: If the value is not a number for each joint, or not finite.
    """
    joints = robot.joint_names
    rests, at = quantity != "position", robot.locked_joints
    named = {} if rests and value is None else by_joint(value, quantity)
    if named is not None:
        others, missing = (dict.fromkeys(at, 0.0), 0.0) if rests else (at, None)
        value = in_order(named, joints, name, others=others, missing=missing)
    content = f"{len(joints)} numbers, one for each of: {', '.join(joints)}"
    if isinstance(value, str) and robot.srdf is not None:
        content += f"; robot.group_state({brief(value)}) has those of a group state"
    numbers = array(value, name, (None,), content)
    one_per_joint(numbers, name, joints)
    for joint, number in zip(joints, numbers, strict=True):
        if not np.isfinite(number):
            message = f"{name}: joint {joint!r} is {number}, expected a finite number"
            raise ProblemError(message, name)
    return numbers


def _checked_wrap(value: object, name: str) -> bool | tuple[str, ...]:
    """Check a caller's choice of the joints that are angles."""
    try:
        return bool(value) if isinstance(value, bool | np.bool_) else names(value)
    except ProblemError as error:
        raise wrong(value, name, "True, False or names of joints") from error


Wrap: TypeAlias = Annotated[bool | Sequence[str], _checked_wrap]
_G = TypeVar("_G", bound="GoalOnJoints")


class GoalOnJoints(Record, Goal):
    """A goal with positions of all joints, or of the joints that it names.

    Joints that are angles may reach it after any number of whole turns. A problem,
    which knows the start, takes the nearest angles, and the nearest angles in the other
    direction as alternatives.
    """

    q: Converted[JointsLike, Array]
    joints: Sequence[str] | None
    wrap: Wrap

    _owner = "goal."
    # Positions that a problem has found to be equivalent, the nearest first.
    _ways: ClassVar[tuple[Array, ...]] = ()

    def __post_init__(self) -> None:
        """Check and copy the positions, and the names of their joints."""
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

    def _in_order(self, value: Any, name: str, missing: float | None = None) -> Any:
        """Put values by joint name into the order of the goal; keep other values."""
        named = by_joint(value, "velocity" if name == "goal.v" else "position")
        if named is None:
            return value
        if self.joints is None:
            message = f"{name} is given by joint name, expected goal.q by name, too"
            raise ProblemError(message, name)
        return in_order(named, self.joints, name, missing=missing)

    @property
    def ways(self) -> tuple[Array, ...]:
        """Equivalent positions, the nearest first, each (n,); before a start ``q``."""
        return self._ways or (self.q,)

    @cached_property
    def alternatives(self) -> tuple[GoalOnJoints, ...]:
        """A goal for each vector of equivalent positions."""
        if len(self.ways) == 1:
            return (self,)
        return tuple(self._with_ways(q) for q in self.ways)

    def _with_ways(self: _G, *ways: Array) -> _G:
        """The goal with other equivalent positions."""
        return self._altered("alternatives", _ways=ways)

    @property
    def turning(self) -> bool:
        """True: the alternatives are equivalent joint angles."""
        return True

    def _rows(self, robot: Robot) -> IntArray:
        """Indices of the goal's joints in the robot."""
        if self.joints is None:
            return np.arange(robot.n)
        return np.array([robot.joint_names.index(name) for name in self.joints])

    def nearest(self, kinematics: RobotKinematics, q: Array, v: Array) -> GoalOnJoints:
        """The goal with the equivalent positions nearest to a final state."""
        if len(self.ways) == 1:
            return self
        final = np.asarray(q)[self._rows(robot_of(kinematics))]
        distances = [float(np.max(np.abs(way - final))) for way in self.ways]
        return self.alternatives[int(np.argmin(distances))]

    def validate(self, robot: Robot) -> None:
        """Check the number of positions, and the names of joints, also in ``wrap``."""
        known = instance(robot, Robot, "robot").joint_names
        names = self.joints or known
        known_joints(names, known, "goal.joints")
        one_per_joint(self.q, "goal.q", names)
        self.angles(robot)

    def wrapped(
        self: _G, robot: Robot, q: Array, v: Array, most: int = MOST_WAYS
    ) -> _G:
        """The goal with its equivalent joint angles near a start as alternatives."""
        most, n = whole(most, "most", least=1), instance(robot, Robot, "robot").n
        q, v = (array(x, name, (n,), JOINTS) for x, name in ((q, "q"), (v, "v")))
        rows, limits = self._rows(robot), robot.limits
        angles = self.angles(robot)[rows]
        if not np.any(angles):
            return self
        moving = (v[rows] != 0.0) | (self.final_velocity(robot.n)[rows] != 0.0)
        bounds = limits.position_lower, limits.position_upper, limits.velocity
        each = [bound[rows] for bound in bounds]
        ways = equivalent_positions(self.q, q[rows], angles, each, moving, most)
        return self._with_ways(*ways)

    def angles(self, robot: Robot) -> BoolArray:
        """Joints that are angles: those declared so, and those without limits."""
        declared = () if isinstance(self.wrap, bool) else self.wrap
        known = np.array(instance(robot, Robot, "robot").joint_names)
        revolute = known[~prismatic_joints(robot)].tolist()
        known_joints(declared, revolute, "goal.wrap")
        angles = np.isin(known, declared)
        return angles if self.wrap is False else angles | endless_joints(robot)

    def _targets(self, robot: Robot, way: Array) -> tuple[IntArray, Array, Array]:
        """Indices of the goal's joints, their target positions, and the tolerances.

        Args:
            robot: The robot.
            way: One of the equivalent positions.
        """
        return self._rows(robot), way, np.zeros(way.size)

    def place(self, kinematics: RobotKinematics, q: Array) -> Place:
        """Differences from the nearest equivalent positions [rad or m]."""
        robot, q = robot_of(kinematics), joint_row(kinematics, q, "q")
        way = self.nearest(kinematics, q, q).ways[0]
        rows, target, tolerance = self._targets(robot, way)
        every = joint_labels(robot)
        labels = tuple(every[i] for i in rows)
        by_q = np.eye(q.size)[rows]
        return Place(q[rows] - target, by_q, -tolerance, tolerance, labels)

    def joint_ranges(self, robot: Robot) -> tuple[Array, Array]:
        """Ranges of the joints over all equivalent positions, each (n,) [rad or m]."""
        lower, upper = super().joint_ranges(robot)
        each = [self._targets(robot, way) for way in self.ways]
        rows = each[0][0]
        lower[rows] = np.min([target - most for _, target, most in each], axis=0)
        upper[rows] = np.max([target + most for _, target, most in each], axis=0)
        return lower, upper

    def turns(self, robot: Robot) -> dict[str, int]:
        """Whole turns between the caller's and the nearest positions, by joint."""
        every = instance(robot, Robot, "robot").joint_names
        named = every if self.joints is None else self.joints
        counts = np.round((self.ways[0] - self.q) / TURN).astype(int).tolist()
        return {name: k for name, k in zip(named, counts, strict=True) if k}


@record
class JointGoal(GoalOnJoints):
    """Reach a configuration.

    Attributes:
        q: Joint positions, shape (n,) [rad or m]; or by joint name: joints that are not
            named keep their positions at the start, or at the goal of the segment
            before.
        v: Final joint velocities, shape (n,) [rad/s or m/s]; by joint name if the
            positions are given by name, with joints not named at rest; None for an arm
            at rest.
        joints: Names of the joints that the numbers belong to; None for the joints of
            the robot, in its order. A problem puts the numbers into that order.
        wrap: Which joints are angles, so that they reach the goal by the nearest whole
            turn from the start: True for continuous joints, which have no position
            limits; False for no joint, so that the numbers are taken literally; or
            names of further joints, which turn as far as their limits allow.
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
        """The goal with its numbers in the order of the robot."""
        if self.joints is None:
            return self
        known = instance(robot, Robot, "robot").joint_names
        rest = dict[str, float]()
        if before is not None:
            before = array(before, "before", (len(known),), JOINTS)
            rest = dict(zip(known, before.tolist(), strict=True))
        places = dict(zip(self.joints, self.q.tolist(), strict=True))
        q = joint_vector(robot, {**rest, **places}, "goal.q")
        v = None
        if self.v is not None:
            one_per_joint(self.v, "goal.v", self.joints)
            speeds = dict(zip(self.joints, self.v.tolist(), strict=True))
            v = joint_vector(robot, speeds, "goal.v", "velocity")
        return JointGoal(q, v, wrap=self.wrap)

    @property
    def configuration(self) -> Array:
        """The configuration with the joint angles nearest to the start, shape (n,)."""
        return self.ways[0]

    def validate(self, robot: Robot) -> None:
        """Check names of joints, and the numbers of positions and of velocities."""
        super().validate(robot)
        if self.v is not None:
            one_per_joint(self.v, "goal.v", self.joints or robot.joint_names)

    def with_state(self, q: Array, v: Array) -> JointGoal:
        """The goal with another configuration and velocity, and the same turns."""
        q = array(q, "q", (self.q.size,), JOINTS)
        v = array(v, "v", (None,), JOINTS)
        same = np.array_equal(v, self.final_velocity(v.size))
        unturned = self.q + (q - self.ways[0])
        moved = replace(self, q=unturned, v=self.v if same else v)
        return moved._altered(_ways=self._ways and (q,), _passing=self._passing)

    def prefixed(self, prefix: str, robot: Robot) -> JointRegionGoal:
        """The configuration as positions of one robot's joints in a combined robot."""
        region = JointRegionGoal(self.resolved(robot).q, wrap=self.wrap)
        return region.prefixed(prefix, robot)

    def final_velocity(self, n: int) -> Array:
        """Final joint velocity, shape (n,)."""
        return np.zeros(whole(n, "n")) if self.v is None else self.v


@record
class JointRegionGoal(GoalOnJoints):
    """Bring some or all joints into ranges; the other joints end where it is fastest.

    The goal corresponds to MoveIt's joint constraints: a position and a tolerance for
    each of some joints. The arm ends at rest.

    Attributes:
        q: Joint positions, shape (k,) [rad or m]; or by joint name.
        tolerance: Largest distance from the positions: one number for all joints, shape
            (k,), or by joint name [rad or m].
        joints: Names of the k joints; None for all joints, in the order of the robot.
        wrap: Which joints are angles, so that they reach the goal by the nearest whole
            turn from the start: True for continuous joints, which have no position
            limits; False for no joint, so that the numbers are taken literally; or
            names of further joints, which turn as far as their limits allow.
    """

    q: Converted[JointsLike, Array]
    tolerance: Converted[JointsLike, float | Array] = default(0.0)
    joints: Sequence[str] | None = None
    wrap: Wrap = True

    def __post_init__(self) -> None:
        """Check and copy the values."""
        super().__post_init__()
        name = "goal.tolerance"
        row = self._in_order(self.tolerance, name)
        if is_single(row):
            self._keep(tolerance=non_negative(row, name, "rad or m"))
            return
        expected = "numbers >= 0, one for each joint of the goal [rad or m]"
        row = vector(row, name, expected, self.q.size)
        if np.any(row < 0.0):
            raise wrong(row.tolist(), name, expected)
        self._keep(tolerance=row)

    def _targets(self, robot: Robot, way: Array) -> tuple[IntArray, Array, Array]:
        """Indices of the goal's joints, their target positions, and the tolerances.

        A target beyond a limit is moved to the limit, and its tolerance reduced by the
        distance.
        """
        rows, limits = self._rows(robot), robot.limits
        target = np.clip(way, limits.position_lower[rows], limits.position_upper[rows])
        tolerance = np.broadcast_to(self.tolerance, rows.shape)
        return rows, target, np.maximum(tolerance - np.abs(target - way), 0.0)

    def positions(self, robot: Robot) -> Array:
        """The targets, or the ends of their ranges nearest to the limits, (n,)."""
        q, way = super().positions(robot), self.ways[0]
        rows, target, _ = self._targets(robot, way)
        q[rows] = np.clip(target, way - self.tolerance, way + self.tolerance)
        return q

    def prefixed(self, prefix: str, robot: Robot) -> JointRegionGoal:
        """The goal with the names that its joints have in a combined robot."""
        own = instance(robot, Robot, "robot").joint_names
        before, named = text(prefix, "prefix"), self.joints or own
        wrap = self.wrap
        if not isinstance(wrap, bool):
            wrap = [before + joint for joint in wrap]
        return replace(self, joints=[before + joint for joint in named], wrap=wrap)


def nearest_turns(robot: Robot, rows: Iterable[Array], near: Array) -> list[Array]:
    """Equivalent configurations near a configuration, shape (n,) each.

    Endless joints take the nearest turn; in a second configuration one of them takes
    the nearest turn in the other direction. Configurations of robots without endless
    joints stay unchanged.
    """
    goals = (JointGoal(q).wrapped(robot, near, 0.0 * near, 2) for q in rows)
    return [way for goal in goals for way in goal.ways]
