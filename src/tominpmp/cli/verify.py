"""The command ``verify``: judge a motion from a file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np

from tominpmp.cli.options import ProblemArguments, VerifyOptions
from tominpmp.cli.problem import check_given, load_problem
from tominpmp.cli.report import json_text, plain, rows_text
from tominpmp.cli.terminal import NO_PLAN, PLANNED, say
from tominpmp.files.export_check import ExportCheck, check_file
from tominpmp.motion.samples import Interpolation

# Rules that are shown where a message breaks more.
SHOWN = 5


def run_verify(
    problem_args: ProblemArguments,
    path: Path,
    tolerances: Mapping[str, Any],
    how: VerifyOptions,
) -> int:
    """Judge a motion and report.

    Args:
        problem_args: What it is to solve.
        path: File that holds the motion.
        tolerances: What it may be off by, as options of a plan; those that are not
            given are the scenario's.
        how: How the points are joined, and how to report.

    Raises:
        TominpmpError: If a file is wrong or they do not belong together.
    """
    check_given(problem_args)
    problem, options = load_problem(problem_args, tolerances)
    found = check_file(
        problem,
        path,
        tolerances=options.tolerances,
        interpolation=cast("Interpolation | None", how.interpolation),
    )
    say(json_text(_data(found)) if how.json else _text(found))
    return PLANNED if found.ok else NO_PLAN


def _data(found: ExportCheck) -> dict[str, Any]:
    replay = found.verification
    assert replay is not None  # noqa: S101
    return {
        "motion": found.path,
        "T": found.duration,
        **plain(replay),
        "touches": replay.touches,
        "ok": found.ok,
        "joined": found.joined,
        "notes": found.notes,
        "refusals": [str(item) for item in found.refusals],
    }


def _text(found: ExportCheck) -> str:
    """Write the judgement for people."""
    replay = found.verification
    assert replay is not None  # noqa: S101
    verdict = "solves the problem" if replay.ok else "does not solve the problem"
    if replay.ok and not found.ok:
        verdict = "solves the problem, but a controller would refuse it"
    rows = [("duration", f"{found.duration:.4f} s"), ("joined", f"by {found.joined}")]
    rows += [("note", note) for note in found.notes]
    rows += [("refused", str(item)) for item in found.refusals[:SHOWN]]
    errors = f"{replay.goal_error:.1e} in position, {replay.speed_error:.1e} in speed"
    rows.append(("goal error", errors))
    if np.isfinite(replay.min_clearance):
        rows.append(("clearance", f"{replay.min_clearance:.4f} m at least"))
    rows.append(("replay", f"{replay.integrator}, {replay.seconds:.2f} s"))
    rows += [("violation", str(item)) for item in found.violations]
    rows += [("warning", str(item)) for item in replay.touches]
    return rows_text(f"The motion in {found.path} {verdict}.", rows)
