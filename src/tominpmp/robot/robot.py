"""A robot arm: its model, limits, friction and geometry."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from tominpmp.arrays import Array, Record, comparable, frozen_array
from tominpmp.checks import JOINTS, array, instance, names
from tominpmp.description.inertials import check_inertia
from tominpmp.description.joint_table import (
    JointLimits,
    JointTable,
    JointValues,
    Linkage,
    check_gravity,
    stack_parts,
)
from tominpmp.description.model import (
    build_geometry,
    build_model,
    configured_model,
    expansion,
    sticks,
)
from tominpmp.description.srdf import SemanticDescription
from tominpmp.description.tree import UrdfDescription
from tominpmp.exceptions import FrameNotFound, ProblemError, RobotLoadError, brief
from tominpmp.motion_limits import MotionLimits
from tominpmp.notebook import card, skeletons, table
from tominpmp.robot.payload import Payload, attach


@dataclass(frozen=True, eq=False)
class Robot(Record):
    r"""A robot arm: its model, limits, friction and geometry.

    The n joints are those that move freely; locked joints are part of the links. A
    joint that follows another (mimic) is a joint of ``model`` but not one of the n:

    .. math:: q_{model} = S q + c

    Torques on the n joints are :math:`S^T \tau_{model}`. Robots are not changed;
    :meth:`with_changes` makes another one.

    Attributes:
        name: Name asked for, or the one in the description.
        model: Kinematics and inertia, with ``gravity`` and ``armature`` set; not to be
            changed. Every joint has one coordinate: nq = nv.
        joint_names: Names of the n joints in the order of all arrays.
        limits: Limits of the n joints.
        damping: Viscous friction, shape (n,) [N m s/rad or N s/m]. Pinocchio's
            algorithms do not apply it.
        armature: Rotor inertia seen at the joint, shape (n,) [kg m^2 or kg].
        friction: Dry (Coulomb) friction against the motion of each joint, shape (n,)
            [N m or N]; see ``docs/friction.md``. Pinocchio's algorithms do not apply
            it either.
        gravity: Gravity in the world, shape (3,) [m/s^2].
        expansion_matrix: S, shape (nv, n), or ``None`` if it is the identity.
        expansion_offset: c, shape (nv,) [rad or m], or ``None`` if it is zero.
        locked_joints: Positions of the locked joints by name [rad or m].
        srdf: Semantic description, if there is one.
        description: The URDF file, as read.
        motion_limits: Limits beyond those of a URDF file, which problems with this
            robot have unless they say otherwise; None for none.
    """

    name: str
    model: pin.Model = field(repr=False)
    joint_names: tuple[str, ...]
    limits: JointLimits = field(repr=False)
    damping: Array = field(repr=False)
    armature: Array = field(repr=False)
    friction: Array = field(repr=False)
    gravity: Array
    expansion_matrix: Array | None = field(repr=False)
    expansion_offset: Array | None = field(repr=False)
    locked_joints: Mapping[str, float]
    srdf: SemanticDescription | None = field(repr=False)
    description: UrdfDescription = field(repr=False)
    motion_limits: MotionLimits | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        """Check the values, and make the arrays and the mapping read-only."""
        instance(self.model, pin.Model, "model")
        instance(self.limits, JointLimits, "limits")
        instance(self.locked_joints, Mapping, "locked_joints", "positions by name")
        instance(self.description, UrdfDescription, "description")
        object.__setattr__(self, "joint_names", names(self.joint_names))
        matrices = ("expansion_matrix", "expansion_offset")
        for name in ("damping", "armature", "friction", "gravity", *matrices):
            if (value := getattr(self, name)) is not None:
                value = frozen_array(array(value, name, (...,), "numbers"))
                object.__setattr__(self, name, value)
        locked = MappingProxyType(dict(self.locked_joints))
        object.__setattr__(self, "locked_joints", locked)
        if self.motion_limits is not None:
            limits = instance(self.motion_limits, MotionLimits, "motion_limits")
            limits.check(self.joint_names)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle without the geometry, which is read again where it is needed.

        Meshes would make it hundreds of megabytes.
        """
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        values["locked_joints"] = dict(self.locked_joints)
        return type(self), tuple(values.values())

    def _values(self) -> tuple[Any, ...]:
        """What is compared; of the model, only what the rest does not determine."""
        found = {f.name: getattr(self, f.name) for f in fields(self)}
        model = found.pop("model")
        found["locked_joints"] = tuple(sorted(self.locked_joints.items()))
        found["inertias"] = np.array([i.toDynamicParameters() for i in model.inertias])
        return tuple(map(comparable, found.values()))

    def __repr__(self) -> str:
        """Name and joints, on one line."""
        joints = brief(", ".join(self.joint_names))[1:-1]
        return f"<Robot {brief(self.name)} with {self.n} joints: {joints}>"

    def _repr_html_(self) -> str:
        """A stick figure and the limits, for notebooks."""
        low, high = self.limits.position_lower, self.limits.position_upper
        arm = sticks(self.model, self.expand(np.clip(np.zeros(self.n), low, high)))
        columns = (low, high, self.limits.velocity, self.limits.effort_upper)
        rows = zip(self.joint_names, *(x.tolist() for x in columns), strict=True)
        head = ("joint", "lower", "upper", "velocity", "effort")
        picture = skeletons("at zero", {"robot": arm})
        return card(f"Robot {self.name}", picture, table(head, list(rows)))

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joint_names)

    @property
    def urdf_path(self) -> Path:
        """The URDF file."""
        return self.description.path

    @property
    def package_dirs(self) -> tuple[Path, ...]:
        """Folders given for ``package://``."""
        return self.description.package_dirs

    @property
    def passive_joints(self) -> tuple[str, ...]:
        """Names of the joints without a motor: both effort limits are equal."""
        passive = self.limits.effort_lower == self.limits.effort_upper
        return tuple(np.array(self.joint_names)[passive].tolist())

    @cached_property
    def collision_model(self) -> pin.GeometryModel:
        """Collision geometry of the links; not to be changed."""
        return build_geometry(self.description, self.model, pin.GeometryType.COLLISION)

    @cached_property
    def visual_model(self) -> pin.GeometryModel:
        """Geometry to look at; read at first use, as it takes up to seconds."""
        return build_geometry(self.description, self.model, pin.GeometryType.VISUAL)

    @cached_property
    def frame_names(self) -> tuple[str, ...]:
        """Names of all frames: links, joints and whatever is fixed to them."""
        return tuple(frame.name for frame in self.model.frames[1:])

    def frame_id(self, name: str) -> int:
        """Index of a frame in ``model.frames``; a link goes before a joint.

        Raises:
            FrameNotFound: If there is none of that name, with those there are.
        """
        index = self._frame_ids.get(name) if isinstance(name, str) else None
        if index is None:
            raise FrameNotFound(name, self.frame_names)
        return index

    @cached_property
    def _frame_ids(self) -> dict[str, int]:
        """Indices of the frames by name."""
        found: dict[str, int] = {}
        for index, frame in enumerate(self.model.frames):
            if index > 0:  # the first one is the world's
                found.setdefault(frame.name, index)
        bodies = (n for n in found if self.model.existBodyName(n))
        found.update({name: int(self.model.getBodyId(name)) for name in list(bodies)})
        return found

    def expand(self, q: ArrayLike) -> Array:
        """Configuration of ``model`` at joint positions: S q + c.

        Args:
            q: Joint positions, shape (..., n) [rad or m].

        Returns:
            Shape (..., model.nq).

        Raises:
            ProblemError: If they are no numbers, or not one for each joint.
        """
        q = array(q, "q", (..., self.n), JOINTS)
        if self.expansion_matrix is None or self.expansion_offset is None:
            return q
        return np.asarray(q @ self.expansion_matrix.T + self.expansion_offset)

    def expand_tangent(self, v: ArrayLike) -> Array:
        """Velocity or acceleration of ``model`` at that of the joints: S v.

        Args:
            v: Joint velocities or accelerations, shape (..., n).

        Returns:
            Shape (..., model.nv).

        Raises:
            ProblemError: If they are no numbers, or not one for each joint.
        """
        v = array(v, "v", (..., self.n), JOINTS)
        if self.expansion_matrix is None:
            return v
        return np.asarray(v @ self.expansion_matrix.T)

    def reduce_tangent(self, rows: ArrayLike) -> Array:
        """Bring gradients, Jacobians or torques from ``model`` to the joints: J S.

        Args:
            rows: Shape (..., model.nv).

        Returns:
            Shape (..., n).

        Raises:
            ProblemError: If they are no numbers, or not one for each joint.
        """
        rows = array(rows, "rows", (..., self.model.nv), JOINTS)
        if self.expansion_matrix is None:
            return rows
        return np.asarray(rows @ self.expansion_matrix)

    def group_state(self, name: str) -> Array:
        """Joint positions that the semantic description names, for example "home".

        Args:
            name: Name of the group state.

        Returns:
            Joint positions, shape (n,) [rad or m].

        Raises:
            ProblemError: If there is no such state, or it lacks a joint.
        """
        states = {} if self.srdf is None else self.srdf.group_states
        if not isinstance(name, str) or name not in states:
            known = ", ".join(states) or "none"
            raise ProblemError(
                f"there is no group state {brief(name)}; the robot has: {known}", "name"
            )
        lacking = [joint for joint in self.joint_names if joint not in states[name]]
        if lacking:
            raise ProblemError(
                f"the group state {name!r} says nothing about {', '.join(lacking)}",
                "name",
            )
        return np.array([states[name][joint] for joint in self.joint_names])

    def with_changes(
        self,
        *,
        gravity: ArrayLike | None = None,
        damping: JointValues | None = None,
        armature: JointValues | None = None,
        friction: JointValues | None = None,
        effort: JointValues | None = None,
        velocity: JointValues | None = None,
        position_lower: JointValues | None = None,
        position_upper: JointValues | None = None,
    ) -> Robot:
        """Make a robot that differs in some values, given as to :func:`load_robot`.

        Raises:
            OptionsError: If a value is wrong.
            JointNotFound: If a joint is unknown.
            RobotLoadError: If the inertia becomes singular.
        """
        table = self._table().overridden(
            self._linkage().reasons(),
            damping=damping,
            armature=armature,
            friction=friction,
            effort=effort,
            velocity=velocity,
            position_lower=position_lower,
            position_upper=position_upper,
        )
        changed = check_gravity(self.gravity if gravity is None else gravity)
        robot = self._rebuilt(table=table, gravity=changed)
        ties = robot.expansion_matrix, robot.expansion_offset
        check_inertia(robot.model, table, *ties, self.description)
        # Geometry does not depend on any of this; it need not be read again.
        for name in ("collision_model", "visual_model"):
            if name in self.__dict__:
                robot.__dict__[name] = self.__dict__[name]
        return robot

    def with_locked(self, positions: Mapping[str, float]) -> Robot:
        """Make a robot of which further joints do not move.

        Args:
            positions: Positions by joint name [rad or m]; joints that are locked
                already stay where they are.

        Raises:
            OptionsError: If a position is wrong.
            JointNotFound: If a joint is unknown.
            RobotLoadError: If no joint is left that moves.
        """
        instance(positions, Mapping, "positions", "positions by joint name")
        joints = self.description.joints
        mimics = {joint.name for joint in joints if joint.mimic}
        kept = {k: v for k, v in self.locked_joints.items() if k not in mimics}
        linkage = Linkage.resolve(joints, {**positions, **kept})
        linkage.warn_of_limits(joints)
        limits = self.motion_limits
        if limits is not None:
            kept_names = {k: k for k in self.joint_names if k not in linkage.locked}
            limits = limits.renamed(kept_names, self.joint_names)
        return self._rebuilt(linkage=linkage, motion_limits=limits)

    def with_payload(self, payload: Payload) -> Robot:
        """Make a robot that carries a body on one of its frames.

        Raises:
            ProblemError: If its name is taken.
            FrameNotFound: If there is no such frame.
        """
        description, srdf = attach(
            payload, self.description, self.srdf, self.model, self.collision_model
        )
        return self._rebuilt(description=description, srdf=srdf)

    @property
    def payloads(self) -> tuple[Payload, ...]:
        """What :meth:`with_payload` attached, in that order."""
        return self.description.attached

    def _table(self) -> JointTable:
        given = self.limits, self.damping, self.armature, self.friction
        return JointTable.of_limits(self.joint_names, *given)

    def _linkage(self) -> Linkage:
        return Linkage.resolve(self.description.joints, self.locked_joints)

    def _rebuilt(
        self,
        *,
        linkage: Linkage | None = None,
        table: JointTable | None = None,
        **changes: Any,
    ) -> Robot:
        """The robot with fields changed, and the model that follows from them."""
        kept = ("name", "description", "gravity", "srdf", "motion_limits")
        values = {name: getattr(self, name) for name in kept} | changes
        linkage = linkage or self._linkage()
        table = table or self._table()
        return assembled(linkage=linkage, table_for=table.only, **values)

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of the robots that this one was combined from; mostly none."""
        return self.description.parts

    def stack(self, **parts: ArrayLike) -> Array:
        """Join values of the joints of all robots combined, by name: shape (n,).

        Raises:
            ProblemError: If a robot is missing or unknown, or a length is wrong.
        """
        return stack_parts(self.joint_names, self.parts, parts)


def assembled(
    *,
    description: UrdfDescription,
    linkage: Linkage,
    table_for: Callable[[tuple[str, ...]], JointTable],
    gravity: Array,
    **values: Any,
) -> Robot:
    """Make a robot with the model that follows from its description.

    Args:
        description: Links and joints.
        linkage: Which joints are locked, and which follow others.
        table_for: Values of the joints that move freely, by their names.
        gravity: Gravity in the world, shape (3,) [m/s^2].
        **values: Its further fields.

    Raises:
        RobotLoadError: If no joint is left that moves.
    """
    plain = build_model(description, linkage.locked)
    joint_names, *ties = expansion(plain, linkage.followers, description.order)
    if not joint_names:
        path = description.path
        raise RobotLoadError(f"{path}: no joint is left that moves", path)
    joints = table_for(joint_names)
    return Robot(
        model=configured_model(plain, joints, gravity, *ties),
        joint_names=joint_names,
        limits=joints.limits(),
        damping=joints["damping"],
        armature=joints["armature"],
        friction=joints["friction"],
        gravity=gravity,
        expansion_matrix=ties[0],
        expansion_offset=ties[1],
        locked_joints=linkage.locked,
        description=description,
        **values,
    )
