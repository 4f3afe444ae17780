"""Shooting over arcs: lengths and torques such that the motion ends at the goal."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.exact.held_joints import FOLLOWS, HOLDS
from tominpmp.exact.radau import NODES, IntegratedArcs, explicit_stages, integrate
from tominpmp.exact.structure import Arcs
from tominpmp.stopping import check
from tominpmp.transcription.problem_functions import ProblemFunctions

# Typical velocities are this times the scale of positions over the duration.
SPEED_FACTOR = 5.0
# Limits are watched where a motion comes this near to them: as a share, and clearances
# as a share of the reach.
NEAR = 0.1
CLOSE = 0.05
POSITION, VELOCITY, TORQUE, CLEARANCE = range(4)


class WatchedLimits(NamedTuple):
    """Limits that are looked at, at the ends of steps.

    Attributes:
        kind: Which limit, shape (r,).
        node: At the end of which step, counted from 1, shape (r,).
        which: Joint or pair, shape (r,).
        sign: 1 for an upper limit, -1 for a lower one, shape (r,).
    """

    kind: IntArray
    node: IntArray
    which: IntArray
    sign: IntArray


@dataclass(frozen=True, eq=False)
class Shot:
    """A motion of a program, and how it depends on the unknowns.

    Attributes:
        motion: The motion.
        equal: Goal and entries of held arcs, zero where they hold, shape (e,).
        by_equal: Shape (e, size).
        room: What is left to the watched limits and bounds of the goal, shape (r,).
        by_room: Shape (r, size).
        seeds: Derivative of the goal's part of ``equal`` by the final state, (k, 2n).
        by_stages: Derivative of the stages, shape (M, 3, 2n, size).
    """

    motion: IntegratedArcs
    equal: Array
    by_equal: Array
    room: Array
    by_room: Array
    seeds: Array
    by_stages: Array


class ArcProgram:
    """Minimum time over the lengths of arcs and the torques that are free.

    The unknowns are y = (lengths over the first duration, free torque shares).

    Attributes:
        system: The functions of the problem.
        arcs: What the joints do.
        steps: Number of integration steps of each arc, shape (K,).
        watched: Limits that are looked at.
        guess: Stages of a motion near by, to begin with, shape (M, 3, 2n).
        evaluations: At how many states the dynamics have been evaluated.
    """

    def __init__(self, system: ProblemFunctions, arcs: Arcs, steps: IntArray) -> None:
        self.system, self.arcs, self.steps = system, arcs, steps
        self.duration = arcs.duration
        self.arc_of_step = np.repeat(np.arange(arcs.count), steps)
        self.watched = WatchedLimits(*np.zeros((4, 0), dtype=np.int64))
        self.evaluations = 0
        self._n = system.n
        self._start = np.concatenate([system.problem.q_start, system.v_start])
        self._held = arcs.held[self.arc_of_step] != 0
        self._follows = arcs.follows[self.arc_of_step]
        self._modes = HOLDS * self._held + FOLLOWS * self._follows
        self._column = np.full(arcs.free.shape, -1)
        self._column[arcs.free] = arcs.count + np.arange(int(arcs.free.sum()))
        # Not a number: without a guess steps are marched.
        self.guess = np.full((self.arc_of_step.size, 3, 2 * system.n), np.nan)
        self._last: tuple[Array, Shot | None] | None = None
        self._base: tuple[Array, Shot] | None = None
        self._speed = SPEED_FACTOR / self.duration * system.step_scale

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return self.arcs.count + int(self.arcs.free.sum())

    def watch(self, watched: WatchedLimits) -> None:
        """Look at other limits."""
        self.watched = watched
        self._last = None

    def pack(self) -> Array:
        """Unknowns of the arcs."""
        arcs = self.arcs
        return np.concatenate([arcs.lengths / self.duration, arcs.levels[arcs.free]])

    def unpack(self, y: Array) -> Arcs:
        """Arcs of unknowns."""
        arcs, count = self.arcs, self.arcs.count
        levels = arcs.levels.copy()
        levels[arcs.free] = np.clip(y[count:], -1.0, 1.0)
        lengths = np.maximum(y[:count], 0.0) * self.duration
        return replace(arcs, lengths=lengths, levels=levels)

    def shoot(self, y: Array) -> Shot | None:
        """The motion of some unknowns; None if it cannot be integrated."""
        check()
        if self._last is None or not np.array_equal(self._last[0], y):
            motion = self._integrate(y)
            shot = None if motion is None else self._differentiate(motion)
            if shot is not None:
                self._base = y.copy(), shot
            self._last = y.copy(), shot
        return self._last[1]

    def _integrate(self, y: Array) -> IntegratedArcs | None:
        system, arcs, of = self.system, self.unpack(y), self.arc_of_step
        u = system.effort_middle + system.effort_half * arcs.levels[of]
        h, guess = (arcs.lengths / self.steps)[of], self.guess
        drive = system.dynamics, self._start, u, self._modes, h
        if self._base is not None:
            # First-order prediction from the motion that was found last.
            z, shot = self._base
            guess = shot.motion.stages + shot.by_stages @ (y - z)
        motion, cost = integrate(*drive, guess)
        if motion is None:
            motion, more = integrate(*drive, explicit_stages(*drive))
            cost += h.size + more
        self.evaluations += cost
        return motion

    def propagate(self, motion: IntegratedArcs) -> tuple[Array, Array]:
        """Derivatives of the states by the unknowns.

        Returns:
            At the ends of the steps, from the start on, and at the stages: shapes
            (M + 1, 2n, size) and (M, 3, 2n, size).
        """
        by_start, by_u, by_h = motion.sensitivities
        count, stages, size, _ = by_start.shape
        of = self.arc_of_step
        drive = np.zeros((count, stages, size, self.size))
        each = np.arange(count)
        drive[each, :, :, of] = by_h * (self.duration / self.steps)[of, None, None]
        step, joint = np.nonzero(self._column[of] >= 0)
        column = self._column[of[step], joint]
        half = self.system.effort_half[joint, None, None]
        drive[step, :, :, column] = by_u[step, :, :, joint] * half
        out = np.zeros((count + 1, size, self.size))
        A, own = by_start[:, -1], drive[:, -1]
        for i in range(count):
            out[i + 1] = A[i] @ out[i] + own[i]
        return out, by_start @ out[:-1, None] + drive

    def _differentiate(self, motion: IntegratedArcs) -> Shot:
        system, n = self.system, self._n
        by, by_stages = self.propagate(motion)
        x, goal = motion.x, system.problem.goal
        end = x[-1, :n], x[-1, n:]
        value, by_q, by_v = goal.residual(system.kinematics, *end)
        scale = np.ones(value.size)
        if goal.fixes_velocity:
            scale[:-n] = system.step_scale if value.size == 2 * n else 1.0
            scale[-n:] = self._speed
        else:
            scale[-3:] = SPEED_FACTOR / self.duration
        low, high = system.goal_bounds
        exact = low == high
        seeds = np.hstack([by_q, by_v]) / scale[:, None]
        slopes = seeds @ by[-1]
        arc, joint = np.nonzero(self.arcs.entries)
        node = (np.cumsum(self.steps) - self.steps)[arc]
        limit = system.problem.robot.limits.velocity[joint]
        entry = x[node, n + joint] / limit - self.arcs.held[arc, joint]
        by_entry = by[node, n + joint] / limit[:, None]
        room, by_room = self._rooms(motion, by)
        above, below = ~exact & np.isfinite(high), ~exact & np.isfinite(low)
        to_high, to_low = (high - value) / scale, (value - low) / scale
        return Shot(
            motion,
            np.concatenate([to_low[exact], entry]),
            np.vstack([slopes[exact], by_entry]),
            np.concatenate([to_high[above], to_low[below], room]),
            np.vstack([-slopes[above], slopes[below], by_room]),
            seeds[exact],
            by_stages,
        )

    # -- limits ------------------------------------------------------------------------

    def _values(self, motion: IntegratedArcs, kind: int) -> tuple[Array, Array]:
        """Distances to upper and lower limits at the ends of steps, (M, k) each."""
        system, n = self.system, self._n
        limits, x = system.problem.robot.limits, motion.x[1:]
        if kind == POSITION:
            q, scale = x[:, :n], system.step_scale
            above, below = limits.position_upper - q, q - limits.position_lower
            return above / scale, below / scale
        if kind == VELOCITY:
            share = x[:, n:] / limits.velocity
            return 1.0 - share, 1.0 + share
        if kind == TORQUE:
            tau = motion.rates.tau.reshape(-1, 3, n)[:, -1]
            share = (tau - system.effort_middle) / system.effort_half
            return 1.0 - share, 1.0 + share
        assert system.clearance is not None  # noqa: S101
        room = -system.clearance.values(x[:, :n], times=np.cumsum(motion.h))
        return room, np.full_like(room, np.inf)

    def look(self, motion: IntegratedArcs, near: float | None = None) -> WatchedLimits:
        """Limits that a motion comes near to, or passes.

        Args:
            motion: The motion.
            near: How near, in shares; None takes the usual.
        """
        system, parts = self.system, list[WatchedLimits]()
        kinds = [POSITION, VELOCITY, TORQUE]
        if system.clearance is not None:
            kinds.append(CLEARANCE)
        # A joint that is held, or begins to be, is at its speed limit; torques that do
        # not follow are within theirs.
        held = self._held.copy()
        held[:-1] |= self._held[1:]
        free = {VELOCITY: held, TORQUE: ~self._follows}
        # A joint that is given at the end has no room to keep there.
        given = {POSITION: system.final_configuration, VELOCITY: system.final_velocity}
        for kind in kinds:
            distance = (CLOSE if kind == CLEARANCE else NEAR) if near is None else near
            for sign, room in zip((1, -1), self._values(motion, kind), strict=True):
                if kind in free:
                    room[free[kind]] = np.inf
                if given.get(kind) is not None:
                    room[-1] = np.inf
                step, index = np.nonzero(room < distance)
                what, signs = np.full_like(step, kind), np.full_like(step, sign)
                parts.append(WatchedLimits(what, step + 1, index, signs))
        return WatchedLimits(
            *(np.concatenate(part) for part in zip(*parts, strict=True))
        )

    def _room(self, motion: IntegratedArcs, watched: WatchedLimits) -> Array:
        """Distances to limits, shape (r,)."""
        room = np.zeros(watched.kind.size)
        for kind in np.unique(watched.kind).tolist():
            rows = watched.kind == kind
            at = watched.node[rows] - 1, watched.which[rows]
            high, low = self._values(motion, kind)
            room[rows] = np.where(watched.sign[rows] > 0, high[at], low[at])
        return room

    def _rooms(self, motion: IntegratedArcs, by: Array) -> tuple[Array, Array]:
        """Distances to the watched limits, with derivatives."""
        system, n, watched = self.system, self._n, self.watched
        by_room = np.zeros((watched.kind.size, self.size))
        limits = system.problem.robot.limits
        for kind in np.unique(watched.kind).tolist():
            rows = np.flatnonzero(watched.kind == kind)
            node, index = watched.node[rows], watched.which[rows]
            if kind == POSITION:
                slope = by[node, index] / system.step_scale[index, None]
            elif kind == VELOCITY:
                slope = by[node, n + index] / limits.velocity[index, None]
            elif kind == TORQUE:
                slope = self._torque_slopes(motion, by, node, index)
            else:
                slope = self._clearance_slopes(motion, by, node, index)
            by_room[rows] = -watched.sign[rows, None] * slope
        return self._room(motion, watched), by_room

    def _clearance_slopes(
        self, motion: IntegratedArcs, by: Array, node: IntArray, index: IntArray
    ) -> Array:
        clearance, n = self.system.clearance, self._n
        assert clearance is not None  # noqa: S101
        gradients, rates = clearance.derivatives_at(
            motion.x[1:, :n], node - 1, index, np.cumsum(motion.h)
        )
        slope: Array = np.einsum("rj,rjz->rz", gradients, by[node, :n])
        if clearance.moving:
            # The time at the end of a step is the sum of the steps before.
            over = np.arange(self.steps.size) == self.arc_of_step[:, None]
            share = over * (self.duration / self.steps)
            arcs = np.arange(self.arcs.count)
            slope[:, arcs] += rates[:, None] * np.cumsum(share, axis=0)[node - 1]
        return slope

    def _torque_slopes(
        self, motion: IntegratedArcs, by: Array, node: IntArray, index: IntArray
    ) -> Array:
        rates, last = motion.rates, 3 * node - 1
        slope = np.einsum("rx,rxz->rz", rates.tau_x[last, index], by[node])
        column = self._column[self.arc_of_step[node - 1]]
        row, joint = np.nonzero(column >= 0)
        by_u = rates.tau_u[last[row], index[row], joint]
        slope[row, column[row, joint]] += by_u * self.system.effort_half[joint]
        return np.asarray(slope / self.system.effort_half[index, None])

    def excess(self, motion: IntegratedArcs, slack: float) -> float:
        """What the limits are passed by at the ends of steps, if by more than slack."""
        passed = self.look(motion, -slack)
        return float(np.max(-self._room(motion, passed), initial=0.0))

    def sample_times(self, arcs: Arcs) -> Array:
        """Times of the stages, shape (M, 3) [s]."""
        h = (arcs.lengths / self.steps)[self.arc_of_step]
        return np.asarray((np.cumsum(h) - h)[:, None] + h[:, None] * NODES)
