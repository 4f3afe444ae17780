"""Workcells: several robots that share a workspace and one duration T.

The paper's conclusions name workcells as the next step: the robots are planned
together, as one robot with several arms, and do not touch each other during the motion.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from functools import partial
from types import MappingProxyType, NoneType
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from tominpmp.arrays import Array, Converted, Record, default, record
from tominpmp.checks import VectorLike, instance, wrong
from tominpmp.combined_robots import base_placement, combine_robots
from tominpmp.description.joint_table import stack_parts
from tominpmp.exceptions import ProblemError, brief, naming, unknown
from tominpmp.goals.base import Goal
from tominpmp.goals.joints import JointGoal, joint_vector
from tominpmp.goals.sets import AllGoals, AnyGoal
from tominpmp.motion.trajectory import InverseDynamics, Trajectory
from tominpmp.problem.problem import Problem
from tominpmp.robot.robot import Robot


@record
class Workcell(Record):
    """Several robots in one workspace.

    ::

        cell = tm.Workcell({"left": (arm, (0, 0.5, 0)), "right": (arm, base_to_world)})
        problem = cell.problem(
            start={"left": q_left, "right": q_right},
            goal={"left": tm.JointGoal(q), "right": tm.PositionGoal("tool0", point)},
        )
        solution = tm.plan(problem)
        motions = cell.split(solution.trajectory)

    Points and placements, also of goals, are given in the world frame, not in the base
    frame of a robot; :meth:`base` gives the placement of a base. Payloads are
    attached to the robots beforehand.

    Attributes:
        robots: By the name of each robot, the robot and the placement base_to_world of
            its base, as a pinocchio.SE3 or a position, shape (3,) [m]; or a list of
            (name, robot, base).
        gravity: Gravity in the world, shape (3,) [m/s^2]; None for the gravity of the
            robots, which has to be the same for all.
        robot: The robots combined into one robot; the name of a robot precedes the
            names of its joints, links and frames: "left/tool0".

    Raises:
        ProblemError: If two robots have the same name, their bases overlap, or their
            gravities differ.
        OptionsError: If the gravity is not a vector.
    """

    robots: Converted[
        Mapping[str, tuple[Robot, Any]] | Sequence[tuple[str, Robot, Any]],
        Mapping[str, tuple[Robot, pin.SE3]],
    ]
    gravity: Converted[VectorLike | None, Array | None] = default(None)
    robot: Robot = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Check the robots and combine them."""
        parts: Any = self.robots
        if isinstance(parts, Mapping):
            for name, item in parts.items():
                if not isinstance(item, tuple | list) or len(item) != 2:
                    raise wrong(item, f"robots[{brief(name)}]", "(robot, base)")
            parts = [(name, *item) for name, item in parts.items()]
        robot = combine_robots(parts, gravity=self.gravity)
        placed = {name: (arm, base_placement(name, base)) for name, arm, base in parts}
        robots = MappingProxyType(placed)
        self._keep(robots=robots, gravity=robot.gravity, robot=robot)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the arguments; the robots are combined again."""
        return type(self), (dict(self.robots), self.gravity)

    def _values(self) -> tuple[Any, ...]:
        """Values that are compared; the other attributes follow from them."""
        return (self.robot,)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the robots."""
        return tuple(self.robots)

    def _member(self, name: str) -> tuple[Robot, pin.SE3]:
        """The robot of a name and the placement of its base."""
        if not isinstance(name, str) or name not in self.robots:
            raise ProblemError(unknown("robot", name, self.names), "name")
        return self.robots[name]

    def base(self, name: str) -> pin.SE3:
        """Placement base_to_world of a robot.

        Raises:
            ProblemError: If no robot has the name.
        """
        return pin.SE3(self._member(name)[1])

    def alone(self, name: str) -> Robot:
        """A robot in free space, with gravity expressed in the axes of its base.

        Raises:
            ProblemError: If no robot has the name.
        """
        robot, base = self._member(name)
        gravity = base.rotation.T @ np.asarray(self.gravity)
        return robot.with_changes(gravity=gravity)

    def stack(self, values: Mapping[str, ArrayLike]) -> Array:
        """Stack joint values of all robots into one vector, shape (n,).

        Args:
            values: Joint values by the name of the robot, shape (n of the robot,).

        Raises:
            ProblemError: If a robot is missing or unknown, or a length is wrong.
        """
        instance(values, Mapping, "values", "values by the name of the robot")
        return stack_parts(self.robot.joint_names, self.robot.parts, values)

    def problem(
        self,
        start: Mapping[str, ArrayLike],
        goal: Mapping[str, Goal | None] | Goal,
        *,
        v_start: Mapping[str, ArrayLike] | None = None,
        **others: Any,
    ) -> Problem:
        """Make one problem of a start and a goal for each robot.

        Args:
            start: Joint positions by robot, shape (n of the robot,) [rad or m].
            goal: Goals by robot, see :meth:`goal`; or one goal for the combined robot.
            v_start: Joint velocities at the start by robot; robots not named are at
                rest.
            **others: Scene, margin and further arguments of :class:`Problem`.

        Returns:
            The problem. The margin is kept between robots, too.

        Raises:
            ProblemError: If a robot is missing or unknown, or a value is wrong.
        """
        instance(start, Mapping, "start", "positions by the name of the robot")
        moving = None
        if v_start is not None:
            rest = {name: np.zeros(r.n) for name, (r, _) in self.robots.items()}
            instance(v_start, Mapping, "v_start", "velocities by the name of the robot")
            moving = self.stack({**rest, **v_start})
        q_start = self.stack(start)
        if isinstance(goal, Mapping):
            goal = {k: self._resolved(k, item, start) for k, item in goal.items()}
        combined = goal if isinstance(goal, Goal) else self.goal(goal)
        return Problem(self.robot, q_start, combined, v_start=moving, **others)

    def _resolved(self, name: str, goal: Any, start: Mapping[str, ArrayLike]) -> Any:
        """The goal of a robot; joints that it does not name stay at their start."""
        if name not in self.robots or not isinstance(goal, Goal):
            return goal  # reported where goals are checked
        robot = self.robots[name][0]
        return goal.resolved(robot, joint_vector(robot, start[name], "start"))

    def goal(self, goals: Mapping[str, Goal | None]) -> Goal:
        """Combine the goals of the robots into one goal.

        Args:
            goals: A goal for each robot, with the names of joints and frames without
                the name of the robot; None for a robot that may end anywhere, at rest.

        Returns:
            A goal for the combined robot: a JointGoal if all goals are JointGoals (with
            ``wrap=False``, which adds no whole turns to angles, if one of the goals has
            it), otherwise AllGoals; or an AnyGoal of all combinations if a goal has
            alternatives.

        Raises:
            ProblemError: If a robot is missing or unknown, or the goals do not go
                together.
        """
        known = ", ".join(self.robots)
        instance(goals, Mapping, "goal", f"goals by the name of the robot: {known}")
        for name in goals:
            self._member(name)
        for name in self.robots:
            if name not in goals:
                raise ProblemError(
                    f"goal: no goal is given for {brief(name)}; expected a goal, or "
                    "None if the robot may end anywhere",
                    "goal",
                )
            whose = f"goal: the goal of {brief(name)}"
            instance(goals[name], (Goal, NoneType), whose, "a goal or None", "goal")
        each = [goals[name] for name in self.robots]
        choices = [(None,) if item is None else item.alternatives for item in each]
        combinations = [
            self._joined(dict(zip(self.robots, chosen, strict=True)))
            for chosen in itertools.product(*choices)
        ]
        return combinations[0] if len(combinations) == 1 else AnyGoal(combinations)

    def _joined(self, goals: Mapping[str, Goal | None]) -> Goal:
        """Combine the goals of the robots, each without alternatives, into one goal."""
        for name, goal in goals.items():
            if goal is not None:
                with naming(name):
                    goal.validate(self.robots[name][0])
        given = {k: goal for k, goal in goals.items() if goal is not None}
        ends = {k: goal.configuration for k, goal in given.items()}
        q = {k: value for k, value in ends.items() if value is not None}
        moving = any(given[k].ends_moving for k in q)
        if len(q) == len(goals):
            v = {k: given[k].final_velocity(value.size) for k, value in q.items()}
            each = {k: getattr(g, "wrap", True) for k, g in given.items()}
            some = {k: wrap for k, wrap in each.items() if not isinstance(wrap, bool)}
            named = [f"{k}/{joint}" for k, wrap in some.items() for joint in wrap]
            wrap = False not in each.values() and (named or True)
            v_end = self.stack(v) if moving else None
            return JointGoal(self.stack(q), v_end, wrap=wrap)
        if moving:
            raise ProblemError(
                "goal: a JointGoal with a velocity can be joined only with JointGoals "
                "for the other robots",
                "goal",
            )
        if not given:
            raise ProblemError("goal: no robot has a goal", "goal")
        renamed = []
        for name, goal in given.items():
            with naming(name):
                renamed.append(goal.prefixed(f"{name}/", self.robots[name][0]))
        return AllGoals(renamed)

    def split(self, trajectory: Trajectory) -> dict[str, Trajectory]:
        """Split a motion of all robots into the motions of single robots.

        Args:
            trajectory: A motion of the combined robot.

        Returns:
            The motion of each robot by the name of the robot, with joint names without
            it; all motions have the same duration.

        Raises:
            ProblemError: If the motion does not have the joints of these robots.
        """
        instance(trajectory, Trajectory, "trajectory")
        trajectory._check_joints(self.robot.joint_names)
        motions = {}
        for name, (robot, _) in self.robots.items():
            own = [f"{name}/{joint}" for joint in robot.joint_names]
            rows = [trajectory.joint_names.index(joint) for joint in own]
            own_torques = partial(_torques_of_some, rows, trajectory.n)
            each = [partial(own_torques, item) for item in trajectory.segment_dynamics]
            parts: dict[str, Any] = {"segment_dynamics": tuple(each)}
            for key in ("q", "v", "u", "a"):
                values = getattr(trajectory, key)
                parts[key] = None if values is None else values[:, rows]
            for key in ("inverse_dynamics", "holding"):
                function = getattr(trajectory, key)
                parts[key] = function and partial(own_torques, function)
            motions[name] = replace(trajectory, joint_names=robot.joint_names, **parts)
        return motions


def _torques_of_some(
    joints: Sequence[int], n: int, dynamics: InverseDynamics, *rows: Array
) -> Array:
    """Torques of the joints of one robot, on which the other robots have no effect.

    Args:
        joints: Columns of the joints of the robot.
        n: Number of joints of all robots.
        dynamics: Inverse dynamics of all robots, which may carry loads.
        rows: Positions, velocities and accelerations of the robot, each of shape (m,
            len(joints)).

    Returns:
        Torques, shape (m, len(joints)) [N m or N].
    """
    whole = np.zeros((len(rows), len(rows[0]), n))
    whole[:, :, joints] = rows
    return dynamics(*whole)[:, joints]
