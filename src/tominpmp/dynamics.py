r"""Equations of motion of a robot with viscous friction.

.. math:: M(q) \dot v + C(q, v) v + g(q) + D v = u

Pinocchio evaluates both directions and their derivatives (Featherstone, 2008;
Carpentier and Mansard, 2018); the friction D v, which its algorithms leave out, is
added here. Joints that follow others (mimic) enter through the expansion matrix S of
the robot: the torque of the free joints is S^T times the torque of all.
"""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array
from tominpmp.robot import Robot


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


class RobotDynamics:
    """Dynamics of a robot, on rows of states.

    Attributes:
        robot: The robot.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self._data = robot.model.createData()  # scratch of the algorithms

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle without the scratch data."""
        return type(self), (self.robot,)

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.robot.n

    def inverse(self, q: Array, v: Array, a: Array) -> Array:
        """Torque for a motion.

        Args:
            q: Positions, shape (m, n) [rad or m].
            v: Velocities, shape (m, n).
            a: Accelerations, shape (m, n).

        Returns:
            Torques, shape (m, n) [N m or N].
        """
        robot, model, data = self.robot, self.robot.model, self._data
        rnea = pin.rnea
        rows = zip(
            robot.expand(q),
            robot.expand_tangent(v),
            robot.expand_tangent(a),
            strict=True,
        )
        tau = np.array([rnea(model, data, *row) for row in rows])
        return robot.reduce_tangent(tau.reshape(-1, model.nv)) + robot.damping * v

    def inverse_jacobians(self, q: Array, v: Array, a: Array) -> InverseJacobians:
        """Torque for a motion, with its derivatives.

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
        return InverseJacobians(
            robot.reduce_tangent(tau) + robot.damping * v, parts[0], parts[1], parts[2]
        )

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
        return np.concatenate([v, self._acceleration(q, v, u)], axis=1)

    def _acceleration(self, q: Array, v: Array, u: Array) -> Array:
        robot, model, data = self.robot, self.robot.model, self._data
        force = u - robot.damping * v
        if robot.expansion_matrix is not None:
            zero = np.zeros_like(v)
            bias = self.inverse(q, v, zero) - robot.damping * v
            mass = self.inverse_jacobians(q, v, zero).tau_a
            return np.asarray(np.linalg.solve(mass, (force - bias)[..., None])[..., 0])
        aba = pin.aba
        rows = [aba(model, data, *row) for row in zip(q, v, force, strict=True)]
        return np.array(rows).reshape(q.shape)

    def forward_jacobians(self, x: Array, u: Array) -> ForwardJacobians:
        r"""State derivative with its partial derivatives.

        By the implicit function theorem on the inverse dynamics,
        :math:`\dot v_q = -M^{-1} \tau_q`, :math:`\dot v_v = -M^{-1} \tau_v` and
        :math:`\dot v_u = M^{-1}`; for robots without mimic joints Pinocchio's
        derivatives of ABA, which need no solve, are used.

        Args:
            x: States (q, v), shape (m, 2n).
            u: Torques, shape (m, n).

        Returns:
            f, f_x and f_u.
        """
        n, m = self.n, x.shape[0]
        q, v = x[:, :n], x[:, n:]
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
