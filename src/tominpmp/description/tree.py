"""The kinematic tree of a robot: links with inertia and shapes, and the joints between.

Whatever a robot is loaded from becomes such a tree, and the models of Pinocchio are
built from it. Payloads, robots on another base and several robots in one are other
trees. A tree holds the files of meshes by name, so that it is small in other processes.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array, IntArray, Record, frozen_array
from tominpmp.exceptions import warn_caller

# The link that the bases of several robots are fixed to, and the one that a robot
# stands on that is somewhere else in the world.
WORLD, GROUND = "world", "ground"
# Attributes that give the sizes of shapes [m], and how many numbers each has.
_ROD = {"radius": 1, "length": 1}
SIZES = {"box": {"size": 3}, "cylinder": _ROD, "capsule": _ROD, "sphere": {"radius": 1}}
# Shapes that are flat are taken to be as thick as this [m].
THIN = 1e-6


@dataclass(frozen=True)
class Mimic:
    """A joint that follows another: q = multiplier * q_leader + offset.

    Attributes:
        leader: Name of the joint that is followed.
        multiplier: Ratio of the two positions.
        offset: Position while the leader is at zero [rad or m].
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
        file: File of a mesh.
        corners: Corners of a mesh without a file, shape (k, 3) [m].
        faces: Indices of three corners for each triangle of it, shape (m, 3).
        colour: Red, green, blue and opacity, from 0 to 1; None for those of the file.
        texture: File of a texture.
    """

    kind: str
    sizes: tuple[float, ...]
    placement: Array
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
        inertia: Inertia about it in the axes of the link, shape (3, 3) [kg m^2].
        collisions: Shapes to collide with.
        visuals: Shapes to look at.
    """

    name: str
    mass: float | None = None
    com: Array = field(default_factory=lambda: frozen_array(np.zeros(3)))
    inertia: Array = field(default_factory=lambda: frozen_array(np.zeros((3, 3))))
    collisions: tuple[Shape, ...] = ()
    visuals: tuple[Shape, ...] = ()


@dataclass(frozen=True, eq=False)
class JointDescription(Record):
    """A joint, as the URDF file has it; a limit not given is NaN, of a fixed one zero.

    Attributes:
        name: Name.
        kind: ``"revolute"``, ``"continuous"``, ``"prismatic"`` or ``"fixed"``.
        parent: Name of the link that it is on.
        child: Name of the link that it carries.
        placement: Placement joint_to_parent at zero, shape (4, 4).
        axis: Unit axis in the axes of the joint, shape (3,); zero if it is fixed.
        lower: Lower position limit [rad or m], infinite if continuous.
        upper: Upper position limit [rad or m].
        velocity: Velocity limit [rad/s or m/s].
        effort: Effort limit [N m or N].
        damping: Viscous friction [N m s/rad or N s/m].
        friction: Dry friction [N m or N].
        mimic: The joint that it follows, if it does.
        acceleration: Largest acceleration, or deceleration [rad/s^2 or m/s^2]; infinite
            if none is given.
        jerk: Largest jerk [rad/s^3 or m/s^3]; infinite if none is given.
        armature: Rotor inertia seen at the joint [kg m^2 or kg].
    """

    name: str
    kind: str
    parent: str
    child: str
    placement: Array
    axis: Array = field(default_factory=lambda: frozen_array(np.zeros(3)))
    lower: float = 0.0
    upper: float = 0.0
    velocity: float = 0.0
    effort: float = 0.0
    damping: float = 0.0
    friction: float = 0.0
    mimic: Mimic | None = None
    acceleration: float = math.inf
    jerk: float = math.inf
    armature: float = 0.0

    def motion(self, position: float) -> pin.SE3:
        """What it adds to its placement at a position [rad or m]."""
        way = position * self.axis
        if self.kind == "prismatic":
            return pin.SE3(np.eye(3), way)
        return pin.SE3(pin.exp3(way), np.zeros(3))


