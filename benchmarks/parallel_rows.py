"""The gain of computing the rows of the linear program in parallel.

Rows are the derivatives of inverse dynamics, the distances and their gradients at the
instants of a motion. They are independent of each other, so that several threads or
processes, each with separate scratch memory, can share them. The benchmark measures one
round of rows (minimum wall-clock time of many repetitions), and the share of these
rounds in planning, which bounds the possible gain (Amdahl).

    python -m benchmarks.parallel_rows
    python -m benchmarks.parallel_rows --scene scene0001.yaml --request request0001.yaml
"""

# ruff: noqa: E402 (the environment must be set before numerical libraries load)
from __future__ import annotations

from benchmarks.sheet import Sheet, markdown, one_thread

one_thread()

import argparse
import pickle
import sys
import time
from collections.abc import Callable
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

import tominpmp as tm
from tominpmp.collision.checker import CollisionChecker
from tominpmp.dynamics import RobotDynamics

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "examples"))

COLUMNS = ("problem", "intervals", "work", "way", "milliseconds", "gain")
# Instants of an interval with rows.
ROWS_PER_INTERVAL = 2
# Distances beyond this share of a metre are bounds only, and give no rows.
CUTOFF = 0.1
# Distance of configurations from those of the preceding round [rad].
JITTER = 0.01
WORK = ("dynamics", "distances", "both")


class Rows:
    """Calculator of rows; every worker has a separate one."""

    def __init__(self, problem: tm.Problem) -> None:
        self.dynamics = RobotDynamics(problem.robot)
        self.checker = CollisionChecker(
            problem.robot,
            problem.scene,
            self_collision=problem.checker.self_collision,
        )

    def dynamics_rows(self, q: Any, v: Any, a: Any) -> Any:
        """Torques and their derivatives."""
        found = self.dynamics.inverse_jacobians(q, v, a)
        return found.tau_q, found.tau_v, found.tau_a

    def distance_rows(self, q: Any, v: Any, a: Any) -> Any:
        """Distances, and gradients of the short ones."""
        distances = self.checker.distances(q, CUTOFF)
        instants, pairs = np.nonzero(distances < CUTOFF)
        return distances, self.checker.derivatives_at(q, instants, pairs).gradients

    def compute(self, work: str, q: Any, v: Any, a: Any) -> Any:
        """The rows of one kind, or of both."""
        found = []
        if work != "distances":
            found.append(self.dynamics_rows(q, v, a))
        if work != "dynamics":
            found.append(self.distance_rows(q, v, a))
        return found


_own: list[Rows] = []


def begin_process(problem: bytes) -> None:
    """Prepare a process, which keeps its robot and scene."""
    _own.append(Rows(pickle.loads(problem)))


def in_process(work: str, *states: Any) -> Any:
    """Compute rows in a prepared process; returns its processor time, too."""
    begin = time.process_time()
    found = _own[0].compute(work, *states)
    return found, time.process_time() - begin


def panda(arguments: argparse.Namespace) -> tm.Problem:
    """A Panda in the given scene, or in the shelf of the examples."""
    if arguments.scene is not None:
        robot = tm.load_robot(
            "panda", limits="urdf", locked_joints={"panda_finger_joint1": 0.04}
        )
        return tm.load_moveit(robot, arguments.scene, arguments.request)
    path = ROOT / "examples" / "scenarios" / "panda_shelf.toml"
    return tm.load_scenario(path).problem


def two_ur5(arguments: argparse.Namespace) -> tm.Problem:
    """Two UR5s over a table, from the example of this name."""
    import two_ur5 as example

    return example.problem(example.workcell())


PROBLEMS = {"panda": panda, "two_ur5": two_ur5}


def best(task: Callable[[int], Any], repetitions: int) -> float:
    """Minimum wall-clock time of several calls [s]."""
    least = np.inf
    for number in range(repetitions):
        begin = time.perf_counter()
        task(number)
        least = min(least, time.perf_counter() - begin)
    return float(least)


def best_path(task: Callable[[int], list[Any]], repetitions: int) -> float:
    """Minimum time of several calls if every process had a separate core [s].

    This is the processor time of the slowest worker plus that of this process, which
    distributes the work and collects the results.
    """
    least = np.inf
    for number in range(repetitions):
        begin = time.process_time()
        found = task(number)
        own = time.process_time() - begin
        least = min(least, own + max(seconds for _, seconds in found))
    return float(least)


def shared(
    pool: Executor, calls: list[Callable[..., Any]], work: str, states: list[Any]
) -> list[Any]:
    """Rows of one part of the instants from each call."""
    parts = [np.array_split(x, len(calls)) for x in states]
    waiting = [
        pool.submit(call, work, *part)
        for call, part in zip(calls, zip(*parts, strict=True), strict=True)
    ]
    return [item.result() for item in waiting]


