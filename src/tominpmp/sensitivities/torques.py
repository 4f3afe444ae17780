"""Sensitivities to torques, and to parameters that change the torques of a motion.

The multipliers of torque limits, of torque-rate limits and of torque-speed curves give
the share of the duration by which an additional torque at an instant delays the motion.
Gravity, payloads and friction change the torques that the same motion requires: the
inverse dynamics is linear in each of these parameters, so that differences of torques
give their derivatives without a truncation error.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tominpmp.arrays import Array
from tominpmp.certificate.limits import (
    PASSIVE,
    LimitRows,
    SampledConstraint,
    limits_of_joints,
)
from tominpmp.certificate.motion import GridMotion
from tominpmp.constraints.torque import MotorLimit, TorqueLimit
from tominpmp.dynamics import RobotDynamics
from tominpmp.robot.robot import Robot


@dataclass(frozen=True, eq=False)
class TorqueWeights:
    """Cost of a unit of torque at instants, as a share of the duration.

    Attributes:
        q: Positions at the instants, shape (k, n).
        v: Velocities at the instants, shape (k, n).
        a: Accelerations at the instants, shape (k, n).
        way: Directions of motion of the joints: 1, -1, or 0 at rest, shape (k, n).
        weight: Derivative of ln T with respect to the torque of each joint, shape
            (k, n).
    """

    q: Array
    v: Array
    a: Array
    way: Array
    weight: Array

    @classmethod
    def of(cls, motion: GridMotion, limits: LimitRows) -> TorqueWeights:
        """Weights from the multipliers of torques on a segment of a motion.

        Args:
            motion: The motion on the segment.
            limits: The limits of the segment, with their multipliers.
        """
        n = motion.changes.n
        every = [tuple(np.zeros((5, 0, n)))]
        for item in limits_of_joints(motion):
            kinds = (item.kind.name, PASSIVE)[: 1 + isinstance(item, TorqueLimit)]
            rows = limits.selected(limits.of(*kinds) & (limits.y != 0.0))
            if not isinstance(item, MotorLimit) or not rows.y.size:
                continue
            slopes = item.order > 2
            at = motion.changes.pairs(rows.at.interval) if slopes else rows.at
            sampled = SampledConstraint.of(motion, item, at)
            # Differentiated as a function of the torques minus dry friction.
            _, q, v, a, _ = sampled.states
            states = sampled.states._replace(u=motion.system.dynamics.inverse(q, v, a))
            each = np.arange(rows.y.size), rows.component
            by = sampled.item.differentiate(states, *each)
            assert by.by_u is not None  # noqa: S101
            weight = np.zeros((at.size, n))
            multiplier = rows.y if by.row is None else rows.y[by.row]
            np.add.at(weight, by.at, multiplier[:, None] * by.by_u)
            every.append((q, v, a, motion.ways(at), weight))
        return cls(*map(np.concatenate, zip(*every, strict=True)))

    def cost(self, robot: Robot) -> float:
        """Change of ln T by all torques that a changed robot needs for the motion."""
        torque = RobotDynamics(robot, dry=False).inverse(self.q, self.v, self.a)
        return float(np.sum(self.weight * torque))
