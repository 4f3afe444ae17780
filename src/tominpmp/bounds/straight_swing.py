"""The fastest motion of one joint in gravity that goes straight to its goal."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tominpmp.arrays import Array
from tominpmp.bounds.one_joint import OneJoint
from tominpmp.bounds.phase_plane import Branch, Slope, branches, meeting, mirrored

# Steps of the swing.
STEPS = 600


@dataclass(frozen=True, eq=False)
class Straight:
    """The fastest single swing, and what little swings beside it might save.

    Attributes:
        T: Its time; infinite if there is none.
        saved: What turning just before the start and just behind the goal saves at
            most, beside the time that it takes; infinite where that is not known.
    """

    T: float
    saved: float


def straight_time(arm: OneJoint, q: Array, v: Array, beside: float) -> Straight:
    """Least time of a single swing.

    Args:
        arm: The arm.
        q: Positions at start and end, shape (2,).
        v: Velocities there, shape (2,).
        beside: How far from them the little swings may turn.
    """
    if q[1] < q[0] or (q[1] == q[0] and np.any(v < 0.0)):
        arm, q, v = mirrored(arm), -q, -v
    if np.any(v < 0.0):
        return Straight(math.inf, math.inf)
    if q[1] == q[0]:
        return Straight(0.0 if v[0] == v[1] else math.inf, math.inf)
    h = float(q[1] - q[0]) / STEPS
    ladders = [_ladder(arm, float(q[k]), beside, k == 1) for k in (0, 1)]
    both = []
    for k, ladder in enumerate(ladders):
        energy = np.append(0.5 * v[k] ** 2, ladder.energy if v[k] == 0.0 else [])
        at = q[k] + (1.0 - 2.0 * k) * h * np.arange(STEPS + 1)
        place = np.arange(STEPS)[:, None]
        both.append(branches(Slope(arm, k == 1), at, energy, h, place))
    forward, back = both
    alone = [Branch(item.E[:, :1], item.t[:, :1]) for item in both]
    ends = np.array([0]), np.array([STEPS])
    T = float(meeting(alone[0], alone[1], *ends, arm.strongest)[0, 0])
    if T == math.inf:
        return Straight(T, T)
    middle = int(np.argmin(np.abs(forward.t[:, 0] + back.t[::-1, 0] - T)))
    saved = 0.0
    for k, (ladder, branch) in enumerate(zip(ladders, both, strict=True)):
        if v[k] == 0.0:
            t = branch.t[STEPS - middle if k else middle]
            saved += ladder.saved(t[0] - t[1:])
    return Straight(T, saved)


@dataclass(frozen=True, eq=False)
class Ladder:
    """What it costs to come back to the start with some speed, or to be past the goal.

    Attributes:
        energy: E at the start, increasing, shape (k,).
        cost: Least time that getting it takes, shape (k,).
    """

    energy: Array
    cost: Array

    def saved(self, savings: Array) -> float:
        """Most that it saves, given what it saves afterwards, shape (k,)."""
        if not self.energy.size or np.any(savings[1:] > self.cost[:-1]):
            return math.inf
        return max(float(savings[0]), 0.0)


def _ladder(arm: OneJoint, q: float, beside: float, end: bool) -> Ladder:
    """Swings away from the start, to its left, or past the goal, to its right.

    Whoever has some E at the start was at rest before, at least E over the largest
    acceleration away, and had come there from the start, stopping. Whoever has some E
    at the goal has to stop, and to come back.
    """
    side = 1.0 if end else -1.0
    at = np.linspace(q, q + side * beside, 50)
    weight = arm.weight[0] + arm.weight[1] * np.cos(at) + arm.weight[2] * np.sin(at)
    margin = beside / 49.0 * math.hypot(*arm.weight[1:])
    # Largest forces to the right and to the left anywhere there, without friction.
    speeds = np.zeros(1) if arm.curve is None else arm.curve.speed
    right = float(np.max(arm.torque(speeds, 1.0)) - np.min(weight)) + margin
    left = float(np.max(weight) - np.min(arm.torque(speeds, -1.0))) + margin
    fastest = beside * arm.damping / arm.mass
    force = max(right, left) + arm.friction
    fastest += math.sqrt(fastest**2 + 2.0 * beside * max(force, 0.0) / arm.mass)
    brake = arm.friction + arm.damping * fastest
    forces = left + brake, left - arm.friction
    if not end:
        forces = right - arm.friction, right + brake
    gain, other = (min(x / arm.mass, arm.acceleration) for x in forces)
    if min(gain, other) <= 0.0:
        return Ladder(np.zeros(0), np.zeros(0))
    energy = gain * beside * np.geomspace(1e-10, 1.0, 90)
    cost = np.sqrt(2.0 * energy) / gain + np.sqrt(2.0 * energy / (gain * other))
    return Ladder(energy, cost)
