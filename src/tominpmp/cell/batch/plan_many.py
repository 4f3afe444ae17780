"""Many plans: made lazily, in several processes, without losing results.

Thousands of problems share a few robots. A robot is pickled once; a process that has
it already neither unpickles it nor reads its meshes again. The cache of robots holds
no data that depend on a problem.
"""

from __future__ import annotations

import copyreg
import hashlib
import io
import math
import os
import pickle
import time
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sized
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cache, lru_cache
from pathlib import Path
from typing import Any
from weakref import WeakSet

import numpy as np

from tominpmp.arrays import Record
from tominpmp.cell.batch.dataset import (
    LIST,
    Entry,
    Outcome,
    file_of,
    make_folder,
    write_outcome,
)
from tominpmp.cell.batch.executor import Executor
from tominpmp.cell.batch.neighbours import Start, nearest_start, rounds_of
from tominpmp.checks import flag, instance, whole, wrong
from tominpmp.description.paths import checked_path
from tominpmp.description.urdf import urdf_file
from tominpmp.exceptions import ScenarioError, TominpmpError, brief, quiet
from tominpmp.files.scenario import Scenario, load_scenario, scenario_text
from tominpmp.initial_guess.parallel import end_with
from tominpmp.motion.trajectory import Trajectory
from tominpmp.options import Options
from tominpmp.planner.planning import plan
from tominpmp.problem.problem import Problem
from tominpmp.robot.robot import Robot
from tominpmp.scene.meshes import Mesh

MOST_WORKERS = 100_000


@dataclass(frozen=True, eq=False)
class Progress(Record):
    """Progress of a batch.

    Attributes:
        done: Number of problems that are done, problems of former runs included.
        found: Number of them that have a motion.
        total: Number of all problems; None if it is not known.
        seconds: Time since the beginning [s].
        last: The outcome that came last.
    """

    done: int
    found: int
    total: int | None
    seconds: float
    last: Outcome


def plan_many(
    problems: Iterable[Any] | Mapping[str, Any],
    options: Options | None = None,
    *,
    workers: int | None = None,
    backend: str | None = None,
    ordered: bool = True,
    results: str | Path | None = None,
    seed: int = 0,
    warm_start: bool = False,
    progress: Callable[[Progress], object] | None = None,
    **changes: Any,
) -> Iterator[Outcome]:
    """Plan many problems.

    ::

        for outcome in tm.plan_many(problems, results="out", max_planning_time=10.0):
            print(outcome.name, outcome.T if outcome.success else outcome.message)

    Problems are taken from the iterable only when a worker is free. The motions are the
    same to the last bit for any number of workers, on any backend, unless a time limit
    ends plans. A problem that is wrong, or whose process is killed, yields an outcome
    with a reason, and the other problems are planned.

    Args:
        problems: The problems to plan: problems, scenarios (see
            :func:`~tominpmp.files.scenario.load_scenario`) or paths of their files;
            each may be a pair of a name and one of these; or a mapping by name.
        options: Options of all plans; None for the options of the scenarios, or the
            defaults.
        workers: Number of problems planned at once; None for the number that the
            backend is configured with, or the number of cores.
        backend: Backend of joblib by its name: "loky" (processes of this machine),
            "threading", "dask", "ray", or any other; None for the backend of
            ``joblib.parallel_config``, or processes.
        ordered: Whether outcomes come in the order of the problems; otherwise as they
            finish.
        results: Folder for the results, a file each, see
            :class:`~tominpmp.cell.batch.dataset.Dataset`. Problems whose results are
            there already, wherever they were in the list, are not planned again: a run
            that was killed loses only the plans under way. Processes on other machines
            must see the folder.
        seed: Seed of the batch. The seed of each plan is derived from it and from the
            name of the problem, or the number of a problem without a name.
        warm_start: Whether problems begin with the motion of the nearest problem that
            was planned before them. All problems are read first; the choice of the
            warm start depends on the problems alone, not on which plan finishes first.
        progress: Called with a :class:`Progress` after each outcome.
        **changes: Options by name, which take precedence over ``options`` and the
            options of scenarios: ``max_planning_time`` is the time of each plan [s].

    Yields:
        The outcomes.

    Raises:
        ProblemError: If an argument is wrong, or the backend is unknown.
        OptionsError: If an option is unknown or its value is wrong.
        MissingDependency: If the package of the backend is not installed.
        ScenarioError: If the folder of the results is a file, or results cannot be
            written there.
    """
    items = _iterator(problems)
    Options.of(options).changed(changes)
    folder = None
    if results is not None:
        # Errors are raised before planning.
        folder = make_folder(checked_path(results, "results").absolute())
    if workers is not None:
        workers = whole(workers, "workers", 1, MOST_WORKERS)
    ordered, warm_start = flag(ordered, "ordered"), flag(warm_start, "warm_start")
    seed = whole(seed, "seed", most=math.inf)
    if backend is not None:
        instance(backend, str, "backend", "the name of a backend of joblib")
    if progress is not None and not callable(progress):
        raise wrong(progress, "progress", "a function")
    executor = Executor(_run_packed, workers, backend)
    total = len(problems) if isinstance(problems, Sized) else None
    fixed = {"options": options, "changes": changes, "folder": folder}
    tasks = (_task(k, item, seed, **fixed) for k, item in enumerate(items))
    run = _in_rounds if warm_start else _outcomes
    outcomes = run(executor, tasks)
    if folder is not None:
        outcomes = _listed(outcomes, folder)
    if progress is not None:
        outcomes = _watched(outcomes, progress, total)
    return _in_order(outcomes) if ordered else outcomes