@dataclass(frozen=True, eq=False)
class UrdfDescription(Record):
    """What a URDF file says of a robot, or would say of it.

    Attributes:
        name: Name of the robot.
        bodies: The links.
        tree: All joints, in the order of the file; with the links they are one tree.
        gravity: Gravity [m/s^2], if the file gives one.
        path: The file.
        package_dirs: Folders given for ``package://``.
        parts: Names of the robots that it was put together from; mostly none.
        attached: What was fixed to its links after it was read, in that order.
        order: Names of the joints in the order that arrays have; empty for that of
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

    @property
    def links(self) -> tuple[str, ...]:
        """Names of the links."""
        return tuple(link.name for link in self.bodies)

    @cached_property
    def joints(self) -> tuple[JointDescription, ...]:
        """Joints that can move, in the order of the file."""
        return tuple(joint for joint in self.tree if joint.kind != "fixed")

    @property
    def root(self) -> str:
        """The link without a parent."""
        carried = {joint.child for joint in self.tree}
        return next(link for link in self.links if link not in carried)

    def joints_above(self, link: str) -> set[str]:
        """Joints from the root to a link, fixed ones too; none if it is unknown."""
        above = {joint.child: joint for joint in self.tree}
        found = set()
        while link in above:
            found.add(above[link].name)
            link = above[link].parent
        return found

    def joints_between(self, one: str, other: str) -> set[str]:
        """Joints of the chain from a link to another, fixed ones too."""
        return self.joints_above(one) ^ self.joints_above(other)

    def carrying_link(self, frame: str) -> str | None:
        """Link whose axes a frame has: that of its name, or the child of that joint."""
        if frame in self.links:
            return frame
        carried = (joint.child for joint in self.tree if joint.name == frame)
        return next(carried, None)

    def with_link(
        self, link: LinkDescription, parent: str, attached: object
    ) -> UrdfDescription:
        """Fix one more link to a link, which is part of what was attached."""
        name = self._free_name(f"{link.name}_joint")
        joint = fixed_joint(name, parent, link.name, pin.SE3.Identity())
        return replace(
            self,
            bodies=(*self.bodies, link),
            tree=(*self.tree, joint),
            attached=(*self.attached, attached),
        )

    def on_base(self, base: pin.SE3) -> UrdfDescription:
        """The same description with its root somewhere else in the world.

        Args:
            base: Placement base_to_world of its root, also if it was moved before.
        """
        if self.mount:
            placement = frozen_array(base.homogeneous)
            moved = (
                replace(joint, placement=placement)
                if joint.name == self.mount
                else joint
                for joint in self.tree
            )
            return replace(self, tree=tuple(moved))
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
        """A name that no joint has."""
        return fresh_name(name, {joint.name for joint in self.tree})


def solid(kind: str, sizes: Iterable[float], placement: Array) -> Shape | None:
    """A shape that is no mesh; None for a point, which collides with nothing."""
    lengths = np.array([*sizes], dtype=float)
    if not np.any(lengths):
        return None
    return Shape(kind, tuple(np.maximum(lengths, THIN).tolist()), placement)


def warn_of_points(places: Sequence[str], path: Path) -> None:
    """Warn of shapes that were left out because all their sizes are zero."""
    if places:
        warn_caller(f"{path}: shapes of no size are left out: {first_of(places)}")


def warn_of_unseen(places: Sequence[str], path: Path) -> None:
    """Warn of shapes to look at that were left out as their meshes are not there."""
    if places:
        warn_caller(
            f"{path}: not shown, as their meshes are not there: {first_of(places)}; "
            "folders that hold packages are given in package_dirs"
        )


def first_of(places: Sequence[str]) -> str:
    """The first of some places, and how many more there are."""
    others = len(places) - 1
    return f"{places[0]} and {others} more" if others else places[0]


def fixed_joint(
    name: str, parent: str, child: str, placement: pin.SE3
) -> JointDescription:
    """A joint that fixes a link to another."""
    matrix = frozen_array(placement.homogeneous)
    return JointDescription(name, "fixed", parent, child, matrix)


def fresh_name(name: str, taken: set[str]) -> str:
    """A name that is not taken yet, and takes it."""
    number, found = 2, name
    while found in taken:
        found, number = f"{name}_{number}", number + 1
    taken.add(found)
    return found


def joined(
    parts: Mapping[str, tuple[UrdfDescription, pin.SE3]],
    orders: Mapping[str, Sequence[str]],
) -> UrdfDescription:
    """Several robots in one description, with the part before every name.

    Args:
        parts: Description and placement base_to_world of each part by its name.
        orders: Names of the joints of the model of each part.
    """
    bodies, tree = [LinkDescription(WORLD)], []
    for number, (part, (description, base)) in enumerate(parts.items()):
        # Models have joints of one link in the order of their names: the number keeps
        # that of the parts.
        mount, root = f"mount{number:03d}/{part}", f"{part}/{description.root}"
        tree.append(fixed_joint(mount, WORLD, root, base))
        bodies += [replace(b, name=f"{part}/{b.name}") for b in description.bodies]
        tree += [_renamed(joint, part) for joint in description.tree]
    descriptions = [description for description, _ in parts.values()]
    folders = [folder for one in descriptions for folder in one.package_dirs]
    order = (
        f"{part}/{joint}"
        for part, (description, _) in parts.items()
        for joint in description.order or orders[part]
    )
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
    """A joint with the name of a part before all names in it."""
    mimic = joint.mimic
    if mimic is not None:
        mimic = replace(mimic, leader=f"{part}/{mimic.leader}")
    return replace(
        joint,
        name=f"{part}/{joint.name}",
        parent=f"{part}/{joint.parent}",
        child=f"{part}/{joint.child}",
        mimic=mimic,
    )
