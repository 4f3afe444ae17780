"""Dual program: what small changes of a motion could gain, and its multipliers.

The program asks for the largest reduction of the duration that changes within a unit
trust region promise to first order. Its multipliers are the costates and the
multipliers of the limits; by the duality of linear programs the promise is the sum of
what each limit and the trust region give away: multiplier times room. A motion that
keeps the first-order conditions promises nothing: all multipliers stand at limits that
have no room.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array, BoolArray, IntArray
from tominpmp.certificate.active_limits import Motion
from tominpmp.certificate.all_limits import limits_of
from tominpmp.certificate.dual_solution import DualSolution
from tominpmp.certificate.limit_rows import LimitRows
from tominpmp.certificate.multipliers import GOAL, TRUST, Collection, Multipliers
from tominpmp.certificate.perturbations import Linearised
from tominpmp.certificate.stays import still_nodes
from tominpmp.linear_programs import Nearly, PiqpSolver
from tominpmp.linear_programs.program import LinearProgram, LpSolution

# The trust region: positions in rad or shares of the reach, velocities in these units
# over the duration, which changes by a share of itself.
RADIUS, SPEED_RADIUS, LENGTH_RADIUS = 1.0, 10.0, 0.5
# Motions of a small fraction of these units are looked at in as many times their way:
# the same motion on another scale has the same promise.
WAYS = 100.0
# Each interval may be longer or shorter by this share as well. Of several sets of
# multipliers that say the same this picks one whose Hamiltonian is constant.
SHIFT = 1e-3
# A promise is good to this share of it, and worth so many iterations: where limits
# overlap, interior points end slowly, and simplex methods take tens of seconds.
ROUGHLY = Nearly(gap=2e-5, share=0.01, iterations=100, residual=1e-7)
FAR_TORQUES = 0.5  # torques with more room to their nearer limit, as a share, are far
SMALL = 400  # unknowns: programs of so many are quick in any case
FAR = RADIUS * (1.0 - 1e-9)  # a bound at least this far is the trust region's
PLACES = 4  # of an interval at which costates may fall; even: one is the middle


class _Bounds(NamedTuple):
    """Bounds of the unknowns, in scaled units, and what they are.

    Attributes:
        lower: Shape (size,).
        upper: Shape (size,).
        kind: 0 for positions, 1 for velocities, 2 for accelerations, shape (size,).
        interval: Shape (size,).
        joint: Shape (size,).
        unit: A scaled unit in units of the limit, shape (size,).
    """

    lower: Array
    upper: Array
    kind: IntArray
    interval: IntArray
    joint: IntArray
    unit: Array


BOUND_KINDS = ("position", "velocity", "acceleration")


def solve_dual_program(
    motion: Motion, enough: float = 0.0, *, near: bool = True
) -> DualSolution | None:
    """Costates and multipliers of a motion; None if the program cannot be solved.

    Args:
        motion: The motion.
        enough: A promise that is good enough. Torques far from their limits are left
            out at first, which is quicker and promises too much, if anything; only
            where that is more than this, all are looked at.
        near: Whether distances are looked at from the first.
    """
    if enough > 0.0 and (motion.changes.size > SMALL or not near):
        found = _Program(motion, FAR_TORQUES, near).solve()
        if found is not None and found.promise <= enough:
            return found
    return _Program(motion).solve()


class _Program:
    """The linear program of a motion, in units that make its numbers of order one.

    Columns are the unknowns of the changes, a change of each interval, and one of the
    duration; rows are the equations of motion, the limits, and the goal.
    """

    def __init__(self, motion: Motion, far: float = np.inf, near: bool = True) -> None:
        self.motion = motion
        changes, system = motion.changes, motion.task
        self.n, self.N = changes.n, changes.N
        self.T = float(changes.t[-1])
        way = np.ptp(changes.q, axis=0) / system.step_scale
        self.share = min(1.0, WAYS * max(float(way.max()), np.finfo(float).eps))
        place = self.share * system.step_scale
        self.state_scale = np.concatenate([place, SPEED_RADIUS * place / self.T])
        mass = np.einsum("mii->mi", motion.parts.tau_a).mean(axis=0)
        drag = np.abs(np.einsum("mii->mi", motion.parts.tau_v)).mean(axis=0)
        inertia = mass + drag * self.T / self.N
        self.acceleration_scale = system.effort_half / np.maximum(inertia, 1e-12)
        self.limits = limits_of(motion, far, near)
        self.goal = self._goal()

    # -- columns -----------------------------------------------------------------------

    @cached_property
    def bounds(self) -> _Bounds:
        """Limits of states and accelerations, and the trust region."""
        N, n, controls = self.N, self.n, self.motion.changes.controls
        problem, changes = self.motion.task.problem, self.motion.changes
        limits = problem.robot.limits
        states = np.concatenate([changes.q, changes.v], axis=1)[1:]
        low = np.concatenate([limits.position_lower, -limits.velocity])
        high = np.concatenate([limits.position_upper, limits.velocity])
        lower = np.clip((low - states) / self.state_scale, -RADIUS, 0.0)
        upper = np.clip((high - states) / self.state_scale, 0.0, RADIUS)
        below, above, most = self._acceleration_bounds()
        place, speed = np.split(self.state_scale, 2)
        units = np.concatenate([place, speed / limits.velocity])
        return _Bounds(
            np.concatenate([lower.ravel(), below.ravel()]),
            np.concatenate([upper.ravel(), above.ravel()]),
            np.append(np.tile(np.repeat([0, 1], n), N), np.full(controls * n, 2)),
            np.append(
                np.repeat(np.arange(N), 2 * n),
                np.repeat(np.minimum(np.arange(controls), N - 1), n),
            ),
            np.tile(np.arange(n), 2 * N + controls),
            np.append(np.tile(units, N), (self.acceleration_scale / most).ravel()),
        )

    def _acceleration_bounds(self) -> tuple[Array, Array, Array]:
        """Room below and above, and the limits, shape (controls, n) each."""
        motion, controls = self.motion, self.motion.changes.controls
        most = np.full((controls, self.n), np.inf)
        for part in motion.segments:
            limits, (first, end) = part.task.problem.motion_limits, part.span
            if limits is None:
                continue
            names = part.task.problem.robot.joint_names
            rows = slice(first, end + (controls > self.N))
            most[rows] = np.minimum(most[rows], limits.by_joint("acceleration", names))
        least, largest = motion.a.min(axis=1), motion.a.max(axis=1)
        if motion.changes.shape == "ramps":
            least = largest = np.concatenate([motion.a[:, 0], motion.a[-1:, 1]])
        below = np.minimum((-most - least) / self.acceleration_scale, 0.0)
        above = np.maximum((most - largest) / self.acceleration_scale, 0.0)
        still = still_nodes(motion)
        below[still] = above[still] = 0.0
        return below, above, most

    # -- rows --------------------------------------------------------------------------

    def _goal(self) -> tuple[sp.csr_matrix, Array, Array]:
        """Rows of the goals of all segments with their bounds."""
        found = [self._goal_of(part) for part in self.motion.segments]
        rows, low, high = zip(*found, strict=True)
        matrix = sp.vstack(rows, format="csr")
        return matrix, np.concatenate(low), np.concatenate(high)

    def _goal_of(self, part: Motion) -> tuple[sp.csr_matrix, Array, Array]:
        """Rows of the goal at the end of a segment."""
        system, changes, node = part.task, part.changes, part.span[1]
        q, v = changes.q[node], changes.v[node]
        goal = system.problem.goal.nearest(system.kinematics, q, v)
        value, by_q, by_v = goal.residual(system.kinematics, q, v)
        lower, upper = goal.bounds(system.kinematics)
        loose = lower < upper
        low = np.where(loose, np.minimum(lower - value, 0.0), 0.0)
        high = np.where(loose, np.maximum(upper - value, 0.0), 0.0)
        by_x = sp.csr_matrix(np.hstack([by_q, by_v]))
        before = sp.csr_matrix((value.size, 2 * (node - 1) * self.n))
        left = 2 * (self.N - node) + changes.controls
        after = sp.csr_matrix((value.size, left * self.n))
        return sp.hstack([before, by_x, after], format="csr"), low, high

    def _all_rows(self, gaps: Linearised) -> tuple[sp.csr_matrix, sp.csr_matrix]:
        """All rows, by unknowns and lengths of intervals; unknowns and gaps scaled."""
        goal, low, _ = self.goal
        matrix = sp.vstack(
            [gaps.matrix, *(rows.change.matrix for rows in self.limits), goal],
            format="csr",
        )
        lengths = sp.vstack(
            [
                gaps.by_length,
                *(rows.change.by_length for rows in self.limits),
                sp.csr_matrix((low.size, self.N)),
            ],
            format="csr",
        )
        columns = np.concatenate(
            [
                np.tile(self.state_scale, self.N),
                np.tile(self.acceleration_scale, self.motion.changes.controls),
            ]
        )
        scale = np.ones(matrix.shape[0])
        scale[: 2 * self.N * self.n] = np.tile(1.0 / self.state_scale, self.N)
        left = sp.diags(scale)
        return (left @ matrix @ sp.diags(columns)).tocsr(), (left @ lengths).tocsr()

    def _row_units(self) -> Array:
        """Factors that make the rows of limits and goals of order one, shape (rows,).

        What depends on positions alone changes by as little as they do.
        """
        units = [np.ones(2 * self.N * self.n)]
        for rows in self.limits:
            unit = 1.0 if rows.slopes is None else self.share
            units.append(np.full(rows.lower.size, 1.0 / unit))
        units.append(np.full(self.goal[1].size, 1.0 / self.share))
        return np.concatenate(units)

    # -- solution ----------------------------------------------------------------------

    def solve(self) -> DualSolution | None:
        """Solve the program; None if no solver can."""
        changes, (_, low, high) = self.motion.changes, self.goal
        matrix, lengths = self._all_rows(changes.gaps())
        # Each segment can take longer by itself.
        spans = [slice(*part.span) for part in self.motion.segments]
        each = [lengths[:, span] @ changes.h[span] for span in spans]
        stretch = sp.csr_matrix(np.stack(each, axis=1))
        rows = sp.hstack([matrix, self.T * lengths, stretch], format="csc")
        # Lengths are in shares of the duration, as the objective.
        shares = [float(changes.h[span].sum()) / self.T for span in spans]
        cost = np.concatenate([np.zeros(changes.size), np.ones(self.N), shares])
        radius = np.full(len(spans), LENGTH_RADIUS)
        shift = np.append(SHIFT * changes.h / self.T, radius)
        equations = np.zeros(2 * self.N * self.n)
        units, limits = self._row_units(), self.limits
        program = LinearProgram(
            cost,
            (sp.diags(units) @ rows).tocsc(),
            units * np.concatenate([equations, *(one.lower for one in limits), low]),
            units * np.concatenate([equations, *(one.upper for one in limits), high]),
            np.append(self.bounds.lower, -shift),
            np.append(self.bounds.upper, shift),
            np.arange(rows.shape[0]),
            np.arange(rows.shape[1]),
        )
        found = _solve(program)
        if found is None:
            return None
        duals = units * found.row_duals
        hamiltonian = 1.0 + self.T * (lengths.T @ duals)
        return self._read(duals, cost + rows.T @ duals, shift, hamiltonian)

    def _read(
        self, duals: Array, slopes: Array, shift: Array, hamiltonian: Array
    ) -> DualSolution:
        """Turn the duals of the rows, and what they leave of the costs, into times."""
        N, n, states = self.N, self.n, 2 * self.N * self.n
        lower, upper = self.bounds.lower[:states], self.bounds.upper[:states]
        slope = slopes[:states]
        # The trust region is no limit of the problem.
        held = np.where(slope > 0.0, -lower, upper) < FAR
        jumps = np.where(held, -slope, 0.0).reshape(N, -1) * self.T / self.state_scale
        pushes = np.zeros((N, PLACES, 2 * n))
        for rows, y in self._of_rows(duals):
            if rows.slopes is None:
                continue
            falls = np.zeros((y.size, 2 * n))
            falls[:, :n] = rows.slopes
            falls[:, n:] = 0.0 if rows.speed_slopes is None else rows.speed_slopes
            falls *= self.T * y[:, None]
            share = rows.at.share
            inside = share < 1.0
            place = np.clip(np.rint(share * PLACES).astype(int), 1, PLACES - 1)[inside]
            np.add.at(pushes, (rows.interval[inside], place), falls[inside])
            np.add.at(jumps, rows.interval[~inside], falls[~inside])
        multipliers = self._multipliers(duals, slopes, shift)
        costates = -duals[:states].reshape(N, -1) * self.T / self.state_scale
        return DualSolution(
            costates=costates - self._arriving(duals),
            jumps=jumps,
            pushes=pushes,
            switching=self._switching(duals),
            hamiltonian=hamiltonian,
            multipliers=multipliers,
            promise=float(multipliers.promise.sum()),
            state_scale=self.state_scale,
            rows=tuple(self._of_rows(duals)),
        )

    def _of_rows(self, duals: Array) -> Iterator[tuple[LimitRows, Array]]:
        """Rows of the limits with their multipliers."""
        at = 2 * self.N * self.n
        for rows in self.limits:
            yield rows, duals[at : at + rows.lower.size]
            at += rows.lower.size

    def _multipliers(self, duals: Array, slopes: Array, shift: Array) -> Multipliers:
        """Sort the multipliers of rows and bounds by what they belong to."""
        found = Collection()
        for rows, y in self._of_rows(duals):
            about = rows.kind, rows.interval, rows.subject
            found.add(*about, y, rows.lower, rows.upper, rows.unit)
        _, low, high = self.goal
        last = self._goal_intervals
        found.add(
            GOAL, last, np.arange(low.size), duals[duals.size - low.size :], low, high
        )
        bounds, size = self.bounds, self.bounds.lower.size
        y = -slopes[:size]
        near = np.where(y > 0.0, bounds.upper, -bounds.lower)
        far = (near >= FAR) & (bounds.kind < 2)

        def add(kind: str, own: BoolArray, unit: Array) -> None:
            interval, joint = bounds.interval[own], bounds.joint[own]
            lower, upper = bounds.lower[own], bounds.upper[own]
            found.add(kind, interval, joint, y[own], lower, upper, unit[own])

        for code, kind in enumerate(BOUND_KINDS):
            add(kind, (bounds.kind == code) & ~far & (bounds.unit > 0.0), bounds.unit)
        add(TRUST, far, np.ones(size))
        no_subject = np.full(shift.size, -1)
        firsts = [part.span[0] for part in self.motion.segments]
        interval = np.append(np.arange(self.N), firsts)
        found.add(TRUST, interval, no_subject, -slopes[size:], -shift, shift)
        return found.multipliers()

    @cached_property
    def _goal_intervals(self) -> IntArray:
        """The interval at whose end each row of a goal stands."""
        found = []
        for part in self.motion.segments:
            lower, _ = part.task.problem.goal.bounds(part.task.kinematics)
            found.append(np.full(lower.size, part.span[1] - 1, dtype=np.int64))
        return np.concatenate(found)

    def _arriving(self, duals: Array) -> Array:
        """Share of the torques before a node in the multipliers there, shape (N, 2 n).

        The costate changes over an interval as the torques on it depend on the state;
        rows at its end have that change at the node itself, where it is too late.
        """
        motion, n = self.motion, self.n
        at_end, ramps = np.zeros((self.N, n)), motion.changes.shape == "ramps"
        for rows, y in self._of_rows(duals):
            if rows.kind not in ("effort", "passive"):
                continue
            if rows.mean:
                np.add.at(at_end, (rows.interval, rows.subject), 0.5 * y)
            elif rows.end == 1:
                np.add.at(at_end, (rows.interval, rows.subject), y)
            elif rows.end == 0 and ramps:
                later = rows.interval > 0
                index = (rows.interval[later] - 1, rows.subject[later])
                np.add.at(at_end, index, 0.5 * y[later])
        parts, at_end = motion.parts, self.T * at_end / motion.task.effort_half
        by_q = np.einsum("kj,kji->ki", at_end, parts.tau_q[1::2])
        by_v = np.einsum("kj,kji->ki", at_end, parts.tau_v[1::2])
        return np.concatenate([by_q, by_v], axis=1)

    def _switching(self, duals: Array) -> Array:
        """Multipliers of the torques, as a density over time."""
        N, n, h = self.N, self.n, self.motion.changes.h
        ramps = self.motion.changes.shape == "ramps"
        at_nodes, inside = np.zeros((N + 1, n)), np.zeros((N, n))
        for rows, y in self._of_rows(duals):
            if rows.kind not in ("effort", "passive"):
                continue
            if ramps and rows.end is not None:
                node = rows.interval + rows.end
                np.add.at(at_nodes, (node, rows.subject), y)
            else:
                np.add.at(inside, (rows.interval, rows.subject), y)
        # A node stands for half of both intervals beside it.
        width = np.append(h, 0.0) + np.append(0.0, h)
        density = at_nodes / width[:, None]
        return np.asarray(-self.T * (density[1:] + density[:-1] + inside / h[:, None]))


def _solve(program: LinearProgram) -> LpSolution | None:
    """Solve a program; None if no solver can, or its numbers are none."""
    numbers = (program.matrix.data, program.row_lower, program.row_upper)
    if any(np.any(np.isnan(part)) for part in numbers):
        return None
    # Interior points find the middle of the multipliers; where they do not, HiGHS finds
    # a corner of them.
    found = PiqpSolver(ROUGHLY).solve(program)
    right = found.optimal and bool(np.all(np.isfinite(found.row_duals)))
    return found if right else None
