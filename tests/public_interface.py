"""The public interface of the library as text: names, files and commands.

    python -m tests.public_interface            # show differences from the stored texts
    python -m tests.public_interface --accept   # store the texts of an intended change

The texts are in ``tests/interface``. They contain the public names of :mod:`tominpmp`
with their parameters and members, the keys of the files that are written and read, and
the help of the commands. The implementation is free to change.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import difflib
import enum
import inspect
import io
import json
import os
import re
import runpy
import sys
import tempfile
import typing
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

import tominpmp as tm

ROOT = Path(__file__).resolve().parents[1]
STORED = Path(__file__).with_name("interface")
ACCEPT = "python -m tests.public_interface --accept"
COMMANDS = (
    "plan", "batch", "verify", "replay", "play", "app", "tour", "info", "robots",
)  # fmt: skip
# Methods with underscores that users call by operators and built-in functions.
DUNDERS = ("__bool__", "__call__", "__contains__", "__getitem__", "__iter__", "__len__")
WIDE_TERMINAL = {
    "COLUMNS": "200",
    "NO_COLOR": "1",
    "TERM": "dumb",
    "_TYPER_STANDARD_TRACEBACK": "",
}


# -- names -----------------------------------------------------------------------------


def names() -> str:
    """Public names with their parameters, fields, methods and values."""
    return "\n".join(line for name in sorted(tm.__all__) for line in _described(name))


def _described(name: str) -> Iterator[str]:
    value = getattr(tm, name)
    if not inspect.isclass(value):
        yield f"{name}{_parameters(value)}"
        return
    kinds = [base.__name__ for base in value.__mro__[1:-1]]
    bases = [kind for kind in kinds if kind in tm.__all__ or kind.endswith("Error")]
    yield f"{name}({', '.join(bases)})" if bases else name
    if issubclass(value, enum.Enum):
        yield from (f"    {item.name} = {item.value!r}" for item in value)
        return
    if issubclass(value, Warning):
        return
    yield f"    {name}{_parameters(value)}"
    if dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            if not field.name.startswith("_"):
                yield f"    .{field.name}{_choices(value, field.name)}"
    for member in sorted(_members(value)):
        found = inspect.getattr_static(value, member)
        if isinstance(found, classmethod | staticmethod) or inspect.isfunction(found):
            yield f"    .{member}{_parameters(getattr(value, member))}"
        else:
            yield f"    .{member}"


def _members(kind: type[Any]) -> set[str]:
    """Members of a class, except its fields and those of public base classes."""
    fields = (
        {item.name for item in dataclasses.fields(kind)}
        if (dataclasses.is_dataclass(kind))
        else set()
    )
    found = set()
    for base in kind.__mro__:
        if base.__module__.partition(".")[0] != "tominpmp":
            continue
        if base is not kind and base.__name__ in tm.__all__:
            break
        for name, value in vars(base).items():
            shown = (
                callable(value)
                or isinstance(value, property | classmethod | staticmethod)
                or type(value).__name__ == "cached_property"
            )
            if shown and (not name.startswith("_") or name in DUNDERS):
                found.add(name)
    return found - fields


def _parameters(value: Any) -> str:
    """Names, kinds and defaults of the parameters, without their annotations."""
    try:
        signature = inspect.signature(value)
    except (TypeError, ValueError):
        return "(?)"
    bare = [
        item.replace(annotation=inspect.Parameter.empty)
        for item in signature.parameters.values()
        if item.name != "self"
    ]
    text = signature.replace(parameters=bare, return_annotation=inspect.Signature.empty)
    return re.sub(r" object at 0x[0-9a-f]+", "", str(text))


def _choices(kind: type[Any], name: str) -> str:
    """Values of a field that is one of several words."""
    try:
        hints = typing.get_type_hints(kind, localns=vars(tm) | {"Any": Any})
    except NameError:
        return ""
    words = list(_words(hints.get(name)))
    return f" in {words}" if words else ""


def _words(hint: Any) -> Iterator[Any]:
    if typing.get_origin(hint) is typing.Literal:
        yield from typing.get_args(hint)
    else:
        for part in typing.get_args(hint):
            yield from _words(part)


# -- files -----------------------------------------------------------------------------

# Scenario files that together have every key; the stored text is that of the files
# after they are read and written again. Obstacles are far from the plane of the arm.
ARM = '[robot]\nname = "planar3r"\n'
JOINT_GOAL = '[goal]\ntype = "joint"\nq = [0.2, 1.0, -1.0]\n'
START = "[start]\nq = [0.5, 1.7, -1.7]\n"
SCENARIOS = {
    "robot, start and options": """
