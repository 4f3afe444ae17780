"""Initial guesses for motions of several segments.

Each segment begins where the previous one ends. It stops at its goal if it begins at
rest and the goal gives no velocity. The optimiser need not keep the stops: a guess must
be feasible only at its ends.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache, partial

import numpy as np

from tominpmp.arrays import Array
from tominpmp.constraints.path import PathConstraint
from tominpmp.initial_guess.constrained import constraints_of
from tominpmp.initial_guess.guess import REST_GUESS, CachedGuesses, Guess, GuessRequest
from tominpmp.initial_guess.inverse_kinematics import end_velocity
from tominpmp.initial_guess.path import speed_weights
from tominpmp.initial_guess.path_velocity import guesses_of
from tominpmp.initial_guess.rrt import PathSearches
from tominpmp.initial_guess.unreachable import unreachable
from tominpmp.transcription.problem_functions import ProblemFunctions


def segmented_guesses(
    system: ProblemFunctions, request: GuessRequest
) -> Iterator[Guess]:
    """Guesses through the goals of all segments; see :func:`guesses_of`.

    The first guess joins the first guesses of all segments, the second guess their
    second guesses, and so on, without end.

    Raises:
        ProblemError: If no configuration was found to reach a goal.
    """
    share = request.duration and request.duration / len(system.parts)
    each = replace(request, duration=share)
    lone = len(system.parts) == 1

    onward = _times_onward(system, each)

    @cache
    def from_state(
        place: int, q: tuple[float, ...], v: tuple[float, ...]
    ) -> tuple[ProblemFunctions, CachedGuesses]:
        """The functions and the guesses of a segment from a state."""
        part, ahead = system.parts[place], _constraints_after(system, place)
        single = _alone(part, np.array(q), np.array(v)).passing(np.array([q]))
        passes = part.problem.goal.stopped is not part.problem.goal
        own = replace(
            each,
            beyond=ahead,
            passes=passes,
            onward=onward[place],
            searches=PathSearches(),
        )
        guesses = guesses_of(single, own)
        # A guess at rest at the start does not lead to the start of the next segment.
        moving = (guess for guess in guesses if lone or guess.name != REST_GUESS)
        return single, CachedGuesses(moving)

    for number in itertools.count():
        pieces: list[Guess] = []
        q, v = system.problem.q_start, system.problem.v_start
        for place in range(len(system.parts)):
            single, guesses = from_state(place, tuple(q), tuple(v))
            guess = next(guesses.since(number), None)
            if guess is None:
                if number:
                    return
                where = f"segment {place + 1} of {len(system.parts)}: "
                ahead = _constraints_after(system, place)
                raise unreachable(single, request.rng, ahead, where)
            pieces.append(guess)
            final = single.problem.goal.configuration
            q = guess.q[-1] if final is None else final
            v = end_velocity(single, q)
        yield _joined(pieces)


def _times_onward(
    system: ProblemFunctions, request: GuessRequest
) -> list[Callable[[Array], float] | None]:
    """Estimates of the time from the end of each segment to the end of the motion.

    Dynamic programming over configurations that reach the later goals, between which
    the joints move at their speed limits (Bellman, 1957). Without it, each segment ends
    where it ends soonest, however far the next goal is from there.

    Args:
        system: Functions of the problem.
        request: The request for guesses.

    Returns:
        Functions of the final configuration of each segment, shape (n,); None for the
        last segment, and for all of them if no choice can be made.
    """
    count, q = len(system.parts), system.problem.q_start
    times: list[Callable[[Array], float] | None] = [None] * count
    if all(part.final_configuration is not None for part in system.parts[:-1]):
        return times
    weights = speed_weights(system.problem.robot.limits.velocity)
    layers: list[Array] = []
    for place, part in enumerate(system.parts):
        single = _alone(part, q, np.zeros_like(q)).passing(np.array([q]))
        own = replace(request, beyond=_constraints_after(system, place))
        ends, _ = own.final_configurations(single)
        if not ends:
            return times
        layers.append(np.stack(ends))
        q = ends[0]
    left = np.zeros(len(layers[-1]))
    for place in reversed(range(count - 1)):
        onward = partial(_least_time_through, layers[place + 1], left, weights)
        times[place], left = onward, np.array([onward(q) for q in layers[place]])
    return times


def _least_time_through(ends: Array, left: Array, weights: Array, q: Array) -> float:
    """Least time from a configuration through one of several others [s].

    Args:
        ends: The other configurations, shape (m, n).
        left: Time from each of them to the end of the motion [s], shape (m,).
        weights: Times per displacement of each joint at its speed limit, shape (n,).
        q: The configuration, shape (n,).
    """
    return float(np.min(np.max(np.abs(ends - q) * weights, axis=1) + left))


def _joined(pieces: list[Guess]) -> Guess:
    """The guesses of all segments one after another."""
    ends = np.cumsum([0.0, *(guess.duration for guess in pieces)])
    t = [begin + guess.t[1:] for begin, guess in zip(ends[:-1], pieces, strict=True)]
    return Guess(
        "segments",
        np.concatenate([[0.0], *t]),
        np.concatenate([pieces[0].q[:1], *(guess.q[1:] for guess in pieces)]),
        all(guess.timed for guess in pieces),
        inner_ends=ends[1:-1],
    )


def _constraints_after(system: ProblemFunctions, place: int) -> list[PathConstraint]:
    """Constraints on positions that hold from the end of a segment on.

    Args:
        system: Functions of the problem.
        place: Number of the segment, from 0.
    """
    if place + 1 >= len(system.parts):
        return []
    return constraints_of(system.parts[place + 1], 0)


def _alone(part: ProblemFunctions, q: Array, v: Array) -> ProblemFunctions:
    """The functions of a segment from a state; from rest, it stops at a via point."""
    goal = part.problem.goal if np.any(v) else part.problem.goal.stopped
    problem = part.problem._altered(q_start=q, v_start=v, goal=goal)
    return replace(part, problem=problem)
