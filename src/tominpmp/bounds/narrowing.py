"""Intervals that enclose motions of an arm with two joints, narrowed in turn.

Many sets of motions are looked at at once, a row each: those whose states at some
instants, the gates, are within ranges of their own.
"""

from __future__ import annotations

import math

import numpy as np

from tominpmp.arrays import Array, BoolArray, IntArray
from tominpmp.bounds.enclosures import GATES, INTERVALS, C, Enclosures, P, S, Y
from tominpmp.bounds.intervals import Interval, scaled
from tominpmp.bounds.tubes import Gates, Tube
from tominpmp.bounds.two_joints import Row, TwoJoints


def all_motions(arm: TwoJoints, T: float | Array) -> Enclosures:
    """All motions that take a time [s] at most: one row, or one for each of m times."""
    K, m = INTERVALS, np.size(T)
    ones = np.ones((m, K))
    far = np.full((m, len(GATES), 4), np.inf)
    p, y = by_energy(arm, T)
    return Enclosures(
        -far,
        far,
        Interval(arm.reach.low[0] * ones, arm.reach.high[0] * ones),
        Interval(arm.x[0] * ones, arm.x[-1] * ones),
        Interval.around(p),
        Interval.around(y),
        np.full((m, K), arm.open),
    )


def by_energy(arm: TwoJoints, T: float | Array) -> tuple[Array, Array]:
    """Bounds on p and y at all times from the work of the torques, shape (m, K).

    With w the root of twice the kinetic energy, p is no larger than w times the root of
    M11, nor y than w; friction only takes energy away.
    """
    ones = np.ones((1, 1))
    ranges = arm.table.ranges(Interval(arm.x[0] * ones, arm.x[-1] * ones))
    mass, ratio, root = ranges[:3]
    first = Interval(arm.reach.low[0] * ones, arm.reach.high[0] * ones)
    one, two = loads(arm, ranges, first)
    across = two.minus(ratio.times(one))
    forces = [float(np.max(np.abs(np.stack(part)))) for part in (one, across)]
    least = float(mass.low[0, 0])
    most = math.hypot(forces[0] / math.sqrt(least), forces[1] / float(root.low[0, 0]))
    begun = math.hypot(arm.p[0] / math.sqrt(least), arm.y[0])
    steps = np.reshape(T, (-1, 1)) / INTERVALS * np.arange(1, INTERVALS + 1)
    w = begun + most * steps
    return np.asarray(w * math.sqrt(float(mass.high[0, 0]))), np.asarray(w)


def loads(
    arm: TwoJoints, ranges: list[Interval], first: Interval
) -> tuple[Interval, Interval]:
    """Torques less gravity on both joints."""
    one, two = arm.effort
    if not arm.weighty:
        zero = Interval.around(np.zeros_like(first.low))
        return one.plus(zero), two.plus(zero)
    cosine, sine = first.cosine(), first.sine()

    def weight(k: int) -> Interval:
        around = ranges[k + 1].times(cosine).plus(ranges[k + 2].times(sine))
        return ranges[k].plus(around)

    return one.minus(weight(Row.WEIGHT_1)), two.minus(weight(Row.WEIGHT_2))


def narrowed(
    arm: TwoJoints, T: float | Array, sets: Enclosures, rounds: int
) -> tuple[Enclosures, IntArray]:
    """Those of which something is left, narrower, and which ones they were.

    Args:
        arm: The arm.
        T: The time [s], one for all or one for each row.
        sets: Sets of motions, m rows.
        rounds: How often they are narrowed.
    """
    which = np.arange(sets.rows)
    times = np.broadcast_to(T, (sets.rows,))
    for _ in range(rounds):
        narrowing = _Narrowing(arm, times[which, None] / INTERVALS, sets)
        left = np.flatnonzero(~narrowing.empty())
        sets, which = narrowing.result().taken(left), which[left]
        if not left.size:
            break
    return sets, which


