"""What a transcription sees of a problem: functions, bounds and scales."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tominpmp.arrays import Array
from tominpmp.collision import CollisionChecker
from tominpmp.constraints import ClearanceConstraint, PathConstraint
from tominpmp.dynamics import Dynamics, RobotDynamics
from tominpmp.goals import JointGoal
from tominpmp.kinematics import RobotKinematics
from tominpmp.problem import Problem


@dataclass(frozen=True, eq=False)
class System:
    """The functions of a problem, ready to be evaluated.

    Attributes:
        problem: The problem.
        dynamics: Equations of motion.
        kinematics: Placement of frames.
        clearance: Distance to obstacles; None without obstacles.
        reach: Length of the arm, which scales lengths [m].
    """

    problem: Problem
    dynamics: Dynamics
    kinematics: RobotKinematics
    clearance: PathConstraint | None
    reach: float

    @classmethod
    def of(cls, problem: Problem) -> System:
        """Build the functions of a problem."""
        kinematics = RobotKinematics(problem.robot)
        reach = max(kinematics.reach(), 1e-3)
        checker = CollisionChecker(problem.robot, problem.scene)
        clearance = (
            ClearanceConstraint(checker, problem.margin, reach)
            if checker.pairs
            else None
        )
        return cls(problem, RobotDynamics(problem.robot), kinematics, clearance, reach)

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.problem.robot.n

    @property
    def joint_goal(self) -> JointGoal | None:
        """The goal, if it is a configuration."""
        goal = self.problem.goal
        return goal if isinstance(goal, JointGoal) else None

    @cached_property
    def v_start(self) -> Array:
        """Velocities at the start, shape (n,)."""
        given = self.problem.v_start
        return np.zeros(self.n) if given is None else given

    @cached_property
    def final_velocity(self) -> Array | None:
        """Joint velocity at the end, if it is known beforehand, shape (n,)."""
        goal = self.problem.goal
        return goal.final_velocity(self.n) if goal.fixes_velocity else None

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
        return np.where(half > 0.0, half, 1.0)

    @cached_property
    def step_scale(self) -> Array:
        """Joint displacement that counts as 1 rad, shape (n,): 1, or the reach [m]."""
        model = self.problem.robot.model
        prismatic = np.array(
            [
                model.joints[model.getJointId(name)]
                .shortname()
                .startswith("JointModelP")
                for name in self.problem.robot.joint_names
            ]
        )
        return np.where(prismatic, self.reach, 1.0)

    def torque(self, q: Array, v: Array, a: Array) -> Array:
        """Torque as a share of its limits, in [-1, 1] where allowed, shape (m, n)."""
        tau = self.dynamics.inverse(q, v, a)
        return (tau - self.effort_middle) / self.effort_half
