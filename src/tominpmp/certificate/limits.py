"""Limits of a motion as linear rows on its small changes.

Between the nodes torques follow the inverse dynamics, speeds and positions the
accelerations: they are limited at the nodes, and at interior maxima between them. Other
constraints of a problem are sampled finely in time, and are rows where they are nearest
to their bounds.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array, BoolArray, IntArray
from tominpmp.certificate.clearances import contacts
from tominpmp.certificate.limit_rows import GOAL, SEGMENT, LimitRows
from tominpmp.certificate.motion import Motion, MotionStates
from tominpmp.certificate.perturbations import (
    BEGIN,
    END,
    JUST_INSIDE,
    MEAN,
    Instants,
    Linearised,
    Stencil,
)
from tominpmp.motion.extrema import local_maxima
from tominpmp.motion_limits import SIDES
from tominpmp.problem.joint_limits import JointBounds, joint_limits

# Kind of the rows of arrival times.
ARRIVAL = "arrival"
# Shares of the intervals at which torques, speeds and positions are inspected.
SHARES = np.arange(1, 10) / 10
# Values are rows inside an interval where they exceed the values at both of its ends by
# the first share of their limits, and are above the second share of them.
BULGE = 1e-3
NEAR = 0.97
# A torque that is smaller in the middle by less than this runs along its limit.
FLAT = 1e-2
# Positions are rows inside an interval where their slack is below the first number
# [rad, or shares of the reach] and they turn back by more than the second.
ROOM, TURN = 0.05, 1e-5
# Shares of intervals at which other constraints are always rows: middles and ends.
REGULAR = (0.5, 1.0)
# Samples of an interval between which the nearest instants of constraints are searched.
SAMPLES = 16
# Constraints farther below their bounds, in units of their scale, are no rows.
NEAR_CONSTRAINT = 0.1


def limits_of(motion: Motion, near: bool = True) -> LimitRows:
    """Rows of all limits, of one segment after the other, and of the goals.

    Args:
        motion: The motion.
        near: Whether distances are rows: they need all meshes cut into convex pieces.
    """
    found = [*_arrivals(motion)]
    for number, part in enumerate(motion.segments):
        inside = part.states(Instants.spread(part.span, SHARES))
        smooth = motion.changes.shape != "torques"
        found += [*_efforts(part), *_over_speed(part, inside if smooth else None)]
        found += _slopes(part)
        for item in joint_limits(part.task.problem):
            if item.kind.of in ("q", "v") or (smooth and item.kind.of == "u"):
                found.append(_bulging(part, inside, item))
        own = [*(_clearances(part) if near else ()), *_constraints(part)]
        found += [_of_segment(number, rows) for rows in own]
    goals = enumerate(map(_goal, motion.segments))
    found += [_of_segment(number, rows) for number, rows in goals]
    return LimitRows.joined(found)


def _of_segment(number: int, rows: LimitRows) -> LimitRows:
    """Rows whose subjects are numbered within a segment, not in the whole motion."""
    return replace(rows, subject=rows.subject + number * SEGMENT)


def _rows(
    motion: Motion,
    kind: str,
    at: MotionStates,
    subject: IntArray,
    room: Sequence[Array],
    *slopes: Array,
    rates: Array | None = None,
    **more: Any,
) -> LimitRows:
    """Rows of quantities that depend on the state at instants.

    Args:
        motion: The motion.
        kind: Name of the rows.
        at: The motion at their instants, m of them.
        subject: Joints or pairs.
        room: Slack below and above.
        *slopes: Derivatives by position, velocity and acceleration, up to the order of
            the quantity, shape (m, n).
        rates: Partial derivatives by time [1/s], shape (m,), if obstacles move.
        **more: Other attributes of the rows.
    """
    change = motion.changes.values(at.at, at.q, at.v, *slopes)
    if rates is not None:
        change = motion.changes.with_time(change, at.at, rates)
    by_state = np.zeros((subject.size, 2 * motion.changes.n))
    if "by_torque" not in more:
        both = np.hstack(slopes[:2])
        by_state[:, : both.shape[1]] = both
    below, above = room
    name = np.array(kind)
    return LimitRows(name, at.at, subject, below, above, by_state, change, **more)


def _one_of(joint: IntArray, n: int, value: Array) -> Array:
    """Slopes with a value for one joint in each row, shape (m, n)."""
    out = np.zeros((joint.size, n))
    out[np.arange(joint.size), joint] = value
    return out


# -- torques at the nodes, their slopes, and jerks -------------------------------------


def _rows_of_joints(
    motion: Motion,
    kind: str,
    interval: IntArray,
    joints: IntArray,
    stencil: Stencil,
    limit: Array,
    load: Array | None = None,
    accelerations: bool = False,
) -> LimitRows:
    """Rows of sums over ends of intervals, of torques or else of accelerations.

    Args:
        motion: The motion.
        kind: Name of the rows.
        interval: The intervals, shape (k,).
        joints: The joints.
        stencil: Ends of intervals, and their weights.
        limit: Limits of the joints, shape (joints,).
        load: Used shares of the limits, shape (k, joints); None where the sums are
            rises, whose slopes are limited.
        accelerations: Whether the sums are of accelerations.
    """
    changes, n, shape = motion.changes, motion.changes.n, (interval.size, joints.size)
    change = changes.nothing(interval.size * joints.size)
    total, none = np.zeros(shape), np.zeros((len(interval), n, n))
    for shift, end, weight in stencil:
        at, scale = motion.ends(interval + shift, end), weight / limit[:, None]
        slopes = [none, none, none + np.eye(n)]
        if not accelerations:
            slopes = [part[end::2][interval + shift] for part in motion.parts[1:]]
        each = [scale * part[:, joints] for part in slopes]
        change += changes.values(at.at, at.q, at.v, *each)
        total += (at.a if accelerations else at.u)[:, joints] * scale.T
    share = sum(end * weight for _, end, weight in stencil)
    if load is None:
        share, load = 0.5, total / changes.apart(interval)[:, None]
        change = changes.slopes(change, load, interval)
    # A joint without a motor obeys its equation of motion in the mean.
    bound = 0.0 * load if kind == "passive" else np.ones(shape)
    load = 0.0 * load if kind == "passive" else load
    return LimitRows(
        np.array(kind),
        Instants(np.repeat(interval, joints.size), np.full(load.size, share)),
        np.tile(joints, interval.size),
        (-bound - load).ravel(),
        (bound - load).ravel(),
        np.zeros(2 * n),
        change,
        by_torque=np.tile((not accelerations) / limit, interval.size),
        mean=np.array(stencil is MEAN),
    )


def _efforts(motion: Motion) -> Iterator[LimitRows]:
    """Torques at the nodes, as shares of their limits."""
    half, driven = motion.task.effort_half, motion.driven
    passive, interval = np.setdiff1d(np.arange(half.size), driven), motion.intervals
    asked = [("passive", passive, MEAN, interval)]
    if motion.changes.shape == "torques":
        asked.append(("effort", driven, MEAN, interval))
    else:
        whole = motion.changes.shape == "ramps" and motion.number is None
        # With ramps, an end of an interval is the beginning of the next one.
        last = interval[-1:] if whole else interval
        asked += [("effort", driven, BEGIN, interval), ("effort", driven, END, last)]
    for kind, joints, stencil, own in asked:
        load = motion.load if stencil is MEAN else motion.loads[:, stencil[0][1]]
        load = load[own][:, joints]
        if joints.size:
            yield _rows_of_joints(
                motion, kind, own, joints, stencil, half[joints], load
            )


def _slopes(motion: Motion) -> Iterator[LimitRows]:
    """Slopes of torques and accelerations over time, as shares of limits."""
    changes, interval = motion.changes, motion.intervals
    interval = interval[interval <= changes.N - changes.passing.size]
    for item in joint_limits(motion.task.problem):
        if item.kind.smooth:
            most, of = item.upper[item.joints], item.kind.of == "j"
            name, rise = item.kind.name, changes.rise
            rows = interval, item.joints, rise, most
            yield _rows_of_joints(motion, name, *rows, accelerations=of)


# -- torques, speeds and positions inside the intervals --------------------------------


def _largest(
    motion: Motion,
    inside: Array,
    ends: Array,
    near: float = NEAR - 1.0,
    more: float = BULGE,
) -> tuple[IntArray, IntArray]:
    """Instants and joints of interior maxima of values near their limits.

    Args:
        motion: The motion.
        inside: Excesses over limits at all instants, shape (m, n).
        ends: Excesses at both ends of all intervals, shape (N, 2, n).
        near: Excess above which a value is near its limit.
        more: Least difference of a maximum to the values at the ends.

    Returns:
        Indices of the instants and joints, shape (k,) each.
    """
    values = inside.reshape(-1, SHARES.size, inside.shape[1])
    peak, worst = np.max(values, axis=1), np.argmax(values, axis=1)
    beside = np.max(ends[slice(*motion.span)], axis=1)
    interval, joint = np.nonzero((peak > near) & (peak > beside + more))
    return interval * SHARES.size + worst[interval, joint], joint


def _at_ends(values: Array) -> Array:
    """Values at nodes, at both ends of the intervals, shape (N, 2, n)."""
    return np.stack([values[:-1], values[1:]], axis=1)


def _bulging(motion: Motion, inside: MotionStates, item: JointBounds) -> LimitRows:
    """Rows of interior maxima of positions, speeds or torques."""
    task, changes, of, name = motion.task, motion.changes, item.kind.of, item.kind.name
    values, ends, unit = {
        "q": (inside.q, _at_ends(changes.q), task.step_scale),
        "v": (inside.v, _at_ends(changes.v), item.upper),
        "u": (inside.u, motion.u, task.effort_half),
    }[of]
    excess = item.outside(values) / unit
    if of == "u":
        # Where a torque runs along its limit, the middle is a row as well as the ends,
        # whose mean changes differently.
        excess[SHARES.size // 2 :: SHARES.size] += FLAT
        excess[:, np.setdiff1d(np.arange(changes.n), motion.driven)] = -np.inf
    near, more = (-ROOM, TURN) if of == "q" else (NEAR - 1.0, BULGE)
    index, joint = _largest(motion, excess, item.outside(ends) / unit, near, more)
    if of == "v" and changes.shape == "ramps":
        index, joint = _with_light_joints(motion, excess * unit, index, joint)
    at, value, unit = inside.kept(index), values[index, joint], unit[joint]
    room = (item.lower[joint] - value) / unit, (item.upper[joint] - value) / unit
    if of == "u":
        return _rows_of_torques(motion, name, at, joint, room, 1.0 / unit, 0.0 * unit)
    by = _one_of(joint, changes.n, 1.0 / unit)
    if of == "q":
        return _rows(motion, name, at, joint, room, by, unit=unit)
    return _rows(motion, name, at, joint, room, 0.0 * by, by)


def _with_light_joints(
    motion: Motion, beyond: Array, index: IntArray, joint: IntArray
) -> tuple[IntArray, IntArray]:
    """Rows of speeds, and middles of intervals where a speed may get its maximum.

    An acceleration that is raised at the beginning of an interval and lowered at its
    end leaves the speeds at both ends unchanged; for light joints the change is large.

    Args:
        motion: The motion.
        beyond: Speeds beyond their limits at all instants, shape (m, n).
        index: Instants that are rows, shape (k,).
        joint: Their joints, shape (k,).
    """
    inertia = np.einsum("mii->mi", motion.parts.tau_a).mean(axis=0)
    strongest = 2.0 * motion.task.effort_half / np.maximum(inertia, 1e-12)
    every, h = SHARES.size, motion.changes.h[slice(*motion.span)]
    light = h[:, None] * strongest / 8.0 > -beyond[every // 2 :: every]
    light[index // every, joint] = False
    interval, more = np.nonzero(light)
    index = np.append(index, interval * every + every // 2)
    return index, np.append(joint, more)


def _rows_of_torques(
    motion: Motion,
    kind: str,
    at: MotionStates,
    joint: IntArray,
    room: tuple[Array, Array],
    by_torque: Array,
    by_speed: Array,
) -> LimitRows:
    """Rows of the torques of joints at an instant each, with a term in the speed."""
    every = np.arange(joint.size)
    parts = motion.task.dynamics.inverse_jacobians(at.q, at.v, at.a)[1:]
    slopes = [by_torque[:, None] * part[every, joint] for part in parts]
    slopes[1] += _one_of(joint, motion.changes.n, by_speed)
    return _rows(motion, kind, at, joint, room, *slopes, by_torque=by_torque)


def _over_speed(motion: Motion, inside: MotionStates | None) -> Iterator[LimitRows]:
    """Rows of torque limits over speed: at nodes, and at interior maxima."""
    looked_at = [motion.ends(motion.intervals, end) for end in (0, 1)]
    ends = motion.u, _at_ends(motion.changes.v)
    for item in joint_limits(motion.task.problem):
        for (own, bound), side in product(item.by_speed.items(), SIDES):
            kind, at = item.kind, looked_at
            unit = kind.scale(bound, float(motion.task.effort_half[own]))
            if inside is not None:
                use, at_ends = (
                    kind.excess(bound, u[..., own], v[..., own], side)[0] / unit
                    for u, v in ((inside.u, inside.v), ends)
                )
                index, _ = _largest(motion, use[:, None], at_ends[:, :, None])
                at = [*looked_at, inside.kept(index)]
            for states in at:
                found = kind.excess(bound, states.u[:, own], states.v[:, own], side)
                excess, by_u, by_v = (part / unit for part in found)
                joint, none = np.full(excess.size, own), np.full(excess.size, -np.inf)
                rows = motion, kind.name, states, joint, (none, -excess)
                yield _rows_of_torques(*rows, by_u, by_v)


# -- clearances and constraints of the problem -----------------------------------------


def _clearances(motion: Motion) -> Iterator[LimitRows]:
    """Distances that are near their margins, as shares of the reach."""
    found = contacts(motion)
    if found is not None:
        yield _rows(
            motion,
            "clearance",
            motion.states(motion.changes.instants(found.times)),
            found.pairs,
            (np.full(found.missing.size, -np.inf), -found.missing),
            found.slopes,
            rates=found.rates if motion.task.problem.checker.moving else None,
            unit=np.array(motion.task.reach),
        )


def _constraints(motion: Motion) -> Iterator[LimitRows]:
    """Constraints of the problem that are near their limits."""
    for index, item in enumerate(motion.task.problem.ready_constraints):
        shares = np.arange(1, SAMPLES + 1) / SAMPLES
        regular = np.isin(shares, REGULAR)
        if item.order > 1:
            # Accelerations jump at the nodes: both sides are inspected.
            shares, regular = np.append(JUST_INSIDE, shares), np.append(True, regular)
        at = motion.states(Instants.spread(motion.span, shares).inside)
        values = item.value_rows(at.q, at.v, at.a)
        lower, upper = item.bounds(len(values))
        excess = np.maximum(values - upper, lower - values)
        if item.window is not None:
            holds = item.window.asked(motion.changes.times(at.at))
            excess = np.where(holds[:, None], excess, -np.inf)
        kept = _beside(local_maxima(excess))
        kept |= np.tile(regular, len(values) // regular.size)[:, None]
        k, which = np.nonzero((excess > -NEAR_CONSTRAINT) & kept)
        if not k.size:
            continue
        used, place = np.unique(k, return_inverse=True)
        _, *by = item.term_rows(at.q[used], at.v[used], at.a[used])
        slopes = [
            part[place, which] if part.size else np.zeros((k.size, motion.changes.n))
            for part in by
        ]
        own, here, rates = at.kept(k), values[k, which], None
        if item.window is not None:
            # The window is fixed in time: a state that the change of lengths brings
            # earlier moves on until the instant of the row. Rates of accelerations are
            # small and left out.
            rates = -np.einsum("kj,kj->k", slopes[0], own.v)
            rates -= np.einsum("kj,kj->k", slopes[1], own.a)
        share = np.where(own.at.share >= 1.0 - JUST_INSIDE, 1.0, own.at.share)
        yield _rows(
            motion,
            item.name,
            own._replace(at=Instants(own.at.interval, share)),
            np.full(k.size, index),
            (lower[k, which] - here, upper[k, which] - here),
            *slopes,
            rates=rates,
            unit=np.array(item.scale),
            component=which,
        )


def _beside(flags: BoolArray) -> BoolArray:
    """Flagged rows, and the rows before and after them, shape (m, p)."""
    out = flags.copy()
    out[1:] |= flags[:-1]
    out[:-1] |= flags[1:]
    return out


# -- goals, and arrival times ----------------------------------------------------------


def _arrivals(motion: Motion) -> Iterator[LimitRows]:
    """Rows of the arrival times of segments that limit them."""
    changes, T, stayed = motion.changes, float(motion.changes.t[-1]), 0.0
    segments = motion.task.problem.segments
    for number, (part, segment) in enumerate(
        zip(motion.segments, segments, strict=False)
    ):
        if segment.arrival is not None:
            end = part.span[1]
            room = (np.array(segment.arrival) - stayed - float(changes.t[end])) / T
            before = np.where(np.arange(changes.N) < end, 1.0 / T, 0.0)
            yield LimitRows(
                np.array(ARRIVAL),
                Instants(np.array([end - 1]), np.ones(1)),
                np.array([number]),
                room[:1],
                room[1:],
                np.zeros(2 * changes.n),
                Linearised(sp.csr_matrix((1, changes.size)), sp.csr_matrix(before)),
                unit=np.array(T),
            )
        stayed += segment.dwell


def _goal(motion: Motion) -> LimitRows:
    """Rows of the goal at the end of a segment."""
    task, changes, node = motion.task, motion.changes, motion.span[1]
    q, v = changes.q[node], changes.v[node]
    goal = task.problem.goal.nearest(task.kinematics, q, v)
    value, by_q, by_v = goal.residual(task.kinematics, q, v)
    lower, upper = goal.bounds(task.kinematics)
    loose = lower < upper
    below, above = (np.where(loose, side - value, 0.0) for side in (lower, upper))
    at, every = motion.ends(np.full(value.size, node - 1), 1), np.arange(value.size)
    return _rows(motion, GOAL, at, every, (below, above), by_q, by_v)
