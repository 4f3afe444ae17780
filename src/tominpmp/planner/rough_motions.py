"""Motions on coarse grids, and how they are compared."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tominpmp.arrays import Array
from tominpmp.initial_guess.guess import Guess
from tominpmp.motion.curves import states
from tominpmp.motion.trajectory import Trajectory
from tominpmp.planner.attempt import Attempt
from tominpmp.planner.progress import Kept
from tominpmp.transcription.problem_functions import ProblemFunctions

# Largest violation of a coarse motion that is gone on with.
NEARLY = 1e-2
# Instants at which motions are compared, and how near to each other the same ones are
# [rad, or shares of the reach].
SAMPLES = 12
SAME = 0.05


@dataclass(frozen=True, eq=False)
class Rough:
    """A motion on a coarse grid.

    Attributes:
        attempt: What led to it.
        guess: What that began with.
        shape: Configurations at even shares of its duration, shape (SAMPLES, n).
        kept: Its program and iterate.
        begun: What the first iteration began with, without rows for links.
        touches: Whether links are known to touch in it.
    """

    attempt: Attempt
    guess: Guess
    shape: Array
    kept: Kept
    begun: Kept
    touches: bool = False

    @property
    def duration(self) -> float:
        """T on the coarse grid [s]; infinite if it is far from a motion."""
        if self.attempt.violation > NEARLY:
            return np.inf
        return self.attempt.trajectory.duration


def shape_of(system: ProblemFunctions, motion: Trajectory) -> Array:
    """Configurations at even shares of the duration, scaled, shape (SAMPLES, n)."""
    shares = np.linspace(0.0, 1.0, SAMPLES)
    times = shares * motion.duration
    q, _, _ = states(motion.t, motion.q, motion.v, motion.a, times)
    return np.asarray(q / system.step_scale)


def same(one: Array, other: Array) -> bool:
    """Whether shapes are those of one motion."""
    return bool(np.max(np.abs(one - other)) < SAME)
