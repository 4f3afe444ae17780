"""Limits on the states of a motion as linear rows on its small changes.

Clearances, and what a problem asks for beyond the limits of its robot.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from tominpmp.certificate.active_limits import LimitRows, Motion
from tominpmp.certificate.perturbations import JUST_INSIDE, Linearised

# Clearances beyond this, in shares of the reach, are no rows.
ATTENTION = 0.03
# Other constraints farther below their limits, in units of their scale, are no rows.
NEAR_CONSTRAINT = 0.1


def clearances(motion: Motion) -> list[LimitRows]:
    """Distances that are near their margins, as shares of the reach."""
    room, changes = motion.task.room, motion.changes
    if room is None:
        return []
    out = []
    for share in (0.5, 1.0):
        times = changes.t[:-1] + share * changes.h
        q = motion.trajectory(times).q if share < 1.0 else changes.q[1:]
        k, pair, missing = room.near(q, ATTENTION, times)
        if not k.size:
            continue
        slopes, rates = room.derivatives_at(q, k, pair, times)
        columns = k[:, None] * changes.n + np.arange(changes.n)
        starts = np.arange(k.size + 1) * changes.n
        by_q = sp.csr_matrix(
            (slopes.ravel(), columns.ravel(), starts),
            shape=(k.size, changes.N * changes.n),
        )
        if share < 1.0:
            change = changes.position_at(share, q).after(by_q)
        else:
            change = changes.fixed(by_q @ changes.positions[changes.n :])
        if room.moving:
            passed = np.where(k[:, None] > np.arange(changes.N), 1.0, 0.0)
            passed[np.arange(k.size), k] = share
            late = sp.csr_matrix(rates[:, None] * passed)
            change = Linearised(change.matrix, change.by_length + late)
        out.append(
            LimitRows(
                kind="clearance",
                change=change,
                lower=np.full(k.size, -np.inf),
                upper=np.maximum(-missing, 0.0),
                interval=k,
                subject=pair,
                share=share,
                slopes=slopes,
                unit=motion.task.reach,
            )
        )
    return out


def constraints(motion: Motion) -> list[LimitRows]:
    """Constraints of the problem that are near their limits."""
    out = []
    for index in range(len(motion.task.problem.constraints)):
        for share in (0.5, 1.0):
            rows = _constraint(motion, index, share)
            if rows is not None:
                out.append(rows)
    return out


def _constraint(motion: Motion, index: int, share: float) -> LimitRows | None:
    item = motion.task.problem.ready_constraints[index]
    changes, n = motion.changes, motion.changes.n
    times = (
        changes.t[:-1] + (share - JUST_INSIDE if share == 1.0 else share) * changes.h
    )
    state = motion.trajectory(times)
    rows = list(zip(state.q, state.v, state.a, strict=True))
    every = [item.value(*row) for row in rows]
    values = np.array([value for value, _ in every])
    k = np.flatnonzero(values > -NEAR_CONSTRAINT)
    if not k.size:
        return None
    sources = (
        changes.position_at(share, state.q),
        changes.velocity_at(share, state.v),
        changes.fixed(
            (1.0 - share) * changes.accelerations(0) + share * changes.accelerations(1)
        ),
    )
    parts, slopes = [], []
    for order, source in enumerate(sources):
        by = np.array([every[i][1][order] for i in k])
        slopes.append(by if by.size else np.zeros((k.size, n)))
        if by.size:
            columns = k[:, None] * n + np.arange(n)
            starts = np.arange(k.size + 1) * n
            shape = k.size, changes.N * n
            pick = sp.csr_matrix((by.ravel(), columns.ravel(), starts), shape=shape)
            parts.append(source.after(pick))
    total = Linearised(
        sum((part.matrix for part in parts[1:]), parts[0].matrix),
        sum((part.by_length for part in parts[1:]), parts[0].by_length),
    )
    return LimitRows(
        kind=item.name,
        change=total,
        lower=np.full(k.size, -np.inf),
        upper=np.maximum(-values[k], 0.0),
        interval=k,
        subject=np.full(k.size, index),
        share=share,
        slopes=slopes[0],
        speed_slopes=slopes[1],
        unit=item.scale,
    )
