"""Models of Pinocchio, converted to the description that a URDF file would give.

All later stages (locked joints, payloads, several robots in one, copies in other
processes) work on descriptions. Placements, inertias and limits equal those of the
model up to rounding; the order of its joints is kept. Shapes without a file, and shapes
that URDF lacks, become meshes within the description.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array, IntArray, frozen_array
from tominpmp.description.model import mesh_arrays
from tominpmp.description.srdf import Pair, SemanticDescription, ordered_pair
from tominpmp.description.tree import (
    EMPTY,
    LOSSES,
    JointDescription,
    LinkDescription,
    Mimic,
    Shape,
    UrdfDescription,
    fixed_joint,
    fresh_name,
    solid,
    warn_of,
)
from tominpmp.description.xml_reader import MAX_NUMBER, limit_or_infinity
from tominpmp.exceptions import brief, fail_to_load

if TYPE_CHECKING:
    from trimesh import Trimesh

# Tolerance within which two placements are equal [m, rad].
PLACEMENT_TOLERANCE = 1e-12
# Number of vertices around a curved shape that becomes a mesh, and the factor from a
# polygon that is inscribed in a circle to one that is circumscribed about it.
VERTICES = 48
WIDER = 1.0 / math.cos(math.pi / VERTICES)

# Triangle mesh: vertices (k, 3), and vertex indices of each triangle (m, 3).
Triangles = tuple[Array, IntArray]


def describe_model(
    model: pin.Model,
    collision: pin.GeometryModel | None = None,
    visual: pin.GeometryModel | None = None,
    package_dirs: Sequence[Path] = (),
) -> tuple[UrdfDescription, SemanticDescription | None]:
    """Describe a model of Pinocchio, with its geometry if it has any.

    Args:
        model: Kinematics and inertia; joints of one degree of freedom only.
        collision: Collision shapes.
        visual: Visual shapes.
        package_dirs: Package folders, which are stored in the description.

    Returns:
        The description; and a semantic description with the link pairs that the
        collision geometry leaves out and the reference configurations, if there are
        any.

    Raises:
        RobotLoadError: If a joint has several degrees of freedom or both turns and
            slides, or a shape has an unsupported type.
    """
    path = Path(f"<pinocchio.Model {model.name}>")
    reader = _ModelReader(model, path)
    links, empty_shapes = reader.links(), list[str]()
    for geometry, kind in ((collision, "collisions"), (visual, "visuals")):
        for item in () if geometry is None else geometry.geometryObjects:
            name, placement = reader.placed(item)
            shape = _shape(item, placement, path)
            if shape is None:
                empty_shapes.append(brief(item.name))
                continue
            if kind == "visuals" and not (shape.file and not item.overrideMaterial):
                colour = np.clip(item.meshColor, 0.0, 1.0).tolist()
                shape = replace(shape, colour=tuple(colour))
            more: Any = {kind: (*getattr(links[name], kind), shape)}
            links[name] = replace(links[name], **more)
    warn_of({EMPTY: empty_shapes}, path)
    description = UrdfDescription(
        name=model.name or "robot",
        bodies=tuple(links.values()),
        tree=(*reader.joints, *reader.fixed),
        gravity=tuple(np.asarray(model.gravity.linear).tolist()),
        path=path,
        package_dirs=tuple(package_dirs),
        order=tuple(joint.name for joint in reader.joints),
    )
    return description, _semantics(reader, collision, path)


class _ModelReader:
    """Converts links and joints of a model."""

    def __init__(self, model: pin.Model, path: Path) -> None:
        self.model, self.path = model, path
        self.data = model.createData()
        pin.forwardKinematics(model, self.data, pin.neutral(model))
        self._links: set[str] = set()
        #: Link of each frame, by the index of the frame.
        self.link_of: dict[int, str] = {}
        self.main = [self._main_link(j) for j in range(model.njoints)]
        self.joints = [self._describe(j) for j in range(1, model.njoints)]
        self.fixed = tuple(self._frame_joints())

    def _describe(self, index: int) -> JointDescription:
        """Describe a joint: its kind, axis, limits and losses.

        Raises:
            RobotLoadError: If it does not turn about one axis or slide along one.
        """
        model, joint = self.model, self.model.joints[index]
        name, data = str(model.names[index]), self.data.joints[index]
        motion = np.asarray(data.S).reshape(6, -1)
        slides, turns = np.any(motion[:3]), np.any(motion[3:])
        if motion.shape[1] != 1 or slides == turns:
            fail_to_load(
                self.path,
                f"joint {brief(name)} is a {joint.shortname()}; only revolute and "
                "prismatic joints can be planned for: give a model with it locked "
                "(pinocchio.buildReducedModel), or a file without it",
            )
        # The motion subspace of a mimic joint is scaled by its ratio.
        axis = motion[:3, 0] + motion[3:, 0]
        ratio = float(np.linalg.norm(axis))
        described = JointDescription(
            name,
            "revolute" if turns else "prismatic",
            self.main[model.parents[index]],
            self.main[index],
            model.jointPlacements[index],
            axis / ratio,
            *(-math.inf, math.inf, math.inf),
        )
        if joint.nv == 0:
            place = list(model.mimicking_joints).index(index)
            leader = str(model.names[model.mimicked_joints[place]])
            # At the neutral configuration the joint is at its offset.
            moved = pin.log6(data.M)
            shift = np.asarray(moved.angular if turns else moved.linear)
            own = Mimic(leader, ratio, float(shift @ described.axis))
            return replace(described, mimic=own)
        v = joint.idx_v
        values: dict[str, Any] = {k: float(getattr(model, k)[v]) for k in LOSSES}
        if joint.nq == 1:
            values["lower"] = limit_or_infinity(model.lowerPositionLimit[joint.idx_q])
            values["upper"] = limit_or_infinity(model.upperPositionLimit[joint.idx_q])
        else:  # cosine and sine as coordinates: a continuous joint
            values["kind"] = "continuous"
        effort = np.array([model.lowerEffortLimit[v], model.upperEffortLimit[v]])
        if np.abs(effort).max() > MAX_NUMBER:
            effort = np.array([-1.0, 1.0]) * limit_or_infinity(np.abs(effort).min())
        velocity = limit_or_infinity(model.velocityLimit[v])
        return replace(described, velocity=velocity, effort=effort, **values)

    # -- links -------------------------------------------------------------------------

    def _main_link(self, joint: int) -> str:
        """Name of the link that a joint moves: its body's, or one after the joint."""
        for index, frame in enumerate(self.model.frames):
            body = frame.type == pin.FrameType.BODY and frame.parentJoint == joint
            if body and frame.placement.isIdentity(PLACEMENT_TOLERANCE):
                self.link_of[index] = fresh_name(frame.name, self._links)
                return self.link_of[index]
        own = f"{self.model.names[joint]}_link" if joint else "world"
        return fresh_name(own, self._links)

    def links(self) -> dict[str, LinkDescription]:
        """Links by name, without shapes: first those of joints, then of frames."""
        links = {self.main[0]: LinkDescription(self.main[0])}
        for name, own in zip(self.main[1:], self.model.inertias[1:], strict=True):
            links[name] = LinkDescription(name, float(own.mass), own.lever, own.inertia)
        of_frames = (joint.child for joint in self.fixed)
        return links | {name: LinkDescription(name) for name in of_frames}

    def _frame_joints(self) -> Iterator[JointDescription]:
        """Joints that fix a link for every further frame to the link of its joint."""
        frames, kinds, taken = self.model.frames, pin.FrameType, set(self.model.names)
        carried = {
            int(frame.parentFrame)
            for index, frame in enumerate(frames)
            if frame.type == kinds.BODY and index not in self.link_of
        }
        for index, frame in enumerate(frames):
            skip = index == 0 or index in self.link_of or frame.type == kinds.JOINT
            # A body behind a fixed joint: one link, with the name of the body.
            if skip or (frame.type == kinds.FIXED_JOINT and index in carried):
                continue
            is_body = frame.type == kinds.BODY and int(frame.parentFrame)
            joint = frames[frame.parentFrame] if is_body else frame
            named = joint.name if joint.type == kinds.FIXED_JOINT else None
            link = self.link_of[index] = fresh_name(str(frame.name), self._links)
            name = fresh_name(str(named or f"{frame.name}_fixed"), taken)
            yield fixed_joint(name, self.main[frame.parentJoint], link, frame.placement)

    def placed(self, item: pin.GeometryObject) -> tuple[str, pin.SE3]:
        """Link that a shape belongs to, and its placement shape_to_link."""
        index, joint = int(item.parentFrame), int(item.parentJoint)
        if index in self.link_of and self.model.frames[index].parentJoint == joint:
            placement = self.model.frames[index].placement.actInv(item.placement)
            return self.link_of[index], placement
        return self.main[joint], item.placement


