"""Semi-infinite exchange: rows where a motion breaks its limits between the rows.

Torques and clearances are rows at chosen instants only. After a solve the motion is
inspected between them, and the worst instants become rows of the next program (Hettich
and Kortanek, 1993), until an inspection finds nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.transcription.spline import Spline
from tominpmp.transcription.spline_rows import Instants
from tominpmp.transcription.system import System
from tominpmp.transcription.ways import Ways

# Instants at which torques are looked at between the rows.
TORQUE_SHARES = (0.2, 0.35, 0.5, 0.65, 0.8)
# Relative torque excess between the rows that is let pass.
OVERLOAD = 2e-3
# Clearances are looked at this often [s], and this often an interval at least.
CLEARANCE_STEP = 2e-3
CLEARANCE_SAMPLES = 4
# Pairs closer than this beyond what is asked for are looked at more closely [m], at
# these places around an instant, in shares of the step.
CLOSE = 1e-3
DIPS = np.array([-0.5, -0.375, -0.25, -0.125, 0.125, 0.25, 0.375])
# Share of the padding that may be used up between the rows, and what may be missing
# without any padding, as a share of the reach.
GRAZE = 0.8
LEAST_GRAZE = 1e-5
# Share of what is left of the padding that may be missing beyond that.
REST = 0.5
# Instants closer than this share of an interval are one; where obstacles move, only if
# they are closer than this, too [s].
APART = 0.03
APART_MOVING = 2e-5
# Where obstacles move, they are looked at so often that they move by no more than this
# share of the padding, but no oftener than by this factor.
FINE = 0.25
FINEST = 128
# So many instants take the place of one when it is looked at more closely.
SPLIT = 4
# No more instants than this are looked at, nor this many more closely at a time, and no
# table of instants by pairs has more numbers: they take memory, and the verification
# looks again.
MOST_SAMPLES, MOST_SPLIT, MOST_NUMBERS = 20_000, 4_000, 4_000_000
# Share of the padding that may be used up there.
GRAZE_MOVING = 0.5


def no_instants() -> Instants:
    """No instants at all."""
    return Instants(np.zeros(0, dtype=np.int64), np.zeros(0))


@dataclass(frozen=True, eq=False)
class Extra:
    """Instants that have become rows.

    Attributes:
        torque: Where torques are rows beside the ends of the intervals.
        clearance: Where clearances are rows beside the regular instants.
        ways: Which way joints with dry friction move at all rows of torques; None
            without friction, or where it is not known yet.
        turned: Number of joints and instants whose way is another than was assumed,
            where that matters.
    """

    torque: Instants = field(default_factory=no_instants)
    clearance: Instants = field(default_factory=no_instants)
    ways: Ways | None = None
    turned: int = 0

    @property
    def size(self) -> int:
        """Number of instants that are other than in the program."""
        return self.torque.size + self.clearance.size + self.turned

    def joined(self, other: Extra) -> Extra:
        """These instants and others, which know the way at all of them."""
        return Extra(
            self.torque.joined(other.torque),
            self.clearance.joined(other.clearance),
            other.ways,
        )


class SplineExtra(NamedTuple):
    """Instants that have become rows, as shares of T.

    Attributes:
        clearance: Where clearances are rows beside the regular instants.
        torque: Where torques are.
        ways: Which way joints with dry friction move at all rows of torques; None
            without friction, or where it is not known yet.
        turned: Number of joints and instants whose way is another than was assumed,
            where that matters.
    """

    clearance: Array = np.zeros(0)
    torque: Array = np.zeros(0)
    ways: Ways | None = None
    turned: int = 0

    @property
    def found(self) -> bool:
        """Whether anything is other than in the program."""
        return bool(self.clearance.size or self.torque.size or self.turned)


def overloaded(system: System, spline: Spline, tolerance: float) -> Instants:
    """Instants between the rows at which torques exceed their limits.

    Args:
        system: Dynamics and limits.
        spline: The motion.
        tolerance: Relative excess that is let pass.

    Returns:
        For each interval and joint the worst of the inspected instants, if it is
        overloaded; without repetitions.
    """
    N, count = spline.h.size, len(TORQUE_SHARES)
    at = Instants(np.tile(np.arange(N), count), np.repeat(TORQUE_SHARES, N))
    load = np.abs(system.torque(*at.states(spline)))
    load = load.reshape(count, N, -1)
    worst = np.argmax(load, axis=0)  # (N, n)
    over = np.max(load, axis=0) > 1.0 + tolerance
    pairs = sorted({(int(k), int(worst[k, j])) for k, j in np.argwhere(over)})
    return Instants(
        np.array([k for k, _ in pairs], dtype=np.int64),
        np.array([TORQUE_SHARES[i] for _, i in pairs]),
    )


def grazing(system: System, spline: Spline, known: Instants) -> Instants:
    """Instants at which links come closer to something than they may.

    Args:
        system: Clearances.
        spline: The motion.
        known: Instants that are rows already.

    Returns:
        For each interval and pair the closest of the inspected instants, if it is too
        close; those near others are left out.
    """
    if system.clearance is None:
        return no_instants()
    regular = _samples(spline.h, most_instants(system.clearance.count))
    at, values = _closer(system, spline, regular)
    if system.clearance.moving:
        more, there = _finer(system, spline, regular)
        at, values = at.joined(more), np.concatenate([values, there])
    missing = values - _usable(system)
    worst = np.max(missing, axis=1)
    found: list[tuple[int, float]] = []
    taken: dict[int, list[float]] = {}
    for k, share in zip(known.interval.tolist(), known.share.tolist(), strict=True):
        taken.setdefault(k, []).append(share)
    for k in np.unique(at.interval[worst > 0.0]).tolist():
        inside = np.flatnonzero(at.interval == k)
        block = missing[inside]
        pairs = np.flatnonzero(block.max(axis=0) > 0.0)
        peaks = inside[np.argmax(block[:, pairs], axis=0)]
        for index in sorted(set(peaks.tolist()), key=lambda i: -worst[i]):
            share = float(at.share[index])
            near = taken.setdefault(k, [])
            apart = APART
            if system.clearance.moving:
                apart = min(APART, APART_MOVING / float(spline.h[k]))
            if all(abs(share - other) > apart for other in near):
                near.append(share)
                found.append((k, share))
    return Instants(
        np.array([k for k, _ in found], dtype=np.int64),
        np.array([share for _, share in found]),
    )


def _usable(system: System) -> Array:
    """How much closer than the rows ask for pairs may come between them.

    The rows keep links a little farther away than need be, and some of it may be used,
    never all: what verifies the motion lets nothing be missing to the margin. Only
    where a motion begins or ends at the margin there is nothing to be used, and a trace
    may be missing.

    Returns:
        Shares of the reach, shape (pairs,).
    """
    assert system.clearance is not None  # noqa: S101
    share = GRAZE_MOVING if system.clearance.moving else GRAZE
    padding = np.asarray(system.padding)
    rest = REST * (1.0 - share) * padding
    least = np.where(padding > 0.0, np.minimum(LEAST_GRAZE, rest), LEAST_GRAZE)
    return np.asarray(share * padding + least)


def _closer(system: System, spline: Spline, at: Instants) -> tuple[Instants, Array]:
    """More instants around those between which links may come too close.

    Returns:
        The instants, and the values there.
    """
    clearance = system.clearance
    assert clearance is not None  # noqa: S101
    close = CLOSE / system.reach

    def values_at(instants: Instants, attention: float) -> Array:
        times = instants.times(spline.h)
        return clearance.values(instants.states(spline)[0], attention, times)

    values = values_at(at, close)
    missing = values - _usable(system)
    near = _worst(
        dipping(missing, 0.0, close), missing, DIPS.size, most_instants(clearance.count)
    )
    if not near.size:
        return at, values
    width = 1.0 / np.bincount(at.interval, minlength=spline.h.size)[at.interval[near]]
    share = at.share[near, None] + DIPS * width[:, None]
    more = Instants(np.repeat(at.interval[near], DIPS.size), share.ravel())
    return at.joined(more), np.concatenate([values, values_at(more, 0.0)])


def grazing_times(
    system: System,
    nodes: Array,
    duration: float,
    position: Callable[[Array], Array],
) -> Array:
    """As :func:`grazing`, for motions of any form.

    Args:
        system: Clearances.
        nodes: Nodes, as shares of the duration.
        duration: Duration of the motion [s].
        position: Configurations at shares of the duration.

    Returns:
        The instants, as shares of the duration.
    """
    clearance = system.clearance
    if clearance is None:
        return np.zeros(0)

    def missing_at(times: Array, attention: float) -> Array:
        values = clearance.values(position(times), attention, times=duration * times)
        return np.asarray(values - _usable(system))

    close = CLOSE / system.reach
    most = most_instants(clearance.count)
    count = int(np.clip(duration / CLEARANCE_STEP, 100, most))
    times = np.linspace(0.0, 1.0, count)[1:-1]
    missing = missing_at(times, close)
    near = _worst(dipping(missing, 0.0, close), missing, DIPS.size, most)
    if near.size:
        more = (times[near, None] + DIPS * (times[1] - times[0])).ravel()
        missing = np.concatenate([missing, missing_at(more, 0.0)])
        times = np.concatenate([times, more])
    inside = np.searchsorted(nodes, times) - 1
    found: list[float] = []
    for pair in np.flatnonzero(missing.max(axis=0) > 0.0):
        for k in np.unique(inside[missing[:, pair] > 0.0]):
            block = np.flatnonzero(inside == k)
            found.append(float(times[block[np.argmax(missing[block, pair])]]))
    return np.unique(np.round(found, 4))


def dipping(missing: Array, tolerance: float, close: float) -> IntArray:
    """Instants around which what is missing may pass a tolerance between the samples.

    Args:
        missing: By instant and pair, in the order of time, shape (m, count).
        tolerance: What is let pass.
        close: Values below minus this are upper bounds, and not looked at.

    Returns:
        Indices of the instants.
    """
    step = np.diff(missing, axis=0)
    np.abs(step, out=step)
    change = np.zeros_like(missing)  # tables may be large: no more of them than needed
    change[1:] = step
    np.maximum(change[:-1], step, out=change[:-1])
    # Half a step away it has risen by half of that at the most, if evenly.
    change *= 0.5
    change += missing
    dips = change > tolerance
    dips &= missing > -close
    return np.flatnonzero(np.any(dips, axis=1))


def most_instants(pairs: int) -> int:
    """How many instants are looked at in all, with so many pairs."""
    return int(np.clip(MOST_NUMBERS // max(pairs, 1), MOST_SPLIT // 20, MOST_SAMPLES))


def _worst(near: IntArray, missing: Array, parts: int, most: int) -> IntArray:
    """Those rows at which most is missing, if each of all has too many parts."""
    count = max(most // parts, 1)
    if near.size <= count:
        return near
    lacking = np.max(missing[near], axis=1)
    return np.sort(near[np.argsort(-lacking, kind="stable")[:count]])


def _finer(system: System, spline: Spline, at: Instants) -> tuple[Instants, Array]:
    """Instants between given ones at which something that moves comes too close.

    Returns:
        The instants, and the values there.
    """
    clearance, h = system.clearance, spline.h
    assert clearance is not None  # noqa: S101
    usable = _usable(system)
    width = 1.0 / np.bincount(at.interval, minlength=h.size)[at.interval]
    rises = clearance.rises(float(h.sum()))
    rise = float(np.max(rises, initial=0.0))
    room = FINE * float(np.max(system.padding)) + LEAST_GRAZE
    parts = float(np.clip(rise * np.max(width * h[at.interval]) / room, 1.0, FINEST))
    found, lacking = [], []
    while True:
        # Between instants a step apart a value rises by this much, seen from the
        # nearer one: only where that matters is it worth while to look closer. What
        # does not move is no reason to.
        step = 0.5 * width * h[at.interval]
        attention = float(np.max(step)) * rise if parts > 1.0 else 0.0
        times, q = at.times(h), at.states(spline)[0]
        values = clearance.values(q, attention=attention, times=times)
        worst = np.max(values - usable, axis=1)
        over = np.flatnonzero(worst > 0.0)
        found.append(Instants(at.interval[over], at.share[over]))
        lacking.append(values[over])
        rising = np.flatnonzero(rises > 0.0)
        ahead = values[:, rising] + step[:, None] * rises[rising]
        moved = np.max(ahead, axis=1, initial=-np.inf)
        near = np.flatnonzero(moved > 0.0)
        if parts <= 1.0 or not near.size:
            break
        split = min(int(np.ceil(parts)), SPLIT)
        most = min(MOST_SPLIT, most_instants(clearance.count) // SPLIT)
        near = _worst(near, moved[:, None], 1, most)
        places = (np.arange(split) + 0.5) / split - 0.5
        share = at.share[near, None] + places * width[near, None]
        at = Instants(np.repeat(at.interval[near], split), share.ravel())
        width, parts = np.repeat(width[near] / split, split), parts / split
    every = no_instants()
    for more in found:
        every = every.joined(more)
    return every, np.concatenate(lacking)


def _samples(h: Array, most: int = MOST_SAMPLES) -> Instants:
    """Instants at which clearances are looked at; fewer a second in long motions."""
    apart = max(CLEARANCE_STEP, float(h.sum()) / most)
    counts: IntArray = np.maximum(
        np.ceil(h / apart).astype(np.int64), CLEARANCE_SAMPLES
    )
    interval = np.repeat(np.arange(h.size), counts)
    first = np.repeat(np.cumsum(counts) - counts, counts)
    step = np.arange(interval.size) - first
    return Instants(interval, (step + 0.5) / counts[interval])
