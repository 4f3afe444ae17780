"""The command ``tour``: load stations, plan, write, report."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tominpmp.bounds.result import USELESS, LowerBound
from tominpmp.cell.commands import TourOptions
from tominpmp.cell.tours import Tour, plan_tour
from tominpmp.cell.tours.tour_file import load_tour
from tominpmp.cli.output_files import (
    MOTION_ENDINGS,
    PAGE_ENDINGS,
    PLOT_ENDINGS,
    check_period,
    check_target,
)
from tominpmp.cli.report import json_text
from tominpmp.cli.terminal import (
    INTERRUPTED,
    NO_PLAN,
    PLANNED,
    error_console,
    logged,
    say,
)
from tominpmp.exceptions import ScenarioError, TominpmpError
from tominpmp.options import Options
from tominpmp.status import Status

# What a report in JSON says of a tour, beside its motions and files.
REPORTED = (
    *("success", "status", "message", "cycle_time", "lower_bound", "gap", "verified"),
    *("planning_time", "visits"),
)


def run_tour(scenario: Path, args: TourOptions) -> int:
    """Plan a tour and report.

    Raises:
        TominpmpError: If anything given is wrong.
    """
    check_target(args.output, "--output", MOTION_ENDINGS)
    check_target(args.plot, "--plot", PLOT_ENDINGS)
    check_target(args.html, "--html", PAGE_ENDINGS)
    check_period(args.dt)
    changes: dict[str, Any] = {}
    if args.max_time is not None:
        changes["max_planning_time"] = args.max_time
    Options().changed(changes)
    arguments = load_tour(scenario)
    with logged(args.verbose, error_console()):
        try:
            tour = plan_tour(**arguments, **changes)
        except ScenarioError:
            raise
        except TominpmpError as error:
            field = getattr(error, "field", None)
            raise ScenarioError(f"{scenario}: {error}", scenario, field) from error
    files = _write(tour, args) if tour.success else []
    if args.json:
        data = {name: getattr(tour, name) for name in REPORTED}
        motions = [motion.T for motion in tour.motions]
        say(json_text(data | {"motions": motions, "files": files}))
    else:
        say(_text(tour, files))
    if tour.status is Status.INTERRUPTED:
        return INTERRUPTED
    return PLANNED if tour.success else NO_PLAN


def _write(tour: Tour, args: TourOptions) -> list[Path]:
    """Write what was asked for."""
    if args.output is not None:
        tour.export(args.output, dt=args.dt)
    if args.plot is not None:
        tour.plot(args.plot)
    if args.html is not None:
        tour.play(args.html)
    return [path for path in (args.output, args.plot, args.html) if path is not None]


def _text(tour: Tour, files: list[Path]) -> str:
    lines = [tour.message]
    if tour.success:
        bound = LowerBound(tour.lower_bound, tour.bound_reason)
        near = bound.comparison(tour.cycle_time) or USELESS
        lines += [tour.table(), f"cycle  {tour.cycle_time:.4f} s, {near}"]
    return "\n".join([*lines, *(f"file   {path}" for path in files)])