def _iterator(problems: Any) -> Iterator[Any]:
    if isinstance(problems, str | Path) or not isinstance(problems, Iterable):
        expected = "problems, scenarios or paths, one after the other or by name"
        raise wrong(problems, "problems", f"{expected}: [path] for one")
    return iter(problems.items() if isinstance(problems, Mapping) else problems)


def _outcomes(executor: Executor, tasks: Iterable[BatchTask]) -> Iterator[Outcome]:
    """Outcomes of tasks as they finish."""

    def work() -> Iterator[tuple[BatchTask, bytes]]:
        for task in tasks:
            try:
                packed = _packed(task)
            except Exception as error:  # pickling a caller's object may raise any error
                reason = f"the problem cannot be sent: {brief(str(error), 300)}"
                packed = _packed(task.failed(BROKEN, reason))
            yield task, packed

    for task, result in executor.results(work()):
        if result is None:
            yield task.failed(LOST, "the process that planned it was killed, twice")
        else:
            yield pickle.loads(result)


def _in_rounds(executor: Executor, tasks: Iterable[BatchTask]) -> Iterator[Outcome]:
    """Outcomes of tasks that are warm-started with the motions of their neighbours."""
    all_tasks = list(tasks)
    problems: list[Problem | None] = [None] * len(all_tasks)
    for k, task in enumerate(all_tasks):
        with suppress(TominpmpError):
            problems[k] = _problem(task.source, Options())[0]
    rounds, near = rounds_of(problems)
    motions: dict[int, Trajectory] = {}
    for numbers in rounds:
        starts = {k: nearest_start(near[k], motions) for k in numbers}
        chosen = [replace(all_tasks[k], start=start) for k, start in starts.items()]
        for outcome in _outcomes(executor, chosen):
            solution = outcome.solution
            if outcome.success and solution is not None and solution.trajectory:
                motions[outcome.index] = solution.trajectory
            yield outcome


def _in_order(outcomes: Iterator[Outcome]) -> Iterator[Outcome]:
    """Outcomes in the order of their numbers."""
    waiting: dict[int, Outcome] = {}
    following = 0
    for outcome in outcomes:
        waiting[outcome.index] = outcome
        while following in waiting:
            yield waiting.pop(following)
            following += 1


def _listed(outcomes: Iterator[Outcome], folder: Path) -> Iterator[Outcome]:
    """Outcomes; each that has a file is listed before it is yielded."""
    with (folder / LIST).open("w", encoding="ascii", buffering=1) as listed:
        for outcome in outcomes:
            if outcome.path is not None:
                file = outcome.path.relative_to(folder).as_posix()
                listed.write(f"{outcome.index} {file}\n")
            yield outcome


