"""Batches: speed of several workers, warm starts, memory, and what a large one costs.

Random joint goals of a planar arm and of a UR5, planned by `tm.plan_many` in one
process, on several, and with warm starts. The ideal of several workers is the time that
their plans took, over their number; memory is what this process has at most. What ten
million plans would cost follows from the measured means.

    python -m benchmarks.batch
    python -m benchmarks.batch --count 2000 --robots planar3r,ur5
"""

# ruff: noqa: E402 (the environment must be set before numerical libraries load)
from __future__ import annotations

from benchmarks.sheet import Sheet, markdown, one_thread

one_thread()

import argparse
import resource
import statistics
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import tominpmp as tm
from benchmarks.random_goals import load_arm, sample_problems

COLUMNS = (
    "robot",
    "how",
    "plans",
    "found",
    "verified",
    "seconds",
    "planning",
    "median",
    "T",
    "bytes",
    "memory_MB",
)
MANY = 10_000_000
HOURS = 3600.0


def problems(name: str, count: int, seed: int) -> list[tm.Problem]:
    """Random joint goals of an arm, of which nothing but the ends differs."""
    robot = load_arm(name)
    return [
        tm.Problem(robot, start, tm.JointGoal(end), self_collision=False)
        for start, end in sample_problems(robot, count, seed)
    ]


def measure(
    name: str, how: str, given: list[tm.Problem], sheet: Sheet, **options: Any
) -> None:
    """Plan a batch; one row."""
    with tempfile.TemporaryDirectory() as folder:
        begin = time.perf_counter()
        times, found, verified, total = [], 0, 0, 0.0
        for outcome in tm.plan_many(given, results=folder, **options):
            times.append(outcome.seconds)
            found += outcome.success
            verified += outcome.verified
            total += outcome.T if outcome.success else 0.0
        seconds = time.perf_counter() - begin
        sizes = [path.stat().st_size for path in tm.Dataset(folder).files]
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    most /= 1e6 if sys.platform == "darwin" else 1e3
    values = (
        name,
        how,
        len(given),
        found,
        verified,
        seconds,
        sum(times),
        statistics.median(times),
        total,
        statistics.mean(sizes),
        most,
    )
    sheet.add(dict(zip(COLUMNS, values, strict=True)))


def table(sheet: Sheet, workers: int) -> str:
    """What was measured, and what a large batch would cost."""
    lines = []
    for row in sheet.rows:
        several = 1 if row["how"] == "one process" else workers
        ideal = row["planning"] / several / row["seconds"]
        each = row["seconds"] * several / row["plans"]
        lines.append(
            (
                row["robot"],
                row["how"],
                f"{row['found']} / {row['plans']}",
                row["found"] - row["verified"],
                f"{row['median']:.3f}",
                f"{row['T']:.3f}",
                f"{100 * ideal:.0f}",
                f"{1e3 * (each - row['planning'] / row['plans']):.1f}",
                f"{row['bytes'] / 1e3:.1f}",
                f"{row['memory_MB']:.0f}",
                f"{MANY * each / HOURS:.0f}",
                f"{MANY * row['bytes'] / 1e9:.0f}",
            )
        )
    header = (
        "robot",
        "how",
        "found",
        "unverified",
        "median s",
        "sum of T [s]",
        "of ideal [%]",
        "overhead [ms]",
        "kB each",
        "memory [MB]",
        "10^7: core hours",
        "GB",
    )
    return markdown(header, lines)


def main() -> int:
    """Measure, write the CSV file, print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", default="planar3r,ur5")
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--csv", type=Path, default=Path("out/batch.csv"))
    arguments = parser.parse_args()
    sheet = Sheet(arguments.csv, COLUMNS)
    for name in arguments.robots.split(","):
        given = problems(name, arguments.count, arguments.seed)
        # Processes of a batch are kept for the next one: their start is not measured.
        list(tm.plan_many(given[:2], workers=arguments.workers))
        several: dict[str, Any] = {"workers": arguments.workers}
        measure(name, "one process", given, sheet, workers=1)
        measure(name, "several", given, sheet, **several)
        measure(name, "warm starts", given, sheet, warm_start=True, **several)
    print(table(sheet, arguments.workers))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
