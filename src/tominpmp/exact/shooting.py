"""Single shooting over arcs: the nonlinear program in their lengths and free torques.

The motion is integrated from the start over all arcs; rows require that it ends at the
goal, enters arcs on which a joint is held with the speed limit of the joint, and keeps
the limits to which its margin is small.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import BarycentricInterpolator

from tominpmp.arrays import Array, IntArray
from tominpmp.constraints.base import States
from tominpmp.constraints.final import GoalReached
from tominpmp.exact.held_joints import FOLLOWS, HOLDS, differentiate_rates
from tominpmp.exact.radau import NODES, STAGES, IntegratedArcs, integrate
from tominpmp.exact.structure import Arcs
from tominpmp.motion.trajectory import Trajectory
from tominpmp.stopping import check
from tominpmp.transcription.base import Rows
from tominpmp.transcription.controls import scale_of_goal
from tominpmp.transcription.problem_functions import ProblemFunctions

# Limits become rows where the margin of a motion is smaller than this: in scaled units,
# mostly shares of the limit, and for clearances in shares of the reach.
NEAR = 0.1
CLOSE = 0.05
# Kinds of rows, and the names of their constraints.
GOAL, POSITION, VELOCITY, TORQUE, CLEARANCE, HOLDING = range(6)
KINDS = ("goal", "position", "velocity", "torque", "clearance", "holding torque")
# Number of parts of a step with a held joint, whose torque changes during the step.
CUTS = 4
# Steps shorter than this share of the duration are left out of the motion.
VANISHED = 1e-9


class BoundRows(NamedTuple):
    """Rows of a program: bounds of constraints at the ends of steps.

    Attributes:
        kind: Kind of the constraint of each row, shape (r,).
        node: Number of the step at whose end each row is evaluated, from 1, shape (r,).
        which: Index of the value of the constraint, shape (r,).
        sign: 1 for upper bounds, -1 for lower bounds, shape (r,).
        margin: Margin to the bound in the motion that was inspected, shape (r,).
    """

    kind: IntArray
    node: IntArray
    which: IntArray
    sign: IntArray
    margin: Array

    @classmethod
    def joined(cls, parts: Iterable[BoundRows]) -> BoundRows:
        """Concatenate rows."""
        return cls(*map(np.concatenate, zip(*parts, strict=True)))


class Margins(NamedTuple):
    """Margins of a motion to the bounds of rows, and their derivatives.

    Attributes:
        value: Margins, shape (k,).
        node: Number of the step at whose end each row is evaluated, shape (k,).
        by_x: Derivatives by the state there, shape (k, 2n).
        by_u: Derivatives by the torques on the step, shape (k, n).
        by_t: Derivatives by the time, shape (k,).
    """

    value: Array
    node: IntArray
    by_x: Array
    by_u: Array
    by_t: Array


@dataclass(frozen=True, eq=False)
class Shot:
    """A motion of a program, its row values, and their derivatives by the unknowns.

    Attributes:
        motion: The motion.
        rows: Margins to the bounds of all rows: e equations first, of the goal and of
            the entries of held arcs, then the bounds of a goal region, and the watched
            limits.
        slopes: Derivatives of the rows, shape (e + r, size).
        equations: Number e of equations.
        by_stages: Derivatives of the stages, shape (M, 3, 2n, size).
    """

    motion: IntegratedArcs
    rows: Margins
    slopes: Array
    equations: int
    by_stages: Array

    @property
    def margin(self) -> Array:
        """Margins, shape (r,)."""
        return self.rows.value[self.equations :]


class ArcProgram:
    """Minimum-time program in the lengths of arcs and the free torques.

    It has the interface :class:`~tominpmp.transcription.base.ProgramInterface`, for the
    records of plans. The unknowns are y = (lengths over the initial duration, free
    torque shares).

    Attributes:
        system: The functions of the problem.
        limits: The constraints that have rows or can have some, by the kind of row.
        arcs: Structure of the arcs, with their initial lengths and torques.
        steps: Number of integration steps of each arc, shape (K,).
        size: Number of unknowns.
        duration: Initial duration [s].
        arc_of_step: Index of the arc of each step, shape (M,).
        follows: Whether torques follow from held joints on the steps, shape (M, n).
        modes: Modes of the joints on the steps, see
            :func:`~tominpmp.exact.held_joints.differentiate_rates`, shape (M, n).
        equations: Number of rows that are equations, which come first.
        bounds: The rows.
        watched: The last rows, of the limits that a motion comes near to.
        guess: Stages of a similar motion, the first initial guess of integrations,
            shape (M, 3, 2n); by default the arm stays at its start.
        evaluations: Number of states at which the dynamics have been evaluated.
    """

    def __init__(self, system: ProblemFunctions, arcs: Arcs, steps: IntArray) -> None:
        self.system, self.arcs, self.steps = system, arcs, steps
        scale = scale_of_goal(system, arcs.duration)
        goal = GoalReached(system.problem.goal, system.kinematics, scale)
        items = filter(None, (*system.constraints, system.held, goal))
        self.limits: dict[int, Any] = {
            KINDS.index(item.name): item for item in items if item.name in KINDS
        }
        self.size = arcs.count + int(arcs.free.sum())
        self.duration = arcs.duration
        self.arc_of_step = np.repeat(np.arange(arcs.count), steps)
        self.evaluations = 0
        self._n = system.n
        self._start = system.problem.x_start
        self.follows = arcs.follows[self.arc_of_step]
        held = arcs.held[self.arc_of_step] != 0
        self.modes = HOLDS * held + FOLLOWS * self.follows
        self._column = np.full(arcs.free.shape, -1)
        self._column[arcs.free] = arcs.count + np.arange(int(arcs.free.sum()))
        self.guess = np.tile(self._start, (self.arc_of_step.size, STAGES, 1))
        self._last: tuple[Array, Shot | None] | None = None
        self._base: tuple[Array, Shot] | None = None
        low, high = map(np.ravel, goal.bounds(1))
        exact, end = low == high, self.arc_of_step.size
        rows = [(GOAL, end, k, -1) for k in np.flatnonzero(exact).tolist()]
        for arc, joint in np.argwhere(arcs.entries).tolist():
            which = int(np.searchsorted(self.limits[VELOCITY].of_joints, joint))
            node, sign = int(steps[:arc].sum()), int(arcs.held[arc, joint])
            rows.append((VELOCITY, node, which, sign))
        self.equations = len(rows)
        for sign, bound in ((1, high), (-1, low)):
            region = np.flatnonzero(~exact & np.isfinite(bound))
            rows += [(GOAL, end, k, sign) for k in region.tolist()]
        columns = np.array([(*row, 0) for row in rows], dtype=np.int64)
        self._required = BoundRows(*columns.reshape(-1, 5).T)
        self.watch(BoundRows(*np.zeros((5, 0), dtype=np.int64)))

    def watch(self, watched: BoundRows) -> None:
        """Replace the rows of limits."""
        self.watched, self._last = watched, None
        self.bounds = BoundRows.joined([self._required, watched])

    def pack(self) -> Array:
        """Unknowns for the initial arcs."""
        arcs = self.arcs
        return np.concatenate([arcs.lengths / self.duration, arcs.levels[arcs.free]])

    def unpack(self, y: Array) -> Arcs:
        """Arcs for given unknowns."""
        arcs, count = self.arcs, self.arcs.count
        levels = arcs.levels.copy()
        levels[arcs.free] = np.clip(y[count:], -1.0, 1.0)
        lengths = np.maximum(y[:count], 0.0) * self.duration
        return replace(arcs, lengths=lengths, levels=levels)

    # -- as a program of a plan --------------------------------------------------------

    @property
    def rows(self) -> Rows:
        """Bounds, kinds and groups of the rows."""
        kind = self.bounds.kind
        upper = np.where(np.arange(kind.size) < self.equations, 0.0, np.inf)
        return Rows(np.zeros(kind.size), upper, kind, kind, KINDS)

    @property
    def of_lengths(self) -> Array:
        """Gradient of the duration in units of the initial duration, shape (size,)."""
        return np.where(np.arange(self.size) < self.arcs.count, 1.0, 0.0)

    @property
    def cost(self) -> Array:
        """Gradient of the duration."""
        return self.duration * self.of_lengths

    def evaluate(self, z: Array, attention: float = np.inf) -> Array:
        """Row values."""
        shot = self.shoot(z)
        return -self.rows.not_integrated if shot is None else shot.rows.value

    def time_scale(self, z: Array, factor: float) -> Array:
        """Iterate with the same torques on longer arcs."""
        return np.where(self.of_lengths > 0.0, factor * z, z)

    def trajectory(self, z: Array) -> Trajectory:
        """The motion of an iterate, with nodes at the ends of all steps.

        Steps with held joints are divided, and steps of almost no length left out.

        Raises:
            ValueError: If the motion cannot be integrated.
        """
        system, n, shot = self.system, self._n, self.shoot(z)
        if shot is None:
            raise ValueError("the motion cannot be integrated")
        motion, levels = shot.motion, self.unpack(z).levels
        u = system.effort_middle + system.effort_half * levels[self.arc_of_step]
        steps = np.flatnonzero(motion.h > VANISHED * motion.h.sum())
        parts = np.where(self.modes.any(axis=1), CUTS, 1)
        of = np.repeat(steps, parts[steps])
        parts, part = parts[of], np.arange(of.size) - np.searchsorted(of, of)
        # Collocation polynomials through the starts and the stages of the steps.
        known, ticks = np.append(0.0, NODES), np.arange(1, 2 * CUTS + 1) / (2 * CUTS)
        points = np.concatenate([motion.x[None, :-1], np.swapaxes(motion.stages, 0, 1)])
        # SciPy would find these weights in a random order, with another rounding.
        weights = 1.0 / np.prod(known[:, None] - known + np.eye(known.size), axis=1)
        inside = BarycentricInterpolator(known, points, wi=weights)(ticks)
        middle = inside[CUTS // parts * (2 * part + 1) - 1, of]
        ends = inside[CUTS // parts * (2 * part + 2) - 1, of]
        held = differentiate_rates(system.dynamics, middle, u[of], self.modes[of])
        torque = np.where(self.follows[of], held.tau, u[of]) + system.resistance
        states = np.vstack([motion.x[:1], ends])
        return Trajectory(
            joint_names=system.problem.robot.joint_names,
            t=np.append(0.0, np.cumsum(motion.h[of] / parts)),
            q=states[:, :n],
            v=states[:, n:],
            u=np.concatenate([torque, torque[-1:]]),
            holding=system.dynamics.inverse,
        )

    # -- shooting ----------------------------------------------------------------------

    def shoot(self, y: Array) -> Shot | None:
        """Motion and rows for given unknowns; None if integration fails."""
        check()
        if self._last is None or not np.array_equal(self._last[0], y):
            motion = self._integrate(y)
            shot = None if motion is None else self._differentiate(motion)
            if shot is not None:
                self._base = y.copy(), shot
            self._last = y.copy(), shot
        return self._last[1]

    def _integrate(self, y: Array) -> IntegratedArcs | None:
        """Motion for given unknowns; None if integration fails."""
        system, arcs, of = self.system, self.unpack(y), self.arc_of_step
        u = system.effort_middle + system.effort_half * arcs.levels[of]
        h, guess = (arcs.lengths / self.steps)[of], self.guess
        if self._base is not None:
            # Guess: first-order prediction from the last motion.
            z, shot = self._base
            guess = shot.motion.stages + shot.by_stages @ (y - z)
        motion, cost = integrate(system.dynamics, self._start, u, self.modes, h, guess)
        self.evaluations += cost
        return motion

    def propagate(self, motion: IntegratedArcs) -> tuple[Array, Array]:
        """Derivatives of the states by the unknowns.

        Returns:
            Derivatives at the start and the ends of the steps, shape
            (M + 1, 2n, size), and at the stages, shape (M, 3, 2n, size).
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
        """Rows of a motion, with their derivatives."""
        rows, (by, by_stages) = self._rows(motion), self.propagate(motion)
        return Shot(motion, rows, self._slopes(rows, by), self.equations, by_stages)

    def _slopes(self, rows: Margins, by: Array) -> Array:
        """Derivatives of rows by the unknowns, shape (k, size).

        Args:
            rows: The rows.
            by: Derivatives of the states at the start and the ends of steps, shape
                (M + 1, 2n, size).
        """
        out = np.einsum("kx,kxz->kz", rows.by_x, by[rows.node])
        column = self._column[self.arc_of_step[rows.node - 1]]
        row, joint = np.nonzero(column >= 0)
        by_share = rows.by_u[row, joint] * self.system.effort_half[joint]
        out[row, column[row, joint]] += by_share
        # The time at the end of a step is the sum of all lengths up to it.
        over = np.arange(self.steps.size) == self.arc_of_step[:, None]
        share = np.cumsum(over * (self.duration / self.steps), axis=0)
        out[:, : self.arcs.count] += rows.by_t[:, None] * share[rows.node - 1]
        return np.asarray(out)

    # -- limits ------------------------------------------------------------------------

    def _states(self, motion: IntegratedArcs, steps: IntArray | slice) -> States:
        """States and torques at the ends of some steps."""
        n, x, t = self._n, motion.x[1:][steps], np.cumsum(motion.h)[steps]
        torque = motion.rates.tau.reshape(-1, STAGES, n)[steps, -1]
        return States(t, x[:, :n], x[:, n:], np.zeros((0, n)), torque)

    def _margins(self, states: States, kind: int) -> tuple[Array, Array]:
        """Margins to the upper and lower limits at states, shape (m, k) each."""
        values = self.limits[kind].evaluate(states)
        lower, upper = self.limits[kind].bounds(states.t.size)
        return upper - values, values - lower

    def nearby(self, motion: IntegratedArcs, gap: float | None = None) -> BoundRows:
        """Limits to which the margin of a motion is small or negative.

        Args:
            motion: The motion.
            gap: Margin below which limits are returned, in units of the rows; None for
                the default of each kind.
        """
        system, states = self.system, self._states(motion, slice(None))
        parts = list[BoundRows]()
        # Left out are the speed limits of joints that are held, or about to be, as the
        # speeds are at them, and the limits of torques that do not follow, as the
        # bounds of the unknowns keep them.
        held = (self.modes & HOLDS) > 0
        held[:-1] |= held[1:]
        free = {VELOCITY: held, TORQUE: ~self.follows}
        # Positions and velocities that the goal fixes need no margin at the end.
        given = {POSITION: system.final_configuration, VELOCITY: system.final_velocity}
        for kind in sorted(self.limits.keys() - {GOAL}):
            distance = (CLOSE if kind == CLEARANCE else NEAR) if gap is None else gap
            for sign, margin in zip((1, -1), self._margins(states, kind), strict=True):
                if kind in free:
                    margin[free[kind][:, self.limits[kind].of_joints]] = np.inf
                if given.get(kind) is not None:
                    margin[-1] = np.inf
                if kind == HOLDING:  # at the end alone
                    margin[:-1] = np.inf
                step, index = np.nonzero(margin < distance)
                kinds, signs = np.full_like(step, kind), np.full_like(step, sign)
                small = margin[step, index]
                parts.append(BoundRows(kinds, step + 1, index, signs, small))
        return BoundRows.joined(parts)

    def _rows(self, motion: IntegratedArcs) -> Margins:
        """Margins to the bounds of all rows, with their derivatives."""
        n, rates, count = self._n, motion.rates, self.bounds.kind.size
        parts = np.zeros(count), self.bounds.node, np.zeros((count, 2 * n))
        out = Margins(*parts, np.zeros((count, n)), np.zeros(count))
        for kind in np.unique(self.bounds.kind).tolist():
            rows = np.flatnonzero(self.bounds.kind == kind)
            node, which, sign = (part[rows] for part in self.bounds[1:4])
            used, place = np.unique(node, return_inverse=True)
            states = self._states(motion, used - 1)
            high, low = (part[place, which] for part in self._margins(states, kind))
            out.value[rows] = np.where(sign > 0, high, low)
            by = self.limits[kind].differentiate(states, place, which).times(-sign)
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
        """Largest violation of limits at the ends of steps; 0 if within the slack."""
        return float(np.max(-self.nearby(motion, -slack).margin, initial=0.0))

    def sample_times(self, arcs: Arcs) -> Array:
        """Times of the stages, shape (M, 3) [s]."""
        h = (arcs.lengths / self.steps)[self.arc_of_step]
        return np.asarray((np.cumsum(h) - h)[:, None] + h[:, None] * NODES)
