"""Robot data for the rivals, and the torques by which all motions are judged.

The torque is implemented here independently of the library, as it is the reference:
Pinocchio's recursive Newton-Euler algorithm plus rotor inertia plus viscous
friction.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

Array = NDArray[np.float64]
Sampler = Callable[[Array], tuple[Array, Array, Array]]


@dataclass(frozen=True)
class Arm:
    """A fully actuated arm with one coordinate per joint.

    Attributes:
        model: Pinocchio model with nq == nv == n. Its rotor inertias are not used.
        position_lower: Shape (n,), in [rad] or [m]; -inf where there is no limit.
        position_upper: Shape (n,), in [rad] or [m]; inf where there is no limit.
        velocity: Largest speeds, shape (n,), in [rad/s] or [m/s].
        effort_lower: Shape (n,), in [N m] or [N].
        effort_upper: Shape (n,), in [N m] or [N].
        damping: Viscous friction, shape (n,), in [N m s/rad] or [N s/m].
        armature: Rotor inertia seen at the joint, shape (n,), in [kg m^2] or [kg].
    """

    model: Any
    position_lower: Array
    position_upper: Array
    velocity: Array
    effort_lower: Array
    effort_upper: Array
    damping: Array
    armature: Array

    @classmethod
    def of(cls, robot: Any) -> Arm:
        """Read the arm off a robot of the library.

        Args:
            robot: Object with ``model``, ``limits``, ``damping`` and ``armature``.
        """
        limits = robot.limits
        if not robot.model.nq == robot.model.nv == len(robot.damping):
            raise ValueError("every joint must have one coordinate and move by itself")
        return cls(
            model=robot.model,
            position_lower=np.array(limits.position_lower, dtype=float),
            position_upper=np.array(limits.position_upper, dtype=float),
            velocity=np.array(limits.velocity, dtype=float),
            effort_lower=np.array(limits.effort_lower, dtype=float),
            effort_upper=np.array(limits.effort_upper, dtype=float),
            damping=np.array(robot.damping, dtype=float),
            armature=np.array(robot.armature, dtype=float),
        )

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.model.nv)


class TorqueModel:
    """Joint torques by Pinocchio, friction and rotors included.

    Args:
        arm: The robot. Its model is copied, so that it is not changed.
    """

    def __init__(self, arm: Arm) -> None:
        self._model = arm.model.copy()
        # pin.rnea adds the rotor inertias of the model; the arm's are added below.
        self._model.armature = np.zeros(arm.n)
        self._data = self._model.createData()
        self._damping = arm.damping
        self._armature = arm.armature

    def __call__(self, q: Array, v: Array, a: Array) -> Array:
        """Torques in [N m] of one state, or of each row of several, shape (..., n)."""
        if q.ndim == 1:
            rigid = pin.rnea(self._model, self._data, q, v, a).copy()
        else:
            rigid = np.array(
                [
                    pin.rnea(self._model, self._data, *row)
                    for row in zip(q, v, a, strict=True)
                ]
            )
        return np.asarray(rigid + self._armature * a + self._damping * v)

    def holding(self, q: Array) -> Array:
        """Torques in [N m] that hold the arm at rest at q, shape (n,)."""
        zero = np.zeros_like(q)
        return self(q, zero, zero)


@dataclass(frozen=True)
class LimitExcess:
    """Excess of a motion over its limits; 0 where it keeps them.

    Attributes:
        torque: Largest excess relative to half the torque range.
        velocity: Largest excess relative to the velocity limit.
        position: Largest excess in [rad] or [m].
        start_error: Distance from the start and from rest there, in [rad], [rad/s].
        goal_error: Distance from the goal and from rest there, in [rad], [rad/s].
    """

    torque: float
    velocity: float
    position: float
    start_error: float
    goal_error: float


def limit_excess(
    arm: Arm,
    motion: Sampler,
    duration: float,
    q_start: Array,
    q_goal: Array,
    samples: int = 2000,
) -> LimitExcess:
    """Judge a motion on a grid much finer than that of any solver.

    The torque is recomputed from position, velocity and acceleration. Sampling is at
    the middle of equal steps, so that a jump of the acceleration is never hit exactly.

    Args:
        arm: The robot.
        motion: Times of shape (m,) in [s] to q, v, a, each of shape (m, n).
        duration: Length of the motion in [s].
        q_start: Required start at rest, shape (n,).
        q_goal: Required end at rest, shape (n,).
        samples: Number of instants.
    """
    edges = np.linspace(0.0, duration, samples + 1)
    times: Array = np.asarray(0.5 * (edges[:-1] + edges[1:]), dtype=np.float64)
    q, v, a = motion(times)
    tau = TorqueModel(arm)(q, v, a)
    half_range = 0.5 * (arm.effort_upper - arm.effort_lower)
    torque = np.maximum(tau - arm.effort_upper, arm.effort_lower - tau) / half_range
    velocity = np.abs(v) / arm.velocity - 1.0
    position = np.maximum(q - arm.position_upper, arm.position_lower - q)
    q_end, v_end, _ = motion(np.array([0.0, duration]))
    miss = np.hstack([q_end - np.stack([q_start, q_goal]), v_end])
    return LimitExcess(
        torque=max(0.0, float(torque.max())),
        velocity=max(0.0, float(velocity.max())),
        position=max(0.0, float(position.max())),
        start_error=float(np.abs(miss[0]).max()),
        goal_error=float(np.abs(miss[1]).max()),
    )


def piecewise_constant_acceleration(knots: Array, q: Array, v: Array) -> Sampler:
    """Motion through given positions and speeds with constant acceleration between.

    Args:
        knots: Times, shape (N+1,), in [s].
        q: Positions at the knots, shape (N+1, n).
        v: Velocities at the knots, shape (N+1, n).
    """
    accelerations = np.diff(v, axis=0) / np.diff(knots)[:, None]

    def motion(times: Array) -> tuple[Array, Array, Array]:
        k = np.clip(np.searchsorted(knots, times, side="right") - 1, 0, len(knots) - 2)
        s = (times - knots[k])[:, None]
        a = accelerations[k]
        return q[k] + s * v[k] + 0.5 * s**2 * a, v[k] + s * a, a

    return motion
