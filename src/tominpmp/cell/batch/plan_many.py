"""Many plans: made lazily, in several processes, without losing results.

Thousands of problems share a few robots. A robot is pickled once; a process that has
it already neither unpickles it nor reads its meshes again. Nothing that depends on a
problem is kept with it.
"""

from __future__ import annotations

import hashlib
import io
import math
import os
import pickle
import tempfile
import time
import warnings
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
from tominpmp.cell.batch.dataset import Entry, Outcome, file_of, write_outcome
from tominpmp.cell.batch.executor import Executor
from tominpmp.cell.batch.neighbours import rounds_of
from tominpmp.checks import flag, instance, whole, wrong
from tominpmp.description.paths import checked_path
from tominpmp.exceptions import ScenarioError, TominpmpError, brief
from tominpmp.files.scenario import Scenario, load_scenario, scenario_text
from tominpmp.initial_guess.parallel import end_with
from tominpmp.motion.trajectory import Trajectory
from tominpmp.options import Options
from tominpmp.planner.planning import plan
from tominpmp.problem.problem import Problem
from tominpmp.robot.robot import Robot

MOST_WORKERS = 100_000


@dataclass(frozen=True, eq=False)
class Progress(Record):
    """How far a batch is.

    Attributes:
        done: Problems that are done, those of former runs too.
        found: How many of them have a motion.
        total: Number of all problems; None where it is not known.
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

    Problems are taken from the iterable as they are needed. The motions are the same to
    the last bit for any number of workers, on any backend, unless a time limit ends
    plans. A problem that is wrong, or whose process is killed, is an outcome with a
    reason, and the others go on.

    Args:
        problems: What to plan: problems, scenarios (see
            :func:`~tominpmp.files.scenario.load_scenario`) or paths of their files;
            each may be a pair of a name and one of these; or all of them by name.
        options: Options of all plans; None for those of the scenarios, or the defaults.
        workers: How many are planned at once; None for as many as there are cores, or
            as the backend that is configured says.
        backend: Where they are planned: "loky" (processes of this machine),
            "threading", "dask", "ray", or any other backend of joblib by its name; None
            for the one of ``joblib.parallel_config``, or processes.
        ordered: Whether outcomes come in the order of the problems, else as they
            finish.
        results: Folder in which the results are kept, a file each, see
            :class:`~tominpmp.cell.batch.dataset.Dataset`. Problems whose results are
            there already are not planned again: a run that was killed has lost the
            plans under way, no more. Processes on other machines must see the folder.
        seed: Seed of the batch. Each plan has one of its own, made of this and of the
            name of the problem, or of its number where it has none.
        warm_start: Whether problems begin with the motion of the nearest problem that
            was planned before them. All problems are looked at first; which begins
            with which depends on them alone, not on which is ready first.
        progress: Called with a :class:`Progress` after each outcome.
        **changes: Options by name, which go before those of ``options`` and of
            scenarios: ``max_planning_time`` is the time of each plan [s].

    Yields:
        The outcomes.

    Raises:
        ProblemError: If an argument is wrong, or the backend is unknown.
        OptionsError: If an option is unknown or its value is wrong.
        MissingDependency: If the package of the backend is not installed.
        ScenarioError: If the folder of the results is a file, or results cannot be
            written.
    """
    items = _iterator(problems)
    Options.of(options).changed(changes)
    folder = None if results is None else _folder(results)
    settings = Settings(options, changes, folder)
    if workers is not None:
        expected = f"a number from 1 to {MOST_WORKERS}"
        workers = whole(workers, "workers", 1, MOST_WORKERS, expected)
    ordered, warm_start = flag(ordered, "ordered"), flag(warm_start, "warm_start")
    first_seed = whole(seed, "seed", most=math.inf)
    if backend is not None:
        instance(backend, str, "backend", "the name of a backend of joblib")
    if progress is not None and not callable(progress):
        raise wrong(progress, "progress", "a function")
    executor = Executor(_run_packed, workers, backend)
    total = len(problems) if isinstance(problems, Sized) else None
    tasks = (_task(index, given, first_seed) for index, given in enumerate(items))
    if warm_start:
        found = _in_rounds(executor, settings, tasks)
    else:
        found = _outcomes(executor, settings, tasks, {})
    if progress is not None:
        found = _watched(found, progress, total)
    return _in_order(found) if ordered else found


