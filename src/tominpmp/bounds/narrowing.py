"""Intervals that enclose all motions of an arm with two joints, narrowed in turn."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from tominpmp.arrays import Array
from tominpmp.bounds.intervals import Interval, scaled
from tominpmp.bounds.tubes import Ends, Tube, TubeThrough, known
from tominpmp.bounds.two_joints import TwoJoints

# Intervals of time, and how often they are narrowed.
INTERVALS = 40
ROUNDS = 5


class Halfway(NamedTuple):
    """Ranges of the state when half of the time has passed.

    Attributes:
        s: Range of the arc of the second joint.
        y: Range of its rate.
        splits: How often they have been cut in halves.
    """

    s: tuple[float, float] = (-math.inf, math.inf)
    y: tuple[float, float] = (-math.inf, math.inf)
    splits: int = 0


class Narrowing:
    """Intervals that enclose all motions of a duration, narrowed again and again."""

    def __init__(self, arm: TwoJoints, T: float, halfway: Halfway) -> None:
        self.arm, self.h, self.halfway = arm, T / INTERVALS, halfway
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
        p = _tube(
            known(arm.p),
            one.plus(scaled(crossing, first)),
            Interval(first / mass.high, first / mass.low),
            h,
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
        rate = force.plus(across).over(root)
        y = self._through(
            arm.y,
            self.halfway.y,
            lambda ends, some: _tube(ends, rate.part(some), drag.part(some), h),
        )
        if y.empty:
            return True
        self.y = self.y.cut(y.within())
        way = y.integral(h).cut(scaled(self.v2.times(root), h)).with_zero()
        s = self._through(
            arm.s, self.halfway.s, lambda ends, some: Tube.of(ends, way.part(some))
        )
        if s.empty or self._follow(s):
            return True
        mass, ratio = self.ranges[:2]
        swept = p.integral(h).over(mass)
        kept = scaled(self.v1.plus(ratio.times(self.v2)), h)
        ends = arm.q[0] + arm.shift[0], arm.q[1] + arm.shift[1]
        c = Tube.of(known(ends), swept.cut(kept).with_zero())
        if c.empty or self._resisted(impulse):
            return True
        self.first = self.first.cut(c.within().minus(self.ranges[4]))
        self.v1, self.v2 = self._speeds()
        return bool(np.any(self.first.low > self.first.high + 1e-6))

    def _through(
        self,
        ends: tuple[float, float],
        halfway: tuple[float, float],
        tube: Callable[[Ends, slice], Tube],
    ) -> Tube | TubeThrough:
        """A tube, in halves if its quantity is in a range halfway."""
        if math.isinf(halfway[1] - halfway[0]):
            return tube(known(ends), slice(None))
        begin, end = known(ends)
        half = INTERVALS // 2
        parts = (begin, halfway), slice(half), (halfway, end), slice(half, None)
        return TubeThrough((tube(*parts[:2]), tube(*parts[2:])))

    def split(self) -> list[Halfway]:
        """Cut the range halfway of s or y in halves."""
        at, arm = INTERVALS // 2, self.arm
        s, y, splits = self.halfway
        around = self.second.low[at], self.second.high[at]
        ends = np.interp(around, arm.x, arm.arc)
        roams = bool(self.roams[at - 1 : at + 1].any())
        if not roams:
            s = max(s[0], float(ends[0])), min(s[1], float(ends[1]))
        y = max(y[0], float(self.y.low[at])), min(y[1], float(self.y.high[at]))
        if splits % 2 == 0 and not roams:
            middle = 0.5 * (s[0] + s[1])
            pieces = [((s[0], middle), y), ((middle, s[1]), y)]
        else:
            middle = 0.5 * (y[0] + y[1])
            pieces = [(s, (y[0], middle)), (s, (middle, y[1]))]
        return [Halfway(*piece, splits + 1) for piece in pieces]

    def _impulse(self, load: Interval) -> Tube:
        """Momentum of the first joint and what friction has taken: d times its way."""
        arm, first = self.arm, float(self.arm.damping[0])
        ends = arm.p[0] + first * arm.q[0], arm.p[1] + first * arm.q[1]
        return Tube.of(known(ends), scaled(load.with_zero(), self.h))

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
        c = Tube.damped(known((0.0, end - begin)), rate, drag, self.h)
        if c.empty:
            return True
        around = c.within()
        place = Interval(around.low + begin, around.high + begin)
        self.first = self.first.cut(place.minus(turned))
        return bool(np.any(self.first.low > self.first.high + 1e-6))

    def _follow(self, s: Tube | TubeThrough) -> bool:
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


def _tube(ends: Ends, rate: Interval, drag: Interval, h: float) -> Tube:
    """Bounds on what changes at a rate, less a drag times itself."""
    if not np.any(drag.high):
        return Tube.of(ends, scaled(rate.with_zero(), h))
    return Tube.damped(ends, rate, drag, h)
