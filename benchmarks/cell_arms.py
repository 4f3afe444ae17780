"""Arms of a cell as a case describes them, built without the library."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from benchmarks.exact_geometry import Array, Body, ExactArm


@dataclass(frozen=True)
class Member:
    """One arm of a cell.

    Attributes:
        arm: Model and exact links, in the axes of its base; gravity is turned.
        base: Pose of the base in the world.
        friction: Dry friction [N m or N], shape (n,).
    """

    arm: ExactArm
    base: pin.SE3
    friction: Array

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.arm.names)

    def configuration(self, q: Array) -> Array:
        """Pinocchio's configuration: cosine and sine for continuous joints."""
        return configuration(self.arm.model, q)

    def position_limits(self) -> Array:
        """Lower and upper limits of the joints, shape (2, n)."""
        model = self.arm.model
        rows = []
        for joint in list(model.joints)[1:]:
            k = joint.idx_q
            if joint.nq == 2:
                rows.append((-np.inf, np.inf))
            else:
                rows.append((model.lowerPositionLimit[k], model.upperPositionLimit[k]))
        return np.array(rows).T


def configuration(model: Any, q: Array) -> Array:
    """Pinocchio's configuration: cosine and sine for continuous joints."""
    out = np.empty(model.nq)
    for joint in list(model.joints)[1:]:
        angle = q[joint.idx_v]
        if joint.nq == 2:
            out[joint.idx_q : joint.idx_q + 2] = np.cos(angle), np.sin(angle)
        else:
            out[joint.idx_q] = angle
    return out


def read_member(item: Mapping[str, Any], gravity: Sequence[float]) -> Member:
    """Build an arm from its description in a case."""
    arm = ExactArm.load(
        Path(item["urdf"]), Path(item["srdf"] or item["urdf"]), item["locked"]
    )
    model = arm.model
    base = pin.SE3(pin.rpy.rpyToMatrix(*item["base_rpy"]), np.array(item["base"]))
    model.gravity.linear = base.rotation.T @ np.array(gravity, dtype=float)
    links = list(arm.links)
    load = item.get("payload")
    if load:
        frame = model.frames[model.getFrameId(load["frame"])]
        lever = np.array(load["com"], dtype=float)
        point = pin.Inertia(load["mass"], lever, np.zeros((3, 3)))
        model.appendBodyToJoint(frame.parentJoint, point, frame.placement)
        if load.get("radius"):
            place = frame.placement * pin.SE3(np.eye(3), lever)
            ball = coal.Sphere(load["radius"])
            links.append(Body("payload", frame.parentJoint, ball, place))
    if item.get("armature") is not None:
        model.armature = np.array(item["armature"], dtype=float)
    for key, values in (
        ("velocityLimit", item.get("velocity")),
        ("effortLimit", item.get("effort")),
    ):
        if values is not None:
            setattr(model, key, np.array(values, dtype=float))
    disabled = set(arm.disabled)
    if load:
        # The link that holds the load touches it, and so may its neighbours.
        carrier = model.frames[model.getFrameId(load["frame"])].parentJoint
        near = {carrier, model.parents[carrier]}
        disabled |= {frozenset((b.name, "payload")) for b in links if b.joint in near}
    damping = arm.damping
    if item.get("damping") is not None:
        damping = np.array(item["damping"], dtype=float)
    arm = ExactArm(model, arm.names, tuple(links), frozenset(disabled), damping)
    friction = np.array(item.get("friction") or np.zeros(len(arm.names)), dtype=float)
    return Member(arm, base, friction)


def inverse(members: Sequence[Member], q: Array, v: Array, a: Array) -> Array:
    """Torques of all arms without dry friction, shape (m, n)."""
    out = np.empty_like(q)
    begin = 0
    for member in members:
        part = slice(begin, begin + member.n)
        model, data = member.arm.model, member.arm.model.createData()
        for k in range(len(q)):
            place = member.configuration(q[k, part])
            out[k, part] = pin.rnea(model, data, place, v[k, part], a[k, part])
        out[:, part] += member.arm.damping * v[:, part]
        begin += member.n
    return out
