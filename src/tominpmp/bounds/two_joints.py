r"""Least time of arms with two joints, from their momenta.

The inertia of such an arm depends on its second joint alone. So the momentum of the
first one, :math:`p = M_{11} v_1 + M_{12} v_2`, changes by torques alone, and

.. math::
    \frac{d}{dt} \Big( q_1 + \int \frac{M_{12}}{M_{11}} dq_2 \Big) = \frac{p}{M_{11}}.

With :math:`m = M_{22} - M_{12}^2 / M_{11}` the inertia of the second joint when the
first one is free, :math:`s = \int \sqrt m \, dq_2` and its rate y,

.. math::
    \dot y = \Big( u_2 - g_2 - \frac{M_{12}}{M_{11}} (u_1 - g_1)
        + \frac{M_{11}'}{2 M_{11}^2} p^2 \Big) / \sqrt m.

Both have no other velocity in them but for friction. The momentum of the second joint,
:math:`M_{12} v_1 + M_{22} v_2 = M_{12} p / M_{11} + \sqrt m \, y`, takes no torque of
the first one, which may not drive p and y as it likes in both at once. From the start
on, and back from the goal, intervals enclose all that these and both positions can be
at each time; where they have nothing in common, no motion takes that long, nor less.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array
from tominpmp.bounds.inertia import effort_bounds, inertia_at
from tominpmp.bounds.intervals import Interval, Table
from tominpmp.kinematics import prismatic_joints
from tominpmp.problem import Problem
from tominpmp.robot import JointLimits, Robot

# Positions of the second joint at which the arm is looked at.
POSITIONS = 1500
# An unlimited second joint is looked at this far from start and goal [rad].
FAR = 2.0 * math.pi
# Positions may be this far beyond their limits, as the verification has it.
BEYOND = 1e-2


class Row:
    """Rows of the table: functions of the position of the second joint.

    M11, M12 / M11, the root of m, M11' / (2 M11^2), the integral of M12 / M11, the
    parts of gravity on both joints that go with 1, the cosine and the sine of the first
    one, and M11' / 2 and M12'.
    """

    MASS, RATIO, ROOT, BENT, TURNED = range(5)
    WEIGHT_1, WEIGHT_2 = 5, 8
    SLOPE, CROSS = 11, 12


@dataclass(frozen=True, eq=False)
class TwoJoints:
    """An arm with two joints on its way from one state to another.

    Attributes:
        x: Positions of the second joint, shape (m,).
        arc: Integral of the root of m over them, shape (m,).
        table: Functions over x, see :class:`Row`.
        shift: What M12 / M11 adds up to at start and goal.
        effort: Bounds on the torques, dry friction in them.
        damping: Viscous friction.
        reach: Bounds on both positions.
        speed: Speed limits.
        q: First positions at start and goal.
        s: Arc there.
        p: Momentum of the first joint there.
        y: Rate of s there.
        p2: Momentum of the second joint there.
        weighty: Whether gravity acts.
        open: Whether the second joint can leave x.
    """

    x: Array
    arc: Array
    table: Table
    shift: tuple[float, float]
    effort: tuple[Interval, Interval]
    damping: Array
    reach: Interval
    speed: Array
    q: tuple[float, float]
    s: tuple[float, float]
    p: tuple[float, float]
    y: tuple[float, float]
    p2: tuple[float, float]
    weighty: bool
    open: bool

    @classmethod
    def of(cls, problem: Problem, q: Array, v: Array) -> TwoJoints | None:
        """Look at the arm of a problem; None if it is no such arm.

        Args:
            problem: The problem.
            q: Configurations at start and goal, shape (2, 2).
            v: Velocities there, shape (2, 2).
        """
        robot, limits = problem.robot, problem.robot.limits
        if robot.n != 2 or robot.model.nv != 2 or robot.expansion_matrix is not None:
            return None
        low, high = float(limits.position_lower[1]), float(limits.position_upper[1])
        if prismatic_joints(robot)[1] and not math.isfinite(high - low):
            return None
        first = max(low, float(np.min(q[:, 1])) - FAR)
        last = min(high, float(np.max(q[:, 1])) + FAR)
        if not prismatic_joints(robot)[1] and last - first < 2.0 * math.pi:
            # Functions of it are looked at as far as it goes, or all round.
            last = min(first + 2.0 * math.pi, high)
        x = np.linspace(first, max(last, first + 1e-6), POSITIONS)
        M = inertia_at(robot, np.column_stack([np.zeros_like(x), x]))
        if np.min(M[:, 0, 0]) <= 0.0 or np.min(np.linalg.det(M)) <= 0.0:
            return None
        ratio = M[:, 0, 1] / M[:, 0, 0]
        root = np.sqrt(M[:, 1, 1] - M[:, 0, 1] * ratio)
        bent = np.gradient(M[:, 0, 0], x) / (2.0 * M[:, 0, 0] ** 2)
        gravity = _gravity(robot, x)
        turned, arc = _integral(ratio, x), _integral(root, x)
        slopes = [0.5 * np.gradient(M[:, 0, 0], x), np.gradient(M[:, 0, 1], x)]
        rows = [M[:, 0, 0], ratio, root, bent, turned, *gravity, *slopes]

        def at(values: Array) -> tuple[float, float]:
            found = np.interp(q[:, 1], x, values)
            return float(found[0]), float(found[1])

        p = np.array(at(M[:, 0, 0])) * v[:, 0] + np.array(at(M[:, 0, 1])) * v[:, 1]
        y = np.array(at(root)) * v[:, 1]
        second = np.array(at(M[:, 0, 1])) * v[:, 0] + np.array(at(M[:, 1, 1])) * v[:, 1]
        effort = effort_bounds(robot, problem.motion_limits)
        lower, upper = effort[0] - robot.friction, effort[1] + robot.friction
        if not np.all(np.isfinite(upper - lower)):
            return None
        torques = [Interval(np.full(1, lower[i]), np.full(1, upper[i])) for i in (0, 1)]
        return cls(
            x,
            arc,
            Table(x, np.array(rows)),
            at(turned),
            (torques[0], torques[1]),
            robot.damping,
            _reach(limits, q),
            limits.velocity,
            (float(q[0, 0]), float(q[1, 0])),
            at(arc),
            (float(p[0]), float(p[1])),
            (float(y[0]), float(y[1])),
            (float(second[0]), float(second[1])),
            bool(np.any(gravity)),
            low < x[0] or high > x[-1],
        )


def _reach(limits: JointLimits, q: Array) -> Interval:
    """Bounds on the positions, start and goal in them."""
    return Interval(
        np.minimum(limits.position_lower - BEYOND, np.min(q, axis=0)),
        np.maximum(limits.position_upper + BEYOND, np.max(q, axis=0)),
    )


def _integral(values: Array, x: Array) -> Array:
    """Integral from the first x on, by the trapezoidal rule."""
    steps = 0.5 * np.diff(x) * (values[1:] + values[:-1])
    return np.concatenate([[0.0], np.cumsum(steps)])


def _gravity(robot: Robot, x: Array) -> list[Array]:
    """Parts of gravity on both joints with 1, cosine and sine of the first one."""
    model, data, zero = robot.model, robot.model.createData(), np.zeros(2)
    if not np.any(robot.gravity):
        return [np.zeros_like(x)] * 6
    turning = not prismatic_joints(robot)[0]
    held = np.array(
        [
            [
                pin.rnea(model, data, row, zero, zero).copy()
                for row in robot.expand(np.column_stack([np.full_like(x, at), x]))
            ]
            for at in ((0.0, 0.5 * math.pi, math.pi) if turning else (0.0,))
        ]
    )
    out = []
    for joint in (0, 1):
        part = held[:, :, joint]
        if not turning:
            out += [part[0], np.zeros_like(x), np.zeros_like(x)]
            continue
        mean = 0.5 * (part[0] + part[2])
        out += [mean, part[0] - mean, part[1] - mean]
    return out
