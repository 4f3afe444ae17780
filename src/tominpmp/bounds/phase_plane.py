r"""Swings of one joint in gravity, in its phase plane.

Between two rests a joint swings one way only. With :math:`E = v^2 / 2` over the
position q, a swing obeys :math:`dE / dq = a`, so that E is no larger than what the
largest acceleration makes of it from where the swing begins, nor than what the largest
brake can take away until it ends; the time of the swing is no less than the integral of
:math:`1 / \sqrt{2 E}` over the smaller of the two.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from tominpmp.arrays import Array, BoolArray, IntArray
from tominpmp.bounds.one_joint import OneJoint
from tominpmp.stopping import check

# Relative rounding that is granted in favour of a shorter time.
ROUNDING = 1e-7
# Where a goal is only just reached, it counts as reached this far off [rad], this much
# too fast or slow [rad/s], and with this share of E.
OFF = 1e-3
TOO_FAST = 1e-2
SHARE = 1e-2


def mirrored(arm: OneJoint) -> OneJoint:
    """The same arm with its position counted the other way."""
    constant, cosine, sine = arm.weight
    return replace(
        arm,
        weight=(-constant, -cosine, sine),
        effort=(-arm.effort[1], -arm.effort[0]),
        position=(-arm.position[1], -arm.position[0]),
    )


@dataclass(frozen=True, eq=False)
class Slope:
    """What changes E along a swing forwards, or backwards from its end.

    Attributes:
        arm: The arm.
        backwards: Whether it is followed back from where the swing ends: E grows by the
            deceleration then.
    """

    arm: OneJoint
    backwards: bool

    @property
    def steepest(self) -> float:
        """Bound on the change of the acceleration with the position."""
        return math.hypot(*self.arm.weight[1:]) / self.arm.mass

    def potential(self, q: Array) -> Array:
        """Part of E that the position alone decides, beginning at 0, shape (m,)."""
        arm = self.arm
        constant, cosine, sine = arm.weight
        work = cosine * np.sin(q) - sine * np.cos(q)
        dry = -arm.friction if not self.backwards else arm.friction
        if self.backwards:
            # Braking from q on: gravity and friction take energy away.
            return np.asarray(-(constant + dry) * q - work) / arm.mass
        return np.asarray((dry - constant) * q - work) / arm.mass

    def curvature(self, q: Array) -> Array:
        """Slope of the acceleration over the position, shape (m,)."""
        _, cosine, sine = self.arm.weight
        return np.asarray((cosine * np.sin(q) - sine * np.cos(q)) / self.arm.mass)

    @property
    def constant(self) -> float | None:
        """What the motor adds to the slope, if that is the same at all speeds."""
        if self.arm.curve is not None or self.arm.damping > 0.0:
            return None
        return float(self.motor(np.zeros(1), np.zeros(1))[1][0])

    def motor(self, low: Array, high: Array) -> tuple[Array, Array]:
        """Least and most that the motor adds to the slope between some speeds."""
        arm, sign = self.arm, -1.0 if self.backwards else 1.0
        ends = sign * arm.torque(low, sign), sign * arm.torque(high, sign)
        least, most = np.minimum(*ends), np.maximum(*ends)
        speeds = np.zeros(0) if arm.curve is None else arm.curve.speed
        for speed, torque in zip(speeds, sign * arm.torque(speeds, sign), strict=True):
            between = (low < speed) & (speed < high)
            least = np.where(between, np.minimum(least, torque), least)
            most = np.where(between, np.maximum(most, torque), most)
        return least / arm.mass, most / arm.mass

    @property
    def drag(self) -> float:
        """Slope that viscous friction adds backwards, and takes forwards, by speed."""
        return self.arm.damping / self.arm.mass


def profile(slope: Slope, energy: Array, rise: Array, least: Array, h: float) -> Array:
    """Bound E along swings, step by step.

    Args:
        slope: What changes E.
        energy: E where the swings begin, or end, shape (b,).
        rise: What the position adds to E in each step, shape (m, b).
        least: Lower bound on what it adds to the slope in each step, shape (m, b).
        h: Length of the steps.

    Returns:
        E at the ends of the steps, shape (m + 1, b); minus infinity where a swing does
        not get, and little less than zero where it only just does.
    """
    arm = slope.arm
    top = 0.5 * arm.velocity**2
    steepest = arm.acceleration * h
    out = np.empty((rise.shape[0] + 1, energy.size))
    out[0] = E = np.minimum(energy, top)
    constant = slope.constant
    if constant is not None:
        total = np.cumsum(np.minimum(rise + constant * h, steepest), axis=0)
        # Where E comes to the speed limit it is held there.
        over = np.maximum.accumulate(np.maximum(E + total - top, 0.0), axis=0)
        out[1:] = E + total - (over if math.isfinite(top) else 0.0)
        dead = np.minimum.accumulate(out, axis=0) < -OFF * arm.strongest
        return np.where(dead, -np.inf, out)
    for k in range(rise.shape[0]):
        after = E + np.minimum(_step(slope, E, rise[k], least[k], h), steepest)
        dead = after < -OFF * arm.strongest
        E = np.where(dead, -np.inf, np.minimum(after, top))
        out[k + 1] = E
    return out


def _step(slope: Slope, E: Array, rise: Array, least: Array, h: float) -> Array:
    """What E gains in a step at most, shape (b,)."""
    k = slope.drag
    v = np.sqrt(2.0 * np.maximum(E, 0.0))
    most = slope.motor(np.zeros(1), np.full(1, np.inf))[1][0]
    # The largest speed in the step: E - h k sqrt(2 E) = known has this root.
    known = E + h * np.maximum(least + 2.0 * h * slope.steepest + most, 0.0)
    root = h * k if slope.backwards else 0.0
    high = root + np.sqrt(root**2 + 2.0 * np.maximum(known, 0.0))
    # A straight line that E is not below, for which friction is known in the mean.
    loss = 0.0 if slope.backwards else k * high
    low = np.zeros(v.shape)
    for _ in range(2):  # from the least torque at speeds that the first look leaves
        weakest = slope.motor(np.minimum(v, low), high)[0]
        low = np.sqrt(2.0 * np.maximum(E + h * (least + weakest - loss), 0.0))
    motor = slope.motor(np.minimum(v, low), high)[1]
    if k == 0.0:
        return np.asarray(rise + h * motor)
    end = high if slope.backwards else low
    mean = (v * v + v * end + end * end) / np.maximum(1.5 * (v + end), 1e-300)
    side = 1.0 if slope.backwards else -1.0
    return np.asarray(rise + h * (motor + side * k * mean))


def durations(E: Array, bend: Array, h: float, slope: Slope) -> Array:
    """Time along swings, no more than it takes, shape (m + 1, b).

    Args:
        E: Bounds on E at the ends of the steps, shape (m + 1, b).
        bend: By how much the position may curve E downwards in each step, shape (m, b).
        h: Length of the steps.
        slope: What changes E.
    """
    top = 0.5 * slope.arm.velocity**2
    low, high = np.minimum(E[1:], E[:-1]), np.maximum(E[1:], E[:-1])
    # Where the speed limit is reached it may have been reached before.
    fast = E[1:] >= top * (1.0 - 1e-9)
    low = np.where(fast & (low > -np.inf), top, low)
    v, w = (np.sqrt(2.0 * np.maximum(x, 0.0)) for x in (low, high))
    bulge = 0.5 * h**2 * bend
    if not slope.backwards:
        # Friction makes E the steeper, the slower it is: it may be above the chord.
        bulge = bulge + 1.5 * h * slope.drag * (w - v)
    # Above the chord by a quarter of that, or below a steeper line from its lower end.
    with np.errstate(divide="ignore"):
        steep = 2.0 * h / (v + np.sqrt(w**2 + 2.0 * bulge))
        lifted = 2.0 * h / (np.sqrt(v**2 + 0.5 * bulge) + np.sqrt(w**2 + 0.5 * bulge))
    steps = np.where(low > -np.inf, np.maximum(steep, lifted), np.inf)
    return np.concatenate([np.zeros((1, E.shape[1])), np.cumsum(steps, axis=0)])


@dataclass(frozen=True, eq=False)
class Branch:
    """A bundle of swings forwards from their beginning, or backwards from their end.

    Attributes:
        E: Bounds on E, shape (m + 1, b), over the distance from there in steps.
        t: Times, likewise.
    """

    E: Array
    t: Array


def single_branch(
    arm: OneJoint, q: float, v: float, h: float, steps: int, backwards: bool
) -> Branch:
    """The branch from a state of known position and speed, which is >= 0."""
    slope = Slope(arm, backwards)
    side = -1.0 if backwards else 1.0
    at = np.asarray(q + side * h * np.arange(steps + 1))
    return branches(slope, at, np.array([0.5 * v**2]), h, np.arange(steps)[:, None])


def branches(
    slope: Slope,
    at: Array,
    energy: Array,
    h: float,
    place: IntArray,
    wide: bool = False,
) -> Branch:
    """Branches over positions of equal distance.

    Args:
        slope: What changes E.
        at: Positions, shape (p,), in the order in which they are passed.
        energy: E at first, shape (b,).
        h: Their distance.
        place: Index of the position at which each step begins, shape (m, b).
        wide: Whether the beginning is somewhere between a position and the next one.
    """
    check()
    rise = np.diff(slope.potential(at))
    bend = np.maximum(-slope.curvature(at), 0.0)
    bend = np.maximum(bend[1:], bend[:-1]) + h * slope.steepest
    low = rise / h - h * slope.steepest
    if wide:
        # A step from anywhere between two positions is no better than from one of them,
        # but for the curvature between.
        grown = slope.steepest * h**3 / 8.0
        rise = np.maximum(rise[1:], rise[:-1]) + grown
        low = np.minimum(low[1:], low[:-1])
        bend = np.maximum(bend[1:], bend[:-1])
    E = profile(slope, energy, rise[place], low[place], h)
    return Branch(E, durations(E, bend[place], h, slope))


def meeting(
    forward: Branch,
    back: Branch,
    starts: IntArray,
    ends: IntArray,
    strongest: float,
    wanted: BoolArray | None = None,
) -> Array:
    """Least times of swings whose branches begin and end at positions of one grid.

    Args:
        forward: Branches from the beginnings, shape (m + 1, b).
        back: Branches from the ends, shape (m + 1, c).
        starts: Positions at which they begin, shape (b,).
        ends: Positions at which they end, shape (c,).
        strongest: Bound on accelerations.
        wanted: Which pairs are asked for, shape (b, c); None for all.

    Returns:
        Shape (b, c); infinite where there is none.
    """
    possible = ends[None, :] >= starts[:, None]
    if wanted is not None:
        possible &= wanted
    # Who begins a swing with some speed must be able to stop, and who is to end it with
    # some must be able to get it; cells are wider by a step than what is between them.
    b, c = np.nonzero(possible)
    far = ends[c] - starts[b]
    enough = _reached(back.E, far, c) >= _excused(forward.E[0, b], strongest)
    enough &= _reached(forward.E, far, b) >= _excused(back.E[0, c], strongest)
    b, c = b[enough], c[enough]
    first, last = starts[b], ends[c]
    low, high = first, last
    # Flat places: the bundles are looked at from one position on.
    one, other = b - first * forward.E.shape[1], c + last * back.E.shape[1]
    strides = forward.E.shape[1], back.E.shape[1]
    E, F = forward.E.ravel(), back.E.ravel()
    width = int(np.max(last - first, initial=1))
    for _ in range(width.bit_length()):
        middle = (low + high + 1) // 2
        slower = E[one + middle * strides[0]] <= F[other - middle * strides[1]]
        low = np.where(slower, middle, low)
        high = np.where(slower, high, np.maximum(middle - 1, low))
    best = np.zeros(low.shape)
    t, r = forward.t.ravel(), back.t.ravel()
    for at in (low, np.minimum(low + 1, last)):
        best = np.maximum(best, t[one + at * strides[0]] + r[other - at * strides[1]])
    out = np.full(possible.shape, np.inf)
    out[b, c] = best
    return out


def _excused(E: Array, strongest: float) -> Array:
    """As little of an E at one end as is enough to be taken for it."""
    return np.asarray((1.0 - SHARE) * E - OFF * strongest - TOO_FAST * np.sqrt(2.0 * E))


def _reached(E: Array, steps: IntArray, branch: IntArray) -> Array:
    """E after some steps, or one more, which is what bundles may have."""
    last = E.shape[0] - 1
    after = np.minimum(steps + (E.shape[1] > 1), last)
    return np.asarray(np.maximum(E[steps, branch], E[after, branch]))
