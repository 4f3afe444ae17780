"""Results and cost of the proofs of a motion, and the gain of a finer grid.

Random joint goals as in benchmarks/random_goals.py and the example scenarios, with
default options. Each motion is replayed and certified; the same problem is solved on a
grid four times finer.

    python -m benchmarks.trust
    python -m benchmarks.trust --robots ur5,panda --goals 2 --no-scenarios
"""

# ruff: noqa: E402 (the environment must be set before numerical libraries load)
from __future__ import annotations

from benchmarks.sheet import Sheet, markdown, one_thread

one_thread()

import argparse
import itertools
import statistics
import time
from pathlib import Path

import tominpmp as tm
from benchmarks.problems import random_goals, scenarios
from benchmarks.random_goals import ROBOTS

FINER = 4
COLUMNS = (
    "problem",
    "status",
    "verified",
    "T",
    "gap",
    "T_fine",
    "excess",
    "seconds",
    "replay_seconds",
    "certificate_seconds",
    "proof_share",
    "certified",
    "stationarity",
    "obeys",
    "saturated",
    "active",
)


def measure(name: str, problem: tm.Problem) -> list[object]:
    """Plan, prove, plan on the finer grid."""
    begin = time.process_time()
    solution = tm.plan(problem)
    planned = time.process_time() - begin
    begin = time.process_time()
    again = tm.verify(problem, solution.trajectory)
    replay = time.process_time() - begin
    certificate = tm.certify(problem, solution.trajectory, verification=again)
    proof = time.process_time() - begin
    fine = tm.plan(problem, tm.Options(intervals=FINER * solution.options.intervals))
    return [
        name,
        solution.status.name,
        solution.success,
        solution.T,
        solution.gap,
        fine.T,
        solution.T / fine.T - 1.0,
        planned,
        replay,
        proof - replay,
        # Planning already includes the replay.
        proof / (planned - replay),
        certificate.ok,
        certificate.stationarity,
        certificate.sign_share,
        certificate.saturated_share,
        certificate.active_share,
    ]


def main() -> int:
    """Measure, write the CSV file, print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", default=",".join(ROBOTS))
    parser.add_argument("--goals", type=int, default=5)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--no-scenarios", dest="scenarios", action="store_false")
    parser.add_argument("--csv", type=Path, default=Path("out/trust.csv"))
    arguments = parser.parse_args()
    sheet = Sheet(arguments.csv, COLUMNS)
    groups: dict[str, list[dict[str, object]]] = {}
    examples = scenarios() if arguments.scenarios else ()
    goals = random_goals(arguments.robots, arguments.goals, arguments.seed)
    for name, problem in itertools.chain(goals, examples):
        sheet.add(dict(zip(COLUMNS, measure(name, problem), strict=True)))
        groups.setdefault(name.split()[0], []).append(sheet.rows[-1])
    lines = []
    for name, rows in [*groups.items(), ("all", sheet.rows)]:

        def median(column: str, rows: list[dict[str, object]] = rows) -> float:
            return statistics.median(float(str(row[column])) for row in rows)

        def most(column: str, rows: list[dict[str, object]] = rows) -> float:
            return max(float(str(row[column])) for row in rows)

        lines.append(
            (
                name,
                f"{sum(bool(row['verified']) for row in rows)} / {len(rows)}",
                f"{100 * median('gap'):.1f} %",
                f"{100 * median('excess'):+.2f} %",
                f"{100 * most('excess'):+.2f} %",
                f"{100 * median('proof_share'):.0f} %",
                f"{sum(bool(row['certified']) for row in rows)} / {len(rows)}",
                f"{median('stationarity'):.1e}",
                f"{100 * median('obeys'):.0f} %",
                f"{100 * median('active'):.0f} %",
            )
        )
    header = (
        "problems",
        "verified",
        "gap to the bound",
        "T relative to a grid 4 x finer: median",
        "largest",
        "proofs / planning",
        "certified",
        "stationarity",
        "obey",
        "a limit active",
    )
    print(markdown(header, lines))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
