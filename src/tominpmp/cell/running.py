"""Runs the commands ``batch`` and ``tour``: read, plan, write and report."""

from __future__ import annotations

import glob
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from tominpmp.bounds.result import USELESS, LowerBound
from tominpmp.cell.batch.plan_many import Progress, plan_many
from tominpmp.cell.options import BatchOptions, TourOptions
from tominpmp.cell.tours.planning import plan_tour
from tominpmp.cell.tours.tour import Tour
from tominpmp.cell.tours.tour_file import load_tour
from tominpmp.cli.options import PlanOptions
from tominpmp.cli.output_files import STDOUT, motion_file, write_files
from tominpmp.cli.report import json_text, plain, rows_text
from tominpmp.cli.signals import present
from tominpmp.cli.terminal import (
    INTERRUPTED,
    NO_PLAN,
    PLANNED,
    complain,
    logged,
    say,
)
from tominpmp.description.fields import Field
from tominpmp.description.paths import checked_path
from tominpmp.exceptions import ScenarioError
from tominpmp.files.records import blaming
from tominpmp.files.scenario import SECTIONS, read_toml
from tominpmp.options import Options
from tominpmp.status import Status

ENDING = ".toml"
# Largest number of failed problems that a report names.
MOST_NAMED = 20
# Fields of a tour in a report in JSON, in addition to its motions and files.
OF_TOURS = (
    *("success", "status", "message", "cycle_time", "lower_bound", "gap", "verified"),
    *("planning_time", "visits"),
)
# Options of a tour that mean the same as those of a plan.
AS_PLANS = ("output", "dt", "plot", "html", "json")


def run_batch(source: Path, options: Mapping[str, Any], args: BatchOptions) -> int:
    """Plan all scenarios, and report.

    Args:
        source: Folder, list or scenario.
        options: Options of all plans by name.
        args: Options of the command: backend, folder of the results, report.

    Raises:
        TominpmpError: If an argument is wrong; a broken scenario among others is
            reported instead, and the others are planned.
    """
    begin, changes = time.perf_counter(), dict(options)
    outcomes = plan_many(
        _scenarios_in(source),
        workers=args.workers,
        backend=args.backend,
        results=args.output,
        seed=changes.pop("seed", None) or 0,
        warm_start=args.warm_start,
        progress=None if args.quiet or args.json else _show,
        **changes,
    )
    rows = []
    for outcome in outcomes:
        # Motions are in files; thousands of them would fill the memory.
        rows.append(replace(outcome, solution=None))
        present().check()
    planned = [row for row in rows if row.success]
    failed = [row for row in rows if not row.success]
    data = {
        "problems": len(rows),
        "found": len(planned),
        "verified": sum(row.verified for row in planned),
        "resumed": sum(row.resumed for row in rows),
        "T": sum(row.T for row in planned),
        "planning_time": sum(row.seconds for row in rows),
        "seconds": time.perf_counter() - begin,
    }
    if args.json:
        # Scripts read the path under the name "file", too, its only name at first.
        each = [plain(row) | {"file": row.path} for row in rows]
        say(json_text(data | {"outcomes": each}))
    else:
        for row in failed[:MOST_NAMED]:
            complain("no motion", f"{row.name}: {row.message}")
        say(_batch_text(data, args))
    return NO_PLAN if failed else PLANNED


def _show(state: Progress) -> None:
    """Print a line of progress for the outcome that came last."""
    last = state.last
    result = f"T = {last.T:.4f} s" if last.success else f"{last.status}, no motion"
    more = ", from a former run" if last.resumed else ""
    say(f"{state.done}/{state.total}  {last.name}: {result}{more}", err=True)


def _batch_text(data: Mapping[str, Any], args: BatchOptions) -> str:
    rows = [
        ("motions", f"{data['found']} of {data['problems']}"),
        ("verified", str(data["verified"])),
        ("sum of T", f"{data['T']:.4f} s"),
        ("planning time", f"{data['planning_time']:.2f} s of all plans"),
        ("time", f"{data['seconds']:.2f} s"),
    ]
    if data["resumed"]:
        rows.append(("former run", f"{data['resumed']} results"))
    return rows_text("The batch is done.", [*rows, ("results", str(args.output))])


