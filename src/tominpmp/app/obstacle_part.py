"""The part of the page where obstacles are added, resized and taken away."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

from tominpmp.app.choice import RobotChoice
from tominpmp.app.controller import Controller
from tominpmp.app.handles import Handles
from tominpmp.app.items import SIZES, Item, new_item


def by_user(act: Callable[[], Any]) -> Callable[[Any], None]:
    """A callback that acts when somebody changes a field, not when the page does."""

    def changed(event: Any) -> None:
        if event.client is not None:
            act()

    return changed


class Host(Protocol):
    """What the panel needs of the page."""

    controller: Controller
    handles: Handles

    def ask(self, **changes: Any) -> bool:
        """Ask for the same with some fields of the request changed."""

    def choose(self, choice: RobotChoice) -> None:
        """Take another robot."""

    def export(self, ending: str, dt: float | None, message: str | None) -> None:
        """Hand the motion to the browser as a file."""


class ObstaclePart:
    """The obstacles of the request.

    Args:
        gui: The fields of viser's server.
        host: The page.
    """

    def __init__(self, gui: Any, host: Host) -> None:
        self._host = host
        self._kinds = gui.add_button_group("Add", tuple(SIZES))
        self._items = gui.add_dropdown("Obstacle", ("none",))
        self._sizes = [
            gui.add_slider(f"size {number + 1}", 0.01, 2.0, 0.01, 0.1)
            for number in range(3)
        ]
        turn = gui.add_checkbox("Turn obstacles", False)
        self._remove = gui.add_button("Remove this obstacle", color="gray")
        self._kinds.on_click(by_user(lambda: self._add_item(self._kinds.value)))
        self._items.on_update(by_user(self._show_sizes))
        for slider in self._sizes:
            slider.on_update(by_user(self._resize))
        self._remove.on_click(by_user(self._remove_item))
        turn.on_update(by_user(lambda: self._host.handles.allow_turning(turn.value)))

    def refresh(self) -> None:
        """Show the names of the obstacles."""
        items = self._host.controller.request.items
        names = tuple(item.name for item in items) or ("none",)
        if tuple(self._items.options) != names:
            self._items.options = names
            self._show_sizes()

    def _add_item(self, kind: str) -> None:
        controller = self._host.controller
        request = controller.request
        taken = tuple(item.name for item in request.items)
        position = controller.reach().pose(request.q_goal)[0] * [-0.6, 0.6, 1.0]
        item = new_item(kind, position, taken)
        self._host.ask(items=(*request.items, item))
        self.refresh()
        self._items.value = item.name
        self._show_sizes()

    def _chosen(self) -> Item | None:
        items = self._host.controller.request.items
        return next((item for item in items if item.name == self._items.value), None)

    def _show_sizes(self) -> None:
        item = self._chosen()
        names = () if item is None else tuple(SIZES[item.kind])
        for number, slider in enumerate(self._sizes):
            slider.visible = number < len(names)
            if item is not None and number < len(names):
                slider.label = f"{names[number]} [m]"
                slider.value = item.size[number]
        self._remove.visible = item is not None

    def _resize(self) -> None:
        item = self._chosen()
        if item is None:
            return
        count = len(SIZES[item.kind])
        sizes = [float(slider.value) for slider in self._sizes[:count]]
        changed = self._host.controller.request.with_item(item.resized(sizes))
        self._host.ask(items=changed.items)

    def _remove_item(self) -> None:
        if self._items.value is not None:
            request = self._host.controller.request.without_item(self._items.value)
            self._host.ask(items=request.items)
