"""Position goals with the final configuration free, against 20 configurations tried.

Positions that a random configuration reaches, for arms with seven joints. The rival
plans to each of 20 inverse-kinematics solutions as a joint goal and takes the best.

    python -m benchmarks.redundancy
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
from benchmarks.random_goals import load_arm, sample_problems
from tominpmp.goals import FrameGoal
from tominpmp.initial_guess.inverse_kinematics import goal_configurations
from tominpmp.kinematics import RobotKinematics
from tominpmp.transcription.problem_functions import ProblemFunctions

FRAMES = {"panda": "panda_hand", "xarm7": "link7"}
COLUMNS = (
    "robot",
    "goal",
    "T",
    "seconds",
    "T_best",
    "seconds_of_all",
    "configurations",
)
TRIED = 20


def main() -> int:
    """Measure, write the CSV file, print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", default="panda,xarm7")
    parser.add_argument("--goals", type=int, default=5)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--csv", type=Path, default=Path("out/redundancy.csv"))
    arguments = parser.parse_args()
    sheet = Sheet(arguments.csv, COLUMNS)
    for name in arguments.robots.split(","):
        robot = load_arm(name)
        goals = sample_problems(robot, arguments.goals, arguments.seed)
        kinematics = RobotKinematics(robot)
        for number, (q_start, q_there) in enumerate(goals):
            place = kinematics.placement(q_there, FRAMES[name]).translation
            goal = tm.PositionGoal(FRAMES[name], place)
            problem = tm.Problem(robot, q_start, goal, self_collision=False)
            begin = time.process_time()
            free = tm.plan(problem)
            seconds = time.process_time() - begin
            assert isinstance(problem.goal, FrameGoal)
            rng = np.random.default_rng([arguments.seed, number])
            found, _ = goal_configurations(
                ProblemFunctions.of(problem), problem.goal, TRIED, rng
            )
            begin = time.process_time()
            durations = [
                tm.plan(
                    tm.Problem(robot, q_start, tm.JointGoal(q), self_collision=False)
                ).T
                for q in [q_there, *found][:TRIED]
            ]
            tried = time.process_time() - begin
            row = [name, number, free.T, seconds, min(durations), tried, len(durations)]
            sheet.add(dict(zip(COLUMNS, row, strict=True)))
    lines = []
    for name in arguments.robots.split(","):
        rows = [row for row in sheet.rows if row["robot"] == name]
        gains = [100 * (row["T"] / row["T_best"] - 1.0) for row in rows]
        lines.append(
            (
                name,
                len(rows),
                f"{statistics.median(gains):+.1f} %",
                f"{max(gains):+.1f} %",
                statistics.median(row["seconds"] for row in rows),
                statistics.median(row["seconds_of_all"] for row in rows),
            )
        )
    header = ("robot", "goals", "T to the best of 20: median", "worst", "s", "s for 20")
    print(markdown(header, lines))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
