"""Sensitivities to torques, and to the numbers that change the torques of a motion.

The multipliers of torques, of their rates and of torques over speed give the share of
the duration by which an additional torque at an instant delays the motion. Gravity,
loads and friction change the torques that the same motion takes: the inverse dynamics
is linear in each of them, so that their derivatives need no differences.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array
from tominpmp.certificate.limits import (
    PASSIVE,
    LimitRows,
    SampledConstraint,
    limits_of_joints,
)
from tominpmp.certificate.motion import Motion
from tominpmp.constraints.torque import MotorLimit, TorqueLimit
from tominpmp.dynamics import RobotDynamics
from tominpmp.robot.payload import Payload
from tominpmp.robot.robot import Robot


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
        """Gather the multipliers of torques on a segment of a motion."""
        n = motion.changes.n
        found = [tuple(np.zeros((5, 0, n)))]
        for item in limits_of_joints(motion):
            kinds = (item.kind.name, PASSIVE)[: 1 + isinstance(item, TorqueLimit)]
            rows = given.selected(given.of(*kinds) & (given.y != 0.0))
            if not isinstance(item, MotorLimit) or not rows.y.size:
                continue
            slopes = item.order > 2
            at = motion.changes.pairs(rows.at.interval) if slopes else rows.at
            looked = SampledConstraint.of(motion, item, at)
            # As a function of the torques, which are those less dry friction.
            _, q, v, a, _ = looked.states
            states = looked.states._replace(u=motion.system.dynamics.inverse(q, v, a))
            each = np.arange(rows.y.size), rows.component
            by = looked.item.differentiate(states, *each)
            assert by.by_u is not None  # noqa: S101
            weight = np.zeros((at.size, n))
            worth = rows.y if by.row is None else rows.y[by.row]
            np.add.at(weight, by.at, worth[:, None] * by.by_u)
            found.append((q, v, a, motion.ways(at), weight))
        return cls(*map(np.concatenate, zip(*found, strict=True)))

    def _of_model(self, robot: Robot, change: Callable[[pin.Model], None]) -> float:
        """Share of T that the torques cost which a change of the model adds."""
        model = robot.model.copy()
        change(model)
        rows = self.q, self.v, self.a
        more, own = (
            RobotDynamics(one, dry=False).inverse(*rows)
            for one in (replace(robot, model=model), robot)
        )
        return float(np.sum(self.weight * (more - own)))

    def by_gravity(self, robot: Robot) -> Array:
        """Shares of T by the coordinates of gravity, shape (3,) [s^2/m]."""

        def pulled(model: pin.Model, way: Array) -> None:
            model.gravity.linear = model.gravity.linear + way

        ways = (partial(pulled, way=way) for way in np.eye(3))
        return np.array([self._of_model(robot, way) for way in ways])

    def by_mass(self, robot: Robot, payload: Payload) -> float:
        """Share of T by the mass of a payload of the robot [1/kg]."""
        tensor = np.zeros((3, 3)) if payload.inertia is None else payload.inertia
        if payload.mass > 0.0:
            tensor = np.asarray(tensor) / payload.mass
        one = pin.Inertia(1.0, np.array(payload.com), np.array(tensor))

        def loaded(model: pin.Model) -> None:
            frame = model.frames[robot.frame_id(payload.name)]
            model.inertias[frame.parentJoint] += frame.placement.act(one)

        return self._of_model(robot, loaded)
