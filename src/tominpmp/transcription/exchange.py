"""Row exchange for semi-infinite constraints: rows where a motion violates limits.

Constraints have rows at chosen instants only. After a solve the motion is inspected
between these instants, and the instants with the largest violations become rows of the
next program (Hettich and Kortanek, 1993), until no violation is found. The assumptions
of constraints about the motion (such as the signs of dry friction) are updated at the
same time.

Quantities that may jump at the nodes, as torques do, are inspected at a few instants of
each interval. Different joints violate their limits at different instants, and rows of
all joints at each of these instants would double the size of the programs of thirty
joints: values with a margin are left out of the rows, until they violate their limits.

A motion depends on the clearance rows that joined its program. Without them, a program
on another grid would let the motion pass through obstacles between the nodes, appear
faster than is feasible, and have to exchange the same rows again: these rows are
transferred to it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np

from tominpmp.arrays import Array, BoolArray, IntArray
from tominpmp.constraints.base import Constraint
from tominpmp.constraints.friction import EFFORT_TOLERANCE
from tominpmp.constraints.path import PathConstraint
from tominpmp.constraints.torque import MotorLimit
from tominpmp.motion.extrema import between_samples
from tominpmp.transcription.base import Motion
from tominpmp.transcription.blocks import Block, SampledRows
from tominpmp.transcription.instants import Instants
from tominpmp.transcription.program import NonlinearProgram

# Continuous values are inspected in steps of this share of the duration, within these
# least and largest steps [s], and at least PARTS times in each interval. With steps of
# 2 ms throughout, plans for the Fetch, whose motions take seconds, took a fifth longer.
STEP_SHARE, STEPS = 2e-3, (2e-3, 5e-3)
# Values with a margin smaller than this are inspected more closely: the first is for
# collision pairs, beyond the required clearance [m], the second for other values. At a
# warm start torques with a smaller margin than the second are nearly active: their rows
# join its first program.
CLOSE, CLOSE_VALUE = 1e-3, 1e-2
# Number of equal parts into which an inspection divides an interval, or a step.
PARTS = 8
# Instants of the closer inspection around an instant, in shares of the step.
CLOSER_LOOK = (np.arange(PARTS) + 0.5) / PARTS - 0.5
# Instants closer than this share of the duration count as one: in a second a tip at
# 20 m/s moves by 0.4 mm during it.
APART = 2e-5
# The step is refined until obstacles move in it, or values rise in half of it, by no
# more than this share of the padding, at most this number of times.
FINE, CUTS = 0.25, 2
# Largest number of instants inspected in one pass, and of entries in a table of
# instants by values: tables take memory, and the verification inspects the motion
# again.
MOST_SAMPLES, MOST_NUMBERS = 20_000, 4_000_000
# Tolerated violation if the padding is zero.
LEAST = 1e-5
# As soon as one torque exceeds its limit by more than the tolerance, all torques that
# exceed theirs by this share of the tolerance become rows: otherwise most of them would
# join one after another.
JOINING_SHARE = 0.5
# Pairs of shares of each interval, around the ends of its parts, between which torque
# rates are inspected.
RATES_INSPECTED = tuple(
    (np.arange(1, PARTS)[:, None] / PARTS + (-0.025, 0.025)).ravel().tolist()
)
# Torques are inspected at this distance from a reversal, in shares of the interval.
REVERSAL_OFFSET = 0.005


def exchanged(
    program: NonlinearProgram, z: Array, effort_tolerance: float = EFFORT_TOLERANCE
) -> NonlinearProgram | None:
    """The program with more rows where a motion violates limits between its rows.

    Args:
        program: The program.
        z: Iterate of the program.
        effort_tolerance: Tolerated relative excess of torques; a negative value is a
            margin that torques must keep.

    Returns:
        The program; None if no rows and no assumptions change.
    """
    motion = program.transcription.motion(z)
    blocks: list[Block] = list(program.blocks)
    changes = 0
    for index, block in enumerate(blocks):
        if isinstance(block, SampledRows):
            inspection = Inspection(block, motion, effort_tolerance)
            blocks[index], count = inspection.exchanged()
            changes += count
    return replace(program, blocks=tuple(blocks)) if changes else None


@dataclass(frozen=True, eq=False)
class Inspection:
    """Inspection of a motion between the rows of a constraint.

    Attributes:
        block: The rows.
        motion: The motion.
        tolerance: Tolerated relative excess of torques; a negative value is a margin
            that torques must keep.
    """

    block: SampledRows
    motion: Motion
    tolerance: float = EFFORT_TOLERANCE

    @property
    def constraint(self) -> Constraint:
        """The constraint, with its assumptions at the rows."""
        return self.block.constraint

    @property
    def within(self) -> tuple[int, int]:
        """Half-open range of the intervals on which the constraint holds."""
        return self.block.within or (0, self.block.scheme.intervals)

    def exchanged(self) -> tuple[SampledRows, int]:
        """The block with updated assumptions, and rows at more instants.

        Returns:
            The block, and the number of changes.
        """
        block, of, motion = self.block, self.block.scheme, self.motion
        constraint, count = block.constraint, 0
        if isinstance(constraint, MotorLimit) and constraint.assumes:
            at, states = block.states(motion)
            middle_v = of.states(motion, at.middles, 1).v
            constraint, count = constraint.corrected(states, middle_v, self.tolerance)
        new, fixed = self._violated(), block.fixed
        if not new.size:
            return replace(block, constraint=constraint), count
        if isinstance(constraint, PathConstraint) and constraint.window:
            times = new.times(motion.h) + of.delays[new.interval]
            constraint = constraint.with_times(times)
        else:
            fixed = fixed.joined(new)
        if isinstance(constraint, MotorLimit):
            constraint = constraint.joined(block.assumed(motion, new))
        return replace(block, constraint=constraint, fixed=fixed), count + new.size

    def _violated(self) -> Instants:
        """Instants between the rows at which the constraint is violated."""
        if self.constraint.usable is None:
            return Instants.of_pairs(())
        if self.constraint.order >= 2:
            return self.violated_jumps()
        return self.worst_instants()

    def worst_instants(self) -> Instants:
        """Instant of the largest violation for each interval and violated value.

        The values of the constraint are continuous. Instants near those that have rows
        are left out.
        """
        h = self.motion.h
        apart = APART * float(h.sum())
        at, excess = self._violations()
        worst = np.max(excess, axis=1, initial=-np.inf)
        found: list[tuple[int, float]] = []
        taken: dict[int, list[float]] = {}
        for k, share in self.block.instants(h).pairs:
            taken.setdefault(k, []).append(share)
        for k in np.unique(at.interval).tolist():
            inside = np.flatnonzero(at.interval == k)
            values = excess[inside]
            violated = np.flatnonzero(values.max(axis=0) > 0.0)
            peaks = inside[np.argmax(values[:, violated], axis=0)]
            for index in sorted(set(peaks.tolist()), key=lambda i: -worst[i]):
                share = float(at.share[index])
                near = taken.setdefault(k, [])
                if all(abs(share - other) * h[k] > apart for other in near):
                    near.append(share)
                    found.append((k, share))
        return Instants.of_pairs(found)

    def _violations(self) -> tuple[Instants, Array]:
        """Instants at which a continuous constraint is violated, and its violations.

        The step is refined around instants near which a bound may be violated. Between
        two samples, values are assumed to rise no faster than from one sample to the
        next, and clearances to moving obstacles to shrink no faster than the obstacles
        move. While no violation is found, the step is refined further where values may
        rise by more than a share of the padding between two samples: a corner that
        passes another one is near for a fraction of a millisecond.
        """
        constraint, of, h = self.constraint, self.block.scheme, self.motion.h
        usable, most = constraint.usable, most_instants(constraint.count)
        assert usable is not None  # noqa: S101
        rises = constraint.rises(float(h.sum() + of.delays[-1]))
        moving, rise = np.flatnonzero(rises > 0.0), float(np.max(rises, initial=0.0))
        at = _samples(h, most).within(*self.within)
        width = 1.0 / np.bincount(at.interval, minlength=h.size)[at.interval]
        attention = CLOSE / of.system.reach if constraint.gradual else CLOSE_VALUE
        if constraint.gradual:
            # Two corners may pass each other between instants: the tip of an arm of 5 m
            # moves by centimetres in a step.
            v = of.states(self.motion, at, 1).v / of.system.step_scale
            speed = np.max(np.abs(v), axis=1, initial=0.0)
            way = 0.5 * width * h[at.interval] * speed
            attention = max(attention, float(np.max(way, initial=0.0)))
        fine = FINE * float(np.max(constraint.room, initial=0.0)) + LEAST
        found: list[tuple[Instants, Array]] = []
        while True:
            excess = self.excess(at, attention)
            violation = np.asarray(excess - usable)
            over = np.flatnonzero(np.max(violation, axis=1, initial=-np.inf) > 0.0)
            near = np.zeros(0, dtype=np.int64)
            if not any(instants.size for instants, _ in found):
                tolerated = fine if found else 0.0
                near = between_samples(violation, tolerated, attention)
            found.append((at[over], violation[over]))
            step = width * h[at.interval]
            if float(np.max(step, initial=0.0)) * rise > fine:
                ahead = excess[:, moving] + 0.5 * step[:, None] * rises[moving]
                near = np.union1d(near, np.flatnonzero(np.max(ahead, axis=1) > 0.0))
            if not near.size or len(found) > CUTS:
                every, violations = zip(*found, strict=True)
                return reduce(Instants.joined, every), np.concatenate(violations)
            near = _worst(near, violation, CLOSER_LOOK.size, most)
            share = at.share[near, None] + CLOSER_LOOK * width[near, None]
            at = Instants(np.repeat(at.interval[near], CLOSER_LOOK.size), share.ravel())
            width = np.repeat(width[near], CLOSER_LOOK.size) / CLOSER_LOOK.size
            approach = 0.5 * float(np.max(width * h[at.interval])) * rise
            attention = max(attention / CLOSER_LOOK.size, approach)

    def excess(self, at: Instants, attention: float = np.inf) -> Array:
        """Excess of the values over their bounds at any instants, shape (m, p)."""
        constraint = self.block.assumed(self.motion, at)
        states = self.block.scheme.states(self.motion, at, constraint.order)
        values = constraint.evaluate(states, attention)
        lower, upper = constraint.bounds(at.size)
        if isinstance(constraint, PathConstraint) and constraint.window is not None:
            holds = constraint.window.contains(states.t)[:, None]
            values = np.where(holds, values, np.clip(values, lower, upper))
        return np.maximum(values - upper, lower - values)

    def violated_jumps(self) -> Instants:
        """Instants of violated values that may jump at the nodes: functions of torques.

        For each value and each part of an interval, the instant is the inspected
        instant with the largest violation; for rates it is a pair of instants. Instants
        around the reversals of joints with dry friction are inspected as well. Instants
        that have rows are left out.
        """
        constraint, tolerance = self.constraint, self.tolerance
        of, (first, end) = self.block.scheme, self.within
        found: set[tuple[int, float]] = set()
        rates = constraint.order >= 3
        for shares in (RATES_INSPECTED,) if rates else of.inspected:
            at = Instants.spread(of.intervals, shares).within(first, end)
            places = np.reshape(shares, (-1, 1 + rates))
            excess = self.excess(at).reshape(end - first, len(places), -1)
            worst, largest = np.argmax(excess, axis=1), np.max(excess, axis=1)
            if not np.any(largest > tolerance):
                continue
            over = largest > (JOINING_SHARE if tolerance > 0.0 else 1.0) * tolerance
            for k, j in np.argwhere(over).tolist():
                found |= {(first + k, share) for share in places[worst[k, j]].tolist()}
        friction = of.system.friction
        if isinstance(constraint, MotorLimit) and not rates and friction is not None:
            at = self.around_reversals(friction > 0.0)
            if at.size:
                over = np.any(self.excess(at) > tolerance, axis=1)
                found.update(at[over].pairs)
        return Instants.of_pairs(sorted(found.difference(self.block.fixed.pairs)))

    def around_reversals(self, joints: BoolArray) -> Instants:
        """Instants before and after each reversal; joints may share a reversal.

        Args:
            joints: Whether each joint has dry friction, shape (n,).
        """
        of, (first, end) = self.block.scheme, self.within
        shares = tuple(np.linspace(0.0, 1.0, PARTS + 1).tolist())
        at = Instants.spread(of.intervals, shares).within(first, end)
        v = of.states(self.motion, at, 1).v[:, joints]
        v = v.reshape(end - first, PARTS + 1, -1)
        before, after = v[:, :-1], v[:, 1:]
        interval, step, joint = np.nonzero(before * after < 0.0)
        v0, v1 = before[interval, step, joint], after[interval, step, joint]
        # The velocity is nearly linear within a step.
        share = (step + v0 / (v0 - v1)) / PARTS
        around = np.concatenate([share - REVERSAL_OFFSET, share + REVERSAL_OFFSET])
        around = np.clip(around, 0.0, 1.0)
        found = np.stack([np.tile(first + interval, 2), around], axis=1)
        found = np.unique(found, axis=0)
        return Instants(found[:, 0].astype(np.int64), found[:, 1])


def most_instants(values: int) -> int:
    """Largest number of instants to inspect, for a number of values at each."""
    return min(max(MOST_NUMBERS // max(values, 1), 1), MOST_SAMPLES)


def _worst(near: IntArray, violation: Array, parts: int, most: int) -> IntArray:
    """The instants with the largest violations, at most ``most`` after refinement."""
    largest = np.max(violation[near], axis=1, initial=-np.inf)
    count = max(most // parts, 1)
    return np.sort(near[np.argsort(-largest, kind="stable")[:count]])


def _samples(h: Array, most: int = MOST_SAMPLES) -> Instants:
    """Instants at which to inspect continuous values, sparser if the motion is long."""
    apart = max(np.clip(STEP_SHARE * h.sum(), *STEPS), float(h.sum()) / most)
    counts: IntArray = np.maximum(np.ceil(h / apart).astype(np.int64), PARTS)
    interval = np.repeat(np.arange(h.size), counts)
    first = np.repeat(np.cumsum(counts) - counts, counts)
    step = np.arange(interval.size) - first
    return Instants(interval, (step + 0.5) / counts[interval])


def times_of_rows(program: NonlinearProgram, z: Array) -> dict[str, Array]:
    """Times of the clearance rows of a program [s], by the name of the block.

    Args:
        program: The program.
        z: Iterate of the program.
    """
    of = program.transcription
    h = of.motion(z).h
    return {
        block.name: block.fixed.times(h) + of.delays[block.fixed.interval]
        for block in program.blocks
        if isinstance(block, SampledRows) and block.constraint.gradual
    }


def with_rows_at(
    program: NonlinearProgram, z: Array, times: Mapping[str, Array]
) -> NonlinearProgram:
    """The program with clearance rows added at times that have no row yet.

    Args:
        program: The program.
        z: Iterate of the program, the motion whose rows they are.
        times: Times of the rows [s], by the name of the block.
    """
    of, blocks = program.transcription, list(program.blocks)
    h = of.motion(z).h
    own = times_of_rows(program, z)
    for index, block in enumerate(blocks):
        if isinstance(block, SampledRows) and block.name in own.keys() & times.keys():
            added = times[block.name]
            away = np.abs(added[:, None] - own[block.name])
            apart = np.min(away, axis=1, initial=np.inf)
            more = np.unique(added[apart > APART * float(h.sum())])
            at = Instants.at_times(more, h, of.delays)
            at = at if block.within is None else at.within(*block.within)
            blocks[index] = replace(block, fixed=block.fixed.joined(at))
    return replace(program, blocks=tuple(blocks))
