"""Transfer of clearance rows between the nodes to a program on another grid.

A motion depends on the clearance rows that joined its program by row exchange. Without
them, a program on another grid would let the motion pass through obstacles between the
nodes, appear faster than is feasible, and have to exchange the same rows again.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from tominpmp.arrays import Array
from tominpmp.transcription.blocks import SampledRows
from tominpmp.transcription.instants import Instants
from tominpmp.transcription.program import NonlinearProgram

# Rows closer than this share of the duration count as one.
APART = 1e-4


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
        if isinstance(block, SampledRows) and block.gradual
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
        if not isinstance(block, SampledRows) or block.name not in own:
            continue
        added = times.get(block.name, np.zeros(0))
        away = np.abs(added[:, None] - own[block.name])
        apart = np.min(away, axis=1, initial=np.inf)
        more = np.unique(added[apart > APART * float(h.sum())])
        if more.size:
            at = Instants.at_times(more, h, of.delays)
            at = at if block.within is None else at.within(*block.within)
            blocks[index] = replace(block, fixed=block.fixed.joined(at))
    return replace(program, blocks=tuple(blocks))
