"""A problem as transcriptions see it: functions, bounds and scales."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from tominpmp.arrays import Array
from tominpmp.constraints.base import Constraint
from tominpmp.constraints.clearance import ClearanceConstraint
from tominpmp.constraints.joint_limits import JointLimit
from tominpmp.constraints.torque import Motors, TorqueLimit, TorqueOverSpeed, TorqueRate
from tominpmp.dynamics import Dynamics, RobotDynamics
from tominpmp.kinematics import RobotKinematics, prismatic_joints
from tominpmp.motion_limits import MotionLimits, kinds_of
from tominpmp.problem.controls import effort_range
from tominpmp.problem.joint_limits import joint_limits

if TYPE_CHECKING:
    from tominpmp.problem.problem import Problem

# Largest padding beyond the margin [m], and its largest share of the clearance beyond
# the margin at the ends of the motion.
PADDING = 2e-3
PADDING_SHARE = 0.5
# Largest padding where an obstacle moves [m]: the arm often waits for the obstacle, and
# the padding makes the wait longer.
MOVING_PADDING = 4e-4


class LazyClearanceRows:
    """Clearance rows, made when they are first used.

    An arm without obstacles is planned without clearance rows at first, and mostly does
    not need them; making them may take as long as a plan, and seconds where meshes are
    not yet cut into convex pieces.

    Args:
        problem: The problem.
        reach: Length of the arm, which scales lengths [m].
        share: Share of the usual padding beyond the margin.
    """

    def __init__(self, problem: Problem, reach: float, share: float = 1.0) -> None:
        self._problem, self._reach, self._share = problem, reach, share

    def padded(self, share: float) -> LazyClearanceRows:
        """The clearance rows with a share of their padding beyond the margin."""
        return LazyClearanceRows(self._problem, self._reach, share * self._share)

    @cached_property
    def room(self) -> Array:
        """Padding beyond the margin, by collision pair [m].

        It makes the motion keep the margin between the rows.
        """
        problem, checker = self._problem, self._problem.checker
        ends = [problem.q_start]
        if problem.goal.configuration is not None:
            ends.append(problem.goal.configuration)
        # Distances beyond this do not change the padding.
        cutoff = problem.margins + PADDING / PADDING_SHARE
        room = checker.distances(np.stack(ends), cutoff) - problem.margins
        # The arrival time is not known, nor is the place of moving obstacles then.
        room[1:, checker.moving_pairs] = np.inf
        room = np.min(room, axis=0)
        most = np.where(checker.moving_pairs, MOVING_PADDING, PADDING)
        return np.asarray(self._share * np.clip(PADDING_SHARE * room, 0.0, most))

    @cached_property
    def clearance(self) -> ClearanceConstraint | None:
        """Distances to obstacles and between links; None without either."""
        checker = self._problem.checker
        if not checker.pairs:
            return None
        margin = self._problem.margins + self.room
        padding = self.room / self._reach
        return ClearanceConstraint(checker, margin, self._reach, padding=padding)


@dataclass(frozen=True, eq=False)
class ProblemFunctions:
    """The functions of a problem, ready to be evaluated.

    Attributes:
        problem: The problem.
        dynamics: Equations of motion without dry friction; their torques are those of
            the motors less dry friction.
        kinematics: Placement of frames.
        reach: Length of the arm, which scales lengths [m].
        watched: The clearance rows; None without clearance rows.
        ways: Assumed direction of each joint during the whole motion, 1, -1 or 0 for at
            rest, shape (n,): torques are those of the motors less dry friction, and
            their limits are shifted by it. None without the assumption.
        parts: The functions of each segment; empty for one segment.
    """

    problem: Problem
    dynamics: Dynamics
    kinematics: RobotKinematics
    reach: float
    watched: LazyClearanceRows | None
    ways: Array | None = None
    parts: tuple[ProblemFunctions, ...] = ()

    @classmethod
    def of(cls, problem: Problem) -> ProblemFunctions:
        """Build the functions of a problem."""
        whole = cls._of(problem)
        if not problem.segments:
            return whole
        # One set of rows for the same pairs, on all segments at once.
        rows, parts = {id(problem.checker): whole.watched}, list[ProblemFunctions]()
        for phase in problem.phases:
            part = cls._of(phase)
            watched = rows.setdefault(id(phase.checker), part.watched)
            parts.append(replace(part, watched=watched))
        return replace(whole, parts=tuple(parts))

    @classmethod
    def _of(cls, problem: Problem) -> ProblemFunctions:
        kinematics = RobotKinematics(problem.robot)
        reach = kinematics.length
        dynamics = RobotDynamics(problem.robot, dry=False)
        watched = LazyClearanceRows(problem, reach)
        if not problem.checker.single_arm:
            _ = watched.clearance
        return cls(problem, dynamics, kinematics, reach, watched)

    @property
    def clearance(self) -> ClearanceConstraint | None:
        """Distances to obstacles and between links; None without either."""
        return None if self.watched is None else self.watched.clearance

    @property
    def in_free_space(self) -> bool:
        """Whether the problem is a single arm in free space."""
        return all(
            not len(phase.scene) and len(phase.robot.parts) <= 1
            for phase in self.problem.phases
        )

    @property
    def segments(self) -> tuple[ProblemFunctions, ...]:
        """The functions of each segment; these functions for one segment."""
        return self.parts or (self,)

    @property
    def sudden(self) -> bool:
        """Whether accelerations may begin and end suddenly, on all segments."""
        own = not self.motion_limits.continuous
        return own and all(part.sudden for part in self.parts)

    @property
    def without_self_collision(self) -> ProblemFunctions:
        """The functions to begin with: a single arm is planned without self-collision.

        Its links hardly ever touch, and the verification detects where they do. Rows
        for them would take more time than the rest of the plan.
        """
        if not self.in_free_space:
            return self
        return self._each(lambda system: replace(system, watched=None))

    def _each(
        self, change: Callable[[ProblemFunctions], ProblemFunctions]
    ) -> ProblemFunctions:
        """The functions with a change made to the whole and to each segment."""
        return replace(change(self), parts=tuple(map(change, self.parts)))

    def padded(self, share: float) -> ProblemFunctions:
        """The same problem with a share of its padding beyond the margin."""
        known: dict[int, LazyClearanceRows] = {}

        def padded(system: ProblemFunctions) -> ProblemFunctions:
            if system.watched is None:
                return system
            watched = known.setdefault(id(system.watched), system.watched.padded(share))
            return replace(system, watched=watched)

        return self._each(padded)

    def without_smooth_limits(self) -> ProblemFunctions:
        """The same problem without limits that need continuous accelerations."""

        def loosened(system: ProblemFunctions) -> ProblemFunctions:
            limits = system.motion_limits
            if not limits.continuous:
                return system
            problem = copy.copy(system.problem)
            kinds = kinds_of(limits).items()
            smooth: dict[str, Any] = {k: None for k, kind in kinds if kind.smooth}
            loose = replace(limits, **smooth)
            object.__setattr__(problem, "motion_limits", loose)
            return replace(system, problem=problem)

        return self._each(loosened)

    def resting(self, time: float | None = None) -> ProblemFunctions:
        """The same problem without moving obstacles.

        Args:
            time: Time at which the obstacles are frozen [s]; None leaves them out.
        """
        scene = self.problem.scene
        if not scene.moving:
            return self
        scene = scene.resting() if time is None else scene.at(time)
        return ProblemFunctions.of(self.problem.with_scene(scene))

    @cached_property
    def motors(self) -> Motors:
        """Torques as shares of their limits."""
        middle, half = self.effort_middle, self.effort_half
        return Motors(self.dynamics, middle, half, self.friction)

    @cached_property
    def constraints(self) -> tuple[Constraint, ...]:
        """All constraints along a motion."""
        limits: list[Constraint] = []
        for item in joint_limits(self.problem.robot, self.motion_limits):
            joints, kind, most = item.joints, item.kind, item.upper
            if kind.quantity == "u":
                limits.append(TorqueLimit(self.motors, kind))
            elif kind.quantity == "du":
                limits.append(TorqueRate(self.motors, kind, joints, most[joints]))
            elif kind.quantity == "uv":
                limits.append(TorqueOverSpeed(self.motors, kind, item.by_speed))
            elif joints.size:
                scale = most if kind.order else self.step_scale
                rows = item.lower[joints], most[joints], scale[joints]
                limits.append(JointLimit(kind, joints, *rows))
        # Those of the motors first, positions last.
        limits.sort(key=lambda item: (isinstance(item, JointLimit), item.order == 0))
        found = [*limits, self.clearance, *self.problem.ready_constraints]
        return tuple(item for item in found if item is not None)

    @property
    def motion_limits(self) -> MotionLimits:
        """Limits beyond those of the robot; an empty record where none are given."""
        return self.problem.motion_limits or MotionLimits()

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.problem.robot.n

    @property
    def final_configuration(self) -> Array | None:
        """The goal, if it is a configuration, shape (n,)."""
        return self.problem.goal.configuration

    @cached_property
    def goal_bounds(self) -> tuple[Array, Array]:
        """Lower and upper bounds of the goal residual, shape (k,) each."""
        return self.problem.goal.bounds(self.kinematics)

    @cached_property
    def goal_scale(self) -> Array:
        """Scale of the goal residual, shape (k,).

        Lengths have the scale 1, or the reach for arms shorter than a metre.
        """
        scale = np.ones(self.goal_bounds[0].size)
        place = self.problem.goal.place(self.kinematics, self.problem.q_start)
        scale[: place.lengths.size][place.lengths] = min(self.reach, 1.0)
        return scale

    @property
    def v_start(self) -> Array:
        """Velocities at the start, shape (n,)."""
        return self.problem.v_start

    @cached_property
    def final_velocity(self) -> Array | None:
        """Joint velocity at the end, if it is known beforehand, shape (n,)."""
        goal = self.problem.goal
        return goal.final_velocity(self.n) if goal.fixes_velocity else None

    @cached_property
    def effort_middle(self) -> Array:
        """Middle of the torque range, shape (n,) [N m or N]."""
        middle, _ = effort_range(self.problem.robot, self.motion_limits)
        return middle if self.ways is None else middle - self.resistance

    @cached_property
    def effort_half(self) -> Array:
        """Half the torque range, shape (n,); 1 where it is empty."""
        _, half = effort_range(self.problem.robot, self.motion_limits)
        return np.where(half > 0.0, half, 1.0)

    @property
    def resistance(self) -> Array:
        """Dry friction in the assumed directions, shape (n,) [N m or N]."""
        ways = np.zeros(self.n) if self.ways is None else self.ways
        return np.asarray(self.problem.robot.friction * ways)

    @cached_property
    def motor_dynamics(self) -> Dynamics:
        """Equations of motion with dry friction: torques are those of the motors."""
        motors = RobotDynamics(self.problem.robot)
        plain = motors.friction is None or self.ways is not None
        return self.dynamics if plain else motors

    @cached_property
    def friction(self) -> Array | None:
        """Dry friction as a share of the torque limits, shape (n,); None without."""
        friction = self.problem.robot.friction
        if self.ways is not None or not np.any(friction):
            return None
        return np.asarray(friction / self.effort_half)

    @cached_property
    def step_scale(self) -> Array:
        """Joint displacement that counts as 1 rad, shape (n,): 1, or the reach [m]."""
        return np.where(prismatic_joints(self.problem.robot), self.reach, 1.0)

    def torque(self, q: Array, v: Array, a: Array) -> Array:
        """Torque as a share of its limits, in [-1, 1] where allowed, shape (m, n)."""
        tau = self.motor_dynamics.inverse(q, v, a)
        return (tau - self.effort_middle) / self.effort_half
