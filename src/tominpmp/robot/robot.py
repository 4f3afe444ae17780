"""Robot arms: model, limits, friction and geometry, and loading them.

A robot is loaded from a name, the path or the text of a URDF file, a ``yourdfpy.URDF``,
a ``pinocchio.Model`` with or without geometry (also as Pinocchio and example-robot-data
return them), or a module of the package robot_descriptions, or its name.
"""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from tominpmp.arrays import Array, Record, comparable, frozen_array
from tominpmp.checks import JOINTS, array, choice, instance, names, raised_as, wrong
from tominpmp.datasheets import SHEET_COLUMNS, published_values
from tominpmp.description.files import check_folders, find_files
from tominpmp.description.from_pinocchio import describe_model
from tominpmp.description.inertials import check_inertia, warn_of_inertia
from tominpmp.description.joint_table import (
    JointLimits,
    JointTable,
    JointValues,
    Linkage,
    check_gravity,
    check_kinematic,
    configured_model,
    stack_parts,
)
from tominpmp.description.mjcf import describe_mjcf
from tominpmp.description.model import (
    ScratchData,
    are_neighbours,
    build_geometry,
    sticks,
)
from tominpmp.description.srdf import (
    Group,
    SemanticDescription,
    ordered_pair,
    read_srdf,
    warn_of_passive,
)
from tominpmp.description.tree import LOSSES, UrdfDescription, check_numbers
from tominpmp.description.urdf import read_parsed, read_urdf
from tominpmp.description.xacro_files import Arguments, expanded_root
from tominpmp.exceptions import (
    FrameNotFound,
    OptionsError,
    ProblemError,
    RobotLoadError,
    brief,
    counted,
    unknown,
)
from tominpmp.motion_limits import MotionLimits, kinds_of, limits_by_joint
from tominpmp.notebook import card, skeletons, table
from tominpmp.robot.payload import Payload


