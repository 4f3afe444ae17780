"""Results of a batch as files: one NPZ file a plan, and tables for learning.

A file holds the problem as the text of a scenario, the motion at its nodes, and its
bounds and verdicts. Reading it takes neither pickle nor this library: ::

    with np.load("results/3f9/pick_3f9a61c2d05b7e48.npz") as file:
        t, q, success, T = file["t"], file["q"], bool(file["success"]), float(file["T"])

The name of a file follows from the name of its problem and the digest of all that the
result depends on, so that later batches in the folder find it, wherever the problem is
in their list. The file ``results.txt`` lists the results of the last batch, a line each
with the number of the problem and the file: results of former batches remain in the
folder, but are not in the dataset.
"""

from __future__ import annotations

import json
import math
import re
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tominpmp.arrays import Array, Converted, Record, record
from tominpmp.bounds.result import LowerBound
from tominpmp.checks import whole
from tominpmp.description.fields import parse_toml
from tominpmp.description.paths import checked_path, write_file
from tominpmp.dynamics import torques_of
from tominpmp.exceptions import BRIEF, ScenarioError, brief, optional, shortened
from tominpmp.files.scenario import Scenario, read_scenario
from tominpmp.motion.trajectory import MAX_SAMPLES, Trajectory
from tominpmp.options import Options
from tominpmp.problem.problem import Problem
from tominpmp.solution import Solution
from tominpmp.status import Status

# The list of the results of the last batch, in the folder of the results.
LIST = "results.txt"
# Arrays of a motion; the last two only some motions have.
ARRAYS = ("t", "q", "v", "u", "a", "segment_ends")
VERSION = 1
# Fields of an outcome that its file holds under their names.
STORED_FIELDS = (
    *("index", "name", "seed", "status", "message", "gap", "verified", "seconds"),
    "began_with",
)


@dataclass(frozen=True, eq=False)
class Outcome(Record):
    """The outcome of one problem of a batch; true if there is a motion.

    Attributes:
        index: Number of the problem in the batch, from 0.
        name: Name of the problem: the caller's, the stem of its file, or "problem" with
            its number.
        seed: The seed of its plan.
        success: Whether there is a motion that keeps all constraints.
        status: Name of the status of the solution; "BROKEN" where the problem could not
            be read or sent, "LOST" where the process that planned it was killed.
        message: How planning ended, or the fault of the problem.
        T: Duration of the motion [s]; infinite without a motion.
        gap: T over its lower bound, less one; None if no bound is known.
        verified: Whether the independent replay of the motion passed.
        seconds: Time that planning took [s].
        began_with: Number of the problem whose motion was the warm start; None for a
            cold start.
        solution: The solution; None if the problem was not planned. A solution that was
            read from a folder of results has neither history nor replay.
        path: File that holds the outcome; None without a folder of results.
        resumed: Whether the outcome was read from that file.
    """

    index: int
    name: str
    seed: int
    success: bool
    status: str
    message: str
    T: float = math.inf
    gap: float | None = None
    verified: bool = False
    seconds: float = 0.0
    began_with: int | None = None
    solution: Solution | None = field(default=None, repr=False, compare=False)
    path: Path | None = None
    resumed: bool = False

    def __bool__(self) -> bool:
        """Whether there is a motion."""
        return self.success

    def __repr__(self) -> str:
        """Name, status and time, on one line."""
        result = f"T = {self.T:.6g} s" if self.success else shortened(self.message)
        return f"<Outcome {brief(self.name, BRIEF)}: {self.status}, {result}>"

    @classmethod
    def of(
        cls,
        solution: Solution,
        index: int,
        name: str,
        seed: int,
        began_with: int | None = None,
    ) -> Outcome:
        """Make the outcome of a solution."""
        return cls(
            index=index,
            name=name,
            seed=seed,
            success=solution.success,
            status=solution.status.name,
            message=solution.message,
            T=solution.T,
            gap=solution.gap,
            verified=bool(solution.verification),
            seconds=solution.planning_time,
            began_with=began_with,
            solution=solution,
        )


