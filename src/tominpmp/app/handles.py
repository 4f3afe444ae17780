"""Handles on the stage: start, goal, points on the way and obstacles are dragged."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, Protocol

import numpy as np

from tominpmp.app.choice import RobotChoice
from tominpmp.app.controller import Controller
from tominpmp.app.items import UPRIGHT, Item
from tominpmp.app.stage import Color, put_surface
from tominpmp.viz.roles import HAZARD_COLOR, VIA_RGB, rgb
from tominpmp.viz.surfaces import obstacle_surface

OBSTACLE_COLOR = rgb(HAZARD_COLOR)
OBSTACLE_OPACITY = 0.72
# A handle that was not moved for so long is not held any more [s].
HOLD = 1.0


class Host(Protocol):
    """The page, for its parts."""

    controller: Controller
    handles: Handles

    def ask(self, **changes: Any) -> bool:
        """Ask for the same with some fields of the request changed."""

    def choose(self, choice: RobotChoice) -> None:
        """Take another robot."""

    def drag(self, end: str, position: Any, quaternion: Any) -> None:
        """Bring the frame at start or goal to a handle."""

    def export(self, ending: str, dt: float | None, message: str | None) -> None:
        """Hand the motion to the browser as a file."""


class Handle(NamedTuple):
    """A handle that the request asks for.

    Attributes:
        position: Where it is [m], shape (3,).
        quaternion: How it is turned (x, y, z, w).
        scale: Its size [m].
        turns: Whether it can be turned.
        dragged: Called with the handle of viser when somebody drags it.
        body: What it moves, if that is drawn with it.
        color: Colour of the body.
        opacity: Opacity of the body.
    """

    position: Any
    quaternion: Any
    scale: float
    turns: bool
    dragged: Callable[[Any], None]
    body: Item | None = None
    color: Color = OBSTACLE_COLOR
    opacity: float = 1.0

    def alike(self, other: Handle) -> bool:
        """Whether another one looks the same, wherever it is."""
        bodies = [one.body and (one.body.kind, one.body.size) for one in (self, other)]
        same = (self.scale, self.turns) == (other.scale, other.turns)
        return same and bodies[0] == bodies[1]


class Handles:
    """The handles, in step with the request.

    Args:
        scene: The scene of viser's server.
        host: The page.
    """

    def __init__(self, scene: Any, host: Host) -> None:
        self._scene, self._host = scene, host
        self._size = 0.2
        self._turning = False
        self._known: dict[str, tuple[Handle, Any]] = {}
        self._held: dict[str, float] = {}

    def rebuild(self, size: float) -> None:
        """Make all anew, for another robot; size of the handles [m]."""
        self._size = size
        self.refresh(all_anew=True)

    def allow_turning(self, wanted: bool) -> None:
        """Whether obstacles are turned, too."""
        self._turning = wanted
        self.refresh()

    def show(self, visible: bool) -> None:
        """Show or hide all handles."""
        for _, node in self._known.values():
            node.visible = visible

    def refresh(self, *, all_anew: bool = False) -> None:
        """Put handles where the request has them, but for those in somebody's hand."""
        wanted = self._wanted()
        for key, (before, node) in list(self._known.items()):
            if all_anew or key not in wanted or not before.alike(wanted[key]):
                node.remove()
                del self._known[key]
        for key, handle in wanted.items():
            known = self._known.get(key)
            node = self._made(key, handle) if known is None else known[1]
            self._known[key] = handle, node
            if self._free(key):
                x, y, z, w = handle.quaternion
                node.position = np.asarray(handle.position)
                node.wxyz = np.array([w, x, y, z])

    def _wanted(self) -> dict[str, Handle]:
        """The handles that the request asks for, by their names."""
        controller, size = self._host.controller, self._size
        request, reach = controller.request, controller.reach()
        found = {}
        for end in ("q_start", "q_goal"):
            pose = reach.pose(getattr(request, end))
            found[end] = Handle(*pose, size, reach.turns, partial(self._drag_end, end))
        for number, point in enumerate(request.via):
            ball = Item("sphere", "point", (0.12 * size,), point)
            dragged = partial(self._drag_via, number)
            found[f"via{number}"] = Handle(
                point, UPRIGHT, 0.7 * size, False, dragged, ball, VIA_RGB
            )
        for item in request.items:
            found[f"item_{item.name}"] = Handle(
                item.position,
                item.quaternion,
                0.9 * size,
                self._turning,
                partial(self._drag_item, item.name),
                item,
                opacity=OBSTACLE_OPACITY,
            )
        return found

    def _made(self, key: str, handle: Handle) -> Any:
        """A new handle on the stage."""
        path = f"/handles/{key}"
        node = self._scene.add_transform_controls(
            path,
            scale=handle.scale,
            disable_rotations=not handle.turns,
            disable_sliders=True,
            depth_test=False,
            **({"line_width": 3.0} if handle.body is None else {}),
        )
        if handle.body is not None:
            surface = obstacle_surface(handle.body.obstacle())
            look = handle.color, handle.opacity
            put_surface(self._scene, f"{path}/body", surface, *look)

        def update(event: Any) -> None:
            self._hold(key, event)
            handle.dragged(node)

        node.on_update(update)
        return node

    def _drag_end(self, end: str, node: Any) -> None:
        self._host.drag(end, np.array(node.position), _quaternion(node))
        if self._free(end):
            self.refresh()

    def _drag_via(self, number: int, node: Any) -> None:
        points = list(self._host.controller.request.via)
        if number < len(points):
            points[number] = tuple(node.position)
            self._host.ask(via=tuple(points))

    def _drag_item(self, name: str, node: Any) -> None:
        request = self._host.controller.request
        for item in request.items:
            if item.name == name:
                moved = item.placed(node.position, _quaternion(node))
                self._host.ask(items=request.with_item(moved).items)

    def _hold(self, key: str, event: Any) -> None:
        """Remember what is in somebody's hand: it is not moved under it."""
        if event.phase == "end":
            self._held.pop(key, None)
        else:
            self._held[key] = time.monotonic()

    def _free(self, key: str) -> bool:
        """Whether a handle is in nobody's hand.

        Events may come in another order than they were sent, the end not last.
        """
        return time.monotonic() - self._held.get(key, -HOLD) >= HOLD


def _quaternion(node: Any) -> Any:
    """How a handle is turned (x, y, z, w)."""
    w, x, y, z = node.wxyz
    return np.array([x, y, z, w])
