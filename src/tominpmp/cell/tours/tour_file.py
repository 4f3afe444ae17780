"""Tours in scenario files: stations in place of a goal.

::

    [robot]
    name = "ur5"

    [start]
    q = [0.0, -1.8, 2.2, -2.0, -1.6, 0.0]

    [tour]                              # optional
    end = "start"                       # the default; "last", or q by joint
    precedence = [["drill", "tap"]]     # pairs (earlier, later)
    configurations = 40

    [[stations]]
    name = "drill"
    dwell = 0.3

    [stations.goal]
    type = "axis"
    frame = "tool0"
    axis = [0, 0, 1]
    direction = [0, 0, -1]
    position = [0.5, 0.1, 0.2]

    [[stations]]
    name = "tap"
    after = ["drill"]
    goal = {type = "joint", q = {elbow_joint = 1.2}}

Scene, limits, constraints and options have the same keys as in other scenarios; joints
that a station or the end does not name keep their positions of the start.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tominpmp.arrays import Array
from tominpmp.cell.tours.station import Rules, Station, checked_stations
from tominpmp.description.fields import Field
from tominpmp.exceptions import brief
from tominpmp.files import scenario
from tominpmp.files.records import blaming
from tominpmp.robot.robot import Robot

SECTIONS = (
    *(name for name in scenario.SECTIONS if name not in ("goal", "segments")),
    *("tour", "stations"),
)


def load_tour(path: str | Path) -> dict[str, Any]:
    """Load a scenario file with stations.

    Args:
        path: TOML file; paths in it are relative to its folder.

    Returns:
        The arguments of :func:`~tominpmp.plan_tour` by name.

    Raises:
        ScenarioError: If the file or its content is wrong, with the key.
    """
    document = scenario.read_toml(path)
    if (goal := document.get("goal")).given:
        goal.fail("belongs to a single motion, see tominpmp plan --help")
    document.only(*SECTIONS)
    robot = scenario.read_robot(document.need("robot"))
    table, start = document.get("options"), document.need("start")
    start.only("q", "state")
    q_start = scenario.positions(start, robot, None)
    options = scenario.read_options(table)
    arguments = {
        "robot": robot,
        "q_start": q_start,
        # Options that the file does not name keep the defaults of tours.
        **{name: getattr(options, name) for name in table.value or ()},
        **scenario.read_conditions(document, robot),
    }
    tour = document.get("tour")
    if tour.given:
        tour.only("end", "precedence", "configurations")
        end, count = tour.get("end"), tour.get("configurations")
        if end.value is not None:
            arguments["q_end"] = _read_end(end, robot, q_start)
        if count.value is not None:
            arguments["configurations"] = count.value
    items, precedence = document.need("stations"), tour.get("precedence")
    read = scenario.read_phase
    stations = [read(Station, item, robot, q_start) for item in items.items()]
    pairs = precedence.value or ()
    # The tour is checked when it is planned; here, errors name the key at fault.
    with blaming(items):
        Rules.of(checked_stations(stations))
    with blaming(precedence):
        Rules.of(stations, pairs)
    return arguments | {"stations": stations, "precedence": pairs}


def _read_end(end: Field, robot: Robot, q_start: Array) -> Any:
    """The end of a tour, as ``q_end`` of :func:`~tominpmp.plan_tour`."""
    if not isinstance(end.value, str):
        known = dict(zip(robot.joint_names, q_start.tolist(), strict=True))
        return scenario.row(end, robot, known)
    if end.value not in ("start", "last"):
        end.fail(f'is {brief(end.value)}, expected "start", "last" or joint positions')
    return "start" if end.value == "start" else None