@dataclass(frozen=True, eq=False)
class Robot(Record):
    r"""A robot arm: its model, limits, friction and geometry.

    The n joints are those that move freely; locked joints are part of the links. A
    joint that follows another (mimic) is a joint of ``model`` but not one of the n:

    .. math:: q_{model} = S q + c

    Torques on the n joints are :math:`S^T \tau_{model}`. Robots are immutable;
    :meth:`with_changes` makes another one.

    Attributes:
        name: Name under which it was loaded, or the name in the description.
        model: Kinematics and inertia, with ``gravity`` and ``armature`` set; not to be
            modified. Every joint has one coordinate: nq = nv.
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
        description: Content of the URDF file.
        motion_limits: Limits beyond those of a URDF file, the default of problems with
            this robot; None without any.
        kinematic: Whether its dynamics are unknown: motions keep limits of positions,
            speeds, accelerations and jerks, and have no torques. Its torque limits are
            infinite, its friction and rotor inertia zero.
    """

    name: str
    model: pin.Model = field(repr=False, compare=False)
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
    kinematic: bool = False

    def __post_init__(self) -> None:
        """Check the values, and make the arrays and the mapping read-only."""
        instance(self.model, pin.Model, "model")
        instance(self.limits, JointLimits, "limits")
        instance(self.locked_joints, Mapping, "locked_joints", "positions by name")
        instance(self.description, UrdfDescription, "description")
        locked = MappingProxyType(dict(self.locked_joints))
        self._keep(joint_names=names(self.joint_names), locked_joints=locked)
        matrices = ("expansion_matrix", "expansion_offset")
        for name in ("damping", "armature", "friction", "gravity", *matrices):
            if (value := getattr(self, name)) is not None:
                value = array(value, name, (...,), "numbers")
                self._keep(**{name: frozen_array(value)})
        if self.motion_limits is not None:
            limits = instance(self.motion_limits, MotionLimits, "motion_limits")
            limits.check(self.joint_names)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle without the geometry, which is read again on demand.

        Meshes would make the pickle hundreds of megabytes large.
        """
        return type(self), tuple(getattr(self, f.name) for f in fields(self))

    def _values(self) -> tuple[Any, ...]:
        """Values to compare; of the model, only those that other fields do not fix."""
        inertias = np.array([i.toDynamicParameters() for i in self.model.inertias])
        return (*super()._values(), comparable(inertias))

    def __repr__(self) -> str:
        """Name and joints, on one line."""
        joints = brief(", ".join(self.joint_names))[1:-1]
        kind = "Kinematic robot" if self.kinematic else "Robot"
        return f"<{kind} {brief(self.name)} with {counted(self.n, 'joint')}: {joints}>"

    def _repr_html_(self) -> str:
        """A stick figure and the limits, for notebooks."""
        low, high = self.limits.position_lower, self.limits.position_upper
        arm = sticks(self.model, self.expand(np.clip(np.zeros(self.n), low, high)))
        columns = {"lower": low, "upper": high, "velocity": self.limits.velocity}
        if not self.kinematic:
            columns["effort"] = self.limits.effort_upper
        values = (column.tolist() for column in columns.values())
        rows = list(zip(self.joint_names, *values, strict=True))
        title, picture = f"Robot {self.name}, in SI units", skeletons("at zero", [arm])
        return card(title, picture, table(("joint", *columns), rows))

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
        """Folders in which ``package://`` is resolved, as passed by the caller."""
        return self.description.package_dirs

    @property
    def passive_joints(self) -> tuple[str, ...]:
        """Names of the joints without a motor: both effort limits are equal."""
        passive = self.limits.effort_lower == self.limits.effort_upper
        return tuple(np.array(self.joint_names)[passive].tolist())

    @cached_property
    def _scratch(self) -> ScratchData:
        return ScratchData(self.model)

    @property
    def _model_and_data(self) -> tuple[pin.Model, pin.Data]:
        """The model, and data of the calling thread for Pinocchio's algorithms."""
        return self.model, self._scratch.data

    @cached_property
    def collision_model(self) -> pin.GeometryModel:
        """Collision geometry of the links; not to be modified."""
        return build_geometry(self.description, self.model, pin.GeometryType.COLLISION)

    @cached_property
    def visual_model(self) -> pin.GeometryModel:
        """Visual geometry; read at the first access, which takes up to seconds."""
        return build_geometry(self.description, self.model, pin.GeometryType.VISUAL)

    @cached_property
    def frame_names(self) -> tuple[str, ...]:
        """Names of all frames, once each: links, joints, and frames fixed to them."""
        return tuple(self._frame_ids)

    def frame_id(self, name: str) -> int:
        """Index of a frame in ``model.frames``; links take precedence over joints.

        Raises:
            FrameNotFound: If the robot has no frame of this name; lists the frames.
        """
        index = self._frame_ids.get(name) if isinstance(name, str) else None
        if index is None:
            raise FrameNotFound(name, self.frame_names)
        return index

    @cached_property
    def _frame_ids(self) -> dict[str, int]:
        """Indices of the frames by name, except the frame of the world."""
        indices: dict[str, int] = {}
        for index, frame in enumerate(self.model.frames[1:], 1):
            if frame.type == pin.FrameType.BODY or frame.name not in indices:
                indices[frame.name] = index
        return indices

    def expand(self, q: ArrayLike) -> Array:
        """Configuration of ``model`` for joint positions: S q + c.

        Args:
            q: Joint positions, shape (..., n) [rad or m].

        Returns:
            Shape (..., model.nq).

        Raises:
            ProblemError: If the values are not numbers, or not one for each joint.
        """
        q = array(q, "q", (..., self.n), JOINTS)
        if self.expansion_matrix is None or self.expansion_offset is None:
            return q
        return np.asarray(q @ self.expansion_matrix.T + self.expansion_offset)

    def expand_tangent(self, v: ArrayLike) -> Array:
        """Velocity or acceleration of ``model`` from that of the joints: S v.

        Args:
            v: Joint velocities or accelerations, shape (..., n).

        Returns:
            Shape (..., model.nv).

        Raises:
            ProblemError: If the values are not numbers, or not one for each joint.
        """
        v = array(v, "v", (..., self.n), JOINTS)
        if self.expansion_matrix is None:
            return v
        return np.asarray(v @ self.expansion_matrix.T)

    def reduce_tangent(self, rows: ArrayLike) -> Array:
        """Project gradients, Jacobians or torques of ``model`` onto the joints: J S.

        Args:
            rows: Shape (..., model.nv).

        Returns:
            Shape (..., n).

        Raises:
            ProblemError: If the values are not numbers, or not one for each joint.
        """
        rows = array(rows, "rows", (..., self.model.nv), JOINTS)
        if self.expansion_matrix is None:
            return rows
        return np.asarray(rows @ self.expansion_matrix)

    @property
    def group_states(self) -> Mapping[str, Mapping[str, float]]:
        """Joint positions [rad or m] by joint name, by the name of a group state."""
        return {} if self.srdf is None else self.srdf.group_states(self.joint_names)

    def group_state(self, name: str) -> Array:
        """Joint positions of a group state of the SRDF file, for example "home".

        Args:
            name: Name of the group state.

        Returns:
            Joint positions, shape (n,) [rad or m].

        Raises:
            ProblemError: If there is no group state of this name, or it lacks a joint.
        """
        states = self.group_states
        if not isinstance(name, str) or name not in states:
            message = unknown("group state", name, list(states), "the robot has")
            raise ProblemError(message, "name")
        lacking = [joint for joint in self.joint_names if joint not in states[name]]
        if lacking:
            raise ProblemError(
                f"the group state {name!r} has no value for {', '.join(lacking)}",
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
        """Make a robot with some values changed, in the forms of :func:`load_robot`.

        Raises:
            OptionsError: If a value is wrong.
            JointNotFound: If a joint is unknown.
            RobotLoadError: If the inertia becomes singular.
        """
        values = {
            "damping": damping,
            "armature": armature,
            "friction": friction,
            "effort": effort,
            "velocity": velocity,
            "position_lower": position_lower,
            "position_upper": position_upper,
        }
        check_kinematic(self.kinematic, values)
        table = self._table().overridden(values)
        changed = check_gravity(self.gravity if gravity is None else gravity)
        robot = self._rebuilt(table, gravity=changed)
        if not robot.kinematic:
            check_inertia(robot.model, table)
        # The geometry does not depend on these values and need not be read again.
        for name in ("collision_model", "visual_model"):
            if name in self.__dict__:
                robot.__dict__[name] = self.__dict__[name]
        return robot

    def with_locked(self, positions: Mapping[str, float]) -> Robot:
        """Make a robot with further joints locked.

        Args:
            positions: Positions by joint name [rad or m]; joints that are locked
                already keep their positions.

        Raises:
            OptionsError: If a position is wrong.
            JointNotFound: If a joint is unknown.
            RobotLoadError: If no moving joint remains.
        """
        instance(positions, Mapping, "positions", "positions by joint name")
        locked = {**positions, **self.locked_joints}
        linkage = Linkage.resolve(self.description, locked)
        linkage.warn_of_limits()
        limits = self.motion_limits
        if limits is not None:
            kept_names = {k: k for k in self.joint_names if k not in linkage.locked}
            limits = limits.renamed(kept_names, self.joint_names)
        return self._rebuilt(self._table(linkage), motion_limits=limits)

    def with_payload(self, payload: Payload) -> Robot:
        """Make a robot that carries a body on one of its frames.

        If the SRDF file disables link pairs, contact is also allowed between the
        payload and links on the carrying joint and the joints next to it.

        Raises:
            ProblemError: If another frame has its name.
            FrameNotFound: If the robot lacks the frame that carries it.
        """
        name = instance(payload, Payload, "payload").name
        if name in self.frame_names:
            raise wrong(name, "payload.name", "a name that no frame of the robot has")
        link = self.description.carrying_link(payload.frame)
        if link is None:
            raise FrameNotFound(payload.frame, self.frame_names)
        description = self.description.with_link(payload._link, link, payload)
        srdf = self.srdf
        if srdf is not None and srdf.disabled_pairs:
            near = [ordered_pair(name, other) for other in self._links_beside(link)]
            pairs = tuple(dict.fromkeys([*srdf.disabled_pairs, *near]))
            srdf = replace(srdf, disabled_pairs=pairs)
        return self._described(description, srdf=srdf)

    def _links_beside(self, link: str) -> list[str]:
        """Links with shapes on the joint of a link and on the adjacent joints."""
        model, items = self.model, self.collision_model.geometryObjects
        joint = int(model.frames[model.getBodyId(link)].parentJoint)
        carriers = {joint, *(int(item.parentJoint) for item in items)}
        near = {k for k in carriers if are_neighbours(model, joint, k, carriers)}
        shown = (item for item in items if int(item.parentJoint) in near | {joint})
        return sorted({model.frames[item.parentFrame].name for item in shown})

    @property
    def payloads(self) -> tuple[Payload, ...]:
        """Payloads that :meth:`with_payload` attached, in that order."""
        return self.description.attached

    def _table(self, linkage: Linkage | None = None) -> JointTable:
        """Values of the joints, or of those that are free in another linkage."""
        linkage = linkage or Linkage.resolve(self.description, self.locked_joints)
        limits, names = self.limits, ("position_lower", "position_upper", "velocity")
        effort = np.column_stack([limits.effort_lower, limits.effort_upper])
        columns = {name: getattr(limits, name) for name in names} | {"effort": effort}
        columns |= {loss: getattr(self, loss) for loss in LOSSES}
        rows = [self.joint_names.index(name) for name in linkage.free]
        return JointTable(linkage, {name: x[rows] for name, x in columns.items()})

    def _described(self, description: UrdfDescription, **changes: Any) -> Robot:
        """The robot with another description, in which the same joints move."""
        linkage = Linkage.resolve(description, self.locked_joints)
        return self._rebuilt(self._table(linkage), **changes)

    def _rebuilt(self, table: JointTable, **changes: Any) -> Robot:
        """The robot with fields changed, and the model derived from them again."""
        kept = ("name", "gravity", "srdf", "motion_limits", "kinematic")
        return assembled(table, **{k: getattr(self, k) for k in kept} | changes)

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of the robots that were combined into this one; usually empty."""
        return self.description.parts

    def stack(self, **parts: ArrayLike) -> Array:
        """Concatenate values of the joints of all combined robots, by name: shape (n,).

        Raises:
            ProblemError: If a robot is missing or unknown, or a length is wrong.
        """
        return stack_parts(self.joint_names, self.parts, parts)


def assembled(
    table: JointTable,
    *,
    gravity: Array,
    **values: Any,
) -> Robot:
    """Make a robot with the model derived from its description.

    Args:
        table: Values of the joints that move freely, with their links and joints.
        gravity: Gravity in the world, shape (3,) [m/s^2].
        **values: Further fields of the robot.

    Raises:
        RobotLoadError: If no moving joint remains.
    """
    linkage = table.linkage
    is_identity = linkage.free == tuple(linkage.model.names)[1:]
    matrix, offset = (None, None) if is_identity else linkage.expansion
    values |= {loss: table[loss] for loss in LOSSES}
    return Robot(
        model=configured_model(table, gravity),
        joint_names=linkage.free,
        limits=JointLimits(*table.ends, table["velocity"], *table["effort"].T),
        gravity=gravity,
        expansion_matrix=matrix,
        expansion_offset=offset,
        locked_joints=linkage.locked,
        description=linkage.description,
        **values,
    )


def datasheet_hint(robot: Robot, joint: str) -> str:
    """Hint that a data sheet has the accelerations of a joint; empty otherwise."""
    known_as = robot.description.known_as(robot.name)
    published = published_values(*known_as, needed=False)
    known = joint in published.get("acceleration", {})
    return "; limits='datasheet' has them" if known else ""


# Values of the argument ``limits``.
DATASHEET, URDF = "datasheet", "urdf"


@dataclass(frozen=True)
class RobotSource:
    """Descriptions and values read from the source of a robot.

    Attributes:
        name: Name under which it was asked for; None for a path, a text or an object.
        description: Content of the URDF file, or its equivalent; a path in angle
            brackets stands for a missing file.
        semantics: Content of the SRDF file, if there is one.
        stated: Limits that take precedence over those of the data sheet, by quantity
            and joint name.
    """

    name: str | None
    description: UrdfDescription
    semantics: SemanticDescription | None
    stated: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def known_values(
        self, limits: str | None, joint_names: Sequence[str]
    ) -> dict[str, dict[str, Any]]:
        """Limits and rotor inertias by quantity and joint name, to override the file's.

        In falling priority: stated limits, the maker's data sheet, rotor inertias of
        the SRDF file, and the accelerations and jerks of the description.

        Args:
            limits: "datasheet" to include the data sheet; "urdf" to leave it out; None
                to include it for a robot asked for by name, if it has a data sheet.
            joint_names: Joints that move; values of other joints are left out.

        Raises:
            OptionsError: If the argument has another value, or there is no data sheet.
        """
        expected = f"{DATASHEET!r}, {URDF!r} or None"
        with raised_as(OptionsError):
            choice(limits, (None, DATASHEET, URDF), "limits", expected)
        joints = self.description.joints
        beyond_urdf = {
            quantity: {j.name: getattr(j, quantity, math.inf) for j in joints}
            for quantity in kinds_of(MotionLimits, numbers=True)
        }
        srdf = self.semantics
        rotors = {} if srdf is None else {"armature": srdf.rotor_inertias}
        named = limits is None and self.name is not None
        sheet = {}
        if named or limits == DATASHEET:
            known_as = self.description.known_as(self.name)
            sheet = published_values(*known_as, needed=not named)
        merged: dict[str, dict[str, Any]] = {}
        for level in (beyond_urdf, rotors, sheet, self.stated):
            for quantity, values in level.items():
                moving = {k: v for k, v in values.items() if k in joint_names}
                if moving:
                    merged.setdefault(quantity, {}).update(moving)
        return merged

    def linkage(self, group: Group | None, locked: Mapping[str, float]) -> Linkage:
        """Determine which joints are locked and which follow others.

        Args:
            group: Group of moving joints, as in :func:`load_robot`; None for all
                joints.
            locked: Positions of joints to be locked [rad or m].

        Raises:
            OptionsError: If the group is unknown, or a position is wrong.
            JointNotFound: If a joint is unknown.
        """
        description = self.description
        # The caller's own locks are resolved first, so that errors name them.
        linkage = Linkage.resolve(description, locked)
        if group is None:
            return linkage
        srdf = SemanticDescription() if self.semantics is None else self.semantics
        inside = srdf.joints_of(group, description)
        rest = srdf.rest_positions(description.joints, inside)
        return Linkage.resolve(description, rest | dict(locked))


def read_source(
    source: object,
    package_dirs: Sequence[str | os.PathLike[str]] = (),
    srdf: str | os.PathLike[str] | None = None,
    geometry: object = None,
    xacro_args: Mapping[str, object] | None = None,
) -> RobotSource:
    """Read the source of a robot; a source that was read already is returned as is.

    Args:
        source: The source, in any form that ``load_robot`` accepts.
        package_dirs: Folders in which ``package://`` is resolved.
        srdf: Path or text of an SRDF file.
        geometry: Geometry of a ``pinocchio.Model``, see ``load_robot``.
        xacro_args: Values of the arguments of a xacro file.

    Raises:
        RobotLoadError: If no robot can be read from the source.
        OptionsError: If the file does not take these xacro arguments.
        MissingDependency: If it is a xacro file and the extra is not installed.
    """
    if isinstance(source, RobotSource):
        return source
    folders, args = check_folders(package_dirs), Arguments(xacro_args)
    parts = _pinocchio_parts(source, geometry)
    if geometry is not None and parts is None:
        raise RobotLoadError(
            f"geometry is given with {brief(source)}; it belongs to a pinocchio.Model"
        )
    name: str | None = None
    embedded: SemanticDescription | None = None
    if parts is not None:
        description, embedded = describe_model(*parts, package_dirs=folders)
    elif _is_yourdfpy(source):
        path = Path(f"<yourdfpy.URDF {source.robot.name}>")  # type: ignore[attr-defined]
        description = read_parsed(source, path, folders)
    else:
        files = find_files(source)
        path, text, folders = files.urdf, files.text, (*folders, *files.packages)
        root = expanded_root(path, folders, text, args)
        if root.tag == "mujoco":
            description, embedded = describe_mjcf(path, text, folders)
        else:
            description = read_urdf(path, folders, root)
            description = replace(description, xacro_args=tuple(args.items()))
        name, srdf = files.name, files.srdf if srdf is None else srdf
    check_numbers(description)
    semantics = embedded if srdf is None else read_srdf(srdf, description, args)
    args.check_declared(description.path)
    return RobotSource(name, description, semantics)


def _pinocchio_parts(
    source: object, geometry: object
) -> tuple[pin.Model, pin.GeometryModel | None, pin.GeometryModel | None] | None:
    """Model, collision and visual geometry; None if it is not a Pinocchio model."""
    shapes: list[Any] = []
    if isinstance(source, tuple) and source and isinstance(source[0], pin.Model):
        source, *shapes = source  # as returned by buildModelsFromUrdf
    if isinstance(getattr(source, "model", None), pin.Model):  # a RobotWrapper
        names = ("model", "collision_model", "visual_model")
        source, *shapes = (getattr(source, name, None) for name in names)
    if not isinstance(source, pin.Model):
        return None
    if geometry is not None:
        listed = isinstance(geometry, tuple | list)
        shapes = list(geometry) if listed else [geometry]  # type: ignore[call-overload]
    valid_shapes = all(isinstance(item, pin.GeometryModel | None) for item in shapes)
    if not valid_shapes or len(shapes) > 2:
        raise RobotLoadError(
            f"geometry is {brief(geometry if geometry is not None else shapes)}, "
            "expected a pinocchio.GeometryModel to collide with, or two: to collide "
            "with and to look at"
        )
    collision, visual = [*shapes, None, None][:2]
    return source, collision, visual


def _is_yourdfpy(source: object) -> bool:
    """Whether it is a ``yourdfpy.URDF``; does not import that package."""
    yourdfpy = sys.modules.get("yourdfpy")
    return yourdfpy is not None and isinstance(source, yourdfpy.URDF)


#: A name, a path, a text, a ``pinocchio.Model`` (alone or with geometry), a
#: ``yourdfpy.URDF`` or a module of robot_descriptions.
RobotLike: TypeAlias = (
    "str | bytes | os.PathLike[str] | pin.Model | tuple[Any, ...] | Any"
)

# Standard gravity to two decimals, as in Pinocchio [m/s^2].
DEFAULT_GRAVITY = (0.0, 0.0, -9.81)


def load_robot(
    source: RobotLike,
    *,
    package_dirs: Sequence[str | os.PathLike[str]] = (),
    srdf: str | os.PathLike[str] | None = None,
    geometry: pin.GeometryModel | Sequence[pin.GeometryModel | None] | None = None,
    limits: str | None = None,
    group: Group | None = None,
    locked_joints: Mapping[str, float] | None = None,
    gravity: ArrayLike | None = None,
    damping: JointValues | None = None,
    armature: JointValues | None = None,
    friction: JointValues | None = None,
    effort: JointValues | None = None,
    velocity: JointValues | None = None,
    position_lower: JointValues | None = None,
    position_upper: JointValues | None = None,
    kinematic: bool = False,
    xacro_args: Mapping[str, object] | None = None,
) -> Robot:
    """Load a robot from its file, or from an object of another library.

    Values per joint are one number for all, an array in joint order, or a mapping of
    joint names for some joints; they replace the values of the file.

    Args:
        source: A bundled robot (``"planar3r"``), one of the package example-robot-data
            (``"panda"``, ``"ur5"``), the path or the text of a URDF, xacro or MJCF
            file, which are distinguished by their content (an MJCF file gives joints,
            actuators, shapes and keyframes, which become group states; it has no speed
            limits); a ``pinocchio.Model``, alone, as the tuple that
            ``buildModelsFromUrdf`` returns or as a ``RobotWrapper``; a
            ``yourdfpy.URDF``; a module of the package robot_descriptions or its name
            (``"panda_description"``).
        package_dirs: Folders in which ``package://`` is resolved, in addition to the
            folders above the file and those of ROS.
        srdf: Path or text of a semantic description, which may be a xacro file; by
            default the SRDF file of the same name next to the file or in the folder
            ``../srdf``.
        geometry: Geometry of a ``pinocchio.Model``: a ``GeometryModel`` for collisions,
            or two, for collisions and for pictures. Its collision pairs, unless it has
            no pair or all, select the link pairs to check; its reference configurations
            become group states.
        limits: ``"datasheet"`` for the limits that the maker publishes (accelerations,
            jerks, torque rates, and speeds and torques in place of the file's); the
            arguments below take precedence. See :mod:`tominpmp.datasheets`. ``"urdf"``
            for the limits of the file. The default is the data sheet for a robot given
            by its name, if it has one, otherwise the file.
        group: Moving joints: a group of the SRDF file, as ``"panda_arm"``; or a link,
            for the chain from the base to it; two links, for the chain between them; or
            names of joints. All other joints are locked at their position in
            ``locked_joints``, else in a group state of the file, else at zero. The base
            is fixed.
        locked_joints: Positions [rad or m] of joints to be locked; positions outside
            the joint limits cause a warning. Joints that follow them are locked too.
        gravity: Gravity in the world, shape (3,) [m/s^2]; by default that of the file,
            else 9.81 along -z.
        damping: Viscous friction [N m s/rad or N s/m].
        armature: Rotor inertia seen at the joint [kg m^2 or kg].
        friction: Dry (Coulomb) friction [N m or N].
        effort: Effort limits [N m or N]: x for (-x, x), or pairs (lower, upper); zero
            makes a joint passive.
        velocity: Velocity limits [rad/s or m/s], possibly infinite.
        position_lower: Lower position limits [rad or m], possibly infinite.
        position_upper: Upper position limits [rad or m], possibly infinite.
        kinematic: Whether to leave out the dynamics, which the description may then
            lack: motions have no torques and keep limits of accelerations instead,
            which come from ``MotionLimits`` if the robot lacks them.
        xacro_args: Values of the arguments (``<xacro:arg>``) of a xacro file by name;
            the extra ``xacro`` expands the file. ``$(find NAME)`` is resolved as
            ``package://`` is. A semantic description that is a xacro file takes those
            arguments that it declares.

    Returns:
        The robot.

    Raises:
        RobotLoadError: If the robot is unknown, its files are wrong, a mesh is missing,
            or a joint lacks a limit or inertia that no argument gives.
        OptionsError: If the value of an argument is wrong.
        JointNotFound: If a joint is unknown.
        MissingDependency: If it is a xacro file and the extra is not installed.
    """
    values = {
        "damping": damping,
        "armature": armature,
        "friction": friction,
        "effort": effort,
        "velocity": velocity,
        "position_lower": position_lower,
        "position_upper": position_upper,
    }
    check_kinematic(kinematic, values)
    loaded = read_source(source, package_dirs, srdf, geometry, xacro_args)
    linkage = loaded.linkage(group, {} if locked_joints is None else locked_joints)
    linkage.warn_of_limits()
    known = loaded.known_values(limits, linkage.free)
    overrides = {key: known[key] for key in SHEET_COLUMNS if key in known}
    table = JointTable.from_linkage(linkage).overridden(overrides).overridden(values)
    table = table.without_dynamics() if kinematic else table
    table.check_complete()
    of_torques = [name for name, k in kinds_of(MotionLimits).items() if k.of_torques]
    kept = {k: v for k, v in known.items() if not kinematic or k not in of_torques}
    own_gravity = loaded.description.gravity or DEFAULT_GRAVITY
    robot = assembled(
        table,
        name=loaded.name or loaded.description.name,
        gravity=check_gravity(own_gravity if gravity is None else gravity),
        srdf=loaded.semantics,
        kinematic=kinematic,
        motion_limits=limits_by_joint(kept, linkage.free),
    )
    if not kinematic:
        check_inertia(robot.model, table)
        warn_of_inertia(robot.model, robot.description)
    if loaded.semantics is not None:
        motors = set(robot.joint_names) - set(robot.passive_joints)
        warn_of_passive(loaded.semantics.passive, motors)
    _ = robot.collision_model  # reports unreadable meshes now
    return robot
