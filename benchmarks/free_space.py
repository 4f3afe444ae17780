"""Random motions without obstacles: self-collisions, and the cost of avoiding them.

Start and goal are drawn as in benchmarks/random_goals.py, without self-collision by
the exact meshes. Each motion is planned twice in turn in one process, with and without
self-collision, and checked with the triangle meshes of the
description, every millisecond, by code independent of the library
(benchmarks/exact_geometry.py).

    python -m benchmarks.free_space
    python -m benchmarks.free_space --robots ur5 --motions 10
"""

# ruff: noqa: E402 (the environment must be set before numerical libraries load)
from __future__ import annotations

from benchmarks.sheet import Sheet, markdown, one_thread

one_thread()

import argparse
import itertools
import statistics
import time
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin

import tominpmp as tm
from benchmarks.exact_geometry import Array, Body, ExactArm, Surroundings
from benchmarks.random_goals import LOCKED_JOINTS, load_arm, sample_problems

COLUMNS = (
    "robot",
    "motion",
    "status",
    "T",
    "T_blind",
    "seconds",
    "seconds_blind",
    "clearance",
    "reported",
    "clearance_blind",
    "ok_blind",
)
# Links that overlap at this share of random configurations do so by design.
ALWAYS, SAMPLES = 0.95, 100


def widened(model: Any, angles: Array) -> Array:
    """Configuration of a model from one angle for each joint.

    Continuous joints have a cosine and a sine.
    """
    q = pin.neutral(model)
    for joint in range(1, model.njoints):
        item, value = model.joints[joint], angles[model.joints[joint].idx_v]
        turn = [np.cos(value), np.sin(value)] if item.nq == 2 else [value]
        q[item.idx_q : item.idx_q + item.nq] = turn
    return q


def judge_of(name: str, robot: Any) -> Surroundings:
    """The exact meshes of an arm, and the pairs that may touch, from the files."""
    urdf, srdf = Path(robot.urdf_path), Path(robot.srdf.path)
    arm = ExactArm.load(urdf, srdf, LOCKED_JOINTS.get(name, {}))
    free = set(arm.disabled) or neighbours(urdf, arm)
    free |= always_touching(arm, free)
    return Surroundings(replace(arm, disabled=frozenset(free)), [])


def neighbours(urdf: Path, arm: ExactArm) -> set[frozenset[str]]:
    """Links between which there is no other link with a shape."""
    parent = {
        str(joint.find("child").get("link")): str(joint.find("parent").get("link"))
        for joint in ET.parse(urdf).getroot().findall("joint")
    }
    shaped = {body.name for body in arm.links}
    found = set()
    for name in shaped:
        above = parent.get(name)
        while above is not None and above not in shaped:
            above = parent.get(above)
        if above is not None:
            found.add(frozenset((name, above)))
    return found


def always_touching(arm: ExactArm, without: set[frozenset[str]]) -> set[frozenset[str]]:
    """Links that overlap at nearly all configurations."""
    model, data = arm.model, arm.model.createData()
    low, high = np.full(model.nv, -np.pi), np.full(model.nv, np.pi)
    for item in list(model.joints)[1:]:
        if item.nq == 1:
            low[item.idx_v] = max(model.lowerPositionLimit[item.idx_q], -np.pi)
            high[item.idx_v] = min(model.upperPositionLimit[item.idx_q], np.pi)
    rng, count = np.random.default_rng(1), {}
    for _ in range(SAMPLES):
        pin.forwardKinematics(model, data, widened(model, rng.uniform(low, high)))
        for one, other in itertools.combinations(arm.links, 2):
            key = frozenset((one.name, other.name))
            if one.joint != other.joint and key not in without:
                count[key] = count.get(key, 0) + overlap(data, one, other)
    return {key for key, number in count.items() if number > ALWAYS * SAMPLES}


def overlap(data: Any, one: Body, other: Body) -> bool:
    """Whether two bodies overlap."""
    places = [data.oMi[body.joint] * body.placement for body in (one, other)]
    one_at, other_at = (coal.Transform3s(p.rotation, p.translation) for p in places)
    request, result = coal.CollisionRequest(), coal.CollisionResult()
    return bool(coal.collide(one.shape, one_at, other.shape, other_at, request, result))


