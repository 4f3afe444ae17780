"""Limit violations of a motion: joint, time and amount."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.dynamics import RobotDynamics
from tominpmp.kinematics import prismatic_joints
from tominpmp.problem import Problem
from tominpmp.stopping import check
from tominpmp.verification.polynomials import Pieces
from tominpmp.verification.replay import TIME_STEP, Replay

# Joints slower than this may stop, turn or set out at another time than in a replay
# [rad/s or m/s]: a tenth of what is tolerated where they are to be at rest.
SLOW = 1e-3
# Units of the kinds, for turning and sliding joints.
UNITS = {
    "position": ("rad", "m"),
    "velocity": ("rad/s", "m/s"),
    "effort": ("N m", "N"),
    "acceleration": ("rad/s^2", "m/s^2"),
    "jerk": ("rad/s^3", "m/s^3"),
    "effort rate": ("N m/s", "N/s"),
}


@dataclass(frozen=True)
class LimitViolation:
    """The worst that a motion does to one kind of limit.

    Attributes:
        kind: "goal", "speed", "position", "velocity", "effort", "acceleration", "jerk",
            "effort rate", "feedback", "clearance", "duration", "arrival", or the name
            of a constraint.
        name: The joint, the frame, or the pair as "one and other".
        time: When [s].
        amount: How far beyond the limit, or from the goal; negative is room left.
        unit: Unit of the amount.
        share: The amount relative to the limit: for positions and efforts to the range.
            For goals and clearances the amount itself.
        violated: Whether that is more than the tolerance.
        segment: Number of the segment it is on, from 1; None where there is one only.
        span: When that segment begins and ends [s]; None where there is one only.
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
        """Say it in a clause, and on which segment."""
        return on_segment(self.segment, self.span) + self.clause

    @property
    def clause(self) -> str:
        """What there is, without the segment."""
        amount = f"{abs(self.amount):.3g} {self.unit}"
        if self.kind in ("goal", "speed") and self.amount == np.inf:
            what = "is at" if self.kind == "goal" else "has the velocity of"
            lost = f"the replay is lost at {self.time:.3f} s"
            return f"{lost}, before {self.name} {what} the goal"
        if self.kind == "goal":
            return f"{self.name} ends {amount} from the goal"
        if self.kind == "speed":
            return f"{self.name} ends {amount} from the velocity of the goal"
        if self.kind == "arrival":
            verb = f"too {self.name}" if self.amount > 0.0 else "in time"
            return f"the goal is reached {amount} {verb}, at {self.time:.3f} s"
        if self.kind == "duration":
            longest = self.time - self.amount
            return (
                f"{self.name} takes {self.time:.3g} s, and no more than {longest:.3g} "
                "s can be replayed"
            )
        if self.kind == "clearance":
            verb = "lack" if self.amount > 0.0 else "have more than"
            return f"{self.name} {verb} {amount} of clearance at {self.time:.3f} s"
        side = "beyond" if self.amount > 0.0 else "within"
        if self.kind not in UNITS and self.kind != "feedback":
            return f"the {self.kind} is {amount} {side} its limit at {self.time:.3f} s"
        return (
            f"joint {self.name} is {amount} {side} its {self.kind} limit at "
            f"{self.time:.3f} s"
        )


def on_segment(number: int | None, span: tuple[float, float] | None) -> str:
    """Begin a sentence with the segment that it is about, and when that is.

    Args:
        number: Its number, from 1; None where there is one only.
        span: When it begins and ends [s], if that is known.
    """
    if number is None:
        return ""
    when = "" if span is None else f" ({span[0]:.3f} to {span[1]:.3f} s)"
    return f"on segment {number}{when}, "


class _Rows(NamedTuple):
    """States with torques on both sides of every jump."""

    t: Array
    q: Array
    v: Array
    u: Array


def limit_violations(
    problem: Problem, replay: Replay, torque: Pieces, tolerance: float
) -> list[LimitViolation]:
    """The worst of each kind of limit on joints; the tolerance is relative."""
    check()
    return _Limits(problem, replay, torque, tolerance).all()


