"""Batches: speed of several workers, warm starts, memory, and cost of a large batch.

Random joint goals of a planar arm and of a UR5, planned by `tm.plan_many` in one
process, on several, and with warm starts. The ideal time of several workers is the time
of all plans divided by their number; on a machine with other load, the processor time
of all processes compared with that of one process is more reliable. Memory is that of
this process and its workers, after a quarter of the plans and at the end. The cost of
ten million plans follows from the measured means.

    python -m benchmarks.batch
    python -m benchmarks.batch --count 2000 --robots ur5 --how several
"""

# ruff: noqa: E402 (the environment must be set before numerical libraries load)
from __future__ import annotations

from benchmarks.sheet import Sheet, markdown, one_thread

one_thread()

import argparse
import os
import statistics
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
    "unverified",
    "seconds",
    "planning",
    "processor",
    "median",
    "T",
    "bytes",
    "memory_early",
    "memory",
)
HOW = ("one", "several", "warm")
MANY = 10_000_000
HOURS = 3600.0


def problems(name: str, count: int, seed: int) -> list[tm.Problem]:
    """Random joint goals of an arm, which differ only in start and goal."""
    robot = load_arm(name)
    return [
        tm.Problem(robot, start, tm.JointGoal(end), self_collision=False)
        for start, end in sample_problems(robot, count, seed)
    ]


def processes() -> list[int]:
    """This process and its descendants, if the system lists them."""
    found, parents = [os.getpid()], {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text().rpartition(")")[2].split()
        except OSError:
            continue  # the process has ended
        parents[int(path.parent.name)] = int(fields[1])
    for pid in found:
        found += [child for child, parent in parents.items() if parent == pid]
    return found


def used() -> tuple[float, float]:
    """Processor time [s] and memory [MB] of this process and its descendants."""
    seconds = memory = 0.0
    tick, page = os.sysconf("SC_CLK_TCK"), os.sysconf("SC_PAGE_SIZE")
    for pid in processes():
        try:
            stat = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        except OSError:
            continue
        seconds += (int(stat[11]) + int(stat[12])) / tick
        memory += int(stat[21]) * page / 1e6
    return seconds, memory


def measure(
    name: str, how: str, given: list[tm.Problem], sheet: Sheet, **options: Any
) -> None:
    """Plan a batch, and add its row."""
    with tempfile.TemporaryDirectory() as folder:
        begin, (before, _) = time.perf_counter(), used()
        times, found, unverified, total = [], 0, 0, 0.0
        early = 0.0
        for outcome in tm.plan_many(given, results=folder, **options):
            times.append(outcome.seconds)
            found += outcome.success
            unverified += outcome.success and not outcome.verified
            total += outcome.T if outcome.success else 0.0
            if len(times) == len(given) // 4:
                early = used()[1]
        seconds = time.perf_counter() - begin
        after, memory = used()
        sizes = [path.stat().st_size for path in tm.Dataset(folder).files]
    values = (
        name,
        how,
        len(given),
        found,
        unverified,
        seconds,
        sum(times),
        after - before,
        statistics.median(times),
        total,
        statistics.mean(sizes),
        early,
        memory,
    )
    sheet.add(dict(zip(COLUMNS, values, strict=True)))


def table(sheet: Sheet, workers: int) -> str:
    """The measurements, and the cost of a large batch."""
    lines = []
    for row in sheet.rows:
        several = 1 if row["how"] == "one" else workers
        ideal = row["planning"] / several / row["seconds"]
        each = row["seconds"] * several / row["plans"]
        lines.append(
            (
                row["robot"],
                row["how"],
                f"{row['found']} / {row['plans']}",
                row["unverified"],
                f"{row['median']:.3f}",
                f"{row['T']:.3f}",
                f"{100 * ideal:.0f}",
                f"{1e3 * (each - row['planning'] / row['plans']):.1f}",
                f"{1e3 * row['processor'] / row['plans']:.0f}",
                f"{row['bytes'] / 1e3:.1f}",
                f"{row['memory_early']:.0f}, {row['memory']:.0f}",
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
        "processor [ms]",
        "kB each",
        "memory early, late [MB]",
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
    parser.add_argument("--how", default=",".join(HOW), help="of: one, several, warm")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--csv", type=Path, default=Path("out/batch.csv"))
    arguments = parser.parse_args()
    sheet = Sheet(arguments.csv, COLUMNS)
    for name in arguments.robots.split(","):
        given = problems(name, arguments.count, arguments.seed)
        # Processes of a batch also serve the next batch: their start is not measured.
        list(tm.plan_many(given[:2], workers=arguments.workers))
        options: dict[str, dict[str, Any]] = {
            "one": {"workers": 1},
            "several": {"workers": arguments.workers},
            "warm": {"workers": arguments.workers, "warm_start": True},
        }
        for how in arguments.how.split(","):
            measure(name, how, given, sheet, **options[how])
    print(table(sheet, arguments.workers))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