margin = 0.01
self_collision = false
[robot]
name = "planar3r"
gravity = [0.0, -5.0, 0.0]
position_lower = -3.0
position_upper = {joint1 = 3.0}
velocity = 5.0
effort = [[-90.0, 80.0], [-50.0, 50.0], [-20.0, 20.0]]
damping = 0.1
armature = {joint2 = 0.01}
friction = [0.1, 0.0, 0.0]
[robot.motion_limits]
acceleration = 50.0
[[robot.payloads]]
mass = 0.2
frame = "tip"
com = [0.0, 0.1, 0.0]
inertia = [[1e-3, 0.0, 0.0], [0.0, 1e-3, 0.0], [0.0, 0.0, 1e-3]]
name = "tool"
[[robot.payloads.geometry]]
type = "sphere"
name = "ball"
radius = 0.1
[start]
q = {joint1 = 0.5, joint2 = 1.7, joint3 = -1.7}
v = [0.1, 0.0, 0.0]
[goal]
type = "joint"
q = {joint1 = 0.2}
v = {joint1 = 0.1}
[motion_limits]
acceleration = 20.0
jerk = [100.0, 200.0, inf]
effort_rate = {joint1 = 500.0}
effort_scale = 0.9
[motion_limits.effort_curves.joint2]
speed = [0.0, 2.0]
effort = [40.0, 20.0]
[options]
method = "adjoint"
intervals = 20
grid = "uniform"
control = "constant"
objective = "feasible"
effort = "quick"
energy_weight = 1e-4
energy = "work"
slack = 0.01
refine = "grid"
smoothing = 0.0
starts = 2
seed = 3
max_planning_time = 5.0
max_iterations = 50
tolerance = 1e-3
feasibility = 1e-5
goal_tolerance = 2e-3
speed_tolerance = 2e-2
limit_tolerance = 1e-2
contact_tolerance = 1e-4
trust_region = 0.2
step_rule = "paper"
control_step = 0.1
time_step = 0.02
initial_duration = 2.0
initial_control = [1.0, 0.0, 0.0]
lp_solver = "highs"
control_period = 0.01
processes = 2
""",
    "start by a state of a group": ARM
    + '[start]\nstate = "start"\n'
    + '[goal]\ntype = "position"\nframe = "tip"\nposition = [4.0, 1.0, 0.0]\n'
    + '[options]\nrefine = "none"\n',
    "files of a robot": """
[robot]
path = "arm.urdf"
srdf = "arm.srdf"
group = "arm"
locked_joints = {joint3 = 0.1}
joint_limits = "joint_limits.yaml"
[start]
q = [0.4, 0.5]
[goal]
type = "joint_region"
q = [0.5]
joints = ["joint1"]
tolerance = 0.1
""",
    "limits of a data sheet": """
[robot]
name = "panda"
limits = "datasheet"
locked_joints = {panda_finger_joint1 = 0.0, panda_finger_joint2 = 0.0}
[start]
state = "default"
[goal]
type = "joint"
q = {panda_joint1 = 0.5}
""",
    "obstacles": ARM
    + START
    + JOINT_GOAL
    + """
