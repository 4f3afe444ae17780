"""The report at the end of a planning, for people and for programs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from importlib import metadata
from typing import TYPE_CHECKING, Any

import numpy as np

from tominpmp.arrays import Array
from tominpmp.robot import Robot
from tominpmp.solution import Solution
from tominpmp.trajectory import Trajectory

if TYPE_CHECKING:
    from tominpmp.output.export_check import ExportCheck

# A torque or speed this close to its limit, as a share of it, is at the limit.
CLOSE = 0.01


def limit_shares(robot: Robot, trajectory: Trajectory) -> tuple[float, float]:
    """Share of the time with an actuator, and with an actuator or a speed, at a limit.

    Args:
        robot: The robot.
        trajectory: A motion of it; looked at in the middle of its intervals.

    Returns:
        The two shares, from 0 to 1.
    """
    limits = robot.limits
    state = trajectory(0.5 * (trajectory.t[1:] + trajectory.t[:-1]))
    span = limits.effort_upper - limits.effort_lower
    reach = np.minimum(state.u - limits.effort_lower, limits.effort_upper - state.u)
    torque = np.any((reach <= CLOSE * span / 2) & (span > 0.0), axis=1)
    speed = np.any(np.abs(state.v) >= (1.0 - CLOSE) * limits.velocity, axis=1)
    weights = np.diff(trajectory.t) / trajectory.duration
    return float(weights @ torque), float(weights @ (torque | speed))


def report_data(
    solution: Solution, files: Mapping[str, str], file: ExportCheck | None = None
) -> dict[str, Any]:
    """What there is to report, in types that JSON knows; infinite numbers are None.

    Args:
        solution: The solution.
        files: Files written, by what they hold.
        file: What the file of the motion was found to do, if there is one.
    """
    problem, options = solution.problem, solution.options
    data: dict[str, Any] = {
        "tominpmp": metadata.version("tominpmp"),
        "robot": problem.robot.name,
        "joint_names": list(problem.robot.joint_names),
        "status": solution.status.name,
        "message": solution.message,
        "success": solution.success,
        "T": solution.T if solution.success else None,
        "method": options.method,
        "intervals": options.intervals,
        "lp_solver": options.lp_solver,
        "iterations": solution.iterations,
        "starts": len({record.start for record in solution.history}),
        "programs": sum(record.programs for record in solution.history),
        "planning_time": solution.planning_time,
        "violations": {k: float(v) for k, v in solution.violations.items()},
    }
    trajectory = solution.trajectory
    if trajectory is not None:
        torque, either = limit_shares(problem.robot, trajectory)
        data["torque_limited_share"] = torque
        data["limited_share"] = either
        data["q_start"] = _list(trajectory.q[0])
        data["q_end"] = _list(trajectory.q[-1])
        peak = solution.peak_acceleration
        if peak is not None:
            data["peak_acceleration"] = asdict(peak)
        if not solution.success:
            data["best_attempt"] = trajectory.duration
    found, bound = solution.verification, solution.lower_bound
    if found is not None:
        data["verified"] = found.ok
        data["goal_error"] = float(found.goal_error)
        clearance = float(found.min_clearance)
        data["min_clearance"] = clearance if math.isfinite(clearance) else None
    if bound is not None:
        data["lower_bound"] = float(bound.T)
        data["lower_bound_reason"] = bound.reason
    if "certificate plot" in files and solution.certificate is not None:
        data["certified"] = solution.certificate.ok
        data["certificate"] = solution.certificate.message
    data["files"] = dict(files)
    if file is not None:
        data["file_holds"] = file.ok
        data["file_joined"] = file.joined
        data["file_message"] = file.message
        data["file_notes"] = list(file.notes)
    return data


def _list(values: Array) -> list[float]:
    return [float(value) for value in values]


def report_text(data: Mapping[str, Any]) -> str:
    """Write the report for people, a line an item."""
    lines: list[tuple[str, str]] = []
    for key, kind in (("T", "duration"), ("best_attempt", "best attempt")):
        if data.get(key) is not None:
            lines.append((kind, f"{data[key]:.4f} s"))
    programs = f"{data['iterations']} ({_count(data['programs'], 'linear program')}"
    if data["starts"] > 1:
        programs += f", {data['starts']} starts"
    lines.append(("iterations", programs + ")"))
    lines.append(("planning time", f"{data['planning_time']:.2f} s"))
    method = f"{data['method']}, {data['intervals']} intervals, {data['lp_solver']}"
    lines.append(("method", method))
    if "limited_share" in data and data["success"]:
        lines.append(
            (
                "at limits",
                f"{_percent(data['torque_limited_share'])} of the time a torque, "
                f"{_percent(data['limited_share'])} a torque or a speed",
            )
        )
    if "verified" in data:
        replay = f"ends {data['goal_error']:.1e} from the goal"
        if data["min_clearance"] is not None:
            replay += f", clearance {data['min_clearance']:.4f} m"
        lines.append(("replay", replay))
    if data.get("lower_bound"):
        bound = f"{data['lower_bound']:.4f} s ({data['lower_bound_reason']})"
        lines.append(("lower bound", bound))
    if "certificate" in data:
        lines.append(("certificate", data["certificate"]))
    if data["violations"]:
        worst = ", ".join(
            f"{kind} {value:.1e}" if value else f"{kind} 0"
            for kind, value in data["violations"].items()
        )
        lines.append(("violations", worst))
    lines += [(kind, file) for kind, file in data["files"].items()]
    if "file_holds" in data:
        verdict = "holds" if data["file_holds"] else "does not hold"
        lines.append(("as read", f"{verdict}, joined by {data['file_joined']}"))
        lines += [("note", note) for note in data["file_notes"]]
    width = max(len(label) for label, _ in lines) + 2
    body = [f"  {label:<{width}}{text}" for label, text in lines]
    return "\n".join([data["message"], "", *body])


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" + ("" if number == 1 else "s")


def _percent(share: float) -> str:
    return f"{100.0 * share:.0f} %"
