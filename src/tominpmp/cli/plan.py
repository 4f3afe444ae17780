"""The command ``plan``: load, check, plan, write, report."""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.text import Text

from tominpmp.cli.options import PlanOptions, ProblemOptions, is_scenario
from tominpmp.cli.output_files import STDOUT, motion_file, write_files
from tominpmp.cli.report import json_text, report_data, report_text
from tominpmp.cli.signals import present
from tominpmp.cli.terminal import (
    INTERRUPTED,
    NO_PLAN,
    PLANNED,
    as_command_line_flags,
    complain,
    error_console,
    log_shown,
    logged,
    say,
)
from tominpmp.exceptions import OptionsError
from tominpmp.solution import Solution
from tominpmp.status import IterationRecord, Status

# Least time between lines of progress outside a terminal [s].
PERIOD = 3.0
# Logger of the decomposition of meshes, which takes seconds and has no callback.
LOGGER = "tominpmp.collision.decomposition_cache"


def run_plan(
    robot: str,
    problem_args: ProblemOptions,
    options: Mapping[str, Any],
    args: PlanOptions,
) -> int:
    """Load, plan, write and report.

    Args:
        robot: Name or path of the robot; or a scenario file.
        problem_args: Changes of the robot, start, goal and obstacles.
        options: Options of the planner that were typed.
        args: Warm start, files to write, and report.

    Returns:
        The exit code.

    Raises:
        TominpmpError: If an argument or a file is wrong.
    """
    motion = motion_file(args)
    # Importing the libraries takes long, and may be interrupted.
    from tominpmp.certificate.dwells import no_certificate
    from tominpmp.cli.problem import load_problem
    from tominpmp.files.export import load_motion
    from tominpmp.files.export_check import joined_samples
    from tominpmp.files.scenario import save_scenario
    from tominpmp.planner.planning import plan
    from tominpmp.sensitivities.analysis import check_applicable

    signals = present()
    progress = Progress(error_console(), quiet=args.quiet, verbose=args.verbose)
    with logged(args.verbose), progress:
        progress.phase(f"loading {robot}")
        problem, chosen = load_problem(robot, problem_args, options)
        dual = args.certificate or args.sensitivities
        if dual is not None and (reason := no_certificate(problem)):
            fault = f"--certificate and --sensitivities: {reason}"
            raise OptionsError(fault, "certificate")
        if args.sensitivities is not None:
            check_applicable(problem, chosen.energy_weight)
        if args.save_scenario is not None:
            save_scenario(args.save_scenario, problem, chosen)
        former, path = None, args.start_from
        if path is not None:  # joined here, so that an error names the file
            former = joined_samples(load_motion(path), problem, path).trajectory
        progress.phase("planning")
        signals.check()
        solution = plan(problem, replace(chosen, callback=progress), former)
    if not is_scenario(robot):
        solution = replace(solution, message=as_command_line_flags(solution.message))
    signals.writing()
    sound = _write(solution, args, motion)
    if signals.number is not None or solution.status is Status.INTERRUPTED:
        return INTERRUPTED
    return PLANNED if solution.success and sound else NO_PLAN


def _write(solution: Solution, args: PlanOptions, motion: Path | None) -> bool:
    """Write and report; return whether the written motion solves the problem."""
    written, judgement = dict[str, str](), None
    try:
        if solution.success:
            written, judgement = write_files(solution, args, motion)
    finally:
        # The report is useful even if the disk is full.
        data = report_data(solution, written, judgement)
        if args.json:
            say(json_text(data))
        elif not args.quiet:
            say(report_text(data), err=args.output == STDOUT)
        elif not solution.success:
            say(solution.message, err=True)
    if judgement is not None and not judgement.ok:
        complain("error", judgement.message)
        return False
    return True


class Progress(ExitStack):
    """Shows the phase and the last iteration during long computations.

    On a terminal it is a status line, which also shows the log of the decomposition of
    meshes, and disappears at the end of the ``with`` block. Elsewhere nothing is shown,
    or, with ``verbose``, a line every few seconds.

    Args:
        console: Console that shows the progress.
        quiet: Whether to show no progress at all.
        verbose: Whether to write lines where the console is not a terminal.
    """

    def __init__(self, console: Console, *, quiet: bool, verbose: bool) -> None:
        super().__init__()
        self._status = console.status("") if console.is_terminal and not quiet else None
        self._lines = verbose and not quiet and not console.is_terminal
        self._last = time.monotonic()
        if self._status is not None:
            self.enter_context(self._status)
            log = log_shown(LOGGER, lambda record: self.phase(record.getMessage()))
            self.enter_context(log)

    def phase(self, text: str) -> None:
        """Show the name of a phase."""
        if self._status is not None:
            self._status.update(Text(text))

    def __call__(self, record: IterationRecord) -> None:
        """Show an iteration."""
        if self._status is not None:
            self.phase(_progress_text(record))
        elif self._lines and time.monotonic() - self._last >= PERIOD:
            self._last = time.monotonic()
            say(_progress_text(record), err=True)


def _progress_text(record: IterationRecord) -> str:
    """The state of an iteration, in one line."""
    start = f"start {record.start + 1}, " if record.start else ""
    return (
        f"planning: {start}iteration {record.iteration}, T {record.duration:.4f} s, "
        f"violation {record.violation:.1e}, {record.seconds:.1f} s"
    )
