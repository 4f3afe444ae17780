"""Sensitivities compared with finite differences of new plans.

Twenty problems: random joint goals of arms (light and heavy loads, limits of
controllers, low speed), goals on frames, obstacles and constraints. Every limit,
clearance, load or position with a relevant sensitivity is decreased and increased by
1 % (or 1 mm, 1 mrad), and the problem is planned again with a warm start, on the same
grid. The sensitivity should equal the central difference of ln T.

    python -m benchmarks.sensitivities
    python -m benchmarks.sensitivities --only planar --least 0.2
"""

# ruff: noqa: E402 (the environment must be set before numerical libraries load)
from __future__ import annotations

from benchmarks.sheet import Sheet, markdown, one_thread

one_thread()

import argparse
import math
import statistics
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import tominpmp as tm
from benchmarks.cell_cases import TOOLS
from benchmarks.random_goals import load_arm, sample_problems
from tominpmp.sensitivities.records import Sensitivity

COLUMNS = (
    "problem",
    "T",
    "promise",
    "kind",
    "subject",
    "unit",
    "sensitivity",
    "difference",
    "off",
    "seconds_plan",
    "seconds_sensitivities",
)
# Plans whose times can be compared to 1e-5: one descent, on one grid, to its end.
FINE: dict[str, Any] = {
    "starts": 1,
    "effort": "quick",
    "refine": None,
    "smoothing": 1e-6,
    "tolerance": 1e-7,
    "max_planning_time": math.inf,
}
OBSTACLE = tm.Scene([tm.Sphere("O", radius=0.8, position=(4, 0, 0))])
PLACES, PLACE_STEPS = {"goal", "obstacle", "margin"}, 5.0
DECLARED = {"acceleration", "jerk", "effort rate"}
ROBOT_FIELDS = {"velocity", "effort", "damping", "friction"}


def changed(problem: tm.Problem, item: Sensitivity, change: float) -> tm.Problem | None:
    """The problem with one limit changed; None if it cannot be changed.

    Args:
        problem: The problem.
        item: The sensitivity to the limit.
        change: Change as a share of the limit, or in its unit.
    """
    robot = problem.robot
    if item.kind in ROBOT_FIELDS and item.joint and item.limit:
        value = {item.joint: item.limit * (1.0 + change)}
        return replace(problem, robot=robot.with_changes(**{item.kind: value}))
    if item.kind == "gravity":  # its vector is not a position
        gravity = np.asarray(robot.gravity) * (1.0 + change)
        return replace(problem, robot=robot.with_changes(gravity=gravity))
    if item.kind in DECLARED and problem.motion_limits is not None:
        name = item.kind.replace(" ", "_")
        values = problem.motion_limits.by_joint(name, robot.joint_names)
        values[robot.joint_names.index(str(item.joint))] *= 1.0 + change
        limits = replace(problem.motion_limits, **{name: values})
        return replace(problem, motion_limits=limits)
    if item.kind == "margin":
        margin = problem.margin + change * (1.0 if item.unit else problem.margin)
        return replace(problem, margin=margin) if margin >= 0.0 else None
    if item.kind == "goal" and item.vector is not None:
        return _with_goal_moved(problem, item, change)
    if item.kind == "obstacle" and item.vector is not None:
        along = item.vector / np.linalg.norm(item.vector)
        moved = [
            replace(one, position=one.position + change * along)
            if one.name == item.subject
            else one
            for one in problem.scene
        ]
        return replace(problem, scene=tm.Scene(moved))
    if item.kind == "goal" and isinstance(problem.goal, tm.JointGoal):
        q = np.array(problem.goal.q)
        q[robot.joint_names.index(str(item.joint))] += change
        return replace(problem, goal=replace(problem.goal, q=q))
    if item.kind == "payload":
        return _with_load(problem, item, change)
    for index, one in enumerate(problem.constraints):
        if one.name == item.kind and hasattr(one, "limit"):
            constraints = list(problem.constraints)
            constraints[index] = replace(one, limit=one.limit * (1.0 + change))
            return replace(problem, constraints=tuple(constraints))
    return None


def _with_goal_moved(
    problem: tm.Problem, item: Sensitivity, change: float
) -> tm.Problem | None:
    goal, vector = problem.goal, np.asarray(item.vector)
    if not isinstance(goal, tm.PositionGoal):
        return None
    along = change * vector / np.linalg.norm(vector)
    return replace(problem, goal=replace(goal, position=goal.position + along))


def _with_load(problem: tm.Problem, item: Sensitivity, change: float) -> tm.Problem:
    """Loads of the problems with arms of example-robot-data."""
    load = problem.robot.payloads[0]
    mass = load.mass + change * (1.0 if item.unit else load.mass)
    robot = load_arm(problem.robot.name).with_payload(replace(load, mass=mass))
    return replace(problem, robot=robot)


def problems() -> Iterator[tuple[str, tm.Problem]]:
    """Twenty problems by name."""
    yield from _planar()
    loads = {"ur5": 4.0, "panda": 2.0, "xarm7": 2.0}
    limits = tm.MotionLimits(acceleration=12.0, jerk=400.0)
    for name in ("ur5", "panda", "xarm7"):
        robot = load_arm(name)
        heavy = robot.with_payload(tm.Payload(loads[name], TOOLS[name], (0, 0, 0.1)))
        quick = robot.with_changes(velocity=4.0 * robot.limits.velocity)
        pairs = sample_problems(robot, 4, 7)
        for kind, arm, own, (start, end) in (
            ("", robot, None, pairs[0]),
            ("loaded", heavy, None, pairs[1]),
            ("quick", quick, None, pairs[2]),
            ("smooth", robot, limits, pairs[3]),
        ):
            goal = tm.JointGoal(end)
            yield (
                f"{name} {kind}".strip(),
                tm.Problem(arm, start, goal, motion_limits=own, self_collision=False),
            )


