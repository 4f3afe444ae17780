"""Initial guesses for motions of several segments.

Each segment begins where the previous one ends. It stops at its goal if it begins at
rest and the goal gives no velocity. The optimiser need not keep the stops: a guess must
be feasible only at its ends.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cache, partial

import numpy as np

from tominpmp.arrays import Array
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
    count = len(system.parts)
    beyond = [*(constraints_of(part, 0) for part in system.parts[1:]), []]
    each = [
        replace(
            request,
            # Alternatives share the goals of their segments, which are copied later.
            goal_key=(place, id(part.problem.goal)),
            duration=request.duration and request.duration / count,
            beyond=beyond[place],
            passes=part.problem.goal.stopped is not part.problem.goal,
        )
        for place, part in enumerate(system.parts)
    ]
    onward = _times_onward(system, each)

    @cache
    def from_state(
        place: int, q: tuple[float, ...], v: tuple[float, ...]
    ) -> tuple[ProblemFunctions, PathSearches, CachedGuesses]:
        """The functions, the searches and the guesses of a segment from a state."""
        single = _alone(system.parts[place], np.array(q), np.array(v))
        own = replace(each[place], onward=onward[place], searches=PathSearches())
        guesses = guesses_of(single, own)
        # A guess at rest at the start does not lead to the start of the next segment.
        moving = (guess for guess in guesses if count == 1 or guess.name != REST_GUESS)
        return single, own.searches, CachedGuesses(moving)

    for number in itertools.count():
        pieces, impasses = list[Guess](), list[str]()
        q, v = system.problem.q_start, system.problem.v_start
        for place in range(count):
            single, searches, guesses = from_state(place, tuple(q), tuple(v))
            guess = next(guesses.since(number), None)
            if guess is None:
                if number:
                    return
                where = f"segment {place + 1} of {count}: "
                raise unreachable(single, request.rng, each[place].beyond, where)
            pieces.append(guess)
            if searches.impasse:
                impasses.append(f"on segment {place + 1}, {searches.impasse}")
            final = single.problem.goal.configuration
            q = guess.q[-1] if final is None else final
            v = end_velocity(single, q)
        request.searches.impasse = "".join(impasses[:1])
        yield _joined(pieces)


def _times_onward(
    system: ProblemFunctions, requests: Sequence[GuessRequest]
) -> list[Callable[[Array], float] | None]:
    """Estimates of the time from the end of each segment to the end of the motion.

    Dynamic programming over configurations that reach the later goals, between which
    the joints move at their speed limits (Bellman, 1957). Without it, each segment ends
    where it ends soonest, however far the next goal is from there.

    Args:
        system: Functions of the problem.
        requests: The request for guesses of each segment.

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
    for part, request in zip(system.parts, requests, strict=True):
        single = _alone(part, q, np.zeros_like(q))
        ends, _ = request.final_configurations(single)
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


def _alone(part: ProblemFunctions, q: Array, v: Array) -> ProblemFunctions:
    """The functions of a segment from a state; from rest, it stops at a via point."""
    goal = part.problem.goal if np.any(v) else part.problem.goal.stopped
    problem = part.problem._altered(q_start=q, v_start=v, goal=goal)
    return replace(part, problem=problem).passing(q[None])
