"""The robot that torques are replayed on.

Dry friction is F tanh(v / CREEP), so steep that the end of a motion does not notice;
see ``docs/friction.md``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array
from tominpmp.dynamics import RobotDynamics
from tominpmp.robot import Robot

# Speed over which dry friction comes up [rad/s or m/s].
CREEP = 1e-9

Slope: TypeAlias = Callable[[float, Array], Array]


class Plant:
    """State derivative of a robot under a polynomial of torque, one row at a time.

    Attributes:
        creep: Speed over which dry friction comes up [rad/s or m/s].
    """

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.dynamics = RobotDynamics(robot, dry=False)
        self.friction = robot.friction if np.any(robot.friction) else None
        self.creep = CREEP
        self._exponents = np.zeros(0)
        self.coefficients = np.zeros((robot.n, 0))
        self.begin, self.rate = 0.0, 1.0

    def load(self, begin: float, end: float, coefficients: Array) -> None:
        """Take up the torque of another piece."""
        self.coefficients = coefficients
        self.begin, self.rate = begin, 2.0 / (end - begin)
        self._exponents = np.arange(float(coefficients.shape[1]))

    def torque(self, t: float) -> Array:
        """Torque at a time within the piece, shape (n,)."""
        s = (t - self.begin) * self.rate - 1.0
        return np.asarray(self.coefficients.dot(s**self._exponents))

    def driving(self, t: float, v: Array) -> Array:
        """What dry friction leaves of the torque, shape (n,)."""
        if self.friction is None:
            return self.torque(t)
        return np.asarray(self.torque(t) - self.friction * np.tanh(v / self.creep))

    def drag(self, v: Array) -> Array:
        """Derivatives of dry friction with respect to velocities, shape (n,)."""
        if self.friction is None:
            return np.zeros(self.robot.n)
        rise = (1.0 - np.tanh(v / self.creep) ** 2) / self.creep
        return np.asarray(self.friction * rise)

    def slope(self) -> Slope:
        """dx/dt as a function of t and x = (q, v)."""
        robot, dynamics, driving = self.robot, self.dynamics, self.driving
        n = robot.n
        if robot.expansion_matrix is not None:

            def linked(t: float, x: Array) -> Array:
                u = driving(t, x[n:])
                return np.asarray(dynamics.forward(x[None], u[None])[0])

            return linked
        model, data, damping = robot.model, robot.model.createData(), robot.damping
        aba = pin.aba

        def free(t: float, x: Array) -> Array:
            out = np.empty(2 * n)
            v = x[n:]
            out[:n] = v
            out[n:] = aba(model, data, x[:n], v, driving(t, v) - damping * v)
            return out

        return free

    def jacobian(self) -> Slope:
        """Derivative of dx/dt with respect to x, shape (2n, 2n), likewise."""
        robot, dynamics, driving = self.robot, self.dynamics, self.driving
        n, drag = robot.n, self.drag
        if robot.expansion_matrix is not None:

            def linked(t: float, x: Array) -> Array:
                v = x[n:]
                u = driving(t, v)
                found = dynamics.forward_jacobians(x[None], u[None])
                f_x = np.array(found.f_x[0])
                f_x[n:, n:] -= found.f_u[0, n:] * drag(v)
                return f_x

            return linked
        model, data, damping = robot.model, robot.model.createData(), robot.damping
        derivatives = pin.computeABADerivatives
        lower = np.tril_indices(n, -1)
        diagonal = np.arange(n)

        def free(t: float, x: Array) -> Array:
            v = x[n:]
            derivatives(model, data, x[:n], v, driving(t, v) - damping * v)
            out = np.zeros((2 * n, 2 * n))
            out[diagonal, n + diagonal] = 1.0
            out[n:, :n] = data.ddq_dq
            inverse = np.array(data.Minv)  # the upper triangle of it
            inverse[lower] = inverse.T[lower]
            out[n:, n:] = data.ddq_dv - inverse * (damping + drag(v))
            return out

        return free
