r"""Lower bounds on the duration of any motion that solves a problem.

What is bounded is every motion, not the one found: obstacles and detours are ignored,
so that the bound holds whatever path there is. Rigorous are

- speed limits: no joint moves faster, and no frame faster than its joints carry it;
- acceleration limits, where the problem has them, or where an arm has one joint, so
  that the torques bound its acceleration;
- energy: with :math:`w = \sqrt{v^T M v}`, the work of the torques gives
  :math:`\dot w \le \sup_q |u - g|_{M^{-1}}`, in which no Coriolis force appears, as
  it does no work. It needs a lower bound of the inertia at all configurations; see
  :mod:`~tominpmp.bounds.inertia`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tominpmp.arrays import Array
from tominpmp.bounds.bang_bang import (
    AccelerationBounds,
    double_integrator_time,
    least_time,
)
from tominpmp.bounds.inertia import EnergyBounds, energy_bounds, single_joint
from tominpmp.exceptions import expect
from tominpmp.goals import Goal
from tominpmp.kinematics import RobotKinematics, prismatic_joints
from tominpmp.problem import Problem
from tominpmp.stopping import check
from tominpmp.verification.link_displacement import Ball, LinkDisplacement

# Boxes of configurations looked at to show that a frame cannot be at its goal so soon,
# and steps of the search for the time.
MAX_BOXES = 128
BISECTIONS = 5
# A motion is accepted that ends this far off, so that a goal which the arm does not
# reach by less is none that it never reaches [m].
ACCEPTED = 1e-3


@dataclass(frozen=True)
class LowerBound:
    """Time that no motion can beat.

    Attributes:
        T: The time [s]; 0 if nothing could be proved.
        reason: What it comes from, in a clause.
        joint: Name of the joint that it comes from; None if several are involved.
    """

    T: float
    reason: str
    joint: str | None = None


def lower_bound(problem: Problem) -> LowerBound:
    """Find a time that no motion which solves a problem can beat.

    Args:
        problem: The problem.

    Returns:
        The largest bound that was found.
    """
    expect(problem, Problem, "problem", "a Problem")
    if problem.segments:
        return _of_segments(problem)
    return min(
        (_of_goal(problem, goal) for goal in problem.goal.alternatives),
        key=lambda bound: bound.T,
    )


def _of_segments(problem: Problem) -> LowerBound:
    """The speed limits on each segment between two configurations, and all stays."""
    total, known = 0.0, True
    for phase, segment in zip(problem.phases, problem.segments, strict=True):
        total += segment.dwell
        q = phase.goal.configuration
        if known and q is not None:
            found = _speed_bounds(phase, np.abs(q - phase.q_start))
            total += max((bound.T for bound in found), default=0.0)
        known = q is not None
    return LowerBound(total, "joints at full speed on each segment, and all stays")


def _of_goal(problem: Problem, goal: Goal) -> LowerBound:
    bounds: list[LowerBound]
    if goal.configuration is not None:
        bounds = _joint_bounds(problem, goal, goal.configuration)
    else:
        bounds = _range_bounds(problem, goal)
        for member in goal.members:
            if member.frame_name is not None:
                bounds += _frame_bounds(problem, member, member.frame_name)
    nothing = LowerBound(0.0, "no bound is known for a goal of this kind")
    return max(bounds, key=lambda bound: bound.T, default=nothing)


# -- joints ----------------------------------------------------------------------------


def _joint_bounds(problem: Problem, goal: Goal, q: Array) -> list[LowerBound]:
    robot = problem.robot
    joints, top = robot.joint_names, robot.limits.velocity
    start = np.zeros(robot.n) if problem.v_start is None else problem.v_start
    ends = np.stack([start, goal.final_velocity(robot.n)])
    way = q - problem.q_start
    found = _speed_bounds(problem, np.abs(way))
    units = np.where(prismatic_joints(robot), "m", "rad")
    if problem.motion_limits is not None:
        limit = problem.motion_limits.by_joint("acceleration", joints)
        for i in np.flatnonzero(np.isfinite(limit)).tolist():
            most = float(limit[i])
            T = double_integrator_time(way[i], ends[:, i], (most, most), top[i])
            reason = (
                f"joint {joints[i]} accelerates by {most:.4g} {units[i]}/s^2 at most"
            )
            found.append(LowerBound(T, reason, joints[i]))
    alone = single_joint(robot)
    if alone is not None:
        T = _single_time(float(way[0]), ends[:, 0], alone, float(top[0]))
        reason = f"no torque accelerates joint {joints[0]} more"
        found.append(LowerBound(T, reason, joints[0]))
    energy = energy_bounds(robot)
    if energy is not None:
        found += _energy_bounds(problem, way, ends, energy)
    return found


def _range_bounds(problem: Problem, goal: Goal) -> list[LowerBound]:
    lower, upper = goal.joint_ranges(problem.robot)
    q = problem.q_start
    if not np.any(np.isfinite([lower, upper])):
        return []
    return _speed_bounds(problem, np.maximum(np.maximum(lower - q, q - upper), 0.0))


def _speed_bounds(problem: Problem, way: Array) -> list[LowerBound]:
    """Bounds from the speed limits for distances to go, shape (n,)."""
    robot, found = problem.robot, []
    top = robot.limits.velocity
    units = np.where(prismatic_joints(robot), "m", "rad")
    for i in np.flatnonzero(np.isfinite(top)).tolist():
        reason = (
            f"joint {robot.joint_names[i]} has {way[i]:.4g} {units[i]} to go, at "
            f"{top[i]:.4g} {units[i]}/s at most"
        )
        T = float(way[i]) / float(top[i])
        found.append(LowerBound(T, reason, robot.joint_names[i]))
    return found


def _single_time(
    way: float, ends: Array, bounds: AccelerationBounds, top: float
) -> float:
    side = 1.0 if way >= 0.0 else -1.0
    toward = np.maximum(side * ends, 0.0)
    speeding, braking = (
        (bounds.up, bounds.down) if side > 0 else (bounds.down, bounds.up)
    )
    if np.all(side * ends >= 0.0) and way != 0.0:
        # Whoever starts and ends forwards gains nothing by going backwards, and who
        # goes forwards has dry friction against him, which helps to brake.
        speeding, braking = speeding - bounds.dry, braking + bounds.dry
        if speeding <= 0.0:
            return 0.0
    else:
        speeding, braking = speeding + bounds.dry, braking + bounds.dry
    if bounds.drag == 0.0:
        both = (speeding, braking) if side > 0 else (braking, speeding)
        return double_integrator_time(way, ends, both, top)
    drag = bounds.drag
    return least_time(abs(way), toward, speeding, braking, drag, top, least_drag=drag)


def _energy_bounds(
    problem: Problem, way: Array, ends: Array, energy: EnergyBounds
) -> list[LowerBound]:
    """Bounds from the work of the torques, joint by joint and along the way."""
    robot, found = problem.robot, []
    mass = energy.inertia_at(np.stack([problem.q_start, problem.q_start + way]))
    # Largest w = |v|_M at both ends.
    swing = np.sqrt(np.einsum("ki,kij,kj->k", ends, mass, ends))
    directions: list[tuple[Array, str | None]] = [
        (row, robot.joint_names[i]) for i, row in enumerate(np.eye(robot.n))
    ]
    along = np.mean(mass, axis=0) @ way
    if np.any(along):
        directions.append((along / np.linalg.norm(along), None))
    for direction, joint in directions:
        # A coordinate c q changes at |c v| <= |c|_(M^-1) w.
        rate = energy.rate(direction)
        distance = abs(float(direction @ way))
        top = float(np.sum(np.abs(direction) * robot.limits.velocity))
        T = least_time(
            distance,
            rate * swing,
            rate * energy.acceleration,
            rate * energy.acceleration,
            energy.drag,
            top,
        )
        where = "the arm" if joint is None else f"joint {joint}"
        found.append(LowerBound(T, f"no torques carry {where} there sooner", joint))
    return found


# -- frames ----------------------------------------------------------------------------


def _frame_bounds(problem: Problem, goal: Goal, frame: str) -> list[LowerBound]:
    found = []
    place = RobotKinematics(problem.robot).placement(problem.q_start, frame)
    angle = goal.angle_to_go(np.asarray(place.rotation))
    speed = _turning_speed(problem, frame)
    if angle > 0.0 and speed > 0.0:
        reason = f"frame {frame} has {angle:.4g} rad to turn"
        found.append(LowerBound(angle / speed, reason))
    if goal.distances(np.zeros((1, 3))) is not None:
        T = _Vicinity(problem, goal, frame).time()
        reason = f"no sooner do the speeds of the joints carry frame {frame} there"
        found.append(LowerBound(T, reason))
    return found


def _turning_speed(problem: Problem, frame: str) -> float:
    """Bound on the speed at which a frame turns [rad/s]."""
    robot, model = problem.robot, problem.robot.model
    top, S = robot.limits.velocity, robot.expansion_matrix
    if S is not None:
        moved = np.abs(S) > 0.0
        top = np.array(
            [np.sum(np.abs(s[m]) * top[m]) for s, m in zip(S, moved, strict=True)]
        )
    speed = 0.0
    for joint in model.supports[model.frames[robot.frame_id(frame)].parentJoint]:
        item = model.joints[joint]
        if joint > 0 and not str(item.shortname()).startswith("JointModelP"):
            speed += float(top[item.idx_v])
    return speed


class _Vicinity:
    """Where a frame can be when joints have moved for some time."""

    def __init__(self, problem: Problem, goal: Goal, frame: str) -> None:
        robot = problem.robot
        self.problem, self.goal = problem, goal
        item = robot.model.frames[robot.frame_id(frame)]
        origin = np.asarray(item.placement.translation)
        ball = Ball(frame, int(item.parentJoint), origin, 0.0)
        self.reach = LinkDisplacement(robot, [ball])

    def time(self) -> float:
        """Largest time found by which no motion has brought the frame to its goal."""
        low, high = 0.0, self._far()
        for _ in range(BISECTIONS):
            T = 0.5 * (low + high)
            low, high = (T, high) if self.excluded(T) else (low, T)
        return low

    def _far(self) -> float:
        """A time that is too long to exclude, or all there is to look at."""
        limits = self.problem.robot.limits
        T = 1e-2
        while T < 100.0 and self.excluded(T):
            T *= 2.0
        return T if np.any(np.isfinite(limits.velocity)) else 0.0

    def excluded(self, T: float) -> bool:
        """Whether the frame is surely not at its goal before a time."""
        limits, q = self.problem.robot.limits, self.problem.q_start
        swing = limits.velocity * T
        if not np.all(np.isfinite(swing)):
            # Joints without a speed limit may be anywhere; turning ones need one turn.
            swing = np.where(np.isfinite(swing), swing, math.pi)
            if np.any(prismatic_joints(self.problem.robot) & np.isinf(limits.velocity)):
                return False
        low = np.maximum(q - swing, np.minimum(limits.position_lower, q))
        high = np.minimum(q + swing, np.maximum(limits.position_upper, q))
        boxes = (0.5 * (low + high)[None], 0.5 * (high - low)[None])
        for _ in range(MAX_BOXES):
            check()
            shifts = self.reach.shifts(*boxes)[:, 0]
            near = self._distance(boxes[0]) <= np.sum(shifts, axis=1) + ACCEPTED
            if not near.any():
                return True
            if 2 * int(near.sum()) > MAX_BOXES:
                return False
            boxes = self._halves(boxes[0][near], boxes[1][near], shifts[near])
        return False

    def _distance(self, q: Array) -> Array:
        apart = self.goal.distances(self.reach.centres(q)[:, 0])
        assert apart is not None  # noqa: S101
        return apart

    def _halves(self, q: Array, half: Array, shifts: Array) -> tuple[Array, Array]:
        """Cut each box across the joint that moves the frame most."""
        share = np.abs(self.problem.robot.reduce_tangent(shifts))
        widest = np.argmax(share, axis=1)
        rows = np.arange(q.shape[0])
        half = half.copy()
        half[rows, widest] *= 0.5
        step = np.zeros_like(half)
        step[rows, widest] = half[rows, widest]
        return np.concatenate([q - step, q + step]), np.concatenate([half, half])
