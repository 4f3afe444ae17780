r"""Invariance of T: order of obstacles, grid and LP solver must not matter.

Each problem of the MotionBenchMaker set is planned once with default options, then with
its obstacles in other orders, on other numbers of intervals, and with another solver
for the linear programs.

    python -m benchmarks.invariance --data DIR
    python -m benchmarks.invariance --data DIR --scenes box --problems 1-3 \
        --variants reversed,N=60

The table has, for each variant, the difference of T from the default, and the number of
problems in which it exceeds one per cent. Rows are in a CSV file as soon as they are
known.
"""

# ruff: noqa: E402 (the environment must be set before numerical libraries load)
from __future__ import annotations

from benchmarks.sheet import Sheet, markdown, one_thread

one_thread()

import argparse
import statistics
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import tominpmp as tm
from benchmarks.certified import problems
from benchmarks.motionbenchmaker import VARIABLE, add_problems, names
from benchmarks.timed_plan import timed_plan

COLUMNS = ("problem", "variant", "status", "success", "T", "seconds")
DEFAULT = "default"
VARIANTS = ("reversed", "shuffled", "N=30", "N=50", "N=60", "highs")
# Target for the difference of T, as a share.
SHARE = 0.01


def varied(problem: tm.Problem, variant: str) -> tuple[tm.Problem, dict[str, Any]]:
    """The same problem in another form, and its options.

    Args:
        problem: The problem.
        variant: "default", "reversed" or "shuffled" obstacles, "N=" and a number of
            intervals, or the name of a solver of linear programs.
    """
    if variant in ("reversed", "shuffled"):
        obstacles = list(problem.scene.obstacles)
        if variant == "reversed":
            obstacles.reverse()
        else:
            np.random.default_rng(0).shuffle(obstacles)  # type: ignore[arg-type]
        return replace(problem, scene=replace(problem.scene, obstacles=obstacles)), {}
    if variant.startswith("N="):
        return problem, {"intervals": int(variant[2:])}
    return problem, {} if variant == DEFAULT else {"lp_solver": variant}


def measure(
    name: str, problem: tm.Problem, variant: str, limit: float | None
) -> dict[str, Any]:
    """Plan one variant; returns its row."""
    other, options = varied(problem, variant)
    found = timed_plan(other, max_planning_time=limit, **options)
    return {"problem": name, "variant": variant, **found}


def line(variant: str, sheet: Sheet) -> tuple[object, ...]:
    """A line of the table: one variant against the default."""
    rows = {r["problem"]: r for r in sheet.rows if r["variant"] == DEFAULT}
    pairs = [
        (rows[r["problem"]], r)
        for r in sheet.rows
        if r["variant"] == variant and r["success"] and rows[r["problem"]]["success"]
    ]
    change = [other["T"] / first["T"] - 1.0 for first, other in pairs]
    seconds = [other["seconds"] / first["seconds"] for first, other in pairs]
    found = sheet.column("success", variant=variant)
    return (
        variant,
        f"{sum(found)} / {len(found)}",
        f"{100 * statistics.fmean(change):+.2f} %",
        f"{100 * min(change):+.2f} %",
        f"{100 * max(change):+.2f} %",
        f"{sum(abs(value) > SHARE for value in change)} / {len(change)}",
        f"{statistics.median(seconds):.2f}",
    )


HEADER = (
    "variant",
    "found",
    "T relative to the default: mean",
    "least",
    "largest",
    "difference above 1 %",
    "time / default's",
)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add_problems(parser, "1-4")
    parser.add_argument("--variants", type=names, default=list(VARIANTS))
    parser.add_argument("--time-limit", type=float, default=60.0, help="seconds a plan")
    parser.add_argument("--csv", type=Path, default=Path("out/invariance.csv"))
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, write the CSV file, print the table."""
    parser = _parser()
    given = parser.parse_args(arguments)
    if given.data is None:
        parser.error(f"--data is missing, and ${VARIABLE} is not set")
    sheet = Sheet(given.csv, COLUMNS)
    for name, problem in problems(given.data, given.scenes, given.problems, (), 0):
        problem.checker.distances(problem.q_start[None])  # loads meshes
        for variant in (DEFAULT, *given.variants):
            sheet.add(measure(name, problem, variant, given.time_limit))
    print(markdown(HEADER, [line(variant, sheet) for variant in given.variants]))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
