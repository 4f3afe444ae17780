"""The command ``plan``: load, check, plan, write, report."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import typer
from rich.console import Console

from tominpmp.cli.files import Targets
from tominpmp.cli.progress import Progress
from tominpmp.cli.report import report_data, report_text
from tominpmp.cli.request import (
    MotionRequest,
    OutputRequest,
    RobotRequest,
    make_options,
)
from tominpmp.cli.signals import Signals, heeded_signals
from tominpmp.cli.terminal import (
    INTERRUPTED,
    NO_PLAN,
    PLANNED,
    complain,
    error_console,
    logged,
)
from tominpmp.solution import Solution, Status

# Time that planning has at least, if loading has used up all of it [s].
LEAST_TIME = 1e-3

if TYPE_CHECKING:
    from tominpmp.output.export_check import ExportCheck


def run_plan(
    robot: RobotRequest,
    motion: MotionRequest,
    options: Mapping[str, Any],
    output: OutputRequest,
) -> int:
    """Plan and report.

    Args:
        robot: The robot asked for.
        motion: Start, goal and obstacles.
        options: Options of the planner; None for its own choice.
        output: What to write and show.

    Returns:
        The exit code.

    Raises:
        TominpmpError: If anything given is wrong.
    """
    begin = time.perf_counter()
    errors = error_console()
    targets = Targets.of(output)
    with heeded_signals() as signals:
        try:
            with logged(output.verbose, errors):
                solution = _solve(
                    robot, motion, options, output, errors, begin, signals
                )
            signals.writing()
            sound = _write(solution, targets, output)
        except KeyboardInterrupt:
            complain("error", "interrupted")
            return signals.code or INTERRUPTED
    if signals.code is not None:
        return signals.code
    if solution.status is Status.INTERRUPTED:
        return INTERRUPTED
    return PLANNED if solution.success and sound else NO_PLAN


def _write(solution: Solution, targets: Targets, output: OutputRequest) -> bool:
    """Write and report; returns whether what was written is as it should be."""
    files: dict[str, str] = {}
    found = None
    try:
        if solution.success:
            files, found = targets.write(solution)
    finally:
        # The figures are worth having even if the disk is full.
        _report(solution, files, found, output, to_stderr=targets.to_stdout)
    if found is not None and not found.ok:
        complain("error", found.message)
        return False
    return True


def _solve(
    robot: RobotRequest,
    motion: MotionRequest,
    options: Mapping[str, Any],
    output: OutputRequest,
    console: Console,
    begin: float,
    signals: Signals,
) -> Solution:
    """Load and plan; the time for both counts since the beginning."""
    from tominpmp.cli.sources import load_problem
    from tominpmp.output.export import load_motion
    from tominpmp.planner import plan
    from tominpmp.scenario.scenario import save_scenario

    make_options(options)  # a wrong one is to be told of before a robot is loaded
    with Progress(console, quiet=output.quiet, verbose=output.verbose) as progress:
        progress.phase(f"loading {robot.robot}")
        problem, chosen = load_problem(robot, motion, options)
        if output.scenario is not None:
            save_scenario(output.scenario, problem, chosen)
        chosen = replace(chosen, callback=progress)
        if chosen.max_planning_time is not None:
            left = chosen.max_planning_time - (time.perf_counter() - begin)
            chosen = replace(chosen, max_planning_time=max(left, LEAST_TIME))
        former = None if motion.former is None else load_motion(motion.former)
        progress.phase("planning")
        signals.check()
        if former is None:
            return plan(problem, chosen)
        return plan(problem, chosen, start=former)


def _report(
    solution: Solution,
    files: Mapping[str, str],
    found: ExportCheck | None,
    output: OutputRequest,
    to_stderr: bool,
) -> None:
    """Write the report."""
    data = report_data(solution, files, found)
    if output.json:
        text = json.dumps(data, indent=2, allow_nan=False)
    elif not output.quiet:
        text = report_text(data)
    elif not solution.success:
        text, to_stderr = solution.message, True
    else:
        return
    typer.echo(text, err=to_stderr)
