"""Semi-infinite exchange: rows where a motion violates its limits between the rows.

Constraints are rows at chosen instants only. After a solve the motion is inspected
between them, and the worst instants become rows of the next program (Hettich and
Kortanek, 1993), until no violation is found. The assumptions of constraints about the
motion (directions of dry friction, say) are updated at the same time.

Quantities that may jump at the nodes, as torques do, are inspected a few times an
interval. Each joint breaks its limits at an instant of its own, and a row of every
joint at each of these instants would make the programs of thirty joints twice as large:
values with a margin are no rows there, until they violate their limits.
"""

from __future__ import annotations

from dataclasses import replace
from functools import reduce
from typing import Any, NamedTuple

import numpy as np

from tominpmp.arrays import Array, BoolArray, IntArray
from tominpmp.constraints.base import Constraint
from tominpmp.constraints.friction import EFFORT_TOLERANCE
from tominpmp.constraints.path import PathConstraint
from tominpmp.constraints.torque import MotorLimit
from tominpmp.motion.extrema import between_samples
from tominpmp.transcription.base import Motion, Transcription
from tominpmp.transcription.blocks import Block, SampledRows, assumed
from tominpmp.transcription.instants import Instants
from tominpmp.transcription.program import NonlinearProgram

# Continuous values are inspected at this share of the motion, in steps between these
# [s], and at least this often an interval. With steps of 2 ms throughout, plans for the
# Fetch, whose motions take seconds, took a fifth longer.
STEP_SHARE, STEPS = 2e-3, (2e-3, 5e-3)
SAMPLES = 4
# Collision pairs closer than this beyond the required clearance are inspected more
# closely [m], as are values of other constraints closer than the second number to their
# bounds: at these places around an instant, in shares of the step.
CLOSE, CLOSE_VALUE = 1e-3, 1e-2
CLOSER_LOOK = np.arange(8) / 8 - 0.5
# Instants closer than this share of an interval count as one; instants of distances
# only if they are closer than this time, too [s]: a tip at 20 m/s moves by 3 cm in that
# share of an interval.
APART = 0.03
APART_IN_TIME = 2e-5
# The step is cut where obstacles move, until they move by no more than this share of
# the padding in it, and so often at most.
FINE, CUTS = 0.25, 2
# Numbers of instants inspected at a time, and of entries in a table of instants by
# values: tables take memory, and the verification inspects the motion again.
FEWEST_SAMPLES, MOST_SAMPLES, MOST_NUMBERS = 200, 20_000, 4_000_000
# Tolerated violation where the padding is zero.
LEAST = 1e-5
# Values with a larger margin than this are no rows at an instant that joins for other
# values, in units of their limits.
ROOM = 0.3
# Where one torque exceeds its limit by more than the tolerance, all torques that exceed
# it by this share of the tolerance become rows: most would be found one after another.
WITH_IT = 0.5
# Pairs of instants of each interval between which torque rates are taken.
RATES_INSPECTED = (
    *(0.1, 0.15, 0.22, 0.27, 0.35, 0.4, 0.475, 0.525),
    *(0.6, 0.65, 0.73, 0.78, 0.85, 0.9),
)
# Number of instants an interval at which velocities are inspected for reversals.
LOOKS = 8
# Distance from a reversal at which torques are inspected, in shares of the interval.
BESIDE = 0.02


def exchanged(
    program: NonlinearProgram, z: Array, effort_tolerance: float = EFFORT_TOLERANCE
) -> NonlinearProgram | None:
    """The program with rows where a motion violates limits between its rows.

    Args:
        program: The program.
        z: Its iterate.
        effort_tolerance: Tolerated relative excess of torques; below zero, a margin
            that torques must keep.

    Returns:
        The program; None if nothing has to change.
    """
    of = program.transcription
    motion = of.motion(z)
    blocks: list[Block] = list(program.blocks)
    changes = 0
    for index, block in enumerate(blocks):
        if isinstance(block, SampledRows):
            blocks[index], count = _exchanged(block, of, motion, effort_tolerance)
            changes += count
    return replace(program, blocks=tuple(blocks)) if changes else None


