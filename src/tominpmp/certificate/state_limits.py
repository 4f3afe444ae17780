"""Limits on the states of a motion as linear rows on its small changes.

What a problem asks for beyond the limits of its robot; clearances have a module of
their own. A limit is looked at closely in time, and where it is nearest is a row.
"""

from __future__ import annotations

import numpy as np

from tominpmp.arrays import BoolArray
from tominpmp.certificate.active_limits import Motion
from tominpmp.certificate.instants import Instants, beside, local_maxima
from tominpmp.certificate.limit_rows import LimitRows
from tominpmp.certificate.perturbations import (
    JUST_INSIDE,
    Perturbations,
    picked,
)

# Where limits are rows in any case: the middles and the ends of the intervals.
REGULAR = (0.5, 1.0)
# Samples of an interval between which the nearest instants are looked for.
SAMPLES = 16
# Other constraints farther below their limits, in units of their scale, are no rows.
NEAR_CONSTRAINT = 0.1


def constraints(motion: Motion) -> list[LimitRows]:
    """Constraints of the problem that are near their limits."""
    count = len(motion.task.problem.constraints)
    found = [_constraint(motion, index) for index in range(count)]
    return [rows for rows in found if rows is not None]


def _constraint(motion: Motion, index: int) -> LimitRows | None:
    item, changes = motion.task.problem.ready_constraints[index], motion.changes
    at, regular = _looked_at(changes, item.order)
    first, end = motion.span
    inside = (at.interval >= first) & (at.interval < end)
    at, regular = at.kept(inside), regular[inside]
    state = motion.trajectory(at.times(changes))
    values = item.value_rows(state.q, state.v, state.a)
    lower, upper = item.bounds(len(values))
    excess = np.maximum(values - upper, lower - values)
    if item.window is not None:
        holds = item.window.asked(at.times(changes))
        excess = np.where(holds[:, None], excess, -np.inf)
    nearest = beside(local_maxima(excess))
    k, which = np.nonzero((excess > -NEAR_CONSTRAINT) & (regular[:, None] | nearest))
    if not k.size:
        return None
    used, place = np.unique(k, return_inverse=True)
    _, *by = item.term_rows(state.q[used], state.v[used], state.a[used])
    at = at.kept(k)
    sources = changes.inside(*at, state.q[k], state.v[k])
    parts, slopes = [], []
    for slope, source in zip(by, sources, strict=True):
        mine = slope[place, which] if slope.size else np.zeros((k.size, changes.n))
        slopes.append(mine)
        if slope.size:
            parts.append(source.after(picked(mine, k.size, np.arange(k.size))))
    here, change = values[k, which], sum(parts[1:], parts[0])
    if item.window is not None:
        # It stays at its times: what is earlier by so much is on its way for that much
        # longer. Slopes by accelerations count for nothing: those run little.
        rate = np.einsum("kj,kj->k", slopes[0], state.v[k])
        rate += np.einsum("kj,kj->k", slopes[1], state.a[k])
        change = at.with_time(change, -rate)
    return LimitRows(
        kind=item.name,
        change=change,
        lower=np.minimum(lower[k, which] - here, 0.0),
        upper=np.maximum(upper[k, which] - here, 0.0),
        interval=at.interval,
        subject=np.full(k.size, index),
        share=np.where(at.share >= 1.0 - JUST_INSIDE, 1.0, at.share),
        slopes=slopes[0],
        speed_slopes=slopes[1],
        unit=item.scale,
        component=which,
    )


def _looked_at(changes: Perturbations, order: int) -> tuple[Instants, BoolArray]:
    """Instants at which a constraint is looked at, and which are rows in any case.

    Accelerations jump at the nodes: what depends on them is looked at on both sides.
    """
    shares = np.arange(1, SAMPLES + 1) / SAMPLES
    regular = np.isin(shares, REGULAR)
    if order > 1:
        shares = np.append(JUST_INSIDE, shares)
        regular = np.append(True, regular)
    shares = np.minimum(shares, 1.0 - JUST_INSIDE)
    return Instants.spread(changes.N, shares), np.tile(regular, changes.N)
