"""Former motions as guesses for motions of several segments.

Each segment is bent to where it begins now, and to its goal where that is a
configuration: a difference in position is added evenly over its time.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tominpmp.exceptions import ProblemError
from tominpmp.initial_guess.segments import SegmentedGuess, solved_guess
from tominpmp.motion.joining import checked_motion
from tominpmp.motion.samples import Samples
from tominpmp.motion.trajectory import Trajectory
from tominpmp.options import Tolerances
from tominpmp.problem import Problem
from tominpmp.verification.stages import with_segments

# What such a guess is called.
FORMER = "former motion"


def former_segments(
    problem: Problem, former: Trajectory | Samples
) -> tuple[SegmentedGuess, Trajectory]:
    """A former motion as a guess.

    Args:
        problem: A problem of several segments.
        former: The motion; where it does not tell when its segments end, that is when
            it meets the goals of the problem, or comes nearest.

    Returns:
        The guess, and the motion with the ends of its segments.

    Raises:
        ProblemError: If the motion is one of other joints, or has segments of no
            length.
    """
    try:
        motion = checked_motion(former, problem.robot, problem.q_start, problem.v_start)
    except ProblemError as error:
        raise ProblemError(f"start: {error}", "start") from error
    motion = with_segments(problem, motion, Tolerances())
    guess = solved_guess(FORMER, motion, problem.segments)
    return _bent(problem, guess), motion


def _bent(problem: Problem, guess: SegmentedGuess) -> SegmentedGuess:
    """A guess that begins and ends where the problem does."""
    q = np.array(guess.q)
    limits = problem.robot.limits
    shift, first = problem.q_start - q[0], 0
    for phase, end in zip(problem.phases, guess.ends.tolist(), strict=True):
        last = int(np.argmin(np.abs(guess.t - end)))
        goal = phase.goal.configuration
        after = np.zeros_like(shift) if goal is None else goal - guess.q[last]
        share = np.linspace(0.0, 1.0, last - first + 1)[:, None]
        moved = guess.q[first : last + 1] + shift + share * (after - shift)
        q[first : last + 1] = moved
        shift, first = after, last
    q = np.clip(q, limits.position_lower, limits.position_upper)
    same = bool(np.all(np.abs(q - guess.q) <= 1e-9))
    return replace(guess, q=q, solved=same)
