"""Whether converged motions satisfy the first-order conditions, in clutter.

Problems of the MotionBenchMaker set, and boxes, balls and capsules at random around a
UR5, an xArm7 and a Panda, with default options. Each motion is certified, and planned
again with a warm start from itself: this gain was left by the converged plan.

    python -m benchmarks.certified --data DIR
    python -m benchmarks.certified --data DIR --problems 1-4 --clutter 12 --again
    python -m benchmarks.certified --against out/former.csv

A motion is *contradicted* if its status is CONVERGED and its certificate refuses it.
Rows are in a CSV file as soon as they are known; a table is printed at the end, with
an earlier run for comparison if there is one.
"""

# ruff: noqa: E402 (the environment must be set before numerical libraries load)
from __future__ import annotations

from benchmarks.sheet import Sheet, markdown, one_thread

one_thread()

import argparse
import csv
import statistics
import time
import warnings
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import tominpmp as tm
from benchmarks.cell_cases import draw_configuration
from benchmarks.motionbenchmaker import Case, Court, add_problems, names
from benchmarks.random_goals import load_arm
from tominpmp.collision.checker import CollisionChecker

CLUTTERED = ("ur5", "xarm7", "panda")
# Numbers of random obstacles, and their half extents or radii [m].
SIZES, COUNTS = (0.05, 0.2), (8, 16)
# Least distance of starts and goals from them [m].
ROOM = 0.005
COLUMNS = (
    "problem",
    "status",
    "success",
    "T",
    "seconds",
    "iterations",
    "programs",
    "certified",
    "stationarity",
    "certificate_seconds",
    "T_again",
    "again_status",
    "message",
    "refusal",
)


def draw_clutter(name: str, number: int) -> tm.Problem:
    """A joint goal of an arm among random obstacles near its straight line."""
    rng = np.random.default_rng([zlib.crc32(name.encode()), number])
    robot = load_arm(name)
    while True:
        things = [_draw_thing(rng, k) for k in range(rng.integers(*COUNTS))]
        ends = [draw_configuration(rng, robot) for _ in range(2)]
        try:
            problem = tm.Problem(
                robot, ends[0], tm.JointGoal(ends[1]), scene=tm.Scene(things)
            )
        except tm.TominpmpError:
            continue
        checker = problem.checker
        line = ends[0] + np.linspace(0.0, 1.0, 60)[:, None] * (ends[1] - ends[0])
        distances = np.min(checker.distances(line), axis=1)
        if min(distances[0], distances[-1]) > ROOM and distances.min() < 0.0:
            return problem


def _draw_thing(rng: np.random.Generator, number: int) -> Any:
    """A box, ball or capsule within reach, off the base."""
    angle, away = rng.uniform(-np.pi, np.pi), rng.uniform(0.3, 0.9)
    place = (away * np.cos(angle), away * np.sin(angle), rng.uniform(-0.1, 1.0))
    kind = str(rng.choice(["box", "sphere", "capsule"]))
    size, name = rng.uniform(*SIZES, 3), f"{kind}{number}"
    turned = rng.normal(size=4)
    turned /= np.linalg.norm(turned)
    if kind == "box":
        return tm.Box(name, size=tuple(2 * size), position=place, rotation=turned)
    if kind == "sphere":
        return tm.Sphere(name, radius=float(size[0]), position=place)
    return tm.Capsule(
        name,
        radius=float(0.5 * size[0]),
        length=float(4 * size[1]),
        position=place,
        rotation=turned,
    )


def problems(
    data: Path | None,
    scenes: Sequence[str],
    numbers: Sequence[int],
    robots: Sequence[str],
    count: int,
) -> Iterator[tuple[str, tm.Problem]]:
    """Problems of the set, then random clutter."""
    from tominpmp.files.moveit import load_moveit

    for scene in scenes if data is not None else ():
        for number in numbers:
            case = Case(scene, number, data)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                robot = Court.of(case).robot
                try:
                    problem = load_moveit(robot, case.scene_path, case.request_path)
                except tm.TominpmpError:
                    continue  # its goal is out of reach
            yield f"{scene} {number}", problem
    for name in robots:
        for number in range(count):
            yield f"{name} {number}", draw_clutter(name, number)


