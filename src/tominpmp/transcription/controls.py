"""Piecewise-constant torques (the paper's equation 16) as unknowns.

They are the torques of the motors less dry friction: their limits depend on the
direction in which a joint moves.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import replace

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array, IntArray
from tominpmp.constraints.base import Partials, States
from tominpmp.constraints.friction import EFFORT_TOLERANCE, Ways, interval_signs
from tominpmp.dynamics import directions
from tominpmp.motion.trajectory import Trajectory, reversals
from tominpmp.problem.controls import control_bounds
from tominpmp.transcription.base import Transcription, Variation
from tominpmp.transcription.instants import Instants
from tominpmp.transcription.integrator import SteppedMotion
from tominpmp.transcription.problem_functions import ProblemFunctions

# Scale of velocities, in units of the scale of positions over the duration.
SPEED_FACTOR = 5.0


class TorqueTranscription(Transcription[SteppedMotion]):
    """A problem whose torques are unknowns, as shares of their limits in [-1, 1].

    The last of its unknowns are the torques of N intervals, and the lengths h = H eta
    with a matrix H of shares, of one column (scaling of a given grid) or more. Torques
    are those of the motors less dry friction.

    Attributes:
        system: The functions of the problem.
        shares: H, shape (N, m): lengths of the intervals [s] per unit of eta.
        duration: Duration that scales velocities [s].
        ways: Directions of joints with dry friction on the intervals; None without
            friction, or before they were taken from a motion.
    """

    def __init__(
        self,
        system: ProblemFunctions,
        shares: Array,
        duration: float,
        ways: Ways | None,
    ) -> None:
        self.system, self.shares, self.duration = system, shares, duration
        self.ways, self.segment_ends = ways, (len(shares),)
        self._N, self._m = int(shares.shape[0]), int(shares.shape[1])
        self._n = system.n

    @abstractmethod
    def with_ways(self, duration: float, ways: Ways) -> TorqueTranscription:
        """The transcription with other velocity scales, and directions of joints."""

    @property
    def _torques(self) -> slice:
        """Slice of the unknowns that holds the shares of torques."""
        end = self.size - self._m
        return slice(end - self._N * self._n, end)

    def shares_at(self, z: Array) -> Array:
        """Torques as shares of their limits, shape (N, n)."""
        return z[self._torques].reshape(self._N, self._n)

    def torques(self, z: Array) -> Array:
        """Torques without dry friction, shape (N, n) [N m or N]."""
        share = self.shares_at(z)
        return self.system.effort_middle + self.system.effort_half * share

    def lengths(self, z: Array) -> Array:
        """Lengths of the intervals [s], shape (N,)."""
        return np.asarray(self.shares @ z[-self._m :])

    @property
    def torque_bounds(self) -> tuple[Array, Array]:
        """Bounds of the torque shares, shape (N, n) each."""
        if self.ways is None:
            ones = np.ones((self._N, self._n))
            return -ones, ones
        return self.ways.lower, self.ways.upper

    def torque_steps(self, z: Array, largest: Array) -> tuple[Array, Array]:
        """Smallest and largest steps of torque shares, shape (N, n) each.

        Zero for joints without a motor.

        Args:
            z: Iterate.
            largest: Largest step of each joint, in shares, shape (n,).
        """
        shares, (low, high) = self.shares_at(z), self.torque_bounds
        driven, most = driven_joints(self.system), np.zeros(self._n)
        most[driven] = largest[driven]
        return np.clip(low - shares, -most, 0.0), np.clip(high - shares, 0.0, most)

    def turned(self, z: Array) -> tuple[TorqueTranscription, Array] | None:
        """With the directions of joints in an iterate, and the iterate within limits.

        None if the assumed directions are consistent with the iterate.
        """
        motion = self.motion(z)
        if self.system.friction is None or not motion.finite:
            return None
        known, v, shares = self.assumed(z), motion.x[:, self._n :], self.shares_at(z)
        # Friction was left out while no directions were known.
        ways = turned_ways(known, v, shares) if known else first_ways(self.system, v)
        if ways is None:
            return None
        out = z.copy()
        out[self._torques] = np.clip(shares, ways.lower, ways.upper).ravel()
        return self.with_ways(float(self.cost @ z), ways), out

    def assumed(self, z: Array) -> Ways | None:
        """Assumed directions of joints in an iterate; None if not known."""
        return self.ways

    def instants(self, order: int, field: str) -> Instants:
        """Nodes; both ends of the intervals for accelerations, which jump there."""
        return Instants.spread(self._N, (0.0, 1.0) if order >= 2 else (1.0,))

    def states(self, motion: SteppedMotion, at: Instants, order: int) -> States:
        """States at instants."""
        n, x, u = self._n, motion.states(at), motion.u[at.interval]
        a = np.zeros((0, n))
        if order >= 2:
            a = self.system.dynamics.forward(x, u)[:, n:]
        return States(at.times(motion.h), x[:, :n], x[:, n:], a, u)

    def rates(self, motion: SteppedMotion, at: Instants) -> Array:
        """Slopes of the polynomials; they are velocities where the defects are zero."""
        return motion.rates(at)[:, : self._n]

    def by_states(
        self, motion: SteppedMotion, at: Instants, partials: Partials
    ) -> tuple[Array, Array]:
        """Derivatives of k values by states and torques where they are.

        Shapes (k, 2n) and (k, n).
        """
        n, which = self._n, partials.at
        by_x, by_u = np.zeros((which.size, 2 * n)), np.zeros((which.size, n))
        given = partials.by_q, partials.by_v, partials.by_u
        targets = by_x[:, :n], by_x[:, n:], by_u
        for part, target in zip(given, targets, strict=True):
            if part is not None:
                target += part
        if partials.by_a is not None:
            here = Instants(at.interval[which], at.share[which])
            x, u = motion.states(here), motion.u[here.interval]
            slopes = self.system.dynamics.forward_jacobians(x, u)
            by_x += np.einsum("kj,kji->ki", partials.by_a, slopes.f_x[:, n:])
            by_u += np.einsum("kj,kji->ki", partials.by_a, slopes.f_u[:, n:])
        return by_x, by_u

    def variation(self, z: Array) -> Variation:
        """Jumps of the torques between intervals, in full ranges."""
        steps = sp.diags([-0.5, 0.5], [0, 1], shape=(self._N - 1, self._N))
        pick = sp.identity(self._n, format="csr")[driven_joints(self.system)]
        jumps = sp.kron(steps, pick)
        count, before = jumps.shape[0], self._torques.start
        columns = (count, before), (count, self._m)
        others = [sp.csr_matrix(shape) for shape in columns]
        matrix = sp.hstack([others[0], jumps, others[1]], format="csr")
        return Variation(matrix, np.zeros(count))

    def trajectory(self, z: Array) -> Trajectory:
        """The motion of an iterate, joined by Hermite polynomials between nodes."""
        motion, n = self.motion(z), self._n
        held = Trajectory(
            joint_names=self.system.problem.robot.joint_names,
            t=np.concatenate([[0.0], np.cumsum(motion.h)]),
            q=motion.x[:, :n],
            v=motion.x[:, n:],
            u=np.concatenate([motion.u, motion.u[-1:]]),
            holding=self.system.dynamics.inverse,
        )
        return motor_torques(self.system, held, self.ways)


def driven_joints(system: ProblemFunctions) -> IntArray:
    """Indices of the joints with a motor, whose torque is free."""
    limits = system.problem.robot.limits
    return np.flatnonzero(limits.effort_upper > limits.effort_lower)


def torque_shares(system: ProblemFunctions, u: Array) -> Array:
    """Torques as shares of their limits, brought within them, shape (N, n)."""
    robot = system.problem.robot
    weakest, strongest = control_bounds(robot, system.problem.motion_limits)
    low, high = weakest - robot.friction, strongest + robot.friction
    if system.ways is not None:
        low, high = weakest - system.resistance, strongest - system.resistance
    u = np.clip(u, low, high)
    return np.asarray((u - system.effort_middle) / system.effort_half)


def net_torque(system: ProblemFunctions, u: Array, v: Array) -> Array:
    """Torques of the motors less dry friction, shape (N, n) [N m or N]."""
    if system.friction is None:
        return u
    return np.asarray(u - system.problem.robot.friction * directions(v, 0.0 * v))


def driving_torque(system: ProblemFunctions, q: Array, v: Array, h: Array) -> Array:
    """Torques that drive a motion, in the middle of its intervals, shape (N, n).

    The torques are not clipped to limits. Positions and velocities are those at the
    nodes, shape (N + 1, n).
    """
    step = h[:, None]
    middle = 0.5 * (q[:-1] + q[1:])
    speed, acceleration = np.diff(q, axis=0) / step, np.diff(v, axis=0) / step
    return system.dynamics.inverse(middle, speed, acceleration)


def first_ways(system: ProblemFunctions, v: Array) -> Ways:
    """Directions of joints on intervals, from velocities at the nodes, (N, n)."""
    assert system.friction is not None  # noqa: S101
    sign, change = interval_signs(v)
    ways = Ways.of(system.friction, sign)
    return replace(ways, both=change & (system.friction > 0.0))


def turned_ways(ways: Ways, v: Array, shares: Array) -> Ways | None:
    """Directions of joints on intervals of a motion, if they affect its torques.

    Args:
        ways: Assumed directions on N intervals.
        v: Velocities at the nodes, shape (N + 1, n) [rad/s or m/s].
        shares: Torques without friction as shares of their limits, shape (N, n).

    Returns:
        The directions; None if the assumed ones are consistent with the motion.
    """
    sign, change = interval_signs(v)
    # A joint that reverses within an interval moves in both directions there.
    wrong = ways.wrong(np.where(change, 1.0, sign), shares, EFFORT_TOLERANCE)
    wrong |= ways.wrong(np.where(change, -1.0, sign), shares, EFFORT_TOLERANCE)
    if not wrong.any():
        return None
    new = ways.turned(sign, wrong)
    # Its torque has to suit both of them.
    both = new.both | (change & (ways.friction > 0.0))
    return replace(new, sign=np.where(both, 0.0, new.sign), both=both)


def motor_torques(
    system: ProblemFunctions, motion: Trajectory, ways: Ways | None
) -> Trajectory:
    """Torques of the motors for a motion with given torques without friction.

    Args:
        system: The problem.
        motion: The motion, joined by cubic polynomials between its nodes.
        ways: Directions of joints with dry friction on its intervals; None takes them
            from the motion.

    Returns:
        The motion with nodes where joints with friction reverse.
    """
    friction = system.problem.robot.friction
    if system.friction is None:
        return motion
    t = np.sort(np.concatenate([motion.t, reversals(motion, friction)]))
    middle = 0.5 * (t[1:] + t[:-1])
    state = motion(middle)
    sign = motion.turns.at(middle)
    if ways is not None:
        index = np.searchsorted(motion.t, middle) - 1
        sign = np.where(ways.both[index], sign, ways.sign[index])
    u = state.u + friction * sign
    nodes = motion(t)
    u = np.vstack([u, u[-1:]])
    holding = motion.holding
    return Trajectory(motion.joint_names, t, nodes.q, nodes.v, u, holding=holding)