def _shape(item: pin.GeometryObject, placement: pin.SE3, path: Path) -> Shape | None:
    """Convert a shape of a link; None if all its sizes are zero.

    Raises:
        RobotLoadError: If its type is not supported.
    """
    body, file = item.geometry, Path(item.meshPath)
    kind = type(body).__name__
    if kind == "Box":
        return solid("box", 2.0 * np.asarray(body.halfSide).ravel(), placement)
    if kind == "Sphere":
        return solid("sphere", (body.radius,), placement)
    if kind in ("Cylinder", "Capsule"):
        return solid(kind.lower(), (body.radius, 2.0 * body.halfLength), placement)
    if kind.startswith("BVHModel") and item.meshPath and file.is_file():
        scale = tuple(np.asarray(item.meshScale).tolist())
        return Shape("mesh", scale, placement, str(file.absolute()))
    triangles = _triangles(body)
    if triangles is None:
        fail_to_load(
            path,
            f"the shape {brief(item.name)} is a {kind}, expected a box, sphere, "
            "cylinder, capsule, cone, ellipsoid, mesh or convex one",
        )
    corners, faces = frozen_array(triangles[0]), triangles[1]
    return Shape("mesh", (1.0, 1.0, 1.0), placement, "", corners, faces)


def _semantics(
    reader: _ModelReader, collision: pin.GeometryModel | None, path: Path
) -> SemanticDescription | None:
    """Group states and disabled pairs of the model, as an SRDF file has them."""
    states: dict[tuple[str, str], dict[str, float]] = {}
    model = reader.model
    for item in model.referenceConfigurations:
        state, q = states.setdefault(("", str(item.key())), {}), np.asarray(item.data())
        for name, joint in zip(model.names[1:], model.joints[1:], strict=True):
            if joint.nv != 1:  # it follows another joint
                continue
            part = q[joint.idx_q : joint.idx_q + joint.nq]
            # Two coordinates are cosine and sine.
            angle = math.atan2(part[-1], part[0]) if joint.nq == 2 else float(part[0])
            state[str(name)] = angle
    pairs = () if collision is None else _unchecked_pairs(reader, collision)
    if not pairs and not states:
        return None
    return SemanticDescription(pairs, states, path)