class _Narrowing:
    """Once around; what is empty is told, and no more of it."""

    def __init__(self, arm: TwoJoints, h: Array, sets: Enclosures) -> None:
        self.arm, self.h, self.sets = arm, h, sets
        self.q1, self.q2, self.p, self.y = sets.q1, sets.q2, sets.p, sets.y
        self.roams = sets.roams
        self.ranges = arm.table.ranges(self.q2)
        self._roam()
        self.v1, self.v2 = self._speeds()
        self.low, self.high = sets.low.copy(), sets.high.copy()

    def result(self) -> Enclosures:
        """What is left."""
        states = self.q1, self.q2, self.p, self.y
        return Enclosures(self.low, self.high, *states, self.roams)

    def _gate(self, index: int, tube: Tube) -> None:
        for number, node in enumerate(GATES):
            at = tube.at(node)
            low, high = self.low[:, number, index], self.high[:, number, index]
            np.maximum(low, at.low, out=low)
            np.minimum(high, at.high, out=high)

    def _speeds(self) -> tuple[Interval, Interval]:
        """Velocities that p and y allow, and their limits."""
        mass, ratio, root = self.ranges[:3]
        top = [Interval(np.array(-v), np.array(v)) for v in self.arm.speed]
        second = self.y.over(root).cut(top[1])
        return self.p.over(mass).minus(ratio.times(second)).cut(top[0]), second

    def empty(self) -> BoolArray:
        """Narrow everything in turn; in which rows nothing is left, shape (m,)."""
        arm, h = self.arm, self.h
        one, two = loads(arm, self.ranges, self.q1)
        impulse, none = self._momentum(one)
        none = none | self._rate(one, two)
        none = none | self._second(two)
        mass, ratio = self.ranges[Row.MASS], self.ranges[Row.RATIO]
        swept = self.p_tube.integral(h).over(mass)
        kept = scaled(self.v1.plus(ratio.times(self.v2)), h)
        ends = arm.q[0] + arm.shift[0], arm.q[1] + arm.shift[1]
        c = Tube.of(ends, swept.cut(kept).with_zero(), self.sets.gates(C))
        self._gate(C, c)
        none = none | c.empty
        self.q1 = self.q1.cut(c.within().minus(self.ranges[Row.TURNED]))
        self._resisted(impulse)
        self.v1, self.v2 = self._speeds()
        return np.asarray(none | self.q1.none | self.p.none | self.y.none)

    def _momentum(self, one: Interval) -> tuple[Tube, BoolArray]:
        """Momentum of the first joint; also with what friction has taken: d1 q1."""
        arm, h = self.arm, self.h
        mass, ratio = self.ranges[Row.MASS], self.ranges[Row.RATIO]
        first = float(arm.damping[0])
        crossing = ratio.times(self.v2)
        self.p_tube = tube = Tube.damped(
            arm.p,
            one.plus(scaled(crossing, first)),
            Interval(first / mass.high, first / mass.low),
            h,
            self.sets.gates(P),
        )
        self._gate(P, tube)
        self.p = self.p.cut(tube.within())
        ends = arm.p[0] + first * arm.q[0], arm.p[1] + first * arm.q[1]
        impulse = Tube.of(ends, scaled(one.with_zero(), h), self._open)
        resisted = impulse.within().minus(scaled(self.q1, first))
        known = np.isfinite(resisted.low) & np.isfinite(resisted.high)
        self.p = self.p.cut(resisted).where(known, self.p)
        return impulse, tube.empty | impulse.empty

    @property
    def _open(self) -> Gates:
        none = np.empty((self.sets.rows, 0))
        return Gates((), none, none)

    def _rate(self, one: Interval, two: Interval) -> BoolArray:
        """Rate and place of the second joint; in which rows nothing is left."""
        arm, h = self.arm, self.h
        mass, ratio, root, bent = self.ranges[:4]
        first, second = arm.damping.tolist()
        force = two.minus(ratio.times(one)).plus(bent.times(self.p.squared()))
        across = ratio.times(scaled(self.p.over(mass), first))
        squares, m = ratio.squared(), root.squared()
        drag = Interval(
            (second + first * squares.low) / m.high,
            (second + first * squares.high) / m.low,
        )
        rate = force.plus(across).over(root)
        y = Tube.damped(arm.y, rate, drag, h, self.sets.gates(Y))
        self._gate(Y, y)
        self.y = self.y.cut(y.within())
        way = y.integral(h).cut(scaled(self.v2.times(root), h)).with_zero()
        s = Tube.of(arm.s, way, self.sets.gates(S))
        self._gate(S, s)
        return np.asarray(y.empty | s.empty | self._follow(s.within()))

    def _second(self, two: Interval) -> BoolArray:
        """Momentum of the second joint, which takes no torque of the first one."""
        arm = self.arm
        ratio, root = self.ranges[Row.RATIO], self.ranges[Row.ROOT]
        slope, cross = self.ranges[Row.SLOPE], self.ranges[Row.CROSS]
        rate = two.minus(scaled(self.v2, float(arm.damping[1])))
        rate = rate.plus(slope.times(self.v1.squared()))
        rate = rate.plus(cross.times(self.v1.times(self.v2)))
        tube = Tube.of(arm.p2, scaled(rate.with_zero(), self.h), self._open)
        self.y = self.y.cut(tube.within().minus(ratio.times(self.p)).over(root))
        return tube.empty

    def _follow(self, found: Interval) -> BoolArray:
        """Take the positions of the second joint from its arc."""
        arm = self.arm
        if arm.open:
            outside = (found.low < arm.arc[0]) | (found.high > arm.arc[-1])
            self.roams = self.roams & outside
        at = Interval(*(np.interp(part, arm.arc, arm.x) for part in found))
        at = self.q2.cut(at)
        self.q2 = Interval(
            np.where(self.roams, self.q2.low, at.low),
            np.where(self.roams, self.q2.high, at.high),
        )
        self.ranges = arm.table.ranges(self.q2)
        self._roam()
        self.v1, self.v2 = self._speeds()
        return at.none

    def _roam(self) -> None:
        """Where the second joint may be anywhere, functions are known all round."""
        turned = self.ranges[Row.TURNED]
        self.ranges[Row.TURNED] = Interval(
            np.where(self.roams, -np.inf, turned.low),
            np.where(self.roams, np.inf, turned.high),
        )

    def _resisted(self, impulse: Tube) -> None:
        """Follow q1 + the integral of M12 / M11 with friction.

        Its rate is the impulse less what friction has taken, over M11, in which no
        velocity appears.
        """
        arm, first = self.arm, float(self.arm.damping[0])
        mass, turned = self.ranges[Row.MASS], self.ranges[Row.TURNED]
        begin, end = arm.q[0] + arm.shift[0], arm.q[1] + arm.shift[1]
        shift = Interval(turned.low - begin, turned.high - begin)
        rate = impulse.within().plus(scaled(shift, first)).over(mass)
        known = np.isfinite(rate.low).all(axis=1) & np.isfinite(rate.high).all(axis=1)
        known = np.reshape(known, (-1, 1))
        if first == 0.0 or not np.any(known):
            return
        rate = Interval(np.where(known, rate.low, 0.0), np.where(known, rate.high, 0.0))
        drag = Interval(first / mass.high, first / mass.low)
        c = Tube.damped((0.0, end - begin), rate, drag, self.h, self._open)
        around = c.within()
        place = Interval(around.low + begin, around.high + begin)
        self.q1 = self.q1.cut(place.minus(turned)).where(known, self.q1)
