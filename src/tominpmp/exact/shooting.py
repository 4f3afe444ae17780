"""Shooting over arcs: lengths and torques such that the motion ends at the goal."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.constraints.base import States
from tominpmp.exact.held_joints import FOLLOWS, HOLDS
from tominpmp.exact.radau import (
    NODES,
    STAGES,
    IntegratedArcs,
    explicit_stages,
    integrate,
)
from tominpmp.exact.structure import Arcs
from tominpmp.stopping import check
from tominpmp.transcription.controls import SPEED_FACTOR
from tominpmp.transcription.problem_functions import ProblemFunctions

# Limits are watched where a motion comes this near to them: as a share, and clearances
# as a share of the reach.
NEAR = 0.1
CLOSE = 0.05
POSITION, VELOCITY, TORQUE, CLEARANCE = range(4)
# Kinds of the constraints that bound positions, velocities or torques.
FIELDS = {"q": POSITION, "v": VELOCITY, "u": TORQUE}


class WatchedLimits(NamedTuple):
    """Limits that are looked at, at the ends of steps.

    Attributes:
        kind: Which limit, shape (r,).
        node: At the end of which step, counted from 1, shape (r,).
        which: Index of the value of the constraint, shape (r,).
        sign: 1 for an upper limit, -1 for a lower one, shape (r,).
        room: Distance to it in the motion that was looked at, shape (r,).
    """

    kind: IntArray
    node: IntArray
    which: IntArray
    sign: IntArray
    room: Array


class EndRows(NamedTuple):
    """Rows of a program, each of which depends on what is at the end of a step.

    Attributes:
        value: Their values, shape (k,).
        node: At the end of which step, counted from 1, shape (k,).
        by_x: Derivatives by the state there, shape (k, 2n).
        by_u: Derivatives by the torques on the step, shape (k, n).
        by_t: Derivatives by the time, shape (k,).
    """

    value: Array
    node: IntArray
    by_x: Array
    by_u: Array
    by_t: Array

    @classmethod
    def of_states(cls, value: Array, node: IntArray | int, by_x: Array) -> EndRows:
        """Rows that depend on states alone."""
        count, size = by_x.shape
        nodes = np.broadcast_to(node, count)
        return cls(value, nodes, by_x, np.zeros((count, size // 2)), np.zeros(count))


@dataclass(frozen=True, eq=False)
class Shot:
    """A motion of a program, and how it depends on the unknowns.

    Attributes:
        motion: The motion.
        equal: Goal and entries of held arcs, zero where they hold, shape (e,).
        by_equal: Shape (e, size).
        room: What is left to bounds of the goal and the watched limits, shape (r,).
        by_room: Shape (r, size).
        rows: Both, one after the other.
        by_stages: Derivative of the stages, shape (M, 3, 2n, size).
    """

    motion: IntegratedArcs
    equal: Array
    by_equal: Array
    room: Array
    by_room: Array
    rows: EndRows
    by_stages: Array


class ArcProgram:
    """Minimum time over the lengths of arcs and the torques that are free.

    The unknowns are y = (lengths over the first duration, free torque shares).

    Attributes:
        system: The functions of the problem.
        limits: The constraints that can be watched, by the kind of limit.
        arcs: What the joints do.
        steps: Number of integration steps of each arc, shape (K,).
        follows: Whether torques follow from held joints on the steps, shape (M, n).
        modes: Which joints are held and which torques follow on the steps, see
            :func:`~tominpmp.exact.held_joints.differentiate_rates`, shape (M, n).
        watched: Limits that are looked at.
        guess: Stages of a motion near by, to begin with, shape (M, 3, 2n).
        evaluations: At how many states the dynamics have been evaluated.
    """

    def __init__(self, system: ProblemFunctions, arcs: Arcs, steps: IntArray) -> None:
        self.system, self.arcs, self.steps = system, arcs, steps
        self.limits: dict[int, Any] = {
            FIELDS[item.field]: item
            for item in system.constraints
            if item.field in FIELDS
        }
        if system.clearance is not None:
            self.limits[CLEARANCE] = system.clearance
        self.duration = arcs.duration
        self.arc_of_step = np.repeat(np.arange(arcs.count), steps)
        self.watched = WatchedLimits(*np.zeros((5, 0), dtype=np.int64))
        self.evaluations = 0
        self._n = system.n
        self._start = np.concatenate([system.problem.q_start, system.v_start])
        self._held = arcs.held[self.arc_of_step] != 0
        self.follows = arcs.follows[self.arc_of_step]
        self.modes = HOLDS * self._held + FOLLOWS * self.follows
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
        drive = system.dynamics, self._start, u, self.modes, h
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
        x, goal = motion.x, system.problem.goal
        value, by_q, by_v = goal.residual(system.kinematics, x[-1, :n], x[-1, n:])
        scale = np.ones(value.size)
        if goal.fixes_velocity:
            scale[:-n] = system.step_scale if value.size == 2 * n else 1.0
            scale[-n:] = self._speed
        else:
            scale[-3:] = SPEED_FACTOR / self.duration
        low, high = system.goal_bounds
        exact = low == high
        above, below = ~exact & np.isfinite(high), ~exact & np.isfinite(low)
        to_high, to_low = (high - value) / scale, (value - low) / scale
        slope, end = np.hstack([by_q, by_v]) / scale[:, None], self.arc_of_step.size
        arc, joint = np.nonzero(self.arcs.entries)
        node = (np.cumsum(self.steps) - self.steps)[arc]
        limit = system.problem.robot.limits.velocity[joint]
        entry = x[node, n + joint] / limit - self.arcs.held[arc, joint]
        parts = (
            EndRows.of_states(to_low[exact], end, slope[exact]),
            EndRows.of_states(entry, node, np.eye(2 * n)[n + joint] / limit[:, None]),
            EndRows.of_states(to_high[above], end, -slope[above]),
            EndRows.of_states(to_low[below], end, slope[below]),
            self._watched_rows(motion),
        )
        columns: Iterator[Any] = zip(*parts, strict=True)
        rows = EndRows(*map(np.concatenate, columns))
        by, by_stages = self.propagate(motion)
        value, slopes = rows.value, self._slopes(rows, by)
        equal = int(exact.sum()) + entry.size
        equations = value[:equal], slopes[:equal]
        return Shot(motion, *equations, value[equal:], slopes[equal:], rows, by_stages)

    def _slopes(self, rows: EndRows, by: Array) -> Array:
        """Derivatives of rows by the unknowns, shape (k, size).

        Args:
            rows: The rows.
            by: Derivatives of the states at the ends of steps, (M + 1, 2n, size).
        """
        out = np.einsum("kx,kxz->kz", rows.by_x, by[rows.node])
        column = self._column[self.arc_of_step[rows.node - 1]]
        row, joint = np.nonzero(column >= 0)
        by_share = rows.by_u[row, joint] * self.system.effort_half[joint]
        out[row, column[row, joint]] += by_share
        # The time at the end of a step is the sum of the steps before.
        over = np.arange(self.steps.size) == self.arc_of_step[:, None]
        share = np.cumsum(over * (self.duration / self.steps), axis=0)
        out[:, : self.arcs.count] += rows.by_t[:, None] * share[rows.node - 1]
        return np.asarray(out)

    # -- limits ------------------------------------------------------------------------

    def _states(self, motion: IntegratedArcs) -> States:
        """States at the ends of steps."""
        n, x = self._n, motion.x[1:]
        torque = motion.rates.tau.reshape(-1, STAGES, n)[:, -1]
        none, t = np.zeros((0, n)), np.cumsum(motion.h)
        return States(t, x[:, :n], x[:, n:], none, torque)

    def _values(self, states: States, kind: int) -> tuple[Array, Array]:
        """Distances to upper and lower limits at states, shape (m, k) each."""
        values = self.limits[kind].evaluate(states)
        lower, upper = self.limits[kind].bounds(states.t.size)
        return upper - values, values - lower

    def look(self, motion: IntegratedArcs, near: float | None = None) -> WatchedLimits:
        """Limits that a motion comes near to, or passes.

        Args:
            motion: The motion.
            near: How near, in shares; None takes the usual.
        """
        system, states = self.system, self._states(motion)
        parts = list[WatchedLimits]()
        # A joint that is held, or begins to be, is at its speed limit; torques that do
        # not follow are within theirs.
        held = self._held.copy()
        held[:-1] |= self._held[1:]
        free = {VELOCITY: held, TORQUE: ~self.follows}
        # A joint that is given at the end has no room to keep there.
        given = {POSITION: system.final_configuration, VELOCITY: system.final_velocity}
        for kind in sorted(self.limits):
            distance = (CLOSE if kind == CLEARANCE else NEAR) if near is None else near
            for sign, room in zip((1, -1), self._values(states, kind), strict=True):
                if kind in free:
                    room[free[kind][:, self.limits[kind].of_joints]] = np.inf
                if given.get(kind) is not None:
                    room[-1] = np.inf
                step, index = np.nonzero(room < distance)
                what, signs = np.full_like(step, kind), np.full_like(step, sign)
                rooms = room[step, index]
                parts.append(WatchedLimits(what, step + 1, index, signs, rooms))
        return WatchedLimits(
            *(np.concatenate(part) for part in zip(*parts, strict=True))
        )

    def _watched_rows(self, motion: IntegratedArcs) -> EndRows:
        """Distances to the watched limits, with derivatives."""
        n, watched, rates = self._n, self.watched, motion.rates
        states, count = self._states(motion), watched.kind.size
        by_x = np.zeros((count, 2 * n))
        out = EndRows.of_states(np.zeros(count), watched.node, by_x)
        for kind in np.unique(watched.kind).tolist():
            rows = np.flatnonzero(watched.kind == kind)
            node, which, sign = (part[rows] for part in watched[1:4])
            high, low = (room[node - 1, which] for room in self._values(states, kind))
            out.value[rows] = np.where(sign > 0, high, low)
            by = self.limits[kind].differentiate(states, node - 1, which)
            by = by.times(-sign[:, None])
            for part, joints in ((by.by_q, slice(n)), (by.by_v, slice(n, None))):
                if part is not None:
                    out.by_x[rows, joints] = part
            if by.by_u is not None:
                # Torques that follow depend on the state and on the other torques.
                last = STAGES * node - 1
                out.by_x[rows] += np.einsum("kj,kjx->kx", by.by_u, rates.tau_x[last])
                out.by_u[rows] = np.einsum("kj,kji->ki", by.by_u, rates.tau_u[last])
            if by.by_t is not None:
                out.by_t[rows] = by.by_t
        return out

    def excess(self, motion: IntegratedArcs, slack: float) -> float:
        """What the limits are passed by at the ends of steps, if by more than slack."""
        return float(np.max(-self.look(motion, -slack).room, initial=0.0))

    def sample_times(self, arcs: Arcs) -> Array:
        """Times of the stages, shape (M, 3) [s]."""
        h = (arcs.lengths / self.steps)[self.arc_of_step]
        return np.asarray((np.cumsum(h) - h)[:, None] + h[:, None] * NODES)
