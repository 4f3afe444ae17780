"""Pinocchio models of a description, with locked and following joints."""

from __future__ import annotations

import threading
from collections.abc import Collection, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array, IntArray
from tominpmp.checks import FARTHEST
from tominpmp.description.mesh_sizes import INSTANCED, check_expanded
from tominpmp.description.tree import (
    SIZES,
    JointDescription,
    LinkDescription,
    Shape,
    UrdfDescription,
)
from tominpmp.exceptions import warn_caller

# Size beyond which a link must be in other units, for example millimetres [m].
LARGE = 100.0

# Tolerance within which two axes are equal, as in Pinocchio.
SAME_AXIS = 1e-12
# Joints about or along an axis of their own frame, which Pinocchio computes faster.
TURNING = (pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ)
SLIDING = (pin.JointModelPX, pin.JointModelPY, pin.JointModelPZ)
# Default colour of shapes, as in Pinocchio.
GREY = (0.9, 0.9, 0.9, 1.0)


class ScratchData(threading.local):
    """Data in which Pinocchio's algorithms leave their results, of each thread its own.

    With common data, threads would read the results of each other.

    Attributes:
        data: The data.
    """

    def __init__(self, model: pin.Model) -> None:
        self.data = model.createData()


def build_model(description: UrdfDescription, locked: Mapping[str, float]) -> pin.Model:
    """Build the kinematics and inertia of a description, with joints locked [rad or m].

    Joints and frames have the order in which Pinocchio reads a URDF file: depth first,
    joints of one link by name. A locked joint becomes a fixed one. (Pinocchio's own
    function for locking joints identifies frames by name alone, and fails if a link and
    a joint share a name.)
    """
    links = {link.name: link for link in description.bodies}
    on_link: dict[str, list[JointDescription]] = {}
    for joint in sorted(description.tree, key=lambda joint: joint.name, reverse=True):
        on_link.setdefault(joint.parent, []).append(joint)
    model, kinds = pin.Model(), pin.FrameType
    model.name = description.name
    root, here = description.root, pin.SE3.Identity()
    inertia = _inertia(links[root])
    body = model.addFrame(pin.Frame(root, 0, 0, here, kinds.BODY, inertia))
    stack = [(joint, body) for joint in on_link.get(root, ())]
    while stack:
        joint, above = stack.pop()
        index = int(model.frames[above].parentJoint)
        place = model.frames[above].placement * pin.SE3(joint.placement)
        inertia = _inertia(links[joint.child])
        if joint.kind == "fixed" or joint.name in locked:
            if joint.name in locked:
                place = place * joint.motion(locked[joint.name])
            frame = model.addFrame(
                pin.Frame(joint.name, index, above, place, kinds.FIXED_JOINT, inertia)
            )
        else:
            index = model.addJoint(index, _joint_model(joint), place, joint.name)
            frame, place = model.addJointFrame(index, above), pin.SE3.Identity()
            model.appendBodyToJoint(index, inertia, place)
        body = model.addBodyFrame(joint.child, index, place, frame)
        stack += [(below, body) for below in on_link.get(joint.child, ())]
    return model


def _inertia(link: LinkDescription) -> pin.Inertia:
    """Inertia of a link, even if it is impossible: that is checked later."""
    inertia = pin.Inertia.Zero()
    inertia.mass = link.mass or 0.0
    # Rounding makes the product of a heavy body too asymmetric for Pinocchio, which
    # reads these six entries.
    entries = link.inertia[[0, 1, 1, 0, 1, 2], [0, 0, 1, 2, 2, 2]]
    inertia.lever, inertia.inertia = link.com, pin.Symmetric3(entries).matrix()
    return inertia


def _joint_model(joint: JointDescription) -> Any:
    slides = joint.kind == "prismatic"
    for axis, kind in zip(np.eye(3), SLIDING if slides else TURNING, strict=True):
        if np.allclose(joint.axis, axis, rtol=0.0, atol=SAME_AXIS):
            return kind()
    if slides:
        return pin.JointModelPrismaticUnaligned(joint.axis)
    return pin.JointModelRevoluteUnaligned(joint.axis)


