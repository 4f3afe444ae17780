"""Goals that consist of goals: via points, alternative goals, and combined goals.

A via point is passed at any velocity; of alternative goals one has to be reached, of
combined goals all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from typing import TypeVar

import numpy as np

from tominpmp.arrays import Array, BoolArray, Record
from tominpmp.checks import instance, whole, wrong
from tominpmp.exceptions import ProblemError, naming
from tominpmp.goals.base import Goal
from tominpmp.goals.place import GoalResidual, Place
from tominpmp.goals.turns import MOST_WAYS, joined_turns
from tominpmp.kinematics import RobotKinematics
from tominpmp.robot.robot import Robot

V = TypeVar("V")


def passed(goal: Goal) -> Goal:
    """A goal as a via point: the velocity is free unless the goal gives a velocity."""
    moving = any(getattr(item, "v", None) is not None for item in goal.alternatives)
    return goal if moving else goal._with_passing(True)


def _checked_members(goals: Sequence[Goal]) -> tuple[Goal, ...]:
    """Check a caller's goals."""
    if not isinstance(goals, Sequence) or not goals:
        raise wrong(goals, "goal.goals", "a list of goals, at least one")
    for k, item in enumerate(goals):
        instance(item, Goal, f"goal.goals[{k}]", "a goal", "goal.goals")
    return tuple(goals)


