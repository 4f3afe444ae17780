"""Random combinations that have a motion, planned within ten seconds each.

    python -m benchmarks.combinations                          # 150 of them
    python -m benchmarks.combinations --numbers 3,17 --limit 60
    python -m benchmarks.combinations --count 20 --effort quick --limit 0.5

Two to four segments of a Panda, UR5, xArm7 or KUKA iiwa14, with or without dry
friction, a load and a grasp that must not slip, stops, and times of arrival
(``golden_fresh.combined_case``). Each is drawn around a slow motion that satisfies all
requirements, so that a plan without a motion is a failure of the planner. Motions are
checked by ``golden_judge.py``.

A plan may take 10 % and 0.2 s more than its limit, in wall-clock time; the processor
time is listed as well, to distinguish a slow planner from a busy machine. With
``--processor`` all times are processor times, and other load does not matter.
Results go to a CSV file, a row as soon as it is known. The exit code is 1 if less than
``--share`` of the motions are found and not refuted, or a plan was late.
"""

# ruff: noqa: E402 (the environment must be set before numerical libraries load)
from __future__ import annotations

from benchmarks.sheet import Sheet, markdown, one_thread

one_thread()

import argparse
import sys
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np

import tominpmp as tm
from benchmarks.every_robot import count_processor_time
from benchmarks.golden_fresh import combined_case
from benchmarks.golden_judge import Asked
from benchmarks.golden_problems import task
from benchmarks.latency import EFFORTS, is_late

COLUMNS = (
    "number",
    "robot",
    "asked",
    "status",
    "verified",
    "faults",
    "T",
    "slow_T",
    "seconds",
    "processor_seconds",
    "late",
    "programs",
    "message",
)
KINDS = ("load", "grasp", "friction", "dwell", "window", "deadline")


def kinds_of(case: Asked) -> list[str]:
    """Names of :data:`KINDS` that apply to a problem."""
    legs = case["legs"]
    windows = [leg["arrival"] for leg in legs if "arrival" in leg]
    has = {
        "load": any("load" in leg for leg in legs),
        "grasp": any("rules" in leg for leg in legs),
        "friction": any(case["arms"][0]["friction"]),
        "dwell": any(leg.get("dwell") for leg in legs),
        "window": bool(windows),
        "deadline": bool(np.isfinite([latest for _, latest in windows]).any()),
    }
    return [kind for kind in KINDS if has[kind]]


def row(seed: int, number: int, effort: str, limit: float) -> dict[str, Any]:
    """Draw, plan and judge one problem."""
    case, slow = combined_case(seed, number)
    made = task(case)
    begin, worked = time.perf_counter(), time.process_time()
    solution = tm.plan(made.problem, effort=effort, max_planning_time=limit)
    seconds = time.perf_counter() - begin
    worked = time.process_time() - worked
    faults = made.judged(solution).faults if solution.success else ()
    return {
        "number": number,
        "robot": case["arms"][0]["robot"],
        "asked": " ".join([f"{len(case['legs'])} segments", *kinds_of(case)]),
        "status": solution.status.name,
        "verified": solution.success and not faults,
        "faults": "; ".join(faults),
        "T": solution.T if solution.success else np.inf,
        "slow_T": slow,
        "seconds": seconds,
        "processor_seconds": worked,
        "late": is_late(seconds, limit),
        "programs": sum(record.programs for record in solution.history),
        "message": " ".join(solution.message.split()),
    }


def table(rows: list[dict[str, Any]]) -> str:
    """Counts and times, in total and by kind, and T relative to the slow motion."""

    def line(name: str, part: list[dict[str, Any]]) -> tuple[object, ...]:
        seconds = [one["seconds"] for one in part]
        shares = [one["T"] / one["slow_T"] for one in part if one["verified"]]
        return (
            name,
            len(part),
            sum(one["verified"] for one in part),
            sum(bool(one["faults"]) for one in part),
            *(float(np.quantile(seconds, share)) for share in (0.5, 0.95, 1.0)),
            sum(one["late"] for one in part),
            float(np.median(shares)) if shares else np.nan,
        )

    lines = [line("all", rows)]
    for kind in KINDS:
        part = [one for one in rows if kind in one["asked"].split()]
        if part:
            lines.append(line(kind, part))
    header = ("with", "problems", "verified", "refuted")
    times = ("median s", "95 % s", "most s", "late", "T / slow T, median")
    return markdown((*header, *times), lines)


def main(argv: list[str] | None = None) -> int:
    """Plan all problems; 1 if too few motions are found, or a plan was late."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=150)
    parser.add_argument("--numbers", help="A,B: these alone")
    parser.add_argument("--seed", type=int, default=20261126)
    parser.add_argument("--effort", choices=EFFORTS, default="standard")
    parser.add_argument("--limit", type=float, default=10.0, help="of a plan [s]")
    parser.add_argument("--share", type=float, default=0.9, help="to be found")
    parser.add_argument("--processor", action="store_true", help="clocks are its own")
    parser.add_argument("--csv", type=Path, default=Path("out/combinations.csv"))
    given = parser.parse_args(argv)
    warnings.simplefilter("ignore")
    numbers = list(range(given.count))
    if given.numbers:
        numbers = [int(word) for word in given.numbers.split(",")]
    if given.processor:
        count_processor_time()
    tm.plan(task(combined_case(0, 0)[0]).problem, effort="quick")  # libraries load
    sheet = Sheet(given.csv, COLUMNS)
    for number in numbers:
        sheet.add(row(given.seed, number, given.effort, given.limit))
    print(table(sheet.rows))
    missed = [one for one in sheet.rows if not one["verified"]]
    for one in missed:
        print(f"\n{one['number']}, {one['robot']}: {one['faults'] or one['message']}")
    enough = len(missed) <= (1.0 - given.share) * len(sheet.rows)
    return int(not enough or any(sheet.column("late")))


if __name__ == "__main__":
    sys.exit(main())
