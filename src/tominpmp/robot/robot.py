"""Robot arms: model, limits, friction and geometry, and loading them.

Beside a name or the path of a URDF file a robot is loaded from a text that is one, a
``yourdfpy.URDF``, a ``pinocchio.Model`` with or without geometry (also as Pinocchio and
example-robot-data return them), and the modules of the package robot_descriptions, or
their names.
"""

from __future__ import annotations

import importlib
import math
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from tominpmp.arrays import Array, Record, comparable, frozen_array
from tominpmp.checks import JOINTS, array, choice, instance, names
from tominpmp.datasheets import OVERRIDES, published_values
from tominpmp.description.files import (
    RobotFiles,
    check_folders,
    find_robot,
    find_srdf,
    robot_names,
)
from tominpmp.description.formats import read_description
from tominpmp.description.from_pinocchio import describe_model
from tominpmp.description.inertials import check_inertia, warn_of_inertia
from tominpmp.description.joint_table import (
    LOSSES,
    ROW,
    JointLimits,
    JointTable,
    JointValues,
    Linkage,
    check_gravity,
    check_kinematic,
    stack_parts,
)
from tominpmp.description.model import (
    build_geometry,
    build_model,
    configured_model,
    expansion,
    sticks,
)
from tominpmp.description.srdf import (
    Group,
    SemanticDescription,
    group_locks,
    read_semantics,
    warn_of_passive,
)
from tominpmp.description.tree import UrdfDescription
from tominpmp.description.urdf import read_parsed
from tominpmp.description.xml_reader import given_text
from tominpmp.exceptions import (
    FrameNotFound,
    OptionsError,
    ProblemError,
    RobotLoadError,
    brief,
    closest,
)
from tominpmp.motion_limits import MotionLimits, kinds_of, limits_by_joint
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
        kinematic: Whether nothing is known of its dynamics: its motions keep limits of
            positions, speeds, accelerations and jerks, and have no torques. Its limits
            of torques are infinite, its friction and rotor inertia zero.
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
        kind = "Kinematic robot" if self.kinematic else "Robot"
        return f"<{kind} {brief(self.name)} with {self.n} joints: {joints}>"

    def _repr_html_(self) -> str:
        """A stick figure and the limits, for notebooks."""
        low, high = self.limits.position_lower, self.limits.position_upper
        arm = sticks(self.model, self.expand(np.clip(np.zeros(self.n), low, high)))
        columns = {"lower": low, "upper": high, "velocity": self.limits.velocity}
        if not self.kinematic:
            columns["effort"] = self.limits.effort_upper
        values = (column.tolist() for column in columns.values())
        rows = list(zip(self.joint_names, *values, strict=True))
        picture = skeletons("at zero", {"robot": arm})
        return card(f"Robot {self.name}", picture, table(("joint", *columns), rows))

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
        """Indices of the frames by name, without that of the world."""
        found: dict[str, int] = {}
        for index, frame in enumerate(self.model.frames[1:], 1):
            if frame.type == pin.FrameType.BODY or frame.name not in found:
                found[frame.name] = index
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
        table = self._table().overridden(self._linkage().reasons(), values)
        changed = check_gravity(self.gravity if gravity is None else gravity)
        robot = self._rebuilt(table=table, gravity=changed)
        robot._check_inertia()
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
        linkage = Linkage.resolve(joints, {**positions, **self.locked_joints})
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
        limits, rows = self.limits, np.zeros(self.n, dtype=ROW)
        for name in ("position_lower", "position_upper", "velocity"):
            rows[name] = getattr(limits, name)
        rows["effort"] = np.column_stack([limits.effort_lower, limits.effort_upper])
        for name in LOSSES:
            rows[name] = getattr(self, name)
        return JointTable(self.joint_names, rows)

    def _check_inertia(self) -> None:
        """Check that no joint moves without inertia, unless the robot has no torques.

        Raises:
            RobotLoadError: If one does.
        """
        if not self.kinematic:
            ties = self.expansion_matrix, self.expansion_offset
            check_inertia(self.model, self._table(), *ties, self.description)

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
        kept = ("name", "description", "gravity", "srdf", "motion_limits", "kinematic")
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
        limits=JointLimits(*joints.ends, joints["velocity"], *joints["effort"].T),
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


def datasheet_hint(robot: Robot, joint: str) -> str:
    """Says that a data sheet has accelerations of a joint; empty if none has."""
    joints = [joint.name for joint in robot.description.joints]
    names = robot.name, robot.description.name, robot.description.path.stem
    published = published_values(names, joints, needed=False)
    known = joint in published.get("acceleration", {})
    return "; limits='datasheet' has them" if known else ""


