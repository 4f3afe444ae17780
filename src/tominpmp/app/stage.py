"""The stage: the robot, its ghosts at start and goal, its path and drag handles."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin
from trimesh import Trimesh

from tominpmp.app.controller import Controller
from tominpmp.app.request import UPRIGHT, Item, Request
from tominpmp.arrays import Array
from tominpmp.robot.robot import Robot
from tominpmp.viz.skeleton import camera_view, skeleton
from tominpmp.viz.surfaces import (
    STEEL,
    Body,
    geometry_bodies,
    obstacle_surface,
    path_tube,
    plain,
    shaded,
    triangle_colors,
)
from tominpmp.viz.surroundings import HAZARD_COLOR, PATH_RGB, VIA_RGB, rgb

Color = tuple[float, float, float]
GHOST_OPACITY, GHOST_SCALE = 0.28, 1.015
# Field of view of the camera [rad], aspect ratio of the window between the panels that
# it is placed for, and factor of the distance at which it sees the links' axes.
FIELD_OF_VIEW, ASPECT, MARGIN = 0.75, 0.67, 1.25
# Largest number of colours of a body; more colours are averaged.
MOST_COLORS = 8
PATH_RADIUS = 0.0025  # as a share of the robot's size
# Largest number of triangles of a ghost; larger robots have their collision geometry.
MOST_TRIANGLES = 20_000
OBSTACLE_LOOK = rgb(HAZARD_COLOR), 0.72
# Time after its last movement at which a handle counts as released [s].
HOLD = 1.0


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
        self._data = robot.model.createData()
        self._root = scene.add_frame(name, show_axes=False)
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
        model, data = self._robot.model, self._data
        pin.forwardKinematics(model, data, self._robot.expand(np.asarray(q)))
        for joint, node in self._joints.items():
            place = pin.SE3ToXYZQUAT(data.oMi[joint])
            node.position = place[:3]
            node.wxyz = place[[6, 3, 4, 5]]

    def remove(self) -> None:
        """Remove the robot from the stage."""
        self._root.remove()


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
    """Put a body on the stage: one mesh for each of its colours."""
    place = pin.SE3ToXYZQUAT(pin.SE3(body.placement))
    look = {"position": place[:3], "wxyz": place[[6, 3, 4, 5]], "side": "double"}
    parts, opacity = _by_color(body), float(body.color[3])
    if tint is not None:
        parts, opacity = [(body.surface, tint)], GHOST_OPACITY
        # Ghosts are slightly larger: coincident surfaces would flicker.
        look |= {"scale": GHOST_SCALE, "cast_shadow": False, "receive_shadow": False}
    for number, (surface, color) in enumerate(parts):
        put_surface(scene, f"{name}/{number}", surface, color, opacity, **look)


def put_surface(
    scene: Any, name: str, surface: Trimesh, color: Color, opacity: float, **look: Any
) -> None:
    """Put a surface of one colour on the stage; ``look`` has options for viser."""
    # With colours of triangles, shared vertices would not be merged.
    mesh = shaded(plain(surface))
    scene.add_mesh_simple(
        name,
        mesh["position"],
        mesh["index"],
        color=color,
        opacity=None if opacity >= 1.0 else opacity,
        **look,
    )


def _by_color(body: Body) -> list[tuple[Trimesh, Color]]:
    """Split a body into parts of one colour each."""
    surface, colors = body.surface, triangle_colors(body.surface)
    if colors is None:
        return [(surface, body.color[:3])]
    shares = np.round(colors / 255.0, 2)
    shown, which = np.unique(shares, axis=0, return_inverse=True)
    if len(shown) > MOST_COLORS:
        shown = np.mean(colors / 255.0, axis=0)[None]
        which = np.zeros_like(which)
    return [
        (Trimesh(surface.vertices, surface.faces[which.ravel() == k]), tuple(color))
        for k, color in enumerate(shown.tolist())
    ]


def draw_path(scene: Any, path: Array, size: float) -> None:
    """Draw the path of the frame as a tube, which replaces the previous one."""
    surface = path_tube(path, PATH_RADIUS, size)
    if surface is not None:
        mesh, look = (surface.vertices, surface.faces), {"color": PATH_RGB}
        scene.add_mesh_simple("/path", *mesh, side="double", cast_shadow=False, **look)


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
    obstacles = [
        obstacle_surface(item.call().evaluate()).vertices + item.position
        for item in request.items
    ]
    points = np.concatenate([links, *obstacles])
    middle = (points.min(0) + points.max(0)) / 2
    slope = np.tan(FIELD_OF_VIEW / 2)
    place = (
        middle + MARGIN * view.distance(points - middle, slope, ASPECT) * view.normal
    )
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


class Handles:
    """The handles of start, goal, via points and obstacles.

    Args:
        scene: The scene of viser's server.
        controller: The controller, whose request the handles follow.
        ask: Changes fields of the request, given by name.
        drag: Brings the frame at start or goal to a position and quaternion.
    """

    def __init__(
        self,
        scene: Any,
        controller: Controller,
        ask: Callable[..., object],
        drag: Callable[[str, Any, Any], None],
    ) -> None:
        self._scene, self._controller = scene, controller
        self._ask, self._drag = ask, drag
        self._size = 0.2
        self._turning = False
        self._known: dict[str, tuple[object, Any]] = {}
        self._held: dict[str, float] = {}

    def clear(self, size: float) -> None:
        """Remove all handles, for another robot; new ones have another size [m]."""
        self._size = size
        self._keep(())

    def allow_turning(self, wanted: bool) -> None:
        """Choose whether the handles of obstacles also turn them."""
        self._turning = wanted
        self.refresh()

    def show(self, visible: bool) -> None:
        """Show or hide all handles."""
        for _, node in self._known.values():
            node.visible = visible

    def refresh(self) -> None:
        """Move handles to the places of the request, except handles being dragged."""
        request, size = self._controller.request, self._size
        reach, wanted = self._controller.reach(), ["q_start", "q_goal"]
        for end in wanted:
            pose: tuple[Any, Any] = reach.pose(getattr(request, end))
            dragged = partial(self._drag_end, end)
            self._put(end, *pose, dragged, size, reach.turns)
        for number, point in enumerate(request.via):
            wanted.append(f"via{number}")
            ball = Item("sphere", "point", (0.12 * size,), point)
            dragged = partial(self._drag_via, number)
            pose, look = (point, UPRIGHT), (VIA_RGB, 1.0)
            self._put(wanted[-1], *pose, dragged, 0.7 * size, False, ball, look)
        for item in request.items:
            wanted.append(f"item_{item.name}")
            dragged = partial(self._drag_item, item.name)
            pose = item.position, item.quaternion
            self._put(wanted[-1], *pose, dragged, 0.9 * size, self._turning, item)
        self._keep(wanted)

    def _keep(self, wanted: Sequence[str]) -> None:
        """Remove all other handles from the stage."""
        for key in set(self._known) - set(wanted):
            self._known.pop(key)[1].remove()

    def _put(
        self,
        key: str,
        position: Any,
        quaternion: Any,
        dragged: Callable[[Any], None],
        scale: float,
        turns: bool,
        body: Item | None = None,
        look: tuple[Color, float] = OBSTACLE_LOOK,
    ) -> None:
        """Put a handle on the stage.

        Args:
            key: Name of the handle.
            position: Its position [m], shape (3,).
            quaternion: Its orientation (x, y, z, w).
            dragged: Called with the handle of viser when a user drags it.
            scale: Its size [m].
            turns: Whether it can be turned.
            body: Obstacle that is drawn with the handle; None for a handle alone.
            look: Colour and opacity of the body.
        """
        kind = scale, turns, body and (body.kind, body.size)
        if key in self._known and self._known[key][0] != kind:
            self._known.pop(key)[1].remove()
        if key not in self._known:
            node = self._scene.add_transform_controls(
                f"/handles/{key}",
                scale=scale,
                disable_rotations=not turns,
                disable_sliders=True,
                depth_test=False,
                **({"line_width": 3.0} if body is None else {}),
            )
            if body is not None:
                surface, path = obstacle_surface(body.call().evaluate()), node.name
                put_surface(self._scene, f"{path}/body", surface, *look)
            node.on_update(partial(self._moved, key, dragged))
            self._known[key] = kind, node
        if self._free(key):
            x, y, z, w = quaternion
            node = self._known[key][1]
            node.position, node.wxyz = np.asarray(position), np.array([w, x, y, z])

    def _moved(self, key: str, dragged: Callable[[Any], None], event: Any) -> None:
        """Process a drag event; the program does not move a handle while it is held."""
        if event.phase == "end":
            self._held.pop(key, None)
        else:
            self._held[key] = time.monotonic()
        dragged(event.target)

    def _drag_end(self, end: str, node: Any) -> None:
        self._drag(end, np.array(node.position), node.wxyz[[1, 2, 3, 0]])
        if self._free(end):
            self.refresh()

    def _drag_via(self, number: int, node: Any) -> None:
        points = list(self._controller.request.via)
        if number < len(points):
            points[number] = tuple(node.position)
            self._ask(via=tuple(points))

    def _drag_item(self, name: str, node: Any) -> None:
        pose = {"position": node.position, "quaternion": node.wxyz[[1, 2, 3, 0]]}
        self._ask(items=self._controller.request.items_with(name, **pose))

    def _free(self, key: str) -> bool:
        """Whether no user drags a handle.

        Events may arrive out of order, with the end of a drag not the last one, so that
        a handle is also free some time after its last movement.
        """
        return self._held.get(key, -HOLD) + HOLD <= time.monotonic()
