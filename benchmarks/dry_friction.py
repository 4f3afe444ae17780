"""Dry friction: random goals with and without it, and accuracy of replays.

Joint goals of several arms, drawn as in benchmarks/random_goals.py (goals with a
self-collision at an end are left out), are planned without dry friction, with friction
of some shares of the torque limits, and with the friction of the robot description, if
any. For each: whether the motion was found and verified, T, the number of joints that
reverse, processor time. Then the torques of some of the motions are replayed with
several integrators, to compare the ends of the motions.

    python -m benchmarks.dry_friction
    python -m benchmarks.dry_friction --robots ur5 --goals 3 --shares 0.1
    python -m benchmarks.dry_friction --method collocation --goals 3
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
from typing import get_args

import numpy as np

import tominpmp as tm
from benchmarks.random_goals import load_arm, sample_problems
from tominpmp.verification.plant import Plant
from tominpmp.verification.replay import Integration, Integrator, torque_pieces

COLUMNS = (
    "robot",
    "goal",
    "friction",
    "success",
    "T",
    "turns",
    "goal_error",
    "seconds",
    "verifying",
)
INTEGRATORS = get_args(Integrator)
REPLAYED = 3


def problems(name: str, count: int, seed: int) -> Iterator[tm.Problem]:
    """Joint goals of an arm without dry friction."""
    robot = load_arm(name).with_changes(friction=0.0)
    for start, goal in sample_problems(robot, 4 * count, seed):
        try:
            problem = tm.Problem(robot, start, tm.JointGoal(goal))
        except tm.ProblemError:
            continue
        yield problem
        count -= 1
        if not count:
            return


def with_friction(problem: tm.Problem, name: str, kind: str) -> tm.Problem:
    """The problem with friction as a share of the torque limits, or of the robot."""
    friction = load_arm(name).friction
    if kind != "own":
        friction = float(kind) * problem.robot.limits.effort_upper
    robot = problem.robot.with_changes(friction=friction)
    return tm.Problem(robot, problem.q_start, problem.goal)


def measure(
    name: str, goal: int, kind: str, problem: tm.Problem, method: str, sheet: Sheet
) -> tm.Solution:
    """Plan once, and add a row with the result."""
    begin = time.process_time()
    solution = tm.plan(problem, method=method)
    seconds = time.process_time() - begin
    motion, found = solution.trajectory, solution.verification
    turns, error, verifying = 0, np.inf, 0.0
    if motion is not None and found is not None:
        inner = motion.v[1:-1]
        turns = int(np.sum(np.any(inner[1:] * inner[:-1] < 0.0, axis=0)))
        error, verifying = found.goal_error, found.seconds
    T = motion.duration if motion is not None and solution.success else np.inf
    values = name, goal, kind, solution.success, T, turns, error, seconds, verifying
    sheet.add(dict(zip(COLUMNS, values, strict=True)))
    return solution


def table(sheet: Sheet, robots: list[str], kinds: list[str]) -> str:
    """Table by arm and friction."""
    lines = []
    for name in robots:
        plain = {r["goal"]: r for r in sheet.rows if _is(r, name, "0")}
        for kind in ["0", *kinds]:
            rows = [row for row in sheet.rows if _is(row, name, kind)]
            if not rows:
                continue
            good = [r for r in rows if r["success"] and plain[r["goal"]]["success"]]
            longer = [100 * (r["T"] / plain[r["goal"]]["T"] - 1) for r in good]
            ratio = [r["seconds"] / plain[r["goal"]]["seconds"] for r in rows]
            lines.append(
                (
                    name,
                    kind if kind == "own" else f"{100 * float(kind):g} %",
                    f"{sum(r['success'] for r in rows)} / {len(rows)}",
                    f"{statistics.mean(r['turns'] for r in rows):.1f}",
                    f"{statistics.median(longer):.2f}" if longer else "-",
                    f"{max(longer):.2f}" if longer else "-",
                    f"{statistics.mean(r['seconds'] for r in rows):.2f}",
                    f"{statistics.median(ratio):.2f}",
                    f"{max(r['goal_error'] for r in rows):.0e}",
                )
            )
    header = (
        "robot",
        "friction",
        "found and verified",
        "joints that turn",
        "T above [%]: median",
        "most",
        "planning [s]",
        "ratio",
        "largest error at the goal",
    )
    return markdown(header, lines)


def _is(row: dict[str, object], name: str, kind: str) -> bool:
    return row["robot"] == name and row["friction"] == kind


def exactness(solutions: list[tuple[str, tm.Solution]]) -> str:
    """Table of the errors at the end of replays, for each integrator."""
    lines = []
    for name, solution in solutions:
        motion, problem = solution.trajectory, solution.problem
        assert motion is not None
        torque, cells = torque_pieces(problem.robot, motion), list[str]()
        for integrator in INTEGRATORS:
            replay = Integration([Plant(problem.robot)], motion, torque, integrator)
            found = replay.run(problem.x_start)
            error = float(np.max(np.abs(found.q[-1] - motion.q[-1])))
            cells.append(f"{error:.1e} ({found.evaluations})")
        lines.append((name, *cells))
    return markdown(("motion", *INTEGRATORS), lines)


def main() -> int:
    """Measure, write the CSV file, print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", default="panda,ur5,xarm7")
    parser.add_argument("--goals", type=int, default=10)
    parser.add_argument("--shares", default="0.05,0.1,0.2")
    parser.add_argument("--method", default="inverse")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--csv", type=Path, default=Path("out/dry_friction.csv"))
    arguments = parser.parse_args()
    robots, kinds = arguments.robots.split(","), arguments.shares.split(",")
    sheet, kept = Sheet(arguments.csv, COLUMNS), []
    for name in robots:
        found = list(problems(name, arguments.goals, arguments.seed))
        tm.plan(found[0])  # loads libraries
        own = ["own"] if np.any(load_arm(name).friction) else []
        for goal, problem in enumerate(found):
            measure(name, goal, "0", problem, arguments.method, sheet)
            for kind in kinds + own:
                rough = with_friction(problem, name, kind)
                solution = measure(name, goal, kind, rough, arguments.method, sheet)
                if goal < REPLAYED and kind == kinds[-1] and solution.success:
                    kept.append((f"{name} {goal}", solution))
    print(table(sheet, robots, [*kinds, "own"]))
    print()
    print(exactness(kept))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
