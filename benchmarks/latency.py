"""Latency: duration of plans with the default time limit of their effort.

    python -m benchmarks.latency
    python -m benchmarks.latency --efforts quick,standard --every 4 --data DIR

The problems are those of the golden set without a limit of their own (one of
``--every`` in each group), and the outliers: problems that once took ten seconds and
more. Each is planned with the default limit of each effort, in wall-clock time
and on one thread. A plan may take 10 % and 0.2 s more than its limit; a longer plan
is counted as late, and the exit code is 1 then.

Results go to a CSV file; the table has, for each effort, the time of plans (median,
95th percentile, maximum), and the numbers of plans that reached their limit, found a
motion, and were late.
"""

# ruff: noqa: E402 (the environment must be set before numerical libraries load)
from __future__ import annotations

from benchmarks.sheet import Sheet, markdown, one_thread

one_thread()

import argparse
import dataclasses
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

import tominpmp as tm
from benchmarks.golden_fresh import iiwa14
from benchmarks.golden_runner import Item, items, task_of

EFFORTS = ("quick", "standard", "thorough")
COLUMNS = ("problem", "effort", "limit", "seconds", "late", "status", "verified", "T")
# A posture of a Panda, its gripper in front of it.
READY = (0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785)
SWUNG = (2.0, 0.5, 0.0, -1.0, 0.0, 2.5, 0.785)

Make = Callable[[], tuple[tm.Problem, dict[str, Any]]]


def is_late(seconds: float, limit: float) -> bool:
    """Whether a plan exceeded its limit [s] by more than 10 % and 0.2 s."""
    return seconds > 1.1 * limit + 0.2


def swift_iiwa14() -> tm.Problem:
    """Seven joints with unreachable speed limits, so that torques limit the motion."""
    robot = tm.load_robot(iiwa14())
    limits = dataclasses.replace(robot.limits, velocity=np.full(robot.n, 10.0))
    robot = dataclasses.replace(robot, limits=limits)
    return tm.Problem(robot, np.zeros(7), tm.JointGoal(np.full(7, 0.5)))


def talos_arm() -> tm.Problem:
    """A gripper whose motor is hardly stronger than its dry friction."""
    robot = tm.load_robot("talos_arm", limits="urdf")
    low, high = robot.limits.position_lower, robot.limits.position_upper
    start, goal = np.zeros(robot.n), np.full(robot.n, 0.6)
    return tm.Problem(
        robot, np.clip(start, low, high), tm.JointGoal(np.clip(goal, low, high))
    )


def loaded_panda() -> tm.Problem:
    """A swing with 2.5 kg in the hand."""
    load = tm.Payload(frame="panda_hand", mass=2.5, com=(0.0, 0.0, 0.1))
    fingers = {"panda_finger_joint1": 0.0, "panda_finger_joint2": 0.0}
    robot = tm.load_robot("panda", limits="urdf", locked_joints=fingers).with_payload(
        load
    )
    return tm.Problem(robot, READY, tm.JointGoal(SWUNG))


OUTLIERS: dict[str, Callable[[], tm.Problem]] = {
    "iiwa14, swift": swift_iiwa14,
    "TALOS arm with gripper": talos_arm,
    "Panda with 2.5 kg": loaded_panda,
}


def problems(data: Path | None, every: int) -> Iterator[tuple[str, Make]]:
    """Names of the problems, and functions that make them with their options."""
    for name, make in OUTLIERS.items():
        yield name, lambda make=make: (make(), {})
    for item in items("tuned", data=data, every=every):
        if item.group == "warm":  # warm starts
            continue

        def of_item(item: Item = item) -> tuple[tm.Problem, dict[str, Any]]:
            task = task_of(item)
            return task.problem, dict(task.options)

        yield f"{item.group}: {item.name}", of_item


def row(name: str, effort: str, make: Make) -> dict[str, Any] | None:
    """The row of a plan; None for a problem with its own time limit or effort."""
    problem, own = make()
    if {"max_planning_time", "effort"} & set(own):
        return None
    options = tm.Options(**{**own, "effort": effort})
    begin = time.perf_counter()
    solution = tm.plan(problem, options)
    seconds = time.perf_counter() - begin
    limit = options.time_limit
    return {
        "problem": name,
        "effort": effort,
        "limit": limit,
        "seconds": seconds,
        "late": is_late(seconds, limit),
        "status": solution.status.name,
        "verified": solution.success,
        "T": solution.T if solution.success else np.inf,
    }


def main(argv: list[str] | None = None) -> int:
    """Plan all problems; 1 if a plan was late."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--csv", type=Path, default=Path("out/latency.csv"))
    parser.add_argument("--data", type=Path, help="folder of MotionBenchMaker")
    parser.add_argument("--efforts", default="quick,standard")
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--outliers", action="store_true", help="these alone")
    arguments = parser.parse_args(argv)
    warnings.simplefilter("ignore")
    efforts = arguments.efforts.split(",")
    tm.plan(loaded_panda(), effort="quick")  # libraries load
    sheet = Sheet(arguments.csv, COLUMNS)
    for number, (name, make) in enumerate(problems(arguments.data, arguments.every)):
        if arguments.outliers and number == len(OUTLIERS):
            break
        for effort in efforts:
            found = row(name, effort, make)
            if found is not None:
                sheet.add(found)
    lines = []
    for effort in efforts:
        seconds = np.array(sheet.column("seconds", effort=effort))
        states = sheet.column("status", effort=effort)
        lines.append(
            (
                effort,
                seconds.size,
                *(float(np.quantile(seconds, share)) for share in (0.5, 0.95, 1.0)),
                states.count("TIME_LIMIT"),
                sum(sheet.column("verified", effort=effort)),
                sum(sheet.column("late", effort=effort)),
            )
        )
    header = ("effort", "plans", "median s", "95 % s", "most s")
    print(markdown((*header, "cut short", "verified", "late"), lines))
    return int(any(row["late"] for row in sheet.rows))


if __name__ == "__main__":
    sys.exit(main())
