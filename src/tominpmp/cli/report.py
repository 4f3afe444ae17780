"""Reports for people and for programs: of a plan, a judged motion, a robot."""

from __future__ import annotations

import dataclasses
import json
import sys
import textwrap
from collections.abc import Mapping, Sequence
from enum import Enum
from importlib import metadata
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from rich.console import Console

from tominpmp.bounds.result import LowerBound
from tominpmp.motion.measures import SATURATED
from tominpmp.motion.trajectory import Trajectory
from tominpmp.motion_limits import MotionLimits, kinds_of
from tominpmp.notebook import text_table
from tominpmp.problem.problem import Problem
from tominpmp.robot.robot import Robot
from tominpmp.sensitivities.records import LEAST
from tominpmp.solution import Solution
from tominpmp.viz.shares import shares_of_limits

if TYPE_CHECKING:
    from tominpmp.files.export_check import ExportCheck

# Largest numbers of sensitivities, and of reasons to refuse a message, in a report.
SHOWN, REFUSALS = 8, 5
# Width of the labels of the rows below the table of joints.
LABEL = 14


def limit_shares(problem: Problem, trajectory: Trajectory) -> tuple[float, float]:
    """Share of the time with an actuator, and with an actuator or a speed, at a limit.

    The motion is evaluated at the middle of each interval.
    """
    middles = 0.5 * (trajectory.t[1:] + trajectory.t[:-1])
    shares = shares_of_limits(problem, trajectory, middles)
    parts = np.abs([shares.torque, shares.speed])
    torque, speed = np.any(parts >= SATURATED, axis=2)
    weights = np.diff(trajectory.t) / (trajectory.duration or 1.0)
    return float(weights @ torque), float(weights @ (torque | speed))


def report_data(
    solution: Solution, files: Mapping[str, str], file: ExportCheck | None = None
) -> dict[str, Any]:
    """Report of a solution, in types of JSON; infinite numbers are None.

    Args:
        solution: The solution.
        files: Files written, by their labels.
        file: Judgement of the file of the motion, if there is one.
    """
    problem, options = solution.problem, solution.options
    data: dict[str, Any] = {
        "tominpmp": metadata.version("tominpmp"),
        "robot": problem.robot.name,
        "joint_names": problem.robot.joint_names,
        **_named(solution, "status", "message", "success", "T"),
        **_named(options, "method", "intervals", "lp_solver"),
        "iterations": solution.iterations,
        "starts": len({record.start for record in solution.history}),
        "programs": sum(record.programs for record in solution.history),
        **_named(solution, "planning_time", "violations"),
    }
    if problem.robot.kinematic:
        data["kinematic"] = True
    trajectory, replay = solution.trajectory, solution.verification
    if trajectory is not None:
        torque, either = limit_shares(problem, trajectory)
        data |= {"torque_limited_share": torque, "limited_share": either}
        data |= {"q_start": trajectory.q[0], "q_end": trajectory.q[-1]}
        if solution.peak_acceleration is not None:
            data["peak_acceleration"] = solution.peak_acceleration
        if not solution.success:
            data["best_attempt"] = trajectory.duration
        elif options.energy_weight:
            data |= {"energy": solution.energy, "cost": solution.cost}
        if trajectory.segment_ends is not None:
            data["segments"] = _segments_data(solution)
    if replay is not None:
        data |= {"verified": replay.ok, **_named(replay, "goal_error", "min_clearance")}
    if solution.lower_bound is not None:
        data["lower_bound"] = solution.lower_bound.T
        data["lower_bound_reason"] = solution.lower_bound.reason
    if "certificate plot" in files and solution.certificate is not None:
        data["certified"] = solution.certificate.ok
        data["certificate"] = solution.certificate.message
    if "sensitivities plot" in files:
        data["sensitivities"] = _sensitivities_data(solution)
    data["files"] = files
    if file is not None:
        data |= {"file_holds": file.ok, "file_joined": file.joined}
        data |= {"file_message": file.message, "file_notes": file.notes}
    return cast("dict[str, Any]", plain(data))


def _named(record: object, *names: str) -> dict[str, Any]:
    return {name: getattr(record, name) for name in names}


def _sensitivities_data(solution: Solution) -> list[dict[str, Any]]:
    """Report of the sensitivities of a motion, the largest effect first."""
    names = ("kind", "joint", "subject", "value", "unit", "limit", "limit_unit")
    T = 1e3 * solution.T
    return [
        _named(item, *names, "effect", "vector")
        | {"text": f"{item.label}, {item.more} more: {item.effect * T:+.3g} ms"}
        for item in solution.sensitivities
    ]


def _segments_data(solution: Solution) -> list[dict[str, Any]]:
    """Report of the segments of a motion, one after the other.

    Times are from the start of the motion [s]; the goal is met at "arrival", and the
    segment ends at "end", after the time "stay" at the goal. That is at least the time
    "dwell" of the problem, rounded up to whole control periods if there is one.
    """
    segments = solution.problem.segments
    return [
        {
            **_named(part, "begin", "arrival", "end", "duration"),
            "stop": segment.stop or segment is segments[-1],
            "dwell": segment.dwell,
            "stay": part.stay,
        }
        for part, segment in zip(solution.segments, segments, strict=True)
    ]


