"""Measures of the torques of a motion: how unquiet they are, and their energy."""

from __future__ import annotations

import numpy as np

from tominpmp.robot import JointLimits
from tominpmp.trajectory import Trajectory

# Instants whose torques are compared.
ROUGHNESS_INSTANTS = 100
# Instants of each interval between nodes at which torques are squared.
GAUSS_POINTS = 4


def roughness(trajectory: Trajectory, limits: JointLimits) -> float:
    """How unquiet the torques of a motion are; see :attr:`Solution.roughness`."""
    share = (np.arange(ROUGHNESS_INSTANTS) + 0.5) / ROUGHNESS_INSTANTS
    u = trajectory(share * trajectory.duration).u
    span = limits.effort_upper - limits.effort_lower
    driven = span > 0.0
    return float(np.sum((np.diff(u[:, driven], axis=0) / span[driven]) ** 2))


def energy_of(trajectory: Trajectory) -> float:
    """Integral of the squared torques of a motion over time [N^2 m^2 s]."""
    h = np.diff(trajectory.t)
    places, weights = np.polynomial.legendre.leggauss(GAUSS_POINTS)
    share = 0.5 * (1.0 + places)
    times = trajectory.t[:-1, None] + h[:, None] * share
    squares = np.sum(trajectory(times.ravel()).u ** 2, axis=1)
    return float(np.sum(squares.reshape(h.size, -1) @ (0.5 * weights) * h))
