"""The command ``batch``: plan many scenarios, and keep the results."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tominpmp.cell.batch.folder import scenarios_in, summary
from tominpmp.cell.batch.outcome import Outcome
from tominpmp.cell.batch.plan_many import Progress, plan_many
from tominpmp.cell.options import BatchOptions
from tominpmp.cli.json_text import json_text
from tominpmp.cli.report import rows_text
from tominpmp.cli.signals import present
from tominpmp.cli.terminal import NO_PLAN, PLANNED, complain, say

# Problems without a motion that are named.
NAMED = 20


def run_batch(source: Path, options: Mapping[str, Any], args: BatchOptions) -> int:
    """Plan all scenarios, and report.

    Args:
        source: Folder, list or scenario.
        options: Options of all plans by name.
        args: Where, and what to report.

    Raises:
        TominpmpError: If anything given is wrong; a broken scenario among others is
            reported instead, and the others are planned.
    """
    begin = time.perf_counter()
    problems = scenarios_in(source)

    def tell(state: Progress) -> None:
        last: Outcome = state.last
        found = f"T = {last.T:.4f} s" if last.success else f"{last.status}, no motion"
        more = ", from a former run" if last.resumed else ""
        line = f"{state.done}/{state.total}  {last.name}: {found}{more}"
        say(line, err=True)

    given = dict(options)
    seed = given.pop("seed", 0)
    found = plan_many(
        problems,
        workers=args.workers,
        backend=args.backend,
        results=args.output,
        seed=0 if seed is None else seed,
        warm_start=args.warm_start,
        progress=None if args.quiet or args.json else tell,
        **given,
    )
    # Motions are in files; thousands of them need not be in memory, too.
    rows = []
    for outcome in found:
        rows.append(_light(outcome))
        present().check()
    data = summary(rows) | {"seconds": time.perf_counter() - begin}
    failed = [row for row in rows if not row.success]
    for row in failed[:NAMED] if not args.json else ():
        complain("no motion", f"{row.name}: {row.message}", "bold yellow")
    if args.json:
        say(json_text(data | {"outcomes": [_told(row) for row in rows]}))
    else:
        say(_text(data, args))
    return NO_PLAN if failed else PLANNED


def _light(outcome: Any) -> Any:
    from dataclasses import replace

    return replace(outcome, solution=None)


def _told(row: Any) -> dict[str, Any]:
    names = ("index", "name", "success", "status", "message", "gap", "verified")
    found = {name: getattr(row, name) for name in names}
    found["T"] = row.T if row.success else None
    found["file"] = None if row.path is None else str(row.path)
    return found | {"seconds": row.seconds, "resumed": row.resumed}


def _text(data: Mapping[str, Any], args: BatchOptions) -> str:
    rows = [
        ("motions", f"{data['found']} of {data['problems']}"),
        ("verified", str(data["verified"])),
        ("sum of T", f"{data['T']:.4f} s"),
        ("planning time", f"{data['planning_time']:.2f} s of all plans"),
        ("time", f"{data['seconds']:.2f} s"),
    ]
    if data["resumed"]:
        rows.append(("former run", f"{data['resumed']} results"))
    if args.output is not None:
        rows.append(("results", str(args.output)))
    return rows_text("The batch is done.", rows)
