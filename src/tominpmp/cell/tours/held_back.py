"""What holds a whole cycle back: motors and obstacles, and where the stations are.

What a motor or an obstacle costs is the sum over the motions. The legs of a tour end at
configurations, which tell nothing of the place of a station: for that the two motions
that meet there are looked at as one, with the goal of the station between them, so that
the arm may reach a place that is moved in another way.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import chain

from tominpmp.cell.tours.joining import joined
from tominpmp.cell.tours.station import Station
from tominpmp.exceptions import ProblemError
from tominpmp.problem import Problem
from tominpmp.segments import Segment, known_names
from tominpmp.sensitivities import Sensitivities, analyse
from tominpmp.sensitivities.records import Sensitivity
from tominpmp.solution import Solution

# Times that are the same [s].
SAME = 1e-9
# Where small changes of two motions promise more than this share of their time, what
# the place between them is worth is not known.
MOST_PROMISE = 0.02


def cycle_sensitivities(
    problem: Problem,
    stations: Sequence[Station],
    motions: Sequence[Solution],
    stays: Sequence[float],
    arrivals: Sequence[tuple[str, float]],
) -> Sensitivities:
    """How the time of a cycle changes with each limit, obstacle and station.

    Args:
        problem: Robot, obstacles and limits.
        stations: The stations.
        motions: The motions of the cycle.
        stays: How long the arm stays at the start, and after each motion [s].
        arrivals: Names of stations, and when they are reached [s], in their order.

    Returns:
        The sum over the motions, and records of kind "goal" for the places of stations
        whose goals are about a frame and at which the arm stops.

    Raises:
        ProblemError: If a motion has no multipliers.
    """
    parts = []
    for motion in motions:
        found = motion.sensitivities
        kept = tuple(item for item in found if item.kind != "goal")
        parts.append(replace(found, records=kept))
    T = sum(motion.T for motion in motions) + sum(stays)
    whole = Sensitivities.of_cycle(parts, T=T)
    named = {station.name: station for station in stations}
    last: Station | None = None
    places, end = [], stays[0]
    for before, after, stay in zip(motions, motions[1:], stays[1:], strict=False):
        end += before.T
        first, until = end - SAME, end + stay + SAME
        here = [name for name, arrival in arrivals if first <= arrival <= until]
        end += stay
        alone = not before.problem.segments and not after.problem.segments
        if len(here) == 1 and alone:
            place = _place(problem, last, named[here[0]], before, after)
            if place is not None:
                places.append(place.scaled((before.T + after.T) / T))
        last = named[here[-1]] if here else last
    return replace(whole, records=(*whole.records, *places))


def _place(
    problem: Problem,
    last: Station | None,
    station: Station,
    before: Solution,
    after: Solution,
) -> Sensitivity | None:
    """What the place of a station is worth to the motions that meet there.

    None where the goal is a configuration, or nothing is known.
    """
    if station.goal.configuration is not None:
        return None
    one, other = before.trajectory, after.trajectory
    assert one is not None and other is not None  # noqa: S101 (of a tour)
    begin = Segment(
        station.goal,
        payload=None if last is None else last.payload,
        may_touch=_touching(before, last, station),
        stop=True,
    )
    then = Segment(
        after.problem.goal,
        payload=station.payload,
        may_touch=_touching(after, station),
    )
    both = replace(
        problem,
        q_start=before.problem.q_start,
        goal=then.goal,
        segments=[begin, then],
    )
    try:
        found = analyse(both, joined([one, other], [0.0, 0.0, 0.0]))
    except ProblemError:
        return None  # no multipliers, or a goal that is none of a segment
    if found.promise > MOST_PROMISE:
        return None
    places = [r for r in found if r.kind == "goal" and r.joint is None]
    own = [r for r in places if r.subject.endswith("of segment 1")]
    return replace(own[0], subject=station.name) if own else None


def _touching(motion: Solution, *stations: Station | None) -> list[tuple[str, str]]:
    """Pairs that may touch on a motion, of what is there."""
    known = known_names(motion.problem.robot, motion.problem.scene)
    given = chain.from_iterable(s.may_touch for s in stations if s is not None)
    return [pair for pair in given if set(pair) <= known]