def _unchecked_pairs(
    reader: _ModelReader, collision: pin.GeometryModel
) -> tuple[Pair, ...]:
    """Link pairs that the collision pairs leave out; empty without a real choice.

    A model without any pair, or with all possible pairs, makes no choice.
    """
    items = list(collision.geometryObjects)
    links = [reader.placed(item)[0] for item in items]
    pairs = collision.collisionPairs
    checked = {ordered_pair(links[pair.first], links[pair.second]) for pair in pairs}
    every = {
        ordered_pair(links[i], links[k])
        for i, k in combinations(range(len(items)), 2)
        if items[i].parentJoint != items[k].parentJoint and links[i] != links[k]
    }
    return tuple(sorted(every - checked)) if checked else ()


def _triangles(solid: Any) -> Triangles | None:
    """Triangles of a shape, circumscribed where it is curved; None if unsupported."""
    kind = type(solid).__name__
    if kind.startswith("BVHModel"):
        return mesh_arrays(solid)
    import trimesh  # heavy, and few models have such shapes

    if kind.startswith("Convex"):
        return _arrays(trimesh.convex.convex_hull(np.array(solid.points())))
    if kind == "Cone":
        cone = trimesh.creation.cone(WIDER, 2.0, sections=VERTICES)
        cone.apply_translation([0.0, 0.0, -1.0])
        return _arrays(cone.apply_scale([solid.radius, solid.radius, solid.halfLength]))
    return ellipsoid(np.asarray(solid.radii)) if kind == "Ellipsoid" else None


def ellipsoid(radii: Array) -> Triangles:
    """Triangles circumscribed about an ellipsoid with three radii [m]."""
    import trimesh

    ball = trimesh.creation.uv_sphere(count=(VERTICES // 2 + 1, VERTICES))
    # The faces touch the ellipsoid, the vertices are outside.
    return _arrays(ball.apply_scale(radii * [WIDER**2, WIDER**2, WIDER]))


def _arrays(mesh: Trimesh) -> Triangles:
    return np.array(mesh.vertices), np.array(mesh.faces, dtype=np.int64)
