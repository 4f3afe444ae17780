"""Three parameterisations of the control: T, planning time and torques compared.

Random joint goals as in benchmarks/random_goals.py, with the speed limits of the
description and four times those.

    python -m benchmarks.controls
    python -m benchmarks.controls --robots planar3r,ur5 --goals 5
"""

# ruff: noqa: E402 (the environment must be set before numerical libraries load)
from __future__ import annotations

from benchmarks.sheet import Sheet, markdown, one_thread

one_thread()

import argparse
import statistics
import time
from pathlib import Path

import tominpmp as tm
from benchmarks.random_goals import load_arm, sample_problems

CONTROLS = ("constant", "linear", "spline", "auto")
COLUMNS = (
    "robot",
    "speed_factor",
    "goal",
    "control",
    "status",
    "verified",
    "T",
    "seconds",
    "roughness",
)


def main() -> int:
    """Measure, write the CSV file, print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", default="planar3r,ur5,panda,xarm7")
    parser.add_argument("--goals", type=int, default=3)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--csv", type=Path, default=Path("out/controls.csv"))
    arguments = parser.parse_args()
    sheet = Sheet(arguments.csv, COLUMNS)
    lines = []
    for name in arguments.robots.split(","):
        for factor in (1.0, 4.0):
            robot = load_arm(name, factor)
            goals = sample_problems(robot, arguments.goals, arguments.seed)
            for number, (q_start, q_goal) in enumerate(goals):
                problem = tm.Problem(
                    robot, q_start, tm.JointGoal(q_goal), self_collision=False
                )
                for control in CONTROLS:
                    begin = time.process_time()
                    solution = tm.plan(problem, tm.Options(control=control))
                    seconds = time.process_time() - begin
                    row = [name, factor, number, control, solution.status.name]
                    row += [solution.success, solution.T, seconds, solution.roughness]
                    sheet.add(dict(zip(COLUMNS, row, strict=True)))
            where = {"robot": name, "speed_factor": factor}
            constant = sheet.column("T", **where, control="constant")
            for control in CONTROLS:
                part = {**where, "control": control}
                ratios = [
                    T / known - 1.0
                    for T, known in zip(
                        sheet.column("T", **part), constant, strict=True
                    )
                ]
                lines.append(
                    (
                        f"{name}, speed x {factor:g}",
                        control,
                        f"{sum(sheet.column('verified', **part))} / {len(ratios)}",
                        f"{100 * statistics.fmean(ratios):+.2f} %",
                        statistics.median(sheet.column("seconds", **part)),
                        statistics.median(sheet.column("roughness", **part)),
                    )
                )
    header = ("problem", "control", "verified", "T relative to constant", "median s")
    print(markdown((*header, "roughness"), lines))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