def make_folder(folder: Path) -> Path:
    """Make a folder of results, unless it is there, and check that it is writable.

    Raises:
        ScenarioError: If the path is a file, or the folder is not writable.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        text = f"{folder}: {error.strerror}, expected a folder to write results to"
        raise ScenarioError(text, folder) from error
    return folder


def file_of(folder: Path, name: str, digest: str) -> Path:
    """The file of the result of a problem, by the digest of all it depends on."""
    plain = re.sub(r"[^A-Za-z0-9._-]", "_", name)[:80]
    return folder / digest[:3] / f"{plain}_{digest[:16]}.npz"


def write_outcome(
    path: Path, outcome: Outcome, digest: str, scenario: str, why: str
) -> None:
    """Write a result.

    Args:
        path: The file; its folder is made.
        outcome: The result.
        digest: Hash that identifies the problem; empty without a scenario.
        scenario: The problem as the text of a scenario; empty if no file can hold it.
        why: The reason why no file can hold the problem; empty with a scenario.

    Raises:
        ScenarioError: If the file cannot be written.
    """
    solution = outcome.solution
    about = {
        "version": VERSION,
        **{name: getattr(outcome, name) for name in STORED_FIELDS},
        "digest": digest,
        "no_scenario": why,
        **_verdicts(solution),
    }
    arrays: dict[str, Any] = {
        "about": np.array(json.dumps(about)),
        "scenario": np.array(scenario),
        "success": np.array(outcome.success),
        "T": np.array(outcome.T),
    }
    motion = None if solution is None else solution.trajectory
    if motion is not None:
        nodes = {name: getattr(motion, name) for name in ARRAYS}
        arrays |= {name: rows for name, rows in nodes.items() if rows is not None}
        arrays["joint_names"] = np.array(motion.joint_names)
        arrays["torques_follow"] = np.array(motion.inverse_dynamics is not None)

    make_folder(path.parent)
    write_file(path, lambda file: np.savez(file, **arrays))


def _verdicts(solution: Solution | None) -> dict[str, Any]:
    """Bounds and verdicts of a solution."""
    if solution is None:
        return {}
    verdicts: dict[str, Any] = {
        "feasible": solution.feasible,
        "robot": solution.problem.robot.name,
        "method": solution.options.method,
        "iterations": solution.iterations,
    }
    bound, replay = solution.lower_bound, solution.verification
    if bound is not None:
        verdicts |= {"lower_bound": bound.T, "lower_bound_reason": bound.reason}
    if replay is not None:
        verdicts |= {"goal_error": replay.goal_error, "speed_error": replay.speed_error}
        clearance = replay.min_clearance
        verdicts["min_clearance"] = clearance if math.isfinite(clearance) else None
    return verdicts


@dataclass(frozen=True, eq=False)
class Entry(Record):
    """One result, as its file holds it.

    Attributes:
        path: The file.
        about: Status, message, seed, bounds and verdicts, by name.
        scenario: The problem as the text of a scenario; empty if no file can hold it.
        success: Whether there is a motion that keeps all constraints.
        T: Its duration [s]; infinite without a motion.
        arrays: The motion: t (N + 1,), q, v and u (N + 1, n), and others; empty without
            a motion.
    """

    path: Path
    about: dict[str, Any]
    scenario: str
    success: bool
    T: float
    arrays: dict[str, Any]

    @classmethod
    def read(cls, path: str | Path) -> Entry:
        """Read a file.

        Raises:
            ScenarioError: If the file is not the result of a batch, or broken.
        """
        path = checked_path(path, "path", ScenarioError)
        try:
            with np.load(path, allow_pickle=False) as file:
                content = {name: file[name] for name in file.files}
            about = json.loads(str(content.pop("about")))
            scenario = str(content.pop("scenario"))
            success, T = bool(content.pop("success")), float(content.pop("T"))
            about |= {"index": int(about["index"]), "name": str(about["name"])}
        except Exception as error:  # a broken file may raise any error in the reader
            raise ScenarioError(
                f"{path} is not the result of a batch: {error}", path
            ) from error
        return cls(path, about, scenario, success, T, content)

    def load(self) -> Scenario:
        """The problem and the options.

        Raises:
            ScenarioError: If no file could hold the problem, or a file that it names
                is missing.
        """
        if not self.scenario:
            reason = self.about.get("no_scenario") or "it was never created"
            raise ScenarioError(f"{self.path} holds no problem: {reason}", self.path)
        # Paths in it are relative to the folder of the results.
        place = self.path.parent.parent / f".{self.path.stem}.toml"
        return read_scenario(parse_toml(self.scenario.encode(), place))

    def sampled(self, count: int) -> Array:
        """The motion at instants equally spaced in time, shape (count, 3 n).

        Columns are positions, velocities and torques; torques are interpolated linearly
        between the nodes.
        """
        motion = self._nodes()
        times = np.linspace(0.0, motion.duration, count)
        state = motion(times)
        u = [np.interp(times, motion.t, column) for column in motion.u.T]
        return np.hstack([state.q, state.v, np.transpose(u)])

    def _nodes(self) -> Trajectory:
        """The motion without its dynamics."""
        arrays = self.arrays
        names = tuple(str(name) for name in arrays["joint_names"].tolist())
        nodes = {k: arrays[k] for k in ARRAYS if k in arrays}
        return Trajectory(names, **nodes)

    def trajectory(self, problem: Problem | None = None) -> Trajectory | None:
        """The motion; None if no motion was found.

        Args:
            problem: The problem, for the torques between the nodes; None to read it
                from the file.

        Raises:
            ScenarioError: If the problem is to be read, as raised by :meth:`load`.
        """
        if "t" not in self.arrays:
            return None
        motion = self._nodes()
        if not bool(self.arrays["torques_follow"]):
            return motion
        problem = self.load().problem if problem is None else problem
        whole, *segments = (torques_of(p.robot) for p in (problem, *problem.phases))
        return motion.with_torques(whole, tuple(segments) if len(segments) > 1 else ())

    def outcome(self, problem: Problem, options: Options) -> Outcome:
        """The outcome in the file, with its solution if the problem was planned."""
        about = self.about
        solution = None
        if about["status"] in Status.__members__:
            bound = about.get("lower_bound")
            if bound is not None:
                bound = LowerBound(bound, about.get("lower_bound_reason", ""))
            solution = Solution(
                problem=problem,
                options=options,
                status=Status[about["status"]],
                message=about["message"],
                feasible=bool(about.get("feasible")),
                trajectory=self.trajectory(problem),
                planning_time=float(about["seconds"]),
                lower_bound=bound,
            )
        return Outcome(
            success=self.success,
            T=self.T,
            solution=solution,
            path=self.path,
            resumed=True,
            **{name: about[name] for name in STORED_FIELDS if name in about},
        )


@record
class Dataset(Record):
    """The results of a batch in a folder, read one by one.

    Attributes:
        folder: The folder.
    """

    folder: Converted[str | Path, Path]

    def __post_init__(self) -> None:
        """Check that the folder exists."""
        folder = checked_path(self.folder, "folder", ScenarioError)
        if not folder.is_dir():
            raise ScenarioError(f"{folder} is not a folder with results", folder)
        object.__setattr__(self, "folder", folder)

    @property
    def files(self) -> list[Path]:
        """The files of the last batch, in the order of the problems."""
        return [path for _, path in self._listed()]

    def _listed(self) -> list[tuple[int | None, Path]]:
        """The numbers of the problems and the files; all files if there is no list."""
        path = self.folder / LIST
        try:
            pairs = map(str.split, path.read_text(encoding="ascii").split("\n")[:-1])
            listed = sorted((int(index), self.folder / file) for index, file in pairs)
        except FileNotFoundError:
            return [(None, path) for path in sorted(self.folder.glob("*/*.npz"))]
        except (OSError, ValueError) as error:
            raise ScenarioError(
                f"{path} is damaged ({brief(str(error))}), expected lines with a "
                "number and a file; if it is deleted, all files of the folder are read",
                path,
            ) from error
        return [(index, path) for index, path in listed if path.is_file()]

    def __len__(self) -> int:
        """Number of results."""
        return len(self._listed())

    def __iter__(self) -> Iterator[Entry]:
        """Read one result after the other.

        Raises:
            ScenarioError: If a file, or the list of the files, is broken.
        """
        for index, path in self._listed():
            entry = Entry.read(path)
            if index is not None:
                entry.about["index"] = index
            yield entry

    def samples(self, count: int) -> Iterator[tuple[Entry, Array]]:
        """Motions at the same number of instants, for learning.

        Args:
            count: Number of instants, from the start to the end, equally spaced in
                time.

        Returns:
            Pairs, one after the other, of a result that has a motion and of its columns
            q, v and u, shape (count, 3 n); torques are interpolated linearly between
            the nodes.
        """
        count = whole(count, "count", 1, MAX_SAMPLES)
        return ((item, item.sampled(count)) for item in self if item.success)

    def to_parquet(self, path: str | Path) -> Path:
        """Write all results as one Parquet file, a row each; nested lists for motions.

        Returns:
            The path.

        Raises:
            MissingDependency: If pyarrow is not installed.
            ScenarioError: If a result is broken or the file cannot be written.
        """
        with optional("pyarrow", "parquet", "writing Parquet files"):
            import pyarrow as pa
            import pyarrow.parquet as pq
        rows = [
            {
                **{k: v for k, v in entry.about.items() if k != "version"},
                "success": entry.success,
                "T": entry.T if math.isfinite(entry.T) else None,
                "scenario": entry.scenario,
                **{k: values.tolist() for k, values in entry.arrays.items()},
            }
            for entry in self
        ]
        # Results without a motion lack columns that others have.
        names = dict.fromkeys(name for row in rows for name in row)
        table = pa.table({name: [row.get(name) for row in rows] for name in names})
        return write_file(path, lambda file: pq.write_table(table, file))
