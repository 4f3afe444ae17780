"""T by default compared with T on a grid four times finer, in every planner mode.

Each random problem is planned with default options, on four times the intervals, and on
these once more with a warm start from the default motion. The excess is that of the
default T over the fastest of the three. If the fastest motion is not the default motion
on a finer grid, the row says so: it is another local optimum.

    python -m benchmarks.continuum
    python -m benchmarks.continuum --modes "jerk;obstacles" --robots ur5
"""

# ruff: noqa: E402 (the environment must be set before numerical libraries load)
from __future__ import annotations

from benchmarks.sheet import Sheet, markdown, one_thread

one_thread()

import argparse
import statistics
import time
from pathlib import Path
from typing import Any

import numpy as np

import tominpmp as tm
from benchmarks.continuum_cases import MODES, problems

FINER = 4
# Motions that differ by more than this at any time are different motions [rad or m].
APART = 0.3
COLUMNS = (
    "mode",
    "problem",
    "verified",
    "intervals",
    "T",
    "T_fine",
    "T_from",
    "excess",
    "excess_same",
    "apart",
    "seconds",
    "seconds_fine",
)


def apart(one: tm.Solution, other: tm.Solution) -> float:
    """Largest distance of two motions at equal shares of their durations."""
    if one.trajectory is None or other.trajectory is None:
        return float("inf")
    shares = np.linspace(0.0, 1.0, 101)
    q = [s.trajectory(shares * s.trajectory.duration).q for s in (one, other)]
    return float(np.max(np.abs(q[0] - q[1])))


def measure(
    mode: str, name: str, problem: tm.Problem, limit: float
) -> dict[str, object]:
    """Plan by default and on finer grids: a row of the sheet."""
    options: dict[str, Any] = dict(MODES[mode][2])
    begin = time.process_time()
    found = tm.plan(problem, **options)
    seconds = time.process_time() - begin
    options |= {"intervals": FINER * 40, "max_planning_time": limit}
    begin = time.process_time()
    fine = tm.plan(problem, **options)
    seconds_fine = time.process_time() - begin
    again = fine
    if found.trajectory is not None:
        again = tm.plan(problem, start=found, **options)
    T = [s.T if s.success else np.inf for s in (found, fine, again)]
    ways = [0.0, apart(found, fine), apart(found, again)]
    best = int(np.argmin(T))
    same = min(t for t, way in zip(T, ways, strict=True) if way <= APART)
    motion = found.trajectory
    row = (
        mode,
        name,
        found.success,
        0 if motion is None else motion.t.size - 1,
        *T,
        T[0] / min(T) - 1.0 if found.success else np.nan,
        T[0] / same - 1.0 if found.success else np.nan,
        ways[best],
        seconds,
        seconds_fine,
    )
    return dict(zip(COLUMNS, row, strict=True))


def table(sheet: Sheet) -> str:
    """Median and largest excess of each mode, in Markdown."""
    lines = []
    for mode in (*MODES, "all"):
        where = {} if mode == "all" else {"mode": mode}
        rows = [
            row
            for row in sheet.rows
            if row["verified"] and where.items() <= row.items()
        ]
        if not rows:
            continue
        excess, same = ([row[k] for row in rows] for k in ("excess", "excess_same"))
        ratios = [row["seconds_fine"] / row["seconds"] for row in rows]
        lines.append(
            (
                mode,
                f"{len(rows)} / {len(sheet.column('T', **where))}",
                f"{100 * statistics.median(same):+.2f} %",
                f"{100 * max(same):+.2f} %",
                f"{100 * max(excess):+.2f} %",
                sum(row["excess"] > row["excess_same"] + 1e-3 for row in rows),
                statistics.median(row["seconds"] for row in rows),
                statistics.median(ratios),
            )
        )
    header = (
        "mode",
        "verified",
        "T relative to 4 x finer, same motion: median",
        "largest",
        "any motion: largest",
        "another motion is faster",
        "median s",
        "time of the finer / default",
    )
    return markdown(header, lines)


def main() -> int:
    """Measure, write the CSV file, print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--modes", help="names, separated by semicolons; all by default"
    )
    parser.add_argument("--robots", default="planar3r,ur5,panda,z1")
    parser.add_argument("--count", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--limit", type=float, default=60.0, help="of finer plans [s]")
    parser.add_argument("--csv", type=Path, default=Path("out/continuum.csv"))
    arguments = parser.parse_args()
    sheet = Sheet(arguments.csv, COLUMNS)
    wanted = list(MODES) if arguments.modes is None else arguments.modes.split(";")
    for mode in wanted:
        if mode not in MODES:
            parser.error(f"no mode {mode!r}; there are {'; '.join(MODES)}")
    for mode in wanted:
        drawn = problems(mode, arguments.robots, arguments.count, arguments.seed)
        for name, problem in drawn:
            sheet.add(measure(mode, name, problem, arguments.limit))
    print(table(sheet))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