def _watched(
    outcomes: Iterator[Outcome],
    progress: Callable[[Progress], object],
    total: int | None,
) -> Iterator[Outcome]:
    """Outcomes; each is reported to the progress callback before it is yielded."""
    begin, planned = time.perf_counter(), 0
    for done, outcome in enumerate(outcomes, start=1):
        planned += outcome.success
        seconds = time.perf_counter() - begin
        progress(Progress(done, planned, total, seconds, outcome))
        yield outcome


BROKEN, LOST = "BROKEN", "LOST"


@dataclass(frozen=True, eq=False)
class BatchTask:
    """A problem of a batch, as the caller gave it.

    Attributes:
        index: Its number, from 0.
        name: Its name.
        seed: The seed of its plan.
        source: A Problem, a Scenario or the path of a scenario file, as the caller gave
            it; an object of another type becomes a failed outcome.
        options: Options of all plans; None for the options of scenarios, or the
            defaults.
        changes: Options by name, which take precedence over ``options``.
        folder: Folder of the results; None to store no results.
        start: Its warm start; None for a cold one.
        parent: Id of the process that hands out the work.
    """

    index: int
    name: str
    seed: int
    source: Any
    options: Options | None
    changes: Mapping[str, Any]
    folder: Path | None
    start: Start | None = None
    parent: int = field(default_factory=os.getpid)

    def failed(self, status: str, message: str) -> Outcome:
        """The outcome of a task that was not planned."""
        return Outcome(self.index, self.name, self.seed, False, status, message)


def _task(index: int, item: Any, seed: int, **fixed: Any) -> BatchTask:
    """Name a problem, and derive the seed of its plan.

    Args:
        index: Number of the problem.
        item: A problem, a scenario, a path, or a pair of a name and one of these.
        seed: The seed of the batch.
        **fixed: Options and folder, which all tasks of the batch share.
    """
    named = isinstance(item, tuple) and len(item) == 2 and isinstance(item[0], str)
    name, source = item if named else (None, item)
    if name is None and isinstance(source, str | Path):
        name = Path(source).stem
    key = index if name is None else zlib.crc32(name.encode(errors="surrogatepass"))
    numbers = np.random.SeedSequence([seed, key]).generate_state(1)
    name = name or f"problem {index}"
    return BatchTask(index, name, int(numbers[0]), source, **fixed)


# Number of robots that a process caches.
MOST_ROBOTS = 16
# Robots that were written to a file and read back as a check.
_checked_robots: WeakSet[Robot] = WeakSet()


@lru_cache(MOST_ROBOTS)
def _cached(robot: Robot) -> tuple[Robot, bytes]:
    """The first robot of this process that equals the given robot, and its pickle."""
    return robot, pickle.dumps(robot)


@lru_cache(MOST_ROBOTS)
def _robot(content: bytes) -> Robot:
    """The robot of a pickle, which is unpickled once."""
    return _cached(pickle.loads(content))[0]


def _packed(item: Any) -> bytes:
    """Pickle an object.

    Raises:
        Exception: If the object, or a part of it, cannot be pickled.
    """
    file = io.BytesIO()
    pickler = pickle.Pickler(file, protocol=pickle.HIGHEST_PROTOCOL)
    # A robot is replaced by its pickle, which each process reads once.
    by_pickle: Any = {Robot: lambda robot: (_robot, (_cached(robot)[1],))}
    pickler.dispatch_table = copyreg.dispatch_table | by_pickle
    pickler.dump(item)
    return file.getvalue()


def _run_packed(number: int, packed: bytes) -> tuple[int, bytes]:
    """Plan a pickled task in a worker process; returns the pickled outcome.

    Args:
        number: Number of the work item, which is returned, too.
        packed: The pickle of a task; or of the outcome of a task that could not be
            pickled, which is returned unchanged.
    """
    task = pickle.loads(packed)
    if isinstance(task, Outcome):
        return number, packed
    _end_with(task.parent)
    return number, _packed(_planned(task))


