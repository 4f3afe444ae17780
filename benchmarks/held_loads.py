"""Loads on a tray and on a suction cup: motions of two examples, by several options.

python -m benchmarks.held_loads
"""

# ruff: noqa: E402 (the environment must be set before numerical libraries load)
from __future__ import annotations

from benchmarks.sheet import Sheet, markdown, one_thread

one_thread()

import argparse
import time
from collections.abc import Iterator
from pathlib import Path

import tominpmp as tm
from examples import suction_carton, waiter

OPTIONS = {
    "default": tm.Options(),
    "linear, 40 intervals, quick": tm.Options(
        control="linear", intervals=40, effort="quick", refine=None
    ),
    "constant, 80 intervals, quick": tm.Options(
        control="constant", intervals=80, effort="quick", refine=None
    ),
    "spline": tm.Options(control="spline"),
}
COLUMNS = ("problem", "options", "status", "T", "promise", "seconds", "verified")


def problems() -> Iterator[tuple[str, tm.Problem]]:
    """The problems of the examples, by name."""
    yield "tray, level", waiter.problem(level=True)
    yield "tray, tilting", waiter.problem(level=False)
    for pull in suction_carton.PULLS:
        yield f"carton, {pull:g} N", suction_carton.problem(pull)


def main() -> int:
    """Measure, write the CSV file, print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--csv", type=Path, default=Path("out/held_loads.csv"))
    sheet = Sheet(parser.parse_args().csv, COLUMNS)
    lines = []
    for problem, task in problems():
        cells = [problem]
        for name, options in OPTIONS.items():
            begin = time.process_time()
            solution = tm.plan(task, options, max_planning_time=60.0)
            seconds = time.process_time() - begin
            promise = solution.certificate.stationarity
            found = (problem, name, solution.status.name, solution.T, promise, seconds)
            sheet.add(dict(zip(COLUMNS, (*found, solution.success), strict=True)))
            cells.append(f"{solution.T:.3f} s, {100 * promise:.1f} %, {seconds:.1f} s")
        lines.append(cells)
    print(markdown(("problem", *OPTIONS), lines))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
