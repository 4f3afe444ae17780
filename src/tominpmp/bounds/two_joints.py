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

Both have no other velocity in them but for friction. From the start on, and back from
the goal, intervals enclose all that p, y and both positions can be at each time; where
they have nothing in common, no motion takes that long, nor less.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array
from tominpmp.bounds.inertia import effort_bounds, inertia_at
from tominpmp.bounds.intervals import Interval, Table, scaled
from tominpmp.bounds.tubes import Tube
from tominpmp.kinematics import prismatic_joints
from tominpmp.problem import Problem
from tominpmp.robot import Robot
from tominpmp.stopping import check

# Positions of the second joint at which the arm is looked at.
POSITIONS = 1500
# An unlimited second joint is looked at this far from start and goal [rad].
FAR = 2.0 * math.pi
# Intervals of time, how often they are narrowed, and steps of the search for the time.
INTERVALS = 40
ROUNDS = 5
BISECTIONS = 8
# Positions may be this far beyond their limits, as the verification has it.
BEYOND = 1e-2
# Longest time looked at [s].
LONGEST = 1e4
# Relative rounding, and errors of quadrature, that are granted.
ROUNDING = 1e-5


@dataclass(frozen=True, eq=False)
class TwoJoints:
    """An arm with two joints on its way from one state to another.

    Attributes:
        x: Positions of the second joint, shape (m,).
        arc: Integral of the root of m over them, shape (m,).
        table: M11, M12 / M11, root of m, M11' / (2 M11^2), the integral of M12 / M11,
            and the parts of gravity on both joints that go with 1, the cosine and the
            sine of the first joint, over x.
        shift: What M12 / M11 adds up to at start and goal.
        effort: Bounds on the torques, dry friction in them.
        damping: Viscous friction.
        reach: Bounds on both positions.
        speed: Speed limits.
        q: First positions at start and goal.
        s: Arc there.
        p: Momentum of the first joint there.
        y: Rate of s there.
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
        rows = [M[:, 0, 0], ratio, root, bent, turned, *gravity]

        def at(values: Array) -> tuple[float, float]:
            found = np.interp(q[:, 1], x, values)
            return float(found[0]), float(found[1])

        p = np.array(at(M[:, 0, 0])) * v[:, 0] + np.array(at(M[:, 0, 1])) * v[:, 1]
        y = np.array(at(root)) * v[:, 1]
        effort = effort_bounds(robot, problem.motion_limits)
        lower, upper = effort[0] - robot.friction, effort[1] + robot.friction
        if not np.all(np.isfinite(upper - lower)):
            return None
        torques = [Interval(np.full(1, lower[i]), np.full(1, upper[i])) for i in (0, 1)]
        reach = Interval(
            np.minimum(limits.position_lower - BEYOND, np.min(q, axis=0)),
            np.maximum(limits.position_upper + BEYOND, np.max(q, axis=0)),
        )
        return cls(
            x,
            arc,
            Table(x, np.array(rows)),
            at(turned),
            (torques[0], torques[1]),
            robot.damping,
            reach,
            limits.velocity,
            (float(q[0, 0]), float(q[1, 0])),
            at(arc),
            (float(p[0]), float(p[1])),
            (float(y[0]), float(y[1])),
            bool(np.any(gravity)),
            low < x[0] or high > x[-1],
        )

    def least_time(self) -> float:
        """Time that no motion can beat, or a little less."""
        low, high = 0.0, 1e-2
        while self.excluded(high):
            low, high = high, 2.0 * high
            if high > LONGEST:
                return low
        for _ in range(BISECTIONS):
            T = 0.5 * (low + high)
            low, high = (T, high) if self.excluded(T) else (low, T)
        return low * (1.0 - ROUNDING)

    def excluded(self, T: float) -> bool:
        """Whether no motion takes so little time, nor less.

        All bounds allow to wait, so that shorter motions are among the longer ones.
        """
        check()
        return _Narrowing(self, T).empty()


class _Narrowing:
    """Intervals that enclose all motions of a duration, narrowed again and again."""

    def __init__(self, arm: TwoJoints, T: float) -> None:
        self.arm, self.h = arm, T / INTERVALS
        K = INTERVALS
        self.first = Interval(
            np.full(K, arm.reach.low[0]), np.full(K, arm.reach.high[0])
        )
        self.second = Interval(np.full(K, arm.x[0]), np.full(K, arm.x[-1]))
        self.ranges = arm.table.ranges(self.second)
        self.roams = np.full(K, arm.open)
        self._roam()
        momentum, rate = self._by_energy()
        self.p, self.y = Interval.around(momentum), Interval.around(rate)
        self.v1, self.v2 = self._speeds()

    def _by_energy(self) -> tuple[Array, Array]:
        """Bounds on p and y at all times from the work of the torques.

        With w the root of twice the kinetic energy, p is no larger than w times the
        root of M11, nor y than w; friction only takes energy away.
        """
        arm = self.arm
        mass, ratio, root = self.ranges[:3]
        one, two = self._loads()
        across = two.minus(ratio.times(one))
        forces = [np.max(np.abs(np.stack(part)), axis=0) for part in (one, across)]
        most = np.max(np.hypot(forces[0] / np.sqrt(mass.low), forces[1] / root.low))
        begun = math.hypot(arm.p[0] / math.sqrt(float(mass.low[0])), arm.y[0])
        w = begun + float(most) * self.h * np.arange(1, INTERVALS + 1)
        return np.asarray(w * np.sqrt(mass.high)), np.asarray(w)

    def _speeds(self) -> tuple[Interval, Interval]:
        """Velocities that p and y allow, and their limits."""
        mass, ratio, root = self.ranges[:3]
        top = [Interval.around(np.full(INTERVALS, v)) for v in self.arm.speed]
        second = self.y.over(root).cut(top[1])
        return self.p.over(mass).minus(ratio.times(second)).cut(top[0]), second

    def _loads(self) -> tuple[Interval, Interval]:
        """Torques less gravity on both joints."""
        arm = self.arm
        one, two = arm.effort
        if not arm.weighty:
            zero = Interval.around(np.zeros(INTERVALS))
            return one.plus(zero), two.plus(zero)
        parts = self.ranges[5:]
        cosine, sine = self.first.cosine(), self.first.sine()

        def weight(k: int) -> Interval:
            around = parts[k + 1].times(cosine).plus(parts[k + 2].times(sine))
            return parts[k].plus(around)

        return one.minus(weight(0)), two.minus(weight(3))

    def empty(self) -> bool:
        """Narrow them; whether nothing is left."""
        for _ in range(ROUNDS):
            if self._narrowed():
                return True
        return False

    def _narrowed(self) -> bool:
        """Once around; whether nothing is left."""
        arm, h = self.arm, self.h
        mass, ratio, root, bent = self.ranges[:4]
        one, two = self._loads()
        first, second = arm.damping.tolist()
        crossing = ratio.times(self.v2)
        p = self._tube(
            arm.p,
            one.plus(scaled(crossing, first)),
            Interval(first / mass.high, first / mass.low),
        )
        if p.empty:
            return True
        self.p = self.p.cut(p.within())
        impulse = self._impulse(one)
        if impulse.empty:
            return True
        resisted = impulse.within().minus(scaled(self.first, first))
        if np.all(np.isfinite(resisted)):
            self.p = self.p.cut(resisted)
        force = two.minus(ratio.times(one)).plus(bent.times(self.p.squared()))
        across = ratio.times(scaled(self.p.over(mass), first))
        squares = ratio.squared()
        m = root.squared()
        drag = Interval(
            (second + first * squares.low) / m.high,
            (second + first * squares.high) / m.low,
        )
        y = self._tube(arm.y, force.plus(across).over(root), drag)
        if y.empty:
            return True
        self.y = self.y.cut(y.within())
        s = Tube.of(arm.s, self._way(y, self.v2.times(root)))
        if s.empty or self._follow(s):
            return True
        mass, ratio = self.ranges[:2]
        rate = p.integral(h).over(mass)
        kept = scaled(self.v1.plus(ratio.times(self.v2)), h)
        c = Tube.of(
            (arm.q[0] + arm.shift[0], arm.q[1] + arm.shift[1]),
            rate.cut(kept).with_zero(),
        )
        if c.empty or self._resisted(impulse):
            return True
        self.first = self.first.cut(c.within().minus(self.ranges[4]))
        self.v1, self.v2 = self._speeds()
        return bool(np.any(self.first.low > self.first.high + 1e-6))

    def _tube(self, ends: tuple[float, float], rate: Interval, drag: Interval) -> Tube:
        if not np.any(drag.high):
            return Tube.of(ends, scaled(rate.with_zero(), self.h))
        return Tube.damped(ends, rate, drag, self.h)

    def _impulse(self, load: Interval) -> Tube:
        """Momentum of the first joint and what friction has taken: d times its way."""
        arm, first = self.arm, float(self.arm.damping[0])
        ends = arm.p[0] + first * arm.q[0], arm.p[1] + first * arm.q[1]
        return Tube.of(ends, scaled(load.with_zero(), self.h))

    def _resisted(self, impulse: Tube) -> bool:
        """Follow q1 + the integral of M12 / M11 with friction; whether nothing is left.

        Its rate is the impulse less what friction has taken, over M11, in which no
        velocity appears.
        """
        arm, first = self.arm, float(self.arm.damping[0])
        mass, turned = self.ranges[0], self.ranges[4]
        begin, end = arm.q[0] + arm.shift[0], arm.q[1] + arm.shift[1]
        shift = Interval(turned.low - begin, turned.high - begin)
        rate = impulse.within().plus(scaled(shift, first)).over(mass)
        if first == 0.0 or not np.all(np.isfinite(rate)):
            return False
        drag = Interval(first / mass.high, first / mass.low)
        c = Tube.damped((0.0, end - begin), rate, drag, self.h)
        if c.empty:
            return True
        around = c.within()
        place = Interval(around.low + begin, around.high + begin)
        self.first = self.first.cut(place.minus(turned))
        return bool(np.any(self.first.low > self.first.high + 1e-6))

    def _way(self, y: Tube, limit: Interval) -> Interval:
        """Bounds on the way of s in each interval."""
        return y.integral(self.h).cut(scaled(limit, self.h)).with_zero()

    def _follow(self, s: Tube) -> bool:
        """Take the positions of the second joint from its arc; whether none is left."""
        arm = self.arm
        found = s.within()
        if arm.open:
            outside = (found.low < arm.arc[0]) | (found.high > arm.arc[-1])
            self.roams = self.roams & outside
        at = Interval(*(np.interp(part, arm.arc, arm.x) for part in found))
        at = self.second.cut(at)
        if np.any(at.low > at.high + 1e-6):
            return True
        self.second = Interval(
            np.where(self.roams, self.second.low, at.low),
            np.where(self.roams, self.second.high, at.high),
        )
        self.ranges = arm.table.ranges(self.second)
        self._roam()
        return False

    def _roam(self) -> None:
        """Where the second joint may be anywhere, functions are known all round."""
        turned = self.ranges[4]
        self.ranges[4] = Interval(
            np.where(self.roams, -np.inf, turned.low),
            np.where(self.roams, np.inf, turned.high),
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