def measure(
    name: str, problem: tm.Problem, options: tm.Options, again: bool
) -> dict[str, Any]:
    """Plan, certify, and plan again with a warm start; returns a row."""
    CollisionChecker.distances(problem.checker, problem.q_start[None])  # meshes load
    begin = time.process_time()
    try:
        solution = tm.plan(problem, options)
    except tm.TominpmpError as error:
        return dict.fromkeys(COLUMNS, "") | {"problem": name, "message": str(error)}
    row: dict[str, Any] = dict.fromkeys(COLUMNS, "") | {
        "problem": name,
        "status": solution.status.name,
        "success": solution.success,
        "T": solution.T,
        "seconds": time.process_time() - begin,
        "iterations": solution.iterations,
        "programs": sum(record.programs for record in solution.history),
        "message": solution.message,
    }
    if not solution.success:
        return row
    begin = time.process_time()
    certificate = solution.certificate
    assert certificate is not None
    row |= {
        "certificate_seconds": time.process_time() - begin,
        "certified": certificate.ok,
        "stationarity": certificate.stationarity,
        "refusal": "" if certificate.ok else certificate.message,
    }
    if again:
        further = tm.plan(problem, options, start=solution)
        row |= {"T_again": further.T, "again_status": further.status.name}
    return row


def summary(title: str, rows: Sequence[dict[str, Any]]) -> tuple[object, ...]:
    """A line of the table."""

    def numbers(column: str, among: Sequence[dict[str, Any]]) -> list[float]:
        return [float(row[column]) for row in among if row[column] != ""]

    found = [row for row in rows if str(row["success"]) == "True"]
    converged = [row for row in found if row["status"] == "CONVERGED"]
    held = [row for row in converged if str(row["certified"]) == "True"]
    seconds, T = numbers("seconds", rows), numbers("T", found)
    proofs, again = numbers("certificate_seconds", found), numbers("T_again", found)
    first = numbers("T", [row for row in found if row["T_again"] != ""])
    return (
        title,
        f"{len(found)} / {len(rows)}",
        len(converged),
        len(converged) - len(held),
        f"{100 * max(numbers('stationarity', converged), default=0.0):.2g} %",
        f"{statistics.fmean(T):.4f}" if T else "-",
        f"{sum(seconds):.1f}",
        f"{100 * sum(proofs) / max(sum(seconds), 1e-9):.0f} %",
        f"{100 * (sum(again) / sum(first) - 1.0):+.2f} %" if again else "-",
        sum(b < 0.99 * a for a, b in zip(first, again, strict=True)) if again else "-",
    )


HEADER = (
    "run",
    "found",
    "converged",
    "contradicted",
    "largest promise",
    "mean T [s]",
    "planning [s]",
    "certificates / planning",
    "T planned again",
    "by more than 1 %",
)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add_problems(parser, "1-6")
    parser.add_argument("--robots", type=names, default=list(CLUTTERED))
    parser.add_argument("--clutter", type=int, default=10, help="problems a robot")
    parser.add_argument("--options", default="", help="name=value,... of tm.Options")
    parser.add_argument("--again", action="store_true", help="plan again from there")
    parser.add_argument("--csv", type=Path, default=Path("out/certified.csv"))
    parser.add_argument("--against", type=Path, help="CSV file of an earlier run")
    return parser


def _value(text: str) -> Any:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            pass
    return text


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, write the CSV file, print the table."""
    given = _parser().parse_args(arguments)
    pairs = [item.split("=") for item in given.options.split(",") if item]
    options = tm.Options(**{name: _value(value) for name, value in pairs})
    former: list[dict[str, Any]] = []
    if given.against is not None:
        with given.against.open(newline="", encoding="utf-8") as file:
            former = list(csv.DictReader(file))
    sheet = Sheet(given.csv, COLUMNS)
    for name, problem in problems(
        given.data, given.scenes, given.problems, given.robots, given.clutter
    ):
        sheet.add(measure(name, problem, options, given.again))
    done = {row["problem"] for row in sheet.rows}
    shared = {row["problem"] for row in former} & done
    lines = [summary("this", sheet.rows)]
    if former:
        same = [row for row in sheet.rows if row["problem"] in shared]
        lines.append(summary("this, both", same))
        same = [row for row in former if row["problem"] in shared]
        lines.append(summary("earlier", same))
    print(markdown(HEADER, lines))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
