"""T against energy on an arm: a plan for each weight, the figure of docs/energy.md.

python -m benchmarks.time_energy [--figure docs/figures/time_energy.png]
python -m benchmarks.time_energy --energy work
"""

# ruff: noqa: E402 (the environment must be set before numerical libraries load)
from __future__ import annotations

from benchmarks.sheet import Sheet, markdown, one_thread

one_thread()

import argparse
import time
from pathlib import Path

import numpy as np

import tominpmp as tm

WEIGHTS = {
    "torque_squared": (0.0, 1e-7, 1e-6, 3e-6, 1e-5, 3e-5, 1e-4, 3e-4, 1e-3),
    "work": (0.0, 1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2),
}
COLUMNS = ("weight", "T", "energy", "cost", "status", "seconds")
START = (0.0, -1.2, 1.4, -1.8, -1.57, 0.0)
GOAL = (2.0, -1.0, 0.6, -1.2, -1.57, 0.0)


def main() -> int:
    """Plan for every weight, write the CSV file and the figure, print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--csv", type=Path, default=Path("out/time_energy.csv"))
    parser.add_argument("--energy", choices=list(WEIGHTS), default="torque_squared")
    parser.add_argument("--figure", type=Path)
    arguments = parser.parse_args()
    problem = tm.Problem(
        tm.load_robot("ur5", limits="urdf"), np.array(START), tm.JointGoal(GOAL)
    )
    sheet, rows = Sheet(arguments.csv, COLUMNS), []
    for weight in WEIGHTS[arguments.energy]:
        begin = time.process_time()
        solution = tm.plan(problem, energy=arguments.energy, energy_weight=weight)
        seconds = time.process_time() - begin
        values = (weight, solution.T, solution.energy, solution.cost)
        row = (*values, solution.status.name, round(seconds, 2))
        sheet.add(dict(zip(COLUMNS, row, strict=True)))
        rows.append(solution)
    print(markdown(COLUMNS, [list(row.values()) for row in sheet.rows]))
    if arguments.figure is not None:
        draw(rows, arguments.figure)
    return 0


def draw(solutions: list[tm.Solution], path: Path) -> None:
    """T over energy, each point with its weight."""
    from tominpmp.viz import figures

    found = [one for one in solutions if one.success and one.energy is not None]
    work = bool(found) and found[0].options.energy == "work"
    kind = "work [J]" if work else "energy, the integral of |u|² over time [N² m² s]"
    with figures.styled():
        figure = figures.new_figure(5.0, 3.2)
        axes = figure.subplots()
        axes.plot([one.energy for one in found], [one.T for one in found], "o-", ms=4)
        for one in found:
            look = {"textcoords": "offset points", "size": 7, "rotation": 45}
            label, place = f"k = {one.options.energy_weight:g}", (one.energy, one.T)
            axes.annotate(label, place, xytext=(2, 5), **look)
        axes.margins(y=0.25)
        axes.set(xlabel=kind, ylabel="T [s]")
        figures.finish(figure, path)


if __name__ == "__main__":
    raise SystemExit(main())