def _exchanged(
    block: SampledRows, of: Transcription[Any], motion: Motion, effort_tolerance: float
) -> tuple[SampledRows, int]:
    """A block with the assumptions of its constraint updated, and more instants.

    Returns:
        The block, and the number of changes.
    """
    constraint, count = block.constraint, 0
    if constraint.assumes:
        at, states = block.states(of, motion)
        beside = of.states(motion, at.middles, 1).v
        constraint, count = constraint.corrected(states, beside, effort_tolerance)
    more = _violated(block, of, motion, effort_tolerance)
    if more.at.size and isinstance(constraint, PathConstraint) and constraint.window:
        times = more.at.times(motion.h) + of.delays[more.at.interval]
        return replace(block, constraint=constraint.with_times(times)), more.at.size
    block, joined = _with_rows(replace(block, constraint=constraint), of, motion, more)
    return block, count + joined


def _violated(
    block: SampledRows, of: Transcription[Any], motion: Motion, effort_tolerance: float
) -> Missing:
    """Instants between the rows of a constraint at which it is violated."""
    constraint = block.constraint
    if constraint.usable is None:
        return Missing(Instants.none())
    if constraint.order >= 3:
        return Missing(rising(constraint, of, motion, effort_tolerance))
    if constraint.order >= 2:
        return jumping(constraint, of, motion, effort_tolerance, block.within)
    known = block.instants(of, motion.h)
    if block.ignored is not None:
        # A new instant may be near one at which not all values are rows.
        whole = np.ones(known.size, dtype=bool)
        whole[: len(block.ignored)] = ~np.any(block.ignored, axis=1)
        known = Instants(known.interval[whole], known.share[whole])
    return Missing(_worst_instants(constraint, of, motion, block.within, known))


def _worst_instants(
    constraint: Constraint,
    of: Transcription[Any],
    motion: Motion,
    within: tuple[int, int] | None,
    known: Instants,
) -> Instants:
    """For each interval and continuous value the worst instant, if it is violated.

    Args:
        constraint: The constraint.
        of: The transcription.
        motion: A motion of it.
        within: First interval on which it holds, and the one after its last; None for
            all.
        known: Instants that have rows; instants near them are left out.
    """
    at, missing = _closer_looks(constraint, of, motion, within or (0, of.intervals))
    worst = np.max(missing, axis=1, initial=-np.inf)
    found: list[tuple[int, float]] = []
    taken: dict[int, list[float]] = {}
    for k, share in known.pairs:
        taken.setdefault(k, []).append(share)
    for k in np.unique(at.interval).tolist():
        inside = np.flatnonzero(at.interval == k)
        block = missing[inside]
        pairs = np.flatnonzero(block.max(axis=0) > 0.0)
        peaks = inside[np.argmax(block[:, pairs], axis=0)]
        apart = APART
        if constraint.gradual:
            apart = min(apart, APART_IN_TIME / float(motion.h[k]))
        for index in sorted(set(peaks.tolist()), key=lambda i: -worst[i]):
            share = float(at.share[index])
            near = taken.setdefault(k, [])
            if all(abs(share - other) > apart for other in near):
                near.append(share)
                found.append((k, share))
    return Instants.of_pairs(found)


