"""Random problems of every mode of the planner, for benchmarks/continuum.py.

Obstacles are placed on the path of the arm without them, and moving obstacles are there
when it passes: they influence the motion in nearly all problems.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

import tominpmp as tm
from benchmarks.cell_cases import TOOLS
from benchmarks.exact_geometry import Array
from benchmarks.random_goals import LOCKED_JOINTS, load_arm, sample_problems
from tominpmp.kinematics import RobotKinematics

# Speeds of obstacles that move, and sizes, as shares of the reach.
SPEEDS, SIZES = (0.1, 0.4), (0.03, 0.08)
# Largest number of draws for the problems of an arm.
DRAWS = 60

# Makes a problem from robot, name, start, goal and random numbers; None if impossible.
Draw = Callable[[tm.Robot, str, Array, Array, np.random.Generator], tm.Problem | None]


def free(
    robot: tm.Robot, name: str, q: Array, q_goal: Array, rng: np.random.Generator
) -> tm.Problem:
    """A problem with the limits of the robot alone."""
    return tm.Problem(robot, q, tm.JointGoal(q_goal), self_collision=False)


def limited(*names: str) -> Draw:
    """Problems with active motion limits, drawn for all joints."""

    def draw(
        robot: tm.Robot, name: str, q: Array, q_goal: Array, rng: np.random.Generator
    ) -> tm.Problem:
        plain = free(robot, name, q, q_goal, rng)
        T, _ = _quick(plain)
        share = rng.uniform(0.3, 0.8)
        way = np.max(np.abs(q_goal - q))
        values: dict[str, Any] = {}
        if "acceleration" in names:
            values["acceleration"] = share * 6.0 * way / T**2
        if "jerk" in names:
            values["jerk"] = share * 60.0 * way / T**3
        if "effort_rate" in names:
            effort = robot.limits.effort_upper
            values["effort_rate"] = (share * 12.0 / T * effort).tolist()
        limits = tm.MotionLimits(**values)
        return tm.Problem(
            robot, q, tm.JointGoal(q_goal), self_collision=False, motion_limits=limits
        )

    return draw


def obstructed(moving: bool) -> Draw:
    """Problems with a box and a ball on the path of the tool, fixed or moving."""

    def draw(
        robot: tm.Robot, name: str, q: Array, q_goal: Array, rng: np.random.Generator
    ) -> tm.Problem | None:
        T, motion = _quick(free(robot, name, q, q_goal, rng))
        kinematics, tool = RobotKinematics(robot), TOOLS[name]
        reach = 2.5 if name == "planar3r" else 0.8
        obstacles: list[tm.Obstacle] = []
        for number, share in enumerate((rng.uniform(0.3, 0.5), rng.uniform(0.5, 0.7))):
            there = kinematics.placement(motion(share * T).q, tool).translation
            size = reach * rng.uniform(*SIZES)
            velocity = np.zeros(3)
            if moving:
                way = rng.normal(size=3) * (1.0, 1.0, name != "planar3r")
                velocity = reach * rng.uniform(*SPEEDS) * way / np.linalg.norm(way)
            place: dict[str, Any] = {"position": there - share * T * velocity}
            if moving:
                place["motion"] = tm.ConstantVelocity(velocity=velocity)
            if number:
                obstacles.append(tm.Sphere("ball", radius=size, **place))
            else:
                edges = 2.0 * size * rng.uniform(0.5, 1.5, 3)
                obstacles.append(tm.Box("box", size=edges, **place))
        return tm.Problem(robot, q, tm.JointGoal(q_goal), tm.Scene(obstacles))

    return draw


def segmented(kind: str) -> Draw:
    """Problems with two via points: passed, with stops, or a load between them."""

    def draw(
        robot: tm.Robot, name: str, q: Array, q_goal: Array, rng: np.random.Generator
    ) -> tm.Problem:
        half, tool = 0.3 * np.abs(q_goal - q), TOOLS[name]
        ways = [q + s * (q_goal - q) + rng.uniform(-half, half) for s in (0.35, 0.7)]
        limits = robot.limits
        ways = [np.clip(p, limits.position_lower, limits.position_upper) for p in ways]
        mass = 0.1 * float(rng.uniform(0.5, 1.5)) * (5.0 if name != "z1" else 2.0)
        load = tm.Payload(mass, tool) if kind == "payload" else None
        goals = [
            tm.PositionGoal(tool, RobotKinematics(robot).placement(p, tool).translation)
            if kind == "passing" and number == 1 and name != "planar3r"
            else tm.JointGoal(p)
            for number, p in enumerate(ways)
        ]
        return tm.Problem(
            robot,
            q,
            segments=[
                tm.Segment(goals[0], stop=kind != "passing"),
                tm.Segment(goals[1], payload=load, stop=kind != "passing"),
                tm.Segment(tm.JointGoal(q_goal)),
            ],
            self_collision=False,
        )

    return draw


def tool_speed(
    robot: tm.Robot, name: str, q: Array, q_goal: Array, rng: np.random.Generator
) -> tm.Problem:
    """A problem whose limit on the tool speed is below the speed without it."""
    T, motion = _quick(free(robot, name, q, q_goal, rng))
    kinematics = RobotKinematics(robot)
    times = np.linspace(0.0, T, 200)
    places = np.array(
        [kinematics.placement(p, TOOLS[name]).translation for p in motion(times).q]
    )
    speeds = np.linalg.norm(np.diff(places, axis=0), axis=1) / times[1]
    limit = float(rng.uniform(0.5, 0.8) * speeds.max())
    constraint = tm.ToolSpeed(TOOLS[name], limit)
    goal = tm.JointGoal(q_goal)
    return tm.Problem(robot, q, goal, constraints=[constraint], self_collision=False)


def upright(
    robot: tm.Robot, name: str, q: Array, q_goal: Array, rng: np.random.Generator
) -> tm.Problem | None:
    """A problem whose tool axis may lean little farther than at both ends."""
    if name == "planar3r":
        return None
    kinematics = RobotKinematics(robot)
    axes = [kinematics.placement(p, TOOLS[name]).rotation[:, 2] for p in (q, q_goal)]
    mean = axes[0] + axes[1]
    if np.linalg.norm(mean) < 0.5:
        return None
    mean /= np.linalg.norm(mean)
    lean = max(float(np.arccos(np.clip(axis @ mean, -1.0, 1.0))) for axis in axes)
    constraint = tm.KeepUpright(
        TOOLS[name], direction=mean, tolerance=lean + rng.uniform(0.05, 0.2)
    )
    goal = tm.JointGoal(q_goal)
    return tm.Problem(robot, q, goal, constraints=[constraint], self_collision=False)


def _quick(problem: tm.Problem) -> tuple[float, tm.Trajectory]:
    """A motion on few intervals, to choose limits and obstacles that influence it."""
    solution = tm.plan(problem, intervals=16, refine=None, effort="quick")
    if solution.trajectory is None:
        raise tm.ProblemError("no motion without obstacles", "q_start")
    return solution.T, solution.trajectory


# Mode: the generator of its problems, changes of the robot, and options of the plan.
Mode = tuple[Draw, dict[str, Any], dict[str, Any]]
MODES: dict[str, Mode] = {
    "auto": (free, {}, {}),
    "constant": (free, {}, {"control": "constant"}),
    "linear": (free, {}, {"control": "linear"}),
    "spline": (free, {}, {"control": "spline"}),
    "auto, speeds x 4": (free, {"speed_factor": 4.0}, {}),
    "constant, speeds x 4": (free, {"speed_factor": 4.0}, {"control": "constant"}),
    "linear, speeds x 4": (free, {"speed_factor": 4.0}, {"control": "linear"}),
    "spline, speeds x 4": (free, {"speed_factor": 4.0}, {"control": "spline"}),
    "collocation": (free, {}, {"method": "collocation"}),
    "acceleration": (limited("acceleration"), {}, {}),
    "jerk": (limited("jerk"), {}, {}),
    "torque rate": (limited("effort_rate"), {}, {}),
    "acceleration and jerk": (limited("acceleration", "jerk"), {}, {}),
    "data sheet": (free, {"datasheet": True}, {}),
    "obstacles": (obstructed(False), {}, {}),
    "obstacles, speeds x 4": (obstructed(False), {"speed_factor": 4.0}, {}),
    "moving obstacles": (obstructed(True), {}, {}),
    "moving obstacles, speeds x 4": (obstructed(True), {"speed_factor": 4.0}, {}),
    "passing": (segmented("passing"), {}, {}),
    "passing, speeds x 4": (segmented("passing"), {"speed_factor": 4.0}, {}),
    "stops": (segmented("stops"), {}, {}),
    "payload": (segmented("payload"), {"speed_factor": 4.0}, {}),
    "tool speed": (tool_speed, {"speed_factor": 4.0}, {}),
    "upright": (upright, {"speed_factor": 4.0}, {}),
}


def load(name: str, speed_factor: float = 1.0, datasheet: bool = False) -> tm.Robot:
    """An arm, with faster joints or with all limits of its data sheet."""
    if datasheet:
        locked = LOCKED_JOINTS.get(name, {})
        return tm.load_robot(name, locked_joints=locked, limits="datasheet")
    robot: tm.Robot = load_arm(name, speed_factor)
    return robot


def problems(
    mode: str, robots: str, count: int, seed: int
) -> Iterator[tuple[str, tm.Problem]]:
    """Random problems of a mode: names and problems."""
    draw, changes, _ = MODES[mode]
    for name in robots.split(","):
        if changes.get("datasheet") and name in ("planar3r", "z1"):
            continue
        robot, made = load(name, **changes), 0
        salt = zlib.crc32(f"{mode} {name}".encode())
        for number, ends in enumerate(sample_problems(robot, DRAWS, seed)):
            rng = np.random.default_rng([seed, salt, number])
            try:
                problem = draw(robot, name, *ends, rng)
            except tm.TominpmpError:  # a collision at an end, or an impossible problem
                continue
            if problem is None:
                continue
            yield f"{name} {number}", problem
            made += 1
            if made == count:
                break