[[scene.obstacles]]
type = "box"
name = "box"
size = [1.0, 2.0, 3.0]
position = [0.0, 0.0, 10.0]
rotation = [0.0, 0.0, 0.6, 0.8]
[[scene.obstacles]]
type = "sphere"
name = "sphere"
radius = 0.5
position = [0.0, 0.0, 20.0]
[scene.obstacles.motion]
type = "constant_velocity"
velocity = [0.1, 0.0, 0.0]
angular = [0.0, 0.0, 0.2]
pivot = [0.0, 0.0, 21.0]
begin = 0.5
end = 2.0
[[scene.obstacles]]
type = "cylinder"
name = "cylinder"
radius = 0.5
length = 2.0
position = [0.0, 0.0, 30.0]
[scene.obstacles.motion]
type = "waypoints"
times = [0.0, 1.0]
positions = [[0.0, 0.0, 30.0], [1.0, 0.0, 30.0]]
rotations = [[0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.6, 0.8]]
[[scene.obstacles]]
type = "capsule"
name = "capsule"
radius = 0.5
length = 2.0
position = [0.0, 0.0, 40.0]
[[scene.obstacles]]
type = "height_field"
name = "ground"
heights = [[0.0, 0.1], [0.2, 0.0]]
size = [1.0, 1.0]
base = -0.5
position = [0.0, 0.0, -20.0]
[[scene.obstacles]]
type = "mesh"
name = "mesh"
vertices = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
triangles = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
scale = 2.0
convex = "hull"
position = [0.0, 0.0, 50.0]
[[scene.obstacles]]
type = "oc_tree"
name = "points"
points = [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]]
resolution = 0.05
position = [0.0, 0.0, 60.0]
""",
    "constraints": 'may_touch = [["link1", "wall"]]\n'
    + ARM
    + START
    + JOINT_GOAL
    + """
[[scene.obstacles]]
type = "box"
name = "wall"
size = [1.0, 1.0, 1.0]
position = [0.0, 0.0, 10.0]
[[constraints]]
type = "tool_speed"
frame = "tip"
limit = 2.0
during = [0.0, 0.5]
[[constraints]]
type = "tool_acceleration"
frame = "tip"
limit = 200.0
[[constraints]]
type = "keep_upright"
frame = "tip"
axis = [0.0, 0.0, 1.0]
direction = [0.0, 0.1, 1.0]
tolerance = 0.5
[[constraints]]
type = "axis_fixed"
frame = "tip"
tolerance = 0.1
[[constraints]]
type = "keep_orientation"
frame = "tip"
rotation = [0.0, 0.0, 0.1, 0.99]
tolerance = 3.0
[[constraints]]
type = "keep_away"
frame = "tip"
point = [0.0, 0.0, 5.0]
distance = 0.1
[[constraints]]
type = "within_region"
frame = "tip"
lower = [-10.0, -10.0, -10.0]
upper = [10.0, 10.0, inf]
[constraints.pose]
position = [0.1, 0.0, 0.0]
rotation = [0.0, 0.0, 0.0, 1.0]
[[constraints]]
type = "tool_line"
frame = "tip"
start = [0.0, 0.0, 0.0]
end = [5.0, 5.0, 0.0]
radius = 10.0
[[constraints]]
type = "tool_polyline"
frame = "tip"
points = [[0.0, 0.0, 0.0], [5.0, 5.0, 0.0], [6.0, 5.0, 0.0]]
radius = 10.0
[[constraints]]
type = "tool_arc"
frame = "tip"
center = [0.0, 0.0, 0.0]
start = [5.0, 0.0, 0.0]
axis = [0.0, 0.0, 1.0]
angle = 3.0
radius = 10.0
[[constraints]]
type = "joint_coupling"
joints = ["joint1", "joint2"]
weights = [1.0, 0.5]
upper = 3.0
lower = -3.0
[[constraints]]
type = "stable_contact"
frame = "tip"
center = [0.0, 0.0, 0.01]
friction = 30.0
support = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]
mass = 0.1
inertia = [[1e-3, 0.0, 0.0], [0.0, 1e-3, 0.0], [0.0, 0.0, 1e-3]]
adhesion = 50.0
[[constraints]]
type = "firm_grasp"
frame = "tip"
force = 500.0
friction = 0.9
mass = 0.1
center = [0.0, 0.0, 0.01]
axis = [0.0, 0.0, 1.0]
pad_radius = 0.05
inertia = [[1e-3, 0.0, 0.0], [0.0, 1e-3, 0.0], [0.0, 0.0, 1e-3]]
""",
    "segments": ARM
    + START
    + """
