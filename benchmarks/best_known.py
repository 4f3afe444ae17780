"""T of plans compared with the best known motions, for random joint goals.

The goals of ``benchmarks.random_goals``, without dry friction. Each is planned with
default options; other motions come from four times the intervals, from twenty
starts, from the greatest effort, and from IPOPT on four times the intervals, if
its torques keep their limits between the nodes too.

    python -m benchmarks.best_known --seed 12
    python -m benchmarks.best_known --seed 12 --speed-factor 4 --robots ur5 --goals 2

The table has the excess of T over the best of all, for each variant of planning. Rows
are in a CSV file as soon as they are known.
"""

# ruff: noqa: E402 (the environment must be set before numerical libraries load)
from __future__ import annotations

from benchmarks.sheet import Sheet, markdown, one_thread

one_thread()

import argparse
import math
import statistics
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import tominpmp as tm
from benchmarks.motionbenchmaker import names
from benchmarks.random_goals import ROBOTS, Contest, load_arm, sample_problems
from benchmarks.timed_plan import timed_plan

COLUMNS = ("robot", "goal", "way", "status", "success", "T", "seconds")
WAYS: dict[str, dict[str, Any]] = {
    "default": {},
    "thorough": {"effort": "thorough"},
    "N = 160": {"intervals": 160},
    "20 starts": {"starts": 20},
}
RIVAL = "IPOPT, N = 160"
RIVAL_INTERVALS, RIVAL_POINTS = 160, 1
# IPOPT's motions whose torques exceed their limits by more than this share between its
# nodes count as infeasible.
EXCESS = 0.005
# Target for the excess of T over the best motion.
SHARE = 0.003


def rival(contest: Contest, q_start: Any, q_goal: Any) -> dict[str, Any]:
    """Columns of IPOPT's row; its motion must keep limits between its nodes, too."""
    row = contest.run("ipopt", q_start, q_goal)
    found = row["ipopt_success"] == "True"
    keeps = found and float(row["ipopt_torque_excess"]) <= EXCESS
    return {
        "status": row["ipopt_status"],
        "success": keeps,
        "T": float(row["ipopt_T"]) if keeps else math.nan,
        "seconds": float(row["ipopt_seconds"]),
    }


def best_of(sheet: Sheet) -> dict[tuple[str, int], float]:
    """The least T of every problem that any variant has solved [s]."""
    best: dict[tuple[str, int], float] = {}
    for row in sheet.rows:
        if row["success"]:
            key = row["robot"], row["goal"]
            best[key] = min(best.get(key, math.inf), row["T"])
    return best


def line(way: str, sheet: Sheet) -> tuple[object, ...]:
    """The line of the table for a variant of planning."""
    best = best_of(sheet)
    rows = [row for row in sheet.rows if row["way"] == way]
    above = [
        row["T"] / best[row["robot"], row["goal"]] - 1.0
        for row in rows
        if row["success"]
    ]
    if not above:
        return way, f"0 / {len(rows)}", "-", "-", "-", "-", "-"
    return (
        way,
        f"{len(above)} / {len(rows)}",
        f"{100 * statistics.median(above):.2f} %",
        f"{100 * statistics.fmean(above):.2f} %",
        f"{100 * max(above):.2f} %",
        f"{sum(value > SHARE for value in above)} / {len(above)}",
        f"{statistics.median(row['seconds'] for row in rows):.2f}",
    )


HEADER = (
    "way",
    "solved",
    "T above the best: median",
    "mean",
    "largest",
    f"above by more than {100 * SHARE:g} %",
    "median s",
)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--robots", type=names, default=list(ROBOTS), metavar="A,B")
    parser.add_argument("--goals", type=int, default=5, help="problems a robot")
    parser.add_argument("--ways", type=names, default=[*WAYS, RIVAL], metavar="A,B")
    parser.add_argument("--seed", type=int, default=12)
    parser.add_argument("--speed-factor", type=float, default=1.0)
    parser.add_argument(
        "--time-limit", type=float, default=120.0, help="seconds a plan"
    )
    parser.add_argument("--csv", type=Path, default=Path("out/best_known.csv"))
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, write the CSV file, print the table."""
    parser = _parser()
    given = parser.parse_args(arguments)
    unknown = [way for way in given.ways if way not in (*WAYS, RIVAL)]
    if unknown:
        parser.error(f"--ways: {unknown[0]!r} is none of {', '.join((*WAYS, RIVAL))}")
    sheet = Sheet(given.csv, COLUMNS)
    for name in given.robots:
        robot = load_arm(name, given.speed_factor, 0.0)
        contest = Contest(
            robot, RIVAL_INTERVALS, "cosine", interior_points=RIVAL_POINTS
        )
        for goal, ends in enumerate(sample_problems(robot, given.goals, given.seed)):
            problem = tm.Problem(
                robot, ends[0], tm.JointGoal(ends[1]), self_collision=False
            )
            for way in given.ways:
                found = (
                    rival(contest, *ends)
                    if way == RIVAL
                    else timed_plan(
                        problem, max_planning_time=given.time_limit, **WAYS[way]
                    )
                )
                sheet.add({"robot": name, "goal": goal, "way": way, **found})
    print(markdown(HEADER, [line(way, sheet) for way in given.ways]))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
