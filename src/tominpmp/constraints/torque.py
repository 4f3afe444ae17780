"""Torque limits, also at rest or depending on speed, and limits of torque rates.

These are the paper's limits on the controls (equation 3), on controls as functions of
the state, and on the rates of controls (section 4).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tominpmp.arrays import Array, BoolArray, IntArray
from tominpmp.constraints.base import Constraint, LimitOfJoints, Partials, States
from tominpmp.constraints.friction import Signs, velocity_signs
from tominpmp.dynamics import Dynamics
from tominpmp.motion_limits import HOLDING, SIDES


@dataclass(frozen=True, eq=False)
class Motors:
    """Functions of the motor torques, as shares of the torque limits.

    Attributes:
        dynamics: Equations of motion without dry friction.
        middle: Middle of the torque ranges, shape (n,) [N m or N].
        half: Half of the torque ranges, shape (n,).
        friction: Dry friction as shares of the limits, shape (n,); None without
            friction.
        signs: Velocity signs of joints with friction at the instants; None before they
            are taken from a motion.
    """

    dynamics: Dynamics
    middle: Array
    half: Array
    friction: Array | None = None
    signs: Signs | None = None

    def torque(self, states: States) -> Array:
        """Torques less dry friction, shape (m, n) [N m or N]."""
        if states.u is not None:
            return states.u
        return self.dynamics.inverse(states.q, states.v, states.a)

    def shares(self, states: States) -> Array:
        """Torques less dry friction, as shares of the limits."""
        return np.asarray((self.torque(states) - self.middle) / self.half)

    def loads(self, states: States) -> Array:
        """Motor torques including dry friction, as shares of their limits."""
        share = self.shares(states)
        return share if self.signs is None else share + self.signs.load

    def differentiate(self, states: States, at: IntArray, joint: IntArray) -> Partials:
        """Partial derivatives of some of the torque shares.

        Args:
            states: The states at m instants.
            at: Index of the instant of each share, shape (k,).
            joint: Index of the joint of each share, shape (k,).
        """
        scale = self.half[joint, None]
        if states.u is not None:
            return Partials(at, by_u=np.eye(self.half.size)[joint] / scale)
        instants, place = np.unique(at, return_inverse=True)
        motion = (part[instants] for part in (states.q, states.v, states.a))
        by = self.dynamics.inverse_jacobians(*motion)
        slopes = by.tau_q, by.tau_v, by.tau_a
        by_q, by_v, by_a = (part[place, joint] / scale for part in slopes)
        return Partials(at, by_q, by_v, by_a)


@dataclass(frozen=True, eq=False)
class MotorLimit(LimitOfJoints):
    """Base class of constraints on torques, which handles dry friction.

    The controls of kinematic robots are accelerations in place of torques.

    Attributes:
        motors: Functions of the torques.
    """

    motors: Motors

    order = 2

    @property
    def assumes(self) -> bool:
        """Whether velocity signs of joints with dry friction are assumed."""
        return self.motors.friction is not None

    @property
    def usable(self) -> Array:
        """Zero: torques and rates may not exceed their limits between the instants."""
        return np.zeros(self.count)

    def assumed(self, states: States, beside: Array) -> MotorLimit:
        """The constraint with the velocity signs of a motion at given instants.

        Args:
            states: The states at these instants.
            beside: Velocities near these instants, shape (m, n).
        """
        return self.along(velocity_signs(states.v, beside))

    def along(self, sign: Array) -> MotorLimit:
        """The constraint with given velocity signs.

        Args:
            sign: Signs at the instants of the constraint: 1, -1, or 0 at rest, shape
                (m, n).
        """
        friction = self.motors.friction
        return self if friction is None else self._with(Signs.of(friction, sign))

    def corrected(
        self, states: States, beside: Array, tolerance: float
    ) -> tuple[MotorLimit, int]:
        """The constraint with the signs of another motion, where they matter.

        Args:
            states: The states of the motion at the instants of the constraint.
            beside: Velocities near the instants, shape (m, n).
            tolerance: Tolerated relative excess.

        Returns:
            The constraint, and the number of signs that changed.
        """
        signs = self.assumed(states, beside).motors.signs
        if signs is None:
            return self, 0
        sign, known = signs.sign, self.motors.signs or signs
        wrong = known.wrong(sign, self.motors.shares(states), tolerance)
        return self._with(known.corrected(sign, wrong)), int(wrong.sum())

    def joined(self, other: Constraint) -> MotorLimit:
        """The constraint at its instants, followed by the instants of another."""
        assert isinstance(other, MotorLimit)  # noqa: S101
        own, more = self.motors.signs, other.motors.signs
        if own is None or more is None:
            return self._with(None)
        return self._with(own.joined(more))

    def _with(self, signs: Signs | None) -> MotorLimit:
        """The constraint with given assumptions about velocity signs."""
        return replace(self, motors=replace(self.motors, signs=signs))


@dataclass(frozen=True, eq=False)
class TorqueLimit(MotorLimit):
    """Torques of all joints as shares of their limits, u_l <= u <= u_u.

    These are the limits of the paper's equation 3.
    """

    field = "u"

    def bounds(self, instants: int) -> tuple[Array, Array]:
        """Bounds -1 and 1; tighter where a joint with dry friction reverses."""
        most = np.ones((instants, self.count))
        if self.motors.signs is not None:
            most = self.motors.signs.bound
        return -most, most

    def evaluate(self, states: States, attention: float = np.inf) -> Array:
        """Motor torques as shares of their limits, shape (m, n)."""
        return self.motors.loads(states)

    def differentiate(self, states: States, at: IntArray, which: IntArray) -> Partials:
        """Derivatives of the inverse dynamics."""
        return self.motors.differentiate(states, at, which)


@dataclass(frozen=True, eq=False)
class HeldAtRest(Constraint):
    """Torques that hold the arm at rest, as shares of their limits.

    A goal on a frame leaves the final configuration open, and the torques that brake
    the arm there may be within limits that those against gravity alone exceed.

    Attributes:
        motors: Functions of the torques, without dry friction.
        driven: Whether each joint has a motor, shape (n,).
    """

    motors: Motors
    driven: BoolArray

    name = HOLDING.name

    @property
    def count(self) -> int:
        """Number of joints."""
        return int(self.driven.size)

    def bounds(self, instants: int) -> tuple[Array, Array]:
        """Bounds -1 and 1; zero for joints without a motor."""
        most = np.tile(self.driven.astype(float), (instants, 1))
        return -most, most

    def _resting(self, states: States) -> States:
        """States at rest in the same configurations."""
        rest = np.zeros_like(states.q)
        return states._replace(v=rest, a=rest, u=None)

    def evaluate(self, states: States, attention: float = np.inf) -> Array:
        """Torques at rest as shares of their limits, shape (m, n)."""
        return self.motors.shares(self._resting(states))

    def differentiate(self, states: States, at: IntArray, which: IntArray) -> Partials:
        """Derivatives by the configuration."""
        by = self.motors.differentiate(self._resting(states), at, which)
        return Partials(at, by.by_q)


@dataclass(frozen=True, eq=False)
class TorqueOverSpeed(MotorLimit):
    """Torques within bounds that depend on the speed, as shares of the bounds.

    The values belong to the upper side of the bounds first, then to the lower side.

    Attributes:
        by_speed: Speed-dependent bound of each limited joint, by its index.
    """

    by_speed: Mapping[int, Any]

    def _excess(self, states: States) -> Iterator[tuple[int, Array, Array, Array]]:
        """Joint, value, and derivatives by torque share and speed, value by value."""
        motors = self.motors
        loads = motors.loads(states) + motors.middle / motors.half
        for side in SIDES:
            for joint, bound in self.by_speed.items():
                half = float(motors.half[joint])
                unit, load, v = self.kind.scale(bound, half), loads[:, joint], states.v
                found = self.kind.excess(bound, half * load, v[:, joint], side)
                value, by_u, by_v = (part / unit for part in found)
                if motors.signs is not None:
                    reserve = 1.0 - motors.signs.bound[:, joint]
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
        by = by.times(np.array(by_share)[which, at])
        slope = np.zeros((at.size, states.v.shape[1]))
        slope[np.arange(at.size), joint] = np.array(by_speed)[which, at]
        return by._replace(by_v=slope if by.by_v is None else by.by_v + slope)


@dataclass(frozen=True, eq=False)
class TorqueRate(MotorLimit):
    """Torque rates between pairs of instants, for motions with continuous torques.

    Both instants of each pair are in the same interval.

    Attributes:
        limit: Limit of each joint with a limit, shape (count,) [N m/s or N/s].
    """

    limit: Array

    order = 3
    assumes = False  # jumps of dry friction are left out

    def bounds(self, instants: int) -> tuple[Array, Array]:
        """Bounds -1 and 1 for each pair of instants."""
        ones = np.ones((instants // 2, self.count))
        return -ones, ones

    def evaluate(self, states: States, attention: float = np.inf) -> Array:
        """Rates as shares of their limits, shape (m / 2, k).

        Jumps of dry friction are left out, as no motor can follow them.
        """
        tau = self.motors.torque(states)[:, self.of_joints]
        span = np.diff(states.t)[::2, None]
        return np.asarray((tau[1::2] - tau[::2]) / (span * self.limit))

    def differentiate(self, states: States, at: IntArray, which: IntArray) -> Partials:
        """Derivatives at both instants of each pair, and by their times."""
        joint = np.tile(self.of_joints[which], 2)
        by = self.motors.differentiate(states, Partials.both_instants(at), joint)
        share = self.motors.half[joint] / np.tile(self.limit[which], 2)
        by = by.times(share)
        return by.slopes(states.t, at, self.evaluate(states)[at, which])
