r"""Bumps: smooth detours from a guess, which lead to other local optima.

A motion that takes another way around an obstacle, swings or flips its elbow differs
from a given one by large arcs in some joints. A bump is such an arc:
:math:`16\,\tau^2 (1 - \tau)^2`, which is 1 halfway and vanishes at both ends with its
derivative, times the cosine of :math:`k \pi \tau`, which divides it into two or three
arcs.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tominpmp.arrays import Array
from tominpmp.initial_guess.guess import Guess, least_time
from tominpmp.transcription.problem_functions import ProblemFunctions

# Height of a bump in a single joint [rad]: smaller ones lead back to the same optimum,
# see benchmarks/known_optima.py.
HEIGHT = 2.0
# Standard deviations of the heights of random bumps in all joints, in turn [rad], and
# their factors by the number of arcs.
SPREADS = (0.8, 1.6, 0.3, 2.4)
ARCS = (1.0, 0.6, 0.4)
# Detours that are too fast by a larger factor are slowed down to it: far too fast ones
# take a hundred programs. Slower ones lead back to the straight line, although an arm
# that swings is faster.
TOO_FAST = 3.0


def bumps(
    system: ProblemFunctions,
    guess: Guess,
    rng: np.random.Generator,
    *,
    from_base: bool = False,
) -> Iterator[Guess]:
    """Detours from a guess: of single joints in both directions, then random ones.

    Args:
        system: Functions of the problem, whose position limits are kept.
        guess: The guess to which the bumps are added.
        rng: Random numbers.
        from_base: Whether the joint nearest to the base comes first, as detours of a
            wrist hardly matter; otherwise the last joint does.

    Yields:
        Guesses, without end.
    """
    order = range(system.n) if from_base else range(system.n)[::-1]
    for arcs in range(len(ARCS)):
        for joint in order:
            for height in (-HEIGHT, HEIGHT):
                heights = np.zeros((len(ARCS), system.n))
                heights[arcs, joint] = height
                yield bumped(system, guess, heights)
    while True:
        for spread in SPREADS:
            heights = rng.normal(size=(len(ARCS), system.n))
            yield bumped(system, guess, spread * np.array(ARCS)[:, None] * heights)


def bumped(system: ProblemFunctions, guess: Guess, heights: Array) -> Guess:
    """A guess with bumps, slowed down if it is far too fast with them.

    Args:
        system: Functions of the problem.
        guess: The guess, at instants spaced evenly in time.
        heights: Heights by number of arcs and joint, shape (k, n), in rad, or in shares
            of the reach for prismatic joints.
    """
    tau = guess.t / guess.duration
    arc = 16.0 * tau**2 * (1.0 - tau) ** 2
    waves = np.cos(np.pi * np.arange(len(heights)) * tau[:, None])
    limits = system.problem.robot.limits
    q = guess.q + (arc[:, None] * waves) @ (heights * system.step_scale)
    q = np.clip(q, limits.position_lower, limits.position_upper)
    too_fast = least_time(system, q) / guess.duration
    slower = max(1.0, too_fast / TOO_FAST)
    return Guess("detour", slower * guess.t, q, False)
