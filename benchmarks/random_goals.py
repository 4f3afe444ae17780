"""Random joint goals: the library compared with IPOPT and TOPP-RA, on one core.

Eight arms, five goals each, no obstacles, the limits of the robot descriptions. Start
and goal are drawn uniformly within the position limits; both must be holdable against
gravity with 90 % of the effort limits. For each problem the methods run one
after another in one process, so that slow periods of the machine affect all of them.

    python -m benchmarks.random_goals
    python -m benchmarks.random_goals --speed-factor 4
    python -m benchmarks.random_goals --only ipopt,toppra --robots ur5,z1 --goals 2

Results go to a CSV file, a row as soon as it is known; existing rows are not
computed again unless ``--rerun`` is given. A table is printed at the end.
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
import statistics
import sys
import time
import zlib
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

if not __package__:  # run as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.rivals.arm import Arm, Array, TorqueModel, limit_excess

LOCKED_JOINTS: dict[str, dict[str, float]] = {
    "panda": {"panda_finger_joint1": 0.0, "panda_finger_joint2": 0.0},
}
ROBOTS = ("ur3", "ur5", "ur10", "panda", "kinova", "xarm7", "z1", "planar3r")
METHODS = ("ours", "ipopt", "toppra")
KEY = (
    "robot",
    "goal",
    "speed_factor",
    "intervals",
    "grid",
    "interior",
    "seed",
    "effort",
)
SHARED = ("success", "status", "T", "seconds")
JUDGED = ("torque_excess", "velocity_excess", "position_excess", "goal_error")
OWN = {
    "ours": ("iterations", "lps"),
    "ipopt": ("iterations", "build_seconds"),
    "toppra": ("passes",),
}
COLUMNS = KEY + tuple(
    f"{method}_{name}" for method in METHODS for name in SHARED + OWN[method] + JUDGED
)

Row = dict[str, str]


def load_arm(
    name: str, speed_factor: float = 1.0, friction: float | None = None
) -> Any:
    """Load one of the benchmark's robots.

    Args:
        name: One of :data:`ROBOTS`, or another robot that the library loads.
        speed_factor: Factor on all velocity limits.
        friction: Dry friction of all joints [N m]; None for that of the description.
    """
    from tominpmp.robot.robot import load_robot

    locked = LOCKED_JOINTS.get(name, {})
    robot = load_robot(name, limits="urdf", locked_joints=locked, friction=friction)
    if speed_factor != 1.0:
        faster = np.array(robot.limits.velocity) * speed_factor
        robot = robot.with_changes(velocity=faster)
    return robot


def sample_problems(robot: Any, count: int, seed: int) -> list[tuple[Array, Array]]:
    """Draw starts and goals; the first problems do not depend on their number.

    The name of the robot's model is part of the seed: arms with the same position
    limits would otherwise get the same problems. A joint that can turn by more than a
    full turn is drawn from one turn, -pi to pi.

    Args:
        robot: A robot of the library, or an :class:`~benchmarks.rivals.arm.Arm`.
        count: Number of problems.
        seed: Seed of the random generator.

    Returns:
        Pairs of start and goal, each of shape (n,).
    """
    arm = robot if isinstance(robot, Arm) else Arm.of(robot)
    rng = np.random.default_rng([seed, zlib.crc32(arm.model.name.encode())])
    many_turns = ~(arm.position_upper - arm.position_lower <= 2 * np.pi)
    lower = np.where(many_turns, -np.pi, arm.position_lower)
    upper = np.where(many_turns, np.pi, arm.position_upper)
    torque = TorqueModel(arm)

    def holdable(q: Array) -> bool:
        tau = torque.holding(q)
        return bool(
            np.all((tau <= 0.9 * arm.effort_upper) & (tau >= 0.9 * arm.effort_lower))
        )

    def draw() -> Array:
        for _ in range(100_000):
            q = np.asarray(rng.uniform(lower, upper))
            if holdable(q):
                return q
        raise RuntimeError("the arm can hardly hold itself anywhere")

    return [(draw(), draw()) for _ in range(count)]


def interval_shares(grid: str, intervals: int) -> Array:
    """Lengths of the intervals as shares of T, shape (N,).

    Args:
        grid: ``"uniform"``, or ``"cosine"``, the library's default: dense at both ends,
            where a fast-accelerating arm would otherwise lose most of an interval.
        intervals: Number N of intervals.
    """
    from tominpmp.transcription.grid import interval_shares

    return interval_shares(grid, intervals)[:, 0]


class Contest:
    """The methods for one robot on one grid, with objects that are built only once.

    Args:
        robot: A robot of the library, velocity limits scaled already.
        intervals: Number of intervals for the library and for IPOPT.
        grid: Distribution of the intervals of both, see :func:`interval_shares`.
        interior_points: Instants inside an interval with torque limits for IPOPT.
        effort: Option ``effort`` of the library.
    """

    def __init__(
        self,
        robot: Any,
        intervals: int,
        grid: str = "uniform",
        interior_points: int = 0,
        effort: str = "standard",
    ) -> None:
        self._robot = robot
        self._effort = effort
        self._arm = Arm.of(robot)
        self._intervals = intervals
        self._interior_points = interior_points
        self._grid = grid
        self._shares = interval_shares(grid, intervals)
        self._ipopt: Any = None

    def run(self, method: str, q_start: Array, q_goal: Array) -> Row:
        """Solve one problem by one method and judge the motion.

        Args:
            method: One of :data:`METHODS`.
            q_start: Start, shape (n,).
            q_goal: Goal, shape (n,).

        Returns:
            The method's columns.
        """
        solvers: dict[str, Callable[[Array, Array], tuple[dict[str, Any], Any]]] = {
            "ours": self._run_ours,
            "ipopt": self._run_ipopt,
            "toppra": self._run_toppra,
        }
        values, motion = solvers[method](q_start, q_goal)
        if values["success"]:
            excess = limit_excess(self._arm, motion, values["T"], q_start, q_goal)
            judged = (excess.torque, excess.velocity, excess.position)
            values |= zip(JUDGED, (*judged, excess.goal_error), strict=True)
        return {f"{method}_{key}": _text(value) for key, value in values.items()}

    def _run_ours(self, q_start: Array, q_goal: Array) -> tuple[dict[str, Any], Any]:
        import tominpmp as tm

        started = time.process_time()
        problem = tm.Problem(
            self._robot, q_start, tm.JointGoal(q_goal), self_collision=False
        )
        options = tm.Options(
            intervals=self._intervals, grid=self._grid, effort=self._effort
        )
        solution = tm.plan(problem, options)
        seconds = time.process_time() - started
        values = {
            "success": bool(solution.success),
            "status": getattr(solution.status, "name", str(solution.status)),
            "T": float(solution.T),
            "seconds": seconds,
            "iterations": len(solution.history),
            "lps": sum(getattr(r, "programs", 0) for r in solution.history),
        }
        return values, lambda times: solution.trajectory(times)[:3]

    def _run_ipopt(self, q_start: Array, q_goal: Array) -> tuple[dict[str, Any], Any]:
        from benchmarks.rivals.ipopt_inverse import InverseTranscription

        if self._ipopt is None:
            self._ipopt = InverseTranscription(
                self._arm,
                self._intervals,
                fractions=self._shares,
                interior_points=self._interior_points,
            )
        result = self._ipopt.solve(q_start, q_goal)
        values = {
            "success": result.success,
            "status": result.status,
            "T": result.T,
            "seconds": result.seconds,
            "build_seconds": result.build_seconds,
            "iterations": result.iterations,
        }
        return values, result.motion if result.success else None

    def _run_toppra(self, q_start: Array, q_goal: Array) -> tuple[dict[str, Any], Any]:
        from benchmarks.rivals.toppra_line import solve_line

        result = solve_line(self._arm, q_start, q_goal)
        values = {
            "success": result.success,
            "status": result.status,
            "T": result.T,
            "seconds": result.seconds,
            "passes": result.passes,
        }
        return values, result.motion if result.success else None


def _text(value: Any) -> str:
    return f"{value:.9g}" if isinstance(value, float) else str(value)


def read_rows(path: Path) -> dict[tuple[str, ...], Row]:
    """Rows of an earlier run by their key; none if there is no file."""
    if not path.exists():
        return {}
    with path.open(newline="") as file:
        return {tuple(row[k] for k in KEY): row for row in csv.DictReader(file)}


def write_rows(path: Path, rows: Iterable[Row]) -> None:
    """Replace the file as a whole, so that an interruption leaves the old one."""
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_suffix(".part")
    with draft.open("w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, restval="", extrasaction="ignore")
        writer.writeheader()
        writer.writerows(rows)
    draft.replace(path)


def run(arguments: argparse.Namespace) -> list[Row]:
    """Run the missing problems and return all rows of this setting."""
    rows = read_rows(arguments.csv)
    wanted: list[tuple[str, ...]] = []
    warm = False
    for name in arguments.robots:
        contest: Contest | None = None
        problems: list[tuple[Array, Array]] = []
        for goal in range(arguments.goals):
            key = (
                name,
                str(goal),
                f"{arguments.speed_factor:g}",
                str(arguments.intervals),
                arguments.grid,
                str(arguments.interior_points),
                str(arguments.seed),
                arguments.effort,
            )
            wanted.append(key)
            row = rows.setdefault(key, dict(zip(KEY, key, strict=True)))
            if not arguments.rerun and all(
                row.get(f"{method}_status") for method in arguments.only
            ):
                continue
            if contest is None:
                # The rivals have no dry friction; all methods get the same problem.
                robot = load_arm(name, arguments.speed_factor, 0.0)
                contest = Contest(
                    robot,
                    arguments.intervals,
                    arguments.grid,
                    arguments.interior_points,
                    arguments.effort,
                )
                problems = sample_problems(robot, arguments.goals, arguments.seed)
            if not warm:
                # Libraries load at their first use, which must not count for a problem.
                for method in arguments.only:
                    contest.run(method, *problems[goal])
                warm = True
            for method in arguments.only:
                row.update(contest.run(method, *problems[goal]))
            write_rows(arguments.csv, rows.values())
            print(_progress(row, arguments.only), flush=True)
    return [rows[key] for key in wanted]


def _progress(row: Row, methods: Sequence[str]) -> str:
    parts = [f"{row['robot']:>9} {row['goal']:>2}"]
    for method in methods:
        status = "" if _solved(row, method) else f" ({row[f'{method}_status']})"
        T, seconds = float(row[f"{method}_T"]), float(row[f"{method}_seconds"])
        parts.append(f"{method} {T:.4f} s in {seconds:.3f} s{status}")
    return " | ".join(parts)


def _solved(row: Row, method: str) -> bool:
    return row.get(f"{method}_success") == "True"


def _numbers(rows: Iterable[Row], column: str) -> list[float]:
    return [float(row[column]) for row in rows if row.get(column)]


def _percent(values: Sequence[float], pick: Callable[[Sequence[float]], float]) -> str:
    return f"{100 * pick(values):.2f} %" if values else "-"


def _ratios(rows: Iterable[Row], method: str, rival: str) -> list[float]:
    """T of one method over T of another, minus one, where both have solved."""
    return [
        float(row[f"{method}_T"]) / float(row[f"{rival}_T"]) - 1.0
        for row in rows
        if _solved(row, method) and _solved(row, rival)
    ]


def markdown_table(rows: Sequence[Row], methods: Sequence[str]) -> str:
    """Table per robot and overall.

    Args:
        rows: Rows of one setting.
        methods: The methods to show, of :data:`METHODS`.
    """
    header = ["robot"]
    for method in methods:
        header += [f"{method}: solved", "median s", "max s"]
        header += ["torque excess", "velocity excess"]
    pairs = [
        (a, b) for i, a in enumerate(methods) for b in methods[i + 1 :]
    ]  # in the order of METHODS
    for a, b in pairs:
        first, second = (a, b) if a == "ours" else (b, a)
        header += [f"T {first} / T {second} - 1: median", "max"]
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    names = list(dict.fromkeys(row["robot"] for row in rows))
    for name in [*names, "all"]:
        group = [row for row in rows if name in ("all", row["robot"])]
        cells = [name]
        for method in methods:
            solved = [row for row in group if _solved(row, method)]
            seconds = _numbers(group, f"{method}_seconds")
            cells += [
                f"{len(solved)} / {len(group)}",
                f"{statistics.median(seconds):.3f}" if seconds else "-",
                f"{max(seconds):.3f}" if seconds else "-",
                _percent(_numbers(solved, f"{method}_torque_excess"), max),
                _percent(_numbers(solved, f"{method}_velocity_excess"), max),
            ]
        for a, b in pairs:
            first, second = (a, b) if a == "ours" else (b, a)
            ratios = _ratios(group, first, second)
            cells += [_percent(ratios, statistics.median), _percent(ratios, max)]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _parser() -> argparse.ArgumentParser:
    def names(text: str) -> list[str]:
        return [part.strip() for part in text.split(",") if part.strip()]

    def methods(text: str) -> list[str]:
        chosen = names(text)
        unknown = set(chosen) - set(METHODS)
        if unknown or not chosen:
            raise argparse.ArgumentTypeError(f"choose from {', '.join(METHODS)}")
        return [method for method in METHODS if method in chosen]

    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.random_goals",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--robots", type=names, default=list(ROBOTS), metavar="A,B")
    parser.add_argument("--goals", type=int, default=5, help="problems per robot")
    parser.add_argument("--intervals", type=int, default=40)
    parser.add_argument(
        "--grid",
        choices=("uniform", "cosine"),
        default="cosine",
        help="distribution of the intervals, also those of IPOPT",
    )
    parser.add_argument(
        "--interior-points",
        type=int,
        default=0,
        help="instants inside an interval with torque limits for IPOPT",
    )
    parser.add_argument("--speed-factor", type=float, default=1.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--only",
        type=methods,
        default=list(METHODS),
        metavar="METHODS",
        help="of ours,ipopt,toppra",
    )
    parser.add_argument(
        "--effort", choices=("quick", "standard", "thorough"), default="standard"
    )
    parser.add_argument("--rerun", action="store_true", help="compute all anew")
    parser.add_argument("--csv", type=Path, default=Path("out/random_goals.csv"))
    return parser


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the benchmark and print its table."""
    options = _parser().parse_args(arguments)
    rows = run(options)
    print()
    print(markdown_table(rows, options.only))


if __name__ == "__main__":
    main()
