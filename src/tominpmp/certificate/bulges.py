"""Limits that hold a motion inside the intervals of its grid, and not at their ends.

Torques run through the intervals as the inverse dynamics has them, speeds and positions
as the accelerations do: either may be largest on the way.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array, IntArray
from tominpmp.certificate.active_limits import Motion
from tominpmp.certificate.instants import Instants
from tominpmp.certificate.limit_rows import LimitRows
from tominpmp.certificate.perturbations import Linearised, picked
from tominpmp.dynamics import InverseJacobians
from tominpmp.motion.trajectory import State
from tominpmp.motion_limits import EffortCurve

# Where in the intervals it is looked.
SHARES = np.arange(1, 10) / 10
# Values are rows inside an interval where they are larger there than at both of its
# ends by this share of their limits, and near them.
BULGE = 1e-3
NEAR = 0.97
# A torque that is less than this smaller in the middle runs along its limit.
FLAT = 1e-2
# Positions with less room than this [rad, or shares of the reach] that turn back inside
# an interval, by more than this.
ROOM, TURN = 0.05, 1e-5


def bulges(motion: Motion) -> list[LimitRows]:
    """Torques, speeds and positions where they are largest inside an interval."""
    at = Instants.spread(motion.changes.N, SHARES)
    inside = _Inside(motion, at, motion.trajectory(at.times(motion.changes)))
    found = [inside.speeds(), inside.positions()]
    if motion.changes.shape != "torques":
        found += [inside.torques(), *inside.over_speed()]
    return [rows for rows in found if rows is not None]


def _at_ends(values: Array) -> Array:
    """Values at nodes, at both ends of the intervals, shape (N, 2, n)."""
    return np.stack([values[:-1], values[1:]], axis=1)


@dataclass(frozen=True, eq=False)
class _Inside:
    """A motion, and its states inside the intervals."""

    motion: Motion
    at: Instants
    state: State

    def _largest(
        self, inside: Array, ends: Array, near: float = NEAR, more: float = BULGE
    ) -> tuple[IntArray, IntArray]:
        """Instants and joints at which values are largest, of those near their limits.

        Args:
            inside: Values as shares of their limits at all instants, shape (m, n).
            ends: Values at both ends of the intervals, shape (N, 2, n).
            near: What is near.
            more: By how much they are larger than at the ends.

        Returns:
            Indices of the instants and joints, shape (k,) each.
        """
        values = inside.reshape(self.motion.changes.N, SHARES.size, -1)
        peak, worst = np.max(values, axis=1), np.argmax(values, axis=1)
        over = (peak > near) & (peak > np.max(ends, axis=1) + more)
        interval, joint = np.nonzero(over)
        return interval * SHARES.size + worst[interval, joint], joint

    def _changes(self, index: IntArray) -> tuple[Linearised, Linearised, Linearised]:
        """Changes of the states at some of the instants."""
        q, v = self.state.q[index], self.state.v[index]
        return self.motion.changes.inside(*self.at.kept(index), q, v)

    def _one_of(self, joint: IntArray, scale: Array) -> Array:
        """Slopes of the values of joints by all joints, shape (k, n)."""
        slopes = np.zeros((joint.size, self.motion.changes.n))
        slopes[np.arange(joint.size), joint] = 1.0 / scale[joint]
        return slopes

    # -- states ------------------------------------------------------------------------

    def speeds(self) -> LimitRows | None:
        """Speeds that are largest between the nodes, or may come to be."""
        limit = self.motion.task.problem.robot.limits.velocity
        share, ends = self.state.v / limit, np.abs(self.motion.changes.v) / limit
        index, joint = self._largest(np.abs(share), _at_ends(ends))
        if self.motion.changes.shape == "ramps":
            index, joint = self._with_middles(
                index, joint, limit - np.abs(self.state.v)
            )
        if not index.size:
            return None
        slopes, value = self._one_of(joint, limit), share[index, joint]
        change = self._changes(index)[1]
        return LimitRows(
            "velocity",
            change.after(picked(slopes, index.size, np.arange(index.size))),
            np.minimum(-1.0 - value, 0.0),
            np.maximum(1.0 - value, 0.0),
            self.at.interval[index],
            joint,
            self.at.share[index],
            slopes=np.zeros_like(slopes),
            speed_slopes=slopes,
        )

    def _with_middles(
        self, index: IntArray, joint: IntArray, room: Array
    ) -> tuple[IntArray, IntArray]:
        """Instants and joints, and the middles where a speed can be raised too much.

        An acceleration that is raised at the beginning of an interval and lowered at
        its end leaves the speeds at both as they are; light joints can do that by much.
        """
        motion, every = self.motion, SHARES.size
        inertia = np.einsum("mii->mi", motion.parts.tau_a).mean(axis=0)
        strongest = 2.0 * motion.task.effort_half / np.maximum(inertia, 1e-12)
        h, middle = motion.changes.h, SHARES.size // 2
        interval, light = np.nonzero(h[:, None] * strongest / 8.0 > room[middle::every])
        known = np.isin(
            interval * motion.changes.n + light,
            (index // every) * motion.changes.n + joint,
        )
        more = interval[~known] * every + middle
        return np.append(index, more), np.append(joint, light[~known])

    def positions(self) -> LimitRows | None:
        """Positions of joints that turn back at a limit between the nodes."""
        limits, scale = (
            self.motion.task.problem.robot.limits,
            self.motion.task.step_scale,
        )
        low, high = limits.position_lower, limits.position_upper

        def beyond(q: Array) -> Array:
            return np.asarray(np.maximum(q - high, low - q) / scale)

        ends = _at_ends(beyond(self.motion.changes.q))
        index, joint = self._largest(beyond(self.state.q), ends, -ROOM, TURN)
        if not index.size:
            return None
        slopes, q = self._one_of(joint, scale), self.state.q[index, joint]
        change = self._changes(index)[0]
        return LimitRows(
            "position",
            change.after(picked(slopes, index.size, np.arange(index.size))),
            np.minimum((low[joint] - q) / scale[joint], 0.0),
            np.maximum((high[joint] - q) / scale[joint], 0.0),
            self.at.interval[index],
            joint,
            self.at.share[index],
            slopes=slopes,
            unit=scale[joint],
        )

    # -- torques -----------------------------------------------------------------------

    def _torque(self, index: IntArray, joint: IntArray) -> Linearised:
        """Changes of the torques of some joints, an instant each [N m or N]."""
        state, every = self.state, np.arange(index.size)
        parts: InverseJacobians = self.motion.task.dynamics.inverse_jacobians(
            state.q[index], state.v[index], state.a[index]
        )
        q, v, a = self._changes(index)
        by_q, by_v, by_a = (
            picked(part[every, joint], index.size, every)
            for part in (parts.tau_q, parts.tau_v, parts.tau_a)
        )
        return q.after(by_q) + v.after(by_v) + a.after(by_a)

    def torques(self) -> LimitRows | None:
        """Torques that are largest inside an interval."""
        motion, task = self.motion, self.motion.task
        load = (self.state.u - task.effort_middle) / task.effort_half
        undriven = np.setdiff1d(np.arange(motion.changes.n), motion.driven)
        seen = np.abs(load)
        seen[:, undriven] = 0.0
        # Where a torque runs along its limit, the middle is a row as well as the ends:
        # it does not change as their mean does.
        middle = np.arange(SHARES.size) == SHARES.size // 2
        favoured = (
            seen + np.where(np.tile(middle, motion.changes.N), FLAT, 0.0)[:, None]
        )
        index, joint = self._largest(favoured, np.abs(motion.loads))
        if not index.size:
            return None
        scale, value = _diagonal(1.0 / task.effort_half[joint]), load[index, joint]
        return LimitRows(
            "effort",
            self._torque(index, joint).after(scale),
            np.minimum(-1.0 - value, 0.0),
            np.maximum(1.0 - value, 0.0),
            self.at.interval[index],
            joint,
            self.at.share[index],
        )

    def over_speed(self) -> list[LimitRows]:
        """Torques that are nearest to what their speed allows inside an interval."""
        motion, n = self.motion, self.motion.changes.n
        limits, names = motion.task.problem.motion_limits, motion.trajectory.joint_names
        curves = {} if limits is None else (limits.effort_curves or {})
        half, out = motion.task.effort_half, []
        for name, curve in sorted(curves.items()):
            own = names.index(name)
            for sign in (1.0, -1.0):
                use = np.zeros((self.at.interval.size, n))
                ends = np.zeros((motion.changes.N, 2, n))
                speeds = _at_ends(motion.changes.v[:, own])
                use[:, own] = 1.0 - _room(
                    curve, sign * self.state.u[:, own], self.state.v[:, own], half[own]
                )
                ends[:, :, own] = 1.0 - _room(
                    curve, sign * motion.u[:, :, own], speeds, half[own]
                )
                index, joint = self._largest(use, ends)
                if index.size:
                    out.append(self._over_speed(curve, sign, index, joint))
        return out

    def _over_speed(
        self, curve: EffortCurve, sign: float, index: IntArray, joint: IntArray
    ) -> LimitRows:
        half, state = self.motion.task.effort_half[joint], self.state
        v = state.v[index, joint]
        slope = curve(v)[1] * np.sign(v)
        by_v = self._one_of(joint, np.ones(self.motion.changes.n)) * slope[:, None]
        speeds = self._changes(index)[1].after(
            picked(-by_v, index.size, np.arange(index.size))
        )
        torque = self._torque(index, joint).after(_diagonal(np.full(index.size, sign)))
        room = _room(curve, sign * state.u[index, joint], v, half)
        return LimitRows(
            "effort over speed",
            (torque + speeds).after(_diagonal(1.0 / half)),
            np.full(index.size, -np.inf),
            np.maximum(room, 0.0),
            self.at.interval[index],
            joint,
            self.at.share[index],
        )


def _room(
    curve: EffortCurve, torque: Array, speed: Array, half: Array | float
) -> Array:
    """What torques leave of what their speeds allow, in half ranges."""
    return np.asarray((curve(speed)[0] - torque) / half)


def _diagonal(values: Array) -> sp.csr_matrix:
    """Diagonal matrix."""
    return sp.diags(values).tocsr()