def _closer_looks(
    constraint: Constraint,
    of: Transcription[Any],
    motion: Motion,
    within: tuple[int, int],
) -> tuple[Instants, Array]:
    """Instants at which a continuous constraint is violated, and its violations there.

    The step is cut around instants beside which a bound may be violated: values rise
    from one to the next as they do from a sample to the next, and those of moving
    obstacles by no more than the obstacles move. Pairs that do not move are looked at
    more closely only once.
    """
    usable, h, most = constraint.usable, motion.h, most_instants(constraint.count)
    assert usable is not None  # noqa: S101
    rises = constraint.rises(float(h.sum() + of.delays[-1]))
    moving, rise = np.flatnonzero(rises > 0.0), float(np.max(rises, initial=0.0))
    at = _samples(h, most).within(*within)
    width = 1.0 / np.bincount(at.interval, minlength=h.size)[at.interval]
    attention = CLOSE / of.system.reach if constraint.gradual else CLOSE_VALUE
    if constraint.gradual:
        # Corners pass each other between instants: the tip of an arm of 5 m moves by
        # centimetres.
        v = of.states(motion, at, 1).v / of.system.step_scale
        speed = np.max(np.abs(v), axis=1, initial=0.0)
        way = 0.5 * width * h[at.interval] * speed
        attention = max(attention, float(np.max(way, initial=0.0)))
    room = FINE * float(np.max(constraint.room, initial=0.0)) + LEAST
    found: list[tuple[Instants, Array]] = []
    while True:
        excess = excess_at(constraint, of, motion, at, attention)
        missing = np.asarray(excess - usable)
        over = np.flatnonzero(np.max(missing, axis=1, initial=-np.inf) > 0.0)
        there = Instants(at.interval[over], at.share[over]), missing[over]
        near = np.zeros(0, dtype=np.int64)
        if not found:
            near = between_samples(missing, 0.0, attention)
        found.append(there)
        step = width * h[at.interval]
        if float(np.max(step, initial=0.0)) * rise > room and len(found) <= CUTS:
            ahead = excess[:, moving] + 0.5 * step[:, None] * rises[moving]
            near = np.union1d(near, np.flatnonzero(np.max(ahead, axis=1) > 0.0))
        if not near.size:
            instants, violations = zip(*found, strict=True)
            return reduce(Instants.joined, instants), np.concatenate(violations)
        near = _worst(near, missing, CLOSER_LOOK.size, most)
        share = at.share[near, None] + CLOSER_LOOK * width[near, None]
        at = Instants(np.repeat(at.interval[near], CLOSER_LOOK.size), share.ravel())
        width = np.repeat(width[near], CLOSER_LOOK.size) / CLOSER_LOOK.size
        attention = 0.5 * float(np.max(width * h[at.interval])) * rise


def most_instants(values: int) -> int:
    """Number of instants that are inspected, for a number of values at each."""
    most = MOST_NUMBERS // max(values, 1)
    return int(np.clip(most, FEWEST_SAMPLES, MOST_SAMPLES))


