"""Random cells planned by the library, and checked by an independent program.

    python -m benchmarks.random_cells                     # 300 motions that were found
    python -m benchmarks.random_cells --count 20 --seed 7 --kinds friction,two_arms

Cells contain one or two arms on tilted or turned bases, fixed or moving boxes,
cylinders, capsules and balls, loads in the hand, dry friction, motion limits, moving
starts and goals, in joints or for the hand. Every motion that the library reports as a
success is written to a file and checked by ``benchmarks/cell_judge.py`` in a separate
process, which imports no code of the library. Files of refuted motions are kept in
``--folder``.

Results go to a CSV file, a row as soon as it is known; existing rows are not
computed again. A table is printed at the end.
"""

# ruff: noqa: E402 (the environment must be set before numerical libraries load)
from __future__ import annotations

import os

for _name in (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "HIGHS_NUM_THREADS",
):
    os.environ[_name] = "1"

import argparse
import csv
import json
import sys
import time
import warnings
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

if not __package__:  # run as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import tominpmp as tm
from benchmarks.cell_cases import KINDS, Case, draw_case, draw_problem, has_friction
from benchmarks.verdicts import verdict_of
from tominpmp.motion.trajectory import torque_breaks

JUDGE = Path(__file__).with_name("cell_judge.py")
COLUMNS = (
    "kind", "number", "robots", "status", "success", "claimed_T", "seconds", "refuted",
    "faults", "T", "jump", "torque_excess", "effort_excess", "velocity_excess",
    "position_excess", "acceleration_excess", "jerk_excess", "feedback", "deviation",
    "goal_error", "goal_speed", "clearance", "message",
)  # fmt: skip
# Shares of a piece at which its torque is written: Chebyshev points.
CHEBYSHEV = 0.5 - 0.5 * np.cos(np.pi * (np.arange(12) + 0.5) / 12)


def write_motion(solution: tm.Solution, path: Path) -> None:
    """Write nodes, and torques at instants of each interval."""
    motion = solution.trajectory
    assert motion is not None
    robot, held = solution.problem.robot, motion.inverse_dynamics is None
    share = np.array([0.5]) if held else CHEBYSHEV
    breaks = torque_breaks(motion, robot.friction)
    h = np.diff(breaks)
    times = breaks[:-1, None] + share * h[:, None]
    u = motion(times.ravel()).u.reshape(len(h), len(share), -1)
    a = np.zeros(0) if motion.a is None else motion.a
    parts = {"t": motion.t, "q": motion.q, "v": motion.v, "a": a, "breaks": breaks}
    np.savez(path, **parts, share=share, u=u, held=held)


def run_case(seed: int, kind: str, number: int, limit: float, folder: Path) -> Case:
    """Draw, plan and judge one problem; returns its row."""
    rng = np.random.default_rng([seed, KINDS.index(kind), number])
    for _ in range(200):
        case = draw_case(rng, kind)
        try:
            problem = draw_problem(rng, case)
        except tm.TominpmpError:
            continue
        break
    else:
        raise RuntimeError(f"no problem of the kind {kind!r} was found")
    options: dict[str, Any] = {"max_planning_time": limit}
    if kind == "torque_methods":
        options["method"] = str(rng.choice(["collocation", "adjoint"]))
    row: Case = {
        "kind": kind,
        "number": number,
        "robots": "+".join(arm["robot"] for arm in case["arms"]),
    }
    begin = time.process_time()
    try:
        solution = tm.plan(problem, tm.Options(**options))
    except tm.TominpmpError as error:
        return row | {"status": type(error).__name__, "message": str(error)[:200]}
    row |= {
        "seconds": round(time.process_time() - begin, 3),
        "status": solution.status.name,
        "success": solution.success,
        "message": solution.message[:200],
    }
    if not solution.success:
        return row
    folder.mkdir(parents=True, exist_ok=True)
    files = folder / f"{kind}_{number}.json", folder / f"{kind}_{number}.npz"
    files[0].write_text(json.dumps(case), encoding="utf-8")
    write_motion(solution, files[1])
    judged = verdict_of(JUDGE, *files)
    row |= {"claimed_T": solution.T, "refuted": bool(judged["faults"])}
    row |= judged | {"faults": "; ".join(judged["faults"])}
    if not judged["faults"]:
        for file in files:
            file.unlink()
    return row


def table(rows: Sequence[Case]) -> str:
    """Counts by kind, in Markdown."""
    lines = [
        "| kind | problems | found | refuted | median planning s |",
        "|---|---|---|---|---|",
    ]

    def line(name: str, part: Sequence[Case]) -> str:
        found = [row for row in part if str(row.get("success")) == "True"]
        bad = [row for row in found if str(row.get("refuted")) == "True"]
        seconds = [float(row["seconds"]) for row in part if row.get("seconds")]
        middle = f"{np.median(seconds):.2f}" if seconds else "-"
        return f"| {name} | {len(part)} | {len(found)} | {len(bad)} | {middle} |"

    for kind in dict.fromkeys(row["kind"] for row in rows):
        lines.append(line(kind, [row for row in rows if row["kind"] == kind]))
    return "\n".join([*lines, line("all", rows)])


def read_rows(path: Path) -> list[Case]:
    """Rows of an earlier run."""
    if not path.exists():
        return []
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def write_rows(path: Path, rows: Sequence[Case]) -> None:
    """Write all rows."""
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_name(path.name + ".part")
    with draft.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, COLUMNS, restval="", extrasaction="ignore")
        writer.writeheader()
        writer.writerows(rows)
    draft.replace(path)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the campaign; 1 if a motion was refuted."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--count", type=int, default=300, help="motions to be found")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--limit", type=float, default=20.0, help="time a plan [s]")
    parser.add_argument("--csv", type=Path, default=Path("out/random_cells.csv"))
    parser.add_argument("--folder", type=Path, default=Path("out/random_cells"))
    given = parser.parse_args(arguments)
    warnings.simplefilter("ignore", tm.TominpmpWarning)
    kinds = [kind for kind in given.kinds.split(",") if kind]
    if not has_friction() and "friction" in kinds:
        kinds.remove("friction")
    rows = read_rows(given.csv)
    known = {(row["kind"], int(row["number"])) for row in rows}
    counts: Counter[str] = Counter()
    is_found: Callable[[Case], bool] = lambda row: str(row.get("success")) == "True"  # noqa: E731
    while sum(map(is_found, rows)) < given.count:
        kind = kinds[sum(counts.values()) % len(kinds)]
        number = counts[kind]
        counts[kind] += 1
        if (kind, number) in known:
            continue
        row = run_case(given.seed, kind, number, given.limit, given.folder)
        rows.append(row)
        write_rows(given.csv, rows)
        if str(row.get("refuted")) == "True":
            print(f"{kind} {number}: {row['faults']}", flush=True)
    print(table(rows))
    return int(any(str(row.get("refuted")) == "True" for row in rows))


if __name__ == "__main__":
    sys.exit(main())
