"""Goals made of goals: passed on the way, any of them, or all of them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Any

import numpy as np

from tominpmp.arrays import Array, Record
from tominpmp.checks import of_kind, whole
from tominpmp.exceptions import ProblemError
from tominpmp.goals.base import Goal
from tominpmp.goals.place import GoalResidual, Label, Place
from tominpmp.goals.turns import MOST_WAYS, joined_turns
from tominpmp.kinematics import RobotKinematics
from tominpmp.robot.robot import Robot


def _of_goal(name: str) -> Any:
    """A property, or a method, that is the one of the goal within."""
    return property(attrgetter(f"goal.{name}"), doc=getattr(Goal, name).__doc__)


@dataclass(frozen=True, eq=False)
class PassedGoal(Record, Goal):
    """The place of a goal, at whatever velocity.

    Attributes:
        goal: The goal, whose velocity is ignored.
    """

    goal: Goal

    def resolved(self, robot: Robot, before: Array | None = None) -> Goal:
        """The same of the goal in the order of the robot."""
        return PassedGoal(self.goal.resolved(robot, before))

    @property
    def stopped(self) -> Goal:
        """The goal."""
        return self.goal

    # -- any velocity ------------------------------------------------------------------

    def motion_residual(
        self, kinematics: RobotKinematics, q: Array, v: Array
    ) -> tuple[Array, Array, Array]:
        """An empty residual: any velocity is allowed."""
        none = np.zeros((0, v.size))
        return np.zeros(0), none, none

    def motion_labels(self, kinematics: RobotKinematics) -> tuple[Label, ...]:
        """No labels."""
        return ()

    def speed_count(self, n: int) -> int:
        """Zero: velocities are free."""
        return 0

    @property
    def fixes_velocity(self) -> bool:
        """False: the velocity is free."""
        return False

    # -- the rest is that of the goal --------------------------------------------------

    validate = _of_goal("validate")
    place = _of_goal("place")
    configuration = _of_goal("configuration")
    positions = _of_goal("positions")
    joint_ranges = _of_goal("joint_ranges")
    frame_name = _of_goal("frame_name")
    ball = _of_goal("ball")
    nearest_point = _of_goal("nearest_point")
    distances = _of_goal("distances")
    angle_to_go = _of_goal("angle_to_go")
    target = _of_goal("target")
    members = _of_goal("members")
    turns = _of_goal("turns")

    def with_state(self, q: Array, v: Array) -> Goal:
        """The same with another configuration."""
        return replace(self, goal=self.goal.with_state(q, v))

    def nearest(self, kinematics: RobotKinematics, q: Array, v: Array) -> Goal:
        """The nearest goal of a set, passed at any velocity."""
        return PassedGoal(self.goal.nearest(kinematics, q, np.zeros_like(v)))

    @property
    def alternatives(self) -> tuple[Goal, ...]:
        """One for each of several goals."""
        if len(self.goal.alternatives) == 1:
            return (self,)
        return tuple(PassedGoal(goal) for goal in self.goal.alternatives)

    def prefixed(self, prefix: str, robot: Robot) -> Goal:
        """The same beside other robots."""
        return replace(self, goal=self.goal.prefixed(prefix, robot))


def passed(goal: Goal) -> Goal:
    """A goal on the way: its velocity counts only if one was asked for."""
    given = any(getattr(item, "v", None) is not None for item in goal.alternatives)
    return goal if given else PassedGoal(goal)


def _members(goals: Sequence[Goal]) -> tuple[Goal, ...]:
    """Check a caller's goals."""
    expected = "a list of goals"
    found = tuple(of_kind(goals, Sequence, "goal.goals", expected))
    for item in found:
        if not isinstance(item, Goal):
            raise ProblemError(
                f"goal.goals holds a {type(item).__name__}, expected {expected}",
                "goal.goals",
            )
    if not found:
        raise ProblemError(f"goal.goals is empty, expected {expected}", "goal.goals")
    return found


