"""Placements by gradients compared with a grid of placements.

Two examples: the base of a planar arm with three goals, and movable goals of a UR5.
A grid plans every task at each of its points; the gradient search plans until
there is no further gain. The comparison is the number of plans for the same result: the
plans that the search had made when it was as good as the best point of the grid.

    python -m benchmarks.placement
    python -m benchmarks.placement --points 5 --only base
"""

# ruff: noqa: E402 (the environment must be set before numerical libraries load)
from __future__ import annotations

from benchmarks.sheet import Sheet, markdown, one_thread

one_thread()

import argparse
import itertools
import math
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

import tominpmp as tm
from tominpmp.cell.placement import Moves

COLUMNS = ("example", "T_before", "T_grid", "T", "plans_grid", "plans_equal", "plans")
QUICK: dict[str, Any] = {"intervals": 20, "starts": 1, "refine": None}
# Share within which the search counts as equal to the grid.
EQUAL = 1e-3


def base() -> tuple[Any, list[tm.Problem], dict[str, tuple[float, float]], str]:
    """A planar arm in a vertical plane, and three points for its tip."""
    robot = tm.load_robot("planar3r")
    points = ((4.0, 1.0, 0.0), (3.0, 3.5, 0.0), (4.4, 2.0, 0.0))
    goals = [tm.PositionGoal("tip", point) for point in points]
    tasks = [tm.Problem(robot, (0.5, 1.7, -1.7), goal) for goal in goals]
    return robot, tasks, {"x": (-0.5, 0.5), "y": (-0.5, 0.5)}, "base"


def station() -> tuple[Any, list[tm.Problem], dict[str, tuple[float, float]], str]:
    """A UR5, and two points of a movable station."""
    robot = tm.load_robot("ur5", limits="urdf")
    points = ((0.5, 0.3, 0.3), (0.5, 0.1, 0.2))
    start = (-0.6, -1.2, 1.4, -1.7, -1.5, 0.0)
    goals = [tm.PositionGoal("tool0", point) for point in points]
    tasks = [tm.Problem(robot, start, goal) for goal in goals]
    return robot, tasks, {"x": (-0.15, 0.15), "y": (-0.3, 0.3)}, "goals"


EXAMPLES = {"base": base, "station": station}


def on_grid(
    moves: Moves, tasks: list[tm.Problem], rows: list[Any]
) -> tuple[float, int]:
    """Best sum of durations on a grid, and the number of plans."""
    best, plans = math.inf, 0
    for x in itertools.product(*rows):
        total = 0.0
        try:
            problems = [*map(moves.mover(np.array(x)), tasks)]
        except tm.TominpmpError:
            continue
        for problem in problems:
            plans += 1
            try:
                total += tm.plan(problem, **QUICK).T
            except tm.TominpmpError:
                total = math.inf
        best = min(best, total)
    return best, plans


def measure(name: str, points: int, sheet: Sheet) -> None:
    """Plan an example on a grid and by gradients; returns its row."""
    robot, tasks, bounds, what = EXAMPLES[name]()
    moves = Moves(what, tuple(bounds), robot, pin.SE3.Identity())
    rows = [np.linspace(*pair, points) for pair in bounds.values()]
    best, plans = on_grid(moves, tasks, rows)
    found = tm.improve_placement(robot, tasks, bounds=bounds, moves=what, **QUICK)
    good = [t.plans for t in found.trials if t.T <= best * (1.0 + EQUAL)]
    equal = min(good) if good else None
    values = (name, found.T_before, best, found.T, plans, equal, found.plans)
    sheet.add(dict(zip(COLUMNS, values, strict=True)))


def main() -> int:
    """Measure, write the CSV file, print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", default="base,station")
    parser.add_argument("--points", type=int, default=7, help="of the grid, each way")
    parser.add_argument("--csv", type=Path, default=Path("out/placement.csv"))
    arguments = parser.parse_args()
    sheet = Sheet(arguments.csv, COLUMNS)
    for name in arguments.only.split(","):
        measure(name, arguments.points, sheet)
    print(markdown(COLUMNS, [list(row.values()) for row in sheet.rows]))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
