"""An arm in the cluttered scenes of the MotionBenchMaker set, judged independently.

    python -m benchmarks.motionbenchmaker --data DIR
    python -m benchmarks.motionbenchmaker --data DIR --scenes box,cage --problems 1-5
    python -m benchmarks.motionbenchmaker --data DIR --rival
    python -m benchmarks.motionbenchmaker --data DIR --both
    python -m benchmarks.motionbenchmaker --data DIR --starts 20 --out out/starts.csv
    python -m benchmarks.motionbenchmaker --data DIR --against out/starts.csv

DIR holds a folder for each scene with ``scene0001.yaml``, ``request0001.yaml`` and so
on; the environment variable ``MOTIONBENCHMAKER`` may name it. The robot is the one
whose URDF and SRDF files are in this folder, or else the Panda. Each motion is checked
with exact meshes by the replay of its torques (see ``benchmarks/judging.py``),
independently of the verdict of the planner. With ``--rival`` the problems are solved by
RRT-Connect with path simplification and TOPP-RA instead; with ``--both`` the two take
turns. With the results of another run, for example with twenty starts, a line says how
far T is above the shorter motion of both.

Results go to a CSV file, a row as soon as it is known; existing rows are not
computed again. A table is printed at the end.
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
import functools
import inspect
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

if not __package__:  # run as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks import exact_geometry, judging
from benchmarks.results import (
    KEY,
    Row,
    Table,
    excess_line,
    failures,
    markdown_table,
    read_rows,
)

VARIABLE = "MOTIONBENCHMAKER"
# Robot of folders without a URDF file.
ROBOT = "panda"
SCENES = (
    "bookshelf_small",
    "bookshelf_tall",
    "bookshelf_thin",
    "box",
    "cage",
    "table_pick",
    "table_under_pick",
)
COMMON = ("success", "status", "faults", "T", "seconds", "process_seconds")
JUDGED = (
    "clearance",
    "closest",
    "closest_time",
    "limit_excess",
    "position_excess",
    "velocity_excess",
    "effort_excess",
    "goal_error",
    "goal_speed",
    "replay_error",
)
OURS = ("claimed", "iterations", "programs", "lp_seconds", "distance_seconds", "starts")
RIVALS = ("path_seconds", "timing_seconds", "waypoints", "subdivisions")


@dataclass(frozen=True)
class Case:
    """A problem of the set, as files."""

    scene: str
    problem: int
    folder: Path

    @property
    def scene_path(self) -> Path:
        """The planning scene."""
        return self._folder / f"scene{self.problem:04d}.yaml"

    @property
    def request_path(self) -> Path:
        """The motion plan request."""
        return self._folder / f"request{self.problem:04d}.yaml"

    @property
    def _folder(self) -> Path:
        """Its folder; some copies of the set add the robot to the name of a scene."""
        longer = self.folder / f"{self.scene}_{ROBOT}"
        return longer if longer.is_dir() else self.folder / self.scene

    @property
    def robot(self) -> str | Path:
        """The robot: its URDF file, or its name."""
        return next(iter(sorted(self.folder.glob("*.urdf"))), ROBOT)

    @property
    def key(self) -> tuple[str, str]:
        """Its name in the CSV file."""
        return self.scene, str(self.problem)


class Stopwatch:
    """Wall-clock and processor time since the object was made."""

    def __init__(self) -> None:
        self._begin = time.perf_counter(), time.process_time()

    def columns(self) -> dict[str, float]:
        """Both times, for a row."""
        wall, process = self._begin
        return {
            "seconds": time.perf_counter() - wall,
            "process_seconds": time.process_time() - process,
        }


class Meter:
    """Processor time spent in some functions; nested calls count once."""

    def __init__(self) -> None:
        self.seconds = 0.0
        self._inside = False

    def _measured(self, function: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(function)
        def wrapper(*args: Any, **kwargs: Any) -> Any:
            if self._inside:
                return function(*args, **kwargs)
            self._inside, begin = True, time.process_time()
            try:
                return function(*args, **kwargs)
            finally:
                self.seconds += time.process_time() - begin
                self._inside = False

        return wrapper

    @contextmanager
    def on(self, *owners: type) -> Iterator[Meter]:
        """Context in which all public methods of some classes are measured."""
        methods = [
            (owner, name, value)
            for owner in owners
            for name, value in vars(owner).items()
            if inspect.isfunction(value) and not name.startswith("_")
        ]
        for owner, name, value in methods:
            setattr(owner, name, self._measured(value))
        try:
            yield self
        finally:
            for owner, name, value in methods:
                setattr(owner, name, value)


@functools.cache
def load_arm(
    name: str | Path,
    locked: tuple[tuple[str, float], ...],
) -> tuple[Any, exact_geometry.ExactArm]:
    """Load the robot twice: for the planner, and for the judge.

    Args:
        name: The robot: its URDF file, or its name.
        locked: Names and positions of the locked joints.
    """
    from tominpmp.robot.robot import load_robot

    with warnings.catch_warnings():
        # The set has the fingers open beyond their limits, on purpose.
        warnings.simplefilter("ignore")
        robot = load_robot(name, limits="urdf", locked_joints=dict(locked))
    assert robot.srdf is not None
    exact = exact_geometry.ExactArm.load(robot.urdf_path, robot.srdf.path, dict(locked))
    return robot, exact


@dataclass(frozen=True)
class Court:
    """A problem with the robot of the planner and the objects of the judge."""

    case: Case
    robot: Any
    arm: exact_geometry.ExactArm
    surroundings: exact_geometry.Surroundings
    request: judging.Request

    @classmethod
    def of(cls, case: Case) -> Court:
        """Read a problem."""
        request = judging.read_request(case.request_path)
        unmoved = {k: v for k, v in request.start.items() if k not in request.goal}
        named = case.robot
        if named != ROBOT:
            unmoved = {}  # joints that the set does not move are fixed in its files
        robot, arm = load_arm(named, tuple(sorted(unmoved.items())))
        root = arm.model.frames[1].name
        obstacles = exact_geometry.read_obstacles(case.scene_path, root)
        surroundings = exact_geometry.Surroundings(arm, obstacles)
        return cls(case, robot, arm, surroundings, request)

    def judge(
        self, motion: judging.Motion, knots: Any, replayed: bool
    ) -> tuple[dict[str, Any], str]:
        """Columns of a verdict, and the faults in words."""
        verdict = judging.judge(
            self.arm,
            self.surroundings,
            self.request,
            motion,
            knots,
            replayed=replayed,
        )
        closest = verdict.clearance
        columns = {
            name: getattr(verdict, name) for name in JUDGED if hasattr(verdict, name)
        }
        columns["clearance"] = closest.distance
        columns["closest"] = f"{closest.first} / {closest.second}"
        columns["limit_excess"] = max(
            verdict.position_excess, verdict.velocity_excess, verdict.effort_excess
        )
        return columns, " ".join(verdict.faults)


def run_library(court: Court, arguments: argparse.Namespace) -> dict[str, Any]:
    """Plan with default options of the library, except effort, time and starts."""
    import tominpmp as tm
    from tominpmp.constraints.clearance import ClearanceConstraint
    from tominpmp.files.moveit import load_moveit
    from tominpmp.linear_programs.highs import HighsSolver
    from tominpmp.linear_programs.piqp import PiqpSolver

    files = court.case.scene_path, court.case.request_path
    limits = {
        name: value
        for name in ("acceleration", "jerk")
        if (value := getattr(arguments, name)) is not None
    }
    robot = court.robot
    if limits:
        robot = replace(robot, motion_limits=tm.MotionLimits(**limits))
    problem = load_moveit(robot, *files)
    options = tm.Options(
        effort=arguments.effort,
        max_planning_time=arguments.time_limit,
        starts=arguments.starts,
    )
    watch = Stopwatch()
    distances, programs = Meter(), Meter()
    with distances.on(ClearanceConstraint), programs.on(HighsSolver, PiqpSolver):
        solution = tm.plan(problem, options)
    columns: dict[str, Any] = watch.columns()
    history = solution.history
    columns |= {
        "status": solution.status.name,
        "claimed": solution.success,
        "iterations": len(history),
        "programs": sum(record.programs for record in history),
        "lp_seconds": programs.seconds,
        "distance_seconds": distances.seconds,
        "starts": 1 + max((record.start for record in history), default=0),
        "faults": "no motion",
    }
    if solution.trajectory is not None:
        columns["T"] = solution.T
        judged, columns["faults"] = court.judge(
            solution.trajectory, solution.trajectory.t, True
        )
        columns |= judged
    converged = solution.status is tm.Status.CONVERGED
    columns["success"] = converged and solution.success and not columns["faults"]
    return columns


def run_rival(court: Court, arguments: argparse.Namespace) -> dict[str, Any]:
    """Plan with RRT-Connect, path simplification and TOPP-RA."""
    from benchmarks.rivals.arm import Arm, TorqueModel
    from benchmarks.rivals.rrt_toppra import solve

    arm, surroundings = Arm.of(court.robot), court.surroundings
    watch = Stopwatch()
    result = solve(
        arm,
        court.arm.vector(court.request.start),
        court.arm.vector(court.request.goal),
        surroundings.is_free,
        lambda q: surroundings.closest(q).distance > 0.0,
        seed=court.case.problem,
        max_seconds=arguments.time_limit or 30.0,
    )
    columns: dict[str, Any] = watch.columns()
    columns |= {
        "status": result.status,
        "path_seconds": result.path_seconds,
        "timing_seconds": result.timing_seconds,
        "waypoints": 0 if result.waypoints is None else len(result.waypoints),
        "subdivisions": result.subdivisions,
        "faults": "no motion",
    }
    sampler = result.motion
    if sampler is not None:
        torque = TorqueModel(arm)

        def motion(t: float) -> tuple[Any, Any, Any, Any]:
            q, v, a = (part[0] for part in sampler(np.array([t])))
            return q, v, a, torque(q, v, a)

        columns["T"] = result.T
        judged, columns["faults"] = court.judge(motion, result.knots, False)
        columns |= judged
    columns["success"] = not columns["faults"]
    return columns


def run_case(case: Case, arguments: argparse.Namespace) -> Row:
    """Row of one problem; an error is a row too."""
    run = run_rival if arguments.rival else run_library
    try:
        columns = run(Court.of(case), arguments)
    except Exception as error:  # one faulty problem must not end the whole run
        words = " ".join(str(error).split())
        columns = {"status": f"{type(error).__name__}: {words}", "success": False}
        columns["faults"] = "no motion"
    columns |= dict(zip(KEY, case.key, strict=True))
    return {name: _text(value) for name, value in columns.items()}


def _text(value: Any) -> str:
    return f"{value:.9g}" if isinstance(value, float) else str(value)


def run(arguments: argparse.Namespace) -> list[Row]:
    """Run the missing problems and return all requested rows.

    With ``--both`` the library and its rival take turns, so that slow periods of the
    machine affect both; the rows are those of the library.
    """
    wanted = []
    sides = (False, True) if arguments.both else (arguments.rival,)
    tables = {
        rival: Table(
            arguments.against if arguments.both and rival else arguments.out,
            KEY + COMMON + own_columns(rival) + JUDGED,
        )
        for rival in sides
    }
    for scene in arguments.scenes:
        for problem in arguments.problems:
            case = Case(scene, problem, arguments.data)
            if not case.request_path.exists():
                raise SystemExit(f"there is no file {case.request_path}")
            wanted.append(case.key)
            for rival, table in tables.items():
                if case.key not in table.rows or arguments.rerun:
                    asked = argparse.Namespace(**vars(arguments) | {"rival": rival})
                    row = run_case(case, asked)
                    table.add(row)
                    print(_progress(row), flush=True)
    return [tables[sides[0]].rows[key] for key in wanted]


def own_columns(rival: bool) -> tuple[str, ...]:
    """Columns that exist only for the library or only for the rival."""
    return RIVALS if rival else OURS


def _progress(row: Row) -> str:
    seconds = row.get("process_seconds", "")
    word = (
        "ok" if row["success"] == "True" else f"{row['status']} {row.get('faults', '')}"
    )
    if "T" not in row:
        return f"{row['scene']:>16} {row['problem']:>3}: {row['status']}"
    return (
        f"{row['scene']:>16} {row['problem']:>3}: T {float(row['T']):.4f} s in "
        f"{float(seconds):.2f} s, clearance {1e3 * float(row['clearance']):.1f} mm, "
        f"{word}"
    )


def parse_range(text: str) -> list[int]:
    """Numbers from text such as "1-3,7"."""
    numbers: list[int] = []
    for part in text.split(","):
        first, dash, last = part.partition("-")
        try:
            span = range(int(first), int(last if dash else first) + 1)
        except ValueError:
            span = range(0)
        if not span or span[0] < 1:
            raise argparse.ArgumentTypeError(f"{part!r} is no range such as 1-20")
        numbers += span
    return list(dict.fromkeys(numbers))


def names(text: str) -> list[str]:
    """Names from text such as "box,cage"."""
    return [part.strip() for part in text.split(",") if part.strip()]


def add_problems(parser: argparse.ArgumentParser, numbers: str) -> None:
    """Add the options that choose problems of the set.

    Args:
        parser: The parser.
        numbers: Default numbers of the problems of each scene, such as "1-20".
    """
    place = os.environ.get(VARIABLE)
    parser.add_argument(
        "--data",
        type=Path,
        default=Path(place) if place else None,
        metavar="DIR",
        help=f"folder with the scenes; by default ${VARIABLE}",
    )
    parser.add_argument("--scenes", type=names, default=list(SCENES), metavar="A,B")
    parser.add_argument(
        "--problems", type=parse_range, default=parse_range(numbers), metavar=numbers
    )


def _parser() -> argparse.ArgumentParser:
    def positive(text: str) -> float:
        value = float(text)
        if not 0.0 < value < float("inf"):
            raise argparse.ArgumentTypeError("expected a positive number")
        return value

    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.motionbenchmaker",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_problems(parser, "1-20")
    parser.add_argument("--out", type=Path, help="CSV file")
    parser.add_argument(
        "--rival", action="store_true", help="RRT-Connect and TOPP-RA instead"
    )
    parser.add_argument(
        "--both", action="store_true", help="one after the other, problem by problem"
    )
    parser.add_argument(
        "--against",
        type=Path,
        default=Path("out/motionbenchmaker_rival.csv"),
        metavar="CSV",
        help="results of another run to compare with, if the file exists",
    )
    for name, unit in (("acceleration", "rad/s^2"), ("jerk", "rad/s^3")):
        parser.add_argument(
            f"--{name}", type=positive, help=f"limit of every joint [{unit}]"
        )
    parser.add_argument(
        "--time-limit", type=positive, metavar="S", help="planning time [s]"
    )
    parser.add_argument(
        "--effort", choices=("quick", "standard", "thorough"), default="standard"
    )
    parser.add_argument("--starts", type=int, metavar="N", help="initial guesses")
    parser.add_argument("--rerun", action="store_true", help="compute all anew")
    return parser


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the benchmark and print its table."""
    parser = _parser()
    options = parser.parse_args(arguments)
    if options.data is None:
        parser.error(f"--data is missing, and ${VARIABLE} is not set")
    if options.out is None:
        name = "motionbenchmaker_rival" if options.rival else "motionbenchmaker"
        if options.effort != "standard" and not options.rival:
            name += f"_{options.effort}"
        options.out = Path("out") / f"{name}.csv"
    rows = run(options)
    others: list[Row] = []
    if not options.rival and options.against.exists():
        others = read_rows(options.against)
    print()
    print(markdown_table(rows, others))
    if others:
        print(excess_line(rows, others))
    for line in failures(rows):
        print(line)


if __name__ == "__main__":
    main()
