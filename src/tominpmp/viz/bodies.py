"""Visual bodies of a robot: coloured surfaces on its joints."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import trimesh

from tominpmp.arrays import Array
from tominpmp.exceptions import RobotLoadError, warn_caller
from tominpmp.robot import Robot
from tominpmp.viz.surfaces import (
    Surface,
    capsule,
    joined,
    moved,
    native_surface,
    placed,
    scaled,
)

# Collision geometry is not coloured; the bodies of a robot without visuals are steel.
STEEL = (0.52, 0.58, 0.66, 1.0)

UPWARDS = np.array([0.0, 0.0, 1.0])
# Share of a robot's size to which a mesh file may differ from what Pinocchio reads.
MESH_AGREEMENT = 1e-3


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid part of a robot.

    Attributes:
        name: Name, unique in its robot.
        joint: Index in the model of the joint that carries it; 0 for the world.
        placement: Placement body_to_joint, homogeneous, shape (4, 4).
        surface: Surface in its own axes.
        color: Red, green, blue and opacity from 0 to 1.
    """

    name: str
    joint: int
    placement: Array
    surface: Surface
    color: tuple[float, float, float, float]


def robot_bodies(robot: Robot) -> list[Body]:
    """List the bodies of a robot.

    They are its visuals, and the collision geometry of what moves with a joint and has
    none (or of all, if they cannot be read); where there is none either, sticks from
    joint to joint.
    """
    try:
        bodies = geometry_bodies(robot.visual_model, color=None)
    except RobotLoadError as error:
        warn_caller(f"the collision geometry is shown instead: {error}")
        bodies = []
    # By joint, not by link: links that are there to collide only are fixed to others.
    seen = {body.joint for body in bodies}
    bodies += [
        body
        for body in geometry_bodies(robot.collision_model, color=STEEL)
        if body.joint not in seen
    ]
    if not any(body.joint for body in bodies):
        bodies += _sticks(robot)
    return bodies


def geometry_bodies(
    model: pin.GeometryModel, color: tuple[float, float, float, float] | None
) -> list[Body]:
    """The bodies of a model.

    Args:
        model: The model.
        color: Their colour; None for that of each.
    """
    bodies = []
    for item in model.geometryObjects:
        surface = _surface(item)
        if surface is None:
            continue
        own = tuple(float(value) for value in item.meshColor)
        bodies.append(
            Body(
                item.name,
                int(item.parentJoint),
                np.array(item.placement.homogeneous),
                surface,
                color or (own[0], own[1], own[2], own[3]),
            )
        )
    return bodies


def _surface(item: pin.GeometryObject) -> Surface | None:
    """Surface of a geometry object, with the colours in its file unless overridden."""
    surface = native_surface(item.geometry)
    if (
        surface is None
        or item.overrideMaterial
        or not type(item.geometry).__name__.startswith("BVHModel")
    ):
        return surface
    colored = _colored_mesh(item.meshPath)
    if colored is None:
        return surface
    colored = scaled(colored, item.meshScale)
    # Readers differ in units and axes; Pinocchio's word counts, and colours are not
    # worth a link in the wrong place.
    box, other = _extent(surface), _extent(colored)
    agree = np.abs(box - other).max() <= MESH_AGREEMENT * np.ptp(box, axis=0).max()
    return colored if agree else surface


def _extent(surface: Surface) -> Array:
    used = surface.vertices[np.unique(surface.faces)]
    return np.stack([used.min(axis=0), used.max(axis=0)])


def _colored_mesh(path: str) -> Surface | None:
    """Read a mesh with its colours; None if it has none or cannot be read."""
    if Path(path).suffix.lower() not in (".dae", ".obj", ".ply", ".glb", ".gltf"):
        return None  # STL has no colours worth reading
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of files that break their standard
            scene: Any = trimesh.load(path, force="scene", process=False)
            parts = [mesh for mesh in scene.dump() if isinstance(mesh, trimesh.Trimesh)]
            surfaces = [
                Surface(np.array(mesh.vertices), np.array(mesh.faces), _colors(mesh))
                for mesh in parts
            ]
    except Exception:  # whatever a mesh reader may raise; the shape is known already
        return None
    if all(surface.colors is None for surface in surfaces):
        return None
    return joined(surfaces)


def _colors(mesh: Any) -> Array | None:
    """Colours of the triangles of a mesh, shape (k, 3), or None if it has none."""
    if mesh.visual.kind == "texture":
        color = np.asarray(mesh.visual.material.main_color)[:3] / 255.0
        return np.tile(color, (len(mesh.faces), 1))
    if mesh.visual.kind in ("face", "vertex"):
        return np.asarray(mesh.visual.face_colors)[:, :3] / 255.0
    return None


def _sticks(robot: Robot) -> list[Body]:
    """Capsules from every joint to the joints and frames that follow it."""
    model = robot.model
    ends: list[tuple[str, int, Array]] = []
    for joint in range(1, model.njoints):
        place = model.jointPlacements[joint].translation
        ends.append((str(model.names[joint]), int(model.parents[joint]), place))
    for frame in model.frames[1:]:
        if frame.type == pin.FrameType.BODY:
            ends.append(
                (frame.name, int(frame.parentJoint), frame.placement.translation)
            )
    longest = max((float(np.linalg.norm(end)) for _, _, end in ends), default=0.0)
    radius = 0.02 * longest or 0.02
    bodies = []
    for name, joint, end in ends:
        length = float(np.linalg.norm(end))
        if length > 1e-6 * longest or joint:
            turn = pin.Quaternion.FromTwoVectors(UPWARDS, end).toRotationMatrix()
            surface = moved(capsule(radius, length), placed(end / 2, turn))
            bodies.append(Body(f"{name}_stick", joint, np.eye(4), surface, STEEL))
    return bodies
