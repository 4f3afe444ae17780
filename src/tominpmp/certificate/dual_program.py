"""Dual program: predicted gain of small changes of a motion, and its multipliers.

The program maximises the reduction of the duration that changes within a unit trust
region predict to first order. Its multipliers are the costates and the multipliers of
the limits; by the duality of linear programs the predicted gain is the sum of
multiplier times slack over the limits and the trust region. For a motion that satisfies
the first-order conditions the gain is zero: limits with multipliers have zero slack.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array
from tominpmp.certificate.dwells import rest_nodes
from tominpmp.certificate.limits import PASSIVE, TRUST, LimitRows, limits_of
from tominpmp.certificate.motion import GridMotion
from tominpmp.linear_programs.piqp import PiqpSolver, Termination
from tominpmp.linear_programs.program import LinearProgram
from tominpmp.problem.joint_limits import control_kind
from tominpmp.transcription.instants import Instants

# Radii of the trust region: of positions in rad or shares of the reach, of velocities
# in these units over the duration, and of the duration of each segment as a share of
# itself.
RADIUS, SPEED_RADIUS, LENGTH_RADIUS = 1.0, 10.0, 0.5
# Radius of the trust region of a small motion, in units of its displacement: the same
# motion on another scale has the same predicted gain. Interior points failed with 100
# units for 10 of 170 small motions, with 1 unit for 9 of 80, and with 10 for one.
DISPLACEMENTS = 10.0
# Share by which each interval may be longer or shorter in addition. Of several optimal
# sets of multipliers this selects a set whose Hamiltonian is constant.
SHIFT = 1e-3
# Accuracy of the predicted gain, as a share of the duration or of the objective, and
# largest number of iterations: where limits overlap, interior points converge slowly.
ACCURACY = Termination(gap=2e-5, share=0.01, iterations=100, residual=1e-7)
# Positions in an interval at which costates may jump; an even number includes the
# middle.
PLACES = 4


@dataclass(frozen=True, eq=False)
class DualSolution:
    """Costates and multipliers of a motion, from the linear program.

    Attributes:
        costates: Derivatives of the duration with respect to the states just before the
            nodes 1 to N, shape (N, 2 n).
        jumps: Decreases of the costates within the intervals, at the positions k /
            PLACES nearest to an active state limit; the last position holds the
            decrease at the node after the interval, shape (N, PLACES + 1, 2 n).
        switching: Derivatives of the Hamiltonian with respect to the torques, each in
            units of half its range, mean over the intervals, shape (N, n).
        hamiltonian: Mean of the Hamiltonian over each interval, shape (N,).
        multipliers: All limits with their multipliers, goals and the trust region
            included.
        predicted_gain: Predicted reduction of the duration, to first order, as a share
            of the duration.
        state_scale: Changes of the state that the trust region allows, shape (2 n,).
    """

    costates: Array
    jumps: Array
    switching: Array
    hamiltonian: Array
    multipliers: LimitRows
    predicted_gain: float
    state_scale: Array


def solve_dual_program(motion: GridMotion, enough: float = 0.0) -> DualSolution | None:
    """Costates and multipliers of a motion; None if the program cannot be solved.

    A motion with a segment of zero duration, which has no interval, has no program.

    Args:
        motion: The motion.
        enough: Predicted gain up to which distances need not be evaluated: without
            their rows the predicted gain is at least as large.
    """
    if any(begin == end for begin, end in (part.span for part in motion.segments)):
        return None
    if enough:
        dual = _Program(motion, near=False).solve()
        if dual is not None and dual.predicted_gain <= enough:
            return dual
    return _Program(motion).solve()


class _Program:
    """The linear program of a motion, scaled to numbers of order one.

    Columns are the unknowns of the small changes, and the change of the duration of
    each segment; rows are the equations of motion, the limits, and the goals.
    """

    def __init__(self, motion: GridMotion, near: bool = True) -> None:
        self.motion = motion
        changes, system = motion.changes, motion.system
        self.n, self.N = changes.n, changes.N
        self.T = float(changes.t[-1])
        extent = float((np.ptp(changes.q, axis=0) / system.step_scale).max())
        self.share = min(1.0, DISPLACEMENTS * max(extent, np.finfo(float).eps))
        position = self.share * system.step_scale
        self.state_scale = np.concatenate([position, SPEED_RADIUS * position / self.T])
        mass, drag = motion.inertia
        inertia = mass + drag * self.T / self.N
        self.acceleration_scale = system.effort_half / inertia
        self.rows = limits_of(motion, near)

    def _columns(self) -> LimitRows:
        """The trust region: bounds of the unknowns in scaled units.

        The unknowns are the states at all nodes except the first; the accelerations of
        intervals or at nodes, which are unbounded except for zero accelerations at ends
        and dwells; the lengths of intervals in shares of the duration; and the lengths
        of segments in shares of themselves.
        """
        N, n, motion, changes = self.N, self.n, self.motion, self.motion.changes
        free = np.full((changes.controls, n), np.inf)
        free[rest_nodes(motion)] = 0.0
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
        """Solve the program; None if the solver fails, or the program contains NaN."""
        changes, limits, columns = self.motion.changes, self.rows, self._columns()
        every = sp.vstack([changes.defects(), limits.change], format="csc")
        scale = [np.tile(self.state_scale, self.N)]
        scale.append(np.tile(self.acceleration_scale, changes.controls))
        scale.append(np.full(self.N, self.T))
        lengths = every[:, -self.N :]
        # The duration of each segment is a separate column.
        spans = [slice(*part.span) for part in self.motion.segments]
        each = [lengths[:, span] @ changes.h[span] for span in spans]
        durations = sp.csr_matrix(np.stack(each, axis=1))
        matrix = every @ sp.diags(np.concatenate(scale))
        rows = sp.hstack([matrix, durations], format="csc")
        rows.eliminate_zeros()
        # The objective and the lengths are shares of the duration.
        shares = [float(changes.h[span].sum()) / self.T for span in spans]
        cost = np.concatenate(
            [np.zeros(changes.size - self.N), np.ones(self.N), shares]
        )
        # Rows that depend on states only have the scale of the states.
        of_states = limits.of_state & np.any(limits.slopes != 0.0, axis=1)
        units = np.append(
            np.tile(1.0 / self.state_scale, self.N),
            np.where(of_states, 1.0 / self.share, 1.0),
        )
        equations = np.zeros(2 * self.N * self.n)
        program = LinearProgram(
            (sp.diags(units) @ rows).tocsc(),
            cost,
            columns.lower,
            columns.upper,
            units * np.append(equations, limits.lower),
            units * np.append(equations, limits.upper),
        )
        numbers = (program.matrix.data, program.row_lower, program.row_upper)
        if any(np.any(np.isnan(values)) for values in numbers):
            return None
        solution = PiqpSolver(ACCURACY).solve(program)
        if not (solution.optimal and np.all(np.isfinite(solution.row_duals))):
            return None
        duals = units * solution.row_duals
        return self._read(
            duals[: equations.size],
            replace(limits, y=duals[equations.size :]),
            replace(columns, y=-(cost + rows.T @ duals)),
            1.0 + self.T * (lengths.T @ duals),
        )

    def _read(
        self, defects: Array, rows: LimitRows, columns: LimitRows, hamiltonian: Array
    ) -> DualSolution:
        """Costates and multipliers in units of time, from the program's multipliers.

        Args:
            defects: Multipliers of the equations of motion, shape (2 N n,).
            rows: The limits that are rows.
            columns: The bounds of the unknowns.
            hamiltonian: Mean of the Hamiltonian over each interval, shape (N,).
        """
        N, n = self.N, self.n
        jumps = np.zeros((N, PLACES + 1, 2 * n))
        interval, share = rows.at.interval, rows.at.share
        inside = np.clip(np.rint(share * PLACES).astype(int), 1, PLACES - 1)
        place = np.where(share < 1.0, inside, PLACES)
        each = self.T * (rows.y * rows.of_state)[:, None] * rows.slopes
        np.add.at(jumps, (interval, place), each)
        every = LimitRows.joined([rows, columns])
        active = np.where(every.upper_active, every.above, every.below)
        every = every.selected(np.isfinite(active))
        control = control_kind(self.motion.system.problem.robot).name
        torques = rows.selected(rows.of(control, PASSIVE))
        return DualSolution(
            costates=-defects.reshape(N, -1) * self.T - self._correction(torques),
            jumps=jumps,
            switching=self._switching(torques),
            hamiltonian=hamiltonian,
            multipliers=every,
            predicted_gain=float(every.predicted_gain.sum()),
            state_scale=self.state_scale,
        )

    def _correction(self, torques: LimitRows) -> Array:
        """Correction of the costates by torque rows before a node, shape (N, 2 n).

        The costate changes over an interval because torques depend on the state. Rows
        at the end of the interval add this change only at the node, so that the costate
        just before the node needs a correction.
        """
        interval, share = torques.at.interval, torques.at.share
        out = np.zeros((self.N, 2 * self.n))
        at_end = self.T * torques.y[:, None] * torques.slopes
        np.add.at(out, interval[share == 1.0], at_end[share == 1.0])
        if self.motion.changes.profile == "ramps":
            # A node represents half of each of the two adjacent intervals.
            at_begin = (share == 0.0) & (interval > 0)
            np.add.at(out, interval[at_begin] - 1, 0.5 * at_end[at_begin])
        return out

    def _switching(self, torques: LimitRows) -> Array:
        """Switching functions: multipliers of the torques, as a density over time."""
        N, n, h = self.N, self.n, self.motion.changes.h
        interval, share = torques.at.interval, torques.at.share
        at_nodes, inside = np.zeros((N + 1, n)), np.zeros((N, n))
        ramps = self.motion.changes.profile == "ramps"
        of_node = np.isin(share, (0.0, 1.0)) & ramps
        node = interval + (share == 1.0)
        both = (at_nodes, node, of_node), (inside, interval, ~of_node)
        for out, place, rows in both:
            np.add.at(out, (place[rows], torques.subject[rows]), torques.y[rows])
        # A node represents half of each of the two adjacent intervals.
        width = np.append(h, 0.0) + np.append(0.0, h)
        density = at_nodes / width[:, None]
        return np.asarray(-self.T * (density[1:] + density[:-1] + inside / h[:, None]))
