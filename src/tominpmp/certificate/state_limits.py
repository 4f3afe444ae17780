"""Limits on the states of a motion as linear rows on its small changes.

What a problem asks for beyond the limits of its robot; clearances have a module of
their own. A limit is looked at closely in time, and where it is nearest is a row.
"""

from __future__ import annotations

import numpy as np

from tominpmp.certificate.active_limits import LimitRows, Motion
from tominpmp.certificate.instants import Instants, beside, local_maxima
from tominpmp.certificate.perturbations import JUST_INSIDE, picked

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
    n = changes.n
    shares = np.arange(1, SAMPLES + 1) / SAMPLES
    at = Instants.spread(changes.N, np.minimum(shares, 1.0 - JUST_INSIDE))
    state = motion.trajectory(at.times(changes))
    rows = list(zip(state.q, state.v, state.a, strict=True))
    every = [item.value(*row) for row in rows]
    values = np.array([value for value, _ in every])
    regular = np.tile(np.isin(shares, REGULAR), changes.N)
    nearest = beside(local_maxima(values[:, None]))[:, 0]
    k = np.flatnonzero((values > -NEAR_CONSTRAINT) & (regular | nearest))
    if not k.size:
        return None
    at = at.kept(k)
    sources = changes.inside(*at, state.q[k], state.v[k])
    parts, slopes = [], []
    for order, source in enumerate(sources):
        by = np.array([every[i][1][order] for i in k])
        slopes.append(by if by.size else np.zeros((k.size, n)))
        if by.size:
            parts.append(source.after(picked(by, k.size, np.arange(k.size))))
    return LimitRows(
        kind=item.name,
        change=sum(parts[1:], parts[0]),
        lower=np.full(k.size, -np.inf),
        upper=np.maximum(-values[k], 0.0),
        interval=at.interval,
        subject=np.full(k.size, index),
        share=np.where(at.share >= 1.0 - JUST_INSIDE, 1.0, at.share),
        slopes=slopes[0],
        speed_slopes=slopes[1],
        unit=item.scale,
    )
