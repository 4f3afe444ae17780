r"""Switching functions of arcs: what other torques would gain, to first order.

At the solution of an :class:`~tominpmp.exact.shooting.ArcProgram` its multipliers
give the costate p at the end, which the discrete adjoint equation carries back; the
derivative of the duration by the torque of a step is p^T B. A torque at its upper limit
with a positive derivative, or at the lower one with a negative one, should be at the
other limit for a while.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

from tominpmp.arrays import Array
from tominpmp.exact.shooting import TORQUE, VELOCITY, ArcProgram, Shot
from tominpmp.exact.structure import Arcs
from tominpmp.transcription.integrator import Sensitivities, sweep_adjoint

# Limits with less room than this are active.
ACTIVE = 1e-6
# Lengths and torques this near to their bounds are on them.
ON_BOUND = 1e-9


@dataclass(frozen=True)
class Change:
    """A change of the structure that promises a gain.

    Attributes:
        gain: What it gains to first order per second of a new arc, or in whole [s].
        arc: The arc to be cut.
        made: Makes the changed structure.
        urgent: Whether it goes before all else on its arc: another torque is to hold a
            joint whose own has come to its limit.
    """

    gain: float
    arc: int
    made: Callable[[Arcs], Arcs]
    urgent: bool = False


def _multipliers(program: ArcProgram, y: Array, shot: Shot) -> Array:
    """Multipliers of the rows, by least squares, shape (e + r,).

    They are shares of the duration, negative for limits that cost time.
    """
    count = program.arcs.count
    moving = np.concatenate([y[:count] > ON_BOUND, np.abs(y[count:]) < 1.0 - ON_BOUND])
    cost = np.concatenate([np.ones(count), np.zeros(y.size - count)])
    active = np.flatnonzero(shot.room < ACTIVE)
    matrix = np.vstack([shot.by_equal, -shot.by_room[active]])[:, moving]
    found = np.linalg.lstsq(matrix.T, -cost[moving], rcond=1e-10)[0]
    weights, equal = np.zeros(shot.rows.value.size), shot.equal.size
    weights[:equal], weights[equal + active] = found[:equal], -found[equal:]
    return weights


def torque_slopes(program: ArcProgram, shot: Shot, weights: Array) -> Array:
    """Derivatives of the duration by the torque shares of steps, shape (M, n) [s].

    Args:
        program: The program.
        shot: The motion.
        weights: Multipliers of its rows, shares of the duration, shape (e + r,).
    """
    steps = Sensitivities(*(part[:, -1] for part in shot.motion.sensitivities))
    rows, weight = shot.rows, weights[:, None]
    one = np.zeros(weights.size, dtype=np.int64)
    slopes, _ = sweep_adjoint(steps, rows.node, weight * rows.by_x, one)
    np.add.at(slopes[0], rows.node - 1, weight * rows.by_u)
    return np.asarray(slopes[0] * program.system.effort_half * program.duration)


def find_changes(
    program: ArcProgram, y: Array, shot: Shot, least: float
) -> list[Change]:
    """Changes of the structure that promise to gain something, the best of each arc.

    Args:
        program: The program.
        y: Its solution.
        shot: The motion.
        least: Gains below this do not count [s].

    Returns:
        Changes, at most one an arc, in the order of the arcs.
    """
    weights = _multipliers(program, y, shot)
    slopes = torque_slopes(program, shot, weights)
    arcs = program.unpack(y)
    found: dict[int, Change] = {}

    def offer(change: Change) -> None:
        known = found.get(change.arc, Change(least, change.arc, Arcs.cleaned))
        if (change.urgent, change.gain) > (known.urgent, known.gain):
            found[change.arc] = change

    for k, of_arc in enumerate(np.split(slopes, np.cumsum(program.steps)[:-1])):
        for j, slope in enumerate(of_arc.T):
            level = float(arcs.levels[k, j])
            if arcs.free[k, j] and not arcs.held[k, j]:
                offer(_limits_instead(k, j, level, slope))
                continue
            if arcs.held[k, j] or arcs.follows[k, j] or abs(level) != 1.0:
                continue
            wrong = np.maximum(2.0 * level * slope, 0.0)
            # Beginnings and ends of the stretches where it is wrong.
            turns = np.diff((wrong > 0.0).astype(int), prepend=0, append=0)
            for a, b in np.flatnonzero(turns).reshape(-1, 2).tolist():
                peak = a + int(np.argmax(wrong[a:b]))
                share = (peak + 0.5) / wrong.size
                new = partial(Arcs.insert, arc=k, share=share, joint=j, level=-level)
                offer(Change(float(wrong[a:b].sum()), k, new))
    for change in _of_limits(program, weights):
        offer(change)
    return [found[k] for k in sorted(found)]


def _limits_instead(arc: int, joint: int, level: float, slopes: Array) -> Change:
    """Torques at their limits in place of one between them.

    It is right in the mean only: where more of it would be better, it is to be as large
    as it can be, where less would be, as small.

    Args:
        arc: The arc.
        joint: The joint.
        level: Its torque, as a share of the limits.
        slopes: Derivatives of the duration by the torque of each step, shape (m,).
    """
    ends = np.flatnonzero(np.diff(np.sign(slopes))) + 1
    runs = np.split(slopes, ends)
    levels = [-1.0 if run.sum() > 0.0 else 1.0 for run in runs]
    shares = [run.size / slopes.size for run in runs]
    if len(runs) == 2:
        # As long as it takes for the same mean.
        first = (level - levels[1]) / (levels[0] - levels[1])
        shares = [first, 1.0 - first]
    gain = float(np.sum(np.abs(slopes) + slopes * level))
    new = partial(Arcs.split, arc=arc, joint=joint, shares=shares, levels=levels)
    return Change(gain, arc, new)


def _of_limits(program: ArcProgram, of_rows: Array) -> Iterator[Change]:
    """Joints that touch their speed limit, and held joints that need another torque.

    A joint that touches its speed limit might stay on it. Where the torque of a held
    joint comes to its limit at an end of the arc, another torque, first of all one that
    changes there, might hold the joint for a while.
    """
    watched, arcs = program.watched, program.arcs
    weights = -of_rows[of_rows.size - watched.kind.size :]
    first = np.cumsum(program.steps) - program.steps
    costly = (weights > 1e-6) & np.isin(watched.kind, (VELOCITY, TORQUE))
    for row in np.flatnonzero(costly).tolist():
        step, kind = int(watched.node[row]) - 1, int(watched.kind[row])
        joint = int(program.limits[kind].of_joints[watched.which[row]])
        gain, sign = float(weights[row]) * program.duration, int(watched.sign[row])
        arc = int(program.arc_of_step[step])
        place, count = step - int(first[arc]), int(program.steps[arc])
        if kind == VELOCITY:
            share = (place + 1) / count
            new = partial(
                Arcs.insert, arc=arc, share=share, joint=joint, level=0.0, held=sign
            )
            yield Change(gain, arc, new)
            continue
        last = place > 0.5 * (count - 1)
        beside = min(max(arc + (1 if last else -1), 0), arcs.count - 1)
        able = (arcs.held[arc] == 0) & ~arcs.follows[arc] & (arcs.levels[arc] != 0.0)
        changes = able & (arcs.levels[beside] != arcs.levels[arc])
        for other in np.flatnonzero(changes if changes.any() else able).tolist():
            new = partial(
                Arcs.lean, arc=arc, joint=joint, level=sign, other=other, last=last
            )
            yield Change(gain, arc, new, urgent=True)
