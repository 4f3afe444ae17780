"""The whole cycle: its motions and stays as one motion, and what holds it back.

What a motor or an obstacle costs is the sum over the motions. The legs of a tour end at
configurations, which tell nothing of the place of a station: for that the two motions
that meet there are looked at as one, with the goal of the station between them, so that
the arm may reach a place that is moved in another way.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np

from tominpmp.arrays import Array
from tominpmp.cell.tours.station import Station
from tominpmp.exceptions import ProblemError
from tominpmp.motion.trajectory import InverseDynamics, Trajectory
from tominpmp.problem import Problem
from tominpmp.problem.segments import Segment, known_names, segments_of
from tominpmp.sensitivities import Sensitivities, analyse
from tominpmp.sensitivities.records import Sensitivity
from tominpmp.solution import Solution

# Nodes that a motion of degree 5 is given where others are of lower degree.
FINE = 0.01


def joined(motions: Sequence[Trajectory], stays: Sequence[float]) -> Trajectory:
    """Join motions that begin where the one before ends, at rest.

    Args:
        motions: The motions.
        stays: How long the arm stays at the start, and at the end of each [s].

    Returns:
        One motion; its segments are the motions, each with the stay at its end.
    """
    pieces = [[p.trajectory for p in segments_of(motion, ())] for motion in motions]
    parts = [part for some in pieces for part in some]
    waits = [
        stay if part is some[-1] else 0.0
        for some, stay in zip(pieces, stays[1:], strict=True)
        for part in some
    ]
    if len({part.degree for part in parts}) > 1:
        parts = [_cubic(part) for part in parts]
    ends, now = list[float](), 0.0
    rows: dict[str, list[Array]] = {name: [] for name in ("t", "q", "v", "u", "a")}
    for number, (part, wait) in enumerate(zip(parts, waits, strict=True)):
        found = _with_stays(part, stays[0] if number == 0 else 0.0, wait)
        nodes, first = found["t"].size, now
        now += float(found["t"][-1])
        found["t"] = first + found["t"]
        ends.append(now)
        for name, values in found.items():
            # Where one part ends, the nodes of the next one begin.
            every = len(values) < nodes or number == len(parts) - 1
            rows[name].append(values if every else values[:-1])
    dynamics = [p.inverse_dynamics for p in parts if p.inverse_dynamics is not None]
    known = len(dynamics) == len(parts)
    several = len({id(_robot_of(function)) for function in dynamics}) > 1
    arrays: dict[str, Any] = {
        name: np.concatenate(some) for name, some in rows.items() if some
    }
    return Trajectory(
        parts[0].joint_names,
        **arrays,
        inverse_dynamics=dynamics[0] if known else None,
        segment_ends=np.array(ends),
        segment_dynamics=tuple(dynamics) if known and several else (),
    )


def _robot_of(dynamics: InverseDynamics) -> object:
    """The robot whose torques a function gives; itself where that is not known."""
    owner = getattr(dynamics, "__self__", None)
    return getattr(owner, "robot", dynamics)


def _with_stays(part: Trajectory, before: float, after: float) -> dict[str, Array]:
    """Arrays of a motion with stays before and after it [s]."""
    found = {"t": part.t, "q": part.q, "v": part.v, "u": part.u}
    if part.a is not None:
        found["a"] = part.a
    dynamics = part.inverse_dynamics or part.holding
    for stay, row in ((before, 0), (after, -1)):
        if stay <= 0.0:
            continue
        q, rest = part.q[row][None], np.zeros_like(part.q[row])[None]
        u = part.u[row][None] if dynamics is None else dynamics(q, rest, rest)
        if row == 0:
            t = np.append(-stay, found["t"]) + stay
        else:
            t = np.append(found["t"], found["t"][-1] + stay)
            # Just after the arrival the arm is held.
            found["u"] = np.concatenate([found["u"][:-1], u])
        for name, value in {"q": q, "v": rest, "u": u, "a": rest}.items():
            if name in found:
                both = [value, found[name]] if row == 0 else [found[name], value]
                found[name] = np.concatenate(both)
        found["t"] = t
    return found


def _cubic(part: Trajectory) -> Trajectory:
    """A motion by positions and velocities alone: exact up to degree 3."""
    if part.degree < 5:
        return replace(part, a=None)
    fine = [
        np.linspace(a, b, 2 + int((b - a) / FINE))[:-1]
        for a, b in zip(part.t[:-1], part.t[1:], strict=True)
    ]
    t = np.append(np.concatenate(fine), part.t[-1])
    state = part(t)
    return replace(part, t=t, q=state.q, v=state.v, u=state.u, a=None)


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
