"""Many plans: lazily, in several processes, and such that nothing is lost."""

from __future__ import annotations

import math
import pickle
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sized
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tominpmp.arrays import Record
from tominpmp.cell.batch.executor import Executor
from tominpmp.cell.batch.neighbours import rounds_of
from tominpmp.cell.batch.outcome import Outcome
from tominpmp.cell.batch.task import (
    BROKEN,
    LOST,
    Item,
    Settings,
    Start,
    item_of,
    pack,
    ready,
    run_packed,
)
from tominpmp.checks import flag, instance, whole, wrong
from tominpmp.description.paths import checked_path
from tominpmp.exceptions import ScenarioError, brief
from tominpmp.motion.trajectory import Trajectory
from tominpmp.options import Options

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
        ProblemError: If an argument is wrong, or there is no such backend.
        OptionsError: If an option is unknown or its value is wrong.
        MissingDependency: If the package of the backend is not installed.
        ScenarioError: If the folder of the results is a file, or results cannot be
            written.
    """
    items = _iterator(problems)
    settings = _settings(options, changes, results)
    if workers is not None:
        expected = f"a number from 1 to {MOST_WORKERS}"
        workers = whole(workers, "workers", 1, MOST_WORKERS, expected)
    ordered, warm_start = flag(ordered, "ordered"), flag(warm_start, "warm_start")
    first_seed = whole(seed, "seed", most=math.inf)
    if backend is not None:
        instance(backend, str, "backend", "the name of a backend of joblib")
    if progress is not None and not callable(progress):
        raise wrong(progress, "progress", "a function")
    executor = Executor(run_packed, workers, backend)
    total = len(problems) if isinstance(problems, Sized) else None
    numbered = (item_of(index, given, first_seed) for index, given in enumerate(items))
    if warm_start:
        found = _in_rounds(executor, settings, numbered)
    else:
        found = _outcomes(executor, settings, numbered, {})
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


def _settings(
    options: Options | None, changes: dict[str, Any], results: str | Path | None
) -> Settings:
    Options.of(options).changed(changes)
    folder = None
    if results is not None:
        folder = checked_path(results, "results").absolute()
        _make_folder(folder)
    return Settings(options, changes, folder)


def _make_folder(folder: Path) -> None:
    """Make the folder of the results, before anything is planned for it.

    Raises:
        ScenarioError: If it is a file, or nothing can be written there.
    """
    if folder.exists() and not folder.is_dir():
        raise ScenarioError(f"{folder} is a file, expected a folder", folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        reason = error.strerror or str(error)
        raise ScenarioError(f"results: {folder}: {reason}", folder) from error


def _outcomes(
    executor: Executor,
    settings: Settings,
    items: Iterable[Item],
    starts: Mapping[int, Start],
) -> Iterator[Outcome]:
    """Outcomes as they finish, of items of which some begin with motions."""
    sent: dict[int, Item] = {}
    bad: list[Outcome] = []

    def work() -> Iterator[tuple[int, bytes]]:
        for item in items:
            try:
                packed = pack((item, settings, starts.get(item.index)))
            except Exception as error:  # whatever the caller's object does
                reason = f"the problem cannot be sent: {brief(str(error), 300)}"
                bad.append(item.failed(BROKEN, reason))
                continue
            sent[item.index] = item
            yield item.index, packed

    for index, result in executor.results(work()):
        while bad:
            yield bad.pop(0)
        item = sent.pop(index)
        if result is None:
            yield item.failed(LOST, "the process that planned it was killed, twice")
        else:
            yield pickle.loads(result)
    yield from bad


def _in_rounds(
    executor: Executor, settings: Settings, items: Iterable[Item]
) -> Iterator[Outcome]:
    """Outcomes of items that begin with the motions of their neighbours."""
    every = list(items)
    problems = [ready(item, Settings(None, {}, None)).problem for item in every]
    rounds = rounds_of(problems)
    motions: dict[int, Trajectory] = {}
    for numbers in rounds.rounds:
        chosen, fresh = [every[k] for k in numbers.tolist()], dict[int, Trajectory]()
        starts: dict[int, Start] = {}
        for item in chosen:
            first = rounds.start(item.index, motions)
            if first is not None:
                starts[item.index] = Start(first, motions[first])
        for outcome in _outcomes(executor, settings, chosen, starts):
            solution = outcome.solution
            if outcome.success and solution is not None and solution.trajectory:
                fresh[outcome.index] = solution.trajectory
            yield outcome
        motions |= fresh


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