def _worst(near: IntArray, missing: Array, parts: int, most: int) -> IntArray:
    """The rows with the largest violations, as many as ``most`` instants allow."""
    count = max(most // parts, 1)
    if near.size <= count:
        return near
    lacking = np.max(missing[near], axis=1)
    return np.sort(near[np.argsort(-lacking, kind="stable")[:count]])


def _samples(h: Array, most: int = MOST_SAMPLES) -> Instants:
    """Instants at which to inspect continuous values; fewer a second if T is long."""
    apart = max(np.clip(STEP_SHARE * h.sum(), *STEPS), float(h.sum()) / most)
    counts: IntArray = np.maximum(np.ceil(h / apart).astype(np.int64), SAMPLES)
    interval = np.repeat(np.arange(h.size), counts)
    first = np.repeat(np.cumsum(counts) - counts, counts)
    step = np.arange(interval.size) - first
    return Instants(interval, (step + 0.5) / counts[interval])


class Missing(NamedTuple):
    """Instants at which rows are missing.

    Attributes:
        at: The instants, each of them once.
        wanted: Which values become rows there, shape (m, p); None for all of them.
    """

    at: Instants
    wanted: BoolArray | None = None


def _with_rows(
    block: SampledRows, of: Transcription[Any], motion: Motion, more: Missing
) -> tuple[SampledRows, int]:
    """A block with missing rows added.

    Args:
        block: The block.
        of: The transcription.
        motion: A motion of it, from which constraints take their assumptions.
        more: The rows.

    Returns:
        The block, and the number of instants at which it was changed: values that are
        rows already are not added twice.
    """
    new, wanted = more.at, more.wanted
    count, ignored = 0, block.ignored
    if wanted is not None:
        ignored = np.zeros((block.fixed.size, wanted.shape[1]), dtype=bool)
        if block.ignored is not None:
            ignored[: len(block.ignored)] = block.ignored
        places = {one: place for place, one in enumerate(block.fixed.pairs)}
        found = np.array([places.get(one, -1) for one in new.pairs], dtype=np.int64)
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


def excess_at(
    constraint: Constraint,
    of: Transcription[Any],
    motion: Motion,
    at: Instants,
    attention: float = np.inf,
) -> Array:
    """Excess of the values over their bounds at instants beside the rows, (m, p)."""
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
    """Rows for values that may jump at the nodes: torques, and functions of them.

    The instants are the worst of the inspected ones for each part of an interval and
    value, and instants beside reversals of joints with dry friction.

    Args:
        constraint: The constraint.
        of: The transcription.
        motion: A motion of it.
        tolerance: Tolerated excess.
        within: First interval on which it holds, and the one after its last; None for
            all.
    """
    found: dict[tuple[int, float], BoolArray] = {}
    first, end = within or (0, of.intervals)
    for shares in of.inspected:
        at = Instants.spread(of.intervals, shares).within(first, end)
        excess = excess_at(constraint, of, motion, at)
        excess = excess.reshape(end - first, len(shares), -1)
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
            for place, one in enumerate(at.pairs):
                if over[place]:
                    found[one] = excess[place] > -ROOM
    instants = sorted(found)
    wanted = [found[one] for one in instants]
    shape = len(instants), constraint.count
    return Missing(Instants.of_pairs(instants), np.reshape(wanted, shape).astype(bool))


def rising(
    constraint: Constraint, of: Transcription[Any], motion: Motion, tolerance: float
) -> Instants:
    """Pairs of instants between which rates are too large, the worst of each interval.

    One pair for each interval and value, without repetitions.
    """
    pairs = Instants.spread(of.intervals, RATES_INSPECTED)
    excess = excess_at(constraint, of, motion, pairs)
    excess = excess.reshape(of.intervals, len(RATES_INSPECTED) // 2, -1)
    worst = np.argmax(excess, axis=1)
    interval, value = np.nonzero(np.max(excess, axis=1) > tolerance)
    found = np.stack([interval, worst[interval, value]], axis=1)
    interval, pair = np.unique(found, axis=0).T
    shares = np.reshape(RATES_INSPECTED, (-1, 2))[pair]
    return Instants(np.repeat(interval, 2), shares.ravel())


def turning(
    of: Transcription[Any], motion: Motion, joints: BoolArray, within: tuple[int, int]
) -> Instants:
    """Instants before and after each reversal, shared by joints that reverse together.

    Args:
        of: The parameterisation.
        motion: The motion.
        joints: Which joints have dry friction, shape (n,).
        within: First interval that is inspected, and the one after the last.
    """
    first, end = within
    shares = tuple(np.linspace(0.0, 1.0, LOOKS + 1).tolist())
    at = Instants.spread(of.intervals, shares).within(first, end)
    v = of.states(motion, at, 1).v[:, joints].reshape(end - first, LOOKS + 1, -1)
    before, after = v[:, :-1], v[:, 1:]
    interval, look, joint = np.nonzero(before * after < 0.0)
    v0, v1 = before[interval, look, joint], after[interval, look, joint]
    # A velocity is nearly linear between two of these instants.
    share = (look + v0 / (v0 - v1)) / LOOKS
    beside = np.concatenate([share - BESIDE, share + BESIDE])
    found = np.stack([np.tile(first + interval, 2), np.clip(beside, 0.0, 1.0)], axis=1)
    found = np.unique(found, axis=0)
    return Instants(found[:, 0].astype(np.int64), found[:, 1])