def _iterator(problems: Any) -> Iterator[Any]:
    if isinstance(problems, str | Path):
        expected = "problems or paths, one after the other: [path] for one"
        raise wrong(problems, "problems", expected)
    if isinstance(problems, Mapping):
        problems = problems.items()
    try:
        return iter(problems)
    except TypeError as error:
        expected = "problems, scenarios or paths, one after the other or by name"
        raise wrong(problems, "problems", expected) from error


def _folder(results: str | Path) -> Path:
    """Make the folder of the results, before anything is planned for it.

    Raises:
        ScenarioError: If it is a file, or nothing can be written there.
    """
    folder = checked_path(results, "results").absolute()
    if folder.exists() and not folder.is_dir():
        raise ScenarioError(f"{folder} is a file, expected a folder", folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        reason = error.strerror or str(error)
        raise ScenarioError(f"results: {folder}: {reason}", folder) from error
    return folder


def _outcomes(
    executor: Executor,
    settings: Settings,
    tasks: Iterable[BatchTask],
    starts: Mapping[int, Start],
) -> Iterator[Outcome]:
    """Outcomes as they finish, of tasks of which some begin with motions."""
    sent: dict[int, BatchTask] = {}

    def work() -> Iterator[tuple[int, bytes]]:
        for task in tasks:
            try:
                packed = _packed((task, settings, starts.get(task.index)))
            except Exception as error:  # whatever the caller's object does
                reason = f"the problem cannot be sent: {brief(str(error), 300)}"
                packed = _packed(task.failed(BROKEN, reason))
            sent[task.index] = task
            yield task.index, packed

    for index, result in executor.results(work()):
        task = sent.pop(index)
        if result is None:
            yield task.failed(LOST, "the process that planned it was killed, twice")
        else:
            yield pickle.loads(result)


def _in_rounds(
    executor: Executor, settings: Settings, tasks: Iterable[BatchTask]
) -> Iterator[Outcome]:
    """Outcomes of tasks that begin with the motions of their neighbours."""
    every = list(tasks)
    problems: list[Problem | None] = [None] * len(every)
    for k, task in enumerate(every):
        with suppress(TominpmpError):
            problems[k] = _problem(task.given, Options())[0]
    rounds = rounds_of(problems)
    motions: dict[int, Trajectory] = {}
    for numbers in rounds.rounds:
        chosen = [every[k] for k in numbers.tolist()]
        near = {task.index: rounds.start(task.index, motions) for task in chosen}
        starts = {k: (j, motions[j]) for k, j in near.items() if j is not None}
        for outcome in _outcomes(executor, settings, chosen, starts):
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


def _watched(
    outcomes: Iterator[Outcome],
    progress: Callable[[Progress], object],
    total: int | None,
) -> Iterator[Outcome]:
    """Outcomes, with a word on each."""
    begin, found = time.perf_counter(), 0
    for done, outcome in enumerate(outcomes, start=1):
        found += outcome.success
        seconds = time.perf_counter() - begin
        progress(Progress(done, found, total, seconds, outcome))
        yield outcome


BROKEN, LOST = "BROKEN", "LOST"
# A motion to begin with: the number of the problem that it solves, and the motion.
Start = tuple[int, Trajectory]


@dataclass(frozen=True, eq=False)
class BatchTask:
    """A problem of a batch, as the caller gave it.

    Attributes:
        index: Its number, from 0.
        name: Its name.
        seed: The seed of its plan.
        given: A Problem, a Scenario or the path of a scenario file; or what is wrong.
    """

    index: int
    name: str
    seed: int
    given: Any

    def failed(self, status: str, message: str) -> Outcome:
        """The outcome of a task that was not planned."""
        return Outcome(self.index, self.name, self.seed, False, status, message)


def _task(index: int, given: Any, seed: int) -> BatchTask:
    """Name a problem, and give it a seed of its own.

    Args:
        index: Its number.
        given: What the caller gave: a problem, a path, or a name and one of these.
        seed: The seed of the batch.
    """
    named = isinstance(given, tuple) and len(given) == 2 and isinstance(given[0], str)
    name, what = given if named else (None, given)
    if name is None and isinstance(what, str | Path):
        name = Path(what).stem
    own = index if name is None else zlib.crc32(name.encode())
    numbers = np.random.SeedSequence([seed, own]).generate_state(1)
    return BatchTask(index, name or f"problem {index}", int(numbers[0]), what)


@dataclass(frozen=True, eq=False)
class Settings:
    """What all plans of a batch have in common.

    Attributes:
        options: Options of the plans; None for those of scenarios, or the defaults.
        changes: Options by name, which go before these.
        folder: Folder of the results, if they are kept.
        parent: Number of the process that hands out the work.
    """

    options: Options | None
    changes: Mapping[str, Any]
    folder: Path | None
    parent: int = field(default_factory=os.getpid)


# Robots that a process keeps.
MOST_ROBOTS = 16
# Those that were written to a file and read back.
_checked_robots: WeakSet[Robot] = WeakSet()


@lru_cache(MOST_ROBOTS)
def _kept(robot: Robot) -> tuple[Robot, bytes]:
    """The robot of this process that is equal to one, and its pickle."""
    return robot, pickle.dumps(robot)


@lru_cache(MOST_ROBOTS)
def _robot(content: bytes) -> Robot:
    """The robot of a pickle, which is read once."""
    return _kept(pickle.loads(content))[0]


class _Pickler(pickle.Pickler):
    def reducer_override(self, item: Any) -> Any:
        """Robots as their pickles, of which each process reads one once."""
        if isinstance(item, Robot):
            return _robot, (_kept(item)[1],)
        return NotImplemented


def _packed(item: Any) -> bytes:
    """Pickle an object.

    Raises:
        Exception: If there is something in it that cannot be pickled.
    """
    file = io.BytesIO()
    _Pickler(file, protocol=pickle.HIGHEST_PROTOCOL).dump(item)
    return file.getvalue()


def _run_packed(packed: bytes) -> bytes:
    """In a process of a batch: plan what was sent, and send the outcome.

    What is sent is a task, the settings and a motion to begin with; or an outcome where
    these cannot be sent.
    """
    sent = pickle.loads(packed)
    if isinstance(sent, Outcome):
        return packed
    task, settings, start = sent
    _end_with(settings.parent)
    return _packed(_planned(task, settings, start))


@cache
def _end_with(handing_out: int) -> None:
    """Let this process end with the one that hands out the work, if it is its child."""
    if hasattr(os, "getppid") and os.getppid() == handing_out:
        end_with(handing_out)


def _planned(task: BatchTask, settings: Settings, start: Start | None) -> Outcome:
    """Plan a problem and keep the result, unless a former run has kept it."""
    folder, text, reason, digest = settings.folder, "", "", ""
    path = None if folder is None else file_of(folder, task.index, task.name)
    try:
        problem, options = _problem(task.given, settings.options)
        options = options.changed(settings.changes)
        options = replace(options, callback=None, processes=1, seed=task.seed)
        if path is not None:
            text, reason = _written(problem, options, path.parents[1])
            if text:
                about = f"{task.name}\n{start and start[0]}\n{text}"
                digest = hashlib.sha256(about.encode()).hexdigest()
                former = _former(path, digest)
                if former is not None:
                    return former.outcome(problem, options)
        number, motion = (None, None) if problem.segments else start or (None, None)
        solution = plan(problem, options, motion)
        outcome = Outcome.of(solution, task.index, task.name, task.seed, number)
    except TominpmpError as error:
        outcome = task.failed(BROKEN, str(error))
    if path is None:
        return outcome
    write_outcome(path, outcome, digest, text, reason)
    return replace(outcome, path=path)


def _problem(given: Any, options: Options | None) -> tuple[Problem, Options]:
    """The problem, with the options of its file unless there are others.

    Raises:
        TominpmpError: If the given object makes no problem.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # they are in the problem's own messages
        if isinstance(given, str | Path):
            given = load_scenario(given)
    if isinstance(given, Scenario):
        return given.problem, given.options if options is None else options
    if isinstance(given, Problem):
        return given, Options.of(options)
    expected = "a Problem, a Scenario or the path of a scenario file"
    raise wrong(given, "the problem", expected)


def _written(problem: Problem, options: Options, folder: Path) -> tuple[str, str]:
    """A problem as the text of a scenario, or why no file can hold it."""
    robot = problem.robot
    try:
        # To read a robot back takes longer than many a plan.
        check, place = robot not in _checked_robots, folder / "problem.toml"
        text = scenario_text(place, problem, options, check=check)
    except ScenarioError as error:
        return "", str(error)
    _checked_robots.add(robot)
    return text, ""


def _former(path: Path, digest: str) -> Entry | None:
    """The result of a former run, if there is one of this very problem."""
    with suppress(ScenarioError):  # one that is broken, or not there, is made anew
        entry = Entry.read(path)
        if entry.about.get("digest") == digest and entry.about["status"] != LOST:
            return entry
    return None
