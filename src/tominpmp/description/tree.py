"""The kinematic tree of a robot: links with inertia and shapes, and the joints between.

Every source of a robot is converted to such a tree, from which the models of Pinocchio
are built. Payloads, another base and combined robots are changes of the tree. A tree
refers to mesh files by name, so that it is small when passed to other processes.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, NoReturn, TypeAlias

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array, FrozenArray, IntArray, Record, frozen_array
from tominpmp.checks import FARTHEST, HUGE
from tominpmp.exceptions import enumerated, fail_to_load, warn_caller

# Link to which the bases of combined robots are fixed, and link below a robot whose
# base was moved in the world.
WORLD, GROUND = "world", "ground"
# Attributes that contain the sizes of shapes [m], with the number of values in each.
_ROD = {"radius": 1, "length": 1}
SIZES = {"box": {"size": 3}, "cylinder": _ROD, "capsule": _ROD, "sphere": {"radius": 1}}
# Values of joints that are zero for a kinematic robot: viscous friction [N m s/rad or
# N s/m], rotor inertia seen at the joint [kg m^2 or kg], and dry friction [N m or N].
LOSSES = ("damping", "armature", "friction")
# Largest sizes of the numbers of joints, links and shapes [SI units].
LARGEST = dict.fromkeys(("placement", "axis", "com", "sizes", "corners"), FARTHEST)
LARGEST |= {"mass": HUGE, "inertia": HUGE}
# Least thickness of shapes; flat ones get it [m].
MIN_THICKNESS = 1e-6


def _matrix(placement: Any, _: str) -> Array:
    """Read-only matrix of a placement, shape (4, 4)."""
    return frozen_array(getattr(placement, "homogeneous", placement))


# A placement, stored as a matrix; it may be given as a pinocchio.SE3, too.
Placement: TypeAlias = Annotated[Array, _matrix]


@dataclass(frozen=True)
class Mimic:
    """A joint that follows another: q = multiplier * q_leader + offset.

    Attributes:
        leader: Name of the joint that it follows.
        multiplier: Ratio of the two positions.
        offset: Position when the leader is at zero [rad or m].
    """

    leader: str
    multiplier: float
    offset: float


@dataclass(frozen=True, eq=False)
class Shape(Record):
    """A shape of a link.

    Attributes:
        kind: "box", "sphere", "cylinder", "capsule" or "mesh".
        sizes: Edges of a box, the radius of a sphere, radius and length of a cylinder
            or capsule (of its straight part) [m], the scale of a mesh.
        placement: Placement shape_to_link, shape (4, 4).
        file: Path of a mesh file.
        corners: Vertices of a mesh without a file, shape (k, 3) [m].
        faces: Vertex indices of each triangle of it, shape (m, 3).
        colour: Red, green, blue and opacity, from 0 to 1; None for the colours of the
            file.
        texture: Path of a texture file.
    """

    kind: str
    sizes: tuple[float, ...]
    placement: Placement
    file: str = ""
    corners: Array | None = None
    faces: IntArray | None = None
    colour: tuple[float, ...] | None = None
    texture: str = ""


@dataclass(frozen=True, eq=False)
class LinkDescription(Record):
    """A link.

    Attributes:
        name: Name.
        mass: Mass [kg]; None for a link without an ``<inertial>`` element.
        com: Centre of mass, shape (3,) [m].
        inertia: Inertia about the centre of mass in the axes of the link, shape (3, 3)
            [kg m^2].
        collisions: Collision shapes.
        visuals: Visual shapes.
    """

    name: str
    mass: float | None = None
    com: FrozenArray = field(default_factory=lambda: np.zeros(3))
    inertia: FrozenArray = field(default_factory=lambda: np.zeros((3, 3)))
    collisions: tuple[Shape, ...] = ()
    visuals: tuple[Shape, ...] = ()


@dataclass(frozen=True, eq=False)
class JointDescription(Record):
    """A joint of a URDF file; missing limits are NaN, limits of fixed joints zero.

    Attributes:
        name: Name.
        kind: ``"revolute"``, ``"continuous"``, ``"prismatic"`` or ``"fixed"``.
        parent: Name of the link that carries it.
        child: Name of the link that it moves.
        placement: Placement joint_to_parent at zero, shape (4, 4).
        axis: Unit axis in the axes of the joint, shape (3,); zero for a fixed joint.
        lower: Lower position limit [rad or m], infinite if continuous.
        upper: Upper position limit [rad or m].
        velocity: Velocity limit [rad/s or m/s].
        effort: Lower and upper effort limit, shape (2,) [N m or N].
        damping: Viscous friction [N m s/rad or N s/m].
        friction: Dry friction [N m or N].
        mimic: Relation to the joint that it follows, if any.
        acceleration: Largest acceleration, or deceleration [rad/s^2 or m/s^2]; infinite
            without a limit.
        jerk: Largest jerk [rad/s^3 or m/s^3]; infinite without a limit.
        armature: Rotor inertia seen at the joint [kg m^2 or kg].
    """

    name: str
    kind: str
    parent: str
    child: str
    placement: Placement
    axis: FrozenArray = field(default_factory=lambda: np.zeros(3))
    lower: float = 0.0
    upper: float = 0.0
    velocity: float = 0.0
    effort: FrozenArray = field(default_factory=lambda: np.zeros(2))
    damping: float = 0.0
    friction: float = 0.0
    mimic: Mimic | None = None
    acceleration: float = math.inf
    jerk: float = math.inf
    armature: float = 0.0

    @property
    def in_file(self) -> JointDescription:
        """The joint as a URDF file has it: one limit of the effort, and no rotor."""
        effort = np.array([-1.0, 1.0]) * np.abs(self.effort).min()
        return replace(self, effort=effort, armature=0.0)

    def motion(self, position: float) -> pin.SE3:
        """Displacement of the joint frame at a position [rad or m]."""
        displacement = position * self.axis
        if self.kind == "prismatic":
            return pin.SE3(np.eye(3), displacement)
        return pin.SE3(pin.exp3(displacement), np.zeros(3))


@dataclass(frozen=True, eq=False)
class UrdfDescription(Record):
    """Content of a URDF file, or its equivalent for another source.

    Attributes:
        name: Name of the robot.
        bodies: The links.
        tree: All joints, in the order of the file; together with the links a tree.
        gravity: Gravity [m/s^2], if the file sets it.
        path: The file.
        package_dirs: Folders in which ``package://`` is resolved.
        parts: Names of the robots that were combined into it; usually empty.
        attached: Payloads fixed to its links after reading, in that order.
        order: Names of the joints in the order of arrays; empty for the order of
            Pinocchio's model of the description.
        mount: Name of the joint between ground and robot, if it was moved.
        xacro_args: Arguments with which a xacro file was expanded.
    """

    name: str
    bodies: tuple[LinkDescription, ...] = field(repr=False)
    tree: tuple[JointDescription, ...] = field(repr=False)
    gravity: tuple[float, ...] | None
    path: Path
    package_dirs: tuple[Path, ...] = ()
    parts: tuple[str, ...] = ()
    attached: tuple[Any, ...] = ()
    order: tuple[str, ...] = ()
    mount: str = ""
    xacro_args: tuple[tuple[str, object], ...] = ()

    def fail(self, message: str) -> NoReturn:
        """Raise an error about the file.

        Raises:
            RobotLoadError: Always.
        """
        fail_to_load(self.path, message)

    @property
    def links(self) -> tuple[str, ...]:
        """Names of the links."""
        return tuple(link.name for link in self.bodies)

    @cached_property
    def joints(self) -> tuple[JointDescription, ...]:
        """Joints that can move, in the order of the file."""
        return tuple(joint for joint in self.tree if joint.kind != "fixed")

    def known_as(self, name: str | None) -> tuple[list[str], list[str]]:
        """Names by which the data sheet of the robot is found.

        Args:
            name: Name by which the robot was asked for, if there is one.

        Returns:
            This name, the name in the description and that of the file; and the names
            of the joints that can move.
        """
        names = [known for known in (name, self.name, self.path.stem) if known]
        return names, [joint.name for joint in self.joints]

    @property
    def root(self) -> str:
        """The link without a parent joint."""
        carried = {joint.child for joint in self.tree}
        return next(link for link in self.links if link not in carried)

    def joints_above(self, link: str) -> set[str]:
        """Joints from the root to a link, including fixed ones; empty if unknown."""
        above = {joint.child: joint for joint in self.tree}
        chain = set()
        while link in above:
            chain.add(above[link].name)
            link = above[link].parent
        return chain

    def joints_between(self, one: str, other: str) -> set[str]:
        """Joints of the chain between two links, including fixed ones."""
        return self.joints_above(one) ^ self.joints_above(other)

    def carrying_link(self, frame: str) -> str | None:
        """Link with the axes of a frame: the link itself, or the child of a joint."""
        carried = {joint.name: joint.child for joint in self.tree}
        return frame if frame in self.links else carried.get(frame)

    def with_link(
        self, link: LinkDescription, parent: str, attached: object
    ) -> UrdfDescription:
        """Fix another link to a link, as part of an attached object."""
        name = self._free_name(f"{link.name}_joint")
        joint = fixed_joint(name, parent, link.name, pin.SE3.Identity())
        return replace(
            self,
            bodies=(*self.bodies, link),
            tree=(*self.tree, joint),
            attached=(*self.attached, attached),
        )

    def on_base(self, base: pin.SE3) -> UrdfDescription:
        """The same description with its root at another placement in the world.

        Args:
            base: Placement base_to_world of the root, which replaces an earlier one.
        """
        if self.mount:
            at = {self.mount: base}
            tree = [
                replace(j, placement=at.get(j.name, j.placement)) for j in self.tree
            ]
            return replace(self, tree=tuple(tree))
        ground = LinkDescription(fresh_name(GROUND, set(self.links)))
        name = self._free_name(f"{GROUND}_mount")
        mount = fixed_joint(name, ground.name, self.root, base)
        return replace(
            self,
            bodies=(ground, *self.bodies),
            tree=(*self.tree, mount),
            mount=mount.name,
        )

    def _free_name(self, name: str) -> str:
        """A name that no joint has yet."""
        return fresh_name(name, {joint.name for joint in self.tree})


def check_numbers(description: UrdfDescription) -> None:
    """Check that placements, weights and shapes are finite, and lengths not too large.

    Raises:
        RobotLoadError: If not; names the joint, link or shape, and the number.
    """
    places: dict[str, Any] = {f"joint {item.name}": item for item in description.tree}
    for link in description.bodies:
        where = f"link {link.name}"
        places[where] = link
        for kind, shapes in (("collision", link.collisions), ("visual", link.visuals)):
            places |= {f"{where}, {kind} {i}": s for i, s in enumerate(shapes, 1)}
    for where, item in places.items():
        for name, most in LARGEST.items():
            value = getattr(item, name, None)
            values = np.ravel(0.0 if value is None else value)
            wrong = values[~(np.abs(values) <= most)].tolist()
            if wrong:
                description.fail(
                    f"{where}: {name} has the number {wrong[0]}, expected finite "
                    f"numbers of at most {most:g} in size"
                )


def solid(kind: str, sizes: Iterable[float], placement: Placement) -> Shape | None:
    """A primitive shape; None for a point, which cannot collide."""
    lengths = np.array([*sizes], dtype=float)
    if not np.any(lengths):
        return None
    return Shape(kind, tuple(np.maximum(lengths, MIN_THICKNESS).tolist()), placement)


# Remarks about a description, with the places that they concern.
UNREAD = "not read: {}"
EMPTY = "shapes of no size are left out: {}"
UNSEEN = (
    "not shown, as their meshes do not exist: {}; folders that hold packages are given "
    "in package_dirs"
)


# Most places that a warning names, and characters from which it names fewer: shapes
# with their files are longer than joints, and the end of the warning says what to do.
MOST_PLACES, LONG_PLACES = 20, 1500


def warn_of(remarks: Mapping[str, Sequence[str]], path: Path) -> None:
    """Warn of what was corrected, left out or doubted in a file.

    Args:
        remarks: The places that each remark concerns, without which it is not made.
        path: The file.
    """
    for remark, places in remarks.items():
        if places:
            named = enumerated(places, MOST_PLACES)
            if len(named) > LONG_PLACES:
                named = enumerated(places)
            warn_caller(f"{path}: {remark.format(named)}")


def fixed_joint(
    name: str, parent: str, child: str, placement: pin.SE3
) -> JointDescription:
    """A joint that fixes a link to another."""
    return JointDescription(name, "fixed", parent, child, placement)


def fresh_name(name: str, taken: set[str]) -> str:
    """Make a name unique by a number, and add it to the names taken."""
    number, free = 2, name
    while free in taken:
        free, number = f"{name}_{number}", number + 1
    taken.add(free)
    return free


def joined_descriptions(
    parts: Mapping[str, tuple[UrdfDescription, pin.SE3]], order: Sequence[str]
) -> UrdfDescription:
    """Combine several robots in one description, prefixing all names with the part's.

    Args:
        parts: Description and placement base_to_world of each part, by its name.
        order: Names of the joints that are free, with their prefixes.
    """
    bodies, tree = [LinkDescription(WORLD)], []
    for number, (part, (description, base)) in enumerate(parts.items()):
        # Pinocchio sorts the joints of one link by name: the number keeps the order of
        # the parts.
        mount, root = f"mount{number:03d}/{part}", f"{part}/{description.root}"
        tree.append(fixed_joint(mount, WORLD, root, base))
        bodies += [replace(b, name=f"{part}/{b.name}") for b in description.bodies]
        tree += [_renamed(joint, part) for joint in description.tree]
    descriptions = [description for description, _ in parts.values()]
    folders = [folder for one in descriptions for folder in one.package_dirs]
    return UrdfDescription(
        name="+".join(parts),
        bodies=tuple(bodies),
        tree=tuple(tree),
        gravity=None,
        path=descriptions[0].path,
        package_dirs=tuple(dict.fromkeys(folders)),
        parts=tuple(parts),
        order=tuple(order),
    )


def _renamed(joint: JointDescription, part: str) -> JointDescription:
    """A joint with all its names prefixed with the name of a part."""
    mimic = joint.mimic
    ends = ("name", "parent", "child")
    names: dict[str, Any] = {key: f"{part}/{getattr(joint, key)}" for key in ends}
    if mimic is not None:
        mimic = replace(mimic, leader=f"{part}/{mimic.leader}")
    return replace(joint, **names, mimic=mimic)