# What the argument ``limits`` may be.
DATASHEET, URDF = "datasheet", "urdf"
# How names in the package robot_descriptions end.
MODULE_ENDING = "_description"
EXPECTED = (
    "the name of a robot, the path or the text of a URDF file, a pinocchio.Model, a "
    "yourdfpy.URDF or a module of robot_descriptions"
)


@dataclass(frozen=True)
class RobotSource:
    """What was given for a robot, read.

    Attributes:
        files: The files; names in angle brackets where there are none.
        description: What a URDF file says.
        semantics: What an SRDF file says, if there is one.
        values: Values by argument of ``load_robot`` and joint name that neither says.
        stated: Limits by quantity and joint name that go before all of these.
    """

    files: RobotFiles
    description: UrdfDescription
    semantics: SemanticDescription | None
    values: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    stated: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    @property
    def names(self) -> tuple[str | None, ...]:
        """Names of the robot: asked for, in its description, of the file."""
        return self.files.name, self.description.name, self.files.urdf.stem

    def known_values(self, limits: str | None) -> dict[str, dict[str, Any]]:
        """Limits and rotor inertias by quantity and joint name, beside the URDF file's.

        They are stated, else those of the maker's data sheet, else what no URDF file
        says, or what only motion limits have: accelerations and jerks.

        Args:
            limits: "datasheet" for those of the data sheet, too; "urdf" for those of
                the file; None for the former of a robot asked for by name, if there is
                a sheet of it.

        Raises:
            OptionsError: If limits are none of these, or there is no sheet.
        """
        expected = f"{DATASHEET!r}, {URDF!r} or None"
        choice(limits, (None, DATASHEET, URDF), "limits", expected, OptionsError)
        joints = self.description.joints
        described = {
            quantity: {j.name: getattr(j, quantity, math.inf) for j in joints}
            for quantity in kinds_of(MotionLimits, numbers=True)
        }
        said = self.semantics
        rotors = {} if said is None else {"armature": said.rotor_inertias}
        moving = [joint.name for joint in joints]
        named = limits is None and self.files.name is not None
        sheet = {}
        if named or limits == DATASHEET:
            sheet = published_values(self.names, moving, needed=not named)
        found: dict[str, dict[str, Any]] = {}
        for level in (described, rotors, self.values, sheet, self.stated):
            for quantity, values in level.items():
                found.setdefault(quantity, {}).update(values)
        return found

    def linkage(
        self, group: Group | None, locked_joints: Mapping[str, float] | None
    ) -> Linkage:
        """Find which joints are locked and which follow others.

        Args:
            group: Group of joints that move, as to :func:`load_robot`; None for all.
            locked_joints: Positions of joints that are not to move [rad or m].

        Raises:
            OptionsError: If there is no such group, or a position is wrong.
            JointNotFound: If a joint is unknown.
        """
        joints = self.description.joints
        locked_joints = {} if locked_joints is None else locked_joints
        # First what the caller gave, with its errors.
        linkage = Linkage.resolve(joints, locked_joints)
        if group is None:
            return linkage
        locks = group_locks(self.semantics, self.description, group, locked_joints)
        return Linkage.resolve(joints, locks)


def read_source(
    source: object,
    package_dirs: Sequence[str | os.PathLike[str]] = (),
    srdf: str | os.PathLike[str] | None = None,
    geometry: object = None,
    xacro_args: Mapping[str, object] | None = None,
) -> RobotSource:
    """Read what was given for a robot; what was read already is taken as it is.

    Args:
        source: What ``load_robot`` takes.
        package_dirs: Folders in which to look for ``package://``.
        srdf: Path or text of an SRDF file.
        geometry: Geometry of a ``pinocchio.Model``, see ``load_robot``.
        xacro_args: Values of the arguments of a xacro file.

    Raises:
        RobotLoadError: If it is nothing that a robot can be read from.
        OptionsError: If it has no such arguments.
    """
    if isinstance(source, RobotSource):
        return source
    folders = check_folders(package_dirs)
    parts = _pinocchio_parts(source, geometry)
    if geometry is not None and parts is None:
        raise RobotLoadError(
            f"geometry is given beside {brief(source)}; it belongs to a pinocchio.Model"
        )
    own: SemanticDescription | None = None
    effort: Mapping[str, Any] = {}
    if parts is not None:
        description, own, effort = describe_model(*parts, package_dirs=folders)
        files = RobotFiles(description.path, None)
    elif _is_yourdfpy(source):
        files = RobotFiles(Path(f"<yourdfpy.URDF {source.robot.name}>"), None)  # type: ignore[attr-defined]
        description = read_parsed(source, files.urdf, folders)
    else:
        text = given_text(source)
        if text is not None:
            files = RobotFiles(Path(f"<text of {len(text)} bytes>"), None)
        else:
            files, more = _find(source)
            folders = (*folders, *more)
        description, own, effort = read_description(
            files.urdf, folders, text, xacro_args
        )
    said = read_semantics(files.srdf if srdf is None else srdf, description)
    return RobotSource(files, description, said or own, {"effort": effort})


