"""Random cells: drawn as plain data, and built for the library from these."""

from __future__ import annotations

import inspect
from typing import Any

import numpy as np
import pinocchio as pin

import tominpmp as tm
from benchmarks.exact_geometry import Array
from tominpmp.dynamics import RobotDynamics

Case = dict[str, Any]

LOCKED: dict[str, dict[str, float]] = {
    "panda": {"panda_finger_joint1": 0.02, "panda_finger_joint2": 0.02},
    "z1": {"jointGripper": 0.0},
}
TOOLS = {
    "panda": "panda_hand",
    "ur5": "tool0",
    "xarm7": "link7",
    "kinova": "j2s6s200_end_effector",
    "z1": "link06",
    "planar3r": "tip",
}
ARMS = ("panda", "ur5", "xarm7", "kinova", "z1")
KINDS = (
    "free",
    "clutter",
    "payload",
    "moving_ends",
    "moving_obstacles",
    "two_arms",
    "friction",
    "controller_limits",
    "hand_goal",
    "torque_methods",
)


def has_friction() -> bool:
    """Whether robots can have dry friction."""
    return "friction" in inspect.signature(tm.load_robot).parameters


def draw_arm(rng: np.random.Generator, name: str, kind: str) -> Case:
    """An arm in the form that the judge reads, at the origin."""
    robot = tm.load_robot(name, limits="urdf", locked_joints=LOCKED.get(name, {}))
    arm: Case = {
        "robot": name,
        "urdf": str(robot.urdf_path),
        "srdf": None if robot.srdf is None else str(robot.srdf.path),
        "locked": {k: float(v) for k, v in robot.locked_joints.items()},
        "base": [0.0, 0.0, 0.0],
        "base_rpy": [0.0, 0.0, 0.0],
        "damping": robot.damping.tolist(),
        "armature": robot.armature.tolist(),
        "friction": [0.0] * robot.n,
    }
    own = getattr(robot, "friction", None)
    if own is not None:
        arm["friction"] = np.asarray(own).tolist()
    if kind == "friction":
        share = rng.uniform(0.0, 0.15, robot.n) * (rng.random(robot.n) < 0.8)
        arm["friction"] = (share * robot.limits.effort_upper).tolist()
    if rng.random() < 0.3 and kind != "torque_methods":
        arm["velocity"] = (robot.limits.velocity * rng.uniform(0.5, 4.0)).tolist()
    if kind == "payload":
        arm["payload"] = {
            "mass": float(rng.uniform(0.2, 1.5)),
            "frame": TOOLS[name],
            "com": rng.uniform(-0.05, 0.12, 3).tolist(),
            "radius": float(rng.uniform(0.02, 0.05)),
        }
    return arm


def build_arm(arm: Case) -> tm.Robot:
    """The same arm for the library."""
    options: dict[str, Any] = {"locked_joints": arm["locked"], "limits": "urdf"}
    if arm.get("velocity"):
        options["velocity"] = np.array(arm["velocity"])
    if has_friction():
        options["friction"] = np.array(arm["friction"])
    robot = tm.load_robot(arm["robot"], **options)
    load = arm.get("payload")
    if load is None:
        return robot
    ball = tm.Sphere("load", radius=load["radius"], position=load["com"])
    return robot.with_payload(
        tm.Payload(load["mass"], load["frame"], com=load["com"], geometry=[ball])
    )


def draw_configuration(rng: np.random.Generator, robot: tm.Robot) -> Array:
    """A configuration that the motors can hold with two thirds of their torque."""
    limits = robot.limits
    low = np.maximum(limits.position_lower, -np.pi)
    high = np.minimum(limits.position_upper, np.pi)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    dynamics, zero = RobotDynamics(robot), np.zeros(robot.n)
    for _ in range(1000):
        q = middle + half * rng.uniform(-0.95, 0.95, robot.n)
        tau = dynamics.inverse(q[None], zero[None], zero[None])[0]
        if np.all(np.abs(tau) < 0.66 * limits.effort_upper):
            return q
    raise RuntimeError(f"{robot.name} can hardly hold itself anywhere")


def draw_obstacles(rng: np.random.Generator, count: int, moving: bool) -> list[Case]:
    """Shapes within reach of an arm at the origin."""
    found = []
    for number in range(count):
        shape = str(rng.choice(["sphere", "box", "cylinder", "capsule"]))
        width = rng.uniform(0.03, 0.12)
        size = {
            "sphere": [width],
            "box": rng.uniform(0.05, 0.4, 3).tolist(),
            "cylinder": [width, rng.uniform(0.1, 0.6)],
            "capsule": [width, rng.uniform(0.1, 0.6)],
        }[shape]
        angle = rng.uniform(-np.pi, np.pi)
        away = rng.uniform(0.3, 0.9)
        turn = rng.normal(size=4)
        velocity = np.zeros(3)
        if moving and rng.random() < 0.6:
            velocity = rng.normal(size=3) * 0.3
        found.append(
            {
                "name": f"o{number}",
                "shape": shape,
                "size": [float(x) for x in size],
                "position": [
                    float(away * np.cos(angle)),
                    float(away * np.sin(angle)),
                    float(rng.uniform(0.0, 0.9)),
                ],
                "rotation": (turn / np.linalg.norm(turn)).tolist(),
                "velocity": velocity.tolist(),
            }
        )
    return found


