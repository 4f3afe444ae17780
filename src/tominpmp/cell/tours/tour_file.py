"""Tours in scenario files: stations in place of a goal.

::

    [robot]
    name = "ur5"

    [start]
    q = [0.0, -1.8, 2.2, -2.0, -1.6, 0.0]

    [tour]                              # may be left out
    end = "start"                       # the default; "last", or q by joint
    precedence = [["drill", "tap"]]     # what comes first
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

Scene, limits, constraints and options are those of any other scenario; joints that a
station does not name are where the tour starts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from tominpmp.arrays import Array
from tominpmp.cell.tours import Station, Tour, plan_tour
from tominpmp.description.fields import Field
from tominpmp.description.paths import checked_path
from tominpmp.exceptions import ProblemError, ScenarioError, TominpmpError, brief
from tominpmp.files.robot_table import read_robot
from tominpmp.files.scenario import read_options, read_toml
from tominpmp.files.scenario_tables import (
    positions,
    read_conditions,
    read_goal,
    read_pairs,
    read_payload,
    vector,
)
from tominpmp.options import Options
from tominpmp.robot import Robot

SECTIONS = (
    "margin",
    "self_collision",
    "robot",
    "start",
    "scene",
    "motion_limits",
    "constraints",
    "may_touch",
    "options",
    "tour",
    "stations",
)
KEYS = tuple(field.name for field in fields(Station))


@dataclass(frozen=True, eq=False)
class TourScenario:
    """What a tour is planned from.

    Attributes:
        robot: The robot.
        q_start: Where it starts, shape (n,) [rad or m].
        stations: The stations.
        arguments: What else :func:`~tominpmp.cell.tours.plan_tour` takes, by name.
        options: The options that the file gives; None for none.
    """

    robot: Robot
    q_start: Array
    stations: tuple[Station, ...]
    arguments: Mapping[str, Any]
    options: Options | None

    def plan(self, **changes: Any) -> Tour:
        """Plan the tour; see :func:`~tominpmp.cell.tours.plan_tour`.

        Args:
            **changes: Options by name.
        """
        return plan_tour(
            self.robot,
            self.q_start,
            self.stations,
            options=self.options,
            **self.arguments,
            **changes,
        )


def load_tour(path: str | Path) -> TourScenario:
    """Load a scenario file with stations.

    Args:
        path: TOML file; paths in it are relative to its folder.

    Returns:
        What the tour is planned from.

    Raises:
        ScenarioError: If the file, or what it describes, is wrong, with the key.
    """
    path = checked_path(path, "path", ScenarioError)
    document = Field(read_toml(path), path)
    document.only(*SECTIONS)
    robot = read_robot(document.need("robot"))
    options = document.get("options")
    start = document.need("start")
    start.only("q", "state")
    q_start = positions(start, robot, None)
    arguments = read_conditions(document, robot)
    arguments |= _read_tour(document.get("tour"), robot)
    items = document.need("stations").items()
    return TourScenario(
        robot,
        q_start,
        tuple(_read_station(item, robot, q_start) for item in items),
        arguments,
        read_options(options) if options.given else None,
    )


def _read_tour(table: Field, robot: Robot) -> dict[str, Any]:
    """Where a tour ends, and what comes first."""
    found: dict[str, Any] = {}
    if not table.given:
        return found
    table.only("end", "precedence", "configurations")
    end, count = table.get("end"), table.get("configurations")
    if isinstance(end.value, str):
        if end.value not in ("start", "last"):
            end.fail(
                f'is {brief(end.value)}, expected "start", "last" or joint positions'
            )
        found["q_end"] = "start" if end.value == "start" else None
    elif end.value is not None:
        found["q_end"] = vector(end, robot)
    found["precedence"] = read_pairs(
        table.get("precedence"), "of a station and of one that comes later"
    )
    if count.value is not None:
        found["configurations"] = count.value
    return found


def _read_station(table: Field, robot: Robot, q_start: Array) -> Station:
    table.only(*KEYS)
    dwell, stop = table.get("dwell"), table.get("stop")
    try:
        return Station(
            table.need("name").text(),
            read_goal(table.need("goal"), robot, q_start),
            dwell=0.0 if dwell.value is None else dwell.number(),
            after=[name.text() for name in table.get("after").items()],
            then=[name.text() for name in table.get("then").items()],
            payload=read_payload(table.get("payload")),
            stop=True if stop.value is None else stop.flag(),
            may_touch=read_pairs(table.get("may_touch")),
        )
    except ProblemError as error:
        field = (error.field or "").removeprefix("station.")
        (table.get(field) if field in KEYS else table).fail(str(error))


def blamed(path: Path, error: TominpmpError) -> ScenarioError:
    """An error about a tour as one about the file that it was read from."""
    return ScenarioError(f"{path}: {error}", path, getattr(error, "field", None))
