"""Path-velocity decomposition: when to wait on a path for moving obstacles.

Moving obstacles may cross a given path, or constraints may forbid a part of it during
a time window. Whether the arm is free then depends on the path parameter and on time.
In the plane of these two, a search over moving forwards, waiting and moving backwards
finds the curve that arrives first (path-velocity decomposition, Kant and Zucker, 1986).
The arm never moves faster than on the timed path that it follows. The waiting time is
part of the motion: T counts from the start.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from tominpmp.arrays import Array, BoolArray, IntArray
from tominpmp.collision.checker import CollisionChecker
from tominpmp.constraints.path import PathConstraint, Window
from tominpmp.initial_guess.constrained import CLOSE, constraints_of
from tominpmp.initial_guess.guess import SAMPLED, VIA_POINT, Guess, GuessRequest
from tominpmp.initial_guess.rrt import LONG, PathSearches
from tominpmp.initial_guess.timing import POINTS
from tominpmp.transcription.problem_functions import ProblemFunctions

# Shortest time step between two places on the path [s].
SHORTEST = 5e-3
# Longest duration of a motion that waits, in multiples of the duration of the path, or
# of a second if that is longer.
PATIENCE = 10.0
# Additional clearance of a cautious passage, as a share of the reach.
CAUTIOUS_MARGIN = 0.02
# Number of guesses without moving obstacles that come first, and the instants at which
# moving obstacles are frozen for later guesses, as shares of the duration of a motion.
WITHOUT_MOVING = 4
MOMENTS = (0.5, 0.25, 0.75, 1.0)


def guesses_of(system: ProblemFunctions, request: GuessRequest) -> Iterator[Guess]:
    """Initial guesses, the best first, which may wait on their paths.

    Guesses for the scene without its moving obstacles come first, each together with
    the same path timed so that it waits for obstacles and constraints, if there are
    any. Paths follow that are free if the obstacles are frozen at an instant, then
    further guesses without moving obstacles, without end. There is no guess if the goal
    is out of reach.
    """
    static = request.guesses(system.resting())
    first: Guess | None = None
    for guess in itertools.islice(static, WITHOUT_MOVING):
        if guess.name == VIA_POINT:
            static = itertools.chain([guess], static)
            break
        first = guess if first is None else first
        yield from _with_passages(system, guess)
    if first is None:
        return
    for share in MOMENTS if system.problem.scene.moving else ():
        still = system.resting(share * first.duration)
        # Obstacles frozen at this instant may leave no path, and in most cases a motion
        # is known already: the search for a path is short.
        brief = replace(request, searches=PathSearches(checks=LONG))
        for guess in brief.guesses(still):
            if guess.name == VIA_POINT:
                break
            if guess.name == SAMPLED:  # the straight lines are those from above
                yield from _with_passages(system, guess)
                break
    for guess in static:
        yield from _with_passages(system, guess)


def _with_passages(system: ProblemFunctions, guess: Guess) -> Iterator[Guess]:
    """A guess, and its path with a timing that waits, if such a timing is found.

    The guess that waits is nearly feasible. From the original guess, which passes
    through an obstacle, the optimiser may move to either side of the obstacle, or fail.
    Among moving obstacles the guess that waits therefore comes first. For constraints
    with a time window the optimiser mostly succeeds from the original guess.
    """
    waiting = _with_waiting(system, guess)
    passages = [] if waiting is None or waiting is guess else [waiting]
    if not system.problem.scene.moving:
        yield from (guess, *passages)
        return
    yield from (*passages, guess)
    slower = _with_waiting(system, guess, CAUTIOUS_MARGIN)
    if slower is not None and slower.duration > (*passages, guess)[0].duration:
        yield slower


def _with_waiting(
    system: ProblemFunctions, guess: Guess, caution: float = 0.0
) -> Guess | None:
    """Traverse the path of a guess, waiting for moving obstacles and constraints.

    Args:
        system: Clearance, margin, and constraints with a time window.
        guess: A path over time.
        caution: Additional distance beyond the margin, as a share of the reach.

    Returns:
        The guess that arrives first on the grid of places and times; the same guess if
        it need not wait, and None if no timing is free.
    """
    watched = system.clearance if system.problem.scene.moving else None
    holding = constraints_of(system, 0, timed=True)
    if watched is None and not holding:
        return guess
    count = min(POINTS, max(int(guess.duration / SHORTEST), 2))
    step = float(guess.duration) / count
    q = guess.position(np.linspace(0.0, guess.duration, count + 1))
    windows = [_forbidden(item, q) for item in holding]
    checker, margin = None, np.zeros(0)
    if watched is not None:
        checker, far = watched.checker, watched.margin + caution * system.reach
        # Waiting does not avoid obstacles at rest, which are not checked.
        margin = np.where(checker.moving_pairs, far, -np.inf)
    places = _passage(q, step, windows, checker, margin)
    if places is None:
        return None
    if places.size == count + 1:
        return guess
    t = step * np.arange(places.size, dtype=np.float64)
    waits = step * float(np.argmax(places > 0) - 1)
    name = f"{guess.name}, waiting"
    return replace(guess, name=name, t=t, q=q[places], delay=waits)


def _forbidden(item: PathConstraint, q: Array) -> tuple[Window, BoolArray]:
    """The time window of a constraint, and the places of a path that it forbids."""
    assert item.window is not None  # noqa: S101
    rest = np.zeros(q.shape[1])
    lacks = [bool(item.lack(place, rest, CLOSE)) for place in q]
    return item.window, np.array(lacks)


def _passage(
    q: Array,
    step: float,
    windows: list[tuple[Window, BoolArray]],
    checker: CollisionChecker | None,
    margin: Array,
) -> IntArray | None:
    """The place at each step of the earliest passage; None without a passage.

    Args:
        q: Configurations at the places, shape (places, n).
        step: Time step [s].
        windows: Time windows of constraints, and the places that these forbid, shape
            (places,).
        checker: Collision checker of moving obstacles; None without any.
        margin: Margins of the collision pairs, shape (pairs,) [m].
    """
    here = np.zeros(len(q), dtype=bool)
    here[0] = True
    reached, time = [here], 0.0
    most = int(PATIENCE * max(len(q) - 1, 1.0 / step))
    # From this time on the arm may remain at the end.
    over = max((window.end for window, places in windows if places[-1]), default=0.0)
    while not (here[-1] and time >= over):
        time = step * len(reached)
        ahead = here.copy()
        ahead[1:] |= here[:-1]
        ahead[:-1] |= here[1:]
        for window, places in windows:
            # The window is widened by a step, to cover the time between two steps.
            if window.begin - step < time < window.end + step:
                ahead &= ~places
        if checker is not None:
            tried = np.flatnonzero(ahead)
            ahead[tried] = list(checker.each_free(q[tried], margin, time))
        here = ahead
        if not here.any() or len(reached) > most:
            return None
        reached.append(here)
    # Traced back from the end with as few waits as possible: the arm waits early.
    place = len(q) - 1
    passage = [place]
    for before in reversed(reached[:-1]):
        nearby = (place - 1, place, place + 1)
        place = next(k for k in nearby if 0 <= k < len(q) and before[k])
        passage.append(place)
    return np.array(passage[::-1], dtype=np.int64)
