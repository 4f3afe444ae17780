"""From where the page shows a robot, and the floor below it."""

from __future__ import annotations

from typing import Any

import numpy as np

from tominpmp.app.request import Request
from tominpmp.robot import Robot
from tominpmp.viz.skeleton import best_view, skeleton

# Where the camera stands: its field of view [rad], its distance in sizes of the robot.
FIELD_OF_VIEW, DISTANCE = 0.75, 1.75
# From where an arm is seen that is not flat; a flat one is no deeper than this share.
SIDE, FLAT = np.array([0.6, -1.0, 0.75]), 0.05


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
