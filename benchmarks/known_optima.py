r"""Problems whose minimum time is known: errors of each method, on each grid.

The problems, their minimum times in closed form or by shooting and their sources are in
tests/optimum_cases.py and tests/two_link_cases.py.

    python -m benchmarks.known_optima
    python -m benchmarks.known_optima --methods inverse --families level,vertical
    python -m benchmarks.known_optima --methods inverse --intervals 40 \
        --grids cosine --refine none,grid,switching --markdown out/known_optima.md
    python -m benchmarks.known_optima --methods auto --intervals 40 --grids cosine \
        --efforts quick,standard,thorough
    python -m benchmarks.known_optima --search --families level

``--search`` searches for faster motions than the known ones by a direct method that
shares no code with the library: Runge-Kutta steps on hand-written equations, IPOPT,
random starts. It needs casadi. Results go to a CSV file, a row as soon as it is known,
and as tables to the standard output or to a file.
"""

# ruff: noqa: E402 (the environment must be set before numerical libraries load)
from __future__ import annotations

import os

# One thread for every solver and for linear algebra; read when the libraries load.
for _name in (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "HIGHS_NUM_THREADS",
):
    os.environ[_name] = "1"

import argparse
import csv
import itertools
import sys
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
# The problems belong to the tests, whose modules find each other by their folder.
sys.path.insert(0, str(ROOT / "tests"))

from bang_bang import Structure, find_extremal
from optimum_cases import Case
from reference_optima import Array, Task
from two_link_cases import CASES

from tominpmp import Options, plan

METHODS = ("auto", "inverse", "collocation", "adjoint")
GRIDS = ("cosine", "uniform")
REFINEMENTS = ("auto", "none", "grid", "switching")
EFFORTS = ("quick", "standard", "thorough")
COLUMNS = (
    "family",
    "problem",
    "method",
    "effort",
    "intervals",
    "grid",
    "refine",
    "T_known",
    "T",
    "error",
    "status",
    "success",
    "iterations",
    "seconds",
)
# Longest planning of one problem [s].
PATIENCE = 60.0
# Relative errors at least this large are given in per cent.
PER_CENT = 1e-5
# The direct search: intervals, Runge-Kutta steps in each, and how far apart durations
# of different local optima are at least.
SEARCH_INTERVALS = 80
SEARCH_STEPS = 2
DISTINCT = 5e-4

Row = dict[str, Any]


def measure(
    family: str,
    case: Case,
    method: str,
    effort: str,
    intervals: int,
    grid: str,
    refine: str,
) -> Row:
    """Plan a problem and compare T with the known minimum."""
    options = Options(
        method=method,
        effort=effort,
        intervals=intervals,
        grid=grid,
        refine=None if refine == "none" else refine,
        max_planning_time=PATIENCE,
    )
    problem = case.problem()
    started = time.process_time()
    solution = plan(problem, options)
    return {
        "family": family,
        "problem": case.name,
        "method": method,
        "effort": effort,
        "intervals": intervals,
        "grid": grid,
        "refine": refine,
        "T_known": case.minimum,
        "T": solution.T,
        "error": solution.T / case.minimum - 1.0,
        "status": solution.status.name,
        "success": solution.success,
        "iterations": solution.iterations,
        "seconds": time.process_time() - started,
    }


