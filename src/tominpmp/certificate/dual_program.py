"""Dual program: the gain that small changes of a motion predict, and its multipliers.

The program maximises the reduction of the duration that changes within a unit trust
region predict to first order. Its multipliers are the costates and the multipliers of
the limits; by the duality of linear programs the predicted gain is the sum of
multiplier times slack over the limits and the trust region. For a motion that keeps the
first-order conditions the gain is zero: all limits with multipliers have zero slack.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array
from tominpmp.certificate.limits import PASSIVE, TRUST, LimitRows, limits_of
from tominpmp.certificate.motion import Motion
from tominpmp.certificate.stays import still_nodes
from tominpmp.linear_programs.piqp import PiqpSolver, Termination
from tominpmp.linear_programs.program import LinearProgram, LpSolution
from tominpmp.problem.controls import control_kind
from tominpmp.transcription.instants import Instants

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
ROUGHLY = Termination(gap=2e-5, share=0.01, iterations=100, residual=1e-7)
PLACES = 4  # places in an interval at which costates may jump; even: one is the middle


@dataclass(frozen=True, eq=False)
class DualSolution:
    """Costates and multipliers that the linear program gives for a motion.

    Attributes:
        costates: Derivatives of the duration by the states just before the nodes 1 to
            N, shape (N, 2 n).
        falls: Decrease of the costates in the intervals, at the places k / PLACES
            nearest to an active state limit; at the last, that at the node after, shape
            (N, PLACES + 1, 2 n).
        switching: Derivative of the Hamiltonian by the torques, mean over each
            interval, in shares of the torque limits, shape (N, n).
        hamiltonian: Mean of the Hamiltonian over each interval, shape (N,).
        multipliers: All limits with their multipliers, with the trust region.
        promise: Predicted reduction of the duration to first order, as a share of it.
        state_scale: Changes of the state that the trust region allows, shape (2 n,).
    """

    costates: Array
    falls: Array
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

    Columns are the unknowns of the changes, and a change of the duration of each
    segment; rows are the equations of motion, the limits, and the goals.
    """

    def __init__(self, motion: Motion, near: bool = True) -> None:
        self.motion = motion
        changes, system = motion.changes, motion.system
        self.n, self.N = changes.n, changes.N
        self.T = float(changes.t[-1])
        way = np.ptp(changes.q, axis=0) / system.step_scale
        self.share = min(1.0, WAYS * max(float(way.max()), np.finfo(float).eps))
        place = self.share * system.step_scale
        self.state_scale = np.concatenate([place, SPEED_RADIUS * place / self.T])
        mass, drag = motion.inertia
        inertia = mass + drag * self.T / self.N
        self.acceleration_scale = system.effort_half / inertia
        self.rows = limits_of(motion, near)

    def _columns(self) -> LimitRows:
        """The trust region: bounds of the unknowns in scaled units.

        States at all nodes but the first, accelerations of intervals or at nodes, which
        are free but for zero accelerations at ends and dwells, and lengths of intervals
        and segments in shares of the duration.
        """
        N, n, motion, changes = self.N, self.n, self.motion, self.motion.changes
        free = np.full((changes.controls, n), np.inf)
        free[still_nodes(motion)] = 0.0
        firsts = [part.span[0] for part in motion.segments]
        lengths = SHIFT * changes.h / self.T, np.full(len(firsts), LENGTH_RADIUS)
        radius = np.concatenate([np.full(2 * n * N, RADIUS), free.ravel(), *lengths])
        each = np.arange(N)
        states = np.repeat(each, 2 * n)
        controls = np.repeat(np.minimum(np.arange(changes.controls), N - 1), n)
        joints = np.tile(np.arange(n), 2 * N + changes.controls)
        interval = np.concatenate([states, controls, each, firsts]).astype(int)
        return LimitRows(
            np.array(TRUST),
            Instants(interval, np.ones(radius.size)),
            np.append(joints, np.full(N + len(firsts), -1)),
            -radius,
            radius,
            np.zeros(2 * n),
            sp.csr_matrix((radius.size, changes.size)),
        )

    # -- solution ----------------------------------------------------------------------

    def solve(self) -> DualSolution | None:
        """Solve the program; None if no solver can."""
        changes, limits, columns = self.motion.changes, self.rows, self._columns()
        every = sp.vstack([changes.gaps(), limits.change], format="csc")
        scale = [np.tile(self.state_scale, self.N)]
        scale.append(np.tile(self.acceleration_scale, changes.controls))
        scale.append(np.full(self.N, self.T))
        lengths = every[:, -self.N :]
        # Each segment has a duration of its own.
        spans = [slice(*part.span) for part in self.motion.segments]
        each = [lengths[:, span] @ changes.h[span] for span in spans]
        stretch = sp.csr_matrix(np.stack(each, axis=1))
        matrix = every @ sp.diags(np.concatenate(scale))
        rows = sp.hstack([matrix, stretch], format="csc")
        rows.eliminate_zeros()
        # Lengths are shares of the duration, as the objective is.
        shares = [float(changes.h[span].sum()) / self.T for span in spans]
        cost = np.concatenate(
            [np.zeros(changes.size - self.N), np.ones(self.N), shares]
        )
        # Rows that depend on states alone are scaled as the states are.
        of_states = limits.of_state & np.any(limits.slopes != 0.0, axis=1)
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
            columns.lower,
            columns.upper,
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
            replace(columns, y=-(cost + rows.T @ duals)),
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
        falls = np.zeros((N, PLACES + 1, 2 * n))
        interval, share = rows.at.interval, rows.at.share
        inside = np.clip(np.rint(share * PLACES).astype(int), 1, PLACES - 1)
        place = np.where(share < 1.0, inside, PLACES)
        each = self.T * (rows.y * rows.of_state)[:, None] * rows.slopes
        np.add.at(falls, (interval, place), each)
        given = LimitRows.joined([rows, columns])
        bounded = np.where(given.held_above, given.above, given.below)
        given = given.kept(np.isfinite(bounded))
        driving = control_kind(self.motion.system.problem.robot).name
        torques = rows.kept(rows.of(driving, PASSIVE))
        return DualSolution(
            costates=-gaps.reshape(N, -1) * self.T - self._arriving(torques),
            falls=falls,
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
        interval, share = torques.at.interval, torques.at.share
        out = np.zeros((self.N, 2 * self.n))
        at_end = self.T * torques.y[:, None] * torques.slopes
        np.add.at(out, interval[share == 1.0], at_end[share == 1.0])
        if self.motion.changes.shape == "ramps":
            # A node stands for half of both intervals beside it.
            later = (share == 0.0) & (interval > 0)
            np.add.at(out, interval[later] - 1, 0.5 * at_end[later])
        return out

    def _switching(self, torques: LimitRows) -> Array:
        """Multipliers of the torques, as a density over time."""
        N, n, h = self.N, self.n, self.motion.changes.h
        interval, share = torques.at.interval, torques.at.share
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
