"""Running the golden set: each problem in a separate process, rows at once.

The state after one problem (caches, random numbers of OMPL, measured times of programs)
has no effect on the next. All modules are loaded before, and robots and scenes
are read, so that the processor time is that of the planner alone.
"""

from __future__ import annotations

import csv
import math
import multiprocessing
import os
import pkgutil
import resource
import signal
import subprocess
import time
import warnings
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from benchmarks.golden_problems import Task

Row = dict[str, str]
KEY = ("variant", "part", "seed", "group", "name")
COLUMNS = (
    *KEY,
    "fingerprint",
    "status",
    "success",
    "T",
    "objective",
    "promise",
    "excess",
    "clearance",
    "faults",
    "programs",
    "iterations",
    "seconds",
    "method",
    "intervals",
    "revision",
    "message",
)
PARTS = ("tuned", "fresh")
# Variant without a change of the planner.
BASE = ""
# Status of a problem whose process was killed at its time limit, or crashed.
OVER, DIED = "TIME_USED_UP", "DIED"
LONGEST_MESSAGE = 160
# Packages of the library that no plan needs.
WITHOUT = ("tominpmp.app", "tominpmp.cli", "tominpmp.viz", "tominpmp.__main__")


@dataclass(frozen=True)
class Item:
    """One problem to be planned.

    Attributes:
        part: "tuned" or "fresh".
        group: Its group.
        name: Its name.
        data: Folder of MotionBenchMaker; None without.
        seed: Seed of a fresh part; otherwise 0.
        variant: Variant of the planner, see ``ablation.py``.
    """

    part: str
    group: str
    name: str
    data: Path | None = None
    seed: int = 0
    variant: str = BASE

    @property
    def key(self) -> tuple[str, ...]:
        """Its name in the CSV file."""
        return (self.variant, self.part, str(self.seed), self.group, self.name)


class Rows:
    """The CSV file: rows of earlier runs, and rows added one by one.

    Args:
        path: The file; its rows are kept.
        revision: Revision of the library; rows of other revisions are refused.

    Raises:
        SystemExit: If the file has other columns, or rows of another revision.
    """

    def __init__(self, path: Path, revision: str) -> None:
        self.path, self.rows = path, read_rows(path)
        others = {row["revision"] for row in self.rows.values()} - {revision}
        if others:
            raise SystemExit(
                f"{path} has rows of revision {', '.join(sorted(others))}, and the "
                f"library is {revision}; choose another --csv"
            )
        # Problems that crashed or were killed are tried again.
        self.rows = {
            key: row
            for key, row in self.rows.items()
            if not row["status"].startswith(DIED)
        }
        path.parent.mkdir(parents=True, exist_ok=True)
        self._write()

    def add(self, row: Row) -> None:
        """Add a row; it is on the disk when this returns."""
        self.rows[tuple(row[name] for name in KEY)] = row
        self._write()

    def _write(self) -> None:
        draft = self.path.with_name(self.path.name + ".part")
        with draft.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, COLUMNS, restval="")
            writer.writeheader()
            writer.writerows(self.rows.values())
            file.flush()
            os.fsync(file.fileno())
        draft.replace(self.path)


def read_rows(path: Path) -> dict[tuple[str, ...], Row]:
    """Rows of a CSV file by their key; none if there is no file.

    Raises:
        SystemExit: If it has other columns.
    """
    if not path.exists() or not path.stat().st_size:
        return {}
    with path.open(newline="", encoding="utf-8") as file:
        reader = csv.DictReader(file)
        if tuple(reader.fieldnames or ()) != COLUMNS:
            raise SystemExit(f"{path} has other columns than a golden set")
        return {tuple(row[name] for name in KEY): row for row in reader}


def revision() -> str:
    """Last commit of the library that is imported; with a plus where it was changed."""
    import tominpmp

    folder = Path(tominpmp.__file__).parent

    def git(*words: str) -> str:
        found = subprocess.run(
            ["git", "-C", str(folder), *words],
            capture_output=True,
            text=True,
            check=False,
        )
        return found.stdout.strip()

    changed = git("status", "--porcelain", "--", str(folder))
    commit = git("log", "-1", "--format=%h", "--", str(folder))
    return (commit or "unknown") + ("+" if changed else "")


def items(
    part: str,
    groups: Sequence[str] | None = None,
    data: Path | None = None,
    seed: int = 0,
    every: int = 1,
) -> Iterator[Item]:
    """The problems of a part.

    Args:
        part: "tuned" or "fresh".
        groups: Names of groups; None for all.
        data: Folder of MotionBenchMaker; without it groups that need it are empty.
        seed: Seed of a fresh part.
        every: Of each group, the first of this many problems.
    """
    from benchmarks.golden_cases import Source

    known = groups_of(part)
    for group in known if groups is None else groups:
        for number, (name, _) in enumerate(known[group](Source(data, seed))):
            if number % every == 0:
                yield Item(part, group, name, data, seed if part == "fresh" else 0)


def groups_of(part: str) -> dict[str, Callable[..., Any]]:
    """The groups of a part."""
    from benchmarks import golden_cases, golden_fresh

    return dict((golden_cases if part == "tuned" else golden_fresh).GROUPS)


def task_of(item: Item) -> Task:
    """Make the problem of an item."""
    from benchmarks.golden_cases import Source

    made = groups_of(item.part)[item.group](Source(item.data, item.seed))
    return dict(made)[item.name]()


