"""Times of legs between configurations of stations: estimates, and what was planned.

Without torque limits and obstacles the joints do not know of each other: the least time
between two configurations at rest is that of the slowest joint, which speeds up, runs
at its speed limit and slows down. It is what no motion beats, and near what is planned
where limits of speed and acceleration rule.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from tominpmp.arrays import Array, BoolArray
from tominpmp.problem import Problem

# Differences of configurations that are taken at once, for the sake of memory.
CHUNK = 2_000_000


@dataclass(frozen=True, eq=False)
class JointTimes:
    """Limits of the joints, shape (n,) each, possibly infinite.

    Attributes:
        velocity: Speed limits [rad/s or m/s].
        acceleration: Acceleration limits [rad/s^2 or m/s^2].
        jerk: Jerk limits [rad/s^3 or m/s^3].
    """

    velocity: Array
    acceleration: Array
    jerk: Array

    @classmethod
    def of(cls, problem: Problem) -> JointTimes:
        """Take the limits of a problem."""
        names, n = problem.robot.joint_names, problem.robot.n
        acceleration, jerk = np.full(n, np.inf), np.full(n, np.inf)
        if problem.motion_limits is not None:
            limits = problem.motion_limits
            acceleration = limits.by_joint("acceleration", names)
            jerk = limits.by_joint("jerk", names)
        return cls(problem.robot.limits.velocity, acceleration, jerk)

    def with_acceleration(self, most: Array) -> JointTimes:
        """The same with accelerations of no more than so much, shape (n,)."""
        return replace(self, acceleration=np.minimum(self.acceleration, most))

    @property
    def weights(self) -> Array:
        """Weights by which displacements of joints take about equal time, shape (n,).

        Those of short ways where accelerations are limited: their square roots count.
        """
        slow = np.where(np.isfinite(self.velocity), 1.0 / self.velocity, 0.0)
        slow = np.maximum(slow, 1e-3 * max(float(slow.max()), 1e-3))
        finite = np.isfinite(self.acceleration)
        if not np.all(finite):
            return np.asarray(slow)
        return np.asarray(np.sqrt(slow**2 + 1.0 / self.acceleration))

    def between(self, a: Array, b: Array, resting: int = 2) -> Array:
        """Least times between configurations.

        Args:
            a: Configurations, shape (..., n) [rad or m].
            b: Others, of a shape that fits.
            resting: At how many of both ends the arm is at rest.

        Returns:
            Times [s], shape (...).
        """
        times = self.of_joints(np.abs(b - a), resting)
        return np.asarray(np.max(times, axis=-1, initial=0.0))

    def matrix(self, a: Array, b: Array, resting: int = 2) -> Array:
        """Least times from each of some configurations to each of others.

        Args:
            a: Shape (k, n) [rad or m].
            b: Shape (m, n).
            resting: At how many of both ends the arm is at rest.

        Returns:
            Times [s], shape (k, m).
        """
        out = np.empty((len(a), len(b)))
        rows = max(1, CHUNK // max(1, b.size))
        for begin in range(0, len(a), rows):
            part = slice(begin, begin + rows)
            out[part] = self.between(a[part, None], b[None], resting)
        return out

    def of_joints(self, way: Array, resting: int = 2) -> Array:
        """Least times by joint for distances to go, shape (..., n) both."""
        v, a, j = self.velocity, self.acceleration, self.jerk
        # Without limits a joint takes no time, whatever the way.
        with np.errstate(divide="ignore", invalid="ignore"):
            cruise = way / v
            if resting == 0:
                return np.asarray(cruise)
            if resting == 1 or not np.any(np.isfinite(j)):
                ramps = float(resting)
                short = way * a < 0.5 * ramps * v * v
                peak = np.sqrt(2.0 * ramps * way / a)
                return np.where(short, peak, cruise + 0.5 * ramps * v / a)
            return self._with_jerk(way, cruise)

    def _with_jerk(self, way: Array, cruise: Array) -> Array:
        """From rest to rest, where accelerations begin and end with zero."""
        v, a, j = self.velocity, self.acceleration, self.jerk
        jerky = np.isfinite(j)
        jerk = np.where(jerky, j, 1.0)
        ramp = np.where(v * jerk >= a * a, v / a + a / jerk, 2.0 * np.sqrt(v / jerk))
        ramp = np.where(jerky, ramp, v / a)
        # The peak speed of a motion that does not reach the speed limit.
        knee = np.where(jerky, a * a / jerk, 0.0)
        full = 0.5 * (np.sqrt(knee * knee + 4.0 * a * way) - knee)
        part = (0.5 * way * np.sqrt(jerk)) ** (2.0 / 3.0)
        peaked = np.where(
            np.isfinite(a) & (full >= knee),
            2.0 * (full / a + np.where(jerky, a / jerk, 0.0)),
            4.0 * np.sqrt(part / jerk),
        )
        peaked = np.where(jerky | np.isfinite(a), peaked, cruise)
        long = np.isfinite(v) & (v * ramp <= way)
        return np.where(way > 0.0, np.where(long, cruise + ramp, peaked), 0.0)


# Configurations this near to those of a leg that is blocked make one that is likely to
# be so, too [rad or m]; what such legs are taken to need: shares of the time, and [s].
NEAR = 0.25
DETOUR_SHARE, DETOUR = 1.5, 0.25

# A leg: node and configuration it begins at, node and configuration it ends at.
Leg = tuple[int, int, int, int]


@dataclass(eq=False)
class LegTable:
    """Times of legs between the nodes of a tour.

    Nodes are the start (0), the stations (1 to n) and, if it is given, the end (n + 1);
    each has some configurations. Times that are not known are estimates.

    Attributes:
        nodes: Configurations of each node, shape (k, n) each.
        rests: Whether the arm is at rest at each node.
        times: Estimates.
        factor: What estimates are multiplied by.
        known: Times that were found, infinite where there is no motion [s].
        blocked: Ends of legs, by their nodes, on whose direct way is something.
        detour_share: What these are taken to need: shares of the estimate, and
        detour: [s].
        ends: Whether the last node is the end of the tour, else it ends anywhere.
    """

    nodes: list[Array]
    rests: Sequence[bool]
    times: JointTimes
    ends: bool
    factor: float = 1.0
    known: dict[Leg, float] = field(default_factory=dict)
    blocked: dict[tuple[int, int], list[tuple[Array, Array]]] = field(
        default_factory=dict
    )
    detour_share: float = DETOUR_SHARE
    detour: float = DETOUR
    _blocks: dict[tuple[int, int], Array] = field(default_factory=dict)
    _of_pair: dict[tuple[int, int], dict[tuple[int, int], float]] = field(
        default_factory=dict
    )

    @property
    def stations(self) -> int:
        """Number of stations."""
        return len(self.nodes) - 1 - self.ends

    def station(self, node: int) -> int | None:
        """Index of the station at a node; None for the start and the end."""
        return node - 1 if 0 < node <= self.stations else None

    def way(self, order: Sequence[int]) -> list[int]:
        """Nodes of an order of stations, with the start and the end."""
        end = [self.stations + 1] if self.ends else []
        return [0, *(i + 1 for i in order), *end]

    def rows(self, leg: Leg) -> tuple[Array, Array]:
        """Configurations that a leg begins and ends at, shape (n,) each."""
        i, a, j, b = leg
        return self.nodes[i][a], self.nodes[j][b]

    def resting(self, i: int, j: int) -> int:
        """At how many ends of a leg the arm is at rest."""
        return int(self.rests[i]) + int(self.rests[j])

    def block(self, i: int, j: int) -> Array:
        """Times from each configuration of a node to each of another, shape (k, m)."""
        if (i, j) not in self._blocks:
            guess = self._guess(i, j, self.nodes[i], self.nodes[j])
            for (a, b), value in self._of_pair.get((i, j), {}).items():
                guess[a, b] = value
            self._blocks[i, j] = guess
        return self._blocks[i, j]

    def _guess(self, i: int, j: int, a: Array, b: Array) -> Array:
        """Estimates between configurations of two nodes, shape (k, m)."""
        guess = self.factor * self.times.matrix(a, b, self.resting(i, j))
        around = np.zeros(guess.shape, dtype=bool)
        for one, other in self.blocked.get((i, j), ()):
            around |= _near(a, one)[:, None] & _near(b, other)[None]
        return np.where(around, self.detour + self.detour_share * guess, guess)

    def block_way(self, leg: Leg) -> None:
        """Take down that something is on the direct way of a leg, there and back."""
        i, _, j, _ = leg
        one, other = self.rows(leg)
        self.blocked.setdefault((i, j), []).append((one, other))
        self.blocked.setdefault((j, i), []).append((other, one))
        for pair in ((i, j), (j, i)):
            self._blocks.pop(pair, None)

    def learn(self, leg: Leg, seconds: float) -> None:
        """Take down the time of a leg."""
        i, a, j, b = leg
        self.known[leg] = seconds
        self._of_pair.setdefault((i, j), {})[a, b] = seconds
        self._blocks.pop((i, j), None)

    def forget(self, leg: Leg) -> None:
        """Leave a leg to the estimates again."""
        i, a, j, b = leg
        self.known.pop(leg, None)
        self._of_pair.get((i, j), {}).pop((a, b), None)
        self._blocks.pop((i, j), None)

    def is_blocked(self, leg: Leg) -> bool:
        """Whether something is likely to be on the direct way of a leg."""
        begin, end = self.rows(leg)
        return any(
            bool(_near(begin, one) and _near(end, other))
            for one, other in self.blocked.get((leg[0], leg[2]), ())
        )

    def detours_take(self, share: float) -> None:
        """Take blocked legs to need another share of their estimates from now on."""
        self.detour_share, self.detour = max(1.0, share), 0.0
        self._blocks.clear()

    def scaled(self, factor: float) -> None:
        """Multiply estimates by another factor from now on."""
        if factor != self.factor:
            self.factor = factor
            self._blocks.clear()

    def add(self, node: int, rows: Array) -> None:
        """Add configurations to a node."""
        self.nodes[node] = np.concatenate([self.nodes[node], rows])
        for pair in [pair for pair in self._blocks if node in pair]:
            del self._blocks[pair]

    def along(self, order: Sequence[int], rows: list[Array]) -> LegTable:
        """A table of other configurations for the nodes of a tour, in their order."""
        blocked = {
            (k, k + 1): self.blocked[pair]
            for k, pair in enumerate(pairwise(order))
            if pair in self.blocked
        }
        rests = [self.rests[node] for node in order]
        return LegTable(
            rows,
            rests,
            self.times,
            True,
            self.factor,
            blocked=blocked,
            detour_share=self.detour_share,
            detour=self.detour,
        )

    def fixed(self, chosen: Sequence[int]) -> Array:
        """Times between the nodes with one configuration each, shape (nodes, nodes)."""
        rows = zip(self.nodes, chosen, strict=True)
        q = np.stack([rows_of[c] for rows_of, c in rows])
        out = np.empty((len(q), len(q)))
        rests = np.array(self.rests, dtype=int)
        for resting in range(3):
            which = rests[:, None] + rests[None] == resting
            if np.any(which):
                out[which] = self.times.matrix(q, q, resting)[which]
        out *= self.factor
        for i, j in self.blocked:
            out[i, j] = self._guess(i, j, q[i : i + 1], q[j : j + 1])[0, 0]
        for (i, a, j, b), value in self.known.items():
            if chosen[i] == a and chosen[j] == b:
                out[i, j] = value
        np.fill_diagonal(out, 0.0)
        return out

    def time(self, leg: Leg) -> float:
        """Time of a leg, known or estimated [s]."""
        if leg in self.known:
            return self.known[leg]
        begin, end = self.rows(leg)
        return float(self._guess(leg[0], leg[2], begin[None], end[None])[0, 0])

    def best_configurations(self, order: Sequence[int]) -> tuple[float, list[int]]:
        """Best configurations for nodes in a given order, by dynamic programming.

        Args:
            order: Nodes, the start and the end among them.

        Returns:
            Time of all legs [s], and the configuration of each.
        """
        cost = np.zeros(len(self.nodes[order[0]]))
        came: list[Array] = []
        for i, j in pairwise(order):
            through = cost[:, None] + self.block(i, j)
            came.append(np.argmin(through, axis=0))
            cost = np.min(through, axis=0)
        chosen = [int(np.argmin(cost))]
        for back in reversed(came):
            chosen.append(int(back[chosen[-1]]))
        return float(np.min(cost)), chosen[::-1]


def _near(rows: Array, q: Array) -> BoolArray:
    """Which configurations, shape (..., n), are near to one, shape (n,)."""
    return np.asarray(np.max(np.abs(rows - q), axis=-1) < NEAR)
