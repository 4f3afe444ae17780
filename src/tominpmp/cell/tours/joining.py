"""Motions of the legs and stays between them, as one motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tominpmp.arrays import Array
from tominpmp.segments import segments_of
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