def shared_round(
    pool: Executor,
    calls: list[Callable[..., Any]],
    work: str,
    states: list[list[Any]],
    number: int,
) -> list[Any]:
    """One round for one of several motions in turn."""
    return shared(pool, calls, work, states[number % len(states)])


def one_round(rows: Rows, work: str, states: list[list[Any]], number: int) -> list[Any]:
    """One round in this process, without workers."""
    rows.compute(work, *states[number % len(states)])
    return [(None, 0.0)]


def measure(
    problem: tm.Problem, motion: tm.Trajectory, N: int, arguments: argparse.Namespace
) -> dict[tuple[str, str], float]:
    """Times of one round of rows [s], by kind of work and by method."""
    times = np.linspace(0.0, motion.duration, ROWS_PER_INTERVAL * N)
    state = motion(times)
    rng = np.random.default_rng(0)
    # Successive motions differ slightly, as those of successive iterations do.
    states = [
        [state.q + JITTER * rng.normal(size=state.q.shape), state.v, state.a]
        for _ in range(5)
    ]
    workers, count = arguments.workers, arguments.repetitions
    rows = [Rows(problem) for _ in range(workers)]
    found = {}
    for work in WORK:
        task = partial(one_round, rows[0], work, states)
        found[work, "one"] = best(task, count)
        found[work, "one core"] = best_path(task, count)
    with ThreadPoolExecutor(workers) as pool:
        calls: list[Callable[..., Any]] = [item.compute for item in rows]
        for work in WORK:
            found[work, "threads"] = best(
                partial(shared_round, pool, calls, work, states), count
            )
    with ProcessPoolExecutor(
        workers, get_context("spawn"), begin_process, (pickle.dumps(problem),)
    ) as processes:
        calls = [in_process] * workers
        begin = time.perf_counter()
        shared_round(processes, calls, "both", states, 0)
        found["begin", "processes"] = time.perf_counter() - begin
        for work in WORK:
            task = partial(shared_round, processes, calls, work, states)
            found[work, "processes"] = best(task, count)
            found[work, "own cores"] = best_path(task, count)
    return found


def compared(way: str) -> str:
    """Reference of a method: wall-clock times with wall-clock times, and so on."""
    return "one core" if "core" in way else "one"


def main() -> int:
    """Measure, write the CSV file, print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--problems", default=",".join(PROBLEMS))
    parser.add_argument("--intervals", default="40,80,160")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--repetitions", type=int, default=20)
    parser.add_argument("--scene", type=Path, help="planning scene of MoveIt, YAML")
    parser.add_argument("--request", type=Path, help="motion plan request to it")
    parser.add_argument("--csv", type=Path, default=Path("out/parallel_rows.csv"))
    arguments = parser.parse_args()
    sheet = Sheet(arguments.csv, COLUMNS)
    lines, shares = [], []
    for name in arguments.problems.split(","):
        problem = PROBLEMS[name](arguments)
        for number, N in enumerate(int(x) for x in arguments.intervals.split(",")):
            if not number:
                begin = time.process_time()
                solution = tm.plan(problem, tm.Options(intervals=N, starts=1))
                planning = time.process_time() - begin
                if solution.trajectory is None:
                    raise SystemExit(f"{name}: {solution.message}")
                motion, rounds = solution.trajectory, len(solution.history)
            found = measure(problem, motion, N, arguments)
            if not number:
                share = rounds * found["both", "one core"] / planning
                ready = f"{found['begin', 'processes']:.1f}"
                percent = f"{100.0 * share:.0f} %"
                shares.append((name, N, f"{planning:.1f}", rounds, percent, ready))
            for (work, way), seconds in found.items():
                if work not in WORK:
                    continue
                gain = found[work, compared(way)] / seconds
                values = (name, N, work, way, 1e3 * seconds, gain)
                sheet.add(dict(zip(COLUMNS, values, strict=True)))
            for work in WORK:
                line = [name, N, work, f"{1e3 * found[work, 'one']:.1f}"]
                for way in ("threads", "processes", "own cores"):
                    seconds = found[work, way]
                    gain = found[work, compared(way)] / seconds
                    line += [f"{1e3 * seconds:.1f}", f"{gain:.2f}"]
                lines.append(line)
    header = ("problem", "N", "rows", "one [ms]", "threads [ms]", "gain")
    print(
        markdown((*header, "processes [ms]", "gain", "own cores [ms]", "gain"), lines)
    )
    header = ("problem", "N", "planning [s]", "rounds", "share", "processes begin [s]")
    print(markdown(header, shares))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