def _pinocchio_parts(
    source: object, geometry: object
) -> tuple[pin.Model, pin.GeometryModel | None, pin.GeometryModel | None] | None:
    """Model, collision and visual geometry; None if it is no model of Pinocchio."""
    shapes: list[Any] = []
    if isinstance(source, tuple) and source and isinstance(source[0], pin.Model):
        source, *shapes = source  # as buildModelsFromUrdf returns them
    wrapped = getattr(source, "model", None)
    if isinstance(wrapped, pin.Model):  # a RobotWrapper, as of example_robot_data
        names = ("collision_model", "visual_model")
        shapes = [getattr(source, name, None) for name in names]
        source = wrapped
    if not isinstance(source, pin.Model):
        return None
    if geometry is not None:
        listed = isinstance(geometry, tuple | list)
        shapes = list(geometry) if listed else [geometry]  # type: ignore[call-overload]
    known = all(isinstance(item, pin.GeometryModel | None) for item in shapes)
    if not known or len(shapes) > 2:
        raise RobotLoadError(
            f"geometry is {brief(geometry if geometry is not None else shapes)}, "
            "expected a pinocchio.GeometryModel to collide with, or two: to collide "
            "with and to look at"
        )
    collision, visual = [*shapes, None, None][:2]
    return source, collision, visual


# What a module of robot_descriptions may have; the first there is is read.
_PATHS = ("URDF_PATH", "XACRO_PATH", "MJCF_PATH")


def _is_yourdfpy(source: object) -> bool:
    """Whether it is a ``yourdfpy.URDF``, without importing that."""
    known = sys.modules.get("yourdfpy")
    return known is not None and isinstance(source, known.URDF)


def _find(source: object) -> tuple[RobotFiles, tuple[Path, ...]]:
    """Files of a robot by name, path or module, and folders of its packages."""
    if isinstance(source, str | os.PathLike):
        name = str(source)
        module = name.isidentifier() and name.endswith(MODULE_ENDING)
        if module and name not in robot_names():
            return _of_module(_imported(name), name)
        return find_robot(source), ()
    name = str(getattr(source, "__name__", ""))
    if not name.startswith("robot_descriptions") and not _paths(source, _PATHS):
        raise RobotLoadError(f"the robot is {brief(source)}, expected {EXPECTED}")
    return _of_module(source, name)


def _imported(name: str) -> Any:
    """Import a module of robot_descriptions, which may fetch files at that."""
    try:
        importlib.import_module("robot_descriptions")
    except ImportError as error:
        raise RobotLoadError(
            f"there is no robot {brief(name)}; names that end with {MODULE_ENDING!r} "
            "are those of the package robot_descriptions: python -m pip install "
            "robot_descriptions"
        ) from error
    try:
        return importlib.import_module(f"robot_descriptions.{name}")
    except ModuleNotFoundError as error:
        raise RobotLoadError(
            f"the package robot_descriptions has no module {brief(name)}"
            f"{closest(name, _module_names())}"
        ) from error
    except Exception as error:  # whatever fetching files may raise
        raise RobotLoadError(
            f"robot_descriptions.{name} cannot be had: {brief(str(error), 200)}"
        ) from error


def _module_names() -> list[str]:
    try:
        listed = importlib.import_module("robot_descriptions._descriptions")
        return list(listed.DESCRIPTIONS)
    except (ImportError, AttributeError, TypeError):
        return []


def _of_module(module: Any, name: str) -> tuple[RobotFiles, tuple[Path, ...]]:
    paths = _paths(module, _PATHS)
    if not paths:
        raise RobotLoadError(
            f"the module {brief(name)} has none of the files {', '.join(_PATHS)}"
        )
    folders = _paths(module, ("PACKAGE_PATH", "REPOSITORY_PATH"))
    around = {p for folder in folders for p in (folder, folder.parent) if p.is_dir()}
    named = name.rpartition(".")[2] or None
    return RobotFiles(paths[0], find_srdf(paths[0]), named), tuple(sorted(around))


def _paths(module: object, names: Sequence[str]) -> list[Path]:
    """Those of some attributes of a module that are paths."""
    found = [getattr(module, name, None) for name in names]
    return [Path(p).absolute() for p in found if isinstance(p, str | os.PathLike)]


#: A name, a path, a text, a ``pinocchio.Model`` (alone or with geometry), a
#: ``yourdfpy.URDF`` or a module of robot_descriptions.
RobotLike: TypeAlias = (
    "str | bytes | os.PathLike[str] | pin.Model | tuple[Any, ...] | Any"
)

