"""Models of Pinocchio, written as the description that a URDF file would give.

All that follows (locked joints, payloads, several robots in one, copies in other
processes) knows descriptions only. Placements, inertias and limits are those of the
model to rounding; the order of its joints is kept.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement, tostring

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array
from tominpmp.description.geometry_shapes import add_shapes
from tominpmp.description.srdf import SemanticDescription
from tominpmp.description.urdf import JointDescription, Mimic, UrdfDescription
from tominpmp.description.urdf_syntax import (
    fresh_name,
    write_inertia,
    write_numbers,
    write_origin,
)
from tominpmp.description.xml_reader import MAX_NUMBER
from tominpmp.exceptions import RobotLoadError, brief

# Two placements that differ by less are one [m, rad].
SAME = 1e-12


@dataclass(frozen=True)
class DescribedModel:
    """What a model of Pinocchio says.

    Attributes:
        description: The model as a description.
        semantics: Pairs of links that its collision geometry leaves out, and its
            reference configurations, if it has any of them.
        effort: Lower and upper effort limits [N m or N] by joint name, of joints where
            they are not opposite.
    """

    description: UrdfDescription
    semantics: SemanticDescription | None
    effort: dict[str, tuple[float, float]] = field(default_factory=dict)


def describe_model(
    model: pin.Model,
    collision: pin.GeometryModel | None = None,
    visual: pin.GeometryModel | None = None,
    package_dirs: Sequence[Path] = (),
) -> DescribedModel:
    """Describe a model of Pinocchio, with its geometry if it has any.

    Args:
        model: Kinematics and inertia; joints of one degree of freedom only.
        collision: Shapes to collide with.
        visual: Shapes to look at.
        package_dirs: Folders given for packages, which are kept.

    Raises:
        RobotLoadError: If a joint has several degrees of freedom or turns and slides,
            or a shape is none that a link can have.
    """
    path = Path(f"<pinocchio.Model {model.name}>")
    writer = _Writer(model, path)
    root = writer.robot()
    meshes: dict[str, bytes] = {}
    for geometry, tag in ((collision, "collision"), (visual, "visual")):
        if geometry is not None:
            meshes |= add_shapes(root, tag, geometry, writer.placed, path)
    gravity = tuple(np.asarray(model.gravity.linear).tolist())
    description = UrdfDescription(
        name=model.name or "robot",
        xml=tostring(root, encoding="unicode"),
        links=tuple(link.get("name", "") for link in root.iter("link")),
        joints=tuple(writer.joints),
        gravity=gravity,
        path=path,
        package_dirs=tuple(package_dirs),
        order=tuple(joint.name for joint in writer.joints),
        meshes=tuple(meshes.items()),
    )
    return DescribedModel(
        description, _semantics(writer, collision, path), _uneven_efforts(writer)
    )


class _Writer:
    """Writes the links and joints of a model as elements of a URDF file."""

    def __init__(self, model: pin.Model, path: Path) -> None:
        self.model, self.path = model, path
        self.data = model.createData()
        self.q = pin.neutral(model)
        pin.forwardKinematics(model, self.data, self.q)
        self.joints = [self._describe(j) for j in range(1, model.njoints)]
        self._joint_names = set(model.names)
        self._links: set[str] = set()
        #: Link of each frame, by its index.
        self.link_of: dict[int, str] = {}
        self.main = [self._main_link(j) for j in range(model.njoints)]

    def _fail(self, message: str) -> None:
        raise RobotLoadError(f"{self.path}: {message}", self.path)

    # -- joints ------------------------------------------------------------------------

    def _describe(self, index: int) -> JointDescription:
        """Kind, limits and losses of a joint."""
        model, joint = self.model, self.model.joints[index]
        name = str(model.names[index])
        self._axis(index)
        if joint.nv == 0:
            leader, ratio, offset = self._mimic(index)
            kind = self._kind(index)
            nothing = (-math.inf, math.inf, math.inf, math.nan, 0.0, 0.0)
            return JointDescription(name, kind, *nothing, Mimic(leader, ratio, offset))
        v = joint.idx_v
        # On two numbers, cosine and sine, it turns without end.
        bounded = joint.nq == 1
        lower = _limit(model.lowerPositionLimit[joint.idx_q]) if bounded else -math.inf
        upper = _limit(model.upperPositionLimit[joint.idx_q]) if bounded else math.inf
        return JointDescription(
            name,
            self._kind(index) if bounded else "continuous",
            lower,
            upper,
            _limit(model.velocityLimit[v]),
            _limit(min(abs(model.lowerEffortLimit[v]), abs(model.upperEffortLimit[v]))),
            float(model.damping[v]),
            float(model.friction[v]),
            None,
            armature=float(model.armature[v]),
        )

    def _kind(self, index: int) -> str:
        turns = np.any(np.asarray(self.data.joints[index].S).reshape(6, -1)[3:, 0])
        return "revolute" if turns else "prismatic"

    def _axis(self, index: int) -> Array:
        """Unit axis of a joint, in the axes of the joint, shape (3,)."""
        motion = np.asarray(self.data.joints[index].S).reshape(6, -1)
        kind = str(self.model.joints[index].shortname())
        one = motion.shape[1] == 1 and np.any(motion)
        if not one or (np.any(motion[:3]) and np.any(motion[3:])):
            self._fail(
                f"joint {brief(str(self.model.names[index]))} is a {kind}; only "
                "joints that turn about one axis or slide along one can be planned for"
                "; give a model with it locked (pinocchio.buildReducedModel)"
            )
        axis = motion[:3, 0] + motion[3:, 0]
        return np.asarray(axis / np.linalg.norm(axis))

    def _mimic(self, index: int) -> tuple[str, float, float]:
        """Leader, ratio and offset of a joint that follows another."""
        place = list(self.model.mimicking_joints).index(index)
        leader = str(self.model.names[self.model.mimicked_joints[place]])
        # What moves it is scaled by the ratio already, as it stands at the offset.
        ratio = float(np.linalg.norm(np.asarray(self.data.joints[index].S)))
        moved = pin.log6(self.data.joints[index].M)
        travel = moved.angular if self._kind(index) == "revolute" else moved.linear
        return leader, ratio, float(np.asarray(travel) @ self._axis(index))

    # -- links -------------------------------------------------------------------------

    def _main_link(self, joint: int) -> str:
        """Name of the link that a joint moves: its body's, or one like the joint's."""
        for index, frame in enumerate(self.model.frames):
            body = frame.type == pin.FrameType.BODY and frame.parentJoint == joint
            if body and frame.placement.isIdentity(SAME):
                self.link_of[index] = self._link_name(frame.name)
                return self.link_of[index]
        own = f"{self.model.names[joint]}_link" if joint else "world"
        return self._link_name(own)

    def _link_name(self, name: str) -> str:
        return fresh_name(name, self._links)

    def robot(self) -> Element:
        """The robot element, with links, joints and frames, without shapes."""
        root = Element("robot", name=self.model.name or "robot")
        for joint, name in enumerate(self.main):
            link = SubElement(root, "link", name=name)
            if joint:
                _inertial(link, self.model.inertias[joint])
        for joint in range(1, self.model.njoints):
            self._add_joint(root, joint)
        self._add_frames(root)
        return root

    def _add_joint(self, root: Element, index: int) -> None:
        described = self.joints[index - 1]
        kind = "revolute" if described.kind == "continuous" else described.kind
        element = SubElement(root, "joint", name=described.name, type=kind)
        parent = self.main[self.model.parents[index]]
        _fix(element, parent, self.main[index], self.model.jointPlacements[index])
        axis = SubElement(element, "axis")
        write_numbers(axis, "xyz", self._axis(index).tolist())
        # Placeholders: who reads this takes the limits from the descriptions.
        SubElement(element, "limit", effort="1", velocity="1", lower="-1", upper="1")

    def _add_frames(self, root: Element) -> None:
        """Add a link for every further frame, fixed to the one of its joint."""
        frames = self.model.frames
        kinds = pin.FrameType
        carried = {
            int(frame.parentFrame): index
            for index, frame in enumerate(frames)
            if frame.type == kinds.BODY and index not in self.link_of
        }
        for index, frame in enumerate(frames):
            skip = index == 0 or index in self.link_of or frame.type == kinds.JOINT
            # A body behind a fixed joint: its link has the name of the body.
            if skip or (frame.type == kinds.FIXED_JOINT and index in carried):
                continue
            above = frames[frame.parentFrame]
            fixed = frame.type == kinds.BODY and above.type == kinds.FIXED_JOINT
            named = above.name if fixed and int(frame.parentFrame) else None
            if frame.type == kinds.FIXED_JOINT:
                named = frame.name
            link = self._link_name(str(frame.name))
            self.link_of[index] = link
            SubElement(root, "link", name=link)
            name = fresh_name(str(named or f"{frame.name}_fixed"), self._joint_names)
            element = SubElement(root, "joint", name=name, type="fixed")
            _fix(element, self.main[frame.parentJoint], link, frame.placement)

    def placed(self, item: pin.GeometryObject) -> tuple[str, pin.SE3]:
        """Link that a shape belongs to, and its placement shape_to_link."""
        index, joint = int(item.parentFrame), int(item.parentJoint)
        if index in self.link_of and self.model.frames[index].parentJoint == joint:
            placement = self.model.frames[index].placement.actInv(item.placement)
            return self.link_of[index], placement
        return self.main[joint], item.placement


def _limit(value: float) -> float:
    """A limit; infinite if it is the largest number there is, or near it."""
    return math.copysign(math.inf, value) if abs(value) > MAX_NUMBER else float(value)


def _inertial(link: Element, inertia: pin.Inertia) -> None:
    inertial = SubElement(link, "inertial")
    origin = SubElement(inertial, "origin")
    write_numbers(origin, "xyz", np.asarray(inertia.lever).tolist())
    write_inertia(inertial, inertia.mass, np.asarray(inertia.inertia))


def _fix(element: Element, parent: str, child: str, placement: pin.SE3) -> None:
    write_origin(element, placement)
    SubElement(element, "parent", link=parent)
    SubElement(element, "child", link=child)


def _uneven_efforts(writer: _Writer) -> dict[str, tuple[float, float]]:
    found = {}
    for described, joint in zip(writer.joints, writer.model.joints[1:], strict=True):
        if joint.nv == 1:
            low = float(writer.model.lowerEffortLimit[joint.idx_v])
            high = float(writer.model.upperEffortLimit[joint.idx_v])
            if low != -high and max(-low, high) <= MAX_NUMBER:
                found[described.name] = low, high
    return found


def _semantics(
    writer: _Writer, collision: pin.GeometryModel | None, path: Path
) -> SemanticDescription | None:
    """What an SRDF file would say of the model."""
    states: dict[str, dict[str, float]] = {}
    for item in writer.model.referenceConfigurations:
        states[str(item.key())] = _positions(writer, np.asarray(item.data()))
    pairs = () if collision is None else _left_out(writer, collision)
    if not pairs and not states:
        return None
    return SemanticDescription(pairs, states, path)


def _positions(writer: _Writer, q: Array) -> dict[str, float]:
    """Positions by joint name in a configuration of the model."""
    found = {}
    for described, joint in zip(writer.joints, writer.model.joints[1:], strict=True):
        if joint.nv == 1:
            part = q[joint.idx_q : joint.idx_q + joint.nq]
            angle = math.atan2(part[-1], part[0]) if joint.nq == 2 else float(part[0])
            found[described.name] = angle
    return found


def _left_out(
    writer: _Writer, collision: pin.GeometryModel
) -> tuple[tuple[str, str], ...]:
    """Pairs of links that the collision pairs leave out; none if they say nothing.

    Without any pair, and with all that there can be, nobody has chosen.
    """
    items = list(collision.geometryObjects)
    links = [writer.placed(item)[0] for item in items]
    watched = {
        tuple(sorted((links[pair.first], links[pair.second])))
        for pair in collision.collisionPairs
    }
    every = {
        tuple(sorted((links[i], links[k])))
        for i, k in combinations(range(len(items)), 2)
        if items[i].parentJoint != items[k].parentJoint and links[i] != links[k]
    }
    if not watched or every <= watched:
        return ()
    return tuple(sorted((one, other) for one, other in every - watched))