def run(arguments: argparse.Namespace) -> list[Row]:
    """Measure all requested settings."""
    rows: list[Row] = []
    arguments.csv.parent.mkdir(parents=True, exist_ok=True)
    with arguments.csv.open("w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        cases = [(name, case) for name in arguments.families for case in _cases(name)]
        settings = itertools.product(
            arguments.methods,
            arguments.efforts,
            arguments.intervals,
            arguments.grids,
            arguments.refine,
        )
        for (family, case), setting in itertools.product(cases, settings):
            row = measure(family, case, *setting)
            rows.append(row)
            writer.writerow(row)
            file.flush()
            print(_progress(row), file=sys.stderr, flush=True)
    return rows


def _cases(family: str) -> list[Case]:
    return list(CASES[family].values())


def _progress(row: Row) -> str:
    return (
        f"{row['problem']}, {row['method']}, {row['effort']}, "
        f"{row['intervals']} {row['grid']}, "
        f"refine {row['refine']}: {_cell(row)}"
    )


def _cell(row: Row) -> str:
    """Relative error, iterations, seconds, and the failure, if any."""
    if not row["success"]:
        return f"no motion ({row['status'].lower()})"
    note = "" if row["status"] == "CONVERGED" else f", {row['status'].lower()}"
    error = f"{100.0 * row['error']:+.3f} %"
    if abs(row["error"]) < PER_CENT:
        error = f"{row['error']:+.0e}"
    return f"{error}, {row['iterations']} it, {row['seconds']:.2f} s{note}"


def markdown_tables(rows: Iterable[Row]) -> str:
    """One table per method: a row for each problem, a column for each setting."""
    rows = list(rows)
    parts = []
    for method in dict.fromkeys(row["method"] for row in rows):
        chosen = [row for row in rows if row["method"] == method]
        settings = dict.fromkeys(
            f"{row['effort']}, N = {row['intervals']}, {row['grid']}"
            + (f", refine {row['refine']}" if row["refine"] != "auto" else "")
            for row in chosen
        )
        header = ["problem", "T [s]", *settings]
        lines = [f"### {method}", "", _line(header), "|" + "---|" * len(header)]
        cells: dict[str, list[str]] = {}
        for row in chosen:
            first = [row["problem"], f"{row['T_known']:.6f}"]
            cells.setdefault(row["problem"], first).append(_cell(row))
        lines += [_line(line) for line in cells.values()]
        parts.append("\n".join(lines))
    return "\n\n".join(parts)


def _line(cells: Iterable[str]) -> str:
    return "| " + " | ".join(cells) + " |"


class DirectSearch:
    """Minimum time by a direct method on hand-written equations.

    Torques are constant on equal intervals; torques and states are the unknowns.

    Args:
        task: The problem.
    """

    def __init__(self, task: Task) -> None:
        import casadi as ca

        self._task = task
        n, count = task.mechanism.n, SEARCH_INTERVALS
        q, v, u = (ca.SX.sym(name, n) for name in "qvu")
        h = ca.SX.sym("h")

        def rate(x: Any) -> Any:
            state = np.array(ca.vertsplit(x), dtype=object)
            mass, forces = task.mechanism.terms(state[:n], state[n:])
            rows = [ca.horzcat(*row) for row in mass]
            pull = ca.vertcat(*np.broadcast_to(forces, n))
            return ca.vertcat(x[n:], ca.solve(ca.vertcat(*rows), u - pull))

        start = x = ca.vertcat(q, v)
        step = h / SEARCH_STEPS
        for _ in range(SEARCH_STEPS):
            k1 = rate(x)
            k2 = rate(x + step / 2 * k1)
            k3 = rate(x + step / 2 * k2)
            k4 = rate(x + step * k3)
            x = x + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        move = ca.Function("move", [start, u, h], [x])
        states, torques = ca.MX.sym("x", 2 * n, count + 1), ca.MX.sym("u", n, count)
        T = ca.MX.sym("T")
        lengths = ca.repmat(T / count, 1, count)
        defects = move.map(count)(states[:, :-1], torques, lengths) - states[:, 1:]
        program = {
            "x": ca.vertcat(ca.vec(states), ca.vec(torques), T),
            "f": T,
            "g": ca.vec(defects),
        }
        quiet = {"print_level": 0, "sb": "yes", "max_iter": 500, "max_wall_time": 20.0}
        self._solver = ca.nlpsol(
            "search", "ipopt", program, {"print_time": False, "ipopt": quiet}
        )

    def solve(
        self, rng: np.random.Generator, duration: float, wildness: float
    ) -> tuple[float, Array]:
        """Solve from a random start.

        Args:
            rng: Random numbers.
            duration: T of the start [s].
            wildness: Distance of the start from a straight line [rad].

        Returns:
            T, infinite if IPOPT failed, and torques as shares of their range, shape
            (N, n).
        """
        task, count = self._task, SEARCH_INTERVALS
        lower, upper = task.bounds.T
        s = np.linspace(0.0, 1.0, count + 1)[:, None]
        states = task.ends[0] + s * (task.ends[1] - task.ends[0])
        for wave in (1, 2, 3):
            states = states + wildness * np.sin(wave * np.pi * s) * rng.normal(
                size=states.shape[1]
            )
        torques = rng.uniform(lower, upper, (count, lower.size))
        low, high = np.full_like(states, -np.inf), np.full_like(states, np.inf)
        low[[0, -1]] = high[[0, -1]] = task.ends
        answer = self._solver(
            x0=np.concatenate([states.ravel(), torques.ravel(), [duration]]),
            lbx=np.concatenate([low.ravel(), np.tile(lower, count), [1e-3]]),
            ubx=np.concatenate([high.ravel(), np.tile(upper, count), [np.inf]]),
            lbg=0.0,
            ubg=0.0,
        )
        z = np.asarray(answer["x"]).ravel()
        torques = z[states.size : -1].reshape(count, -1)
        T = float(z[-1]) if self._solver.stats()["success"] else np.inf
        return T, (torques - lower) / (upper - lower)


def read_structure(T: float, shares: Array) -> Structure:
    """Read switches off torques that are constant on equal intervals.

    Args:
        T: Duration [s].
        shares: Torques as shares of their range, shape (N, n).

    Returns:
        The structure, with approximate times.
    """
    events: list[tuple[float, str]] = []
    step = T / shares.shape[0]
    for joint, column in enumerate(shares.T, 1):
        high = bool(column[0] > 0.5)
        for k, share in enumerate(column):
            # An interval in which the torque switches has a value in between.
            kept = share if high else 1.0 - share
            following = column[k + 1] if k + 1 < column.size else column[k]
            if kept < 0.5 or (kept < 0.98 and (following > 0.5) != high):
                events.append(((k + kept) * step, str(joint)))
                high = not high
    events.sort()
    times = [max(at, 1e-3 * T) for at, _ in events]
    first = "".join("+" if share > 0.5 else "-" for share in shares[0])
    return Structure(first, "".join(joint for _, joint in events), [*times, T])


def search(case: Case, starts: int, seed: int) -> list[str]:
    """Search for local optima; a line for each different optimum."""
    rng = np.random.default_rng(seed)
    direct = DirectSearch(case.task)
    found = []
    for start in range(starts):
        duration = case.minimum * float(np.exp(rng.normal(0.0, 0.4)))
        found.append(direct.solve(rng, duration, 0.0 if start == 0 else 1.0))
    found.sort(key=lambda item: item[0])
    lines, last = [], 0.0
    for T, shares in found:
        if not np.isfinite(T) or T < last * (1.0 + DISTINCT):
            continue
        last = T
        rough = read_structure(T, shares)
        line = f"direct {T:.6f} s, {rough.first} {rough.order}"
        try:
            extremal = find_extremal(case.task, rough, rough=True)
        except (ArithmeticError, ValueError) as error:
            lines.append(f"{line}: no extremal ({error})")
            continue
        times = ", ".join(f"{t:.6f}" for t in extremal.structure.times)
        lines.append(
            f"{line}: extremal {extremal.T:.8f} s, switches at {times}, "
            f"wrong sign {extremal.wrong_sign:.0e}"
        )
    return lines


def _parser() -> argparse.ArgumentParser:
    def names(known: Sequence[str]) -> Any:
        def parse(text: str) -> list[str]:
            chosen = [part.strip() for part in text.split(",") if part.strip()]
            if not chosen or set(chosen) - set(known):
                raise argparse.ArgumentTypeError(f"choose from {', '.join(known)}")
            return chosen

        return parse

    def numbers(text: str) -> list[int]:
        return [int(part) for part in text.split(",")]

    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.known_optima",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    families = list(CASES)
    parser.add_argument("--families", type=names(families), default=families)
    parser.add_argument("--methods", type=names(METHODS), default=list(METHODS[1:]))
    parser.add_argument("--grids", type=names(GRIDS), default=list(GRIDS))
    parser.add_argument("--efforts", type=names(EFFORTS), default=["standard"])
    parser.add_argument("--refine", type=names(REFINEMENTS), default=["auto"])
    parser.add_argument("--intervals", type=numbers, default=[20, 40, 80])
    parser.add_argument("--search", action="store_true", help="look for faster motions")
    parser.add_argument("--starts", type=int, default=10, help="of a search")
    parser.add_argument("--seed", type=int, default=0, help="of a search")
    parser.add_argument("--csv", type=Path, default=Path("out/known_optima.csv"))
    parser.add_argument("--markdown", type=Path, help="write the tables to this file")
    return parser


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the benchmark and print its tables."""
    options = _parser().parse_args(arguments)
    if not options.search:
        tables = markdown_tables(run(options))
        if options.markdown is None:
            print(tables)
        else:
            options.markdown.parent.mkdir(parents=True, exist_ok=True)
            options.markdown.write_text(f"{tables}\n", encoding="utf-8")
        return
    for family in options.families:
        for case in CASES[family].values():
            if not case.structures:
                continue
            known = ", ".join(f"{extremal.T:.8f}" for extremal in case.extremals)
            print(f"{case.name}: known {known} s", flush=True)
            for line in search(case, options.starts, options.seed):
                print("   ", line, flush=True)


if __name__ == "__main__":
    main()