def _segment_rows(segments: Sequence[Mapping[str, Any]]) -> list[tuple[str, str]]:
    """A row for each segment: its duration, and a stop or dwell at its end."""
    rows = []
    for number, item in enumerate(segments, start=1):
        how = "arrives" if item["stop"] else "passes"
        text = f"{item['duration']:.4f} s, {how} at {item['arrival']:.4f} s"
        if item["stay"]:
            text += f", stays {item['stay']:g} s"
        elif item["stop"] and number < len(segments):
            text += ", stops"
        rows.append((f"segment {number}", text))
    return rows


def report_text(data: Mapping[str, Any]) -> str:
    """Format the report as text, a line for each item."""
    rows: list[tuple[str, str]] = []
    for key, kind in (("T", "duration"), ("best_attempt", "best attempt")):
        if data.get(key) is not None:
            rows.append((kind, f"{data[key]:.4f} s"))
    rows += _segment_rows(data.get("segments", ()))
    count, starts = data["programs"], data["starts"]
    programs = f"{count} linear program{'' if count == 1 else 's'}"
    programs += f", {starts} starts" if starts > 1 else ""
    rows.append(("iterations", f"{data['iterations']} ({programs})"))
    rows.append(("planning time", f"{data['planning_time']:.2f} s"))
    method = f"{data['method']}, {data['intervals']} intervals, {data['lp_solver']}"
    method += ", kinematic" if data.get("kinematic") else ""
    rows.append(("method", method))
    if "limited_share" in data and data["success"]:
        torque, either = data["torque_limited_share"], data["limited_share"]
        of = "an acceleration" if data.get("kinematic") else "a torque"
        share = f"{100 * torque:.0f} % of the time {of}, "
        rows.append(("at limits", f"{share}{100 * either:.0f} % {of} or a speed"))
    if "verified" in data:
        missed = data["goal_error"]
        replay = "was not completed"
        if missed is not None:
            replay = f"ends {missed:.1e} from the goal"
        if data["min_clearance"] is not None:
            replay += f", clearance {data['min_clearance']:.4f} m"
        rows.append(("replay", replay))
    if "lower_bound" in data and data["success"]:
        bound = LowerBound(data["lower_bound"], data["lower_bound_reason"])
        rows.append(("lower bound", bound.in_words(data["T"])))
    if "certificate" in data:
        rows.append(("certificate", data["certificate"]))
    every = data.get("sensitivities", ())
    held = [item["text"] for item in every if abs(item["effect"]) >= LEAST]
    rows += [("held by", text) for text in held[:SHOWN]]
    if data["violations"]:
        worst = data["violations"].items()
        shown = {None: "infinite", 0.0: "0"}
        texts = (f"{kind} {shown.get(x) or format(x, '.1e')}" for kind, x in worst)
        rows.append(("violations", f"{', '.join(texts)} (scaled)"))
    rows += data["files"].items()
    if "file_holds" in data:
        verdict = "passes" if data["file_holds"] else "does not pass"
        rows.append(("as read", f"{verdict}, interpolated by {data['file_joined']}"))
        rows += [("note", note) for note in data["file_notes"]]
    return rows_text(data["message"], rows)


def check_data(judgement: ExportCheck) -> dict[str, Any]:
    """Report of the judgement of a motion file, in types of JSON."""
    replay = judgement.verification
    return {
        "motion": judgement.path,
        "T": judgement.duration,
        **plain(replay),
        "touches": replay.touches,
        **_named(judgement, "ok", "joined", "notes"),
        "refusals": [str(item) for item in judgement.refusals],
    }


def check_text(judgement: ExportCheck) -> str:
    """Format the judgement of a motion file as text."""
    replay = judgement.verification
    verdict = "solves the problem" if replay.ok else "does not solve the problem"
    if replay.ok and not judgement.ok:
        verdict = "solves the problem, but a controller would refuse it"
    rows = [("duration", f"{judgement.duration:.4f} s")]
    rows.append(("interpolation", judgement.joined))
    rows += [("note", note) for note in judgement.notes]
    rows += [("refused", str(item)) for item in judgement.refusals[:REFUSALS]]
    errors = f"{replay.goal_error:.1e} in position, {replay.speed_error:.1e} in speed"
    rows.append(("goal error", errors))
    if np.isfinite(replay.min_clearance):
        rows.append(("clearance", f"{replay.min_clearance:.4f} m at least"))
    rows.append(("replay", f"{replay.integrator}, {replay.seconds:.2f} s"))
    rows += [("violation", str(item)) for item in judgement.violations]
    rows += [("warning", str(item)) for item in replay.touches]
    return rows_text(f"The motion in {judgement.path} {verdict}.", rows)


