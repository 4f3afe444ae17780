"""Least times between configurations, joint by joint, many at once.

Without torque limits and obstacles the joints do not know of each other: the least time
between two configurations at rest is that of the slowest joint, which speeds up, runs
at its speed limit and slows down. It is what no motion beats, and near what is planned
where limits of speed and acceleration rule.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tominpmp.arrays import Array
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
