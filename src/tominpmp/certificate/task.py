"""Functions and scales of a problem for its certificate.

They follow from the problem alone: the robot, its limits, the scene and the goal. No
code is shared with the programs that plan motions.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tominpmp.arrays import Array
from tominpmp.dynamics import RobotDynamics
from tominpmp.kinematics import RobotKinematics, prismatic_joints
from tominpmp.problem import Problem
from tominpmp.problem.problem import effort_range


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
        """Make the functions of a problem."""
        kinematics = RobotKinematics(problem.robot)
        dynamics = RobotDynamics(problem.robot, dry=False)
        return cls(problem, dynamics, kinematics, kinematics.length)

    @cached_property
    def effort_half(self) -> Array:
        """Half the torque range, shape (n,); 1 where it is empty."""
        half = effort_range(self.problem)[1]
        return np.where(half > 0.0, half, 1.0)

    def share_of_effort(self, torque: Array) -> Array:
        """Torques, shape (..., n) [N m or N], as shares of their limits."""
        return np.asarray((torque - effort_range(self.problem)[0]) / self.effort_half)

    @cached_property
    def step_scale(self) -> Array:
        """Joint displacement that counts as 1 rad, shape (n,): 1, or the reach [m]."""
        return np.where(prismatic_joints(self.problem.robot), self.reach, 1.0)