[[segments]]
stop = true
may_touch = [["link1", "wall"]]
arrival = [0.5, 20.0]
[segments.goal]
type = "position"
frame = "tip"
position = [4.0, 1.0, 0.0]
tolerance = 0.01
[segments.payload]
mass = 0.1
frame = "tip"
name = "part"
[segments.motion_limits]
acceleration = 30.0
[[segments.constraints]]
type = "tool_speed"
frame = "tip"
limit = 3.0
[[segments.scene.obstacles]]
type = "box"
name = "wall"
size = [1.0, 1.0, 1.0]
position = [0.0, 0.0, 10.0]
[[segments]]
dwell = 0.2
[segments.goal]
type = "pose"
frame = "tip"
tolerance = 0.01
angle_tolerance = 0.1
[segments.goal.pose]
position = [4.0, 1.5, 0.0]
rotation = [0.0, 0.0, 0.1, 0.99]
[[segments]]
[segments.goal]
type = "axis"
frame = "tip"
axis = [1.0, 0.0, 0.0]
direction = [0.0, 1.0, 0.0]
position = [3.0, 2.0, 0.0]
v = [0.1, 0.0, 0.0]
tolerance = 0.02
angle_tolerance = 0.1
[[segments]]
[segments.goal]
type = "region"
frame = "tip"
lower = [3.0, 1.0, -1.0]
upper = [4.0, 2.0, 1.0]
angle_tolerance = [3.0, 3.0, 1.0]
[[segments]]
[segments.goal]
type = "any"
[[segments.goal.goals]]
type = "joint"
q = [0.2, 1.0, -1.0]
[[segments.goal.goals]]
type = "joint"
q = [0.3, 1.1, -1.0]
joints = ["joint1", "joint2", "joint3"]
[[segments]]
[segments.goal]
type = "all"
[[segments.goal.goals]]
type = "joint_region"
q = [0.2]
joints = ["joint1"]
tolerance = 0.1
[[segments.goal.goals]]
type = "position"
frame = "tip"
position = [4.0, 1.0, 0.0]
""",
}
TOUR = (
    ARM
    + START
    + """
