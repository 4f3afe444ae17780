"""Invalid arguments of commands: exit code 2, and one line that names the argument."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
from cli_samples import (
    Planner,
    Run,
)

BAD = {
    "unknown robot": ("plan planer3r --start 1 --goal 1", "did you mean planar3r"),
    "missing file": ("plan ./no.urdf --start 1 --goal 1", "no.urdf"),
    "no number": (
        "plan planar3r --start 1,x,2 --goal 1,1,1",
        "got 'x', expected a number",
    ),
    "a word too many": (
        "plan planar3r --start 1 2 x --goal 1,1,1",
        "'x': neither an option nor a value of the preceding option",
    ),
    "wrong count": (
        "plan planar3r --start 1,2 --goal 1,1,1",
        "--start has 2 numbers, expected 3, one for each of: joint1, joint2, joint3",
    ),
    "too many": (
        "plan planar3r --start start --goal 1,1,1,1",
        "--goal has 4 numbers",
    ),
    "nothing": (
        "plan planar3r --start '' --goal 1,1,1",
        "--start: has no joint positions, expected q (numbers for joint1, joint2, "
        "joint3) or state (a group state)",
    ),
    "NaN": (
        "plan planar3r --start 1,nan,1 --goal 1,1,1",
        "--start: joint 'joint2' is nan, expected a finite",
    ),
    "infinite": ("plan planar3r --start start --goal 1,1,inf", "inf"),
    "outside": ("plan planar3r --start 0.1,0,0 --goal 1,1,1", "[0.18, 3]"),
    "unknown state": (
        "plan planar3r --start home --goal 1,1,1",
        "--start: there is no group state 'home'; the robot has: start",
    ),
    "unknown joint": (
        "plan planar3r --start start --goal elbow=1",
        "--goal has a value for 'elbow', expected a value for each of: joint1, joint2",
    ),
    "joint twice": ("plan planar3r --start start --goal joint1=1,joint1=2", "twice"),
    "half a pair": ("plan planar3r --start start --goal joint1=", "JOINT=VALUE"),
    "sensitivities of energy": (
        "plan planar3r --start start --goal 1,1,1 --energy-weight 1e-4 "
        "--sensitivities held.svg",
        "error: --energy-weight is 0.0001, expected 0: sensitivities are known for",
    ),
    "one file for two plots": (
        "plan planar3r --start start --goal 1,1,1 --plot a.svg --certificate ./a.svg",
        "two options write 'a.svg'",
    ),
    "unknown frame": (
        "plan planar3r --start start --goal-position nose 1 1 0",
        "no frame 'nose'; the robot has: base,",
    ),
    "beyond reach": (
        "plan planar3r --start start --goal-position tip 7 0 0",
        "outside reach by 1 m",
    ),
    "no quaternion": (
        "plan planar3r --start start --goal-pose tip 1 1 0 0 0 0 0",
        "or a quaternion (x, y, z, w) of finite numbers other than zero",
    ),
    "pose of NaN": (
        "plan planar3r --start start --goal-pose tip 1 1 0 0 0 nan 1",
        "--goal-pose is not finite",
    ),
    "no goal": ("plan planar3r --start start", "there is no goal"),
    "two goals": (
        "plan planar3r --start start --goal 1,1,1 --goal-position tip 1 1 0",
        "--goal and --goal-position are given",
    ),
    "velocity of two": (
        "plan planar3r --start start --goal 1,1,1 --start-velocity 1,2",
        "--start-velocity has 2 numbers",
    ),
    "velocity of a stranger": (
        "plan planar3r --start start --goal 1,1,1 --goal-velocity hand=1",
        "--goal-velocity has a value for 'hand', expected a value for each of",
    ),
    "frame velocity of two": (
        "plan planar3r --start start --goal-position tip 4 1 0 --goal-velocity 1,2",
        "--goal-velocity is [1.0, 2.0], expected three components [m/s]",
    ),
    "weak": ("plan planar3r --start start --goal 1,1,1 --effort 1", "cannot hold"),
    "effort by stranger": (
        "plan planar3r --start start --goal 1,1,1 --effort elbow=1",
        "error: --effort: there is no joint 'elbow'",
    ),
    "acceleration of two": (
        "plan planar3r --start start --goal 1,1,1 --acceleration=1,2",
        "error: --acceleration has 2 numbers, expected 3",
    ),
    "turning of a stranger": (
        "plan planar3r --start start --goal 1,1,1 --wrap elbow",
        "error: --wrap: there is no joint 'elbow'",
    ),
    "turning without a configuration": (
        "plan planar3r --start start --goal-position tip 4 1 0 --wrap joint1",
        "error: --wrap is about the joints of a --goal",
    ),
    "obstacle as far as numbers go": (
        "plan planar3r --start start --goal 1,1,1 --obstacle sphere:a:r=1:at=1e308,0,0",
        ".position: is [1e+308, 0.0, 0.0], expected three coordinates [m], all finite, "
        "within 1e+06",
    ),
    "unknown ROS message": (
        "plan planar3r --start start --goal 1,1,1 -o m.csv --ros-message Joint",
        "error: --ros-message is 'Joint', expected one of",
    ),
    "margin below zero": (
        "plan planar3r --start start --goal 1,1,1 --margin -1",
        "error: --margin is -1.0, expected a finite number >= 0",
    ),
    "group of strangers": (
        "info planar3r --group joint1,elbow",
        "--group: there is no",
    ),
    "limit of a scenario's robot": (
        "info free.toml --effort 3",
        "error: --effort contradicts a scenario file",
    ),
    "search effort as torque limit": (
        "plan planar3r --start start --goal 1,1,1 --effort quick",
        "how far to search is --planning-effort quick",
    ),
    "torque limit as search effort": (
        "plan planar3r --start start --goal 1,1,1 --planning-effort 30",
        "Torque limits are --effort",
    ),
    "gravity of two": ("info planar3r --gravity 0,1", "gravity"),
    "lock without value": ("info planar3r --lock joint1", "'joint1', expected JOINT="),
    "lock twice": ("info planar3r --lock joint1=1 --lock joint1=2", "twice"),
    "lock of stranger": (
        "info planar3r --lock elbow=1",
        "error: --lock: there is no joint 'elbow'",
    ),
    "no package folder": ("info planar3r --package-dir ./none", "none"),
    "no srdf": ("info planar3r --srdf none.srdf", "none.srdf"),
    "margin": ("plan planar3r --start start --goal 1,1,1 --margin -1", "margin is -1"),
    "obstacle kind": (
        "plan planar3r --start start --goal 1,1,1 --obstacle torus:x:r=1",
        "torus:x:r=1': there is no kind 'torus'; there are: sphere, box, cylinder",
    ),
    "obstacle name": (
        "plan planar3r --start start --goal 1,1,1 --obstacle sphere:r=1:at=1,1,1",
        "it has no name",
    ),
    "obstacle key": (
        "plan planar3r --start start --goal 1,1,1 --obstacle sphere:x:size=1:at=1,1,1",
        "size: there is no such key; there are: name, position, rotation",
    ),
    "obstacle lacks": (
        "plan planar3r --start start --goal 1,1,1 --obstacle box:x:at=1,1,1",
        "size: is missing",
    ),
    "obstacle value": (
        "plan planar3r --start start --goal 1,1,1 --obstacle box:x:0.1:at=1,1,1",
        "error: --obstacle 'box:x:0.1:at=1,1,1': 0.1 lacks =VALUE; expected KIND:NAME",
    ),
    "obstacle without a place": (
        "plan planar3r --start start --goal 1,1,1 --obstacle sphere:x:r=1",
        "it lacks at=X,Y,Z",
    ),
    "obstacle numbers": (
        "plan planar3r --start start --goal 1,1,1 --obstacle sphere:x:r=1:at=1,1",
        "expected three coordinates",
    ),
    "obstacle size": (
        "plan planar3r --start start --goal 1,1,1 --obstacle sphere:x:r=-1:at=9,9,0",
        ".radius: is -1.0, expected a positive length",
    ),
    "obstacle twice": (
        "plan planar3r --start start --goal 1,1,1 --obstacle sphere:x:r=1:at=9,9,0 "
        "--obstacle sphere:x:r=1:at=9,9,0",
        "two obstacles are named 'x'",
    ),
    "in collision": (
        "plan planar3r --start start --goal 1,1,1 --obstacle sphere:x:r=1:at=3,1,0",
        "start in collision: link 'link1' and obstacle 'x' overlap",
    ),
    "method": ("plan planar3r --start start --goal 1,1,1 --method best", "'best'"),
    "intervals": (
        "plan planar3r --start start --goal 1,1,1 --intervals 1",
        "intervals is 1, expected an integer >= 4",
    ),
    "time": (
        "plan planar3r --start start --goal 1,1,1 --max-time 0",
        "--max-time is 0.0, expected a positive number",
    ),
    "dt": ("plan planar3r --start start --goal 1,1,1 --dt nan", "--dt is nan"),
    "short dt": ("plan planar3r --start start --goal 1,1,1 --dt 1e-12", "1e-07 s at"),
    "ending": (
        "plan planar3r --start start --goal 1,1,1 -o motion.txt",
        "--output: 'motion.txt' must end in .csv or .npz",
    ),
    "plot": (
        "plan planar3r --start start --goal 1,1,1 --plot motion.csv",
        "--plot: 'motion.csv' must end in .png or .pdf or .svg",
    ),
    "folder": (
        "plan planar3r --start start --goal 1,1,1 --html no/where.html",
        "there is no folder 'no'",
    ),
    "two outputs": (
        "plan planar3r --start start --goal 1,1,1 --json --output -",
        "both write to standard output",
    ),
    "no file": ("play none.csv --robot planar3r", "there is no file none.csv"),
    # Refused by the parser.
    "no robot": ("plan --start 1", "ROBOT"),
    "no start": ("plan planar3r --goal 1,1,1", "'planar3r' is not a scenario file"),
    "empty robot": ("plan ''", "'' is not a scenario file"),
    "folder as a robot": ("plan /", "'/' is a folder, not a scenario file (.toml)"),
    "no folder": ("batch nowhere", "there is no folder or file nowhere"),
    "option": ("plan planar3r --sart 1,1,1", "--sart"),
    "command": ("paln planar3r", "paln"),
    "float": ("plan planar3r --start start --goal 1,1,1 --margin big", "--margin"),
    "integer": ("plan planar3r --start start --goal 1,1,1 --seed 1.5", "--seed"),
    "short point": ("plan planar3r --start start --goal-position tip 1 2", "position"),
    "word as a point": (
        "plan planar3r --start start --goal-position tip 1 2 up",
        "--goal-position",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_invalid_argument_is_an_error_with_one_line(
    case: str, run: Run, planner: Planner, tmp_path: Path
) -> None:
    text, message = BAD[case]
    result = run(*shlex.split(text))
    assert result.exit_code == 2
    assert result.stdout == ""
    paragraph, *rest = result.stderr.splitlines()
    assert paragraph.startswith("error: ")
    assert message in paragraph
    assert all(re.fullmatch(r"see [\w -]+ --help", line) for line in rest)
    assert planner.problem is None
    assert list(tmp_path.iterdir()) == []
