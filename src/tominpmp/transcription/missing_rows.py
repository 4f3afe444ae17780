"""Rows that a block lacks: instants between its rows, and which values there.

What may jump at the nodes, as torques do, is looked at a few times an interval. Each
joint breaks its limits at an instant of its own, and a row of every joint at each of
these would make the programs of thirty joints twice as large: values with room to spare
are no rows there, until they lack some.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from tominpmp.arrays import Array, BoolArray
from tominpmp.constraints import Constraint, PathConstraint
from tominpmp.constraints.torque import MotorLimit
from tominpmp.transcription.base import Motion, Transcription
from tominpmp.transcription.blocks import Sampled, assumed
from tominpmp.transcription.instants import Instants
from tominpmp.transcription.turning import turning

# Values with more room than this are no rows at an instant that joins for others, in
# units of their limits.
ROOM = 0.3
# Where one torque is beyond its limit by more than is let pass, all that are beyond by
# this share of it become rows: most would be found one after the other.
WITH_IT = 0.5
# Intervals whose values stay below their bounds by this, bent eight times as much as a
# parabola through three of them, are looked at no closer; all are if more than this
# share of them is near, as what is known of regular instants is not found again.
FAR, MOST = 0.05, 0.5
# Torque rates are taken between such pairs of instants of each interval.
RATES_INSPECTED = (
    *(0.1, 0.15, 0.22, 0.27, 0.35, 0.4, 0.475, 0.525),
    *(0.6, 0.65, 0.73, 0.78, 0.85, 0.9),
)


class Missing(NamedTuple):
    """Instants at which rows are missing.

    Attributes:
        at: The instants, none of them twice.
        wanted: Which values become rows there, shape (m, p); None for all of them.
    """

    at: Instants
    wanted: BoolArray | None = None


def with_rows(
    block: Sampled, of: Transcription[Any], motion: Motion, more: Missing
) -> tuple[Sampled, int]:
    """A block with the rows that it lacks.

    Args:
        block: The block.
        of: The transcription.
        motion: A motion of it, which tells what constraints take for granted.
        more: The rows.

    Returns:
        The block, and at how many instants it was changed: one that has all that is
        wanted there does not get it twice.
    """
    new, wanted = more.at, more.wanted
    count, ignored = 0, block.ignored
    if wanted is not None:
        ignored = np.zeros((block.fixed.size, wanted.shape[1]), dtype=bool)
        if block.ignored is not None:
            ignored[: len(block.ignored)] = block.ignored
        places = {one: place for place, one in enumerate(_pairs(block.fixed))}
        found = np.array([places.get(one, -1) for one in _pairs(new)], dtype=np.int64)
        known = found >= 0
        lacking = ignored[found[known]] & wanted[known]
        ignored[found[known]] &= ~wanted[known]
        count = int(np.any(lacking, axis=1).sum())
        new = Instants(new.interval[~known], new.share[~known])
        ignored = np.concatenate([ignored, ~wanted[~known]])
    if new.size:
        constraint = block.constraint
        constraint = constraint.joined(assumed(constraint, of, motion, new))
        block = replace(block, constraint=constraint, fixed=block.fixed.joined(new))
    return replace(block, ignored=ignored), count + new.size


def _pairs(at: Instants) -> list[tuple[int, float]]:
    return list(zip(at.interval.tolist(), at.share.tolist(), strict=True))


def listed(found: list[tuple[int, float]]) -> Instants:
    """Instants from pairs of an interval and a share of it."""
    return Instants(
        np.array([k for k, _ in found], dtype=np.int64),
        np.array([share for _, share in found]),
    )


def excess_at(
    constraint: Constraint,
    of: Transcription[Any],
    motion: Motion,
    at: Instants,
    attention: float = np.inf,
) -> Array:
    """What values are beyond their bounds at other instants than the rows', (m, p)."""
    states = of.states(motion, at, constraint.order)
    constraint = assumed(constraint, of, motion, at)
    values = constraint.evaluate(states, attention)
    lower, upper = constraint.bounds(at.size)
    if isinstance(constraint, PathConstraint) and constraint.window is not None:
        holds = constraint.window.asked(states.t)[:, None]
        values = np.where(holds, values, np.clip(values, lower, upper))
    if np.all(np.isinf(lower)):
        return np.asarray(values - upper)
    return np.maximum(values - upper, lower - values)