[tour]
end = "last"
precedence = [["first", "second"]]
configurations = 3
[options]
intervals = 8
effort = "quick"
refine = "none"
[[stations]]
name = "first"
dwell = 0.1
[stations.goal]
type = "joint"
q = [0.4, 1.6, -1.6]
[[stations]]
name = "second"
[stations.goal]
type = "joint"
q = [0.3, 1.5, -1.5]
"""
)


def files() -> str:
    """Scenario files read and written again, and the contents of motion files."""
    with tempfile.TemporaryDirectory() as folder:
        parts = [*_scenarios(Path(folder)), *_motions(Path(folder))]
    return "\n".join(parts)


def _scenarios(folder: Path) -> Iterator[str]:
    """Each scenario file as it is written again; a second time changes nothing."""
    (folder / "arm.urdf").write_text((ROOT / "robots/planar3r.urdf").read_text())
    (folder / "arm.srdf").write_text((ROOT / "robots/planar3r.srdf").read_text())
    limits = "joint_limits:\n  joint1: {has_velocity_limits: true, max_velocity: 2.0}\n"
    (folder / "joint_limits.yaml").write_text(limits)
    for name, text in SCENARIOS.items():
        path = folder / "scenario.toml"
        path.write_text(text, encoding="utf-8")
        rewritten = folder / "again.toml"
        scenario = tm.load_scenario(path)
        tm.save_scenario(rewritten, scenario.problem, scenario.options)
        written = rewritten.read_text(encoding="utf-8")
        tm.save_scenario(path, *_problem_and_options(tm.load_scenario(rewritten)))
        if path.read_text(encoding="utf-8") != written:
            raise ValueError(
                f"{name}: the file changes when it is read and written again"
            )
        yield f"---- scenario: {name}\n{written}"
    path.write_text(TOUR, encoding="utf-8")
    yield f"---- tour: {_tour(path)}\n"


def _problem_and_options(scenario: tm.Scenario) -> tuple[tm.Problem, tm.Options]:
    return scenario.problem, scenario.options


def _tour(path: Path) -> str:
    """The first sentence that the command prints about a tour."""
    return re.split(r"\.\s", printed("tour", str(path))[0])[0]


def motion() -> tm.Samples:
    """A short motion of two joints in two segments."""
    t = np.array([0.0, 0.5, 1.0])
    rows = np.column_stack([t, 2.0 * t])
    ends = np.array([0.5, 1.0])
    names = ("one", "two")
    return tm.Samples(names, t, rows, rows, rows, rows, segment_ends=ends)


def _motions(folder: Path) -> Iterator[str]:
    """Columns and keys of files of motions."""
    samples = motion()
    values = {key: getattr(samples, key) for key in ("t", "q", "v", "u")}
    trajectory = tm.Trajectory(
        samples.joint_names, **values, segment_ends=samples.segment_ends
    )
    robot = _two_joints()
    problem = tm.Problem(robot, [0.0, 0.0], tm.JointGoal([1.0, 2.0]))
    solution = tm.Solution(
        problem, tm.Options(), tm.Status.FEASIBLE, "", True, trajectory
    )
    for ending in ("csv", "npz"):
        path = solution.export(folder / f"motion.{ending}", verify=False)
        yield f"---- motion: {ending}"
        if ending == "csv":
            yield path.read_text(encoding="utf-8").split("\n")[0]
        else:
            with np.load(path, allow_pickle=False) as data:
                yield "\n".join(f"{k}: {data[k].shape}" for k in sorted(data))
        yield f"read as: {_shapes(tm.load_motion(path))}\n"
    for message in ("JointTrajectory", "FollowJointTrajectory", "RobotTrajectory"):
        for ending in ("yaml", "json"):
            name = folder / f"motion.{ending}"
            path = solution.export(
                name, with_effort=True, message=message, verify=False
            )
            keys = re.findall(r'[\w"]+(?=:)', path.read_text(encoding="utf-8"))
            yield f"---- motion: {message} as {ending}"
            yield " ".join(dict.fromkeys(key.strip('"') for key in keys))
            yield f"read as: {_shapes(tm.load_motion(path))}\n"


def _shapes(samples: tm.Samples) -> str:
    parts = [
        f"{key} {getattr(samples, key).shape}" for key in ("t", "q", "v", "a", "u")
    ]
    ends = samples.segment_ends
    known = "without" if ends is None else "with"
    return f"{', '.join(parts)}, {samples.interpolation}, {known} segments"


def _two_joints() -> tm.Robot:
    links = "".join(
        f'<link name="{name}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" '
        'izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        for name in ("base", "a", "b")
    )
    joints = "".join(
        f'<joint name="{name}" type="revolute"><parent link="{parent}"/>'
        f'<child link="{child}"/><axis xyz="0 0 1"/><limit lower="-3" upper="3" '
        'velocity="9" effort="99"/></joint>'
        for name, parent, child in (("one", "base", "a"), ("two", "a", "b"))
    )
    return tm.load_robot(f'<robot name="two">{links}{joints}</robot>')


# -- commands --------------------------------------------------------------------------


# Commands that are run; the keys of their reports and their exit codes are stored.
TASK = ("planar3r", "--start", "start", "--goal", "0.2", "1.2", "-1.2")
QUICK = ("--intervals", "8", "--planning-effort", "quick", "--refine", "none")
RUNS = (
    ("plan", *TASK, *QUICK, "--json", "--output", "motion.csv"),
    ("verify", *TASK, "motion.csv", "--json"),
    ("info", "planar3r", "--json"),
    ("verify", *TASK, "missing.csv"),
    ("plan", "planar3r", "--start", "start", "--goal", "99", "0", "0"),
    ("plan", *TASK, "--intervals", "-1"),
    ("no-such-command",),
)


def commands() -> str:
    """Help and flags of every command, and the keys of the reports."""
    parts = []
    for name in ("", *COMMANDS):
        words = [name, "--help"] if name else ["--help"]
        text, _ = printed(*words)
        flags = sorted(set(re.findall(r"(?<![\w-])--?[a-zA-Z][\w-]*", text)))
        parts += [f"---- flags of tominpmp {name}".rstrip(), *flags, ""]
        parts.append(f"---- help of tominpmp {name}".rstrip())
        parts += [*(line.rstrip() for line in text.splitlines()), ""]
    with tempfile.TemporaryDirectory() as folder:
        for words in RUNS:
            own = [
                f"{folder}/{word}" if word.endswith(".csv") else word for word in words
            ]
            text, code = printed(*own)
            parts.append(f"---- tominpmp {' '.join(words)}: exit code {code}")
            if "--json" in words:
                parts += sorted(set(_keys(json.loads(text), "")))
            parts.append("")
    return "\n".join(parts)


def _keys(value: Any, place: str) -> Iterator[str]:
    """Paths of the values in a report with their types; names of joints are *."""
    if isinstance(value, dict):
        for key, item in value.items():
            name = re.sub(r"^(joint\d|link\d|base|tip)$", "*", key)
            yield from _keys(item, f"{place}.{name}")
    elif isinstance(value, list) and value:
        for item in value:
            yield from _keys(item, f"{place}[]")
    else:
        yield f"{place}: {type(value).__name__}"


def printed(*words: str) -> tuple[str, int]:
    """Output of the command line, run in this process, and its exit code.

    Args:
        *words: The command and its arguments.
    """
    out, code = io.StringIO(), 0
    with (
        mock.patch.object(sys, "argv", ["tominpmp", *words]),
        mock.patch.dict(os.environ, WIDE_TERMINAL),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(io.StringIO()),
    ):
        try:
            # Another test may have imported the module, which has to run anew.
            sys.modules.pop("tominpmp.__main__", None)
            runpy.run_module("tominpmp", run_name="__main__")
        except SystemExit as end:
            code = int(end.code or 0)
    return out.getvalue(), code


# -- the stored texts ------------------------------------------------------------------

PARTS: dict[str, Callable[[], str]] = {
    "names": names,
    "files": files,
    "commands": commands,
}


def stored(part: str) -> Path:
    """Path of a stored text."""
    return STORED / f"{part}.txt"


def difference(part: str) -> str:
    """Difference of a text from the stored text; empty if they are equal.

    Args:
        part: One of :data:`PARTS`.
    """
    path = stored(part)
    before = path.read_text(encoding="utf-8") if path.exists() else ""
    after = PARTS[part]().rstrip() + "\n"
    lines = difflib.unified_diff(
        before.splitlines(), after.splitlines(), "stored", "now", lineterm="", n=2
    )
    return "\n".join(lines)


def main() -> int:
    """Show differences, or store the texts anew; 1 if there are differences."""
    parser = argparse.ArgumentParser(prog="python -m tests.public_interface")
    parser.add_argument("--accept", action="store_true", help="store the texts anew")
    accept = parser.parse_args().accept
    different = False
    for part in PARTS:
        lines = difference(part)
        different |= bool(lines)
        if lines:
            print(lines)
        if accept:
            STORED.mkdir(exist_ok=True)
            stored(part).write_text(PARTS[part]().rstrip() + "\n", encoding="utf-8")
    return int(different and not accept)


if __name__ == "__main__":
    raise SystemExit(main())
