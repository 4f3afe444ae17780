"""The right side of the page: what is asked for, files and lines of Python."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tominpmp.app.choice import RobotChoice, group_names, has_datasheet, loaded
from tominpmp.app.first_request import ARMS, known
from tominpmp.app.handles import Host
from tominpmp.app.items import SIZES, Item, new_item
from tominpmp.app.numbers import plain_name
from tominpmp.app.request import Limits
from tominpmp.description.files import robot_names
from tominpmp.exceptions import TominpmpError

ALL_JOINTS = "all joints"
GOAL_WORDS = {
    "this configuration": "joint",
    "the pose, any configuration": "pose",
    "the position, any orientation": "position",
}
# Files by what they are called on the page: ending, time between rows [s], message.
FILES: dict[str, tuple[str, float | None, str | None]] = {
    "CSV, every millisecond": (".csv", 0.001, None),
    "CSV, nodes": (".csv", None, None),
    "NumPy (.npz), every millisecond": (".npz", 0.001, None),
    "ROS 2 JointTrajectory (.yaml), 10 ms": (".yaml", 0.01, None),
    "ROS 2 FollowJointTrajectory (.yaml), 10 ms": (
        ".yaml",
        0.01,
        "FollowJointTrajectory",
    ),
}
# Files larger than this are no URDF [bytes].
MOST_BYTES = 20_000_000


def by_user(act: Callable[[], Any]) -> Callable[[Any], None]:
    """A callback that acts when somebody changes a field, not when the page does."""

    def changed(event: Any) -> None:
        if event.client is not None:
            act()

    return changed


class Panel:
    """What is asked for.

    Args:
        server: Viser's server.
        host: The page.
    """

    def __init__(self, server: Any, host: Host) -> None:
        self._gui, self._host = server.gui, host
        with self._gui.add_folder("Robot"):
            self._robot_part()
        with self._gui.add_folder("Start and goal"):
            self._ends_part()
        with self._gui.add_folder("Limits"):
            self._limits_part()
        with self._gui.add_folder("Obstacles"):
            self._obstacles = ObstaclePart(self._gui, host)
        with self._gui.add_folder("Export"):
            self._export_part()
        with self._gui.add_folder("In Python", expand_by_default=False):
            self._lines = self._gui.add_markdown("")

    # -- parts -------------------------------------------------------------------------

    def _robot_part(self) -> None:
        gui, source = self._gui, self._host.controller.request.robot.source
        names = [*ARMS, *(name for name in robot_names() if name not in ARMS)]
        if source not in names:
            names.insert(0, source)
        self._robots = gui.add_dropdown("Robot", names, initial_value=source)
        self._groups = gui.add_dropdown("Joints", (ALL_JOINTS,))
        self._datasheet = gui.add_checkbox("Maker's data sheet", False)
        upload = gui.add_upload_button(
            "Open a URDF file", mime_type=".urdf,.xml,text/xml"
        )
        self._robots.on_update(by_user(lambda: self._choose(known(self._robots.value))))
        self._groups.on_update(by_user(self._choose_part))
        self._datasheet.on_update(by_user(self._choose_part))
        upload.on_upload(by_user(lambda: self._take_file(upload.value)))

    def _ends_part(self) -> None:
        gui = self._gui
        self._goals = gui.add_dropdown("Goal is", tuple(GOAL_WORDS))
        self._frames = gui.add_dropdown("Frame", ("",))
        self._swap = gui.add_button("Swap start and goal")
        add = gui.add_button("Add a point on the way")
        self._fewer = gui.add_button("Remove the last point")
        show = gui.add_checkbox("Show handles", True)
        self._goals.on_update(by_user(self._change_goal))
        self._frames.on_update(by_user(self._change_frame))
        self._swap.on_click(by_user(self._swapped))
        add.on_click(by_user(self._add_point))
        self._fewer.on_click(
            by_user(lambda: self._ask(via=self._host.controller.request.via[:-1]))
        )
        show.on_update(by_user(lambda: self._host.handles.show(show.value)))

    def _limits_part(self) -> None:
        gui = self._gui
        self._sliders = {
            "effort_scale": gui.add_slider("Torque", 0.1, 1.0, 0.01, 1.0),
            "speed_scale": gui.add_slider("Speed", 0.1, 1.0, 0.01, 1.0),
            "margin": gui.add_slider("Margin [m]", 0.0, 0.1, 0.005, 0.02),
        }
        self._bounded = gui.add_checkbox("Limit accelerations", False)
        self._acceleration = gui.add_slider("Acceleration", 1.0, 60.0, 0.5, 15.0)
        self._acceleration.visible = False
        for slider in self._sliders.values():
            slider.on_update(by_user(self._change_limits))
        self._bounded.on_update(by_user(self._change_limits))
        self._acceleration.on_update(by_user(self._change_limits))

    def _export_part(self) -> None:
        files = self._gui.add_dropdown("File", tuple(FILES))
        button = self._gui.add_button("Download the motion")
        button.on_click(by_user(lambda: self._host.export(*FILES[files.value])))

    # -- robots ------------------------------------------------------------------------

    def _choose(self, choice: RobotChoice) -> None:
        self._host.choose(choice)

    def _choose_part(self) -> None:
        """The same robot with other joints, or other limits."""
        present = self._host.controller.request.robot
        group = None if self._groups.value == ALL_JOINTS else self._groups.value
        sheet = bool(self._datasheet.value)
        if (group, sheet) != (present.group, present.datasheet):
            locked = () if group else known(present.source).locked
            self._choose(replace(present, group=group, datasheet=sheet, locked=locked))

    def _take_file(self, file: Any) -> None:
        """Take a robot from a file that was dropped in."""
        if not file.content or len(file.content) > MOST_BYTES:
            return
        folder = Path(tempfile.mkdtemp(prefix="tominpmp-"))
        path = folder / f"{plain_name(Path(file.name).stem)}.urdf"
        path.write_bytes(file.content)
        self._choose(RobotChoice(str(path)))

    def rebuild(self) -> None:
        """Show what belongs to another robot."""
        request = self._host.controller.request
        source = request.robot.source
        try:
            if source not in self._robots.options:
                self._robots.options = (source, *self._robots.options)
            self._robots.value = source
            self._groups.options = (ALL_JOINTS, *group_names(source))
            self._groups.value = request.robot.group or ALL_JOINTS
            self._datasheet.visible = has_datasheet(source)
            self._datasheet.value = request.robot.datasheet
            self._frames.options = loaded(request.robot).frame_names
            self._frames.value = request.frame
            self._goals.value = next(
                k for k, v in GOAL_WORDS.items() if v == request.goal
            )
            self._show_limits(request.limits)
        except TominpmpError:
            pass  # the robot was loaded, only what else its files say is not known
        self.refresh_lines()

    # -- ends and points ---------------------------------------------------------------

    def _ask(self, **changes: Any) -> None:
        self._host.ask(**changes)

    def _change_goal(self) -> None:
        self._ask(goal=GOAL_WORDS[self._goals.value])

    def _change_frame(self) -> None:
        if self._frames.value:
            self._ask(frame=self._frames.value)

    def _swapped(self) -> None:
        request = self._host.controller.request
        via = tuple(reversed(request.via))
        self._ask(q_start=request.q_goal, q_goal=request.q_start, via=via)

    def _add_point(self) -> None:
        """A point beside the way, in the middle between the last one and the goal."""
        controller = self._host.controller
        request, reach = controller.request, controller.reach()
        middle = (np.array(request.q_start) + np.array(request.q_goal)) / 2
        point = tuple(reach.pose(tuple(middle.tolist()))[0].tolist())
        if request.via:
            goal = reach.pose(request.q_goal)[0]
            point = tuple(((np.array(request.via[-1]) + goal) / 2).tolist())
        self._ask(via=(*request.via, point))

    # -- limits ------------------------------------------------------------------------

    def _change_limits(self) -> None:
        bounded = bool(self._bounded.value)
        self._acceleration.visible = bounded
        values = {name: float(s.value) for name, s in self._sliders.items()}
        limit = float(self._acceleration.value) if bounded else None
        self._ask(limits=Limits(**values, acceleration=limit))

    def _show_limits(self, limits: Limits) -> None:
        for name, slider in self._sliders.items():
            slider.value = getattr(limits, name)
        self._bounded.value = limits.acceleration is not None

    # -- lines -------------------------------------------------------------------------

    def refresh_lines(self) -> None:
        """Show the lines of Python, and the names of the obstacles."""
        request = self._host.controller.request
        self._lines.content = f"```python\n{request.python()}```"
        self._fewer.visible = bool(request.via)
        self._obstacles.refresh()


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