def build_geometry(
    description: UrdfDescription, model: pin.Model, kind: pin.GeometryType
) -> pin.GeometryModel:
    """Build the collision or visual geometry for a model of a description.

    Raises:
        RobotLoadError: If a mesh cannot be read.
    """
    geometry, load = pin.GeometryModel(), cache(_read_mesh)
    links = {link.name: link for link in description.bodies}
    collides = kind == pin.GeometryType.COLLISION
    for index, frame in enumerate(model.frames):
        if frame.type != pin.FrameType.BODY:
            continue
        link = links[frame.name]
        for number, shape in enumerate(link.collisions if collides else link.visuals):
            try:
                solid = _solid(shape, load)
            except Exception as error:  # mesh readers may raise anything
                description.fail(
                    f"link {link.name}, {shape.file or shape.kind}: the geometry "
                    f"cannot be read: {one_line(error)}"
                )
            item = pin.GeometryObject(
                f"{link.name}_{number}",
                int(frame.parentJoint),
                index,
                frame.placement * pin.SE3(shape.placement),
                solid,
                shape.file,
                np.array(shape.sizes if shape.kind == "mesh" else np.ones(3)),
                shape.colour is not None,
                np.array(GREY if shape.colour is None else shape.colour),
                shape.texture,
            )
            geometry.addGeometryObject(item)
    if collides:
        _warn_of_units(geometry, description.path)
    return geometry


def _solid(shape: Shape, load: Any) -> Any:
    """Shape as a geometry object of Coal."""
    if shape.kind in SIZES:
        return getattr(coal, shape.kind.capitalize())(*shape.sizes)
    if shape.corners is None or shape.faces is None:
        return load(shape.file, shape.sizes)
    return triangle_mesh(shape.corners, shape.faces)


def triangle_mesh(vertices: Array, triangles: IntArray) -> Any:
    """Mesh for Coal, from vertices (k, 3) and indices of corners (l, 3)."""
    mesh = coal.BVHModelOBBRSS()
    mesh.beginModel(len(triangles), len(vertices))
    mesh.addVertices(np.ascontiguousarray(vertices))
    mesh.addTriangles(np.ascontiguousarray(triangles))
    mesh.endModel()
    return mesh


def mesh_arrays(mesh: Any) -> tuple[Array, IntArray]:
    """Vertices (k, 3) [m] and corner indices of the triangles (l, 3) of a mesh."""
    triangles = map(mesh.tri_indices, range(mesh.num_tris))
    corners = np.array([[t[0], t[1], t[2]] for t in triangles], dtype=np.int64)
    vertices = np.array(mesh.vertices(), dtype=np.float64).reshape(-1, 3)
    return vertices, corners.reshape(-1, 3)


def _read_mesh(file: str, scale: tuple[float, ...]) -> Any:
    path = Path(file)
    if path.suffix.lower() in INSTANCED:
        check_expanded(path, path.read_bytes())
    mesh = coal.MeshLoader().load(file, np.array(scale))
    if not np.all(np.abs(mesh.vertices()) < FARTHEST):
        raise ValueError(f"it has vertices that are not finite, or {FARTHEST:g} m away")
    return mesh


def _warn_of_units(geometry: pin.GeometryModel, path: Path) -> None:
    """Warn of the first link so large that its mesh must be in other units."""
    for item in geometry.geometryObjects:
        if not item.meshPath:
            continue
        item.geometry.computeLocalAABB()
        size = 2.0 * float(item.geometry.aabb_radius)
        if size > LARGE:
            link = item.name.rpartition("_")[0]
            warn_caller(
                f"{path}: the mesh of link {link} is {size:.3g} m across, as if it "
                'were in millimetres: scale="0.001 0.001 0.001" of <mesh> corrects this'
            )
            return


def one_line(error: Exception) -> str:
    """Message of an error of a C++ library in one line, without the source location."""
    return " ".join(str(error).rpartition("message:")[2].split())


def sticks(model: pin.Model, q: Array) -> Array:
    """Ends of straight lines between consecutive joints, and from joints to bodies.

    Returns:
        Shape (k, 2, 3) [m], in the world; at least one line.
    """
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    places = ((data.oMi[joint], end) for joint, end in stick_ends(model))
    return np.array([(place.translation, place.act(end)) for place, end in places])


def stick_ends(model: pin.Model) -> list[tuple[int, Array]]:
    """Joints, and where those and the bodies that each carries are in its axes [m]."""
    joints, body = range(1, model.njoints), pin.FrameType.BODY
    ends = [(model.parents[joint], model.jointPlacements[joint]) for joint in joints]
    ends += [(k.parentJoint, k.placement) for k in model.frames[1:] if k.type == body]
    return [(int(joint), np.array(place.translation)) for joint, place in ends]


def are_neighbours(
    model: pin.Model, first: int, second: int, carriers: Collection[int]
) -> bool:
    """Whether one joint carries the other, with no joint with shapes between them.

    Args:
        model: The model.
        first: Index of a joint.
        second: Index of another joint.
        carriers: Indices of the joints with shapes.
    """
    for joint, target in ((first, second), (second, first)):
        parent = int(model.parents[joint])
        while parent and parent not in carriers:
            parent = int(model.parents[parent])
        if parent == target:
            return True
    return False