@dataclass(frozen=True, eq=False)
class GoalSet(Record, Goal):
    """Several goals.

    Attributes:
        goals: The goals.
    """

    goals: Sequence[Goal]

    def resolved(self, robot: Robot, before: Array | None = None) -> GoalSet:
        """The set with joint values in the order of the robot."""
        goals = self._of_each(lambda goal: goal.resolved(robot, before))
        same = all(a is b for a, b in zip(goals, self.goals, strict=True))
        return self if same else replace(self, goals=goals)

    def wrapped(self, robot: Robot, q: Array, v: Array, most: int = MOST_WAYS) -> Goal:
        """The set of the goals, each with its equivalent joint angles near a start."""
        most = whole(most, "most", least=1)
        # An obstacle may block the way in one direction.
        share = max(most // len(self.goals), min(most, 2))
        goals = tuple(goal.wrapped(robot, q, v, share) for goal in self.goals)
        return self._altered(goals=goals)

    def validate(self, robot: Robot) -> None:
        """Check each goal."""
        self._of_each(lambda goal: goal.validate(robot))

    def _with_passing(self, passing: bool) -> Goal:
        """The set of the goals as via points, or as goals at which the arm stops."""
        goals = tuple(goal._with_passing(passing) for goal in self.goals)
        return self._altered(goals=goals, _passing=passing)

    def _of_each(self, function: Callable[[Goal], V]) -> tuple[V, ...]:
        """Values of a function of a goal, whose errors name the goal."""
        values = list[V]()
        for number, goal in enumerate(self.goals, 1):
            with naming(f"goal {number} of {len(self.goals)}"):
                values.append(function(goal))
        return tuple(values)


@dataclass(frozen=True, eq=False)
class AnyGoal(GoalSet):
    """Alternative goals: each is planned for, and the fastest motion is kept.

    Attributes:
        goals: The goals; a nested set of alternatives is replaced by its members.
    """

    def __post_init__(self) -> None:
        """Check the goals."""
        members = _checked_members(self.goals)
        goals: tuple[Goal, ...] = ()
        for item in members:
            # Equivalent joint angles stay together: they are alternatives of one goal.
            goals += (item,) if item.turning else item.alternatives
        if len({item.fixes_velocity for item in goals}) > 1:
            raise ProblemError(
                "goal.goals: some of the goals fix the final joint velocity and others "
                "do not; expected goals of one kind",
                "goal.goals",
            )
        self._keep(goals=goals, _passing=goals[0]._passing)

    @property
    def alternatives(self) -> tuple[Goal, ...]:
        """The goals, each with all its equivalent joint angles."""
        return tuple(item for goal in self.goals for item in goal.alternatives)

    @property
    def choices(self) -> tuple[Goal, ...]:
        """The goals."""
        return tuple(self.goals)

    @property
    def ends_moving(self) -> bool:
        """Whether one of the goals asks for a final velocity other than zero."""
        return any(goal.ends_moving for goal in self.goals)

    def nearest(self, kinematics: RobotKinematics, q: Array, v: Array) -> Goal:
        """The goal with the smallest excess at a final state, in the maximum norm."""
        excess = (goal.excess(kinematics, q, v) for goal in self.goals)
        return self._least(excess).nearest(kinematics, q, v)

    def place(self, kinematics: RobotKinematics, q: Array) -> Place:
        """Conditions of the nearest goal on a configuration."""
        excess = (goal.place_residual(kinematics, q)[0] for goal in self.goals)
        return self._least(excess).place(kinematics, q)

    def _least(self, excess: Iterable[Array]) -> Goal:
        """The goal with the least excess, from the excesses of all goals, in order."""
        worst = [np.max(np.abs(values), initial=0.0) for values in excess]
        return self.goals[int(np.argmin(worst))]

    def residual(self, kinematics: RobotKinematics, q: Array, v: Array) -> GoalResidual:
        """Excess of the nearest goal over its bounds; its length may vary by goal."""
        goal = self.nearest(kinematics, q, v)
        value, *by_state = goal.residual(kinematics, q, v)
        bounds = goal.bounds(kinematics)
        excess, slope = Place(value, np.hstack(by_state), *bounds, ()).residual()
        return GoalResidual(excess, *np.hsplit(slope, 2))

    @property
    def fixes_velocity(self) -> bool:
        """Whether each of the goals fixes the final joint velocity."""
        return self.goals[0].fixes_velocity

    def final_velocity(self, n: int) -> Array:
        """Final joint velocity of the first goal, shape (n,)."""
        return self.goals[0].final_velocity(n)


@dataclass(frozen=True, eq=False)
class AllGoals(GoalSet):
    """Goals that have to be reached together, at rest: for example one for each arm.

    Attributes:
        goals: Goals on frames or on some joints; a nested set of this kind is replaced
            by its members.
    """

    def __post_init__(self) -> None:
        """Check the goals."""
        goals: list[Goal] = []
        for item in _checked_members(self.goals):
            goals += item.goals if isinstance(item, AllGoals) else [item]
        for item in goals:
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
        self._keep(goals=tuple(goals))

    @property
    def members(self) -> tuple[Goal, ...]:
        """The goals."""
        return tuple(self.goals)

    def angles(self, robot: Robot) -> BoolArray:
        """Joints that are angles in one of the goals, shape (n,)."""
        each = [goal.angles(robot) for goal in self.members]
        return np.asarray(np.any(each, axis=0))

    def turns(self, robot: Robot) -> dict[str, int]:
        """Whole turns that were added to the positions of all goals, by joint."""
        return {k: n for goal in self.members for k, n in goal.turns(robot).items()}

    def place(self, kinematics: RobotKinematics, q: Array) -> Place:
        """Conditions of all goals on a configuration."""
        places = (goal.place(kinematics, q) for goal in self.members)
        return reduce(Place.joined, places)

    def positions(self, robot: Robot) -> Array:
        """Positions that any goal determines, (n,) [rad or m]; NaN for other joints."""
        each = [goal.positions(robot) for goal in self.members]
        return np.asarray(np.fmax.reduce(each))

    def joint_ranges(self, robot: Robot) -> tuple[Array, Array]:
        """Intersections of the joint ranges of all goals, each (n,) [rad or m]."""
        ranges = [goal.joint_ranges(robot) for goal in self.members]
        lower, upper = (np.stack(part) for part in zip(*ranges, strict=True))
        return np.max(lower, axis=0), np.min(upper, axis=0)

    def prefixed(self, prefix: str, robot: Robot) -> AllGoals:
        """The goals with the names of joints and frames of a combined robot."""
        return AllGoals([goal.prefixed(prefix, robot) for goal in self.members])


def restricted(goal: Goal, choices: Sequence[Goal]) -> Goal:
    """The goal with only some of its choices."""
    return joined_turns(choices) if goal.turning else AnyGoal(choices)
