"""Rows of distances between the nodes, kept and put where pairs of bodies are nearest.

A motion rests on the rows that joined its program. On another grid it would pass
through what is between the nodes, look faster than it is, and find them anew: they are
kept where a motion goes on with another grid.

A pair holds a motion at the instant at which it is nearest, which moves with the
motion. Rows at other instants of the same approach, as a grid has them, say more than
that: they hold the pace, since sooner or later the pair was or will be nearer than it
is at that very instant. A program whose rows are beside the nearest instants settles on
motions that are not optimal; so its instants follow those of a motion once it is near
the optimum.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from tominpmp.arrays import Array, BoolArray, IntArray
from tominpmp.certificate.clearances import Nearest
from tominpmp.constraints.clearance import ClearanceConstraint, Slopes
from tominpmp.transcription.base import Motion, Transcription
from tominpmp.transcription.blocks import Block, Sampled
from tominpmp.transcription.exchange import Missing, with_rows
from tominpmp.transcription.instants import Instants
from tominpmp.transcription.program import NonlinearProgram

# Rows closer than this share of the motion are one.
APART = 1e-4
# Rows of pairs beyond this, in lengths, are left as they are.
ATTENTION = 0.03
# A row within this share of the motion around the nearest instant belongs to the same
# approach, if at its speed its room would not last for that time.
APPROACH = 0.05
# Of what is left of the padding this share is asked for, and so much of all at least.
ALMOST, LEAST = 0.95, 0.3


def times_of_rows(program: NonlinearProgram, z: Array) -> dict[str, Array]:
    """Times of the rows of distances of a program [s], by the name of the block.

    Args:
        program: The program.
        z: Its iterate.
    """
    of = program.transcription
    h = of.motion(z).h
    return {
        block.name: block.fixed.times(h) + of.delays[block.fixed.interval]
        for block in program.blocks
        if isinstance(block, Sampled) and block.gradual
    }


def with_rows_at(
    program: NonlinearProgram, z: Array, times: Mapping[str, Array]
) -> NonlinearProgram:
    """The program with rows of distances at times, where it has none.

    Args:
        program: The program.
        z: Its iterate, the motion that the rows are of.
        times: Times of rows [s], by the name of the block.
    """
    of, blocks = program.transcription, list(program.blocks)
    h = of.motion(z).h
    own = times_of_rows(program, z)
    for index, block in enumerate(blocks):
        if not isinstance(block, Sampled) or block.name not in own:
            continue
        wanted = times.get(block.name, np.zeros(0))
        known = np.sort(own[block.name])
        place = np.searchsorted(known, wanted)
        padded = np.concatenate([[-np.inf], known, [np.inf]])
        apart = np.minimum(wanted - padded[place], padded[place + 1] - wanted)
        more = np.unique(wanted[apart > APART * float(h.sum())])
        if more.size:
            at = Instants.at_times(more, h, of.delays)
            at = at if block.within is None else at.within(*block.within)
            blocks[index] = replace(block, fixed=block.fixed.joined(at))
    return replace(program, blocks=tuple(blocks))


def anchored(
    program: NonlinearProgram, z: Array, nearest: Nearest, padding: float
) -> NonlinearProgram:
    """The program with rows of distances at the nearest instants of pairs.

    Args:
        program: The program.
        z: Its iterate.
        nearest: Where pairs are nearest in it.
        padding: Share of the padding of the distances that is left.

    Returns:
        The program, with the slopes of the least distances of this iterate; rows that
        came to it between the nodes are left out.
    """
    of = program.transcription
    motion = of.motion(z)

    def change(block: Sampled, constraint: ClearanceConstraint) -> Sampled:
        return _anchored(block, constraint.tightened(padding), of, motion, nearest)

    return _with_distances(program, change)


def _with_distances(
    program: NonlinearProgram,
    change: Callable[[Sampled, ClearanceConstraint], Sampled],
) -> NonlinearProgram:
    """The program with its blocks of distances changed, given their constraints."""
    blocks: list[Block] = []
    for block in program.blocks:
        if isinstance(block, Sampled) and isinstance(
            block.constraint, ClearanceConstraint
        ):
            block = change(block, block.constraint)
        blocks.append(block)
    return replace(program, blocks=tuple(blocks))


def _anchored(
    block: Sampled,
    constraint: ClearanceConstraint,
    of: Transcription[Any],
    motion: Motion,
    nearest: Nearest,
) -> Sampled:
    times, pairs, slopes, rates = nearest
    regular = of.instants(constraint.order, constraint.field)
    beside = _beside(constraint, of, motion, regular, times, pairs)
    distinct, index = np.unique(times, return_inverse=True)
    own = Instants.at_times(distinct, motion.h, of.delays)
    others = np.ones((distinct.size, constraint.count), dtype=bool)
    others[index, pairs] = False
    ignored = np.concatenate([beside, others])
    known = Slopes(regular.size + index, pairs, slopes, rates)
    return replace(
        block,
        constraint=constraint.knowing(known),
        fixed=regular.joined(own),
        ignored=ignored,
    )


def _beside(
    constraint: Any,
    of: Transcription[Any],
    motion: Motion,
    at: Instants,
    times: Array,
    pairs: IntArray,
) -> BoolArray:
    """Which values at instants belong to an approach that has a row of its own."""
    states = of.states(motion, at, 1)
    values = constraint.evaluate(states, ATTENTION)
    out = np.zeros(values.shape, dtype=bool)
    k, pair = np.nonzero(values > -ATTENTION)
    when = at.times(motion.h) + of.delays[at.interval]
    T = float(motion.h.sum() + of.delays[-1])
    near = np.zeros(values.shape, dtype=bool)
    for time, own in zip(times, pairs, strict=True):
        near[:, own] |= np.abs(when - time) <= APPROACH * T
    own = near[k, pair]
    k, pair = k[own], pair[own]
    if not k.size:
        return out
    partials = constraint.differentiate(states, k, pair)
    speed = np.einsum("kj,kj->k", partials.by_q, of.rates(motion, at)[k])
    if partials.by_t is not None:
        speed = speed + partials.by_t
    room = np.maximum(constraint.padding[pair] - values[k, pair], 0.0)
    out[k, pair] = room < APPROACH * T * np.abs(speed)
    return out


def unanchored(program: NonlinearProgram) -> NonlinearProgram:
    """The program with all its rows, wherever iterates lead.

    The nearest instants of another iterate are others: those of the grid are rows, too,
    and all have the derivatives that they have there.
    """

    def change(block: Sampled, constraint: ClearanceConstraint) -> Sampled:
        return replace(block, constraint=constraint.knowing(None), ignored=None)

    return _with_distances(program, change)


def with_nearest(
    program: NonlinearProgram, z: Array, nearest: Nearest
) -> NonlinearProgram:
    """The program with rows of distances where pairs are nearest beside its own.

    Args:
        program: The program.
        z: Its iterate.
        nearest: Where pairs are nearest in it.
    """
    of = program.transcription
    motion = of.motion(z)
    own = Instants.at_times(np.unique(nearest.times), motion.h, of.delays)

    def change(block: Sampled, constraint: ClearanceConstraint) -> Sampled:
        return with_rows(block, of, motion, Missing(own))[0]

    return _with_distances(program, change)


def padding_left(
    of: Transcription[Any], z: Array, nearest: Nearest, most: float
) -> float:
    """Share of the padding that pairs have left where they are nearest.

    Args:
        of: The parameterisation.
        z: An iterate of it.
        nearest: Where pairs are nearest in it.
        most: What is not exceeded.
    """
    constraint, times, pairs = of.system.clearance, nearest.times, nearest.pairs
    if constraint is None or not times.size:
        return most
    motion = of.motion(z)
    distinct, index = np.unique(times, return_inverse=True)
    states = of.states(motion, Instants.at_times(distinct, motion.h, of.delays), 0)
    padding = constraint.padding[pairs]
    room = padding - constraint.evaluate(states, ATTENTION)[index, pairs]
    padded = padding > 0.0
    left = np.min(room[padded] / padding[padded], initial=np.inf)
    return float(np.clip(ALMOST * left, LEAST * most, most))
