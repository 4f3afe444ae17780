"""What an obstacle is in a picture: furniture, or something to beware of."""

from __future__ import annotations

import numpy as np

from tominpmp.scene import Box, HeightField, Mesh, Obstacle
from tominpmp.viz.surfaces import obstacle_surface

# A board is at least so many times as wide as thick, in both directions.
BOARD = 3.0

FURNITURE_COLOR = "#8d98a5"
HAZARD_COLOR = "#d6453a"
# Start, goal, points on the way, and path of the end of an arm in space.
START_RGB, GOAL_RGB = (0.35, 0.47, 0.65), (0.13, 0.62, 0.36)
VIA_RGB, PATH_RGB = (0.55, 0.27, 0.80), (0.95, 0.64, 0.10)


def _is_furniture(obstacle: Obstacle) -> bool:
    """Whether an obstacle is a table, wall, board or ground that stands still.

    Pictures show these grey, and red what is left: posts, balls, crates, and whatever
    moves.
    """
    if obstacle.motion is not None:
        return False
    if isinstance(obstacle, HeightField):
        return True
    if not isinstance(obstacle, Box | Mesh):
        return False
    vertices = obstacle_surface(obstacle).vertices
    least, middle, _ = np.sort(np.ptp(vertices, axis=0))
    return bool(middle >= BOARD * least)


def obstacle_color(obstacle: Obstacle) -> str:
    """Colour of an obstacle, as ``#rrggbb``."""
    return FURNITURE_COLOR if _is_furniture(obstacle) else HAZARD_COLOR


def rgb(color: str) -> tuple[float, float, float]:
    """Red, green and blue from 0 to 1 of a colour ``#rrggbb``."""
    red, green, blue = (int(color[i : i + 2], 16) / 255.0 for i in (1, 3, 5))
    return red, green, blue