def timed(robot: Any, ends: tuple[Array, Array], own: bool) -> tuple[Any, float]:
    """Plan a motion; the processor time includes making the problem."""
    begin = time.process_time()
    problem = tm.Problem(robot, ends[0], tm.JointGoal(ends[1]), self_collision=own)
    solution = tm.plan(problem)
    return solution, time.process_time() - begin


def taken(robot: Any, ends: tuple[Array, Array]) -> bool:
    """Whether the library also accepts start and goal as collision-free."""
    try:
        tm.Problem(robot, ends[0], tm.JointGoal(ends[1]))
    except tm.ProblemError:
        return False
    return True


def clearance(judge: Surroundings, solution: Any) -> float:
    """Smallest distance of the exact meshes, every millisecond [m]."""
    if solution.trajectory is None:
        return np.nan
    times = np.append(np.arange(0.0, solution.T, 1e-3), solution.T)
    path = solution.trajectory(times).q
    return judge.closest(np.array([widened(judge.model, q) for q in path])).distance


def main() -> int:
    """Measure, write the CSV file, print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", default="panda,ur5,xarm7,kinova")
    parser.add_argument("--motions", type=int, default=25, help="by robot")
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--csv", type=Path, default=Path("out/free_space.csv"))
    arguments = parser.parse_args()
    sheet = Sheet(arguments.csv, COLUMNS)
    refused: dict[str, tuple[int, int]] = {}
    for name in arguments.robots.split(","):
        robot = load_arm(name)
        judge = judge_of(name, robot)
        drawn = sample_problems(robot, 3 * arguments.motions, arguments.seed)
        clear = [
            ends
            for ends in drawn
            if all(judge.is_free(widened(judge.model, q)) for q in ends)
        ]
        kept = [ends for ends in clear if taken(robot, ends)]
        refused[name] = len(clear) - len(kept), len(clear)
        for number, ends in enumerate(kept[: arguments.motions]):
            if number == 0:  # reads meshes and libraries
                for own in (True, False):
                    timed(robot, ends, own)
            found = [timed(robot, ends, own) for own in (True, False)]
            (watched, seconds), (blind, seconds_blind) = found
            row = [name, number, watched.status.name, watched.T, blind.T]
            row += [seconds, seconds_blind, clearance(judge, watched)]
            row += [watched.verification.min_clearance if watched.success else np.nan]
            row += [clearance(judge, blind), blind.success]
            sheet.add(dict(zip(COLUMNS, row, strict=True)))
    print(table(sheet, arguments.robots.split(",")))
    for name, (number, drawn_) in refused.items():
        print(f"{name}: {number} of {drawn_} clear pairs of ends were refused")
    return 0


def table(sheet: Sheet, robots: list[str]) -> str:
    """Results of the motions of each robot."""
    lines = []
    for name in robots:
        rows = [row for row in sheet.rows if row["robot"] == name]
        touching = [row for row in rows if row["clearance_blind"] <= 0.0]
        apart = [row for row in rows if row["clearance_blind"] > 0.0]
        ratios = [row["seconds"] / row["seconds_blind"] for row in apart]
        hit = [row["seconds"] / row["seconds_blind"] for row in touching]
        total = sum(row["seconds"] for row in apart)
        total /= sum(row["seconds_blind"] for row in apart)
        lines.append(
            (
                name,
                f"{sum(row['status'] == 'CONVERGED' for row in rows)} / {len(rows)}",
                len(touching),
                sum(row["clearance"] <= 0.0 for row in rows),
                statistics.median(row["seconds_blind"] for row in rows),
                statistics.median(row["seconds"] for row in rows),
                f"{100 * (statistics.median(ratios) - 1):+.0f} %",
                f"{100 * (total - 1):+.0f} %",
                statistics.median(hit) if hit else "",
            )
        )
    header = (
        "robot",
        "solved",
        "touch without",
        "touch with",
        "median s without",
        "median s with",
        "median change",
        "change of the sum",
        "factor where links touch",
    )
    return markdown(header, lines)


if __name__ == "__main__":
    raise SystemExit(main())
