"""What the torques of a motion are worth, and what changes with the torques it takes.

The multipliers of torques, of their rates and of torques over speed say by which share
of the duration a torque more at an instant delays the motion. Gravity, loads and
friction change the torques that the same motion takes: the inverse dynamics is linear
in each of them, so that their derivatives need no differences.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array, IntArray
from tominpmp.certificate.active_limits import Motion
from tominpmp.certificate.dual_solution import DualSolution
from tominpmp.certificate.instants import Instants
from tominpmp.certificate.limit_rows import LimitRows
from tominpmp.robot import Robot
from tominpmp.robot.payload import Payload

# Multipliers below this share of the largest one change nothing.
NOTHING = 1e-12

Term = tuple[IntArray, Array, IntArray, Array]
NO_TERM: Term = np.zeros(0, int), np.zeros(0), np.zeros(0, int), np.zeros(0)


@dataclass(frozen=True, eq=False)
class TorqueWeights:
    """What a unit of torque costs at some instants, as shares of the duration.

    Attributes:
        time: The instants [s], shape (k,).
        q: Positions there, shape (k, n).
        v: Velocities, shape (k, n).
        a: Accelerations, shape (k, n).
        way: Which way the joints go: 1, -1, or 0 at rest, shape (k, n).
        weight: Share of T by the torque of each joint, shape (k, n).
    """

    time: Array
    q: Array
    v: Array
    a: Array
    way: Array
    weight: Array

    @classmethod
    def of(cls, motion: Motion, found: DualSolution) -> TorqueWeights:
        """Gather the multipliers of a motion."""
        terms = [term for rows, y in found.rows for term in _terms(motion, rows, y)]
        n, changes = motion.changes.n, motion.changes
        parts = zip(NO_TERM, *terms, strict=True)
        interval, share, joint, worth = (np.concatenate(part) for part in parts)
        kept = np.abs(worth) > NOTHING * np.max(np.abs(worth), initial=0.0)
        place = np.stack([interval + 0.0, share], axis=1)[kept]
        place, row = np.unique(place, axis=0, return_inverse=True)
        weight = np.zeros((len(place), n))
        np.add.at(weight, (row.ravel(), joint[kept]), worth[kept])
        interval, share = place[:, 0].astype(int), place[:, 1]
        time = Instants(interval, share).inside.times(changes)
        state = motion.trajectory(time)
        a = np.array(state.a)
        for end in (0, 1):
            a[share == end] = motion.a[interval[share == end], end]
        way = np.asarray(motion.trajectory.turns.at(time))
        return cls(time, state.q, state.v, a, way, weight)

    def against(self, torque: Array) -> float:
        """Share of T that torques of shape (k, n) cost."""
        return float(np.sum(self.weight * torque))

    def by_joint(self, torque: Array) -> Array:
        """The same by the joint that provides them, shape (n,)."""
        return np.asarray(np.sum(self.weight * torque, axis=0))

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


# -- where the rows of limits have their torques ---------------------------------------


def _terms(motion: Motion, rows: LimitRows, y: Array) -> list[Term]:
    """Interval, place in it, joint and worth [1/(N m)] of the torques of rows."""
    reader: Callable[[Motion, LimitRows, Array], list[Term]] | None = {
        "effort": _levels,
        "passive": _levels,
        "effort rate": _rates,
        "effort over speed": _over_speed,
    }.get(rows.kind)
    return [] if reader is None else reader(motion, rows, y)


def _levels(motion: Motion, rows: LimitRows, y: Array) -> list[Term]:
    worth = y / motion.task.effort_half[rows.subject]
    if rows.mean:
        half = 0.5 * worth
        return _at_both_ends(rows.interval, rows.subject, half)
    return [(*rows.at, rows.subject, worth)]


def _rates(motion: Motion, rows: LimitRows, y: Array) -> list[Term]:
    """Rates are slopes over an interval, or of the mean torques of neighbours."""
    limits, h = motion.task.problem.motion_limits, motion.changes.h
    if limits is None:
        return []
    most = limits.by_joint("effort_rate", motion.trajectory.joint_names)
    if motion.changes.shape == "ramps":
        worth = y / (h[rows.interval] * most[rows.subject])
        begin, end = np.zeros(y.size), np.ones(y.size)
        return [
            (rows.interval, begin, rows.subject, -worth),
            (rows.interval, end, rows.subject, worth),
        ]
    apart = 0.5 * (h[rows.interval] + h[rows.interval + 1])
    half = 0.5 * y / (apart * most[rows.subject])
    return [
        *_at_both_ends(rows.interval, rows.subject, -half),
        *_at_both_ends(rows.interval + 1, rows.subject, half),
    ]


def _over_speed(motion: Motion, rows: LimitRows, y: Array) -> list[Term]:
    """Rows are of either sign: the one whose limit is near is that of the torque."""
    time = rows.at.inside.times(motion.changes)
    u = motion.trajectory(time).u[np.arange(y.size), rows.subject]
    worth = np.sign(u) * y / motion.task.effort_half[rows.subject]
    return [(*rows.at, rows.subject, worth)]


def _at_both_ends(interval: IntArray, joint: IntArray, worth: Array) -> list[Term]:
    return [(interval, np.full(worth.shape, end), joint, worth) for end in (0.0, 1.0)]