class _Limits:
    def __init__(
        self, problem: Problem, replay: Replay, torque: Pieces, tolerance: float
    ) -> None:
        self.problem, self.replay, self.tolerance = problem, replay, tolerance
        self.joints = problem.robot.joint_names
        self.slides = prismatic_joints(problem.robot)
        known = torque.t[1:] <= replay.t[-1]
        # Rows of the replay at which pieces of torque end.
        self.ends: IntArray = np.searchsorted(replay.t, torque.t[1:][known])
        self.before = torque.ends()[known, 1]
        self.rows = _Rows(
            np.concatenate([replay.t, replay.t[self.ends]]),
            np.concatenate([replay.q, replay.q[self.ends]]),
            np.concatenate([replay.v, replay.v[self.ends]]),
            np.concatenate([replay.u, self.before]),
        )

    def all(self) -> list[LimitViolation]:
        found = [self._worst(*row) for row in self._of_joints()]
        return [item for item in found if item is not None] + self._constraints()

    def _of_joints(self) -> Iterator[tuple[str, Array, Array, Array]]:
        """Kinds of limits on joints.

        Yields:
            Name, times of shape (m,), amounts beyond the limits of shape (m, n), and
            measures of the limits of shape (n,).
        """
        limits, replay, rows = self.problem.robot.limits, self.replay, self.rows
        low, high, top = limits.position_lower, limits.position_upper, limits.velocity
        beyond = np.maximum(replay.q - high, low - replay.q)
        yield "position", replay.t, beyond, high - low
        yield "velocity", replay.t, np.abs(replay.v) - top, top
        yield "effort", rows.t, *self._effort()
        extra = self.problem.motion_limits
        if extra is None:
            return
        kinds = "effort_rate", "acceleration", "jerk"
        rate, highest, steepest = (extra.by_joint(kind, self.joints) for kind in kinds)
        if np.any(np.isfinite(rate)):
            dry = self.problem.robot.friction * self.ways
            yield "effort rate", *self._rates(rows.u, rate, dry), rate
        if np.any(np.isfinite([highest, steepest])):
            a = self.accelerations
            yield "acceleration", rows.t, np.min(np.abs(a), axis=0) - highest, highest
            yield "jerk", *self._rates(a[0], steepest), steepest

    def _constraints(self) -> list[LimitViolation]:
        """What the problem asks for beyond the limits of the robot."""
        rows = self.rows
        found: list[LimitViolation] = []
        for item in self.problem.ready_constraints:
            every = self.accelerations
            if item.order < 2:
                every = np.zeros((1, rows.t.size, 0))
            sizes = np.min(
                [item.sizes(rows.t, rows.q, rows.v, a) for a in every], axis=0
            )
            sizes = np.where(np.isfinite(sizes), sizes, np.inf)
            k = int(np.argmax(sizes))
            amount = float(sizes[k]) - item.largest
            share = amount / item.scale
            found.append(
                LimitViolation(
                    item.name,
                    item.subject,
                    float(rows.t[k]),
                    amount,
                    item.unit,
                    share,
                    share > self.tolerance,
                )
            )
        return found

    def _effort(self) -> tuple[Array, Array]:
        """Amounts beyond the limits of torque, and measures of these."""
        limits, rows = self.problem.robot.limits, self.rows
        middle = 0.5 * (limits.effort_upper + limits.effort_lower)
        half = 0.5 * (limits.effort_upper - limits.effort_lower)
        extra = self.problem.motion_limits
        share = 1.0 if extra is None else extra.effort_scale
        beyond = np.abs(rows.u - middle) - share * half
        curves = {} if extra is None else (extra.effort_curves or {})
        for joint, curve in curves.items():
            i = self.joints.index(joint)
            excess = np.abs(rows.u[:, i]) - curve(rows.v[:, i])[0]
            beyond[:, i] = np.maximum(beyond[:, i], excess)
        # Against a joint without a motor, the strongest one is the measure.
        scale = np.where(half > 0.0, half, np.max(half, initial=1e-12))
        return beyond, scale

    @cached_property
    def ways(self) -> Array:
        """Which way joints go at the rows, as far as can be told.

        A replay that is off by a trace stops, turns and sets out a trace early or late.
        Slow joints may go as they do in the time to the next row, or from the last one
        where a torque ends, or as in those beside it.

        Returns:
            These three, shape (3, m + P, n).
        """
        count, v = len(self.replay.way), self.rows.v
        if not (count and np.any(self.problem.robot.friction)):
            return np.zeros((1, *v.shape))
        own = np.concatenate([np.arange(count + 1), self.ends - 1])
        beside = np.clip(own + np.array([[0], [-1], [1]]), 0, count - 1)
        return np.where(np.abs(v) > SLOW, np.sign(v), self.replay.way[beside])

    @cached_property
    def accelerations(self) -> Array:
        """Accelerations at the rows if joints go these ways, shape (3, m + P, n)."""
        dynamics, rows = RobotDynamics(self.problem.robot), self.rows
        state = rows.q, rows.v, rows.u
        return np.array([dynamics.forward_along(*state, way) for way in self.ways])

    def _rates(
        self, values: Array, limit: Array, own: Array | None = None
    ) -> tuple[Array, Array]:
        """Jerks or effort rates; a jump counts as if it took a millisecond.

        Args:
            values: At the rows, shape (m + P, n).
            limit: The largest rates, shape (n,).
            own: Values whose jumps are no fault: of dry friction where a joint turns,
                which no rate of a motor can follow. Shape (k, m + P, n).

        Returns:
            Times, and amounts beyond the limit.
        """
        t = self.replay.t
        before, after = self._sides(values)
        steps = np.abs(before[1:] - after[:-1]) / np.diff(t)[:, None]
        jumps = after - before
        if own is not None:
            (low, later), (high, latest) = map(self._sides, (own.min(0), own.max(0)))
            jumps -= np.clip(
                jumps, np.minimum(later - high, 0.0), np.maximum(latest - low, 0.0)
            )
        beyond = np.concatenate([steps, np.abs(jumps) / TIME_STEP]) - limit
        return np.concatenate([t[:-1], t]), beyond

    def _sides(self, values: Array) -> tuple[Array, Array]:
        """Values just before and just after the times of the replay, (m, n) each."""
        after = values[: self.replay.t.size]
        before = after.copy()
        before[self.ends] = values[after.shape[0] :]
        return before, after

    def _worst(
        self, kind: str, t: Array, beyond: Array, scale: Array
    ) -> LimitViolation | None:
        """The worst of amounts of shape (m, n) at times of shape (m,)."""
        beyond = np.where(np.isnan(beyond), np.inf, beyond)
        # A limit that is infinite or zero is measured by 1.
        share = beyond / np.where(np.isfinite(scale) & (scale > 0.0), scale, 1.0)
        row, joint = np.unravel_index(int(np.argmax(share)), share.shape)
        amount = float(beyond[row, joint])
        if amount == -np.inf:
            return None  # nothing is limited
        return LimitViolation(
            kind,
            self.joints[int(joint)],
            float(t[row]),
            amount,
            UNITS[kind][int(self.slides[joint])],
            float(share[row, joint]),
            bool(share[row, joint] > self.tolerance),
        )
