"""One plan of a batch, in whatever process it is made.

Thousands of problems share a few robots. A robot is pickled once; a process that has
it already neither unpickles it nor reads its meshes again. Nothing that depends on a
problem is kept with it.
"""

from __future__ import annotations

import hashlib
import io
import os
import pickle
import warnings
import zlib
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from weakref import WeakValueDictionary

import numpy as np

from tominpmp.cell.batch.dataset import Entry, file_of, write_outcome
from tominpmp.cell.batch.outcome import Outcome
from tominpmp.exceptions import ProblemError, ScenarioError, TominpmpError, brief
from tominpmp.files.scenario import Scenario, load_scenario, scenario_text
from tominpmp.initial_guess.parallel import end_with
from tominpmp.motion.trajectory import Trajectory
from tominpmp.options import Options
from tominpmp.planner.planning import plan
from tominpmp.problem import Problem
from tominpmp.robot import Robot

# Robots that a process keeps.
MOST_ROBOTS = 16
# These by what they are pickled to, the one used last at the end.
_kept: OrderedDict[bytes, Robot] = OrderedDict()


def _keep(content: bytes, robot: Robot) -> None:
    _kept[content] = robot
    _kept.move_to_end(content)
    while len(_kept) > MOST_ROBOTS:
        _kept.popitem(last=False)


def _robot(content: bytes) -> Robot:
    """The robot of a pickle, which is read once."""
    robot = _kept.get(content)
    robot = pickle.loads(content) if robot is None else robot
    _keep(content, robot)
    return robot


class _Pickler(pickle.Pickler):
    def reducer_override(self, item: Any) -> Any:
        """Robots as their pickles, of which each process reads one once."""
        if not isinstance(item, Robot):
            return NotImplemented
        known = [content for content, robot in _kept.items() if robot is item]
        content = known[0] if known else pickle.dumps(item)
        _keep(content, item)
        return _robot, (content,)


def pack(item: Any) -> bytes:
    """Pickle an object.

    Raises:
        Exception: If there is something in it that cannot be pickled.
    """
    file = io.BytesIO()
    _Pickler(file, protocol=pickle.HIGHEST_PROTOCOL).dump(item)
    return file.getvalue()


BROKEN, LOST = "BROKEN", "LOST"


@dataclass(frozen=True, eq=False)
class Item:
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

    def failed(self, status: str, reason: str) -> Outcome:
        """The outcome of an item that was not planned."""
        return Outcome.failed(self.index, self.name, self.seed, status, reason)


def item_of(index: int, given: Any, seed: int) -> Item:
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
    name = f"problem {index}" if name is None else name
    return Item(index, name, int(numbers[0]), what)


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


@dataclass(frozen=True, eq=False)
class Start:
    """A motion to begin with.

    Attributes:
        index: The number of the problem that it solves.
        motion: The motion.
    """

    index: int
    motion: Trajectory


@dataclass(frozen=True, eq=False)
class Ready:
    """A problem with its options, or what keeps it from being planned.

    Attributes:
        problem: The problem; None where it could not be made.
        options: Its options, with its seed.
        reason: What is wrong with it.
        digest: What tells it from others with other options; empty where nothing does.
        text: The problem as the text of a scenario, where that is kept.
        untold: Why no file can hold it.
    """

    problem: Problem | None
    options: Options
    reason: str = ""
    digest: str = ""
    text: str = ""
    untold: str = ""


# By their numbers, which others may get once they are gone: so they are compared.
_checked_robots: WeakValueDictionary[int, Robot] = WeakValueDictionary()


def ready(item: Item, settings: Settings, began_with: int | None = None) -> Ready:
    """Make the problem of an item and its options."""
    base = Options() if settings.options is None else settings.options
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # they are in the problem's own messages
            problem, base = _problem(item.given, base, settings.options is not None)
        options = base.changed(settings.changes)
        options = replace(options, callback=None, processes=1, seed=item.seed)
    except TominpmpError as error:
        return Ready(None, base, str(error))
    text, untold = "", ""
    if settings.folder is not None:
        robot = problem.robot
        try:
            # To read a robot back takes longer than many a plan.
            known = _checked_robots.get(id(robot)) is robot
            place = settings.folder / "problem.toml"
            text = scenario_text(place, problem, options, check=not known)
            _checked_robots[id(robot)] = robot
        except ScenarioError as error:
            untold = str(error)
    digest = ""
    if text:
        about = f"{item.name}\n{began_with}\n{text}"
        digest = hashlib.sha256(about.encode()).hexdigest()
    return Ready(problem, options, "", digest, text, untold)


def _problem(given: Any, options: Options, own: bool) -> tuple[Problem, Options]:
    """The problem, with the options of its file unless there are others.

    Raises:
        TominpmpError: If there is none.
    """
    if isinstance(given, str | Path):
        given = load_scenario(given)
    if isinstance(given, Scenario):
        return given.problem, options if own else given.options
    if isinstance(given, Problem):
        return given, options
    raise ProblemError(
        f"the problem is {brief(given)}, expected a Problem, a Scenario or the path of "
        "a scenario file",
        "problems",
    )


def former(item: Item, found: Ready, settings: Settings) -> Outcome | None:
    """The result of a former run, if there is one of this very problem."""
    if settings.folder is None or found.problem is None or not found.digest:
        return None
    path = file_of(settings.folder, item.index, item.name)
    if not path.is_file():
        return None
    try:
        entry = Entry.read(path)
    except ScenarioError:
        return None  # a broken one is made again
    if entry.about.get("digest") != found.digest or entry.about["status"] == LOST:
        return None
    return entry.outcome(found.problem, found.options)


def planned(
    item: Item, found: Ready, settings: Settings, start: Start | None = None
) -> Outcome:
    """Plan a problem, and keep the result."""
    about = item.index, item.name, item.seed
    if found.problem is None:
        outcome = item.failed(BROKEN, found.reason)
    else:
        began = None if start is None or found.problem.segments else start
        begin = {} if began is None else {"start": began.motion}
        try:
            solution = plan(found.problem, found.options, **begin)
            outcome = Outcome.of(
                solution, *about, None if began is None else began.index
            )
        except TominpmpError as error:
            outcome = item.failed(BROKEN, str(error))
    if settings.folder is None:
        return outcome
    path = file_of(settings.folder, item.index, item.name)
    write_outcome(path, outcome, found.digest, found.text, found.untold)
    return replace(outcome, path=path)


_watched: set[int] = set()


def run_packed(packed: bytes) -> bytes:
    """In a process of a batch: plan what was sent, and send the outcome.

    What is sent is an item, the settings and a motion to begin with.
    """
    item, settings, start = pickle.loads(packed)
    if os.getpid() != settings.parent and settings.parent not in _watched:
        _watched.add(settings.parent)
        if hasattr(os, "getppid") and os.getppid() == settings.parent:
            end_with(settings.parent)
    began_with = None if start is None else start.index
    found = ready(item, settings, began_with)
    return pack(former(item, found, settings) or planned(item, found, settings, start))
