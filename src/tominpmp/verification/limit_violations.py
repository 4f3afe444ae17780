"""Limit violations of a motion: joint, time and amount."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.dynamics import RobotDynamics
from tominpmp.kinematics import units_of
from tominpmp.motion_limits import LimitKind, joint_kinds
from tominpmp.problem.joint_limits import JointBounds, joint_limits
from tominpmp.robot.robot import Robot
from tominpmp.stopping import check
from tominpmp.verification.polynomials import Pieces
from tominpmp.verification.replay import TIME_STEP, Replay

if TYPE_CHECKING:
    from tominpmp.problem.problem import Problem

# Speed below which a joint may stop, reverse or start at another time than in a replay
# [rad/s or m/s]: a tenth of the tolerance of the final velocity.
SLOW = 1e-3
# Rounding error of positions, as a share of the largest position. Accelerations contain
# its second differences: within microseconds rounding looks like a jerk.
ROUNDING = 16.0 * float(np.finfo(np.float64).eps)


@dataclass(frozen=True)
class LimitViolation:
    """The worst violation of one kind of limit, or the least slack.

    Attributes:
        kind: "start", "goal", "speed", "position", "velocity", "effort",
            "acceleration", "jerk", "effort rate", "feedback", "holding torque",
            "clearance", "duration", "arrival", or the name of a constraint.
        name: Name of the joint, of the frame, of the pair ("link and obstacle"), or of
            the subject of a constraint; "late" or "early" for arrivals, "the motion"
            for durations, and "the arm" for goals after a failed integration.
        time: Time of the violation [s].
        amount: Excess over the limit, or distance from the goal, infinite after a
            failed integration; negative for slack.
        unit: Unit of the amount.
        share: The amount relative to the limit, for positions and efforts relative to
            the range of the limits; for the start, goals, clearances and arrivals the
            amount itself.
        violated: Whether the excess is larger than the tolerance.
        segment: Number of the segment, from 1; None for a motion of one segment.
        span: Begin and end of the segment [s]; None for a motion of one segment.
    """

    kind: str
    name: str
    time: float
    amount: float
    unit: str
    share: float
    violated: bool
    segment: int | None = None
    span: tuple[float, float] | None = None

    def __str__(self) -> str:
        """The violation and its segment, in words."""
        return self.place + self.clause

    @property
    def place(self) -> str:
        """Beginning of a sentence, with the segment; empty for a single segment."""
        if self.span is None:
            return ""
        begin, end = self.span
        return f"on segment {self.segment} ({begin:.3f} to {end:.3f} s), "

    @property
    def clause(self) -> str:
        """The violation in words, without the segment."""
        amount, when = f"{abs(self.amount):.3g} {self.unit}", f"at {self.time:.3f} s"
        if self.kind == "start":
            return f"joint {self.name} begins {amount} from the start of the problem"
        if self.kind in ("goal", "speed"):
            velocity = "" if self.kind == "goal" else "the velocity of "
            if self.amount < np.inf:
                return f"{self.name} ends {amount} from {velocity}the goal"
            verb = f"has {velocity}" if velocity else "is at "
            return f"the integration fails {when}, before {self.name} {verb}the goal"
        if self.kind == "arrival":
            verb = f"too {self.name}" if self.amount > 0.0 else "in time"
            return f"the goal is reached {amount} {verb}, {when}"
        if self.kind == "duration":
            longest = self.time - self.amount
            return (
                f"{self.name} takes {self.time:.3g} s, and no more than {longest:.3g} "
                "s can be replayed"
            )
        if self.kind == "clearance":
            verb = "lack" if self.amount > 0.0 else "have more than"
            return f"{self.name} {verb} {amount} of clearance {when}"
        side = "beyond" if self.amount > 0.0 else "within"
        if self.kind not in joint_kinds():
            return f"the {self.kind} is {amount} {side} its limit {when}"
        return f"joint {self.name} is {amount} {side} its {self.kind} limit {when}"


class Excesses(NamedTuple):
    """Excesses over one kind of limit along a motion.

    Attributes:
        kind: Name of the kind of limit.
        subjects: Name and unit of the subject of each column.
        t: Times [s], shape (m,).
        excess: Excesses over the limits at the times, shape (m, k).
        scale: Scale of the excesses of each subject, shape (k,).
    """

    kind: str
    subjects: Sequence[tuple[str, str]]
    t: Array
    excess: Array
    scale: Array

    @classmethod
    def of_joints(cls, robot: Robot, kind: LimitKind, *rows: Array) -> Excesses:
        """Excesses over one kind of joint limit, from times, excesses and scale."""
        joints = [*zip(robot.joint_names, units_of(robot, kind), strict=True)]
        return cls(kind.name, joints, *rows)

    def worst(self, tolerance: float) -> list[LimitViolation]:
        """The worst violation; empty where no subject has a limit.

        Args:
            tolerance: Tolerated excess, as a share of the scale.
        """
        scale, excess = self.scale, np.where(np.isnan(self.excess), np.inf, self.excess)
        # An excess over a limit whose scale is infinite or zero is not divided.
        share = excess / np.where(np.isfinite(scale) & (scale > 0.0), scale, 1.0)
        row, column = np.unravel_index(int(np.argmax(share)), share.shape)
        amount, worst = float(excess[row, column]), float(share[row, column])
        if amount == -np.inf:
            return []
        (name, unit), time = self.subjects[int(column)], float(self.t[row])
        rest = name, time, amount, unit, worst, worst > tolerance
        return [LimitViolation(self.kind, *rest)]


def limit_violations(
    problem: Problem,
    replay: Replay,
    torque: Pieces,
    tolerance: float,
    outside: Array,
) -> list[LimitViolation]:
    """The worst violation of each kind of limit along a replay.

    Torques are compared with their limits on both sides of every jump: a row of the
    replay at the end of a piece of torque stands for two rows, with the torques just
    before and just after the jump. These rows are followed by the mean torques of
    pieces so short that they have no rows inside.

    Args:
        problem: The problem, with the limits and constraints.
        replay: The motion.
        torque: Torques of the motion, as polynomials between their jumps.
        tolerance: Tolerated excess, as a share of the limits.
        outside: Accelerations just before the first row and just after the last one,
            shape (2, n): limits of jerk and torque rate hold there, too. NaN where they
            are not known.
    """
    check()
    robot = problem.robot
    limits = joint_limits(robot, problem.motion_limits)
    known = torque.t[1:] <= replay.t[-1]
    begins = np.searchsorted(replay.t, torque.t[:-1][known])
    ends: IntArray = np.searchsorted(replay.t, torque.t[1:][known])
    rows = np.sort(np.concatenate([np.arange(replay.t.size), ends]))
    before = np.append(rows[1:] == rows[:-1], False)
    t, q, v, u = (each[rows] for each in (replay.t, replay.q, replay.v, replay.u))
    # A feedback, which the torques of the replay include, does not jump.
    u[before] += torque.ends()[known, 1] - torque(t[before])
    directions, a = _directions(robot, replay, v, rows - before), np.zeros((1, 0, 0))
    dynamics = RobotDynamics(robot)
    accelerated = any(item.kind.quantity in ("a", "j") for item in limits)
    if accelerated or any(item.order > 1 for item in problem.ready_constraints):
        a = np.array([dynamics.forward_along(q, v, u, way) for way in directions])
    # Pieces of a millisecond or less have no rows inside. Torques that rise and fall
    # within them count by their means: the peaks depend more on the interpolation of a
    # motion file than on the motion.
    short = np.flatnonzero(ends - begins == 1)
    inside = 0.5 * (torque.t[short] + torque.t[short + 1])
    between = np.transpose([np.interp(inside, replay.t, x) for x in replay.v.T])
    torques = np.vstack([u, torque.means()[short]])
    speeds = np.vstack([v, between])

    def excesses(item: JointBounds) -> tuple[Array, Array]:
        """Times, and excesses over a limit, the least of all possible directions.

        Jerks are differences of the accelerations with the directions of the replay.
        """
        if item.kind.quantity == "j":
            rounding = ROUNDING * np.max(np.abs(q), axis=0)
            return _rates(t, a[0], item.upper, outside, 0.0 * directions, rounding)
        if item.kind.quantity == "du":
            both = [0, -1]
            state = q[both], v[both], u[both], directions[0, both]
            # Only accelerations jump there, not the direction of friction.
            jumps = outside - dynamics.forward_along(*state)
            beyond = u[both] + (dynamics.mass(q[both]) @ jumps[..., None])[..., 0]
            return _rates(t, u, item.upper, beyond, robot.friction * directions)
        if item.kind.quantity in ("u", "uv"):
            return np.append(t, inside), item.beyond(q, speeds, a[0], torques)
        return t, np.min([item.beyond(q, v, accel, u) for accel in a], axis=0)

    # A kind that is reported as part of another kind is merged with it: torque-speed
    # curves are part of effort limits.
    merged: dict[str, Excesses] = {}
    for item in limits:
        kind, (times, excess) = item.kind, excesses(item)
        if kind.part_of:
            whole = merged[kind.part_of]
            times, excess = np.append(whole.t, times), np.vstack([whole.excess, excess])
            merged[whole.kind] = whole._replace(t=times, excess=excess)
        else:
            row = times, excess, item.scale
            merged[kind.name] = Excesses.of_joints(robot, kind, *row)
    every = [*merged.values()]
    for constraint in problem.ready_constraints:
        sizes = np.min([constraint.sizes(t, q, v, accel) for accel in a], axis=0)
        excess = np.where(np.isfinite(sizes), sizes, np.inf) - constraint.largest
        subjects = [(constraint.subject, constraint.unit)]
        row = t, excess[:, None], np.array([constraint.scale])
        every.append(Excesses(constraint.name, subjects, *row))
    return [worst for item in every for worst in item.worst(tolerance)]


def _directions(robot: Robot, replay: Replay, v: Array, interval: IntArray) -> Array:
    """Possible directions of motion of the joints at rows, for dry friction.

    Joints of a replay stop, reverse and start a little early or late. The direction of
    a slow joint may be its direction until the next row (or since the row before, at
    the end of a piece of torque), or its direction one row earlier or later.

    Args:
        robot: The robot.
        replay: The motion.
        v: Velocities at the rows, shape (m, n).
        interval: Index of the interval between two rows of the replay to which each row
            belongs, shape (m,).

    Returns:
        The three possible directions, shape (3, m, n); zero, shape (1, m, n), without
        dry friction.
    """
    count = len(replay.way)
    if not (count and np.any(robot.friction)):
        return np.zeros((1, *v.shape))
    adjacent = np.clip(interval + np.array([[0], [-1], [1]]), 0, count - 1)
    return np.where(np.abs(v) > SLOW, np.sign(v), replay.way[adjacent])


def _rates(
    t: Array,
    values: Array,
    limit: Array,
    outside: Array,
    friction: Array,
    rounding: Array | float = 0.0,
) -> tuple[Array, Array]:
    """Excesses of jerks or torque rates; a jump counts as if it took a time step.

    The time step is the largest between two rows, a millisecond at most.

    Args:
        t: Times of the rows [s], shape (m,), with two equal times at a jump.
        values: Accelerations or torques at the rows, shape (m, n).
        limit: The largest rates, shape (n,).
        outside: Values just before the first row and just after the last one, shape
            (2, n); NaN where they are not known.
        friction: Possible torques of dry friction, shape (k, m, n): their jumps where a
            joint reverses are allowed, as no motor can follow them.
        rounding: Rounding error of the second integrals of the values, shape (n,).

    Returns:
        Times, and excesses over the limit.
    """
    outside = np.where(np.isnan(outside), values[[0, -1]], outside)
    changes = np.diff(values, axis=0, prepend=outside[:1], append=outside[1:])
    dt = np.diff(t, prepend=t[0], append=t[-1])[:, None]
    jump, step = dt == 0.0, min(TIME_STEP, np.max(dt) or TIME_STEP)
    torques = np.pad(friction, ((0, 0), (1, 1), (0, 0)), mode="edge")
    least, most = torques.min(axis=0), torques.max(axis=0)
    low = np.minimum(least[1:] - most[:-1], 0.0)
    high = np.maximum(most[1:] - least[:-1], 0.0)
    changes -= np.where(jump, np.clip(changes, low, high), 0.0)
    dt, rounding = np.where(jump, step, dt), np.where(jump, 0.0, rounding)
    rates = np.maximum(np.abs(changes) - rounding / dt**2, 0.0) / dt
    return np.append(t[:1], t), rates - limit
