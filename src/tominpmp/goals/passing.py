"""Goals that are passed at any speed: where a motion goes through on its way."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array, Record
from tominpmp.goals.base import Goal
from tominpmp.goals.place import Ball, Label, Place
from tominpmp.kinematics import RobotKinematics
from tominpmp.robot import Robot


@dataclass(frozen=True, eq=False)
class PassedGoal(Record, Goal):
    """The place of a goal, at whatever velocity.

    Attributes:
        goal: What has to be met, but for its velocity.
    """

    goal: Goal

    def validate(self, robot: Robot) -> None:
        """Check the goal."""
        self.goal.validate(robot)

    def resolved(self, robot: Robot, before: Array | None = None) -> Goal:
        """The same of the goal in the order of the robot."""
        return PassedGoal(self.goal.resolved(robot, before))

    def place(self, kinematics: RobotKinematics, q: Array) -> Place:
        """What the goal asks of a configuration."""
        return self.goal.place(kinematics, q)

    @property
    def stopped(self) -> Goal:
        """The goal."""
        return self.goal

    # -- any velocity ------------------------------------------------------------------

    def motion_residual(
        self, kinematics: RobotKinematics, q: Array, v: Array
    ) -> tuple[Array, Array, Array]:
        """None: any velocity will do."""
        none = np.zeros((0, v.size))
        return np.zeros(0), none, none

    def motion_labels(self, kinematics: RobotKinematics) -> tuple[Label, ...]:
        """None."""
        return ()

    def speed_count(self, n: int) -> int:
        """None of the numbers of its residual is about the velocity."""
        return 0

    @property
    def fixes_velocity(self) -> bool:
        """It does not."""
        return False

    # -- the rest is that of the goal --------------------------------------------------

    @property
    def configuration(self) -> Array | None:
        """Configuration of the goal."""
        return self.goal.configuration

    def with_state(self, q: Array, v: Array) -> Goal:
        """The same with another configuration."""
        return replace(self, goal=self.goal.with_state(q, v))

    def positions(self, robot: Robot) -> Array:
        """Positions of the goal."""
        return self.goal.positions(robot)

    def joint_ranges(self, robot: Robot) -> tuple[Array, Array]:
        """Ranges of the goal."""
        return self.goal.joint_ranges(robot)

    @property
    def frame_name(self) -> str | None:
        """Frame of the goal."""
        return self.goal.frame_name

    @property
    def ball(self) -> Ball | None:
        """Ball of the goal."""
        return self.goal.ball

    def nearest_point(self) -> Array | None:
        """Nearest point of the goal."""
        return self.goal.nearest_point()

    def distances(self, points: Array) -> Array | None:
        """Distances from the goal."""
        return self.goal.distances(points)

    def angle_to_go(self, rotation: Array) -> float:
        """Least angle to the goal [rad]."""
        return self.goal.angle_to_go(rotation)

    @property
    def target(self) -> pin.SE3 | Array | None:
        """What is to be drawn of the goal."""
        return self.goal.target

    def nearest(self, kinematics: RobotKinematics, q: Array, v: Array) -> Goal:
        """The same of that one of several goals which is missed by least."""
        return PassedGoal(self.goal.nearest(kinematics, q, np.zeros_like(v)))

    @property
    def alternatives(self) -> tuple[Goal, ...]:
        """One for each of several goals."""
        if len(self.goal.alternatives) == 1:
            return (self,)
        return tuple(PassedGoal(goal) for goal in self.goal.alternatives)

    @property
    def members(self) -> tuple[Goal, ...]:
        """Goals that are all to be met."""
        return self.goal.members

    def prefixed(self, prefix: str, robot: Robot) -> Goal:
        """The same beside other robots."""
        return replace(self, goal=self.goal.prefixed(prefix, robot))


def passed(goal: Goal) -> Goal:
    """A goal on the way: its velocity counts only if one was asked for."""
    given = any(getattr(item, "v", None) is not None for item in goal.alternatives)
    return goal if given else PassedGoal(goal)
