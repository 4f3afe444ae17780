"""Lengths of joint paths beyond the direct ones, in fastest and in smoothed motions.

Random joint goals as in benchmarks/random_goals.py. For each the fastest motion, and
the motion smoothed by tominpmp.smooth in the same time, and in 0.1, 0.3 and 1 % more.

    python -m benchmarks.smoothing
"""

# ruff: noqa: E402 (the environment must be set before numerical libraries load)
from __future__ import annotations

from benchmarks.sheet import Sheet, markdown, one_thread

one_thread()

import argparse
import statistics
import time
from pathlib import Path

import numpy as np

import tominpmp as tm
from benchmarks.problems import random_goals

SLACKS = (None, 0.0, 0.001, 0.003, 0.01)
INSTANTS = 1000
COLUMNS = (
    "problem",
    "slack",
    "T",
    "seconds",
    "roughness",
    "beyond",
    "farthest",
    "success",
)


def beyond(solution: tm.Solution) -> np.ndarray:
    """Length of each joint's path beyond its displacement [rad]."""
    motion = solution.trajectory
    assert motion is not None
    q = motion(np.linspace(0.0, motion.duration, INSTANTS)).q
    return np.asarray(np.abs(np.diff(q, axis=0)).sum(axis=0) - np.abs(q[-1] - q[0]))


def measure(name: str, problem: tm.Problem) -> list[dict[str, object]]:
    """The fastest motion and the smoothed motions."""
    begin = time.process_time()
    fastest = tm.plan(problem)
    rows = []
    for slack in SLACKS:
        solution = fastest
        if slack is not None:
            begin = time.process_time()
            solution = tm.smooth(fastest, slack)
        ways = beyond(solution)
        found = (
            name,
            "fastest" if slack is None else slack,
            solution.T,
            time.process_time() - begin,
            solution.roughness,
            float(ways.sum()),
            float(ways.max()),
            solution.success,
        )
        rows.append(dict(zip(COLUMNS, found, strict=True)))
    return rows


def main() -> int:
    """Measure, write the CSV file, print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", default="ur5,panda,kinova,xarm7,z1")
    parser.add_argument("--goals", type=int, default=8)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--csv", type=Path, default=Path("out/smoothing.csv"))
    arguments = parser.parse_args()
    sheet = Sheet(arguments.csv, COLUMNS)
    for name, problem in random_goals(
        arguments.robots, arguments.goals, arguments.seed
    ):
        for row in measure(name, problem):
            sheet.add(row)
    first = [row for row in sheet.rows if row["slack"] == "fastest"]
    lines = []
    for slack in SLACKS:
        key = "fastest" if slack is None else slack
        mine = [row for row in sheet.rows if row["slack"] == key]
        rough = [
            row["roughness"] / max(before["roughness"], 1e-12)
            for row, before in zip(mine, first, strict=True)
        ]
        lines.append(
            (
                "the fastest" if slack is None else f"{100 * slack:g} % more time",
                statistics.median(row["beyond"] for row in mine),
                statistics.fmean(row["beyond"] for row in mine),
                max(row["farthest"] for row in mine),
                statistics.median(rough),
                statistics.median(row["seconds"] for row in mine),
                f"{sum(bool(row['success']) for row in mine)} / {len(mine)}",
            )
        )
    header = (
        "motion",
        "beyond straight, all joints, median [rad]",
        "mean",
        "one joint, most",
        "roughness, median share",
        "s",
        "verified",
    )
    print(markdown(header, lines))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
