"""Sensitivities to torques, and to the numbers that change the torques of a motion.

The multipliers of torques, of their rates and of torques over speed give the share of
the duration by which an additional torque at an instant delays the motion. Gravity,
loads and friction change the torques that the same motion takes: the inverse dynamics
is linear in each of them, so that their derivatives need no differences.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array
from tominpmp.certificate.limit_rows import LimitRows
from tominpmp.certificate.motion import Motion
from tominpmp.certificate.perturbations import MEAN, Instants
from tominpmp.motion_limits import joint_kinds
from tominpmp.robot import Robot
from tominpmp.robot.payload import Payload

# Multipliers below this share of the largest one are neglected.
NOTHING = 1e-12


@dataclass(frozen=True, eq=False)
class TorqueWeights:
    """Cost of a unit of torque at instants, as shares of the duration.

    Attributes:
        q: Positions at the instants, shape (k, n).
        v: Velocities, shape (k, n).
        a: Accelerations, shape (k, n).
        way: Directions of the joints: 1, -1, or 0 at rest, shape (k, n).
        weight: Share of T by the torque of each joint, shape (k, n).
    """

    q: Array
    v: Array
    a: Array
    way: Array
    weight: Array

    @classmethod
    def of(cls, motion: Motion, given: LimitRows) -> TorqueWeights:
        """Gather the multipliers of torques of a motion."""
        rows = given.kept(np.abs(given.y * given.by_torque) > 0.0)
        changes, (interval, share) = motion.changes, rows.at
        worth, mean = rows.y * rows.by_torque, rows.mean
        rate = rows.of(*(k for k, kind in joint_kinds().items() if kind.of == "du"))
        # Rows, the instants of their torques, and the factors of these.
        parts: list[Any] = [(~mean & ~rate, 0, share, 1.0)]
        parts += [(mean, *term) for term in MEAN]
        parts += [
            (rate, shift, end, factor / changes.apart(interval))
            for shift, end, factor in changes.rise
        ]
        terms = []
        for own, shift, place, factor in parts:
            each = interval + shift, place, rows.subject, worth * factor
            terms.append(np.stack(np.broadcast_arrays(*each))[:, own])
        interval, share, joint, worth = np.concatenate(terms, axis=1)
        kept = np.abs(worth) > NOTHING * np.max(np.abs(worth), initial=0.0)
        place = np.stack([interval, share], axis=1)[kept]
        place, row = np.unique(place, axis=0, return_inverse=True)
        weight = np.zeros((len(place), changes.n))
        np.add.at(weight, (row.ravel(), joint[kept].astype(int)), worth[kept])
        at = Instants(place[:, 0].astype(int), place[:, 1])
        state = motion.states(at.inside)
        a = np.array(state.a)
        for end in (0, 1):
            a[at.share == end] = motion.a[at.interval[at.share == end], end]
        way = np.asarray(motion.trajectory.turns.at(changes.times(at.inside)))
        return cls(state.q, state.v, a, way, weight)

    def against(self, torque: Array) -> float:
        """Share of T that torques, shape (k, n), cost."""
        return float(np.sum(self.weight * torque))

    def by_gravity(self, robot: Robot) -> Array:
        """Shares of T by the coordinates of gravity, shape (3,) [s^2/m]."""
        out = np.zeros(3)
        for axis in range(3):
            model = robot.model.copy()
            model.gravity.linear = np.eye(3)[axis]
            out[axis] = self.against(_torques(robot, model, self.q))
        return out

    def by_mass(self, robot: Robot, payload: Payload) -> float:
        """Share of T by the mass of a payload of the robot [1/kg]."""
        model = robot.model.copy()
        frame = model.frames[robot.frame_id(payload.name)]
        tensor = np.zeros((3, 3)) if payload.inertia is None else payload.inertia
        if payload.mass > 0.0:
            tensor = np.asarray(tensor) / payload.mass
        one = pin.Inertia(1.0, np.array(payload.com), np.array(tensor))
        for joint in range(model.njoints):
            model.inertias[joint] = pin.Inertia.Zero()
        model.inertias[frame.parentJoint] = frame.placement.act(one)
        model.armature = np.zeros(model.nv)
        return self.against(_torques(robot, model, self.q, self.v, self.a))


def _torques(
    robot: Robot,
    model: pin.Model,
    q: Array,
    v: Array | None = None,
    a: Array | None = None,
) -> Array:
    """Torques of a changed model at states, at rest by default, shape (k, n)."""
    data, rest = model.createData(), np.zeros_like(q)
    rows = zip(
        robot.expand(q),
        robot.expand_tangent(rest if v is None else v),
        robot.expand_tangent(rest if a is None else a),
        strict=True,
    )
    found = np.array([pin.rnea(model, data, *row) for row in rows])
    return robot.reduce_tangent(found.reshape(-1, model.nv))
