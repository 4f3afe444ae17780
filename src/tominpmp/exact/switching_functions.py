r"""Switching functions of arcs: first-order gains of changes of the structure.

At the solution of an :class:`~tominpmp.exact.shooting.ArcProgram` the multipliers give
the costate p at the end, which the discrete adjoint equation propagates backwards; the
derivative of the duration by the torque of a step is p^T B, the switching function. A
torque at its upper limit with a positive derivative, or at its lower limit with a
negative derivative, violates the minimum principle, and should be at the other limit
for some time.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from tominpmp.arrays import Array
from tominpmp.exact.shooting import TORQUE, VELOCITY, ArcProgram, Shot
from tominpmp.exact.structure import Edit
from tominpmp.transcription.integrator import StepJacobians, sweep_adjoint

# Limits with a smaller margin than this are active.
ACTIVE = 1e-6
# Lengths and torques this close to their bounds count as being at them.
ON_BOUND = 1e-9


@dataclass(frozen=True)
class ArcChange:
    """A change of the structure with a predicted gain.

    Attributes:
        gain: Predicted reduction of the duration to first order [s], for changes that
            insert an arc per second of its length.
        arc: Index of the arc to change.
        shares: Lengths of the pieces of the arc, see :meth:`Arcs.divided`.
        edits: Torques on the pieces.
        urgent: Whether the change precedes all others of its arc: the torque of another
            joint must hold a joint whose own torque has reached its limit.
    """

    gain: float
    arc: int
    shares: Sequence[float]
    edits: Sequence[Edit]
    urgent: bool = False


def _multipliers(program: ArcProgram, y: Array, shot: Shot) -> Array:
    """Multipliers of the rows, by least squares, shape (e + r,).

    They are in units of the initial duration, and negative for limits that cost time.
    """
    count = program.arcs.count
    moving = np.concatenate([y[:count] > ON_BOUND, np.abs(y[count:]) < 1.0 - ON_BOUND])
    used = np.append(np.full(shot.equations, True), shot.margin < ACTIVE)
    matrix, weights = shot.slopes[used][:, moving], np.zeros(used.size)
    cost = program.of_lengths[moving]
    weights[used] = np.linalg.lstsq(matrix.T, -cost, rcond=1e-10)[0]
    return weights


def torque_slopes(program: ArcProgram, shot: Shot, weights: Array) -> Array:
    """Derivatives of the duration by the torque shares of steps, shape (M, n) [s].

    Args:
        program: The program.
        shot: The motion.
        weights: Multipliers of the rows in units of the initial duration, shape
            (e + r,).
    """
    steps = StepJacobians(*(part[:, -1] for part in shot.motion.sensitivities))
    rows, weight = shot.rows, weights[:, None]
    same = np.zeros(weights.size, dtype=np.int64)  # one functional: the weighted sum
    slopes, _ = sweep_adjoint(steps, rows.node, weight * rows.by_x, same)
    np.add.at(slopes[0], rows.node - 1, weight * rows.by_u)
    return np.asarray(slopes[0] * program.system.effort_half * program.duration)


def find_changes(
    program: ArcProgram, y: Array, shot: Shot, least: float
) -> list[ArcChange]:
    """Changes of the structure with the largest predicted gain on each arc.

    Args:
        program: The program.
        y: Solution of the program.
        shot: The motion of the solution.
        least: Least predicted gain [s].

    Returns:
        Changes in the order of the arcs, at most one for each arc.
    """
    weights = _multipliers(program, y, shot)
    slopes = torque_slopes(program, shot, weights)
    arcs = program.unpack(y)
    found: dict[int, ArcChange] = {}

    def offer(change: ArcChange) -> None:
        known = found.get(change.arc, ArcChange(least, change.arc, (), ()))
        if (change.urgent, change.gain) > (known.urgent, known.gain):
            found[change.arc] = change

    for k, of_arc in enumerate(np.split(slopes, np.cumsum(program.steps)[:-1])):
        for j, slope in enumerate(of_arc.T):
            level = float(arcs.levels[k, j])
            if arcs.free[k, j] and not arcs.held[k, j]:
                offer(_bang_bang(k, j, level, slope))
                continue
            if arcs.held[k, j] or arcs.follows[k, j] or abs(level) != 1.0:
                continue
            wrong = np.maximum(2.0 * level * slope, 0.0)
            # Beginnings and ends of the runs of steps with the wrong sign.
            turns = np.diff((wrong > 0.0).astype(int), prepend=0, append=0)
            for a, b in np.flatnonzero(turns).reshape(-1, 2).tolist():
                peak = a + int(np.argmax(wrong[a:b]))
                share = (peak + 0.5) / wrong.size
                shares, edit = (share, 0.0, 1.0 - share), Edit(1, j, -level)
                offer(ArcChange(float(wrong[a:b].sum()), k, shares, (edit,)))
    for change in _limit_changes(program, weights):
        offer(change)
    return [found[k] for k in sorted(found)]


def _bang_bang(arc: int, joint: int, level: float, slopes: Array) -> ArcChange:
    """Replace a torque between its limits by torques at its limits.

    A constant torque on an arc is optimal in the mean only. It goes to its upper limit
    where the duration falls with the torque, and to its lower limit where it grows.

    Args:
        arc: Index of the arc.
        joint: Index of the joint.
        level: Torque of the joint as a share of the limits.
        slopes: Derivatives of the duration by the torque of each step, shape (m,).
    """
    ends = np.flatnonzero(np.diff(np.sign(slopes))) + 1
    runs = np.split(slopes, ends)
    levels = [-1.0 if run.sum() > 0.0 else 1.0 for run in runs]
    shares = [run.size / slopes.size for run in runs]
    if len(runs) == 2:
        # Lengths that preserve the mean torque.
        first = (level - levels[1]) / (levels[0] - levels[1])
        shares = [first, 1.0 - first]
    gain = float(np.sum(np.abs(slopes) + slopes * level))
    edits = [Edit(piece, joint, level) for piece, level in enumerate(levels)]
    return ArcChange(gain, arc, shares, edits)


def _limit_changes(program: ArcProgram, of_rows: Array) -> Iterator[ArcChange]:
    """Changes for joints at a speed limit, and for held joints at a torque limit.

    A joint that touches its speed limit may stay at it for an arc. If the torque of a
    held joint reaches its limit at an end of the arc, the torque of another joint may
    hold it for an arc: preferably a torque that switches at this end.

    Args:
        program: The program, at its solution.
        of_rows: Multipliers of the rows, shape (e + r,).
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
            edit = Edit(1, joint, 0.0, sign, follows=True)
            yield ArcChange(gain, arc, (share, 0.0, 1.0 - share), (edit,))
            continue
        last = place > 0.5 * (count - 1)
        neighbour = min(max(arc + (1 if last else -1), 0), arcs.count - 1)
        able = (arcs.held[arc] == 0) & ~arcs.follows[arc] & (arcs.levels[arc] != 0.0)
        switches = able & (arcs.levels[neighbour] != arcs.levels[arc])
        for other in np.flatnonzero(switches if switches.any() else able).tolist():
            edits = (
                Edit(int(last), joint, sign, int(arcs.held[arc, joint])),
                Edit(int(last), other, float(arcs.levels[arc, other]), follows=True),
            )
            shares = (1.0, 0.0) if last else (0.0, 1.0)
            yield ArcChange(gain, arc, shares, edits, urgent=True)
