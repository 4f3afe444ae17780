"""The command ``verify``: judge a motion from a file."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from enum import Enum
from pathlib import Path
from typing import Any, cast

import numpy as np
import typer

from tominpmp.cli.request import MotionRequest, RobotRequest
from tominpmp.cli.sources import load_problem
from tominpmp.cli.terminal import NO_PLAN, PLANNED
from tominpmp.exceptions import ProblemError
from tominpmp.output.export import (
    is_message,
    load_message,
    load_motion,
    message_motion,
)
from tominpmp.output.ros_rules import (
    Refusal,
    controller_needs,
    controller_refusals,
    ends_moving,
)
from tominpmp.problem import Problem
from tominpmp.recorded import join
from tominpmp.sampling import Interpolation, check_interpolation
from tominpmp.trajectory import Samples

# Rules that are shown where a message breaks more.
SHOWN = 5


def run_verify(
    robot: RobotRequest,
    motion: MotionRequest,
    path: Path,
    as_json: bool,
    interpolation: str | None = None,
) -> int:
    """Judge a motion and report.

    Args:
        robot: A scenario file; or the robot, with files of MoveIt in the motion.
        motion: Scene, request and margin.
        path: File that holds the motion.
        as_json: Whether the report is JSON.
        interpolation: How the points are joined; None for what the kind of file says.

    Returns:
        The exit code.

    Raises:
        TominpmpError: If a file is wrong or they do not belong together.
    """
    if not robot.is_scenario and motion.request is None:
        raise ProblemError(
            f"{robot.robot!r} is no scenario file (.toml): expected one, or a robot "
            "with --scene and --request",
            "scenario",
        )
    problem, options = load_problem(robot, motion, {})
    if interpolation is not None:
        check_interpolation(interpolation)
    samples, broken, notes = _read(path, problem)
    joined = join(
        samples,
        problem.robot,
        path,
        start=problem.q_start,
        start_velocity=problem.v_start,
        interpolation=cast("Interpolation | None", interpolation),
    )
    from tominpmp.verification import verify

    trajectory = joined.trajectory
    found = verify(problem, trajectory, options.tolerances)
    ok = found.ok and not broken
    if as_json:
        data = {"motion": str(path), "T": trajectory.duration} | _plain(found)
        data |= {"ok": ok, "joined": str(joined), "notes": notes}
        data["refusals"] = [str(item) for item in broken]
        typer.echo(json.dumps(data, indent=2, allow_nan=False))
    else:
        rows = [("joined", f"by {joined}"), *(("note", note) for note in notes)]
        rows += [("refused", str(item)) for item in broken[:SHOWN]]
        typer.echo(_text(path, trajectory.duration, found, ok, rows))
    return PLANNED if ok else NO_PLAN


def _read(
    path: Path, problem: Problem
) -> tuple[Samples, tuple[Refusal, ...], list[str]]:
    """Samples of a file, what a controller refuses of it, and what it needs for it."""
    if not is_message(path):
        return load_motion(path), (), []
    message = load_message(path)
    samples = message_motion(message, path)
    moving = ends_moving(problem.goal)
    effort = bool(np.any(np.isfinite(samples.u)))
    broken = controller_refusals(message, effort_interface=effort, moving_end=moving)
    return samples, broken, controller_needs(samples, moving)


def _plain(value: Any) -> Any:
    """Turn a record into types that JSON knows; infinite numbers are None."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        # What is too long to be shown is too long for a report.
        items = (item for item in dataclasses.fields(value) if item.repr)
        return {item.name: _plain(getattr(value, item.name)) for item in items}
    if hasattr(value, "_asdict"):
        return {key: _plain(item) for key, item in value._asdict().items()}
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, Enum):
        return value.name
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    return value if isinstance(value, str | int | None) else str(value)


def _text(
    path: Path, duration: float, found: Any, ok: bool, more: list[tuple[str, str]]
) -> str:
    """Write the judgement for people."""
    verdict = "solves the problem" if found.ok else "does not solve the problem"
    if found.ok and not ok:
        verdict = "solves the problem, but a controller would refuse it"
    rows = [
        ("duration", f"{duration:.4f} s"),
        (
            "goal error",
            f"{found.goal_error:.1e} in position, {found.speed_error:.1e} in speed",
        ),
        ("clearance", f"{found.min_clearance:.4f} m at least"),
        ("replay", f"{found.integrator}, {found.seconds:.2f} s"),
    ]
    if np.isinf(found.min_clearance):
        del rows[2]
    rows[1:1] = more
    rows += [("violation", str(violation)) for violation in found.violations]
    body = [f"  {label:<12}{text}" for label, text in rows]
    return "\n".join([f"The motion in {path} {verdict}.", "", *body])
