"""Drilling tasks of RoboTSP: durations, bounds and planning times as a table.

    git clone https://github.com/crigroup/raveutils
    python -m benchmarks.drilling raveutils [--holes 25 50 ...] [--out drilling.csv]

The published durations are the shortest of all methods in benchmarks.hdf5 of
github.com/crigroup/robotsp; each task has the holes drawn there, the same limits
of speed and acceleration, stops in front of all holes, and leads from home to home.
"""

from __future__ import annotations

import argparse
import csv
import time
from pathlib import Path

import tominpmp as tm
from benchmarks.drilling_cell import (
    HOME,
    MARGIN,
    PUBLISHED,
    holes,
    limits,
    robot,
    scene,
    stations,
    subsets,
)

COLUMNS = [
    "holes",
    "cycle [s]",
    "published [s]",
    "ratio",
    "bound [s]",
    "direct legs",
    "legs",
    "verified",
    "wall [s]",
    "processor [s]",
]


def row(count: int, places: list, arguments: argparse.Namespace) -> list[object]:
    """Plan one task; returns its row."""
    wall, processor = time.perf_counter(), time.process_time()
    tour = tm.plan_tour(
        robot(),
        HOME,
        stations(places),
        scene=scene(),
        motion_limits=limits(),
        margin=MARGIN,
        seed=arguments.seed,
    )
    taken = time.perf_counter() - wall, time.process_time() - processor
    if arguments.page and tour.success:
        tour.play(arguments.page)
        tour.plot(arguments.page.with_suffix(".png"))
    best = PUBLISHED.get(count, float("nan"))
    print(tour.message)
    return [
        count,
        round(tour.cycle_time, 3),
        best,
        round(tour.cycle_time / best, 4),
        round(tour.lower_bound, 3),
        tour.direct,
        len(tour.motions),
        tour.verified,
        round(taken[0], 1),
        round(taken[1], 1),
    ]


def main() -> int:
    """Plan the tasks and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="a copy of crigroup/raveutils")
    parser.add_argument("--holes", type=int, nargs="*", default=list(PUBLISHED))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--page", type=Path, help="page that plays the last task")
    arguments = parser.parse_args()
    every = holes(arguments.folder)
    drawn = subsets(len(every))
    rows = [COLUMNS]
    for count in arguments.holes:
        rows.append(row(count, every[drawn[count]], arguments))
        print(dict(zip(COLUMNS, rows[-1], strict=True)), flush=True)
    if arguments.out:
        with arguments.out.open("w", newline="") as file:
            csv.writer(file).writerows(rows)
    return 0 if all(line[7] for line in rows[1:]) else 1


if __name__ == "__main__":
    raise SystemExit(main())
