"""Path-velocity decomposition: when to wait on a path for moving obstacles.

A path is given, and moving obstacles cross it, or constraints forbid a part of it for
a part of the motion. Whether the arm is free depends on the path parameter and on the
time: in the plane of these two, the curve that arrives first is sought by going,
waiting and going back (path-velocity decomposition, Kant and Zucker, 1986). The arm
never goes faster than on the timed path it follows, and the time of waiting is part of
the motion: T counts from the start.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from tominpmp.arrays import Array, BoolArray, IntArray
from tominpmp.collision.checker import CollisionChecker
from tominpmp.constraints.path import PathConstraint, Window
from tominpmp.initial_guess.guess import ANYWHERE, SAMPLED, Guess, initial_guesses
from tominpmp.transcription.problem_functions import ProblemFunctions

# Number of places on the path, and the shortest time between two [s].
PLACES = 60
SHORTEST = 5e-3
# Configurations that are checked for one path, at most.
CHECKS = 30_000
# Longest duration of a motion that waits, in multiples of the duration of the path, and
# a lower bound on it [s].
PATIENCE = 10.0
LONG = 10.0
# Tolerated violation of constraints on positions, as a share of their scale.
KEPT = 1e-6
# Margin of obstacles at rest, which disables them: waiting does not avoid them [m].
ANY_DEPTH = -1e6
# A cautious passage keeps this share of the reach free beside the margin.
CAUTION = 0.02
# Number of guesses without moving obstacles that come first, and the instants at which
# moving obstacles are frozen for later guesses, as shares of the time of a motion.
WITHOUT_MOVING = 4
MOMENTS = (0.5, 0.25, 0.75, 1.0)


def guesses_of(
    system: ProblemFunctions,
    count: int,
    rng: np.random.Generator,
    duration: float | None = None,
    deadline: float = np.inf,
) -> Iterator[Guess]:
    """Initial guesses for a problem, which wait for moving obstacles.

    For the arguments see :func:`~tominpmp.initial_guess.guess.initial_guesses`.
    """
    passes = system.problem.scene.moving or _passing(system)
    make = waiting_guesses if passes else initial_guesses
    made = make(system, count, rng, duration, deadline)
    yield from itertools.islice(made, count)


def _passing(system: ProblemFunctions) -> list[PathConstraint]:
    """Constraints on positions that hold during a part of the motion."""
    every = system.problem.ready_constraints
    return [item for item in every if item.order == 0 and item.window is not None]


def waiting_guesses(
    system: ProblemFunctions,
    count: int,
    rng: np.random.Generator,
    duration: float | None = None,
    deadline: float = np.inf,
) -> Iterator[Guess]:
    """Initial guesses among moving obstacles, the most promising first, without end.

    Guesses for the scene without its moving obstacles come first, each beside the same
    path with a timing that waits for the obstacles. Then paths follow that are free
    where the obstacles are frozen at an instant. For the arguments see
    :func:`~tominpmp.initial_guess.guess.initial_guesses`; ``count`` limits each of the
    two kinds.
    """
    alone = initial_guesses(system.resting(), count, rng, duration, deadline)
    first: Guess | None = None
    for guess in itertools.islice(alone, WITHOUT_MOVING):
        if guess.name == ANYWHERE:
            alone = itertools.chain([guess], alone)
            break
        first = guess if first is None else first
        yield from _with_passages(system, guess)
    if first is None:
        return
    for share in MOMENTS if system.problem.scene.moving else ():
        still = system.resting(share * first.duration)
        for guess in initial_guesses(still, count, rng, duration, deadline):
            if guess.name == ANYWHERE:
                break
            if guess.name == SAMPLED:  # the straight lines are known from above
                yield from _with_passages(system, guess)
                break
    for guess in alone:
        yield from _with_passages(system, guess)


def _with_passages(system: ProblemFunctions, guess: Guess) -> Iterator[Guess]:
    """A guess, beside its path with a timing that waits, if a timing is found.

    The guess that waits is admissible, or nearly, while the optimiser may drive a
    motion that goes through an obstacle to either side of it, or fail: the guess that
    waits comes first where obstacles move. Where constraints hold for a while, the
    optimiser mostly succeeds from the original guess.
    """
    passed = let_pass(system, guess)
    passages = [] if passed is None or passed is guess else [passed]
    if not system.problem.scene.moving:
        yield from (guess, *passages)
        return
    yield from (*passages, guess)
    slower = let_pass(system, guess, CAUTION)
    if slower is not None and slower.duration > (*passages, guess)[0].duration:
        yield slower


def let_pass(
    system: ProblemFunctions, guess: Guess, caution: float = 0.0
) -> Guess | None:
    """Traverse the path of a guess, waiting for moving obstacles and constraints.

    Args:
        system: Clearance, margin, and constraints that hold for a while.
        guess: A path over time.
        caution: Distance to keep beyond the margin, as a share of the reach.

    Returns:
        The guess that arrives first on the grid of places and times; the same guess if
        its path is free, and None if no timing is free.
    """
    clearance, holding = system.clearance, _passing(system)
    watched = clearance if clearance is not None and clearance.moving else None
    if watched is None and not holding:
        return guess
    count = min(PLACES, max(int(guess.duration / SHORTEST), 2))
    step = float(guess.duration) / count
    q = guess.position(np.linspace(0.0, guess.duration, count + 1))
    windows = [_forbidden(item, q) for item in holding]
    checker, margin = None, np.zeros(0)
    if watched is not None:
        checker, far = watched.checker, watched.margin + caution * system.reach
        margin = np.where(checker.moving_pairs, far, ANY_DEPTH)
    places = _passage(_Plane(q, step, windows, checker, margin))
    if places is None:
        return None
    if places.size == count + 1:
        return guess
    t = step * np.arange(places.size, dtype=np.float64)
    waits = step * float(np.argmax(places > 0) - 1)
    name = f"{guess.name}, waiting"
    return replace(guess, name=name, t=t, q=q[places], delay=waits)


def _forbidden(item: PathConstraint, q: Array) -> tuple[Window, BoolArray]:
    """When a constraint holds, and the places of a path that it forbids meanwhile."""
    assert item.window is not None  # noqa: S101
    rest = np.zeros(q.shape[1])
    lacks = [bool(item.lack(place, rest, KEPT)) for place in q]
    return item.window, np.array(lacks)


@dataclass(eq=False)
class _Plane:
    """Which places on a path are free at which times.

    Attributes:
        q: Configurations at the places, shape (places, n).
        step: Time between two of the times [s].
        windows: When constraints hold, and the places that they forbid meanwhile, shape
            (places,).
        checker: Checker of moving obstacles; None without any.
        margin: Margins of its pairs, shape (pairs,) [m].
        checks: How many configurations were checked.
    """

    q: Array
    step: float
    windows: list[tuple[Window, BoolArray]]
    checker: CollisionChecker | None
    margin: Array
    checks: int = 0

    def free(self, places: BoolArray, number: int) -> BoolArray:
        """The places, of given ones, that are free at a time counted in steps."""
        time = number * self.step
        out = places.copy()
        for window, forbidden in self.windows:
            # The window is widened by a step, to cover the time between the steps.
            if window.begin - self.step < time < window.end + self.step:
                out &= ~forbidden
        if self.checker is None:
            return out
        for place in np.flatnonzero(out).tolist():
            self.checks += 1
            out[place] = self.checker.is_free(self.q[place], self.margin, time)
        return out

    def ends(self, number: int) -> bool:
        """Whether the arm may stay at the end from a time on, counted in steps."""
        time = number * self.step
        return all(
            time >= window.end or not places[-1] for window, places in self.windows
        )


def _passage(plane: _Plane) -> IntArray | None:
    """Place at each step of the passage that arrives first; None without a passage."""
    here = np.zeros(len(plane.q), dtype=bool)
    here[0] = True
    reached = [here]
    most = int(max(PATIENCE * (len(plane.q) - 1), LONG / plane.step))
    while not (here[-1] and plane.ends(len(reached) - 1)):
        ahead = here.copy()
        ahead[1:] |= here[:-1]
        ahead[:-1] |= here[1:]
        here = plane.free(ahead, len(reached))
        if not here.any() or len(reached) > most or plane.checks > CHECKS:
            return None
        reached.append(here)
    # Back from the end, as long as possible without waiting: the arm waits at first.
    place = len(plane.q) - 1
    found = [place]
    for before in reversed(reached[:-1]):
        for other in (place - 1, place, place + 1):
            if 0 <= other < len(plane.q) and before[other]:
                place = other
                break
        found.append(place)
    return np.array(found[::-1], dtype=np.int64)
