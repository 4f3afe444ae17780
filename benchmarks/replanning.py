"""Times of a first feasible motion, a warm start, quiet torques, and a full plan.

Random joint goals as in benchmarks/random_goals.py and the example scenarios. For each:
the fastest motion, the first feasible motion, a warm start from the former motion after
a change of the goal by 0.05 rad in each joint compared with a cold start, and quiet
torques in 1 % more time.

    python -m benchmarks.replanning
"""

# ruff: noqa: E402 (the environment must be set before numerical libraries load)
from __future__ import annotations

from benchmarks.sheet import Sheet, markdown, one_thread

one_thread()

import argparse
import itertools
import statistics
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

import tominpmp as tm
from benchmarks.problems import random_goals, scenarios

SLACK, SHIFT = 0.01, 0.05
COLUMNS = (
    "problem",
    "T",
    "seconds",
    "T_feasible",
    "seconds_feasible",
    "T_other",
    "seconds_other",
    "T_warm",
    "seconds_warm",
    "roughness",
    "roughness_quiet",
    "T_quiet",
    "seconds_quiet",
    "all_verified",
)


def timed(work: Callable[[], tm.Solution]) -> tuple[tm.Solution, float]:
    """A solution and its processor time [s]."""
    begin = time.process_time()
    return work(), time.process_time() - begin


def nearby(problem: tm.Problem, end: np.ndarray) -> tm.Problem:
    """The problem with a joint goal close to the end of a motion."""
    limits = problem.robot.limits
    middle = np.clip(0.0, limits.position_lower, limits.position_upper)
    q = end + SHIFT * np.where(end > middle, -1.0, 1.0)
    q = np.clip(q, limits.position_lower, limits.position_upper)
    return replace(problem, goal=tm.JointGoal(q))


def measure(name: str, problem: tm.Problem) -> list[object]:
    """Make all plans of a problem."""
    full, seconds = timed(lambda: tm.plan(problem))
    any_one = tm.Options(objective="feasible")
    first, seconds_first = timed(lambda: tm.plan(problem, any_one))
    assert full.trajectory is not None
    changed = nearby(problem, full.trajectory.q[-1])
    other, seconds_other = timed(lambda: tm.plan(changed))
    warm, seconds_warm = timed(lambda: tm.plan(changed, start=full))
    quiet, seconds_quiet = timed(lambda: tm.smooth(full, SLACK))
    return [
        name,
        full.T,
        seconds,
        first.T,
        seconds_first,
        other.T,
        seconds_other,
        warm.T,
        seconds_warm,
        full.roughness,
        quiet.roughness,
        quiet.T,
        seconds_quiet,
        all(s.success for s in (full, first, other, warm, quiet)),
    ]


def main() -> int:
    """Measure, write the CSV file, print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", default="planar3r,ur5,panda")
    parser.add_argument("--goals", type=int, default=3)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--csv", type=Path, default=Path("out/replanning.csv"))
    arguments = parser.parse_args()
    sheet = Sheet(arguments.csv, COLUMNS)
    goals = random_goals(arguments.robots, arguments.goals, arguments.seed)
    for name, problem in itertools.chain(goals, scenarios()):
        if problem.segments:
            continue  # torques of several segments cannot be made quiet
        sheet.add(dict(zip(COLUMNS, measure(name, problem), strict=True)))
    lines = [
        (
            row["problem"],
            row["T"],
            row["seconds"],
            f"{100 * (row['T_feasible'] / row['T'] - 1):+.0f} %",
            row["seconds_feasible"],
            f"{100 * (row['T_warm'] / row['T_other'] - 1):+.2f} %",
            f"{row['seconds_warm']:.2f} / {row['seconds_other']:.2f}",
            row["roughness_quiet"] / row["roughness"],
            row["seconds_quiet"],
        )
        for row in sheet.rows
    ]
    header = (
        "problem",
        "T",
        "s",
        "first feasible: T",
        "s",
        "warm: T relative to cold",
        "s, warm / scratch",
        "quiet: roughness",
        "s",
    )
    print(markdown(header, lines))
    shares = [row["seconds_feasible"] / row["seconds"] for row in sheet.rows]
    verified = sum(bool(row["all_verified"]) for row in sheet.rows)
    print(f"\nAll verified: {verified} / {len(sheet.rows)}; the first feasible motion ")
    print(f"takes {100 * statistics.median(shares):.0f} % of the time, in the median.")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
