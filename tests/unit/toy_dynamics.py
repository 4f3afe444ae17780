"""Equations of motion simple enough to check by hand, with the methods of Dynamics."""

from __future__ import annotations

import numpy as np

from tominpmp.dynamics import ForwardJacobians


class Pendulum:
    """Independent joints: inertia a + weight sin q + friction v = u, row by row."""

    def __init__(self, inertia, friction, weight):
        self.inertia, self.friction, self.weight = (
            np.array(value, dtype=float) for value in (inertia, friction, weight)
        )

    @property
    def n(self):
        return self.inertia.size

    def forward(self, x, u):
        q, v = x[:, : self.n], x[:, self.n :]
        force = u - self.friction * v - self.weight * np.sin(q)
        return np.concatenate([v, force / self.inertia], axis=1)

    def forward_jacobians(self, x, u):
        n, m = self.n, x.shape[0]
        f_x, f_u = np.zeros((m, 2 * n, 2 * n)), np.zeros((m, 2 * n, n))
        joints = np.arange(n)
        f_x[:, joints, n + joints] = 1.0
        f_x[:, n + joints, joints] = -self.weight * np.cos(x[:, :n]) / self.inertia
        f_x[:, n + joints, n + joints] = -self.friction / self.inertia
        f_u[:, n + joints, joints] = 1.0 / self.inertia
        return ForwardJacobians(self.forward(x, u), f_x, f_u)

    def inverse(self, q, v, a):
        return self.inertia * a + self.friction * v + self.weight * np.sin(q)


def double_integrator(n=1):
    """Joints of unit inertia without friction or weight."""
    return Pendulum(np.ones(n), np.zeros(n), np.zeros(n))
