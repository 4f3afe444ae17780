"""Keys of scenario files, from the code that reads them."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Mapping

from tables import entries, field_rows, kinds

import tominpmp as tm
from tominpmp.cell.tours import tour_file
from tominpmp.cell.tours.station import Station
from tominpmp.constraints.path import PathConstraint
from tominpmp.files import scenario
from tominpmp.files.records import classes
from tominpmp.goals.base import Goal
from tominpmp.goals.joints import JointGoal
from tominpmp.motion_limits import MotionLimits
from tominpmp.problem.segments import Segment
from tominpmp.robot.payload import Payload
from tominpmp.robot.robot import load_robot
from tominpmp.scene.motion import Motion
from tominpmp.scene.obstacles import Obstacle

# Keys that are tables in a file, or are described differently there than in the code.
TABLES = {
    "robot": "Table: the robot, see `[robot]`.",
    "start": "Table: the start of the motion, see `[start]`.",
    "goal": "Table: its `type` and the keys of this type, see `[goal]`.",
    "scene": "Table with the list `obstacles`, see `[[scene.obstacles]]`.",
    "motion_limits": "Table, see `[motion_limits]`.",
    "constraints": "List of tables: path constraints, see `[[constraints]]`.",
    "segments": "List of tables instead of the goal, see `[[segments]]`.",
    "options": "Table, see `[options]`.",
    "tour": "Table: the end and the precedence of a tour, see `[tour]`.",
    "stations": "List of tables instead of the goal, see `[[stations]]`.",
}
START = {
    "q": "Joint positions [rad or m], in order or by joint name.",
    "state": "Name of a group state of the SRDF file, instead of `q`; beside it, `q` "
    "has joints by name that differ from it.",
    "v": "Joint velocities [rad/s or m/s]; at rest if left out.",
    "a": "Joint accelerations [rad/s^2 or m/s^2], for limits of jerk or torque rate; "
    "zero if left out.",
}
ROBOT = {
    "name": "Name of a robot that `tominpmp robots` lists, or of one of the package "
    "robot_descriptions.",
    "path": "Path of a URDF file, relative to the folder of the scenario.",
    "joint_limits": "Path of a `joint_limits.yaml` of MoveIt.",
    "motion_limits": "Like the table `[motion_limits]`, but for the robot itself.",
    "payloads": "List of tables, with the keys of the table of payloads below.",
}
LIMITS_FILE = "Path of a YAML file of motion limits; the other keys take precedence."
TOUR = {
    "end": '`"start"`, which is the default; `"last"` for the last station; or joint '
    "positions [rad or m], by joint name too.",
    "precedence": "Pairs of stations; the first of each pair is visited first.",
}


def rows_of(keys: Iterable[str], meanings: Mapping[str, str]) -> list[str]:
    """A table of keys; a key without a meaning leaves its cell empty."""
    rows = ["| key | meaning |", "|---|---|"]
    return rows + [f"| `{key}` | {meanings.get(key, '')} |" for key in keys]


def scenario_keys() -> list[str]:
    """Every key of a scenario file."""
    top = entries(tm.Problem.__doc__, "Attributes") | TABLES
    robot = entries(load_robot.__doc__, "Args") | ROBOT
    lines = ["## At the top", "", *rows_of(scenario.SECTIONS, top)]
    lines += ["", "## `[robot]`", "", *rows_of(scenario.ROBOT_KEYS, robot)]
    lines += ["", "## `[start]`", "", *rows_of(START, START)]
    for heading, kind in (
        ("`[motion_limits]`", MotionLimits),
        ("`[[segments]]`", Segment),
        ("Payloads", Payload),
        ("`[options]`", tm.Options),
    ):
        # A function cannot be written in a file.
        lines += ["", f"## {heading}", "", *field_rows(kind, without=("callback",))]
        if kind is MotionLimits:
            lines.append(f"| `file` | `None` | {LIMITS_FILE} |")
    joint_goal = field_rows(JointGoal, without=("joints",))
    own = {JointGoal: [*joint_goal, f"| `state` | `None` | {START['state']} |"]}
    for heading, found in (
        ("`[goal]`: types", classes(Goal)),
        ("`[[scene.obstacles]]`: types", classes(Obstacle)),
        ("`motion` of an obstacle: types", classes(Motion)),
        ("`[[constraints]]`: types", classes(PathConstraint)),
    ):
        lines += ["", f"## {heading}", "", *kinds(found, rows=own)]
    return lines


def scenario_example() -> list[str]:
    """The annotated file in the docstring of the module."""
    text = (scenario.__doc__ or "").partition("::\n")[2]
    body = textwrap.dedent(text.split("\n\nA motion of several")[0]).strip("\n")
    return ["```toml", *body.splitlines(), "```"]


def tour_keys() -> list[str]:
    """Every key that only files of tours have, and an example."""
    text = (tour_file.__doc__ or "").partition("::\n")[2]
    body = textwrap.dedent(text.split("\n\nScene, limits")[0]).strip("\n")
    told = entries(tm.plan_tour.__doc__, "Args") | TOUR
    lines = ["```toml", *body.splitlines(), "```", ""]
    more = [key for key in tour_file.SECTIONS if key not in scenario.SECTIONS]
    lines += [*rows_of(more, TABLES), "", "### `[tour]`", ""]
    lines += [*rows_of((*TOUR, "configurations"), told)]
    return [*lines, "", "### `[[stations]]`", "", *field_rows(Station)]
