"""Initial guesses: a path over time that need satisfy nothing but its ends."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tominpmp.arrays import Array
from tominpmp.goals import FrameGoal, JointGoal
from tominpmp.seeding.inverse_kinematics import goal_configurations
from tominpmp.seeding.timing import time_straight_line
from tominpmp.transcription.system import System

# Random configurations tried when solving inverse kinematics for a goal on a frame.
KINEMATIC_STARTS = 20
# Durations of untimed guesses, in multiples of what the speed limits demand.
LEISURE = 2.0
# Samples of a guess.
SAMPLES = 200


@dataclass(frozen=True, eq=False)
class Guess:
    """A path over time.

    Attributes:
        name: How it came about, for reports.
        t: Times [s], increasing from 0, shape (m,).
        q: Configurations, shape (m, n) [rad or m].
        timed: Whether the duration is the least for this path.
    """

    name: str
    t: Array
    q: Array
    timed: bool

    @property
    def duration(self) -> float:
        """T [s]."""
        return float(self.t[-1])

    def position(self, times: Array) -> Array:
        """Configurations at times, shape (k, n)."""
        columns = [np.interp(times, self.t, column) for column in self.q.T]
        return np.stack(columns, axis=1)


def straight_guess(system: System, q_end: Array, name: str = "straight line") -> Guess:
    """Straight line in joint space, in minimum time where that can be told.

    Args:
        system: Dynamics and limits.
        q_end: Final configuration, shape (n,) [rad or m].
        name: Name of the guess.

    Returns:
        The guess.
    """
    problem = system.problem
    timing = time_straight_line(system, problem.q_start, q_end)
    if timing is not None:
        times = np.linspace(0.0, timing.duration, SAMPLES)
        return Guess(name, times, timing.position(times), True)
    return _smooth_guess(system, np.stack([problem.q_start, q_end]), name)


def resting_guess(system: System, duration: float) -> Guess:
    """Stay at the start for a duration [s]."""
    q = np.tile(system.problem.q_start, (2, 1))
    return Guess("at rest", np.array([0.0, duration]), q, False)


def via_guess(system: System, via: Array, q_end: Array) -> Guess:
    """Path through a configuration halfway.

    Args:
        system: Dynamics and limits.
        via: Configuration in the middle, shape (n,).
        q_end: Final configuration, shape (n,).

    Returns:
        The guess.
    """
    corners = np.stack([system.problem.q_start, via, q_end])
    return _smooth_guess(system, corners, "via point")


def _smooth_guess(system: System, corners: Array, name: str) -> Guess:
    """Quadratic Bezier curve or line, with a quintic time law from rest to rest."""
    s = np.linspace(0.0, 1.0, SAMPLES)
    s = s**3 * (10.0 + s * (6.0 * s - 15.0))
    if corners.shape[0] == 2:
        q = corners[0] + s[:, None] * (corners[1] - corners[0])
    else:
        # Passes the middle configuration at s = 1/2.
        middle = 2.0 * corners[1] - 0.5 * (corners[0] + corners[2])
        weights = np.stack([(1.0 - s) ** 2, 2.0 * s * (1.0 - s), s**2], axis=1)
        q = weights @ np.stack([corners[0], middle, corners[2]])
        limits = system.problem.robot.limits
        q = np.clip(q, limits.position_lower, limits.position_upper)
    return Guess(
        name, LEISURE * _least_time(system, q) * np.linspace(0, 1, SAMPLES), q, False
    )


def _least_time(system: System, q: Array) -> float:
    """Time scale of a path: speed limits and the torque for its accelerations [s]."""
    limits, count = system.problem.robot.limits, q.shape[0]
    unit = np.linspace(0.0, 1.0, count)
    v = np.gradient(q, unit, axis=0)
    a = np.gradient(v, unit, axis=0)
    speed = float(np.max(np.abs(v) / limits.velocity, initial=0.0))
    zero = np.zeros_like(q)
    hold = system.torque(q, zero, zero)
    need = system.torque(q, v, a) - hold
    # Friction grows with 1/T and inertia with 1/T^2; the larger bound covers both.
    room = np.maximum(1.0 - np.abs(hold), 0.1)
    ratio = float(np.max(np.abs(need) / room, initial=0.0))
    return max(speed, float(np.sqrt(ratio)), 1e-3)


def initial_guesses(
    system: System,
    count: int,
    rng: np.random.Generator,
    duration: float | None = None,
) -> Iterator[Guess]:
    """Initial guesses for a problem, the most promising first.

    Args:
        system: The problem.
        count: How many at most.
        rng: Random numbers.
        duration: Duration of the guess at rest [s]; None for that of the fastest
            straight line.

    Yields:
        At most ``count`` guesses; none if inverse kinematics did not reach the goal.
    """
    problem = system.problem
    if isinstance(problem.goal, JointGoal):
        ends = [problem.goal.q]
    elif isinstance(problem.goal, FrameGoal):
        ends, _ = goal_configurations(system, problem.goal, KINEMATIC_STARTS, rng)
    else:
        ends = []
    if not ends:
        return
    straight = [straight_guess(system, q) for q in ends]
    straight.sort(key=lambda guess: (not guess.timed, guess.duration))
    if isinstance(problem.goal, FrameGoal):
        # The paper's kind of start, which satisfies nothing: the linear programs choose
        # the final configuration themselves. It is mostly the best one to begin with.
        yield resting_guess(system, duration or straight[0].duration)
        count -= 1
    yield from straight[:count]
    limits = problem.robot.limits
    low = np.maximum(limits.position_lower, problem.q_start - np.pi)
    high = np.minimum(limits.position_upper, problem.q_start + np.pi)
    for _ in range(count - len(straight)):
        end = ends[int(rng.integers(len(ends)))]
        yield via_guess(system, rng.uniform(low, high), end)