# Standard gravity in two decimals, as Pinocchio has it [m/s^2].
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
    """Load a robot from its file, or from what another library made of it.

    Values per joint are one number for all, an array in joint order, or a mapping of
    joint names for some; they replace what the file says.

    Args:
        source: A bundled robot (``"planar3r"``), one of the package example-robot-data
            (``"panda"``, ``"ur5"``), the path or the text of a URDF, xacro or MJCF
            file, told apart by what is in it (of an MJCF file the joints, actuators,
            shapes and keyframes, which are group states; it has no limits of speed); a
            ``pinocchio.Model``, alone, as the tuple that ``buildModelsFromUrdf``
            returns or as a ``RobotWrapper``; a ``yourdfpy.URDF``; a module of the
            package robot_descriptions or its name (``"panda_description"``).
        package_dirs: Folders in which to look for ``package://``; those above the file
            and of ROS are looked through anyway.
        srdf: Path or text of a semantic description; by default the one that lies
            beside the file or in the folder ``../srdf`` and has its name.
        geometry: Of a ``pinocchio.Model``: a ``GeometryModel`` to collide with, or two
            of them, to collide with and to look at. Its collision pairs, unless they
            are none or all, say which links are watched against each other; its
            reference configurations are group states.
        limits: ``"datasheet"`` for those that the maker publishes (accelerations,
            jerks, torque rates, and speeds and torques instead of the file's); the
            arguments below go before them. See :mod:`tominpmp.datasheets`. ``"urdf"``
            for those of the file. By default those of the data sheet for a robot given
            by its name, if there is one of it, else those of the file.
        group: Group of the SRDF file, as ``"panda_arm"``, whose joints move; or a
            link, for the chain from the base to it; two links, for the chain from one
            to the other; or names of joints. The others are locked: where
            ``locked_joints`` has them, else where a group state of the file has them,
            else at zero. The base stands still.
        locked_joints: Positions [rad or m] of joints that are not to move; outside
            their limits they cause a warning. Joints that follow them are locked too.
        gravity: Gravity in the world, shape (3,) [m/s^2]; by default what the file
            says, else 9.81 along -z.
        damping: Viscous friction [N m s/rad or N s/m].
        armature: Rotor inertia seen at the joint [kg m^2 or kg].
        friction: Dry (Coulomb) friction [N m or N].
        effort: Effort limits [N m or N]: x for (-x, x), or pairs (lower, upper); zero
            makes a joint passive.
        velocity: Velocity limits [rad/s or m/s], possibly infinite.
        position_lower: Lower position limits [rad or m], possibly infinite.
        position_upper: Upper position limits [rad or m], possibly infinite.
        kinematic: Whether to leave out the dynamics, of which the description need say
            nothing then: motions have no torques and keep limits of accelerations
            instead, which ``MotionLimits`` have where the robot has none.
        xacro_args: Values of the arguments (``<xacro:arg>``) of a xacro file by name,
            which the extra ``xacro`` expands. ``$(find NAME)`` is looked for where
            ``package://`` is.

    Returns:
        The robot.

    Raises:
        RobotLoadError: If there is no such robot, its files are wrong or a mesh is not
            there, or a joint lacks a limit or inertia that no argument gives.
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
    given = read_source(source, package_dirs, srdf, geometry, xacro_args)
    linkage = given.linkage(group, locked_joints)
    linkage.warn_of_limits(given.description.joints)
    known, reasons = given.known_values(limits), linkage.reasons()

    def table_for(joint_names: tuple[str, ...]) -> JointTable:
        table = JointTable.from_description(
            joint_names, given.description.joints, linkage
        )
        own = {
            key: {k: v for k, v in known[key].items() if k in joint_names}
            for key in OVERRIDES
            if key in known
        }
        table = table.overridden(reasons, own).overridden(reasons, values)
        table = table.without_dynamics() if kinematic else table
        table.check_complete(given.files.urdf)
        return table

    own = given.description.gravity or DEFAULT_GRAVITY
    robot = assembled(
        name=given.files.name or given.description.name,
        description=given.description,
        linkage=linkage,
        table_for=table_for,
        gravity=check_gravity(own if gravity is None else gravity),
        srdf=given.semantics,
        kinematic=kinematic,
    )
    if kinematic:
        for name, kind in kinds_of(MotionLimits).items():
            if kind.of_torques:
                known.pop(name, None)
    robot = replace(robot, motion_limits=limits_by_joint(known, robot.joint_names))
    robot._check_inertia()
    if not kinematic:
        warn_of_inertia(robot.model, given.description)
    if given.semantics is not None:
        motors = set(robot.joint_names) - set(robot.passive_joints)
        warn_of_passive(given.semantics.passive, motors)
    _ = robot.collision_model  # a mesh that cannot be read is an error now
    return robot