def build_obstacle(item: Case) -> tm.Obstacle:
    """The same obstacle for the library."""
    place: dict[str, Any] = {"position": item["position"], "rotation": item["rotation"]}
    if np.any(item["velocity"]):
        place["motion"] = tm.ConstantVelocity(item["velocity"])
    size, name = item["size"], item["name"]
    if item["shape"] == "sphere":
        return tm.Sphere(name, radius=size[0], **place)
    if item["shape"] == "box":
        return tm.Box(name, size=size, **place)
    kind = tm.Cylinder if item["shape"] == "cylinder" else tm.Capsule
    return kind(name, radius=size[0], length=size[1], **place)


def draw_case(rng: np.random.Generator, kind: str) -> Case:
    """The specification without start and goal."""
    names = [str(rng.choice(ARMS))]
    if kind == "torque_methods":
        names = [str(rng.choice(["ur5", "kinova", "panda"]))]
    if kind == "two_arms":
        names.append(str(rng.choice(ARMS)))
    arms = [draw_arm(rng, name, kind) for name in names]
    if kind == "two_arms":
        apart = float(rng.uniform(0.5, 0.8))
        for arm, side in zip(arms, (-1.0, 1.0), strict=True):
            arm["base"] = [0.0, side * 0.5 * apart, 0.0]
            arm["base_rpy"] = [0.0, 0.0, float(rng.uniform(-np.pi, np.pi))]
    count = {"free": 0, "clutter": 6, "moving_obstacles": 4}.get(kind, 2)
    if kind in ("friction", "controller_limits", "torque_methods"):
        count = int(rng.integers(0, 3))
    return {
        "kind": kind,
        "arms": arms,
        "gravity": [0.0, 0.0, -9.81],
        "obstacles": draw_obstacles(rng, count, kind == "moving_obstacles"),
        "margin": float(rng.choice([0.0, 0.005, 0.02])),
    }


def draw_problem(rng: np.random.Generator, case: Case) -> tm.Problem:
    """Add start and goal to a case.

    Raises:
        TominpmpError: If they are invalid.
    """
    robots = [build_arm(arm) for arm in case["arms"]]
    kind = case["kind"]
    starts = [draw_configuration(rng, robot) for robot in robots]
    ends = [draw_configuration(rng, robot) for robot in robots]
    ends = [
        a + rng.uniform(0.2, 1.0) * (b - a) for a, b in zip(starts, ends, strict=True)
    ]
    speed = np.concatenate([robot.limits.velocity for robot in robots])
    case["q_start"] = np.concatenate(starts).tolist()
    moving = kind == "moving_ends"
    most = 0.3 * np.minimum(speed, 2.0) * moving
    v_start, v_end = rng.uniform(-1.0, 1.0, (2, len(speed))) * most
    case["v_start"] = v_start.tolist()
    goal = np.concatenate(ends)
    case["goal"] = {"kind": "joint", "q": goal.tolist(), "v": v_end.tolist()}
    scene = tm.Scene([build_obstacle(item) for item in case["obstacles"]])
    common: dict[str, Any] = {"scene": scene, "margin": case["margin"]}
    if kind == "controller_limits":
        case["acceleration"] = rng.uniform(5.0, 20.0, len(speed)).tolist()
        case["jerk"] = rng.uniform(300.0, 5000.0, len(speed)).tolist()
        common["motion_limits"] = tm.MotionLimits(
            acceleration=case["acceleration"], jerk=case["jerk"]
        )
    if kind == "two_arms":
        cell = tm.Workcell(
            [
                (name, robot, place_of(arm))
                for name, robot, arm in zip(
                    ("a", "b"), robots, case["arms"], strict=True
                )
            ]
        )
        return cell.problem(
            start=dict(zip("ab", starts, strict=True)),
            goal={
                k: tm.JointGoal(q, wrap=False) for k, q in zip("ab", ends, strict=True)
            },
            **common,
        )
    # The judge takes the positions of continuous joints as they are, without turns.
    target: tm.Goal = tm.JointGoal(goal, v_end if moving else None, wrap=False)
    if kind == "hand_goal":
        model = robots[0].model
        data, frame = model.createData(), TOOLS[case["arms"][0]["robot"]]
        pin.framesForwardKinematics(model, data, robots[0].expand(goal[None])[0])
        at = data.oMf[model.getFrameId(frame)].translation.tolist()
        case["goal"] = {"kind": "position", "frame": frame, "position": at}
        target = tm.PositionGoal(frame, at)
    return tm.Problem(
        robots[0], goal=target, q_start=starts[0], v_start=v_start, **common
    )


def place_of(arm: Case) -> pin.SE3:
    """Placement of the base of an arm."""
    return pin.SE3(pin.rpy.rpyToMatrix(*arm["base_rpy"]), np.array(arm["base"]))
