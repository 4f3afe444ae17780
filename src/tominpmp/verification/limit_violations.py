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
        kind: "goal", "speed", "position", "velocity", "effort", "acceleration", "jerk",
            "effort rate", "feedback", "clearance", "duration", "arrival", or the name
            of a constraint.
        name: Name of the joint, of the frame, of the pair ("link and obstacle"), or of
            the subject of a constraint; "late" or "early" for arrivals, "the motion"
            for durations, and "the arm" for goals before which a replay is lost.
        time: Time of the violation [s].
        amount: Excess over the limit, or distance from the goal, infinite for a lost
            replay; negative for slack.
        unit: Unit of the amount.
        share: The amount relative to the limit, for positions and efforts relative to
            the range of the limits; for goals, clearances and arrivals the amount
            itself.
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
        if self.kind in ("goal", "speed"):
            velocity = "" if self.kind == "goal" else "the velocity of "
            if self.amount < np.inf:
                return f"{self.name} ends {amount} from {velocity}the goal"
            verb = f"has {velocity}" if velocity else "is at "
            return f"the replay is lost {when}, before {self.name} {verb}the goal"
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

    Torques are compared with their limits on both sides of every jump: the rows of the
    replay, which hold the values just after a jump, are followed by rows with the
    values just before each jump, and these by the mean torques of pieces so short that
    they have no rows inside.

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
    # Rows of the replay at the ends of the pieces of torque.
    ends: IntArray = np.searchsorted(replay.t, torque.t[1:][known])
    rows: IntArray = np.concatenate([np.arange(replay.t.size), ends])
    t, q, v = replay.t[rows], replay.q[rows], replay.v[rows]
    u = np.concatenate([replay.u, torque.ends()[known, 1]])
    directions, a = _directions(robot, replay, v, ends), np.zeros((1, 0, 0))
    dynamics = RobotDynamics(robot)
    accelerated = any(item.kind.quantity in ("a", "j") for item in limits)
    if accelerated or any(item.order > 1 for item in problem.ready_constraints):
        a = np.array([dynamics.forward_along(q, v, u, way) for way in directions])
    # Pieces of a millisecond or less have no rows inside. Torques that rise and fall
    # within them count by their means: the peaks depend more on the interpolation of a
    # motion file than on the motion.
    begins = np.searchsorted(replay.t, torque.t[:-1][known])
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
            return _rates(replay.t, ends, a[0], item.upper, outside, rounding=rounding)
        if item.kind.quantity == "du":
            both = [0, replay.t.size - 1]
            state = q[both], v[both], u[both], directions[0, both]
            # Only accelerations jump there, not the direction of friction.
            jumps = outside - dynamics.forward_along(*state)
            beyond = u[both] + (dynamics.mass(q[both]) @ jumps[..., None])[..., 0]
            friction = robot.friction * directions
            return _rates(replay.t, ends, u, item.upper, beyond, friction)
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


def _directions(robot: Robot, replay: Replay, v: Array, ends: IntArray) -> Array:
    """Possible directions of motion of the joints at the rows, for dry friction.

    Joints of a replay stop, reverse and start a little early or late. The direction of
    a slow joint may be its direction until the next row (or since the row before, at
    the end of a piece of torque), or its direction one row earlier or later.

    Returns:
        The three possible directions, shape (3, m + P, n); zero, shape (1, m + P, n),
        without dry friction.
    """
    count = len(replay.way)
    if not (count and np.any(robot.friction)):
        return np.zeros((1, *v.shape))
    rows = np.concatenate([np.arange(count + 1), ends - 1])
    adjacent = np.clip(rows + np.array([[0], [-1], [1]]), 0, count - 1)
    return np.where(np.abs(v) > SLOW, np.sign(v), replay.way[adjacent])


def _rates(
    t: Array,
    ends: IntArray,
    values: Array,
    limit: Array,
    outside: Array,
    friction: Array | None = None,
    rounding: Array | float = 0.0,
) -> tuple[Array, Array]:
    """Excesses of jerks or torque rates; a jump counts as if it took a time step.

    The time step is the largest between two rows, a millisecond at most.

    Args:
        t: Times of the replay [s], shape (m,).
        ends: Indices of the times at which the values may jump, shape (P,).
        values: Accelerations or torques at the rows, shape (m + P, n).
        limit: The largest rates, shape (n,).
        outside: Values just before the first row and just after the last one, shape
            (2, n); NaN where they are not known.
        friction: Possible torques of dry friction, shape (k, m + P, n): their jumps
            where a joint reverses are allowed, as no motor can follow them.
        rounding: Rounding error of the second integrals of the values, shape (n,).

    Returns:
        Times, and excesses over the limit.
    """

    def sides(values: Array) -> tuple[Array, Array]:
        before, after = values[: t.size].copy(), values[: t.size].copy()
        before[ends] = values[t.size :]
        return before, after

    before, after = sides(values)
    before[0] = np.where(np.isnan(outside[0]), before[0], outside[0])
    after[-1] = np.where(np.isnan(outside[1]), after[-1], outside[1])
    dt = np.diff(t)[:, None]
    step = min(TIME_STEP, np.max(dt, initial=0.0) or TIME_STEP)
    steps = np.maximum(np.abs(before[1:] - after[:-1]) - rounding / dt**2, 0.0) / dt
    jumps = after - before
    if friction is not None:
        (low, later), (high, latest) = map(sides, (friction.min(0), friction.max(0)))
        jumps -= np.clip(
            jumps, np.minimum(later - high, 0.0), np.maximum(latest - low, 0.0)
        )
    excess = np.concatenate([steps, np.abs(jumps) / step]) - limit
    return np.concatenate([t[:-1], t]), excess