def _scenarios_in(source: str | Path) -> list[tuple[str, Path]]:
    """Scenario files of a batch, each with a distinct name.

    Args:
        source: A folder, whose ``.toml`` files, also those of its subfolders, are the
            scenarios; a list of scenarios, which is a TOML file with
            ``problems = ["a.toml", "cells/*.toml"]`` and paths relative to its folder;
            or one scenario.

    Returns:
        Pairs of a name, which is the path without its ending, and the path, in the
        order of the list, or sorted for a folder.

    Raises:
        ScenarioError: If the file or folder does not exist or has no scenario, or a
            list has other keys.
    """
    path = checked_path(source, "source", ScenarioError)
    folder, scenarios = path.parent, list[Path]()
    if path.is_dir():
        folder, scenarios = path, sorted(path.rglob(f"*{ENDING}"))
    elif not path.exists():
        raise ScenarioError(f"there is no folder or file {path}", path)
    else:
        document = read_toml(path)
        content = document.table()
        if "problems" not in content and any(key in content for key in SECTIONS):
            return [(path.stem, path)]
        document.only("problems")
        for item in document.need("problems").items():
            files = _matching(folder, item.text())
            if not files:
                item.fail(f"is {item.text()!r}, which no file matches")
            scenarios += files
    if not scenarios:
        raise ScenarioError(f"{path} holds no scenario ({ENDING})", path)
    return [(_name(file, folder), file) for file in dict.fromkeys(scenarios)]


def _matching(folder: Path, pattern: str) -> list[Path]:
    """Files that match a pattern; a plain path is checked later, when it is read."""
    if not glob.has_magic(pattern):
        return [folder / pattern]
    try:
        names = glob.glob(pattern, root_dir=folder, recursive=True)
    except ValueError:  # a zero byte
        return []
    return sorted(path for name in names if (path := folder / name).is_file())


def _name(path: Path, folder: Path) -> str:
    inside = path.relative_to(folder) if path.is_relative_to(folder) else path
    return inside.with_suffix("").as_posix()


def run_tour(scenario: Path, args: TourOptions) -> int:
    """Plan a tour and report.

    Raises:
        TominpmpError: If an argument or the scenario is wrong.
    """
    shared = {name: getattr(args, name) for name in AS_PLANS}
    options = PlanOptions(no_output=args.output is None, **shared)
    motion = motion_file(options)
    changes = {} if args.max_time is None else {"max_planning_time": args.max_time}
    Options().changed(changes)
    arguments = load_tour(scenario)
    with logged(args.verbose), blaming(Field({}, scenario)):
        tour = plan_tour(**arguments | changes)
    signals = present()
    signals.writing()
    written, fault = dict[str, str](), ""
    try:
        # A tour with all stations at the start has no motion to write; it is reported.
        if tour.success and (args.output or args.plot or args.html):
            whole = tour._solution()
            written, judgement = write_files(whole, options, motion, drawn=tour)
            fault = "" if judgement is None or judgement.ok else judgement.message
    finally:
        # The report is useful even if the disk is full.
        files = list(written.values())
        if args.json:
            data = {name: getattr(tour, name) for name in OF_TOURS}
            motions = [motion.T for motion in tour.motions]
            say(json_text(data | {"motions": motions, "files": files}))
        else:
            say(_tour_text(tour, files), err=options.output == STDOUT)
    if fault:
        complain("error", fault)
    if tour.status is Status.INTERRUPTED or signals.number is not None:
        return INTERRUPTED
    return NO_PLAN if fault or not tour.success else PLANNED


def _tour_text(tour: Tour, files: list[str]) -> str:
    lines = [tour.message]
    if tour.success:
        bound = LowerBound(tour.lower_bound, tour.bound_reason)
        comparison = bound.comparison(tour.cycle_time) or USELESS
        lines += [tour.table(), f"cycle  {tour.cycle_time:.4f} s, {comparison}"]
    return "\n".join([*lines, *(f"file   {path}" for path in files)])