@cache
def _end_with(handing_out: int) -> None:
    """Let this process end with its parent, if the parent hands out the work."""
    if hasattr(os, "getppid") and os.getppid() == handing_out:
        end_with(handing_out)


def _planned(task: BatchTask) -> Outcome:
    """Plan a problem and store the result, unless a former run has stored it."""
    folder, text, reason, digest = task.folder, "", "", ""
    try:
        problem, options = _problem(task.source, task.options)
        options = options.changed(task.changes)
        options = replace(options, callback=None, processes=1, seed=task.seed)
        number, motion = (None if problem.segments else task.start) or (None, None)
        if folder is not None:
            text, reason = _written(problem, options, folder)
            if text:
                begun = [getattr(motion, k).tobytes() for k in "tqvu" if motion]
                digest = _digest(task.name, text, begun, *_contents(problem))
                # A broken or missing file is written anew.
                with suppress(ScenarioError):
                    former = Entry.read(file_of(folder, task.name, digest))
                    outcome = former.outcome(problem, options)
                    return replace(outcome, index=task.index, began_with=number)
        solution = plan(problem, options, motion)
        outcome = Outcome.of(solution, task.index, task.name, task.seed, number)
    except TominpmpError as error:
        outcome = task.failed(BROKEN, str(error))
    if folder is None:
        return outcome
    # Without a scenario there is no digest, and the result is not taken over.
    path = file_of(folder, task.name, digest or _digest(task.name, task.index))
    write_outcome(path, outcome, digest, text, reason)
    return replace(outcome, path=path)


def _digest(*parts: object) -> str:
    """Digest of texts, numbers and bytes."""
    return hashlib.sha256(repr(parts).encode()).hexdigest()


def _problem(source: Any, options: Options | None) -> tuple[Problem, Options]:
    """The problem, with the options of its file if ``options`` is None.

    Raises:
        TominpmpError: If the source is of another type, or its file is wrong.
    """
    with quiet(Warning):  # the message of the solution repeats the warnings
        if isinstance(source, str | Path):
            source = load_scenario(source)
    if isinstance(source, Scenario):
        return source.problem, source.options if options is None else options
    if isinstance(source, Problem):
        return source, Options.of(options)
    expected = "a Problem, a Scenario or the path of a scenario file"
    raise wrong(source, "the problem", expected)


def _written(problem: Problem, options: Options, folder: Path) -> tuple[str, str]:
    """A problem as the text of a scenario, or the reason why no file can hold it."""
    robot = problem.robot
    try:
        # Reading a robot back takes longer than many plans, so each is checked once.
        check, place = robot not in _checked_robots, folder / "problem.toml"
        text = scenario_text(place, problem, options, check=check)
    except ScenarioError as error:
        return "", str(error)
    _checked_robots.add(robot)
    return text, ""


def _contents(problem: Problem) -> Iterator[bytes]:
    """Contents of the files that the scenario of a problem refers to by their paths."""
    for robot in {id(phase.robot): phase.robot for phase in problem.phases}.values():
        description = robot.description
        yield urdf_file(description, (), "")[0]
        yield repr(robot.srdf and robot.srdf.disabled_pairs).encode()
        for link in description.bodies:
            yield from (_content(shape.file) for shape in link.collisions if shape.file)
    for phase in problem.phases:
        meshes = (item for item in phase.scene if isinstance(item, Mesh) and item.path)
        yield from (_content(str(mesh.path)) for mesh in meshes)


def _content(file: str) -> bytes:
    """Digest of a file, which is computed once as long as the file is unchanged.

    It is empty for a file that is gone: a scenario then holds the mesh itself.
    """
    with suppress(OSError):
        about = Path(file).stat()
        return _content_at(file, about.st_mtime_ns, about.st_size)
    return b""


@lru_cache(1000)
def _content_at(file: str, *_: int) -> bytes:
    return hashlib.sha256(Path(file).read_bytes()).digest()
