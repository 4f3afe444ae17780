"""Every robot of example-robot-data: a small joint goal, verified within a time limit.

Each description known by name is loaded with all joints that have limits; every joint
is moved by a tenth of a radian (or a tenth of its range) from a
configuration near the middle of the ranges, with self-collision.
Joints whose motors are no stronger than their dry friction, like those of TALOS'
grippers (1 N m each), cannot be moved: they are locked. All times and the limit are
processor times: other load of the machine is not measured.

    python -m benchmarks.every_robot
    python -m benchmarks.every_robot --robots icub_reduced,g1 --limit 60
"""

# ruff: noqa: E402 (the environment must be set before numerical libraries load)
from __future__ import annotations

from benchmarks.sheet import Sheet, markdown, one_thread

one_thread()

import argparse
import contextlib
import time
from pathlib import Path
from typing import Any

import numpy as np

import tominpmp as tm
from tominpmp.description.files import robot_names
from tominpmp.exceptions import ProblemError, TominpmpError

COLUMNS = (
    "robot",
    "joints",
    "pairs",
    "status",
    "success",
    "verified",
    "T",
    "bound",
    "seconds",
    "load_seconds",
    "iterations",
    "programs",
    "program_seconds",
    "message",
)
# Displacement of each joint: at most, and as a share of its range [rad or m].
STEP, SHARE = 0.1, 0.1
# Shares of the ranges at which a start is tried, in this order, until links are clear;
# the first start is near zero.
PLACES = (None, 0.5, 0.45, 0.55, 0.4, 0.6, 0.3, 0.7)
# Larger ranges count as unlimited.
WIDE = 10.0


def count_processor_time() -> None:
    """Let clocks and limits, also of the planner, count processor time."""
    time.perf_counter = time.process_time


def ends(robot: Any, place: float | None) -> tuple[np.ndarray, np.ndarray]:
    """Start and goal, the goal nearer to the middle of the ranges."""
    lower = np.maximum(robot.limits.position_lower, -WIDE)
    upper = np.minimum(robot.limits.position_upper, WIDE)
    step = np.minimum(STEP, SHARE * (upper - lower))
    middle = 0.5 * (lower + upper)
    if place is None:
        start = np.clip(0.0, lower + 0.2 * step, upper - 0.2 * step)
    else:
        start = lower + place * (upper - lower)
    return start, start + np.where(start > middle, -step, step)


def load(name: str | Path, **given: Any) -> Any:
    """A robot whose joints are locked if their motors cannot move them."""
    given = {"limits": "urdf", **given}
    robot = tm.load_robot(name, **given)
    most = np.minimum(robot.limits.effort_upper, -robot.limits.effort_lower)
    stuck = [
        joint
        for joint, friction, effort in zip(
            robot.joint_names, robot.friction, most, strict=True
        )
        if 0.0 < effort <= friction
    ]
    if not stuck:
        return robot
    return tm.load_robot(name, locked_joints=dict.fromkeys(stuck, 0.0), **given)


def pose(robot: Any, acceleration: float | None = None) -> tm.Problem:
    """The first problem whose start and goal are collision-free and can be held.

    If links touch at all candidates, self-collision is switched off.

    Args:
        robot: The robot.
        acceleration: Limit of all joints [rad/s^2 or m/s^2]; None for the robot's own.

    Raises:
        TominpmpError: If no start and goal are free of collisions and can be held.
    """
    limits: dict[str, Any] = {}
    if acceleration is not None:
        limits = {"motion_limits": tm.MotionLimits(acceleration=acceleration)}
    for place in PLACES:
        start, goal = ends(robot, place)
        with contextlib.suppress(ProblemError):
            return tm.Problem(robot, start, tm.JointGoal(goal), **limits)
    start, goal = ends(robot, None)
    return tm.Problem(robot, start, tm.JointGoal(goal), self_collision=False, **limits)


def measure(name: str, limit: float) -> dict[str, object]:
    """Load a robot and move it a little: a row of the sheet."""
    row: dict[str, object] = dict.fromkeys(COLUMNS, "") | {"robot": name}
    try:
        return row | plan_little(name, limit)
    except TominpmpError as error:
        return row | {"status": type(error).__name__, "message": str(error)[:300]}


def plan_little(
    name: str | Path, limit: float, acceleration: float | None = None, **given: Any
) -> dict[str, object]:
    """Load a robot and move it a little: the columns of its row.

    Args:
        name: First argument of ``load_robot``.
        limit: Longest time of planning [s].
        acceleration: As for :func:`pose`.
        **given: Further arguments of ``load_robot``.

    Raises:
        TominpmpError: If the robot does not load. A missing problem is in the row.
    """
    row: dict[str, object] = dict.fromkeys(COLUMNS[1:], "")
    begin = time.perf_counter()
    robot = load(name, **given)
    row["joints"] = robot.n
    try:
        problem = pose(robot, acceleration)
    except TominpmpError as error:
        return row | {"status": type(error).__name__, "message": str(error)[:300]}
    row["pairs"] = len(problem.checker.pairs)
    row["load_seconds"] = time.perf_counter() - begin
    begin = time.perf_counter()
    solution = tm.plan(problem, max_planning_time=limit)
    row["seconds"] = time.perf_counter() - begin
    bound = solution.lower_bound
    judged = solution.verification
    return row | {
        "status": solution.status.name,
        "success": solution.success,
        "verified": bool(solution.success and judged is not None and judged.ok),
        "T": solution.T,
        "bound": "" if bound is None else bound.T,
        "iterations": len(solution.history),
        "programs": sum(record.programs for record in solution.history),
        "program_seconds": sum(record.program_seconds for record in solution.history),
        "message": solution.message,
    }


def main() -> int:
    """Measure, write the CSV file, print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", default=",".join(robot_names()))
    parser.add_argument(
        "--limit", type=float, default=20.0, help="seconds of the processor a robot"
    )
    parser.add_argument("--csv", type=Path, default=Path("out/every_robot.csv"))
    arguments = parser.parse_args()
    count_processor_time()
    sheet = Sheet(arguments.csv, COLUMNS)
    for name in arguments.robots.split(","):
        sheet.add(measure(name, arguments.limit))
    shown = ("robot", "joints", "pairs", "status", "verified", "T", "seconds")
    lines = [[row[key] for key in shown] for row in sheet.rows]
    print(markdown(shown, lines))
    posed = [row for row in sheet.rows if row["seconds"] != ""]
    good = sum(bool(row["verified"]) for row in posed)
    slowest = max((float(row["seconds"]) for row in posed), default=0.0)
    print(f"\n{good} of {len(posed)} verified, the slowest took {slowest:.1f} s")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
