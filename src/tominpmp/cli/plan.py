"""The command ``plan``: load, check, plan, write, report."""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import replace
from typing import Any

from rich.console import Console
from rich.text import Text

from tominpmp.cli.options import PlanOptions, ProblemArguments
from tominpmp.cli.output_files import OutputFiles
from tominpmp.cli.report import json_text, report_data, report_text
from tominpmp.cli.signals import present
from tominpmp.cli.terminal import (
    INTERRUPTED,
    NO_PLAN,
    PLANNED,
    complain,
    error_console,
    log_shown,
    logged,
    say,
)
from tominpmp.exceptions import OptionsError
from tominpmp.solution import Solution
from tominpmp.status import IterationRecord, Status

# Time that planning has at least, if loading has used up all of it [s].
LEAST_TIME = 1e-3
# Lines in a log come this seldom [s].
PERIOD = 3.0
# What takes seconds where the planning cannot tell how it goes: cutting meshes.
LOGGER = "tominpmp.collision.decomposition_cache"


def run_plan(
    problem_args: ProblemArguments,
    options: Mapping[str, Any],
    args: PlanOptions,
) -> int:
    """Plan and report.

    Raises:
        TominpmpError: If anything given is wrong.
    """
    begin = time.perf_counter()
    files = OutputFiles.of(args)
    signals = present()
    with logged(args.verbose, error_console()):
        solution = _solve(problem_args, options, args, begin)
    signals.writing()
    sound = _write(solution, files)
    if signals.number is not None or solution.status is Status.INTERRUPTED:
        return INTERRUPTED
    return PLANNED if solution.success and sound else NO_PLAN


def _solve(
    problem_args: ProblemArguments,
    options: Mapping[str, Any],
    args: PlanOptions,
    begin: float,
) -> Solution:
    """Load and plan; the time for both counts since the beginning."""
    # Loading the libraries takes long, and may be interrupted.
    from tominpmp.cli.problem import load_problem
    from tominpmp.files.export import load_motion
    from tominpmp.files.scenario import save_scenario
    from tominpmp.planner.planning import plan

    with Progress(error_console(), quiet=args.quiet, verbose=args.verbose) as progress:
        progress.phase(f"loading {problem_args.robot}")
        problem, chosen = load_problem(problem_args, options)
        if args.sensitivities is not None and chosen.energy_weight > 0.0:
            raise OptionsError(
                "--sensitivities are those of the least time, but energy has a weight "
                f"of {chosen.energy_weight:g}; expected one of them alone",
                "sensitivities",
            )
        if args.save_scenario is not None:
            save_scenario(args.save_scenario, problem, chosen)
        limit = chosen.max_planning_time
        if limit is not None:
            limit = max(limit - (time.perf_counter() - begin), LEAST_TIME)
        chosen = replace(chosen, callback=progress, max_planning_time=limit)
        former = None if args.start_from is None else load_motion(args.start_from)
        progress.phase("planning")
        present().check()
        return plan(problem, chosen, former)


def _write(solution: Solution, files: OutputFiles) -> bool:
    """Write and report; returns whether what was written is as it should be."""
    written: dict[str, str] = {}
    found = None
    try:
        if solution.success:
            written, found = files.write(solution)
    finally:
        # The figures are worth having even if the disk is full.
        _report(solution, files, report_data(solution, written, found))
    if found is not None and not found.ok:
        complain("error", found.message)
        return False
    return True


def _report(solution: Solution, files: OutputFiles, data: Mapping[str, Any]) -> None:
    args = files.options
    if args.json:
        say(json_text(data))
    elif not args.quiet:
        say(report_text(data), err=files.to_stdout)
    elif not solution.success:
        say(solution.message, err=True)


class Progress:
    """Shows the phase and the last iteration while something takes long.

    On a terminal it is a line that changes and disappears at the end. Elsewhere there
    is nothing, or a line every few seconds if wished for.

    Args:
        console: Where to show it.
        quiet: Whether to show nothing at all.
        verbose: Whether to write lines where the console is no terminal.
    """

    def __init__(self, console: Console, *, quiet: bool, verbose: bool) -> None:
        self._console, self._shown = console, ExitStack()
        alive = console.is_terminal and not quiet
        self._status = console.status("") if alive else None
        self._lines = verbose and not quiet and not console.is_terminal
        self._last = time.monotonic()

    def __enter__(self) -> Progress:
        """Begin to show."""
        if self._status is not None:
            self._shown.enter_context(self._status)
            log = log_shown(LOGGER, lambda record: self.phase(record.getMessage()))
            self._shown.enter_context(log)
        return self

    def __exit__(self, *raised: object) -> None:
        """Clear the line."""
        self._shown.close()

    def phase(self, text: str) -> None:
        """Say what is being done."""
        if self._status is not None:
            self._status.update(Text(text))

    def __call__(self, record: IterationRecord) -> None:
        """Show an iteration."""
        if self._status is not None:
            self._status.update(Text(_progress_text(record)))
        elif self._lines and time.monotonic() - self._last >= PERIOD:
            self._last = time.monotonic()
            self._console.print(_progress_text(record), soft_wrap=True)


def _progress_text(record: IterationRecord) -> str:
    """Say in one line how far an iteration got."""
    start = f"start {record.start + 1}, " if record.start else ""
    return (
        f"planning: {start}iteration {record.iteration}, T {record.duration:.4f} s, "
        f"violation {record.violation:.1e}, {record.seconds:.1f} s"
    )
