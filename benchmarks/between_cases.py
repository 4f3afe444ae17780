"""Random problems with constraints between start and goal, drawn as plain data."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

import tominpmp as tm
from benchmarks.cell_cases import (
    TOOLS,
    Case,
    build_arm,
    build_obstacle,
    draw_arm,
    draw_configuration,
    draw_obstacles,
)
from benchmarks.exact_geometry import Array
from tominpmp.kinematics import RobotKinematics

ARMS = ("panda", "ur5", "xarm7")
KINDS = ("upright", "tool_speed", "via")
CONE, SPEED = float(np.deg2rad(10.0)), 0.5  # [rad], [m/s]
# Axes of the tool that point up: away from the gripped object, or across it, as for a
# hand that holds a cup.
AXES = ((0.0, 0.0, -1.0), (1.0, 0.0, 0.0))
OBSTACLES = 6
# A step of the tool towards a goal that keeps it upright, and displacements [m, rad].
STEP, WAY, TURN = 0.02, (0.5, 1.2), 1.8
VIA_GOALS = ("position", "pose", "joint")


def draw(seed: int, number: int) -> tuple[Case, tm.Problem, tm.Problem]:
    """One of the problems.

    Returns:
        The specification as plain data, the problem, and the problem without the
        constraints between start and goal.
    """
    rng = np.random.default_rng([seed, number])
    kind = KINDS[number % len(KINDS)]
    name = ARMS[number // len(KINDS) % len(ARMS)]
    arm = draw_arm(rng, name, "clutter")
    arm.pop("velocity", None)
    robot = build_arm(arm)
    for _ in range(1000):
        case: Case = {
            "kind": kind,
            "number": number,
            "arms": [arm],
            "gravity": [0.0, 0.0, -9.81],
            "frame": TOOLS[name],
            "obstacles": draw_obstacles(rng, OBSTACLES, moving=False),
            "margin": 0.005,
        }
        found = _DRAWN[kind](rng, robot, case)
        if found is None:
            continue
        try:
            return case, *_problems(robot, case, found)
        except tm.TominpmpError:
            continue
    raise RuntimeError(f"no problem of the kind {kind!r} was found")


def _problems(
    robot: tm.Robot, case: Case, states: list[Array]
) -> tuple[tm.Problem, tm.Problem]:
    """The problem, and the problem without the constraints between start and goal.

    Raises:
        TominpmpError: If one of the states is invalid.
    """
    common: dict[str, Any] = {
        "scene": tm.Scene([build_obstacle(item) for item in case["obstacles"]]),
        "margin": case["margin"],
    }
    for state in states[1:]:  # each is clear of obstacles
        tm.Problem(robot, states[0], tm.JointGoal(state), **common)
    goals = [_goal(robot, case, q) for q in states[1:]]
    free = tm.Problem(robot, states[0], goals[-1], **common)
    case |= {"q_start": states[0].tolist(), "v_start": [0.0] * robot.n}
    case["goals"] = [item.pop("drawn") for item in case["goals_drawn"]]
    del case["goals_drawn"]
    if case["kind"] == "via":
        segments = [tm.Segment(goal) for goal in goals]
        return tm.Problem(robot, states[0], segments=segments, **common), free
    rule: tm.ToolSpeed | tm.KeepUpright = tm.ToolSpeed(case["frame"], SPEED)
    if case["kind"] == "upright":
        rule = tm.KeepUpright(case["frame"], axis=case["axis"], tolerance=CONE)
        case["tolerance"] = CONE
    else:
        case["limit"] = SPEED
    return tm.Problem(robot, states[0], goals[0], constraints=(rule,), **common), free


def _goal(robot: tm.Robot, case: Case, q: Array) -> tm.Goal:
    """A goal that a configuration meets: itself, or the position of its tool."""
    frame, known = case["frame"], case.setdefault("goals_drawn", [])
    kind = "joint" if case["number"] % 2 else "pose"
    if case["kind"] == "via":
        kind = VIA_GOALS[(case["number"] // len(KINDS) + len(known)) % len(VIA_GOALS)]
    place = RobotKinematics(robot).placement(q, frame)
    at = place.translation
    known.append(
        {
            "drawn": {
                "kind": kind,
                "q": q.tolist(),
                "position": at.tolist(),
                "rotation": place.rotation.tolist(),
            }
        }
    )
    if kind == "joint":
        return tm.JointGoal(q)
    if kind == "position":
        return tm.PositionGoal(frame, at)
    return tm.PoseGoal(frame, place)


def _free_ends(rng: np.random.Generator, robot: tm.Robot, count: int) -> list[Array]:
    """Configurations, each between the preceding one and a random one."""
    found = [draw_configuration(rng, robot)]
    for _ in range(count):
        other = draw_configuration(rng, robot)
        found.append(found[-1] + rng.uniform(0.3, 1.0) * (other - found[-1]))
    return found


def _tool_speed(rng: np.random.Generator, robot: tm.Robot, case: Case) -> list[Array]:
    return _free_ends(rng, robot, 1)


def _via(rng: np.random.Generator, robot: tm.Robot, case: Case) -> list[Array]:
    return _free_ends(rng, robot, 3)


def _upright(
    rng: np.random.Generator, robot: tm.Robot, case: Case
) -> list[Array] | None:
    """Start and goal with the tool upright; without obstacles there is a path."""
    axis = np.array(AXES[int(rng.integers(len(AXES)))])
    case["axis"] = axis.tolist()
    kinematics, frame = RobotKinematics(robot), case["frame"]
    q = draw_configuration(rng, robot)
    place = kinematics.placement(q, frame)
    up = _tilted(rng, 0.6 * CONE)
    turn = pin.Quaternion.FromTwoVectors(place.rotation @ axis, up).toRotationMatrix()
    start = _moved(
        kinematics, frame, q, pin.SE3(turn @ place.rotation, place.translation), 40
    )
    if start is None:
        return None
    place = kinematics.placement(start, frame)
    way = rng.normal(size=3)
    way *= rng.uniform(*WAY) / np.linalg.norm(way)
    spin = rng.uniform(-TURN, TURN)
    steps = int(np.ceil(np.linalg.norm(way) / STEP))
    q = start
    for k in range(1, steps + 1):
        rotation = pin.rpy.rpyToMatrix(0.0, 0.0, spin * k / steps) @ place.rotation
        target = pin.SE3(rotation, place.translation + way * k / steps)
        after = _moved(kinematics, frame, q, target, 8)
        if after is None or np.abs(after - q).max() > 0.4:
            return None
        q = after
    return [start, q] if np.abs(q - start).max() > 0.8 else None


def _tilted(rng: np.random.Generator, most: float) -> Array:
    """A direction near the vertical."""
    angle, side = most * np.sqrt(rng.random()), rng.uniform(-np.pi, np.pi)
    return np.array(
        [np.sin(angle) * np.cos(side), np.sin(angle) * np.sin(side), np.cos(angle)]
    )


def _moved(
    kinematics: RobotKinematics, frame: str, q: Array, target: pin.SE3, steps: int
) -> Array | None:
    """A configuration near q whose tool is at a target; None if not found."""
    limits = kinematics.robot.limits
    margin = 0.02
    low, high = limits.position_lower + margin, limits.position_upper - margin
    for _ in range(steps):
        place = kinematics.placement(q, frame)
        miss = np.concatenate(
            [
                target.translation - place.translation,
                pin.log3(target.rotation @ place.rotation.T),
            ]
        )
        if np.linalg.norm(miss) < 1e-7:
            return q
        J = kinematics.jacobian(q, frame)
        step = J.T @ np.linalg.solve(J @ J.T + 1e-6 * np.eye(6), miss)
        step *= min(1.0, 0.3 / max(float(np.abs(step).max()), 1e-12))
        q = np.clip(q + step, low, high)
    return None


_DRAWN = {"upright": _upright, "tool_speed": _tool_speed, "via": _via}
