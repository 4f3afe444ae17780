"""Arms with the limits of their data sheets: accelerations, jerks, torque rates.

Random joint goals, drawn as in benchmarks/random_goals.py, without those in
self-collision. Each is planned with ``limits="datasheet"`` and without; accelerations,
jerks and torque rates are computed from the positions, by finite differences.

    python -m benchmarks.controller_limits
    python -m benchmarks.controller_limits --robots panda,ur5 --goals 5 --seed 1
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

import numpy as np

import tominpmp as tm
from benchmarks.random_goals import LOCKED_JOINTS, sample_problems
from tominpmp.exceptions import ProblemError

ROBOTS = ("panda", "ur3", "ur5", "ur10", "xarm7")
COLUMNS = (
    "robot",
    "goal",
    "status",
    "verified",
    "T",
    "T_free",
    "seconds",
    "seconds_free",
    "peak",
    "peak_free",
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


def problems(name: str, count: int, seed: int) -> Iterator[tuple[tm.Problem, ...]]:
    """Pairs of problems: with the limits of the data sheet, and without."""
    locked = LOCKED_JOINTS.get(name, {})
    limited = tm.load_robot(name, locked_joints=locked, limits="datasheet")
    free = tm.load_robot(name, limits="urdf", locked_joints=locked)
    made = 0
    for q_start, q_goal in sample_problems(limited, 20 * count, seed):
        goal = tm.JointGoal(q_goal)
        try:
            pair = tuple(tm.Problem(robot, q_start, goal) for robot in (limited, free))
        except ProblemError:  # a self-collision
            continue
        yield pair
        made += 1
        if made == count:
            return


def measure(name: str, number: int, pair: tuple[tm.Problem, ...]) -> list[object]:
    """Plan both, and measure the motions: a row of the sheet."""
    found, seconds = [], []
    for problem in pair:
        begin = time.process_time()
        found.append(tm.plan(problem))
        seconds.append(time.process_time() - begin)
    solution = found[0]
    shares = [np.nan] * 3
    if solution.trajectory is not None and pair[0].motion_limits is not None:
        shares = largest_shares(solution.trajectory, pair[0].motion_limits)
    judged = solution.verification
    peaks = [
        np.nan if s.peak_acceleration is None else s.peak_acceleration.value
        for s in found
    ]
    return [
        name,
        number,
        solution.status.name,
        bool(solution.success and judged is not None and judged.ok),
        *(s.T for s in found),
        *seconds,
        *peaks,
        *shares,
    ]


def summary(rows: list[dict[str, object]], name: str) -> tuple[object, ...]:
    """The row of the table for an arm."""
    own = [row for row in rows if row["robot"] == name]
    good = [row for row in own if row["verified"]]

    def median(key: str) -> float:
        return statistics.median(float(row[key]) for row in good)  # type: ignore[arg-type]

    def most(key: str) -> float:
        return max(float(row[key]) for row in good)  # type: ignore[arg-type]

    slower = [float(r["T"]) / float(r["T_free"]) for r in good]  # type: ignore[arg-type]
    return (
        name,
        f"{len(good)} / {len(own)}",
        median("T_free"),
        median("T"),
        statistics.median(slower),
        most("peak_free"),
        most("peak"),
        # The data sheet has no limit where the share is NaN.
        *(most(key) or "–" for key in ("acceleration", "jerk", "effort_rate")),
        median("seconds_free"),
        median("seconds"),
        most("seconds"),
    )


def main() -> int:
    """Measure, write the CSV file, print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", default=",".join(ROBOTS))
    parser.add_argument("--goals", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--csv", type=Path, default=Path("out/controller_limits.csv"))
    arguments = parser.parse_args()
    names = arguments.robots.split(",")
    sheet = Sheet(arguments.csv, COLUMNS)
    for name in names:
        pairs = problems(name, arguments.goals, arguments.seed)
        for number, pair in enumerate(pairs):
            if not number:
                tm.plan(pair[1])  # loads libraries
            row = measure(name, number, pair)
            sheet.add(dict(zip(COLUMNS, row, strict=True)))
    header = (
        "arm",
        "verified",
        "T free",
        "T",
        "ratio",
        "peak free [rad/s²]",
        "peak [rad/s²]",
        "acceleration",
        "jerk",
        "torque rate",
        "s free",
        "s",
        "max s",
    )
    print(markdown(header, [summary(sheet.rows, name) for name in names]))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
