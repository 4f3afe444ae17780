"""Dual program: the gain that small changes of a motion predict, and its multipliers.

The program maximises the reduction of the duration that changes within a unit trust
region predict to first order. Its multipliers are the costates and the multipliers of
the limits; by the duality of linear programs the predicted gain is the sum of
multiplier times slack over the limits and the trust region. For a motion that keeps the
first-order conditions the gain is zero: all limits with multipliers have zero slack.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array
from tominpmp.certificate.limit_rows import TRUST, LimitRows
from tominpmp.certificate.limits import limits_of
from tominpmp.certificate.motion import Motion
from tominpmp.certificate.perturbations import Instants, Linearised
from tominpmp.certificate.stays import still_nodes
from tominpmp.linear_programs import Nearly, PiqpSolver
from tominpmp.linear_programs.program import LinearProgram, LpSolution

# The trust region: positions in rad or shares of the reach, velocities in these units
# over the duration, which changes by a share of itself.
RADIUS, SPEED_RADIUS, LENGTH_RADIUS = 1.0, 10.0, 0.5
# The trust region of a small motion is this many times its displacement: the same
# motion on another scale has the same predicted gain.
WAYS = 100.0
# Each interval may be longer or shorter by this share as well. Of several optimal sets
# of multipliers this picks one whose Hamiltonian is constant.
SHIFT = 1e-3
# Relative accuracy of the predicted gain, and the iterations spent on it: where limits
# overlap, interior points converge slowly, and simplex methods take tens of seconds.
ROUGHLY = Nearly(gap=2e-5, share=0.01, iterations=100, residual=1e-7)
FAR = RADIUS * (1.0 - 1e-9)  # a bound at least this far is the trust region's
PLACES = 4  # places in an interval at which costates may jump; even: one is the middle


@dataclass(frozen=True, eq=False)
class DualSolution:
    """Costates and multipliers that the linear program gives for a motion.

    Attributes:
        costates: Derivatives of the duration by the states just before the nodes 1 to
            N, shape (N, 2 n).
        jumps: Decrease of the costates at these nodes, where a state limit is active,
            shape (N, 2 n).
        pushes: Decrease of the costates inside the intervals, at the places k / PLACES
            nearest to an active state limit, shape (N, PLACES, 2 n).
        switching: Derivative of the Hamiltonian by the torques, mean over each
            interval, in shares of the torque limits, shape (N, n).
        hamiltonian: Mean of the Hamiltonian over each interval, shape (N,).
        multipliers: All limits with their multipliers, with the trust region.
        promise: Predicted reduction of the duration to first order, as a share of it.
        state_scale: Changes of the state that the trust region allows, shape (2 n,).
    """

    costates: Array
    jumps: Array
    pushes: Array
    switching: Array
    hamiltonian: Array
    multipliers: LimitRows
    promise: float
    state_scale: Array


def solve_dual_program(
    motion: Motion, enough: float = 0.0, *, near: bool = True
) -> DualSolution | None:
    """Costates and multipliers of a motion; None if the program cannot be solved.

    Args:
        motion: The motion.
        enough: Predicted gain below which distances need not be evaluated.
        near: Whether distances are rows at first. Without them the predicted gain is at
            least as large, and they are added where it exceeds ``enough``.
    """
    if not near:
        found = _Program(motion, near).solve()
        if found is not None and found.promise <= enough:
            return found
    return _Program(motion).solve()


class _Program:
    """The linear program of a motion, scaled to numbers of order one.

    Columns are the unknowns of the changes, a change of each interval, and one of the
    duration of each segment; rows are the equations of motion, the limits, and the
    goals.
    """

    def __init__(self, motion: Motion, near: bool = True) -> None:
        self.motion = motion
        changes, task = motion.changes, motion.task
        self.n, self.N = changes.n, changes.N
        self.T = float(changes.t[-1])
        way = np.ptp(changes.q, axis=0) / task.step_scale
        self.share = min(1.0, WAYS * max(float(way.max()), np.finfo(float).eps))
        place = self.share * task.step_scale
        self.state_scale = np.concatenate([place, SPEED_RADIUS * place / self.T])
        mass = np.einsum("mii->mi", motion.parts.tau_a).mean(axis=0)
        drag = np.abs(np.einsum("mii->mi", motion.parts.tau_v)).mean(axis=0)
        inertia = mass + drag * self.T / self.N
        self.acceleration_scale = task.effort_half / np.maximum(inertia, 1e-12)
        self.rows = limits_of(motion, near)

    # -- columns -----------------------------------------------------------------------

    @cached_property
    def columns(self) -> LimitRows:
        """Bounds of the unknowns in scaled units: limits, and the trust region.

        States at all nodes but the first, accelerations of intervals or at nodes, and
        lengths of intervals and segments in shares of the duration.
        """
        N, n, motion, changes = self.N, self.n, self.motion, self.motion.changes
        limits, controls = motion.task.problem.robot.limits, changes.controls
        states = np.concatenate([changes.q, changes.v], axis=1)[1:]
        low = np.concatenate([limits.position_lower, -limits.velocity])
        high = np.concatenate([limits.position_upper, limits.velocity])
        least, largest, most = self._accelerations()
        firsts = [part.span[0] for part in motion.segments]
        radius = np.full(len(firsts), LENGTH_RADIUS)
        shift = np.append(SHIFT * changes.h / self.T, radius)
        lengths = np.append(np.arange(N), firsts)
        counts = 2 * n * N, controls * n, lengths.size
        control, last = np.arange(controls), controls - 1
        below = np.maximum((low - states) / self.state_scale, -RADIUS)
        above = np.minimum((high - states) / self.state_scale, RADIUS)
        place, speed = np.split(self.state_scale, 2)
        of_state = np.concatenate([place, speed / limits.velocity])
        interval = np.repeat(np.minimum(control, N - 1), n)
        return LimitRows(
            kind=np.append(
                np.tile(np.repeat(["position", "velocity"], n), N),
                np.repeat(["acceleration", TRUST], counts[1:]),
            ),
            at=Instants(
                np.concatenate([np.repeat(np.arange(N), 2 * n), interval, lengths]),
                np.repeat([1.0, 0.0, 1.0, 0.0], [counts[0], last * n, n, counts[2]]),
            ),
            subject=np.append(
                np.tile(np.arange(n), 2 * N + controls), np.full(counts[2], -1)
            ),
            below=np.concatenate([below.ravel(), least.ravel(), -shift]),
            above=np.concatenate([above.ravel(), largest.ravel(), shift]),
            slopes=np.zeros(2 * n),
            change=changes.nothing(sum(counts)),
            unit=np.concatenate(
                [
                    np.tile(of_state, N),
                    (self.acceleration_scale / most).ravel(),
                    np.ones(counts[2]),
                ]
            ),
        )

    def _accelerations(self) -> tuple[Array, Array, Array]:
        """Slack below and above, and the limits, shape (controls, n) each."""
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
        below = (-most - least) / self.acceleration_scale
        above = (most - largest) / self.acceleration_scale
        still = still_nodes(motion)
        below[still] = above[still] = 0.0
        return below, above, most

    # -- solution ----------------------------------------------------------------------

    def solve(self) -> DualSolution | None:
        """Solve the program; None if no solver can."""
        changes, limits = self.motion.changes, self.rows
        every = Linearised.stacked([changes.gaps(), limits.change])
        scale = np.append(
            np.tile(self.state_scale, self.N),
            np.tile(self.acceleration_scale, changes.controls),
        )
        matrix, lengths = every.matrix @ sp.diags(scale), every.by_length
        # Each segment has a duration of its own.
        spans = [slice(*part.span) for part in self.motion.segments]
        each = [lengths[:, span] @ changes.h[span] for span in spans]
        stretch = sp.csr_matrix(np.stack(each, axis=1))
        rows = sp.hstack([matrix, self.T * lengths, stretch], format="csc")
        rows.eliminate_zeros()
        # Lengths are shares of the duration, as the objective is.
        shares = [float(changes.h[span].sum()) / self.T for span in spans]
        cost = np.concatenate([np.zeros(changes.size), np.ones(self.N), shares])
        # Rows that depend on states alone are scaled as the states are.
        of_states = np.any(limits.slopes != 0.0, axis=1)
        units = np.append(
            np.tile(1.0 / self.state_scale, self.N),
            np.where(of_states, 1.0 / self.share, 1.0),
        )
        equations = np.zeros(2 * self.N * self.n)
        program = LinearProgram(
            cost,
            (sp.diags(units) @ rows).tocsc(),
            units * np.append(equations, limits.lower),
            units * np.append(equations, limits.upper),
            self.columns.lower,
            self.columns.upper,
            np.arange(rows.shape[0]),
            np.arange(rows.shape[1]),
        )
        found = _solve(program)
        if found is None:
            return None
        duals = units * found.row_duals
        return self._read(
            duals[: equations.size],
            replace(limits, y=duals[equations.size :]),
            replace(self.columns, y=-(cost + rows.T @ duals)),
            1.0 + self.T * (lengths.T @ duals),
        )

    def _read(
        self, gaps: Array, rows: LimitRows, columns: LimitRows, hamiltonian: Array
    ) -> DualSolution:
        """Turn the multipliers of the program into times.

        Args:
            gaps: Multipliers of the equations of motion, shape (2 N n,).
            rows: The limits that are rows.
            columns: The bounds of the unknowns.
            hamiltonian: Mean of the Hamiltonian over each interval, shape (N,).
        """
        N, n = self.N, self.n
        # The trust region is no limit of the problem.
        far = (np.where(columns.held_above, columns.upper, -columns.lower) >= FAR) & (
            columns.of("position", "velocity")
        )
        jumps = np.where(far, 0.0, columns.y)[: gaps.size].reshape(N, -1)
        jumps = jumps * self.T / self.state_scale
        pushes = np.zeros((N, PLACES, 2 * n))
        falls, (interval, share) = self.T * rows.y[:, None] * rows.slopes, rows.at
        inside = share < 1.0
        place = np.clip(np.rint(share * PLACES).astype(int), 1, PLACES - 1)[inside]
        np.add.at(pushes, (interval[inside], place), falls[inside])
        np.add.at(jumps, interval[~inside], falls[~inside])
        columns = replace(
            columns,
            kind=np.where(far, TRUST, columns.kind),
            unit=np.where(far, 1.0, columns.unit),
        )
        given = LimitRows.joined([rows, columns])
        bounded = np.where(given.held_above, given.above, given.below)
        given = given.kept(np.isfinite(bounded) & (given.unit > 0.0))
        torques = rows.kept(rows.of("effort", "passive"))
        return DualSolution(
            costates=-gaps.reshape(N, -1) * self.T - self._arriving(torques),
            jumps=jumps,
            pushes=pushes,
            switching=self._switching(torques),
            hamiltonian=hamiltonian,
            multipliers=given,
            promise=float(given.promise.sum()),
            state_scale=self.state_scale,
        )

    def _arriving(self, torques: LimitRows) -> Array:
        """Correction of the costates by torque rows before a node, shape (N, 2 n).

        The costate changes over an interval as its torques depend on the state; rows at
        the end of the interval add this change at the node, where it is too late.
        """
        motion, (interval, share), y = self.motion, torques.at, torques.y
        at_end = np.zeros((self.N, self.n))
        own = np.where(torques.mean, 0.5, 1.0 * (share == 1.0)) * y
        np.add.at(at_end, (interval, torques.subject), own)
        if motion.changes.shape == "ramps":
            later = (share == 0.0) & ~torques.mean & (interval > 0)
            index = (interval[later] - 1, torques.subject[later])
            np.add.at(at_end, index, 0.5 * y[later])
        parts, at_end = motion.parts, self.T * at_end / motion.task.effort_half
        by_q = np.einsum("kj,kji->ki", at_end, parts.tau_q[1::2])
        by_v = np.einsum("kj,kji->ki", at_end, parts.tau_v[1::2])
        return np.concatenate([by_q, by_v], axis=1)

    def _switching(self, torques: LimitRows) -> Array:
        """Multipliers of the torques, as a density over time."""
        N, n, h = self.N, self.n, self.motion.changes.h
        interval, share = torques.at
        at_nodes, inside = np.zeros((N + 1, n)), np.zeros((N, n))
        ramps = self.motion.changes.shape == "ramps"
        of_node = np.isin(share, (0.0, 1.0)) & ramps
        for out, place, own in (
            (at_nodes, interval + (share == 1.0), of_node),
            (inside, interval, ~of_node),
        ):
            np.add.at(out, (place[own], torques.subject[own]), torques.y[own])
        # A node stands for half of both intervals beside it.
        width = np.append(h, 0.0) + np.append(0.0, h)
        density = at_nodes / width[:, None]
        return np.asarray(-self.T * (density[1:] + density[:-1] + inside / h[:, None]))


def _solve(program: LinearProgram) -> LpSolution | None:
    """Solve a program; None if no solver can, or some of its numbers are NaN."""
    numbers = (program.matrix.data, program.row_lower, program.row_upper)
    if any(np.any(np.isnan(part)) for part in numbers):
        return None
    found = PiqpSolver(ROUGHLY).solve(program)
    right = found.optimal and bool(np.all(np.isfinite(found.row_duals)))
    return found if right else None
