"""Rows of distances between the nodes, kept when a motion changes its grid.

A motion depends on the rows that joined its program by exchange. Without these rows, on
another grid it would pass through obstacles between the nodes, seem faster than is
admissible, and have to find the rows anew.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from tominpmp.arrays import Array
from tominpmp.transcription.blocks import SampledRows
from tominpmp.transcription.instants import Instants
from tominpmp.transcription.program import NonlinearProgram

# Rows closer than this share of the motion count as one.
APART = 1e-4


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
        if isinstance(block, SampledRows) and block.gradual
    }


def with_rows_at(
    program: NonlinearProgram, z: Array, times: Mapping[str, Array]
) -> NonlinearProgram:
    """The program with rows of distances at times, where rows are missing.

    Args:
        program: The program.
        z: Its iterate, the motion that the rows are of.
        times: Times of rows [s], by the name of the block.
    """
    of, blocks = program.transcription, list(program.blocks)
    h = of.motion(z).h
    own = times_of_rows(program, z)
    for index, block in enumerate(blocks):
        if not isinstance(block, SampledRows) or block.name not in own:
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
