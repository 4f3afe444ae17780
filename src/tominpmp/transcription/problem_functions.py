"""Functions, bounds and scales of a problem, for transcriptions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from tominpmp.arrays import Array, BoolArray
from tominpmp.collision.query import ROUNDING
from tominpmp.constraints.base import Constraint
from tominpmp.constraints.clearance import ClearanceConstraint
from tominpmp.constraints.joint_limits import JointLimit
from tominpmp.constraints.torque import (
    HeldAtRest,
    Motors,
    TorqueLimit,
    TorqueOverSpeed,
    TorqueRate,
)
from tominpmp.dynamics import Dynamics, RobotDynamics, directions
from tominpmp.kinematics import RobotKinematics, prismatic_joints
from tominpmp.motion_limits import SIDES, MotionLimits
from tominpmp.problem.joint_limits import effort_range, joint_limits

if TYPE_CHECKING:
    from tominpmp.problem.problem import Problem

# Largest padding beyond the margin: absolute [m], and as a share of the excess of the
# clearance over the margin where the motion begins and where its segments end.
PADDING = 2e-3
PADDING_SHARE = 0.5
# Largest padding for moving obstacles [m]: the arm often waits for an obstacle, and the
# padding makes the wait longer.
MOVING_PADDING = 4e-4


@dataclass(frozen=True, eq=False)
class LazyClearanceRows:
    """Clearance rows that are built when they are first used.

    An arm without obstacles is planned without clearance rows at first, and mostly does
    not need them. Building them may take as long as planning, and seconds if meshes are
    not yet decomposed into convex pieces.

    Attributes:
        problem: The problem.
        reach: Length of the arm, which scales lengths [m].
        passed: Configurations that the motion passes, shape (k, n): its start first,
            then the goals that are configurations, and the configurations of a guess at
            all other goals.
        share: Share of the full padding beyond the margin.
    """

    problem: Problem
    reach: float
    passed: Array
    share: float = 1.0

    def passing(self, q: Array) -> LazyClearanceRows:
        """The clearance rows for a guess that passes configurations, shape (m, n)."""
        same = np.all(np.isclose(q[:, None], self.passed), axis=2)
        more = q[~np.any(same, axis=1)]
        if not len(more):
            return self
        return replace(self, passed=np.concatenate([self.passed, more]))

    @cached_property
    def padding(self) -> Array:
        """Padding beyond the margin of each collision pair [m].

        With it, the motion keeps the margin between the rows as well. Goals may lie
        closer to an obstacle than the full padding: a part in a gripper, or a tool at
        work. Configurations in collision, as a guess may have, do not count as goals.
        """
        problem, checker = self.problem, self.problem.checker
        # Distances beyond this do not change the padding.
        cutoff = problem.margins + PADDING / PADDING_SHARE
        excess = checker.distances(self.passed, cutoff) - problem.margins
        excess[excess < -ROUNDING] = np.inf
        # Where moving obstacles are at the arrival is unknown, as its time is.
        excess[1:, checker.moving_pairs] = np.inf
        excess = np.min(excess, axis=0)
        most = np.where(checker.moving_pairs, MOVING_PADDING, PADDING)
        padding = self.share * np.clip(PADDING_SHARE * excess, 0.0, most)
        # Rounding may leave states at the margin slightly inside it.
        return np.asarray(padding + np.clip(excess, -ROUNDING, 0.0))

    @cached_property
    def clearance(self) -> ClearanceConstraint | None:
        """Distances to obstacles and between links; None without collision pairs."""
        checker = self.problem.checker
        if not checker.pairs:
            return None
        margin = self.problem.margins + self.padding
        padding = np.maximum(self.padding, 0.0) / self.reach
        return ClearanceConstraint(checker, margin, self.reach, padding=padding)


@dataclass(frozen=True, eq=False)
class ProblemFunctions:
    """The functions of a problem, ready to be evaluated.

    Attributes:
        problem: The problem.
        dynamics: Equations of motion without dry friction; their torques are the motor
            torques less dry friction.
        kinematics: Placement of frames.
        reach: Length of the arm, which scales lengths [m].
        clearance_rows: The clearance rows; None for a program without clearance rows.
        signs: Assumed velocity sign of each joint during the whole motion, 1, -1, or 0
            for a joint at rest, shape (n,): torques are motor torques less dry
            friction, which shifts their limits. None without the assumption.
        parts: The functions of each segment; empty for one segment.
    """

    problem: Problem
    dynamics: Dynamics
    kinematics: RobotKinematics
    reach: float
    clearance_rows: LazyClearanceRows | None
    signs: Array | None = None
    parts: tuple[ProblemFunctions, ...] = ()

    @classmethod
    def of(cls, problem: Problem) -> ProblemFunctions:
        """Build the functions of a problem."""
        # Segments with the same collision pairs share one set of rows.
        passed: dict[int, list[Array]] = {id(problem.checker): [problem.q_start]}
        for phase in problem.phases:
            known = passed.setdefault(id(phase.checker), [phase.q_start])
            ends = phase.q_start, phase.goal.configuration
            known += [q for q in ends if q is not None and q is not known[0]]
        rows: dict[int, LazyClearanceRows] = {}

        def functions(part: Problem) -> ProblemFunctions:
            kinematics, key = RobotKinematics(part.robot), id(part.checker)
            reach = kinematics.length
            own = LazyClearanceRows(part, reach, np.stack(passed[key]))
            rows.setdefault(key, own)
            if not part.checker.single_arm:
                _ = rows[key].clearance
            dynamics = RobotDynamics(part.robot, dry=False)
            return cls(part, dynamics, kinematics, reach, rows[key])

        whole = functions(problem)
        if not problem.segments:
            return whole
        return replace(whole, parts=tuple(map(functions, problem.phases)))

    @property
    def clearance(self) -> ClearanceConstraint | None:
        """Distances to obstacles and between links; None without clearance rows."""
        return None if self.clearance_rows is None else self.clearance_rows.clearance

    @property
    def in_free_space(self) -> bool:
        """Whether the problem is a single arm in free space."""
        return all(
            not len(phase.scene) and len(phase.robot.parts) <= 1
            for phase in self.problem.phases
        )

    @property
    def segments(self) -> tuple[ProblemFunctions, ...]:
        """The functions of each segment; for one segment, the functions themselves."""
        return self.parts or (self,)

    @property
    def sudden(self) -> bool:
        """Whether accelerations may jump at the ends of the motion and of segments."""
        own = not self.motion_limits.continuous
        return own and all(part.sudden for part in self.parts)

    @property
    def without_self_collision(self) -> ProblemFunctions:
        """The initial functions: a single arm is planned without self-collision rows.

        Its links hardly ever touch, and the verification detects if they do. Rows for
        self-collision would take more time than the rest of the planning.
        """
        return self._with_rows(lambda rows: None) if self.in_free_space else self

    def padded(self, share: float) -> ProblemFunctions:
        """The same problem with a share of its padding beyond the margin."""
        return self._with_rows(lambda rows: replace(rows, share=share * rows.share))

    def passing(self, q: Array) -> ProblemFunctions:
        """The same problem with padding for a guess that passes configurations.

        A goal on a frame may be closer to an obstacle than the padding, which is only
        known once a configuration reaches it.

        Args:
            q: The configurations, shape (m, n) [rad or m].
        """
        return self._with_rows(lambda rows: rows.passing(q))

    def _with_rows(
        self, change: Callable[[LazyClearanceRows], LazyClearanceRows | None]
    ) -> ProblemFunctions:
        """The functions after a change of the clearance rows, also of all segments."""
        known: dict[int, LazyClearanceRows | None] = {}

        def changed(system: ProblemFunctions) -> ProblemFunctions:
            if (rows := system.clearance_rows) is None:
                return system
            rows = known.setdefault(id(rows), change(rows))
            return replace(system, clearance_rows=rows)

        return replace(changed(self), parts=tuple(map(changed, self.parts)))

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
        """Functions of the torques, as shares of their limits."""
        middle, half = self.effort_middle, self.effort_half
        return Motors(self.dynamics, middle, half, self.friction)

    @cached_property
    def constraints(self) -> tuple[Constraint, ...]:
        """All constraints along a motion, except the goal."""
        limits: list[Constraint] = []
        for item in joint_limits(self.problem.robot, self.motion_limits):
            joints, kind, most = item.joints, item.kind, item.upper
            if kind.quantity == "u":
                limits.append(TorqueLimit(kind, np.arange(self.n), self.motors))
            elif kind.quantity == "du":
                limits.append(TorqueRate(kind, joints, self.motors, most[joints]))
            elif kind.quantity == "uv":
                both = kind, np.tile(joints, len(SIDES)), self.motors
                limits.append(TorqueOverSpeed(*both, item.by_speed))
            elif joints.size:
                scale = most if kind.order else self.step_scale
                rows = item.lower[joints], most[joints], scale[joints]
                limits.append(JointLimit(kind, joints, *rows))
        # Limits of the motors come first, limits of positions last.
        limits.sort(key=lambda item: (isinstance(item, JointLimit), item.order == 0))
        found = [*limits, self.clearance, *self.problem.ready_constraints]
        return tuple(item for item in found if item is not None)

    @property
    def motion_limits(self) -> MotionLimits:
        """Limits of the problem in addition to the limits of the robot; maybe empty."""
        return self.problem.motion_limits or MotionLimits()

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.problem.robot.n

    @property
    def final_configuration(self) -> Array | None:
        """The goal, shape (n,), if it is a configuration; None otherwise."""
        return self.problem.goal.configuration

    @cached_property
    def goal_bounds(self) -> tuple[Array, Array]:
        """Lower and upper bounds of the goal residual, shape (k,) each."""
        return self.problem.goal.bounds(self.kinematics)

    @cached_property
    def goal_scale(self) -> Array:
        """Scale of the goal residual, shape (k,).

        The scale of lengths is 1 m, or the reach for arms shorter than a metre.
        """
        scale = np.ones(self.goal_bounds[0].size)
        place = self.problem.goal.place(self.kinematics, self.problem.q_start)
        scale[: place.lengths.size][place.lengths] = min(self.reach, 1.0)
        return scale

    @cached_property
    def final_velocity(self) -> Array | None:
        """Joint velocity at the end, shape (n,); None if the goal does not fix it."""
        goal = self.problem.goal
        return goal.final_velocity(self.n) if goal.fixes_velocity else None

    @cached_property
    def held(self) -> HeldAtRest | None:
        """Constraint that the motors hold the arm where the segment ends.

        None if the arm moves on, if there is no gravity, if the robot has no torques,
        and if the final configuration is given: the problem has checked it.
        """
        robot, v = self.problem.robot, self.final_velocity
        given = self.final_configuration is not None or robot.kinematic
        if given or v is None or np.any(v) or not np.any(robot.gravity):
            return None
        middle, half = effort_range(robot, None)
        half = np.where(self.driven, half, 1.0)
        return HeldAtRest(Motors(self.dynamics, middle, half), self.driven)

    @cached_property
    def effort_middle(self) -> Array:
        """Middle of the torque range, shape (n,) [N m or N]."""
        middle, _ = effort_range(self.problem.robot, self.motion_limits)
        return middle - self.resistance

    @cached_property
    def effort_half(self) -> Array:
        """Half the torque range, shape (n,); 1 for joints with an empty range."""
        _, half = effort_range(self.problem.robot, self.motion_limits)
        return np.where(half > 0.0, half, 1.0)

    @property
    def resistance(self) -> Array:
        """Dry friction for the assumed velocity signs, shape (n,) [N m or N]."""
        signs = np.zeros(self.n) if self.signs is None else self.signs
        return np.asarray(self.problem.robot.friction * signs)

    @cached_property
    def motor_dynamics(self) -> Dynamics:
        """Equations of motion with dry friction, for the motor torques."""
        motors = RobotDynamics(self.problem.robot)
        plain = motors.friction is None or self.signs is not None
        return self.dynamics if plain else motors

    @cached_property
    def friction(self) -> Array | None:
        """Dry friction over half the torque range, (n,); None without friction."""
        friction = self.problem.robot.friction
        if self.signs is not None or not np.any(friction):
            return None
        return np.asarray(friction / self.effort_half)

    @cached_property
    def step_scale(self) -> Array:
        """Joint displacement that counts as 1 rad, (n,): 1 rad, or the reach [m]."""
        return np.where(prismatic_joints(self.problem.robot), self.reach, 1.0)

    def torque(self, q: Array, v: Array, a: Array) -> Array:
        """Motor torques as shares of their limits, feasible in [-1, 1], (m, n)."""
        tau = self.motor_dynamics.inverse(q, v, a)
        return (tau - self.effort_middle) / self.effort_half

    @cached_property
    def driven(self) -> BoolArray:
        """Whether each joint has a motor, and thus a nonempty torque range, (n,)."""
        limits = self.problem.robot.limits
        return np.asarray(limits.effort_upper > limits.effort_lower)

    def torque_shares(self, u: Array) -> Array:
        """Torques as shares of their limits, clipped to them, shape (N, n)."""
        _, most = effort_range(self.problem.robot, self.motion_limits)
        if self.friction is not None:
            most = most + self.problem.robot.friction
        most = most / self.effort_half
        return np.clip((u - self.effort_middle) / self.effort_half, -most, most)

    def net_torque(self, u: Array, v: Array) -> Array:
        """Motor torques less dry friction, shape (N, n) [N m or N]."""
        if self.friction is None:
            return u
        return np.asarray(u - self.problem.robot.friction * directions(v, 0.0 * v))

    def driving_torque(self, q: Array, v: Array, h: Array) -> Array:
        """Torques that drive a motion, in the middle of its intervals, shape (N, n).

        The torques are not clipped to their limits.

        Args:
            q: Positions at the nodes, shape (N + 1, n).
            v: Velocities at the nodes, shape (N + 1, n).
            h: Lengths of the intervals [s], shape (N,).
        """
        step = h[:, None]
        middle = 0.5 * (q[:-1] + q[1:])
        speed, acceleration = np.diff(q, axis=0) / step, np.diff(v, axis=0) / step
        return self.dynamics.inverse(middle, speed, acceleration)
