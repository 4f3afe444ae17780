"""Lower bounds of random arms with two joints, as shares of the best T that is known.

Rods with random masses, lengths, loads, friction and torques, level and upright, one
that slides, and a pendulum on a cart; a quarter of the problems begin and end in
motion. The best T is that of a plan, or of a thorough one with --thorough.

    python -m benchmarks.two_joint_bounds
    python -m benchmarks.two_joint_bounds --problems 16 --thorough
"""

# ruff: noqa: E402 (the environment must be set before numerical libraries load)
from __future__ import annotations

from benchmarks.sheet import Sheet, markdown, one_thread

one_thread()

import argparse
import statistics
import sys
import time
from pathlib import Path

import numpy as np

import tominpmp as tm

# The arms belong to the tests, whose modules find each other by their folder.
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from sample_arms import DOWNWARD, WEIGHTLESS, make_arm, rod, slide

KINDS = (
    *("level", "damped", "vertical", "vertical damped"),
    *("loaded", "loaded damped", "slider", "cart"),
)
COLUMNS = (
    "problem",
    "kind",
    "T",
    "bound",
    "share",
    "seconds",
    "quick",
    "quick_seconds",
)
# Tries until start and goal can be held.
TRIES = 1000


def random_arm(kind: str, rng: np.random.Generator) -> tm.Robot:
    """An arm of some kind."""
    mass, length = rng.uniform(0.3, 3.0, 2), rng.uniform(0.3, 1.2, 2)
    first, second = rod(mass[0], length[0]), rod(mass[1], length[1])
    level = kind in ("level", "damped")
    if kind.startswith("loaded"):
        second = second.with_payload(float(rng.uniform(0.3, 2.0)))
    if kind == "slider":
        second = slide(float(mass[1]))
    if kind == "cart":
        first = slide(float(mass[0]))
    damping = rng.uniform(0.1, 1.0, 2) if "damped" in kind else np.zeros(2)
    reach = 0.5 if kind == "slider" else second.length
    loads = np.array(
        [
            first.centre * first.mass + second.mass * (first.length + reach),
            second.mass * (1.0 if kind == "slider" else second.length),
        ]
    )
    if kind == "cart":
        loads[0] = first.mass + second.mass
    strength = rng.uniform(0.3, 3.0) if level else 9.81 * rng.uniform(0.3, 2.5)
    return make_arm(
        first,
        second,
        effort=strength * loads * rng.uniform(0.6, 1.5, 2),
        gravity=WEIGHTLESS if level else DOWNWARD,
        damping=damping,
    )


def random_problem(number: int, seed: int) -> tuple[str, tm.Problem | None]:
    """A problem by its number, and its kind; none if the arm can be held nowhere."""
    rng = np.random.default_rng([seed, number])
    kind = KINDS[number % len(KINDS)]
    robot = random_arm(kind, rng)
    for _ in range(TRIES):
        start, goal = rng.uniform(-1.6, 1.6, (2, 2))
        goal = start + np.clip(goal - start, -2.0, 2.0)
        moves = rng.uniform() < 0.25
        ends = 0.8 * rng.normal(size=(2, 2)) if moves else np.zeros((2, 2))
        to = tm.JointGoal(goal, ends[1]) if moves else tm.JointGoal(goal)
        try:
            return kind, tm.Problem(robot, start, to, v_start=ends[0])
        except tm.ProblemError:
            continue
    return kind, None


def timed_bound(problem: tm.Problem, *, quick: bool) -> tuple[float, float]:
    """A lower bound [s] and its processor time [s]."""
    begin = time.process_time()
    T = tm.lower_bound(problem, quick=quick).T
    return T, time.process_time() - begin


def main() -> int:
    """Measure, write the CSV file, print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--problems", type=int, default=72)
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--thorough", action="store_true")
    parser.add_argument("--csv", type=Path, default=Path("out/two_joint_bounds.csv"))
    arguments = parser.parse_args()
    sheet = Sheet(arguments.csv, COLUMNS)
    effort = "thorough" if arguments.thorough else "standard"
    for number in range(arguments.problems):
        kind, problem = random_problem(number, arguments.seed)
        if problem is None:
            continue
        solution = tm.plan(problem, effort=effort, max_planning_time=20.0)
        if not solution.feasible:
            continue
        bound, seconds = timed_bound(problem, quick=False)
        quick, quick_seconds = timed_bound(problem, quick=True)
        T = float(solution.T)
        row = [number, kind, T, bound, bound / T, seconds, quick / T, quick_seconds]
        sheet.add(dict(zip(COLUMNS, row, strict=True)))
    lines = []
    for kind in (*KINDS, "all"):
        rows = [row for row in sheet.rows if kind in ("all", row["kind"])]
        if not rows:
            continue
        shares = [row["share"] for row in rows]
        lines.append(
            (
                *(kind, len(rows), f"{min(shares):.2f}", f"{max(shares):.4f}"),
                f"{statistics.median(shares):.2f}",
                sum(share < 0.6 for share in shares),
                statistics.median(row["seconds"] for row in rows),
                max(row["seconds"] for row in rows),
                f"{statistics.median(row['quick'] for row in rows):.2f}",
            )
        )
    header = (
        *("arm", "problems", "least share", "largest", "median", "below 0.6"),
        *("median s", "max s", "quick: median share"),
    )
    print(markdown(header, lines))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
