"""Goals on a frame with a free final configuration, compared with joint goals.

Positions and poses reached by a random configuration. The rival plans to each of at
most 20 inverse-kinematics solutions as a joint goal and takes the best. Goals that
are refused, or not reached, are given to the rival, too.

    python -m benchmarks.redundancy
    python -m benchmarks.redundancy --robots panda --goals 10 --seed 3
"""

# ruff: noqa: E402 (the environment must be set before numerical libraries load)
from __future__ import annotations

from benchmarks.sheet import Sheet, markdown, one_thread

one_thread()

import argparse
import statistics
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

import tominpmp as tm
from benchmarks.cell_cases import TOOLS
from benchmarks.random_goals import load_arm, sample_problems
from tominpmp.goals.frames import FrameGoal
from tominpmp.initial_guess.inverse_kinematics import Target
from tominpmp.kinematics import RobotKinematics
from tominpmp.transcription.problem_functions import ProblemFunctions

KINDS = ("position", "pose")
COLUMNS = (
    "robot",
    "kind",
    "goal",
    "outcome",
    "T",
    "seconds",
    "T_best",
    "seconds_of_all",
    "configurations",
)
TRIED = 20


def goals_of(
    name: str, kind: str, count: int, seed: int
) -> Iterator[tuple[int, tm.Problem]]:
    """Problems with the numbers of their goals; starts that collide are left out."""
    robot = load_arm(name)
    kinematics = RobotKinematics(robot)
    for number, (q_start, q_there) in enumerate(sample_problems(robot, count, seed)):
        place = kinematics.placement(q_there, TOOLS[name])
        goal: FrameGoal = tm.PoseGoal(TOOLS[name], place)
        if kind == "position":
            goal = tm.PositionGoal(TOOLS[name], place.translation)
        try:
            yield number, tm.Problem(robot, q_start, goal)
        except tm.ProblemError:
            continue


def timed(problem: tm.Problem) -> tuple[str, float, float]:
    """Status of a plan, T [s], and its processor time [s]."""
    begin = time.process_time()
    try:
        solution = tm.plan(problem)
        outcome, T = solution.status.name, float(solution.T)
    except tm.ProblemError:
        outcome, T = "refused", np.inf
    return outcome, T, time.process_time() - begin


def best_of_all(problem: tm.Problem, seed: list[int]) -> tuple[float, float, int]:
    """T of the best joint goal [s], processor time of all [s], and their number."""
    system, rng = ProblemFunctions.of(problem), np.random.default_rng(seed)
    found = Target(system, problem.goal).configurations(TRIED, rng).free
    plans = [
        timed(tm.Problem(problem.robot, problem.q_start, tm.JointGoal(q)))
        for q in found[:TRIED]
    ]
    T = min((T for _, T, _ in plans), default=np.inf)
    return T, sum(seconds for *_, seconds in plans), len(plans)


def main() -> int:
    """Measure, write the CSV file, print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", default="panda,xarm7,ur5,kinova")
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--goals", type=int, default=5)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--csv", type=Path, default=Path("out/redundancy.csv"))
    arguments = parser.parse_args()
    sheet = Sheet(arguments.csv, COLUMNS)
    for name in arguments.robots.split(","):
        for kind in arguments.kinds.split(","):
            known = goals_of(name, kind, arguments.goals, arguments.seed)
            for number, problem in known:
                outcome = timed(problem)
                rival = best_of_all(problem, [arguments.seed, number])
                row = [name, kind, number, *outcome, *rival]
                sheet.add(dict(zip(COLUMNS, row, strict=True)))
    lines = []
    for name in [*arguments.robots.split(","), "all"]:
        for kind in arguments.kinds.split(","):
            rows = [
                row
                for row in sheet.rows
                if name in ("all", row["robot"]) and row["kind"] == kind
            ]
            if rows:
                lines.append((name, kind, *summary(rows)))
    header = (
        *("robot", "goal", "goals", "found", "refused", "found by the rival"),
        *(
            "T relative to the best of 20: median",
            "worst",
            "median s",
            "max s",
            "s for 20",
        ),
    )
    print(markdown(header, lines))
    return 0


def summary(rows: list[dict[str, Any]]) -> tuple[object, ...]:
    """Cells of a line of the table."""
    both = [row for row in rows if np.isfinite(row["T"] * row["T_best"])]
    gains = [100.0 * (row["T"] / row["T_best"] - 1.0) for row in both]
    seconds = [row["seconds"] for row in rows]
    return (
        len(rows),
        sum(np.isfinite(row["T"]) for row in rows),
        sum(row["outcome"] == "refused" for row in rows),
        sum(np.isfinite(row["T_best"]) for row in rows),
        f"{statistics.median(gains):+.1f} %" if gains else "",
        f"{max(gains):+.1f} %" if gains else "",
        statistics.median(seconds),
        max(seconds),
        statistics.median(row["seconds_of_all"] for row in rows),
    )


if __name__ == "__main__":
    raise SystemExit(main())