def jumping(
    constraint: Constraint,
    of: Transcription[Any],
    motion: Motion,
    tolerance: float,
    within: tuple[int, int] | None,
) -> Missing:
    """Rows for what may jump at the nodes: torques, and what depends on them.

    For each part of an interval and value the worst of the instants that are looked at,
    and those beside which joints with dry friction turn.

    Args:
        constraint: The constraint.
        of: The transcription.
        motion: A motion of it.
        tolerance: What is let pass.
        within: First interval on which it holds, and the one after its last; None for
            all.
    """
    found: dict[tuple[int, float], BoolArray] = {}
    first, end = within or (0, of.intervals)
    for shares in of.inspected:
        excess = _looked_at(constraint, of, motion, shares, (first, end))
        worst, largest = np.argmax(excess, axis=1), np.max(excess, axis=1)
        if not np.any(largest > tolerance):
            continue
        over = largest > (WITH_IT if tolerance > 0.0 else 1.0) * tolerance
        for k, j in np.argwhere(over).tolist():
            place = worst[k, j]
            found[first + k, shares[place]] = excess[k, place] > -ROOM
    if isinstance(constraint, MotorLimit) and constraint.motors.friction is not None:
        joints = constraint.motors.friction > 0.0
        at = turning(of, motion, joints, (first, end))
        if at.size:
            excess = excess_at(constraint, of, motion, at)
            over = np.any(excess > tolerance, axis=1)
            for place, one in enumerate(_pairs(at)):
                if over[place]:
                    found[one] = excess[place] > -ROOM
    instants = sorted(found)
    wanted = [found[one] for one in instants]
    shape = len(instants), constraint.count
    return Missing(listed(instants), np.reshape(wanted, shape).astype(bool))


def _looked_at(
    constraint: Constraint,
    of: Transcription[Any],
    motion: Motion,
    shares: tuple[float, ...],
    within: tuple[int, int],
) -> Array:
    """What values are beyond their bounds at shares of intervals, shape (m, s, p).

    Three of the shares tell where that may be anything: a parabola through them stays
    below the largest of the three plus an eighth of its second difference. Where all of
    that would have to be far off, the others are not looked at, and minus infinity.

    Args:
        constraint: The constraint.
        of: The transcription.
        motion: A motion of it.
        shares: The shares, s of them.
        within: The first of the intervals, and the one after their last.
    """
    first, end = within

    def looked(some: tuple[float, ...]) -> Array:
        at = Instants.spread(of.intervals, some).within(first, end)
        found = excess_at(constraint, of, motion, at)
        return found.reshape(end - first, len(some), -1)

    few = [0, len(shares) // 2, len(shares) - 1]
    if len(shares) <= len(few):
        return looked(shares)
    rough = looked(tuple(shares[k] for k in few))
    bend = np.abs(rough[:, 0] - 2.0 * rough[:, 1] + rough[:, 2])
    near = np.any(rough.max(axis=1) + bend > -FAR, axis=1)
    out = np.full((end - first, len(shares), rough.shape[2]), -np.inf)
    out[:, few] = rough
    if not near.any():
        return out
    rest = [k for k in range(len(shares)) if k not in few]
    others = tuple(shares[k] for k in rest)
    if near.mean() > MOST:
        out[:, rest] = looked(others)
        return out
    at = Instants(
        np.repeat(first + np.flatnonzero(near), len(rest)),
        np.tile(others, int(near.sum())),
    )
    found = excess_at(constraint, of, motion, at)
    out[np.ix_(near, rest)] = found.reshape(-1, len(rest), rough.shape[2])
    return out


def rising(
    constraint: Constraint, of: Transcription[Any], motion: Motion, tolerance: float
) -> Instants:
    """Pairs of instants between which rates are too large, the worst of each interval.

    One pair for each interval and value, without repetitions.
    """
    pairs = Instants.spread(of.intervals, RATES_INSPECTED)
    excess = excess_at(constraint, of, motion, pairs)
    excess = excess.reshape(of.intervals, len(RATES_INSPECTED) // 2, -1)
    worst, over = np.argmax(excess, axis=1), np.max(excess, axis=1) > tolerance
    found = {(int(k), int(worst[k, j])) for k, j in np.argwhere(over)}
    return listed(
        [
            (k, share)
            for k, pair in sorted(found)
            for share in RATES_INSPECTED[2 * pair : 2 * pair + 2]
        ]
    )
