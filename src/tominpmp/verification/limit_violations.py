"""Limit violations of a motion: joint, time and amount."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.dynamics import RobotDynamics
from tominpmp.kinematics import prismatic_joints
from tominpmp.motion_limits import MotionLimits
from tominpmp.problem import Problem
from tominpmp.stopping import check
from tominpmp.verification.plant import CREEP
from tominpmp.verification.polynomials import Pieces
from tominpmp.verification.replay import TIME_STEP, Replay

# Joints slower than this may stick or not, as errors of the replay have it [rad/s or
# m/s].
SLOW = 1e-5
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
        limits, replay = self.problem.robot.limits, self.replay
        width = limits.position_upper - limits.position_lower
        beyond = np.maximum(
            replay.q - limits.position_upper, limits.position_lower - replay.q
        )
        found = [
            self._worst("position", replay.t, beyond, _finite(width)),
            self._worst(
                "velocity",
                replay.t,
                np.abs(replay.v) - limits.velocity,
                _finite(limits.velocity),
            ),
            self._effort(),
        ]
        extra = self.problem.motion_limits
        if extra is not None:
            found += self._extra(extra)
        found += self._constraints()
        return [item for item in found if item is not None]

    def _constraints(self) -> list[LimitViolation | None]:
        """What the problem asks for beyond the limits of the robot."""
        rows, n = self.rows, len(self.joints)
        found: list[LimitViolation | None] = []
        for item in self.problem.ready_constraints:
            a = np.zeros((rows.t.size, 0))
            if item.order >= 2:
                x = np.concatenate([rows.q, rows.v], axis=1)
                a = RobotDynamics(self.problem.robot).forward(x, rows.u)[:, n:]
            sizes = item.sizes(rows.t, rows.q, rows.v, a)
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

    def _effort(self) -> LimitViolation | None:
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
        return self._worst("effort", rows.t, beyond, scale)

    def _extra(self, extra: MotionLimits) -> list[LimitViolation | None]:
        rows, names = self.rows, self.joints
        found: list[LimitViolation | None] = []
        top = extra.by_joint("effort_rate", names)
        if np.any(np.isfinite(top)):
            found.append(self._rate("effort rate", rows.u - self._dry(), top))
        highest = extra.by_joint("acceleration", names)
        steepest = extra.by_joint("jerk", names)
        if np.any(np.isfinite(highest)) or np.any(np.isfinite(steepest)):
            x = np.concatenate([rows.q, rows.v], axis=1)
            dynamics = RobotDynamics(self.problem.robot, dry=False)
            a = dynamics.forward(x, rows.u - self._dry())[:, len(names) :]
            beyond = np.abs(a) - highest
            found.append(self._worst("acceleration", rows.t, beyond, _finite(highest)))
            found.append(self._rate("jerk", a, steepest))
        return found

    def _dry(self) -> Array:
        """Dry friction at the rows, on the side of a jump that they are on, (m + P, n).

        Torques have jumps of it where a joint turns, which no rate of a motor can
        follow; they are left out of the rates.
        """
        friction, v = self.problem.robot.friction, self.replay.v
        if not np.any(friction):
            return np.zeros(1)
        # At an end at rest the velocity is rounding, whose sign means nothing, and the
        # torque is that just before.
        between = 0.5 * (v[1:] + v[:-1]) if len(v) > 1 else v
        way = np.where(np.abs(between) > SLOW, np.sign(between), self._way(between))
        around = np.vstack([way[:1], way, way[-1:]])
        return np.asarray(friction * np.concatenate([around[1:], around[self.ends]]))

    def _way(self, between: Array) -> Array:
        """Which way joints move between rows where they hardly do.

        Just before it stops and after it sets out a joint may stick in a replay that is
        a trace too slow, for microseconds; it is taken to move as in the rest of the
        piece of torque, in which it does not turn. Where it is as slow all the time,
        its friction is what the replay has.
        """
        out = np.tanh(between / CREEP)
        stops = np.unique(np.concatenate([[0], self.ends, [len(between)]]))
        for begin, end in itertools.pairwise(stops.tolist()):
            part = between[begin:end]
            if not len(part):
                continue
            fastest = part[np.argmax(np.abs(part), axis=0), np.arange(part.shape[1])]
            out[begin:end, np.abs(fastest) > SLOW] = np.sign(
                fastest[np.abs(fastest) > SLOW]
            )
        return out

    def _rate(self, kind: str, values: Array, limit: Array) -> LimitViolation | None:
        """Worst jerk or effort rate; a jump counts as if it took a millisecond.

        From values at the rows, shape (m + P, n), and the largest rates, shape (n,).
        """
        t = self.replay.t
        after = values[: t.size]
        before = after.copy()
        before[self.ends] = values[t.size :]
        steps = np.abs(before[1:] - after[:-1]) / np.diff(t)[:, None]
        jumps = np.abs(after - before) / TIME_STEP
        beyond = np.concatenate([steps, jumps]) - limit
        return self._worst(kind, np.concatenate([t[:-1], t]), beyond, _finite(limit))

    def _worst(
        self, kind: str, t: Array, beyond: Array, scale: Array
    ) -> LimitViolation | None:
        """The worst of amounts of shape (m, n) at times of shape (m,)."""
        beyond = np.where(np.isnan(beyond), np.inf, beyond)
        share = beyond / scale
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


def _finite(scale: Array) -> Array:
    """Measures of limits; 1 where there is none."""
    return np.where(np.isfinite(scale) & (scale > 0.0), scale, 1.0)
