"""Problems as plain data, and the same for the library.

Specifications are drawn and written down without the planner, so that every commit
gets the same problems, and the judge (``golden_judge.py``) reads them without the
library. :func:`build` makes a problem of the library from a specification, by the
public interface.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pinocchio as pin

import tominpmp as tm
from benchmarks.cell_arms import Member
from benchmarks.cell_cases import build_obstacle, place_of
from benchmarks.exact_geometry import Array
from benchmarks.golden_judge import Asked, Verdict, judge, read_arm
from benchmarks.random_goals import LOCKED_JOINTS

# Joints that are locked by default [rad or m].
LOCKED = {**LOCKED_JOINTS, "z1": {"jointGripper": 0.0}}
# Number of digits in which numbers are compared.
DIGITS = 9
# Keys with paths of files, which do not belong to the fingerprint of a problem.
PLACES = ("urdf", "srdf", "source")

Start = tm.Solution | tm.Trajectory | tm.Samples


@dataclass(frozen=True)
class Task:
    """A problem, how it is planned, and how the motion is judged.

    Attributes:
        problem: The problem.
        judged: The judge.
        numbers: Its plain data; the fingerprint shows whether two commits had the
            same problem.
        options: Options that differ from the default.
        start: Makes the former motion of a warm start; it is not measured.
        slack: Share of T that ``tm.smooth`` may add afterwards; None for no smoothing.
        measure: The objective, if it is not T.
    """

    problem: tm.Problem
    judged: Callable[[tm.Solution], Verdict]
    numbers: Any
    options: Mapping[str, Any] = field(default_factory=dict)
    start: Callable[[], Start] | None = None
    slack: float | None = None
    measure: Callable[[tm.Solution], float] | None = None

    @property
    def fingerprint(self) -> str:
        """A short hash of the plain data of the problem."""
        words = json.dumps(_rounded([self.numbers, dict(self.options)]), sort_keys=True)
        return hashlib.sha256(words.encode()).hexdigest()[:12]


def _rounded(value: Any) -> Any:
    """Plain data whose numbers have few digits, without paths of files."""
    if isinstance(value, Mapping):
        return {str(k): _rounded(v) for k, v in value.items() if k not in PLACES}
    if isinstance(value, np.ndarray):
        return _rounded(value.tolist())
    if isinstance(value, list | tuple):
        return [_rounded(item) for item in value]
    if isinstance(value, float | np.floating):
        return f"{float(value):.{DIGITS}g}"
    if isinstance(value, np.integer):
        return int(value)
    if value is None or isinstance(value, str | int | bool):
        return value
    return type(value).__name__


# -- arms ------------------------------------------------------------------------------


def arm(
    source: str,
    *,
    locked: Mapping[str, float] | None = None,
    speed_factor: float = 1.0,
    sheet: bool = False,
    friction: float | None = None,
    load: Asked | None = None,
    **place: Sequence[float],
) -> Asked:
    """An arm as plain data, including its limits.

    Args:
        source: Name of the robot, or its URDF file.
        locked: Positions of joints that do not move; None for :data:`LOCKED`.
        speed_factor: Factor on all velocity limits.
        sheet: Whether limits are those of the maker's data sheet.
        friction: Dry friction as a share of the torque limits; None for that of the
            description.
        load: Its permanent load.
        **place: ``base`` and ``base_rpy``, the pose of its base.
    """
    fixed = LOCKED.get(source, {}) if locked is None else dict(locked)
    limits = "datasheet" if sheet else "urdf"
    robot = tm.load_robot(source, locked_joints=fixed, limits=limits)
    known = robot.limits
    dry = robot.friction if friction is None else friction * known.effort_upper
    return {
        "robot": robot.name,
        "source": source,
        "sheet": sheet,
        "urdf": str(robot.urdf_path),
        "srdf": None if robot.srdf is None else str(robot.srdf.path),
        "locked": {k: float(v) for k, v in robot.locked_joints.items()},
        "joints": list(robot.joint_names),
        "base": list(place.get("base", (0.0, 0.0, 0.0))),
        "base_rpy": list(place.get("base_rpy", (0.0, 0.0, 0.0))),
        "gravity": np.asarray(robot.gravity).tolist(),
        "damping": robot.damping.tolist(),
        "armature": robot.armature.tolist(),
        "friction": np.asarray(dry).tolist(),
        "velocity": (speed_factor * robot.limits.velocity).tolist(),
        "effort": known.effort_upper.tolist(),
        "position": [known.position_lower.tolist(), known.position_upper.tolist()],
        "limits": _published(robot),
        "payload": load,
    }


def _published(robot: tm.Robot) -> dict[str, list[float]]:
    """Default limits of accelerations, jerks and torque rates of a robot."""
    limits, found = robot.motion_limits, {}
    for name in ("acceleration", "jerk", "effort_rate"):
        values = None if limits is None else getattr(limits, name)
        if isinstance(values, Mapping):
            values = [values.get(joint, np.inf) for joint in robot.joint_names]
        if values is not None:
            found[name] = np.broadcast_to(values, robot.n).astype(float).tolist()
    return found


def robot_of(item: Asked) -> tm.Robot:
    """The arm for the library."""
    robot = tm.load_robot(
        item["source"],
        locked_joints=item["locked"],
        limits="datasheet" if item["sheet"] else "urdf",
        velocity=np.array(item["velocity"]),
        friction=np.array(item["friction"]),
    )
    load = item["payload"]
    return robot if load is None else robot.with_payload(payload(load))


def payload(load: Asked) -> tm.Payload:
    """A load for the library."""
    return tm.Payload(
        load["mass"],
        load["frame"],
        com=load.get("com", (0.0, 0.0, 0.0)),
        inertia=load.get("inertia"),
        geometry=[build_obstacle(item) for item in load.get("shapes", ())],
    )


def member_of(item: Asked) -> Member:
    """The arm for the judge."""
    return read_arm(item, item["gravity"], None)


def placement(member: Member, q: Array, frame: str) -> pin.SE3:
    """Pose of a frame of an arm in the world, without the library."""
    model = member.arm.model
    data = model.createData()
    pin.framesForwardKinematics(model, data, member.configuration(q))
    return member.base * data.oMf[model.getFrameId(frame)]


# -- goals, rules and problems -----------------------------------------------------


def joint(q: Array, v: Array | None = None) -> Asked:
    """A goal of all joints."""
    return {
        "kind": "joint",
        "q": np.asarray(q).tolist(),
        "v": None if v is None else np.asarray(v).tolist(),
    }


def goal_of(goal: Asked) -> tm.Goal:
    """A goal for the library."""
    kind, frame = goal["kind"], goal.get("frame", "")
    if kind == "any":
        return tm.AnyGoal([goal_of(one) for one in goal["goals"]])
    if kind == "joint" and goal.get("tolerance"):
        return tm.JointRegionGoal(goal["q"], goal["tolerance"])
    if kind == "joint":
        return tm.JointGoal(goal["q"], goal["v"])
    if kind == "position":
        return tm.PositionGoal(frame, goal["position"])
    if kind == "pose":
        turn = np.array(goal["rotation"])
        return tm.PoseGoal(frame, pin.SE3(turn, np.array(goal["position"])))
    if kind == "axis":
        where = goal["axis"], goal["direction"], goal.get("position")
        return tm.AxisGoal(frame, *where)
    return tm.RegionGoal(frame, goal["lower"], goal["upper"])


def rule_of(rule: Asked, joints: Sequence[str]) -> tm.PathConstraint:
    """A rule for the library."""
    more = {k: v for k, v in rule.items() if k != "kind"}
    if rule["kind"] == "coupling":
        names = tuple(joints[column] for column in more.pop("columns"))
        return tm.JointCoupling(names, **more)
    if "rotation" in more:
        more["rotation"] = np.array(more["rotation"])
    return RULE_NAMES[rule["kind"]](**more)


RULE_NAMES: dict[str, Callable[..., tm.PathConstraint]] = {
    "tool_speed": tm.ToolSpeed,
    "tool_acceleration": tm.ToolAcceleration,
    "upright": tm.KeepUpright,
    "orientation": tm.KeepOrientation,
    "line": tm.ToolLine,
    "region": tm.WithinRegion,
    "keep_away": tm.KeepAway,
    "stable": tm.StableContact,
    "grasp": tm.FirmGrasp,
}


def asked(
    arms: Sequence[Asked] | Asked, q_start: Array, goal: Asked | None, **more: Any
) -> Asked:
    """The specification of a problem.

    Args:
        arms: One arm, or several.
        q_start: Start positions of all joints, shape (n,).
        goal: The goal; None if ``legs`` are given.
        **more: Further keys, see :func:`~benchmarks.golden_judge.judge`.
    """
    every = [arms] if isinstance(arms, Mapping) else list(arms)
    found: Asked = {
        "arms": every,
        "gravity": every[0]["gravity"],
        "obstacles": [],
        "margin": 0.0,
        "q_start": np.asarray(q_start).tolist(),
        "v_start": [0.0] * len(q_start),
        "legs": [{"goal": goal}],
        "rules": [],
        "self_collision": True,
    }
    for name in ("acceleration", "jerk", "effort_rate"):
        parts = [one["limits"].get(name) for one in every]
        if all(part is not None for part in parts):
            found[name] = [value for part in parts for value in part]
    return found | more


def build(case: Asked) -> tm.Problem:
    """The problem for the library.

    Raises:
        TominpmpError: If the library refuses the problem.
    """
    robots = [robot_of(item) for item in case["arms"]]
    names = case["arms"][0]["joints"]
    common: dict[str, Any] = {
        "scene": tm.Scene([build_obstacle(item) for item in case["obstacles"]]),
        "margin": case["margin"],
        "motion_limits": _limits(case, case["arms"][0]["sheet"]),
        "constraints": tuple(rule_of(rule, names) for rule in case["rules"]),
        "may_touch": case.get("may_touch", ()),
    }
    if not case["self_collision"]:
        common["self_collision"] = False
    if len(robots) > 1:
        return _together(case, robots, common)
    legs = case["legs"]
    if len(legs) == 1 and set(legs[0]) == {"goal"}:
        common["goal"] = goal_of(legs[0]["goal"])
    else:
        common["segments"] = [_segment(leg, names) for leg in legs]
    return tm.Problem(robots[0], case["q_start"], v_start=case["v_start"], **common)


def _limits(case: Asked, sheet: bool) -> tm.MotionLimits | None:
    values = {k: case[k] for k in ("acceleration", "jerk", "effort_rate") if k in case}
    return None if sheet or not values else tm.MotionLimits(**values)


def _segment(leg: Asked, joints: Sequence[str]) -> tm.Segment:
    load = leg.get("load")
    return tm.Segment(
        goal_of(leg["goal"]),
        constraints=tuple(rule_of(rule, joints) for rule in leg.get("rules", ())),
        motion_limits=_limits(leg, False),
        payload=None if load is None else payload(load),
        may_touch=leg.get("may_touch", ()),
        stop=leg.get("stop", False),
        dwell=leg.get("dwell", 0.0),
        arrival=leg.get("arrival"),
    )


def _together(
    case: Asked, robots: Sequence[tm.Robot], common: Mapping[str, Any]
) -> tm.Problem:
    """Several arms, each to a joint goal."""
    names = "ab"[: len(robots)]
    stand = [place_of(item) for item in case["arms"]]
    cell = tm.Workcell(list(zip(names, robots, stand, strict=True)))
    ends = np.cumsum([robot.n for robot in robots])[:-1]
    (leg,) = case["legs"]
    starts, goals = (np.split(x, ends) for x in (case["q_start"], leg["goal"]["q"]))
    return cell.problem(
        start=dict(zip(names, starts, strict=True)),
        goal={k: tm.JointGoal(q) for k, q in zip(names, goals, strict=True)},
        **common,
    )


def task(case: Asked, start: Callable[[], Start] | None = None, **more: Any) -> Task:
    """A task of plain data.

    Args:
        case: The specification.
        start: Makes the former motion of a warm start.
        **more: ``slack`` and ``measure`` of the task; all other values are options.
    """
    own = {k: more.pop(k) for k in ("slack", "measure") if k in more}
    period = more.get("control_period")
    judged = case if period is None else {**case, "period": period}
    return Task(
        build(case), lambda found: judge(judged, found), case, more, start, **own
    )