def _planar() -> Iterator[tuple[str, tm.Problem]]:
    """The planar arm: obstacles, goals on its tip, constraints, a controller."""
    robot = load_arm("planar3r")
    weightless = robot.with_changes(gravity=(0, 0, 0))
    start, goal = (0.5, 1.7, -1.7), tm.PositionGoal("tip", (4, 1, 0))
    joints = tm.JointGoal([1.2, 0.8, -0.4])
    limits = tm.MotionLimits(acceleration=20.0, jerk=300.0, effort_rate=300.0)
    speed = (tm.ToolSpeed("tip", 2.0),)
    yield "planar", tm.Problem(robot, start, joints)
    yield "planar weightless", tm.Problem(weightless, start, joints)
    yield "planar tip", tm.Problem(robot, start, goal)
    yield "planar obstacle", tm.Problem(robot, start, goal, OBSTACLE, 0.02)
    yield "planar wide", tm.Problem(weightless, start, goal, OBSTACLE, 0.1)
    yield "planar controller", tm.Problem(robot, start, joints, motion_limits=limits)
    yield "planar speed", tm.Problem(robot, start, goal, constraints=speed)
    slow = robot.with_changes(velocity=1.0)
    yield "planar slow", tm.Problem(slow, start, goal, OBSTACLE, 0.02)


def difference(
    problem: tm.Problem, solution: tm.Solution, item: Sensitivity, steps: float = 1.0
) -> float | None:
    """Central difference of ln T by a limit; None without two plans on one grid.

    Args:
        problem: The problem.
        solution: Its solution, from which the others are planned.
        item: The sensitivity to the limit.
        steps: Number of steps by which the limit is changed in both directions.
            Positions are changed by a few more: a change within the tolerance of the
            goal needs no other motion.
    """
    step = item.step * steps * (PLACE_STEPS if item.kind in PLACES else 1.0)
    logarithms = []
    for sign in (-1.0, 1.0):
        other = changed(problem, item, sign * step)
        if other is None:
            return None
        found = tm.plan(other, start=solution, **planned_as(solution))
        if not found.success or found.trajectory.t.size != solution.trajectory.t.size:
            return None
        logarithms.append(math.log(found.T))
    return (logarithms[1] - logarithms[0]) / (2.0 * step)


def planned_as(solution: tm.Solution) -> dict[str, Any]:
    """Options that plan on the grid of a solution."""
    assert solution.trajectory is not None
    intervals = solution.trajectory.t.size - 1
    return {**FINE, "intervals": intervals, "control": solution.options.control}


def mattering(solution: tm.Solution, least: float) -> list[Sensitivity]:
    """Sensitivities whose step changes T by a number of hundredths of a per cent."""
    limits = [s for s in solution.sensitivities if not s.kind.endswith("position")]
    return [s for s in limits if abs(s.effect) >= 0.01 * least and s.kind != "margin"]


def measure(
    name: str, problem: tm.Problem, least: float, sheet: Sheet, intervals: int
) -> None:
    """One row for each sensitivity that matters."""
    begin = time.process_time()
    solution = tm.plan(problem, intervals=intervals, **FINE)
    planned = time.process_time() - begin
    begin = time.process_time()
    found = solution.sensitivities
    seconds = time.process_time() - begin
    for item in mattering(solution, least):
        by_plans = difference(problem, solution, item)
        off = None if by_plans is None else abs(item.value / by_plans - 1.0)
        values = (
            name,
            solution.T,
            found.promise,
            item.kind,
            item.subject,
            item.unit,
            item.value,
            by_plans,
            off,
            planned,
            seconds,
        )
        sheet.add(dict(zip(COLUMNS, values, strict=True)))


def table(sheet: Sheet) -> str:
    """Errors of the sensitivities, by kind."""
    rows = [row for row in sheet.rows if row["off"] is not None]
    lines = []
    for kind in [*dict.fromkeys(row["kind"] for row in rows), "all"]:
        off = [100 * row["off"] for row in rows if kind in (row["kind"], "all")]
        within = sum(value <= 5.0 for value in off)
        lines.append(
            (kind, len(off), statistics.median(off), max(off), f"{within} / {len(off)}")
        )
    header = ("kind", "values", "off [%]: median", "most", "within 5 %")
    return markdown(header, lines)


def main() -> int:
    """Measure, write the CSV file, print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--only", default="", help="problems whose names begin with this"
    )
    parser.add_argument("--least", type=float, default=0.1, help="values that matter")
    parser.add_argument("--intervals", type=int, default=40)
    parser.add_argument("--csv", type=Path, default=Path("out/sensitivities.csv"))
    arguments = parser.parse_args()
    sheet = Sheet(arguments.csv, COLUMNS)
    for name, problem in problems():
        if name.startswith(arguments.only):
            measure(name, problem, arguments.least, sheet, arguments.intervals)
    print(table(sheet))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
