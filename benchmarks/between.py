"""Motions with constraints between start and goal, compared with motions without.

    python -m benchmarks.between                      # 40 problems
    python -m benchmarks.between --numbers 0-11 --seed 3

Panda, UR5 and xArm7 among six obstacles, random starts and goals, and in turn a tool
that stays upright within 10 degrees, a tool speed of 0.5 m/s, or two intermediate goals
that are passed (positions, poses, configurations). Each problem is planned with default
options, and once more without these constraints, in the same run. The motions are
exported as CSV and checked by ``benchmarks/between_judge.py`` in a separate process,
which shares no code with the planner.

Rows go to a CSV file as soon as they are known; a table is printed at the end. Exits
with 1 if a motion was refuted.
"""

# ruff: noqa: E402 (the environment must be set before numerical libraries load)
from __future__ import annotations

from benchmarks.sheet import Sheet, markdown, one_thread

one_thread()

import argparse
import json
import sys
import time
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import tominpmp as tm
from benchmarks.between_cases import KINDS, draw
from benchmarks.verdicts import verdict_of

JUDGE = Path(__file__).with_name("between_judge.py")
COLUMNS = (
    "number", "kind", "robot", "goal", "solved", "seconds", "free_seconds", "ratio",
    "T", "free_T", "status", "free_status", "verified", "faults", "clearance",
    "message",
)  # fmt: skip
STEP = 0.00025  # time step of an exported motion [s]


def planned(problem: tm.Problem, limit: float) -> tuple[tm.Solution, float]:
    """A plan, and its processor time [s]."""
    begin = time.process_time()
    solution = tm.plan(problem, max_planning_time=limit)
    return solution, time.process_time() - begin


def judged(case: dict[str, Any], solution: tm.Solution, folder: Path) -> dict[str, Any]:
    """Verdict of the judge on the exported motion."""
    folder.mkdir(parents=True, exist_ok=True)
    name = str(case["number"])
    files = folder / f"{name}.json", folder / f"{name}.csv"
    files[0].write_text(json.dumps(case), encoding="utf-8")
    solution.export(files[1], dt=STEP)
    return verdict_of(JUDGE, *files)


def run(seed: int, number: int, limit: float, folder: Path) -> dict[str, Any]:
    """Plan and judge one problem; returns its row."""
    case, problem, free = draw(seed, number)
    row: dict[str, Any] = dict.fromkeys(COLUMNS, "")
    row |= {
        "number": number,
        "kind": case["kind"],
        "robot": case["arms"][0]["robot"],
        "goal": "+".join(goal["kind"] for goal in case["goals"]),
    }
    for _ in range(2 if number == 0 else 1):  # the first plan loads libraries
        without, seconds = planned(free, limit)
    solution, own = planned(problem, limit)
    row |= {
        "solved": solution.success,
        "seconds": own,
        "free_seconds": seconds,
        "ratio": own / seconds,
        "T": solution.T if solution.success else "",
        "free_T": without.T if without.success else "",
        "status": solution.status.name,
        "free_status": without.status.name,
        "message": solution.message,
    }
    if solution.success:
        found = judged(case, solution, folder)
        row["faults"] = "; ".join(found["faults"])
        row |= {"verified": not found["faults"], "clearance": found.get("clearance")}
    return row


def table(sheet: Sheet) -> str:
    """Counts and times by kind, in Markdown."""
    lines = []
    for kind in (*KINDS, "all"):
        rows = [row for row in sheet.rows if kind in ("all", row["kind"])]
        if not rows:
            continue
        solved = [row for row in rows if row["solved"]]
        both = [row for row in solved if row["free_T"]]
        own, free = ([row[key] for row in rows] for key in ("seconds", "free_seconds"))
        longer = [row["T"] / row["free_T"] for row in both]
        lines.append(
            (
                kind,
                f"{len(solved)} / {len(rows)}",
                sum(row["verified"] is True for row in solved),
                float(np.median(own)),
                float(np.median(free)),
                float(np.median(own) / np.median(free)),
                float(np.median([row["ratio"] for row in rows])),
                max(own),
                float(np.median(longer)) if longer else "-",
            )
        )
    header = ["kind", "solved", "verified", "median s", "without", "ratio of medians"]
    header += ["median of ratios", "max s", "median T / T without"]
    return markdown(header, lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--numbers", default="0-39", help="as 0-39 or 3,5,8")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--limit", type=float, default=60.0, help="time a plan [s]")
    parser.add_argument("--csv", type=Path, default=Path("out/between.csv"))
    parser.add_argument("--folder", type=Path, default=Path("out/between"))
    given = parser.parse_args(arguments)
    warnings.simplefilter("ignore", tm.TominpmpWarning)
    numbers: list[int] = []
    for part in given.numbers.split(","):
        first, _, last = part.partition("-")
        numbers += range(int(first), int(last or first) + 1)
    sheet = Sheet(given.csv, COLUMNS)
    for number in numbers:
        sheet.add(run(given.seed, number, given.limit, given.folder))
    print(table(sheet))
    return int(any(row["verified"] is False for row in sheet.rows))


if __name__ == "__main__":
    sys.exit(main())