@dataclass(frozen=True, eq=False)
class GoalSet(Record, Goal):
    """Several goals.

    Attributes:
        goals: The goals.
    """

    goals: Sequence[Goal]

    def resolved(self, robot: Robot, before: Array | None = None) -> GoalSet:
        """Each goal in the order of the robot."""
        found = tuple(goal.resolved(robot, before) for goal in self.goals)
        same = all(a is b for a, b in zip(found, self.goals, strict=True))
        return self if same else replace(self, goals=found)

    def wrapped(self, robot: Robot, q: Array, v: Array, most: int = MOST_WAYS) -> Goal:
        """Each goal with the turns of its angles."""
        share = max(whole(most, "most", least=1) // len(self.goals), 1)
        found = tuple(goal.wrapped(robot, q, v, share) for goal in self.goals)
        return self._altered(goals=found)

    def validate(self, robot: Robot) -> None:
        """Check each goal."""
        for goal in self.goals:
            goal.validate(robot)


@dataclass(frozen=True, eq=False)
class AnyGoal(GoalSet):
    """Goals of which any will do; each is planned for, and the fastest one kept.

    Attributes:
        goals: The goals; a set among them counts as its members.
    """

    def __post_init__(self) -> None:
        """Check the goals."""
        members = _members(self.goals)
        found: tuple[Goal, ...] = ()
        for item in members:
            # Turns of angles are chosen by the goal that has them.
            found += (item,) if item.turning else item.alternatives
        if len({item.fixes_velocity for item in found}) > 1:
            raise ProblemError(
                "goal.goals: with some of them the arm ends at a given joint velocity, "
                "with others it does not; expected one or the other",
                "goal.goals",
            )
        self._keep(goals=found)

    @property
    def alternatives(self) -> tuple[Goal, ...]:
        """The goals, each with all turns that will do."""
        return tuple(one for goal in self.goals for one in goal.alternatives)

    @property
    def choices(self) -> tuple[Goal, ...]:
        """The goals."""
        return tuple(self.goals)

    @property
    def ends_moving(self) -> bool:
        """Whether any of them asks for a velocity other than zero."""
        return any(goal.ends_moving for goal in self.goals)

    def nearest(self, kinematics: RobotKinematics, q: Array, v: Array) -> Goal:
        """The goal that a final state misses by least, in the worst of its numbers."""
        excess = (goal.excess(kinematics, q, v) for goal in self.goals)
        return self._least(excess).nearest(kinematics, q, v)

    def place(self, kinematics: RobotKinematics, q: Array) -> Place:
        """Conditions of the nearest goal on a configuration."""
        apart = (goal.place_residual(kinematics, q)[0] for goal in self.goals)
        return self._least(apart).place(kinematics, q)

    def _least(self, missed: Iterable[Array]) -> Goal:
        """The goal with the least excess, from the excesses of all goals."""
        worst = [np.max(np.abs(part), initial=0.0) for part in missed]
        return self.goals[int(np.argmin(worst))]

    def residual(self, kinematics: RobotKinematics, q: Array, v: Array) -> GoalResidual:
        """Excess over the bounds of the nearest goal; its length depends on which."""
        goal = self.nearest(kinematics, q, v)
        value, by_q, by_v = goal.residual(kinematics, q, v)
        lower, upper = goal.bounds(kinematics)
        excess = value - np.clip(value, lower, upper)
        outside = ((excess != 0.0) | (lower == upper))[:, None]
        return GoalResidual(
            excess, np.where(outside, by_q, 0.0), np.where(outside, by_v, 0.0)
        )

    @property
    def fixes_velocity(self) -> bool:
        """Whether the final joint velocity is known beforehand, for each of them."""
        return self.goals[0].fixes_velocity

    def final_velocity(self, n: int) -> Array:
        """Final joint velocity of the first goal, shape (n,)."""
        return self.goals[0].final_velocity(n)


@dataclass(frozen=True, eq=False)
class AllGoals(GoalSet):
    """Goals that are all to be met, at rest: one for each of several arms, say.

    Attributes:
        goals: Goals on frames or on some joints; a set of this kind among them counts
            as its members.
    """

    def __post_init__(self) -> None:
        """Check the goals."""
        found: list[Goal] = []
        for item in _members(self.goals):
            found += item.goals if isinstance(item, AllGoals) else [item]
        for item in found:
            if item.configuration is not None or isinstance(item, AnyGoal):
                raise ProblemError(
                    f"goal.goals holds a {type(item).__name__}, expected goals on "
                    "frames or on some joints (JointRegionGoal)",
                    "goal.goals",
                )
            if not item.fixes_velocity:
                raise ProblemError(
                    "goal.goals holds a goal with a velocity v, expected goals at rest",
                    "goal.goals",
                )
        self._keep(goals=tuple(found))

    @property
    def members(self) -> tuple[Goal, ...]:
        """The goals."""
        return tuple(self.goals)

    def turns(self, robot: Robot) -> dict[str, int]:
        """Whole turns of the joints of all goals."""
        return {k: n for goal in self.members for k, n in goal.turns(robot).items()}

    def place(self, kinematics: RobotKinematics, q: Array) -> Place:
        """Conditions of all goals on a configuration."""
        first, *others = (goal.place(kinematics, q) for goal in self.members)
        for other in others:
            first = first.joined(other)
        return first

    def joint_ranges(self, robot: Robot) -> tuple[Array, Array]:
        """Intersections of the ranges of all goals."""
        ranges = [goal.joint_ranges(robot) for goal in self.members]
        lower, upper = (np.stack(part) for part in zip(*ranges, strict=True))
        return np.max(lower, axis=0), np.min(upper, axis=0)

    def prefixed(self, prefix: str, robot: Robot) -> AllGoals:
        """The goals in the names that their parts have beside other robots."""
        return AllGoals([goal.prefixed(prefix, robot) for goal in self.members])


def among(goal: Goal, kept: Sequence[Goal]) -> Goal:
    """The goal with some of its choices alone."""
    return joined_turns(kept) if goal.turning else AnyGoal(kept)
