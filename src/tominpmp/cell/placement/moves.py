"""What is moved in a cell: the base of the robot, obstacles, or goals."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array
from tominpmp.checks import instance
from tominpmp.combined_robots import base_placement
from tominpmp.description.assembly import on_base
from tominpmp.description.model import build_model, configured_model
from tominpmp.problem import Problem
from tominpmp.robot import Robot
from tominpmp.scene import Scene
from tominpmp.sensitivities import Sensitivities

TRANSLATIONS, ROTATIONS = ("x", "y", "z"), ("roll", "pitch", "yaw")
COORDINATES = TRANSLATIONS + ROTATIONS
BASE, GOALS = "base", "goals"


def robot_at(robot: Robot, base: Any) -> Robot:
    """The robot with its base somewhere else in the world.

    Args:
        robot: The robot.
        base: Placement base_to_world of the root of its description: anything that
            says a pose, or a position, shape (3,) [m].

    Raises:
        ProblemError: If an argument is of another type.
    """
    instance(robot, Robot, "robot")
    description = on_base(robot.description, base_placement(robot.name, base, "base"))
    plain = build_model(description, robot.locked_joints)
    ties = robot.expansion_matrix, robot.expansion_offset
    model = configured_model(plain, robot._table(), robot.gravity, *ties)
    return replace(robot, model=model, description=description)


@dataclass(frozen=True, eq=False)
class Moves:
    """How the problems of tasks change with some coordinates.

    Attributes:
        what: "base", "goals", or names of obstacles.
        names: Names of the coordinates that are free.
        robot: The robot.
        base: Placement of its base where all coordinates are zero.
    """

    what: str | tuple[str, ...]
    names: tuple[str, ...]
    robot: Robot
    base: pin.SE3

    def placement(self, x: Array) -> pin.SE3:
        """The displacement, of the base about its own origin; shape (k,) to SE3."""
        twist = self._twist(x)
        if self.what != BASE:
            return pin.SE3(np.eye(3), twist[:3])
        turned = pin.exp3(twist[3:]) @ self.base.rotation
        return pin.SE3(turned, self.base.translation + twist[:3])

    def _twist(self, x: Array) -> Array:
        twist = np.zeros(6)
        twist[[COORDINATES.index(name) for name in self.names]] = x
        return twist

    def problems(self, tasks: Sequence[Problem], x: Array) -> list[Problem]:
        """The tasks with what is moved where it is to be.

        Raises:
            TominpmpError: If one of them cannot be: a start that collides, say.
        """
        return [make() for make in self.each(tasks, x)]

    def each(
        self, tasks: Sequence[Problem], x: Array
    ) -> Iterator[Callable[[], Problem]]:
        """The same, made one by one by functions: so it is known which cannot be."""
        move = self.placement(x)
        if self.what == BASE:
            # Tasks share a robot, whose meshes are read once.
            robot = robot_at(self.robot, move)
            return (partial(replace, task, robot=robot) for task in tasks)
        by = np.array(move.translation)
        return (partial(self._with_moved, task, by) for task in tasks)

    def _with_moved(self, task: Problem, by: Array) -> Problem:
        if self.what == GOALS:
            return replace(task, goal=task.goal.moved(by))
        scene = [
            replace(item, position=item.position + by)
            if item.name in self.what
            else item
            for item in task.scene
        ]
        return replace(task, scene=Scene(scene))

    def gradient(self, found: Sensitivities, x: Array) -> Array:
        """Derivative of the duration of a task by the coordinates [s/m or s/rad]."""
        slopes = np.zeros(6)
        if self.what == BASE:
            base, twist = found.base, self._twist(x)
            # Of a rotation about where the base is, not about the world's origin.
            here = self.placement(x).translation
            about = base[3:] - np.cross(here, base[:3])
            slopes[:3] = base[:3]
            slopes[3:] = pin.Jexp3(-twist[3:]).T @ about
        else:
            kind = "goal" if self.what == GOALS else "obstacle"
            for item in found.of(kind):
                own = kind == "goal" or item.subject in self.what
                if own and item.vector is not None:
                    slopes[:3] += item.vector
        chosen = slopes[[COORDINATES.index(name) for name in self.names]]
        return np.asarray(found.T * chosen)
