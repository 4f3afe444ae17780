"""An arm with one joint: what bounds its acceleration, and its least time."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array
from tominpmp.bounds.inertia import effort_bounds, inertia_at
from tominpmp.bounds.speed_changes import AccelerationLimit
from tominpmp.kinematics import prismatic_joints
from tominpmp.motion_limits import EffortCurve
from tominpmp.problem import Problem


@dataclass(frozen=True, eq=False)
class OneJoint:
    """Equation of motion and limits of an arm with one joint.

    Its inertia does not change, and gravity acts on it by a constant force or by a
    sine of the angle.

    Attributes:
        mass: Inertia [kg m^2 or kg].
        damping: Viscous friction.
        friction: Dry friction [N m or N].
        weight: Constant part of the torque that gravity needs, and its parts with the
            cosine and the sine of the angle.
        effort: Least and largest torque.
        curve: Torque over speed, if it is limited.
        position: Least and largest position.
        velocity: Speed limit.
        acceleration: Acceleration limit.
        jerk: Jerk limit.
        effort_rate: Limit of the torque rate.
    """

    mass: float
    damping: float
    friction: float
    weight: tuple[float, float, float]
    effort: tuple[float, float]
    curve: EffortCurve | None
    position: tuple[float, float]
    velocity: float
    acceleration: float
    jerk: float
    effort_rate: float

    @classmethod
    def of(cls, problem: Problem) -> OneJoint | None:
        """The arm of a problem, if it has one joint; None for others."""
        robot, model = problem.robot, problem.robot.model
        if robot.n != 1 or model.nv != 1 or robot.expansion_matrix is not None:
            return None
        mass = float(inertia_at(robot, np.zeros((1, 1)))[0, 0, 0])
        data, zero = model.createData(), np.zeros(1)
        held = [
            float(pin.rnea(model, data, np.array([q]), zero, zero)[0])
            for q in (0.0, 0.5 * math.pi, math.pi)
        ]
        weight = held[0], 0.0, 0.0
        if not prismatic_joints(robot)[0]:
            mean = 0.5 * (held[0] + held[2])
            weight = mean, held[0] - mean, held[1] - mean
        lower, upper = effort_bounds(robot, problem.motion_limits)
        limits, more = robot.limits, problem.motion_limits
        extra = [math.inf] * 3
        curve = None
        if more is not None:
            names = ("acceleration", "jerk", "effort_rate")
            extra = [float(more.by_joint(k, robot.joint_names)[0]) for k in names]
            curve = (more.effort_curves or {}).get(robot.joint_names[0])
        return cls(
            mass,
            float(robot.damping[0]),
            float(robot.friction[0]),
            weight,
            (float(lower[0]), float(upper[0])),
            curve,
            (float(limits.position_lower[0]), float(limits.position_upper[0])),
            float(limits.velocity[0]),
            *extra,
        )

    @property
    def uniform(self) -> bool:
        """Whether gravity acts alike wherever the joint is."""
        scale = max(abs(x) for x in (*self.effort, *self.weight))
        return max(abs(self.weight[1]), abs(self.weight[2])) <= 1e-12 * scale

    @property
    def strongest(self) -> float:
        """Bound on all accelerations at rest."""
        torque = max(map(abs, self.effort)) + sum(map(abs, self.weight))
        return min((torque + self.friction) / self.mass, self.acceleration)

    def torque(self, v: Array, sign: float) -> Array:
        """Largest torque at speeds, or the least for the sign -1."""
        lower, upper = self.effort
        flat = np.full(np.shape(v), upper if sign > 0.0 else lower)
        if self.curve is None:
            return flat
        most = self.curve(v)[0]
        if sign > 0.0:
            return np.asarray(np.minimum(flat, most))
        return np.asarray(np.maximum(flat, -most))

    def limit(self, sign: float) -> AccelerationLimit:
        """Largest acceleration over the speed in uniform gravity, or the least."""

        def sides(v: float, side: float) -> float:
            way = math.copysign(1.0, v) if v != 0.0 else side
            load = self.damping * v + self.friction * way + self.weight[0]
            a = (float(self.torque(np.array(v), sign)) - load) / self.mass
            most = sign * self.acceleration
            return min(a, most) if sign > 0.0 else max(a, most)

        return AccelerationLimit.of(sides, self._knots(sign))

    def _knots(self, sign: float) -> Array:
        """Speeds at which the largest acceleration changes its slope."""
        speeds = [0.0]
        flat = self.effort[1] if sign > 0.0 else -self.effort[0]
        lines = [(flat, 0.0)]
        if self.curve is not None:
            s, e = self.curve.speed, self.curve.effort
            speeds += s.tolist()
            slopes = np.diff(e) / np.diff(s)
            lines += [
                (float(y - k * x), float(k))
                for x, y, k in zip(s[1:], e[1:], slopes, strict=True)
            ]
            lines.append((float(e[-1]), 0.0))
            speeds += [(flat - y) / k for y, k in lines[1:] if k != 0.0]
        speeds += [-v for v in speeds]
        if math.isfinite(self.acceleration):
            # Where a line, friction and weight make the acceleration the largest.
            for level, slope in lines:
                for way in (1.0, -1.0):
                    rest = level - sign * (self.friction * way + self.weight[0])
                    fall = sign * self.damping - slope * way
                    if fall != 0.0:
                        speeds.append((rest - self.mass * self.acceleration) / fall)
        return np.unique(np.array(speeds))
