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

import numpy as np

from tominpmp.arrays import Array
from tominpmp.cell.tours.station import Station
from tominpmp.exceptions import ProblemError
from tominpmp.problem import Problem
from tominpmp.segments import Segment, known_names, segments_of
from tominpmp.sensitivities import Sensitivities, analyse
from tominpmp.sensitivities.records import Sensitivity
from tominpmp.solution import Solution
from tominpmp.trajectory import InverseDynamics, Trajectory

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
    pieces = [_segments(motion) for motion in motions]
    parts = _alike([piece for some in pieces for piece in some])
    waits = [
        stay if k == len(some) - 1 else 0.0
        for some, stay in zip(pieces, stays[1:], strict=True)
        for k in range(len(some))
    ]
    t = [np.zeros(1)]
    q: list[Array] = []
    v: list[Array] = []
    u: list[Array] = []
    a: list[Array] = []
    ends: list[float] = []
    dynamics: list[InverseDynamics] = []
    now = 0.0
    for number, (part, wait) in enumerate(zip(parts, waits, strict=True)):
        times = part.t
        nodes: list[Nodes] = [(part.q, part.v, part.u, part.a)]
        if number == 0 and stays[0] > 0.0:
            times = np.concatenate([[0.0], stays[0] + part.t])
            nodes.insert(0, _still(part, 0))
        if wait > 0.0:
            times = np.append(times, times[-1] + wait)
            nodes.append(_still(part, -1))
        last = number == len(parts) - 1
        _append(nodes, wait > 0.0, last, q, v, u, a)
        t.append(now + times[1:])
        now += float(times[-1])
        ends.append(now)
        if part.inverse_dynamics is not None:
            dynamics.append(part.inverse_dynamics)
    alike = len({id(_robot_of(function)) for function in dynamics}) <= 1
    return Trajectory(
        parts[0].joint_names,
        np.concatenate(t),
        np.concatenate(q),
        np.concatenate(v),
        np.concatenate(u),
        a=np.concatenate(a) if a else None,
        inverse_dynamics=dynamics[0] if len(dynamics) == len(parts) else None,
        segment_ends=np.array(ends),
        segment_dynamics=() if alike or len(dynamics) < len(parts) else tuple(dynamics),
    )


def _robot_of(dynamics: InverseDynamics) -> object:
    """The robot whose torques a function gives; itself where that is not known."""
    owner = getattr(dynamics, "__self__", None)
    return getattr(owner, "robot", dynamics)


Nodes = tuple[Array, Array, Array, Array | None]


def _still(part: Trajectory, row: int) -> Nodes:
    """A node at which the arm stays."""
    q, v = part.q[row][None], np.zeros_like(part.q[row])[None]
    dynamics = part.inverse_dynamics or part.holding
    u = part.u[row][None] if dynamics is None else dynamics(q, v, v)
    return q, v, u, v if part.a is not None else None


def _append(
    nodes: list[Nodes],
    waits: bool,
    last: bool,
    q: list[Array],
    v: list[Array],
    u: list[Array],
    a: list[Array],
) -> None:
    """Add nodes of one part; where it ends, those of the next one begin."""
    rows = [np.concatenate([node[k] for node in nodes]) for k in range(3)]
    if waits:
        # Just after the arrival the arm is held.
        rows[2][-2] = rows[2][-1]
    for out, row in zip((q, v, u), rows, strict=True):
        out.append(row if last else row[:-1])
    accelerations = [node[3] for node in nodes]
    if accelerations[0] is None:
        return
    size = len(rows[0])
    found = np.concatenate([item for item in accelerations if item is not None])
    if len(found) == size - 1:
        a.append(found)
    elif len(found) >= size:
        a.append(found[:size] if last else found[: size - 1])


def _segments(motion: Trajectory) -> list[Trajectory]:
    """The segments of a motion, each from time 0."""
    return [part.trajectory for part in segments_of(motion, ())]


def _alike(parts: Sequence[Trajectory]) -> list[Trajectory]:
    """The same motions as polynomials of one degree, from rest to rest."""
    degrees = {part.degree for part in parts}
    if len(degrees) == 1:
        return list(parts)
    return [_cubic(part) for part in parts]


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
