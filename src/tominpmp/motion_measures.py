"""Measures of a motion: how unquiet its torques are, its way, and its energy."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tominpmp.arrays import Array
from tominpmp.robot import JointLimits
from tominpmp.trajectory import State, Trajectory

# Instants whose torques are compared.
ROUGHNESS_INSTANTS = 100
# Instants of each interval between nodes at which torques are squared.
GAUSS_POINTS = 4
# The same for work, which has kinks where a motor begins to brake.
WORK_POINTS = 12


def roughness(trajectory: Trajectory, limits: JointLimits) -> float:
    """How unquiet the torques of a motion are; see :attr:`Solution.roughness`."""
    share = (np.arange(ROUGHNESS_INSTANTS) + 0.5) / ROUGHNESS_INSTANTS
    u = trajectory(share * trajectory.duration).u
    span = limits.effort_upper - limits.effort_lower
    driven = span > 0.0
    return float(np.sum((np.diff(u[:, driven], axis=0) / span[driven]) ** 2))


def way_of(trajectory: Trajectory, limits: JointLimits) -> float:
    """What all joints would take for their ways one after the other [s].

    Each at the limit of its speed, those without one at 1 rad/s or m/s.
    """
    speed = np.where(np.isfinite(limits.velocity), limits.velocity, 1.0)
    return float(np.sum(np.abs(np.diff(trajectory.q, axis=0)) / speed))


def energy_of(trajectory: Trajectory) -> float:
    """Integral of the squared torques of a motion over time [N^2 m^2 s]."""
    return _integral(trajectory, GAUSS_POINTS, lambda state: np.sum(state.u**2, axis=1))


def work_of(trajectory: Trajectory) -> float:
    """Mechanical work that the motors do in a motion [J], without what they brake."""
    return _integral(
        trajectory,
        WORK_POINTS,
        lambda state: np.sum(np.maximum(state.u * state.v, 0.0), axis=1),
    )


def _integral(
    trajectory: Trajectory, points: int, of: Callable[[State], Array]
) -> float:
    """Integral over time of what is at the states of a motion."""
    h = np.diff(trajectory.t)
    places, weights = np.polynomial.legendre.leggauss(points)
    share = 0.5 * (1.0 + places)
    times = trajectory.t[:-1, None] + h[:, None] * share
    values = of(trajectory(times.ravel())).reshape(h.size, points)
    return float(np.sum(values @ (0.5 * weights) * h))
