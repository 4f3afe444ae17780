"""Planning and replays with one BLAS thread per core, and with a single BLAS thread.

python -m benchmarks.blas_threads [--goals 12] [--rounds 2] [--busy 2]

Random goals of a Panda, each planned and replayed in both ways, one after the other in
one process, first on the machine as found and then with programs that keep cores busy.
Unlike all other benchmarks, this one does not set the number of threads to one.
"""

# ruff: noqa: E402 (BLAS loads before other benchmarks leave it one thread)
from __future__ import annotations

import os

NAMES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
SET = [name for name in NAMES if name in os.environ]

import scipy.linalg  # noqa: F401

# isort: split
import argparse
import contextlib
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import tominpmp as tm
from benchmarks.problems import random_goals
from benchmarks.sheet import Sheet, markdown
from tominpmp import blas_threads

COLUMNS = ("busy", "problem", "round", "threads", "plan", "replay")
BUSY = "while True: pass"
# Number of threads without the limit of the library, and with it.
WAYS = ("all", "one")


class _NoLimit:
    """Replacement for the controller that limits threads of libraries."""

    def limit(self, **settings: Any) -> contextlib.nullcontext[None]:
        """Return a context without a limit."""
        return contextlib.nullcontext()


@contextlib.contextmanager
def threads(way: str) -> Iterator[None]:
    """Context in which calls of the library use a number of threads."""
    usual = blas_threads.blas
    limited = {"all": _NoLimit, "one": usual}[way]
    vars(blas_threads)["blas"] = limited
    try:
        yield
    finally:
        vars(blas_threads)["blas"] = usual


@contextlib.contextmanager
def busy_cores(count: int) -> Iterator[None]:
    """Other processes that compute without pause."""
    others = [subprocess.Popen([sys.executable, "-c", BUSY]) for _ in range(count)]
    try:
        yield
    finally:
        for other in others:
            other.kill()
            other.wait()


def seconds(act: Callable[[], Any]) -> tuple[float, Any]:
    """Wall-clock time [s], and the result."""
    begin = time.perf_counter()
    found = act()
    return time.perf_counter() - begin, found


def main() -> int:
    """Measure, write the CSV file, print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--goals", type=int, default=12)
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--busy", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--seed", type=int, default=11)
    parser.add_argument("--csv", type=Path, default=Path("out/blas_threads.csv"))
    arguments = parser.parse_args()
    if SET:
        parser.error(f"{SET[0]} is set, and would fix the number of threads")
    problems = list(random_goals("panda", arguments.goals, arguments.seed))
    motions = [tm.plan(problem) for _, problem in problems]  # and libraries load
    sheet = Sheet(arguments.csv, COLUMNS)
    for busy in (0, arguments.busy):
        with busy_cores(busy):
            for turn in range(arguments.rounds):
                for (name, problem), motion in zip(problems, motions, strict=True):
                    for way in WAYS if turn % 2 else WAYS[::-1]:
                        _measure(sheet, (busy, name, turn, way), problem, motion)
    lines = []
    for busy in dict.fromkeys(sheet.column("busy")):
        for what in ("plan", "replay"):
            free, one = (
                sum(sheet.column(what, busy=busy, threads=way)) / arguments.rounds
                for way in WAYS
            )
            lines.append((busy, what, round(free, 2), round(one, 2), free / one))
    header = ("busy programs", "what", "all threads [s]", "one [s]", "ratio")
    print(markdown(header, lines))
    return 0


def _measure(
    sheet: Sheet, key: tuple[Any, ...], problem: tm.Problem, motion: tm.Solution
) -> None:
    with threads(str(key[-1])):
        plan, _ = seconds(lambda: tm.plan(problem))
        replay, _ = seconds(lambda: tm.verify(problem, motion.trajectory))
    sheet.add(dict(zip(COLUMNS, (*key, plan, replay), strict=True)))


if __name__ == "__main__":
    raise SystemExit(main())
