r"""Equations of motion of a robot with viscous and dry friction.

.. math:: M(q) \dot v + C(q, v) v + g(q) + D v + F \mathrm{sgn}(v) \ni u

This is the paper's :math:`\dot x = f(x, u)` (equation 2) with the state x = (q, v).
Pinocchio evaluates both directions and their derivatives (Featherstone, 2008;
Carpentier and Mansard, 2018); friction, which its algorithms leave out, is added here.
The sign is Coulomb's: a joint at rest stays there while its friction, up to F in either
direction, can hold it. Joints that follow others (mimic) enter through the expansion
matrix S of the robot: the torque of the free joints is S^T times the torque of all.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array
from tominpmp.robot import Robot
from tominpmp.stopping import check
from tominpmp.turns import STANDSTILL, directions

# Of so many rows it is looked now and then whether it is time to stop.
MANY = 5_000

_Row = TypeVar("_Row")


class ForwardJacobians(NamedTuple):
    """State derivative and its partial derivatives, one row an evaluation point.

    Attributes:
        f: dx/dt with x = (q, v), shape (m, 2n).
        f_x: Shape (m, 2n, 2n).
        f_u: Shape (m, 2n, n).
    """

    f: Array
    f_x: Array
    f_u: Array


class InverseJacobians(NamedTuple):
    """Torque and its partial derivatives, one row an evaluation point.

    Attributes:
        tau: Shape (m, n) [N m or N].
        tau_q: Shape (m, n, n).
        tau_v: Shape (m, n, n).
        tau_a: The mass matrix, shape (m, n, n).
    """

    tau: Array
    tau_q: Array
    tau_v: Array
    tau_a: Array


class Dynamics(Protocol):
    """What the transcriptions need to know of a mechanical system."""

    @property
    def n(self) -> int:
        """Number of degrees of freedom."""

    def forward(self, x: Array, u: Array) -> Array:
        """State derivative f(x, u), shapes (m, 2n) and (m, n) to (m, 2n)."""

    def forward_jacobians(self, x: Array, u: Array) -> ForwardJacobians:
        """State derivative with its partial derivatives."""

    def inverse(self, q: Array, v: Array, a: Array) -> Array:
        """Torque for a motion, all shapes (m, n)."""

    def inverse_jacobians(self, q: Array, v: Array, a: Array) -> InverseJacobians:
        """Torque with its partial derivatives."""


def _heeding(rows: Iterable[_Row], count: int) -> Iterable[_Row]:
    """Rows, of which there may be so many that it is time to stop before their end."""
    return rows if count < MANY else _watched(rows)


def _watched(rows: Iterable[_Row]) -> Iterator[_Row]:
    for number, row in enumerate(rows):
        if number % MANY == 0:
            check()
        yield row


class RobotDynamics:
    """Dynamics of a robot, on rows of states.

    Attributes:
        robot: The robot.
        friction: Dry friction of its joints, shape (n,) [N m or N]; None if there is
            none, or if torques are meant that are left when it is overcome.
    """

    def __init__(self, robot: Robot, *, dry: bool = True) -> None:
        self.robot = robot
        self.friction = robot.friction if dry and np.any(robot.friction) else None
        self._data = robot.model.createData()  # scratch of the algorithms

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle without the scratch data."""
        return _restored, (self.robot, self.friction is not None)

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.robot.n

    def inverse(self, q: Array, v: Array, a: Array) -> Array:
        """Torque for a motion.

        Dry friction acts against the motion; where a joint is at rest, against that
        which is about to begin.

        Args:
            q: Positions, shape (m, n) [rad or m].
            v: Velocities, shape (m, n).
            a: Accelerations, shape (m, n).

        Returns:
            Torques, shape (m, n) [N m or N].
        """
        if self.friction is None:
            return self._smooth(q, v, a)
        return self.inverse_along(q, v, a, directions(v, a))

    def inverse_along(self, q: Array, v: Array, a: Array, way: Array) -> Array:
        """Torque for a motion whose ways are known, however slow it may be.

        Args:
            q: Positions, shape (m, n) [rad or m].
            v: Velocities, shape (m, n).
            a: Accelerations, shape (m, n).
            way: Which way the joints go: 1, -1, or 0 at rest, shape (m, n).

        Returns:
            Torques, shape (m, n) [N m or N].
        """
        tau = self._smooth(q, v, a)
        return tau if self.friction is None else tau + self.friction * way

    def _smooth(self, q: Array, v: Array, a: Array) -> Array:
        robot, model, data = self.robot, self.robot.model, self._data
        rnea = pin.rnea
        rows = zip(
            robot.expand(q),
            robot.expand_tangent(v),
            robot.expand_tangent(a),
            strict=True,
        )
        tau = np.array([rnea(model, data, *row) for row in _heeding(rows, len(q))])
        return robot.reduce_tangent(tau.reshape(-1, model.nv)) + robot.damping * v

    def inertial(self, q: Array, a: Array) -> Array:
        """Torque that accelerations take, beyond what holds the arm: M(q) a.

        Args:
            q: Positions, shape (m, n).
            a: Accelerations, shape (m, n).

        Returns:
            Torques, shape (m, n) [N m or N].
        """
        robot, model, data = self.robot, self.robot.model.copy(), self._data
        model.gravity = pin.Motion.Zero()
        rnea, rest = pin.rnea, np.zeros(model.nv)
        rows = _heeding(
            zip(robot.expand(q), robot.expand_tangent(a), strict=True), len(q)
        )
        tau = np.array([rnea(model, data, at, rest, row) for at, row in rows])
        return robot.reduce_tangent(tau.reshape(-1, model.nv))

    def inverse_jacobians(self, q: Array, v: Array, a: Array) -> InverseJacobians:
        """Torque for a motion, with its derivatives.

        Those of dry friction are zero, away from rest.

        Args:
            q: Positions, shape (m, n).
            v: Velocities, shape (m, n).
            a: Accelerations, shape (m, n).

        Returns:
            Torque and derivatives with respect to q, v and a.
        """
        robot, model, data = self.robot, self.robot.model, self._data
        m, nv = q.shape[0], model.nv
        tau = np.empty((m, nv))
        parts = np.empty((3, m, nv, nv))
        derivatives = pin.computeRNEADerivatives
        rows = zip(
            robot.expand(q),
            robot.expand_tangent(v),
            robot.expand_tangent(a),
            strict=True,
        )
        for i, row in enumerate(rows):
            derivatives(model, data, *row)
            tau[i] = data.tau
            parts[0, i], parts[1, i], parts[2, i] = data.dtau_dq, data.dtau_dv, data.M
        # Pinocchio 3 fills only the upper triangle of M.
        upper = np.triu(parts[2])
        parts[2] = upper + np.swapaxes(np.triu(parts[2], 1), 1, 2)
        if robot.expansion_matrix is not None:
            S = robot.expansion_matrix
            parts = S.T @ parts @ S
        parts[1] += np.diag(robot.damping)
        tau = robot.reduce_tangent(tau) + robot.damping * v
        if self.friction is not None:
            tau = tau + self.friction * directions(v, a)
        return InverseJacobians(tau, parts[0], parts[1], parts[2])

    def forward(self, x: Array, u: Array) -> Array:
        """State derivative.

        Args:
            x: States (q, v), shape (m, 2n).
            u: Torques, shape (m, n) [N m or N].

        Returns:
            dx/dt = (v, dv/dt), shape (m, 2n).
        """
        n = self.n
        q, v = x[:, :n], x[:, n:]
        return np.concatenate([v, self._acceleration(q, v, self._net(q, v, u))], axis=1)

    def _net(self, q: Array, v: Array, u: Array) -> Array:
        """What dry friction leaves of torques.

        Joints at rest stay there if their friction can hold them all; those that it
        cannot hold are let go, until it can hold the rest.
        """
        if self.friction is None:
            return u
        F, moving = self.friction, np.abs(v) > STANDSTILL
        net = u - F * np.where(moving, np.sign(v), 0.0)
        for i in np.flatnonzero(np.any(~moving & (F > 0.0), axis=1)).tolist():
            row = slice(i, i + 1)
            mass = self.inverse_jacobians(q[row], v[row], np.zeros_like(v[row])).tau_a[
                0
            ]
            free = self._acceleration(q[row], v[row], net[row])[0]
            net[i] -= _holding(mass, free, F, ~moving[i] & (F > 0.0))
        return net

    def _acceleration(self, q: Array, v: Array, u: Array) -> Array:
        robot, model, data = self.robot, self.robot.model, self._data
        force = u - robot.damping * v
        if robot.expansion_matrix is not None:
            zero = np.zeros_like(v)
            bias = self._smooth(q, v, zero) - robot.damping * v
            mass = self.inverse_jacobians(q, v, zero).tau_a
            return np.asarray(np.linalg.solve(mass, (force - bias)[..., None])[..., 0])
        aba = pin.aba
        rows = _heeding(zip(q, v, force, strict=True), len(q))
        found = [aba(model, data, *row) for row in rows]
        return np.array(found).reshape(q.shape)

    def forward_jacobians(self, x: Array, u: Array) -> ForwardJacobians:
        r"""State derivative with its partial derivatives.

        By the implicit function theorem on the inverse dynamics,
        :math:`\dot v_q = -M^{-1} \tau_q`, :math:`\dot v_v = -M^{-1} \tau_v` and
        :math:`\dot v_u = M^{-1}`; for robots without mimic joints Pinocchio's
        derivatives of ABA, which need no solve, are used. Dry friction has no
        derivatives, away from rest.

        Args:
            x: States (q, v), shape (m, 2n).
            u: Torques, shape (m, n).

        Returns:
            f, f_x and f_u.
        """
        n, m = self.n, x.shape[0]
        q, v = x[:, :n], x[:, n:]
        u = self._net(q, v, u)
        f_x = np.zeros((m, 2 * n, 2 * n))
        f_u = np.zeros((m, 2 * n, n))
        f_x[:, :n, n:] = np.eye(n)
        if self.robot.expansion_matrix is None:
            acceleration = self._aba_jacobians(q, v, u, f_x, f_u)
        else:
            acceleration = self._acceleration(q, v, u)
            parts = self.inverse_jacobians(q, v, acceleration)
            inverse = np.linalg.inv(parts.tau_a)
            f_x[:, n:, :n] = -inverse @ parts.tau_q
            f_x[:, n:, n:] = -inverse @ parts.tau_v
            f_u[:, n:] = inverse
        return ForwardJacobians(np.concatenate([v, acceleration], axis=1), f_x, f_u)

    def _aba_jacobians(
        self, q: Array, v: Array, u: Array, f_x: Array, f_u: Array
    ) -> Array:
        model, data, n = self.robot.model, self._data, self.n
        force = u - self.robot.damping * v
        acceleration = np.empty_like(q)
        derivatives = pin.computeABADerivatives
        for i, row in enumerate(zip(q, v, force, strict=True)):
            derivatives(model, data, *row)
            acceleration[i] = data.ddq
            f_x[i, n:, :n], f_x[i, n:, n:] = data.ddq_dq, data.ddq_dv
            f_u[i, n:] = data.Minv
        upper = f_u[:, n:]
        f_u[:, n:] = np.triu(upper) + np.swapaxes(np.triu(upper, 1), 1, 2)
        # The friction is a torque -D v: its derivative passes through the inverse mass.
        f_x[:, n:, n:] -= f_u[:, n:] * self.robot.damping
        return acceleration


def _restored(robot: Robot, dry: bool) -> RobotDynamics:
    return RobotDynamics(robot, dry=dry)


def _holding(mass: Array, free: Array, F: Array, resting: Array) -> Array:
    """Dry friction of joints at rest.

    Args:
        mass: Mass matrix, shape (n, n).
        free: Accelerations without it, shape (n,).
        F: Its largest values, shape (n,) [N m or N].
        resting: Which joints are at rest and have some, shape (n,).

    Returns:
        What it takes off the torques, shape (n,).
    """
    inverse = np.linalg.inv(mass)
    taken, held = np.zeros_like(free), np.flatnonzero(resting)
    while held.size:
        # What lets the held ones stay, given those that were let go.
        left = free - inverse @ taken
        hold = np.linalg.solve(inverse[np.ix_(held, held)], left[held])
        loose = np.abs(hold) > F[held]
        if not loose.any():
            taken[held] = hold
            break
        taken[held[loose]] = np.sign(hold[loose]) * F[held[loose]]
        held = held[~loose]
    return taken
