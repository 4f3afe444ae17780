"""The stage: the robot, its ghosts at start and goal, and its path."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin
from trimesh import Trimesh

from tominpmp.app.request import Request
from tominpmp.arrays import Array
from tominpmp.robot.robot import Robot
from tominpmp.viz.skeleton import camera_view, skeleton
from tominpmp.viz.surfaces import (
    STEEL,
    Body,
    geometry_bodies,
    obstacle_surface,
    path_tube,
    shaded,
)
from tominpmp.viz.surroundings import GOAL_RGB, PATH_RGB, START_RGB

Color = tuple[float, float, float]
# Opacity of ghosts, and their sizes relative to the robot, by colour: surfaces of equal
# size would flicker where they coincide.
GHOST_OPACITY, GHOSTS = 0.28, {START_RGB: 1.015, GOAL_RGB: 1.025}
# Field of view of the camera [rad], aspect ratio of the window between the panels that
# it is placed for, and factor of the distance at which it sees the links' axes.
FIELD_OF_VIEW, ASPECT, MARGIN = 0.75, 0.67, 1.25
PATH_RADIUS = 0.0025  # as a share of the robot's size
# Largest number of triangles of a ghost; larger robots have their collision geometry.
MOST_TRIANGLES = 20_000


class Arm:
    """A robot on the stage: a node for each joint, with the bodies that it carries.

    Args:
        scene: The scene of viser's server.
        name: Name of the root node.
        robot: The robot.
        bodies: Its bodies.
        tint: Colour of a ghost; None for the colours of the bodies.
    """

    def __init__(
        self,
        scene: Any,
        name: str,
        robot: Robot,
        bodies: Sequence[Body],
        tint: Color | None = None,
    ) -> None:
        self._robot = robot
        scene.add_frame(name, show_axes=False)
        self._joints: dict[int, Any] = {}
        for number, body in enumerate(bodies):
            if tint is not None and not body.joint:
                continue  # the base of a ghost would cover the robot's base
            if body.joint not in self._joints:
                node = scene.add_frame(f"{name}/{body.joint}", show_axes=False)
                self._joints[body.joint] = node
            _put(scene, f"{name}/{body.joint}/{number}", body, tint)

    def move(self, q: Sequence[float] | Array) -> None:
        """Move the robot to a configuration, n numbers [rad or m]."""
        model, data = self._robot._model_and_data
        pin.forwardKinematics(model, data, self._robot.expand(np.asarray(q)))
        for joint, node in self._joints.items():
            place = pin.SE3ToXYZQUAT(data.oMi[joint])
            node.position = place[:3]
            node.wxyz = place[[6, 3, 4, 5]]


def outlines(robot: Robot, bodies: Sequence[Body]) -> list[Body]:
    """The bodies of a ghost, with few triangles if possible.

    Args:
        robot: The robot.
        bodies: Its bodies; if they have too many triangles, its collision geometry
            replaces them.
    """
    if sum(len(body.surface.faces) for body in bodies) <= MOST_TRIANGLES:
        return list(bodies)
    coarse = geometry_bodies(robot.collision_model, STEEL)
    return coarse if any(body.joint for body in coarse) else list(bodies)


def _put(scene: Any, name: str, body: Body, tint: Color | None) -> None:
    """Put a body on the stage."""
    place = pin.SE3ToXYZQUAT(pin.SE3(body.placement))
    look = {"position": place[:3], "wxyz": place[[6, 3, 4, 5]], "side": "double"}
    color, opacity = body.color[:3], body.color[3]
    if tint is not None:
        color, opacity = tint, GHOST_OPACITY
        look |= {"scale": GHOSTS[tint], "cast_shadow": False, "receive_shadow": False}
    put_surface(scene, name, body.surface, color, opacity, **look)


def put_surface(
    scene: Any, name: str, surface: Trimesh, color: Color, opacity: float, **look: Any
) -> None:
    """Put a surface of one colour on the stage; ``look`` has options for viser."""
    mesh = shaded(surface)
    scene.add_mesh_simple(
        name,
        mesh["position"],
        mesh["index"],
        color=color,
        opacity=None if opacity >= 1.0 else opacity,
        **look,
    )


def draw_path(scene: Any, path: Array, size: float) -> None:
    """Draw the path of the frame as a tube, which replaces the previous one."""
    surface = path_tube(path, PATH_RADIUS, size)
    if surface is not None:
        look = {"side": "double", "cast_shadow": False}
        put_surface(scene, "/path", surface, PATH_RGB, 1.0, **look)


def look_at(server: Any, robot: Robot, request: Request) -> float:
    """Place camera and floor for the robot.

    Returns:
        Diagonal of the bounding box of the base and the robot at start and goal [m].
    """
    both = np.array([request.q_start, request.q_goal])
    poses = skeleton(robot, both, request.frame)
    links = poses.points.reshape(-1, 3)
    extent = np.ptp(np.concatenate([links, np.zeros((1, 3))]), axis=0)
    size = float(np.linalg.norm(extent)) or 1.0
    view = camera_view(poses.points)
    corners = [
        obstacle_surface(item).vertices @ item.rotation.T + item.position
        for item in request.items
    ]
    points = np.concatenate([links, *corners])
    middle = (points.min(0) + points.max(0)) / 2
    distance = view.distance(points - middle, np.tan(FIELD_OF_VIEW / 2), ASPECT)
    place = middle + MARGIN * distance * view.normal
    camera = server.initial_camera
    camera.look_at, camera.position = tuple(middle), tuple(place)
    up = tuple(view.up) if view.planar else (0.0, 0.0, 1.0)
    camera.fov, camera.up = FIELD_OF_VIEW, up
    for client in server.get_clients().values():
        client.camera.up_direction = up
        client.camera.position = place
        client.camera.look_at = middle
    server.scene.add_grid(
        "/floor",
        width=8.0 * size,
        height=8.0 * size,
        cell_size=0.1 * size,
        section_size=0.5 * size,
        cell_color=(226, 230, 236),
        section_color=(205, 211, 220),
        position=(0.0, 0.0, -0.002 * size),
        fade_distance=6.0 * size,
    )
    return size