# -- one problem -----------------------------------------------------------------------


def measure(task: Task, *, judged: bool = True) -> dict[str, Any]:
    """Plan a problem and judge the motion; the columns of a row.

    Args:
        task: The problem.
        judged: Whether to judge it.
    """
    import tominpmp as tm

    former = None if task.start is None else task.start()
    begin = _processor_time()
    # Without a time limit results do not depend on the clock; latency.py has limits.
    options = {"max_planning_time": math.inf, **task.options}
    solution = tm.plan(task.problem, start=former, **options)
    if task.slack is not None and solution.success:
        solution = tm.smooth(solution, task.slack)
    found: dict[str, Any] = {"seconds": _processor_time() - begin}
    motion, options = solution.trajectory, solution.options
    found |= {
        "status": solution.status.name,
        "success": solution.success,
        "programs": sum(record.programs for record in solution.history),
        "iterations": len(solution.history),
        "method": f"{options.method} {options.control}",
        "message": " ".join(solution.message.split())[:LONGEST_MESSAGE],
    }
    if not solution.success or motion is None:
        return found
    found |= {"T": solution.T, "intervals": motion.t.size - 1}
    if task.measure is not None:
        found["objective"] = task.measure(solution)
    try:
        certificate = solution.certificate
        found["promise"] = None if certificate is None else certificate.stationarity
    except tm.TominpmpError as error:
        found["promise"] = type(error).__name__
    if judged:
        verdict = task.judged(solution)
        found |= {"excess": verdict.excess, "clearance": verdict.clearance}
        found["faults"] = "; ".join(verdict.faults)
    return found


def _processor_time() -> float:
    """Processor time of this process and its children [s]."""
    others = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + others.ru_utime + others.ru_stime


def row_of(item: Item, columns: dict[str, Any], version: str) -> Row:
    """A row of text."""
    row = dict(zip(KEY, item.key, strict=True)) | {"revision": version}
    return row | {name: _text(value) for name, value in columns.items()}


def _text(value: Any) -> str:
    if value is None or (isinstance(value, float) and math.isinf(value)):
        return ""
    return f"{value:.9g}" if isinstance(value, float) else str(value)


def _work(sender: Connection, item: Item, limit: float, judged: bool) -> None:
    """Plan one problem and send its columns; runs in a separate process."""
    import tominpmp as tm
    from benchmarks.ablation import switched

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # The system ends the process when it has used up its processor time.
    signal.setitimer(signal.ITIMER_PROF, limit)
    warnings.simplefilter("ignore")
    columns: dict[str, Any] = {}
    try:
        task = task_of(item)
        columns["fingerprint"] = task.fingerprint
        with switched(item.variant, task) as changed:
            columns |= measure(changed, judged=judged)
    except tm.TominpmpError as error:
        words = " ".join(str(error).split())[:LONGEST_MESSAGE]
        columns |= {"status": type(error).__name__, "message": words, "success": False}
    except Exception as error:  # one faulty problem must not end the whole run
        words = " ".join(str(error).split())[:LONGEST_MESSAGE]
        columns |= {"status": f"ERROR {type(error).__name__}", "message": words}
        columns["success"] = False
    sender.send(columns)
    sender.close()


def run(
    wanted: Iterable[Item],
    rows: Rows,
    version: str,
    *,
    jobs: int = 1,
    limit: float = 300.0,
    judged: bool = True,
    show: Callable[[Row], None] = lambda row: None,
) -> None:
    """Plan all problems that have no row yet.

    Args:
        wanted: The problems.
        rows: The file of the rows.
        version: Revision of the library.
        jobs: Number of processes at once.
        limit: Processor time of a problem [s], after which its process is ended.
        judged: Whether motions are judged.
        show: Called with each row.
    """
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(list(_modules()))
    waiting = deque(item for item in wanted if item.key not in rows.rows)
    working: dict[int, tuple[BaseProcess, Connection, Item]] = {}
    try:
        while waiting or working:
            while waiting and len(working) < jobs:
                item = waiting.popleft()
                receiver, sender = context.Pipe(duplex=False)
                process = context.Process(
                    target=_work, args=(sender, item, limit, judged), daemon=True
                )
                process.start()
                sender.close()
                working[process.sentinel] = process, receiver, item
            for ended in wait(list(working)):
                assert isinstance(ended, int)
                process, receiver, item = working.pop(ended)
                process.join()
                row = row_of(item, _columns(process, receiver), version)
                rows.add(row)
                show(row)
    finally:
        for process, _, _ in working.values():
            process.terminate()
            process.join()


def _columns(process: BaseProcess, receiver: Connection) -> dict[str, Any]:
    """Columns that a process has sent before it ended."""
    try:
        if receiver.poll():
            return dict(receiver.recv())
    except EOFError:
        pass
    over = process.exitcode == -signal.SIGPROF
    status = OVER if over else f"{DIED} {process.exitcode}"
    return {"status": status, "success": False}


def _modules() -> Iterator[str]:
    """Load modules, robots and scenes before the first problem."""
    import tominpmp

    yield from ("benchmarks.golden_cases", "benchmarks.golden_fresh")
    yield from ("benchmarks.ablation", "highspy", "ompl.base", "ompl.geometric")
    for module in pkgutil.walk_packages(tominpmp.__path__, "tominpmp."):
        if not module.name.startswith(WITHOUT):
            yield module.name
