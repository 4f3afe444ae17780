"""Two segments in clutter, to the goal and back, compared with a plan for each.

    python -m benchmarks.there_and_back --data DIR
    python -m benchmarks.there_and_back --data DIR --scenes box,cage --problems 1-3

The problems are those of ``benchmarks/motionbenchmaker.py``. The arm stops at the goal,
so that the fastest motion of both segments takes as long as the two fastest motions.
Times of planning are processor times.
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
from benchmarks.motionbenchmaker import VARIABLE, Case, Court, add_problems
from tominpmp.files.moveit import load_moveit

COLUMNS = (
    *("scene", "problem", "status", "T", "T_of_two_plans", "ratio"),
    *("seconds", "seconds_of_two_plans"),
)


def timed(problem: tm.Problem) -> tuple[tm.Solution, float]:
    """A plan, and the processor time that it took [s]."""
    begin = time.process_time()
    return tm.plan(problem), time.process_time() - begin


def row_of(case: Case) -> dict[str, object]:
    """Plan a problem in two segments, and in two plans."""
    there = load_moveit(Court.of(case).robot, case.scene_path, case.request_path)
    start, goal = tm.JointGoal(there.q_start), there.goal
    back = there.with_ends(goal.configuration, start)
    both = tm.Problem(
        there.robot,
        there.q_start,
        scene=there.scene,
        segments=[tm.Segment(goal, stop=True), tm.Segment(start)],
    )
    solution, seconds = timed(both)
    plans = [timed(problem) for problem in (there, back)]
    total = sum(plan.T for plan, _ in plans)
    values = (
        *(case.scene, case.problem, solution.status.name, solution.T, total),
        *(solution.T / total, seconds, sum(used for _, used in plans)),
    )
    return dict(zip(COLUMNS, values, strict=True))


def main() -> int:
    """Plan all problems, write the CSV file, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add_problems(parser, "1-2")
    parser.add_argument("--csv", type=Path, default=Path("out/there_and_back.csv"))
    arguments = parser.parse_args()
    if arguments.data is None:
        parser.error(f"--data is missing, and ${VARIABLE} is not set")
    sheet = Sheet(arguments.csv, COLUMNS)
    for scene in arguments.scenes:
        for number in arguments.problems:
            sheet.add(row_of(Case(scene, number, arguments.data)))
    found = [row for row in sheet.rows if row["T"] < float("inf")]
    medians = [
        statistics.median(row[name] for row in found)
        for name in ("ratio", "seconds", "seconds_of_two_plans")
    ]
    header = "problems", "found", "ratio of T", "seconds", "seconds of two plans"
    print(markdown(header, [(len(sheet.rows), len(found), *medians)]))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
