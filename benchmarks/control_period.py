"""Motions on the clock of a controller: verified exports, time and planning time.

Random joint goals of three arms, drawn as in benchmarks/random_goals.py (goals with a
self-collision at an end are left out), with the limits of the makers' data sheets.
Each is planned without a clock and for controllers of several periods. A motion planned
for a period is written at this period, as a ROS 2 message and as CSV, and checked by
`tominpmp verify` as written. Planning times are the minimum of a few repetitions, as
other load makes single plans longer.

    python -m benchmarks.control_period
    python -m benchmarks.control_period --goals 3 --periods 0.01 --robots ur5
"""

# ruff: noqa: E402 (the environment must be set before numerical libraries load)
from __future__ import annotations

from benchmarks.sheet import Sheet, markdown, one_thread

one_thread()

import argparse
import statistics
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import tominpmp as tm
from benchmarks.random_goals import LOCKED_JOINTS, sample_problems
from tominpmp.cli.app import run
from tominpmp.exceptions import TominpmpError

COLUMNS = (
    "robot",
    "goal",
    "period",
    "status",
    "success",
    "T_free",
    "T",
    "ticks",
    "intervals",
    "seconds_free",
    "seconds",
    "verified",
)
# Problems drawn per required problem: some have self-collisions at an end.
DRAWN = 4


def problems(name: str, count: int, seed: int) -> Iterator[tm.Problem]:
    """The first problems of an arm whose start and goal are possible."""
    locked = LOCKED_JOINTS.get(name, {})
    robot = tm.load_robot(name, locked_joints=locked, limits="datasheet")
    for q_start, q_goal in sample_problems(robot, DRAWN * count, seed):
        if count == 0:
            return
        goal = tm.JointGoal(q_goal)
        try:
            problem = tm.Problem(robot, q_start, goal)
        except TominpmpError:
            continue
        count -= 1
        yield problem


def timed(
    problem: tm.Problem, period: float | None, repeats: int
) -> tuple[tm.Solution, float]:
    """Plan repeatedly; returns the solution and the least processor time [s]."""
    least = float("inf")
    for _ in range(repeats):
        begin = time.process_time()
        solution = tm.plan(problem, control_period=period)
        least = min(least, time.process_time() - begin)
    return solution, least


def holds(solution: tm.Solution, period: float, kind: str, folder: Path) -> bool:
    """Whether `tominpmp verify` passes a motion as it is written."""
    if not solution.success:
        return False
    scenario, motion = folder / "problem.toml", folder / f"motion.{kind}"
    tm.save_scenario(scenario, solution.problem)
    solution.export(motion, dt=period, verify=False)
    return run(["verify", str(scenario), str(motion)]) == 0


def measure(
    key: tuple[str, int],
    problem: tm.Problem,
    periods: list[float],
    kinds: list[str],
    repeats: int,
    sheet: Sheet,
) -> None:
    """Plan a problem without a clock and for all periods; one row each."""
    free, seconds_free = timed(problem, None, repeats)
    for period in periods:
        solution, seconds = timed(problem, period, repeats)
        motion = solution.trajectory
        assert motion is not None
        with tempfile.TemporaryDirectory() as folder:
            verified = all(
                holds(solution, period, kind, Path(folder)) for kind in kinds
            )
        values = (
            *key,
            period,
            solution.status.name,
            solution.success,
            free.T,
            solution.T,
            round(motion.duration / period),
            motion.t.size - 1,
            seconds_free,
            seconds,
            verified,
        )
        sheet.add(dict(zip(COLUMNS, values, strict=True)))


def table(sheet: Sheet, robots: list[str], periods: list[float]) -> str:
    """Table by arm and period, and over all."""
    lines = []
    for name in [*robots, "all"]:
        for period in periods:
            rows = [
                row
                for row in sheet.rows
                if name in (row["robot"], "all") and row["period"] == period
            ]
            above = [100 * (r["T"] / r["T_free"] - 1) for r in rows if r["success"]]
            ratio = [row["seconds"] / row["seconds_free"] for row in rows]
            if not rows:
                continue
            lines.append(
                (
                    name,
                    f"{1e3 * period:g}",
                    f"{sum(row['verified'] for row in rows)} / {len(rows)}",
                    f"{statistics.median(above):.2f}" if above else "-",
                    f"{max(above):.2f}" if above else "-",
                    f"{statistics.median(ratio):.2f}",
                    f"{max(ratio):.2f}",
                )
            )
    header = (
        "robot",
        "period [ms]",
        "verified as written",
        "T above [%]: median",
        "most",
        "planning time: median ratio",
        "most",
    )
    return markdown(header, lines)


def main() -> int:
    """Measure, write the CSV file, print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", default="panda,ur5,xarm7")
    parser.add_argument("--goals", type=int, default=10)
    parser.add_argument("--periods", default="0.001,0.004,0.008")
    parser.add_argument("--kinds", default="yaml,csv", help="endings of the exports")
    parser.add_argument("--repeats", type=int, default=3, help="of every plan")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--csv", type=Path, default=Path("out/control_period.csv"))
    arguments = parser.parse_args()
    robots = arguments.robots.split(",")
    periods = [float(word) for word in arguments.periods.split(",")]
    kinds = arguments.kinds.split(",")
    sheet = Sheet(arguments.csv, COLUMNS)
    for name in robots:
        found = list(problems(name, arguments.goals, arguments.seed))
        tm.plan(found[0], control_period=periods[0])  # loads libraries
        for goal, problem in enumerate(found):
            measure((name, goal), problem, periods, kinds, arguments.repeats, sheet)
    print(table(sheet, robots, periods))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
