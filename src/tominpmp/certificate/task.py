"""What a problem asks for, in the numbers that a certificate needs.

It is made from the problem alone: the robot, its limits, the scene and the goal.
Nothing here is shared with the programs that motions are made by.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.collision import CollisionChecker, Derivatives
from tominpmp.dynamics import RobotDynamics
from tominpmp.kinematics import RobotKinematics, prismatic_joints
from tominpmp.problem import Problem

# Configurations whose distances are asked for at once.
CHUNK = 512


@dataclass(frozen=True, eq=False)
class Room:
    """What pairs of bodies lack of their margins, as shares of the reach.

    Attributes:
        checker: Distances of the pairs.
        margins: Distances to keep, shape (pairs,) [m].
        reach: Length that the values are divided by [m].
    """

    checker: CollisionChecker
    margins: Array
    reach: float

    @property
    def moving(self) -> bool:
        """Whether values depend on time."""
        return self.checker.moving

    def near(
        self, q: Array, attention: float, times: Array
    ) -> tuple[IntArray, IntArray, Array]:
        """Pairs that have less room than so much.

        Args:
            q: Configurations, shape (m, n) [rad or m].
            attention: The room, as a share of the reach.
            times: Times [s], shape (m,).

        Returns:
            Indices of configurations and pairs, and what is missing, shape (k,) each.
        """
        cutoff = self.margins + attention * self.reach
        parts = []
        for begin in range(0, len(q), CHUNK):
            part = slice(begin, begin + CHUNK)
            found = self.checker.distances(q[part], cutoff, times[part])
            missing = (self.margins - found) / self.reach
            row, pair = np.nonzero(missing > -attention)
            parts.append((row + begin, pair, missing[row, pair]))
        rows, pairs, values = zip(*parts, strict=True)
        return np.concatenate(rows), np.concatenate(pairs), np.concatenate(values)

    def missing(
        self, q: Array, pairs: IntArray, attention: float, times: Array
    ) -> Array:
        """What single pairs lack; an upper bound where they have more room than that.

        Args:
            q: A configuration for each, shape (k, n) [rad or m].
            pairs: Index of the pair at each, shape (k,).
            attention: The room, as a share of the reach.
            times: Times [s], shape (k,).

        Returns:
            Shape (k,), as shares of the reach.
        """
        enough = (self.margins + attention * self.reach)[pairs]
        every = np.arange(len(q))
        found = self.checker.measured(q, every, pairs, enough, times)
        return np.asarray((self.margins[pairs] - found) / self.reach)

    def derivatives_at(
        self, q: Array, instants: IntArray, pairs: IntArray, times: Array
    ) -> Derivatives:
        """Derivatives of what pairs lack, by configuration and by time [1/s].

        Of k pairs at instants of configurations q of shape (m, n) at times [s].
        """
        found = self.checker.derivatives_at(q, instants, pairs, times)
        return Derivatives(*(-part / self.reach for part in found))


@dataclass(frozen=True, eq=False)
class Task:
    """The functions and scales of a problem.

    Attributes:
        problem: The problem.
        dynamics: Equations of motion of its robot.
        kinematics: Placement of its frames.
        reach: Length of the arm, which scales lengths [m].
    """

    problem: Problem
    dynamics: RobotDynamics
    kinematics: RobotKinematics
    reach: float

    @classmethod
    def of(cls, problem: Problem) -> Task:
        """Take up a problem."""
        kinematics = RobotKinematics(problem.robot)
        dynamics = RobotDynamics(problem.robot, dry=False)
        return cls(problem, dynamics, kinematics, kinematics.length)

    @cached_property
    def room(self) -> Room | None:
        """Distances to obstacles and between links; None without either.

        All meshes are cut for them: whoever does not need them does not ask.
        """
        checker, problem = self.problem.checker, self.problem
        if not checker.pairs:
            return None
        return Room(checker, checker.margins(problem.margin), self.reach)

    @cached_property
    def v_start(self) -> Array:
        """Velocities at the start, shape (n,)."""
        given = self.problem.v_start
        return np.zeros(self.problem.robot.n) if given is None else given

    @cached_property
    def effort_middle(self) -> Array:
        """Middle of the torque range, shape (n,) [N m or N]."""
        limits = self.problem.robot.limits
        return 0.5 * (limits.effort_upper + limits.effort_lower)

    @cached_property
    def effort_half(self) -> Array:
        """Half the torque range, shape (n,); 1 where it is empty."""
        limits = self.problem.robot.limits
        half = 0.5 * (limits.effort_upper - limits.effort_lower)
        if self.problem.motion_limits is not None:
            half = self.problem.motion_limits.effort_scale * half
        return np.where(half > 0.0, half, 1.0)

    def share_of_effort(self, torque: Array) -> Array:
        """Torques, shape (..., n) [N m or N], as shares of their limits."""
        return np.asarray((torque - self.effort_middle) / self.effort_half)

    @cached_property
    def step_scale(self) -> Array:
        """Joint displacement that counts as 1 rad, shape (n,): 1, or the reach [m]."""
        return np.where(prismatic_joints(self.problem.robot), self.reach, 1.0)
