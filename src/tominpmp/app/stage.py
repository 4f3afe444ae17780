"""The stage: the robot, its ghosts at start and goal, its path, camera and floor."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from tominpmp.app.outcome import Shown
from tominpmp.app.request import Request
from tominpmp.arrays import Array
from tominpmp.robot import Robot
from tominpmp.viz.bodies import STEEL, Body, geometry_bodies
from tominpmp.viz.roles import PATH_RGB
from tominpmp.viz.skeleton import best_view, skeleton
from tominpmp.viz.surfaces import Surface, path_tube, shaded

Color = tuple[float, float, float]
GHOST_OPACITY, GHOST_SCALE = 0.28, 1.015
# Where the camera stands: its field of view [rad], its distance in sizes of the robot.
FIELD_OF_VIEW, DISTANCE = 0.75, 1.75
# From where an arm is seen that is not flat; a flat one is no deeper than this share.
SIDE, FLAT = np.array([0.6, -1.0, 0.75]), 0.05
# More colours than this in one body are averaged.
MOST_COLORS = 8
PATH_RADIUS = 0.0025  # as a share of the robot's size
# Ghosts of robots with more than this many are drawn by their collision geometry.
MOST_TRIANGLES = 20_000


class Arm:
    """One robot on the stage: a frame for each joint, with its bodies on it.

    Args:
        scene: The scene of viser's server.
        name: Name of the node.
        robot: The robot.
        bodies: What it looks like.
        tint: Colour and opacity of a ghost; None for the colours of the bodies.
    """

    def __init__(
        self,
        scene: Any,
        name: str,
        robot: Robot,
        bodies: Sequence[Body],
        tint: tuple[Color, float] | None = None,
    ) -> None:
        self._robot = robot
        self._data = robot.model.createData()
        self._root = scene.add_frame(name, show_axes=False)
        self._joints: dict[int, Any] = {}
        for number, body in enumerate(bodies):
            if tint is not None and not body.joint:
                continue  # the base stands where the robot's own is
            if body.joint not in self._joints:
                node = scene.add_frame(f"{name}/{body.joint}", show_axes=False)
                self._joints[body.joint] = node
            _put(scene, f"{name}/{body.joint}/{number}", body, tint)

    def move(self, q: Sequence[float] | Array) -> None:
        """Bring it into a configuration, n numbers [rad or m]."""
        model, data = self._robot.model, self._data
        pin.forwardKinematics(model, data, self._robot.expand(np.asarray(q)))
        for joint, node in self._joints.items():
            place = pin.SE3ToXYZQUAT(data.oMi[joint])
            node.position = place[:3]
            node.wxyz = place[[6, 3, 4, 5]]

    def remove(self) -> None:
        """Take it off the stage."""
        self._root.remove()


def outlines(robot: Robot, bodies: Sequence[Body]) -> list[Body]:
    """The bodies of a ghost, of few triangles.

    Args:
        robot: The robot.
        bodies: What it looks like; taken if that is little, else collision geometry.
    """
    if sum(len(body.surface.faces) for body in bodies) <= MOST_TRIANGLES:
        return list(bodies)
    found = geometry_bodies(robot.collision_model, STEEL)
    return found if any(body.joint for body in found) else list(bodies)


def _put(scene: Any, name: str, body: Body, tint: tuple[Color, float] | None) -> None:
    """Put a body on the stage: one mesh for each of its colours."""
    place = pin.SE3ToXYZQUAT(pin.SE3(body.placement))
    parts, opacity = _by_color(body), float(body.color[3])
    if tint is not None:
        parts, opacity = [(body.surface, tint[0])], tint[1]
    for number, (surface, color) in enumerate(parts):
        put_surface(
            scene,
            f"{name}/{number}",
            surface,
            color,
            opacity,
            # Ghosts are larger, or they would flicker with the robot on their surface.
            scale=1.0 if tint is None else GHOST_SCALE,
            cast_shadow=tint is None,
            receive_shadow=tint is None,
            side="double",
            position=place[:3],
            wxyz=place[[6, 3, 4, 5]],
        )


def put_surface(
    scene: Any, name: str, surface: Surface, color: Color, opacity: float, **look: Any
) -> None:
    """Put a surface of one colour on the stage; the look is that of viser."""
    # Colours of its triangles would keep apart vertices that are the same.
    drawn = shaded(surface.plain)
    scene.add_mesh_simple(
        name,
        drawn.positions,
        drawn.faces,
        color=color,
        opacity=None if opacity >= 1.0 else opacity,
        **look,
    )


def _by_color(body: Body) -> list[tuple[Surface, Color]]:
    """A body as parts of one colour each."""
    surface, own = body.surface, body.color[:3]
    if surface.colors is None:
        return [(surface, own)]
    colors, which = np.unique(np.round(surface.colors, 2), axis=0, return_inverse=True)
    if len(colors) > MOST_COLORS:
        mean = tuple(surface.colors.mean(axis=0).tolist())
        return [(surface.plain, mean)]
    return [
        (
            Surface(surface.vertices, surface.faces[which.ravel() == number]),
            tuple(color.tolist()),
        )
        for number, color in enumerate(colors)
    ]


def draw_path(scene: Any, shown: Shown, size: float) -> None:
    """Draw the path of the frame as a tube, in place of the one before."""
    surface = path_tube(shown.path, PATH_RADIUS, size)
    if surface is None:
        return
    scene.add_mesh_simple(
        "/path",
        surface.vertices,
        surface.faces,
        color=PATH_RGB,
        side="double",
        cast_shadow=False,
    )


def look_at(server: Any, robot: Robot, request: Request, size: float) -> None:
    """Camera and floor for the robot."""
    both = np.array([request.q_start, request.q_goal])
    found = skeleton(robot, both, request.frame)
    view = best_view(found.points)
    depth = np.ptp(found.points.reshape(-1, 3) @ view.normal)
    flat = view.planar and depth < FLAT * size
    normal = view.normal if flat else SIDE / np.linalg.norm(SIDE)
    places = [item.position for item in request.items]
    links = found.points.reshape(-1, 3)
    points = np.concatenate([links, np.reshape(places, (-1, 3))])
    middle = (points.min(0) + points.max(0)) / 2
    scene, camera = server.scene, server.initial_camera
    offset = DISTANCE * size * normal
    camera.look_at, camera.position = tuple(middle), tuple(middle + offset)
    camera.fov = FIELD_OF_VIEW
    if flat:
        camera.up = tuple(view.up)
    for client in server.get_clients().values():
        client.camera.position = middle + offset
        client.camera.look_at = middle
    scene.add_grid(
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


def size_of(robot: Robot, request: Request) -> float:
    """Size of what the robot spans between its base and its end [m]."""
    both = np.array([request.q_start, request.q_goal])
    points = skeleton(robot, both, request.frame).points.reshape(-1, 3)
    points = np.concatenate([points, np.zeros((1, 3))])
    return float(np.linalg.norm(np.ptp(points, axis=0))) or 1.0
