"""A Panda with the acceleration, jerk and torque-rate limits of its data sheet.

Random joint goals, drawn as in benchmarks/random_goals.py. Each is planned with the
limits of examples/panda_motion_limits.yaml and, as a bound from below, without them.
What the motion does is computed anew from its positions, by differences.

    python -m benchmarks.controller_limits
    python -m benchmarks.controller_limits --goals 20 --seed 1
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

LIMITS = Path(__file__).parents[1] / "examples" / "panda_motion_limits.yaml"
COLUMNS = (
    "goal",
    "status",
    "verified",
    "T",
    "T_relaxed",
    "seconds",
    "iterations",
    "acceleration",
    "jerk",
    "effort_rate",
)
# Instants of a motion, and the half width of differences [s].
INSTANTS, WIDTH = 4000, 1e-5


def largest_shares(motion: tm.Trajectory, limits: tm.MotionLimits) -> list[float]:
    """Largest acceleration, jerk and torque rate, as shares of their limits."""
    t = np.linspace(2 * WIDTH, motion.duration - 2 * WIDTH, INSTANTS)
    after, before = motion(t + WIDTH), motion(t - WIDTH)
    changes = (
        (after.v - before.v, "acceleration"),
        (after.a - before.a, "jerk"),
        (after.u - before.u, "effort_rate"),
    )
    return [
        float(
            np.max(
                np.abs(change) / (2 * WIDTH) / limits.by_joint(name, motion.joint_names)
            )
        )
        for change, name in changes
    ]


def main() -> int:
    """Measure, write the CSV file, print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--goals", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--csv", type=Path, default=Path("out/controller_limits.csv"))
    arguments = parser.parse_args()
    robot = load_arm("panda")
    limits = tm.load_motion_limits(LIMITS, robot)
    sheet = Sheet(arguments.csv, COLUMNS)
    goals = sample_problems(robot, arguments.goals, arguments.seed)
    tm.plan(
        tm.Problem(robot, goals[0][0], tm.JointGoal(goals[0][1]), self_collision=False)
    )  # loads libraries
    for number, (q_start, q_goal) in enumerate(goals):
        free = tm.Problem(robot, q_start, tm.JointGoal(q_goal), self_collision=False)
        limited = tm.Problem(
            robot,
            q_start,
            tm.JointGoal(q_goal),
            motion_limits=limits,
            self_collision=False,
        )
        begin = time.process_time()
        solution = tm.plan(limited)
        seconds = time.process_time() - begin
        shares = [np.nan] * 3
        if solution.trajectory is not None:
            shares = largest_shares(solution.trajectory, limits)
        row = [
            number,
            solution.status.name,
            solution.success,
            solution.T,
            tm.plan(free).T,
            seconds,
            solution.iterations,
            *shares,
        ]
        sheet.add(dict(zip(COLUMNS, row, strict=True)))
    seconds_of_all = sheet.column("seconds")
    slower = [row["T"] / row["T_relaxed"] for row in sheet.rows if row["verified"]]
    cells = (
        f"{len(slower)} / {len(sheet.rows)}",
        statistics.median(seconds_of_all),
        max(seconds_of_all),
        statistics.median(slower),
        min(slower),
        *(max(sheet.column(name)) for name in COLUMNS[-3:]),
    )
    header = ("verified", "median s", "max s", "T / T without: median", "least")
    print(markdown((*header, "acceleration", "jerk", "torque rate"), [cells]))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
