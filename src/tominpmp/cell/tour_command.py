"""The command ``tour``: load stations, plan, write, report."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tominpmp.bounds.result import USELESS, LowerBound
from tominpmp.cell.options import TourOptions
from tominpmp.cell.tours import Tour
from tominpmp.cell.tours.tour_file import blamed, load_tour
from tominpmp.cli.json_text import json_text
from tominpmp.cli.output_files import (
    MOTION_ENDINGS,
    PAGE_ENDINGS,
    PLOT_ENDINGS,
    check_period,
    check_target,
)
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


def run_tour(scenario: Path, args: TourOptions) -> int:
    """Plan a tour and report.

    Raises:
        TominpmpError: If anything given is wrong.
    """
    targets = (
        (args.output, "--output", MOTION_ENDINGS),
        (args.plot, "--plot", PLOT_ENDINGS),
        (args.html, "--html", PAGE_ENDINGS),
    )
    for path, option, endings in targets:
        if path is not None:
            check_target(path, option, endings)
    check_period(args.dt)
    changes: dict[str, Any] = {}
    if args.max_time is not None:
        changes["max_planning_time"] = args.max_time
        Options().changed(changes)
    task = load_tour(scenario)
    with logged(args.verbose, error_console()):
        try:
            tour = task.plan(**changes)
        except ScenarioError:
            raise
        except TominpmpError as error:
            raise blamed(scenario, error) from error
    written = _write(tour, args)
    say(json_text(_data(tour, written)) if args.json else _text(tour, written))
    if tour.status is Status.INTERRUPTED:
        return INTERRUPTED
    return PLANNED if tour.success else NO_PLAN


def _write(tour: Tour, args: TourOptions) -> list[Path]:
    """Write what was asked for; nothing without a tour."""
    if not tour.success:
        return []
    found = []
    if args.output is not None:
        found.append(tour.export(args.output, dt=args.dt))
    if args.plot is not None:
        tour.plot(args.plot)
        found.append(args.plot)
    if args.html is not None:
        found.append(Path(tour.play(args.html)))
    return found


def _text(tour: Tour, written: list[Path]) -> str:
    lines = [tour.message]
    if tour.success:
        bound = LowerBound(tour.lower_bound, tour.bound_reason)
        near = bound.comparison(tour.cycle_time) or USELESS
        lines += [tour.table(), f"cycle  {tour.cycle_time:.4f} s, {near}"]
    return "\n".join([*lines, *(f"file   {path}" for path in written)])


def _data(tour: Tour, written: list[Path]) -> dict[str, Any]:
    return {
        "success": tour.success,
        "status": tour.status,
        "message": tour.message,
        "cycle_time": tour.cycle_time,
        "lower_bound": tour.lower_bound,
        "gap": tour.gap,
        "verified": tour.verified,
        "planning_time": tour.planning_time,
        "visits": tour.visits,
        "motions": [motion.T for motion in tour.motions],
        "files": written,
    }
