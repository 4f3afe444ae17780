"""Torque limits; torque limits over the speed; torque rates.

These are the paper's limits on controls, equation 3, and its section 4 for limits that
depend on the state, and on the rates of controls.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.constraints.base import (
    Constraint,
    Partials,
    States,
    both_instants,
    slope_partials,
)
from tominpmp.constraints.friction import Ways, signs
from tominpmp.dynamics import Dynamics
from tominpmp.motion_limits import SIDES, LimitKind


@dataclass(frozen=True, eq=False)
class Motors:
    """Torques of motors as shares of their limits.

    Attributes:
        dynamics: Equations of motion without dry friction.
        middle: Middle of the torque ranges, shape (n,) [N m or N].
        half: Half of the torque ranges, shape (n,).
        friction: Dry friction as shares of the limits, shape (n,); None without
            friction.
        ways: Directions of joints with friction at the instants; None before they were
            taken from a motion.
    """

    dynamics: Dynamics
    middle: Array
    half: Array
    friction: Array | None = None
    ways: Ways | None = None

    def torque(self, states: States) -> Array:
        """Torques less dry friction, shape (m, n) [N m or N]."""
        if states.u is not None:
            return states.u
        return self.dynamics.inverse(states.q, states.v, states.a)

    def shares(self, states: States) -> Array:
        """Torques less dry friction, as shares of the limits."""
        return np.asarray((self.torque(states) - self.middle) / self.half)

    def loads(self, states: States) -> Array:
        """Torques of the motors as shares of their limits, with dry friction."""
        share = self.shares(states)
        return share if self.ways is None else share + self.ways.load

    def differentiate(self, states: States, at: IntArray, joint: IntArray) -> Partials:
        """Partial derivatives of some of the shares."""
        scale = self.half[joint, None]
        if states.u is not None:
            by_u = np.zeros((at.size, self.half.size))
            by_u[np.arange(at.size), joint] = 1.0
            return Partials(at, by_u=by_u / scale)
        instants, place = np.unique(at, return_inverse=True)
        motion = (part[instants] for part in (states.q, states.v, states.a))
        by = self.dynamics.inverse_jacobians(*motion)
        by_q, by_v, by_a = (
            part[place, joint] / scale for part in (by.tau_q, by.tau_v, by.tau_a)
        )
        return Partials(at, by_q, by_v, by_a)


@dataclass(frozen=True, eq=False)
class MotorLimit(Constraint):
    """Base of constraints on torques: the handling of dry friction.

    Attributes:
        motors: The torques.
        kind: The kind of limit: of torques, or of a kinematic robot's accelerations.
    """

    motors: Motors
    kind: LimitKind

    order = 2
    curable = True

    @property
    def name(self) -> str:
        """Name of the kind of limit, of torques."""
        return self.kind.name.replace("effort", "torque")

    @property
    @abstractmethod
    def of_joints(self) -> IntArray:
        """Joint of each value, shape (count,)."""

    @property
    def count(self) -> int:
        """One value for each of these joints."""
        return int(self.of_joints.size)

    @property
    def assumes(self) -> bool:
        """Whether directions of joints with dry friction are assumed."""
        return self.motors.friction is not None

    @property
    def informed(self) -> bool:
        """Whether the directions are set."""
        return not self.assumes or self.motors.ways is not None

    @property
    def usable(self) -> Array:
        """Zero: torques and rates may not exceed their limits between the instants."""
        return np.zeros(self.count)

    def assumed(self, states: States, beside: Array) -> MotorLimit:
        """The constraint with directions of joints with dry friction in a motion."""
        return self if not self.assumes else self.along(signs(states.v, beside))

    def along(self, sign: Array) -> MotorLimit:
        """The constraint with given directions of joints with dry friction.

        Args:
            sign: The directions at its instants: 1, -1, or 0 at rest, shape (m, n).
        """
        friction = self.motors.friction
        return self if friction is None else self._moving(Ways.of(friction, sign))

    def corrected(
        self, states: States, beside: Array, tolerance: float
    ) -> tuple[MotorLimit, int]:
        """The constraint with the directions in another motion, where they matter."""
        ways = self.assumed(states, beside).motors.ways
        if ways is None:
            return self, 0
        sign, known = ways.sign, self.motors.ways or ways
        wrong = known.wrong(sign, self.motors.shares(states), tolerance)
        return self._moving(known.turned(sign, wrong)), int(wrong.sum())

    def joined(self, other: Constraint) -> MotorLimit:
        """The constraint at these instants and at those of another."""
        assert isinstance(other, MotorLimit)  # noqa: S101
        own, more = self.motors.ways, other.motors.ways
        if own is None or more is None:
            return self._moving(None)
        return self._moving(own.joined(more))

    def _moving(self, ways: Ways | None) -> MotorLimit:
        """The constraint with given directions of joints with dry friction."""
        return replace(self, motors=replace(self.motors, ways=ways))


@dataclass(frozen=True, eq=False)
class TorqueLimit(MotorLimit):
    """Torques within their limits, as shares of them: u_l <= u <= u_u (3)."""

    field = "u"

    @property
    def of_joints(self) -> IntArray:
        """All joints."""
        return np.arange(self.motors.half.size)

    def bounds(self, instants: int) -> tuple[Array, Array]:
        """Bounds of -1 and 1; tighter where a joint with dry friction reverses."""
        most = np.ones((instants, self.count))
        if self.motors.ways is not None:
            most = self.motors.ways.bound
        return -most, most

    def evaluate(self, states: States, attention: float = np.inf) -> Array:
        """Shares of the limits."""
        return self.motors.loads(states)

    def differentiate(self, states: States, at: IntArray, which: IntArray) -> Partials:
        """Derivatives of the inverse dynamics."""
        return self.motors.differentiate(states, at, which)


@dataclass(frozen=True, eq=False)
class TorqueOverSpeed(MotorLimit):
    """Torques within bounds that depend on the speed, as shares of the bounds.

    Attributes:
        by_speed: The bounds, by the index of the joint.
    """

    by_speed: Mapping[int, Any]

    @property
    def of_joints(self) -> IntArray:
        """The joints with a bound, for the upper sides and for the lower ones."""
        return np.tile([*self.by_speed], len(SIDES))

    def _excess(self, states: States) -> Iterator[tuple[int, Array, Array, Array]]:
        """Values one after the other, and their derivatives by share and speed."""
        motors = self.motors
        loads = motors.loads(states) + motors.middle / motors.half
        for side in SIDES:
            for joint, bound in self.by_speed.items():
                half = float(motors.half[joint])
                unit, load, v = self.kind.scale(bound, half), loads[:, joint], states.v
                found = self.kind.excess(bound, half * load, v[:, joint], side)
                value, by_u, by_v = (part / unit for part in found)
                if motors.ways is not None:
                    reserve = 1.0 - motors.ways.bound[:, joint]
                    value = value + np.abs(half * by_u) * reserve
                yield joint, value, half * by_u, by_v

    def evaluate(self, states: States, attention: float = np.inf) -> Array:
        """Excess of the torques over the bounds."""
        return np.stack([value for _, value, *_ in self._excess(states)], axis=1)

    def differentiate(self, states: States, at: IntArray, which: IntArray) -> Partials:
        """Derivatives of torques and bounds."""
        joints, _, by_share, by_speed = zip(*self._excess(states), strict=True)
        joint = np.array(joints)[which]
        by = self.motors.differentiate(states, at, joint)
        by = by.times(np.array(by_share)[which, at, None])
        slope = np.zeros((at.size, states.v.shape[1]))
        slope[np.arange(at.size), joint] = np.array(by_speed)[which, at]
        return by._replace(by_v=slope if by.by_v is None else by.by_v + slope)


@dataclass(frozen=True, eq=False)
class TorqueRate(MotorLimit):
    """Torque rates between pairs of instants, for motions whose torques do not jump.

    Its instants come in pairs of one interval.

    Attributes:
        joints: Joints that have a limit, shape (k,).
        limit: Their limits, shape (k,) [N m/s or N/s].
    """

    joints: IntArray
    limit: Array

    order = 3

    @property
    def of_joints(self) -> IntArray:
        """The joints that have a limit."""
        return self.joints

    def bounds(self, instants: int) -> tuple[Array, Array]:
        """Bounds of -1 and 1."""
        ones = np.ones((instants // 2, self.count))
        return -ones, ones

    def evaluate(self, states: States, attention: float = np.inf) -> Array:
        """Rates as shares of their limits, shape (m / 2, k).

        Jumps of dry friction are left out, as no motor can follow them.
        """
        tau = self.motors.torque(states)[:, self.joints]
        span = np.diff(states.t)[::2, None]
        return np.asarray((tau[1::2] - tau[::2]) / (span * self.limit))

    def differentiate(self, states: States, at: IntArray, which: IntArray) -> Partials:
        """Derivatives at both instants of each pair, and by their times."""
        joint = np.tile(self.joints[which], 2)
        by = self.motors.differentiate(states, both_instants(at), joint)
        by = by.times(
            self.motors.half[joint, None] / np.tile(self.limit[which], 2)[:, None]
        )
        return slope_partials(by, states.t, at, self.evaluate(states)[at, which])
