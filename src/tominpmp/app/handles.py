"""Handles on the stage: start, goal, points on the way and obstacles are dragged."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from tominpmp.app.controller import Controller
from tominpmp.app.items import Item
from tominpmp.app.stage import GOAL_COLOR, START_COLOR
from tominpmp.viz.surfaces import obstacle_surface, shaded, sphere

OBSTACLE_COLOR = (0.84, 0.27, 0.22)
OBSTACLE_OPACITY = 0.72
VIA_COLOR = (0.55, 0.27, 0.80)
# A handle that was not moved for so long is not held any more [s].
HOLD = 1.0
ENDS = {"q_start": START_COLOR, "q_goal": GOAL_COLOR}


class Stage(Protocol):
    """What handles need of the page."""

    controller: Controller

    def ask(self, **changes: Any) -> bool:
        """Ask for the same with some fields of the request changed."""

    def drag(self, end: str, position: Any, quaternion: Any) -> None:
        """Bring the frame at start or goal to a handle."""


class Handles:
    """The handles, in step with the request.

    Args:
        scene: The scene of viser's server.
        stage: The page.
    """

    def __init__(self, scene: Any, stage: Stage) -> None:
        self._scene, self._stage = scene, stage
        self._size = 0.2
        self._turning = False
        self._ends: dict[str, Any] = {}
        self._via: list[Any] = []
        self._items: dict[str, tuple[Item, Any]] = {}
        self._held: dict[str, float] = {}

    def rebuild(self, size: float) -> None:
        """Make all anew, for another robot; size of the handles [m]."""
        for handle in self._ends.values():
            handle.remove()
        self._size, self._ends = size, {}
        turns = self._stage.controller.reach().turns
        for end in ENDS:
            handle = self._scene.add_transform_controls(
                f"/handles/{end}",
                scale=size,
                disable_rotations=not turns,
                disable_sliders=True,
                depth_test=False,
                line_width=3.0,
            )
            handle.on_update(self._on_end(end, handle))
            self._ends[end] = handle
        self.refresh(all_anew=True)

    def allow_turning(self, wanted: bool) -> None:
        """Whether obstacles are turned, too."""
        self._turning = wanted
        self.refresh(all_anew=True)

    def show(self, visible: bool) -> None:
        """Show or hide all handles."""
        for handle in (*self._ends.values(), *self._via):
            handle.visible = visible
        for _, handle in self._items.values():
            handle.visible = visible

    def refresh(self, *, all_anew: bool = False) -> None:
        """Put handles where the request has them, but for those in somebody's hand."""
        request, reach = self._stage.controller.request, self._stage.controller.reach()
        for end, handle in self._ends.items():
            if self._free(end):
                position, quaternion = reach.pose(getattr(request, end))
                _place(handle, position, quaternion)
        self._refresh_via(request.via, all_anew)
        names = {item.name for item in request.items}
        for name in list(self._items):
            if all_anew or name not in names:
                self._drop(name)
        for item in request.items:
            self._refresh_item(item)

    def _refresh_via(self, points: Any, all_anew: bool) -> None:
        if all_anew or len(points) != len(self._via):
            for handle in self._via:
                handle.remove()
            self._via = [self._via_handle(number) for number in range(len(points))]
        for number, (handle, point) in enumerate(zip(self._via, points, strict=True)):
            if self._free(f"via{number}"):
                handle.position = np.array(point)

    def _via_handle(self, number: int) -> Any:
        name = f"/handles/via{number}"
        handle = self._scene.add_transform_controls(
            name,
            scale=0.7 * self._size,
            disable_rotations=True,
            disable_sliders=True,
            depth_test=False,
        )
        ball = shaded(sphere(0.12 * self._size))
        self._scene.add_mesh_simple(
            f"{name}/ball", ball.positions, ball.faces, color=VIA_COLOR
        )

        def dragged(event: Any) -> None:
            key = f"via{number}"
            self._hold(key, event)
            points = list(self._stage.controller.request.via)
            if number < len(points):
                points[number] = tuple(handle.position)
                self._stage.ask(via=tuple(points))

        handle.on_update(dragged)
        return handle

    def _refresh_item(self, item: Item) -> None:
        known = self._items.get(item.name)
        if known is not None and known[0] == item:
            return
        if known is not None and known[0].alike(item):
            handle = known[1]
        else:
            if known is not None:
                self._drop(item.name)
            handle = self._item_handle(item)
        self._items[item.name] = item, handle
        if self._free(item.name):
            _place(handle, item.position, item.quaternion)

    def _item_handle(self, item: Item) -> Any:
        path = f"/handles/item_{item.name}"
        handle = self._scene.add_transform_controls(
            path,
            scale=0.9 * self._size,
            disable_rotations=not self._turning,
            disable_sliders=True,
            depth_test=False,
        )
        drawn = shaded(obstacle_surface(item.obstacle()))
        self._scene.add_mesh_simple(
            f"{path}/body",
            drawn.positions,
            drawn.faces,
            color=OBSTACLE_COLOR,
            opacity=OBSTACLE_OPACITY,
        )

        def dragged(event: Any) -> None:
            self._hold(item.name, event)
            request = self._stage.controller.request
            now = [one for one in request.items if one.name == item.name]
            if now:
                moved = now[0].placed(handle.position, _quaternion(handle))
                self._stage.ask(items=request.with_item(moved).items)

        handle.on_update(dragged)
        return handle

    def _drop(self, name: str) -> None:
        _, handle = self._items.pop(name)
        handle.remove()

    def _on_end(self, end: str, handle: Any) -> Callable[[Any], None]:
        def dragged(event: Any) -> None:
            self._hold(end, event)
            self._stage.drag(end, np.array(handle.position), _quaternion(handle))
            if self._free(end):
                self.refresh()

        return dragged

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


def _place(handle: Any, position: Any, quaternion: Any) -> None:
    handle.position = np.asarray(position)
    x, y, z, w = quaternion
    handle.wxyz = np.array([w, x, y, z])


def _quaternion(handle: Any) -> Any:
    """How a handle is turned (x, y, z, w)."""
    w, x, y, z = handle.wxyz
    return np.array([x, y, z, w])
