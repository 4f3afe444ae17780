"""What holds a whole cycle back: motors and obstacles, and where the stations are.

What a motor or an obstacle costs is the sum over the motions. The legs of a tour end at
configurations, which tell nothing of the place of a station: for that the two motions
that meet there are looked at as one, with the goal of the station between them, so that
the arm may reach a place that is moved in another way.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import chain

from tominpmp.exceptions import ProblemError
from tominpmp.problem import Problem
from tominpmp.segments import Segment, known_names
from tominpmp.sensitivities import Sensitivities, analyse
from tominpmp.sensitivities.records import Sensitivity
from tominpmp.solution import Solution
from tominpmp.tours.joining import joined
from tominpmp.tours.station import Station
from tominpmp.tours.tour import Tour

# Times that are the same [s].
SAME = 1e-9
# Where small changes of two motions promise more than this share of their time, what
# the place between them is worth is not known.
MOST_PROMISE = 0.02


def cycle_sensitivities(tour: Tour) -> Sensitivities:
    """How the time of a cycle changes with each limit, obstacle and station.

    Args:
        tour: The tour.

    Returns:
        The sum over the motions, and records of kind "goal" for the places of stations
        whose goals are about a frame and at which the arm stops.

    Raises:
        ProblemError: If there is no tour, or a motion has no multipliers.
    """
    if not tour.success or not tour.motions:
        raise ProblemError(f"there is no tour: {tour.message}", "trajectory")
    parts = []
    for motion in tour.motions:
        found = motion.sensitivities
        kept = tuple(item for item in found if item.kind != "goal")
        parts.append(replace(found, records=kept))
    whole = Sensitivities.of_cycle(parts, T=tour.cycle_time)
    return replace(whole, records=(*whole.records, *_places(tour)))


def _places(tour: Tour) -> Iterator[Sensitivity]:
    """Records of the stations between two motions."""
    named = {station.name: station for station in tour.stations}
    last: Station | None = None
    end = tour.stays[0]
    legs = zip(tour.motions, tour.motions[1:], tour.stays[1:], strict=False)
    for before, after, stay in legs:
        end += before.T
        first, until = end - SAME, end + stay + SAME
        here = [v.station for v in tour.visits if first <= v.arrival <= until]
        end += stay
        station = named[here[0]] if len(here) == 1 else None
        alone = not before.problem.segments and not after.problem.segments
        if station is not None and station.goal.configuration is None and alone:
            found = _place(tour.problem, last, station, before, after)
            if found is not None:
                yield found.scaled((before.T + after.T) / tour.cycle_time)
        last = named[here[-1]] if here else last


def _place(
    problem: Problem,
    last: Station | None,
    station: Station,
    before: Solution,
    after: Solution,
) -> Sensitivity | None:
    """What the place of a station is worth to the motions that meet there."""
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
