r"""A motion on the grid of its certificate, and its small changes.

Small changes are linear maps of a few unknowns: changes of the states at nodes, of the
accelerations between the nodes, and of the lengths of the intervals. On an interval, of
which the share :math:`s` has passed,

.. math:: \delta\ddot q = (1 - s)\, \delta a_0 + s\, \delta a_1,

and the double integrator carries positions and velocities over the interval exactly, so
that their limits hold between the nodes in the same way as at the nodes. The limits are
the constraints of the programs that plan motions: their derivatives with respect to
states at instants are pulled back to these unknowns.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, TypeAlias

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array, BoolArray, IntArray
from tominpmp.constraints.base import Partials, States
from tominpmp.motion.measures import accelerations_continue
from tominpmp.motion.samples import subdivided
from tominpmp.motion.trajectory import Trajectory
from tominpmp.transcription.curve import rows_of_table
from tominpmp.transcription.instants import Instants
from tominpmp.transcription.problem_functions import ProblemFunctions

# Profiles by the quantity that is constant on an interval: the acceleration, its slope,
# or the torque.
Profile: TypeAlias = Literal["steps", "ramps", "torques"]

# Largest length of an interval, as a share of the motion; longer ones are subdivided.
LONGEST = 0.05
# Number of intervals above which neighbours are merged, and the length up to which they
# are merged, as a share of the motion.
MOST = 300
SHORTEST = 0.0125
# Change of a torque at a node from which it counts as a jump, as a share of the range
# of this torque in the motion.
JUMP = 0.2
# Distance from a node at which torques just after and before a jump are evaluated, as a
# share of the interval.
JUST_INSIDE = 1e-9
# Number of instants over which the mean torque of an interval is taken.
SAMPLES = 8


@dataclass(frozen=True, eq=False)
class Perturbations:
    """Small changes of a motion on a grid.

    The unknowns are, in this order, the states (q, v) at all nodes except the first,
    which is fixed; the accelerations, one for each interval or, with "ramps", one for
    each node; and the lengths of the intervals.

    Attributes:
        t: Times of the nodes [s], shape (N + 1,).
        q: Positions at the nodes, shape (N + 1, n).
        v: Velocities at the nodes, shape (N + 1, n).
        profile: The quantity that is constant on the intervals.
    """

    t: Array
    q: Array
    v: Array
    profile: Profile

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.q.shape[1])

    @cached_property
    def h(self) -> Array:
        """Lengths of the intervals [s], shape (N,)."""
        return np.diff(self.t)

    @property
    def N(self) -> int:
        """Number of intervals."""
        return int(self.t.size - 1)

    @property
    def controls(self) -> int:
        """Number of accelerations of a joint."""
        return self.N + 1 if self.profile == "ramps" else self.N

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return (2 * self.N + self.controls) * self.n + self.N

    def pull_back(
        self,
        at: Instants,
        states: States,
        partials: Partials,
        *,
        carried: bool = False,
    ) -> sp.csr_matrix:
        """Derivatives with respect to the unknowns, from partials by states.

        States inside an interval depend on the node before it; the state at the end of
        an interval is the state of the node there. Instants move with the lengths.

        Args:
            at: The instants.
            states: The states of the motion at the instants.
            partials: Partial derivatives of k values.
            carried: Whether states at ends of intervals depend on the node before the
                interval instead.

        Returns:
            Shape (k, size); a row for each row of the partial derivatives.
        """
        n, N, which = self.n, self.N, partials.at
        interval, share = at.interval[which], at.share[which]
        zero = np.zeros((which.size, n))
        by_states = partials.by_q, partials.by_v, partials.by_a
        by_q, by_v, by_a = (zero if values is None else values for values in by_states)
        ended = (share >= 1.0) & (not carried)
        node, h = interval + ended, self.h[interval]
        passed = np.where(ended, 0.0, share)
        p, t, after = (column[:, None] for column in (passed, passed * h, share))
        by_unknowns = [
            by_q,
            t * by_q + by_v,
            (1 / 2 - p / 6) * t**2 * by_q + (1 - p / 2) * t * by_v + (1 - after) * by_a,
            p / 6 * t**2 * by_q + p / 2 * t * by_v + after * by_a,
        ]
        last = interval + (self.profile == "ramps")
        # Column -1 is the state at the first node, which does not change.
        first = [2 * node - 2, 2 * node - 1, 2 * N + interval, 2 * N + last]
        columns = [n * k[:, None] + np.arange(n) for k in first]
        # A longer interval with unchanged accelerations adds twice the displacement,
        # minus its part due to the initial velocity.
        per_length = ~ended[:, None] / h[:, None]
        displacement = (states.q[which] - self.q[node]) * per_length
        v_length = (states.v[which] - self.v[node]) * per_length
        q_length = 2.0 * displacement - p * self.v[node]
        by_length = np.sum(by_q * q_length + by_v * v_length, axis=1)
        data = np.concatenate([*by_unknowns, by_length[:, None]], axis=1)
        lengths = self.size - N
        columns.append((lengths + interval)[:, None])
        places = np.concatenate(columns, axis=1)
        matrix = rows_of_table(data, places, self.size)
        matrix.sum_duplicates()
        if partials.by_t is not None:
            by_lengths = at.times(np.eye(N))[which]
            later = sp.csr_matrix(partials.by_t[:, None] * by_lengths)
            matrix += sp.hstack([sp.csr_matrix((which.size, lengths)), later])
        if partials.row is not None:
            terms = partials.row, np.arange(which.size)
            matrix = sp.csr_matrix((np.ones(which.size), terms)) @ matrix
        return sp.csr_matrix(matrix)

    def defects(self) -> sp.csr_matrix:
        """Defects of the intervals: changes of end nodes minus the integrated changes.

        The defects are zero for changes that obey the equations of motion. Rows are
        (q, v) of one node after the other, shape (2 N n, size).
        """
        n, N = self.n, self.N
        ends = Instants.spread(N, (1.0,))
        states = States(self.t[1:], self.q[1:], self.v[1:], np.zeros((0, n)))
        by_q, by_v = np.hsplit(np.tile(np.eye(2 * n), (N, 1)), 2)
        partials = Partials(np.repeat(np.arange(N), 2 * n), by_q, by_v)
        nodes = sp.eye(2 * N * n, self.size, format="csr")
        return nodes - self.pull_back(ends, states, partials, carried=True)

    def pairs(self, interval: IntArray) -> Instants:
        """Pairs of instants between which slopes over time are taken.

        The pairs are both ends of an interval where accelerations are continuous,
        otherwise the middles of an interval and of the next one.

        Args:
            interval: The intervals, shape (k,).
        """
        ramps = self.profile == "ramps"
        second, shares = (interval, (0.0, 1.0)) if ramps else (interval + 1, (0.5, 0.5))
        pairs = np.stack([interval, second], axis=1)
        return Instants(pairs.ravel(), np.tile(shares, interval.size))


@dataclass(frozen=True, eq=False)
class GridMotion:
    """A motion on the grid on which its limits are linearised.

    Attributes:
        system: The functions of the problem, without padding of distances.
        trajectory: The motion.
        changes: Small changes of the motion.
        span: Index of the first interval on which the problem applies, and the index
            after the last.
        segments: The motion on each of its segments, with the functions of the segment;
            empty for a segment.
    """

    system: ProblemFunctions
    trajectory: Trajectory
    changes: Perturbations
    span: tuple[int, int]
    segments: tuple[GridMotion, ...] = ()

    @classmethod
    def of(cls, system: ProblemFunctions, trajectory: Trajectory) -> GridMotion:
        """Put a motion on the grid of its certificate."""
        system = system.padded(0.0)
        t, merged = certificate_grid(trajectory)
        nodes, profile = trajectory(t), _profile(system, trajectory, merged)
        changes = Perturbations(t, nodes.q, nodes.v, profile)
        places = [0, *np.searchsorted(t, trajectory._ends).tolist()]
        each = zip(system.segments, itertools.pairwise(places), strict=True)
        segments = tuple(cls(part, trajectory, changes, span) for part, span in each)
        return cls(system, trajectory, changes, (0, changes.N), segments)

    @cached_property
    def path(self) -> Trajectory:
        """The motion without its inverse dynamics, which take time."""
        return replace(self.trajectory, inverse_dynamics=None, segment_dynamics=())

    @property
    def constraints(self) -> list[Any]:
        """Constraints along the motion, segment by segment."""
        every = (part.system.problem.constraints for part in self.segments)
        return [item for items in every for item in items]

    # -- states ------------------------------------------------------------------------

    def instants(self, *shares: float) -> Instants:
        """Instants at the same shares of all intervals of the span."""
        return Instants.spread(self.changes.N, shares).within(*self.span)

    def _times(self, at: Instants) -> Array:
        """Times of instants [s]; those at ends of intervals are moved just inside."""
        share = np.clip(at.share, JUST_INSIDE, 1.0 - JUST_INSIDE)
        return self.changes.t[at.interval] + share * self.changes.h[at.interval]

    def ways(self, at: Instants) -> Array:
        """Directions of motion of the joints at instants, 0 at rest, shape (m, n)."""
        return self.trajectory.turns.at(self._times(at))

    def torques(self, at: Instants) -> Array:
        """Torques of the motors at instants, shape (m, n) [N m or N]."""
        return np.asarray(self.trajectory(self._times(at)).u)

    def states(self, at: Instants) -> States:
        """States at instants; for motions given by torques, accelerations follow."""
        times = self._times(at)
        q, v, a, u = self.path(times)
        if self.trajectory.inverse_dynamics is None:
            dry = self.system.problem.robot.friction * self.ways(at)
            x = np.concatenate([q, v], axis=1)
            a = self.system.dynamics.forward(x, u - dry)[:, self.changes.n :]
        return States(times, q, v, a)

    # -- torques as shares of their limits ---------------------------------------------

    @cached_property
    def loads(self) -> Array:
        """Torques at both ends of the intervals, relative to limits, (N, 2, n).

        Torques that are constant on the intervals, or stand for several, are given by
        their mean alone, shape (N, 1, n).
        """
        if self.segments:
            return np.concatenate([part.loads for part in self.segments])
        constant = self.changes.profile == "torques"
        shares = (np.arange(SAMPLES) + 0.5) / SAMPLES if constant else np.arange(2.0)
        u = self.torques(self.instants(*shares.tolist()))
        load = (u - self.system.effort_middle) / self.system.effort_half
        load = load.reshape(-1, shares.size, self.changes.n)
        return np.asarray(load.mean(axis=1, keepdims=True) if constant else load)

    @property
    def load(self) -> Array:
        """Mean torque of each interval, relative to its limits, shape (N, n)."""
        return np.asarray(self.loads.mean(axis=1))

    @cached_property
    def inertia(self) -> tuple[Array, Array]:
        """Mean derivatives of torques by accelerations and by speeds, shape (n,)."""
        diagonals = []
        for part in self.segments:
            state = part.states(part.instants(0.5))
            by = part.system.dynamics.inverse_jacobians(state.q, state.v, state.a)
            diagonals.append([np.einsum("mii->mi", x) for x in (by.tau_a, by.tau_v)])
        mass, drag = map(np.vstack, zip(*diagonals, strict=True))
        return np.maximum(mass.mean(axis=0), 1e-12), np.abs(drag).mean(axis=0)


def _profile(system: ProblemFunctions, trajectory: Trajectory, merged: bool) -> Profile:
    """The quantity that is constant on the intervals of a motion."""
    if system.motion_limits.continuous:
        return "ramps"
    if trajectory.inverse_dynamics is None or merged:
        return "torques"
    return "ramps" if accelerations_continue(trajectory) else "steps"


# -- the grid --------------------------------------------------------------------------


def certificate_grid(trajectory: Trajectory) -> tuple[Array, bool]:
    """Nodes at which the certificate examines a motion.

    Returns:
        Times of the nodes [s], and whether intervals of the motion were merged. Without
        merging, all nodes of the motion are kept; with merging, the ends of segments
        are kept, and nodes at which the torque jumps, unless there are too many.
    """
    t, T = trajectory.t, trajectory.duration
    merged = t.size - 1 > MOST
    if merged:
        jumps = _jumps(trajectory) | np.isin(t, trajectory._ends)
        kept = [0]
        for k in range(1, t.size - 1):
            if jumps[k] or t[k + 1] - t[kept[-1]] > SHORTEST * T:
                kept.append(k)
        t = t[[*kept, t.size - 1]]
    return subdivided(t, LONGEST * T), merged


def _jumps(trajectory: Trajectory) -> BoolArray:
    """Whether a torque jumps at each node, (N + 1,); False if there are many jumps."""
    t = trajectory.t
    before = trajectory(t[1:-1] - JUST_INSIDE * np.diff(t)[:-1]).u
    height = np.abs(trajectory.u[1:-1] - before)
    span = np.ptp(trajectory.u, axis=0)
    jumps = np.pad(np.any(height > JUMP * span, axis=1), 1)
    return jumps if np.count_nonzero(jumps) <= MOST // 4 else np.zeros_like(jumps)