def robot_data(robot: Robot) -> dict[str, Any]:
    """Report of a robot, in types of JSON; infinite limits are None."""
    limits, beyond, semantics = robot.limits, robot.motion_limits, robot.srdf
    groups = {} if semantics is None else semantics.groups
    kinds = {joint.name: joint.kind for joint in robot.description.joints}
    others = {*robot.joint_names, *robot.locked_joints}
    columns = _named(limits, *(item.name for item in dataclasses.fields(limits)))
    columns |= _named(robot, "damping", "armature", "friction")
    if robot.kinematic:
        columns = _named(limits, "position_lower", "position_upper", "velocity")
    for quantity in kinds_of(MotionLimits, numbers=True):
        if beyond is not None and getattr(beyond, quantity) is not None:
            columns[quantity] = beyond.by_joint(quantity, robot.joint_names)
    data = {
        "name": robot.name,
        "urdf": robot.urdf_path,
        "srdf": None if semantics is None else semantics.path,
        "kinematic": robot.kinematic,
        "gravity": robot.gravity,
        "joints": [
            {"name": name, "kind": kinds[name]}
            | {key: column[i] for key, column in columns.items()}
            for i, name in enumerate(robot.joint_names)
        ],
        "locked_joints": robot.locked_joints,
        "mimic_joints": [name for name in kinds if name not in others],
        "passive_joints": robot.passive_joints,
        "groups": {name: group.joints for name, group in groups.items()},
        "group_states": robot.group_states,
        "frames": robot.frame_names,
        "collision_geometries": int(robot.collision_model.ngeoms),
    }
    return cast("dict[str, Any]", plain(data))


def robot_text(data: dict[str, Any]) -> str:
    """Format the report of a robot as text, wrapped to the width of a terminal."""
    console = Console()
    width = max(console.width, 2 * LABEL) if console.is_terminal else sys.maxsize
    count, shapes = len(data["joints"]), data["collision_geometries"]
    rows = {
        "gravity": [f"{value:g}" for value in data["gravity"]],
        "locked": [f"{k}={value:g}" for k, value in data["locked_joints"].items()],
        "mimic": data["mimic_joints"],
        "passive": data["passive_joints"],
        "groups": list(data["groups"]),
        "group states": list(data["group_states"]) or ["none"],
        "collision": [f"{shapes} geometr{'y' if shapes == 1 else 'ies'}"],
        "frames": data["frames"],
        "URDF": [data["urdf"]],
        "SRDF": [data["srdf"] or "none"],
    }
    kind = ", kinematic: without torques" if data["kinematic"] else ""
    lines = [f"{data['name']}: {count} joint{'' if count == 1 else 's'}{kind}", ""]
    lines += [_table(data["joints"]), ""]
    lines += ["Units: rad, s, N m; for prismatic joints m, s, N.", ""]
    lines += [_row(name, row, width) for name, row in rows.items() if row]
    return "\n".join(lines)


def _row(label: str, items: list[str], width: int) -> str:
    """Format a label and a list, wrapped to a width."""
    return textwrap.fill(
        f"{label:<{LABEL}}{', '.join(items)}",
        width,
        subsequent_indent=" " * LABEL,
        break_long_words=False,
        break_on_hyphens=False,
    )


def _table(joints: list[dict[str, Any]]) -> str:
    """Format the table of joints; its lines are never shortened to fit a terminal."""
    columns = {key: [_cell(key, joint[key]) for joint in joints] for key in joints[0]}
    lower, upper = columns.pop("effort_lower", []), columns.get("effort_upper", [])
    for i, (low, high) in enumerate(zip(lower, upper, strict=True)):
        opposite = joints[i]["effort_upper"]
        if opposite is None or joints[i]["effort_lower"] != -opposite:
            upper[i] = f"{low} to {high}"
    heads = {"name": "joint", "effort_upper": "effort"}
    head = [
        heads.get(key, key.replace("position_", "").replace("_", " "))
        for key in columns
    ]
    return text_table([head, *zip(*columns.values(), strict=True)], left=2)


def _cell(key: str, value: Any) -> str:
    """Format a value; None stands for an infinite limit."""
    if value is None:
        return "-inf" if key.endswith("lower") else "inf"
    return value if isinstance(value, str) else f"{value:.5g}"


def rows_text(message: str, rows: Sequence[tuple[str, str]]) -> str:
    """Format a message and, below it, rows of a label and a text."""
    return f"{message}\n\n{textwrap.indent(text_table(rows, left=2), '  ')}"


def plain(value: Any) -> Any:
    """Convert records, arrays and paths to types of JSON.

    Infinite numbers and NaN become None. Fields of a record that ``repr`` does not show
    are left out: they are too long for a report.
    """
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        items = (item.name for item in dataclasses.fields(value) if item.repr)
        return {name: plain(getattr(value, name)) for name in items}
    if hasattr(value, "_asdict"):
        value = value._asdict()
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, Enum):
        return value.name
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    return value if isinstance(value, str | int | None) else str(value)


def json_text(data: Any) -> str:
    """Format data as indented JSON."""
    return json.dumps(plain(data), indent=2, allow_nan=False)
