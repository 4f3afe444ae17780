"""Initial guesses for motions of several segments: from goal to goal, at rest there.

Each segment begins where the one before it ends. The stops at the goals do not bind the
optimiser: of a guess only the ends need be admissible.
"""

from __future__ import annotations

import copy
import itertools
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from tominpmp.arrays import Array
from tominpmp.constraints.path import PathConstraint
from tominpmp.exceptions import ProblemError
from tominpmp.initial_guess.constrained import held_positions
from tominpmp.initial_guess.guess import RESTING, Guess, initial_guesses
from tominpmp.initial_guess.path_velocity import waiting_guesses
from tominpmp.problem.problem import Problem
from tominpmp.transcription.problem_functions import ProblemFunctions


def segmented_guesses(
    system: ProblemFunctions,
    count: int,
    rng: np.random.Generator,
    duration: float | None = None,
    deadline: float = np.inf,
    *,
    smooth: bool = False,
) -> Iterator[Guess]:
    """Guesses through the goals of all segments; see :func:`initial_guesses`.

    The first guess joins the first guesses of all segments, the second guess their
    second guesses, as long as every segment has one. If accelerations are continuous,
    each guess comes twice where goals are passed, to pass them at once and to stop
    there first: which leads to the better motion is not known beforehand.
    """
    share = None if duration is None else duration / len(system.parts)
    twice = smooth and at_rest_on_the_way(system) is not system
    for number in range(count):
        known = number % 2 and twice
        if not known:
            place = number // 2 if twice else number
            guess = _guess(system, place, rng, share, deadline)
        if guess is None:
            return
        yield replace(guess, stops=True) if known else guess


def _guess(
    system: ProblemFunctions,
    number: int,
    rng: np.random.Generator,
    duration: float | None,
    deadline: float,
) -> Guess | None:
    """One guess; None if a goal cannot be reached."""
    found: list[Guess] = []
    q = system.problem.q_start
    for place, part in enumerate(system.parts):
        alone = _from(part, q)
        if part.problem.scene.moving:
            guesses = waiting_guesses(alone, number + 2, rng, duration, deadline)
        else:
            ahead = following(system, place)
            guesses = initial_guesses(
                alone, number + 2, rng, duration, deadline, beyond=ahead
            )
        # A guess that rests at its start does not lead on to the next segment.
        moving = (g for g in guesses if g.name != RESTING or len(system.parts) == 1)
        made = [*itertools.islice(moving, number + 1)]
        if not made:
            return None
        found.append(made[-1])
        final = alone.problem.goal.configuration
        q = made[-1].q[-1] if final is None else final
    t, positions, begin = [np.zeros(1)], [found[0].q[:1]], 0.0
    for guess in found:
        t.append(begin + guess.t[1:])
        positions.append(guess.q[1:])
        begin += guess.duration
    return Guess(
        found[0].name if len({guess.name for guess in found}) == 1 else "segments",
        np.concatenate(t),
        np.concatenate(positions),
        all(guess.timed for guess in found),
        inner_ends=np.cumsum([guess.duration for guess in found])[:-1],
    )


def following(system: ProblemFunctions, place: int) -> list[PathConstraint]:
    """Constraints on positions that hold from the end of a segment on.

    Args:
        system: The functions of the problem.
        place: Number of the segment, from 0.
    """
    if place + 1 >= len(system.parts):
        return []
    return held_positions(system.parts[place + 1].problem)


def unreached(
    system: ProblemFunctions, rng: np.random.Generator
) -> tuple[int, ProblemFunctions]:
    """The first segment whose goal no guess reaches from the end of the segment before.

    Returns:
        The number of the segment, from 0, and its functions.
    """
    q = system.problem.q_start
    for number, part in enumerate(system.parts):
        alone, ahead = _from(part, q), following(system, number)
        guess = next(initial_guesses(alone, 1, rng, beyond=ahead), None)
        if guess is None:
            return number, alone
        q = guess.q[-1]
    raise ProblemError("segments: no guess of a motion through their goals", "segments")


def at_rest_on_the_way(system: ProblemFunctions) -> ProblemFunctions:
    """The problem with a stop at the goals of all segments; itself if all have one."""
    parts = [_from(part, part.problem.q_start) for part in system.parts]
    goals = zip(parts, system.parts, strict=True)
    if all(one.problem.goal is other.problem.goal for one, other in goals):
        return system
    return replace(system, parts=tuple(parts))


def _from(part: ProblemFunctions, q: Array) -> ProblemFunctions:
    """The functions of a segment that begins and ends at rest."""
    problem: Problem = copy.copy(part.problem)
    goal = problem.goal.stopped
    object.__setattr__(problem, "q_start", q)
    object.__setattr__(problem, "goal", goal)
    object.__setattr__(problem, "v_start", np.zeros_like(q))
    problem.__dict__["checker"] = part.problem.checker
    return replace(part, problem=problem)
