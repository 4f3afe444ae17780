"""The commands ``batch`` and ``tour``: what can be said to them.

Only what is light is imported here, as the help is made of it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from tominpmp.cli.option_fields import given, options
from tominpmp.cli.options import (
    OUTPUT_FILE,
    PLANNING,
    QUIET,
    VERBOSE,
    PlannerOptions,
    ReportOptions,
)


@options("Output")
@dataclass(frozen=True, kw_only=True)
class BatchOptions(ReportOptions):
    """Where a batch is planned, and where its results go.

    Attributes:
        output (FOLDER): Keep the results there, an NPZ file each; what is there from a
            former run is not planned again. Default: results.
        workers (N): How many are planned at once. Default: as many as there are cores.
        backend (NAME): loky (processes), threading, dask, ray, or any other of joblib.
            Default: loky.
        warm_start: Let problems begin with the motions of their neighbours.
        quiet: No progress, only a report, warnings and errors.
    """

    output: Path = field(default=Path("results"), metadata=OUTPUT_FILE)
    workers: int | None = field(default=None, metadata=PLANNING)
    backend: str | None = field(default=None, metadata=PLANNING)
    warm_start: bool = field(default=False, metadata=PLANNING)
    quiet: bool = field(default=False, metadata=QUIET)


@options("Output")
@dataclass(frozen=True, kw_only=True)
class TourOptions(ReportOptions):
    """What of a tour to write and what to show.

    Attributes:
        output (FILE): Write the whole cycle there: .csv, .npz, or a ROS 2 message
            (.yaml, .json, or .mcap for a bag); replaced if it exists.
        dt (SECONDS): Time between the rows. Default: the nodes of the motions.
        plot (FILE): Draw a Gantt picture: .png, .pdf or .svg.
        html (FILE): Write a page that plays the cycle: .html.
        max_time (SECONDS): Time limit of the planning.
        verbose: Show the log too.
    """

    output: Path | None = field(default=None, metadata=OUTPUT_FILE)
    dt: float | None = None
    plot: Path | None = None
    html: Path | None = None
    max_time: float | None = field(default=None, metadata=PLANNING)
    verbose: bool = field(default=False, metadata=VERBOSE)


BatchSource = Annotated[
    Path,
    Parameter(
        help="Folder with scenario files (.toml), or a file with a list of them: "
        "problems = ['a.toml', 'cells/*.toml']."
    ),
]
TourScenario = Annotated[Path, Parameter(help="Scenario file (.toml) with stations.")]


def batch(
    source: BatchSource,
    /,
    *,
    planning: PlannerOptions = PlannerOptions(),
    args: BatchOptions = BatchOptions(),
) -> int:
    """Plan many scenarios, several at once, and keep the results in a folder.

    Each result is a file (.npz) with the problem, the motion, its time and what
    was found of it. A batch that was interrupted goes on where it was. A scenario
    that is broken is named, and the others are planned.

    Exit codes:
        0    all have a motion
        1    some have none: they are named
        2    bad input
        130  interrupted (Ctrl-C); results that were kept are taken by
             the next run
        143  terminated (SIGTERM); likewise
    """
    from tominpmp.cell.running import run_batch

    return run_batch(source, given(planning), args)


def tour(scenario: TourScenario, /, *, args: TourOptions = TourOptions()) -> int:
    """Plan the order of the stations of a scenario file, and the motions between them.

    The file has a list of [[stations]] in place of a goal. The cycle begins at the
    start and ends there, too, unless its table [tour] says otherwise; all motions
    are verified. The report tells when the arm is where, and what no order can
    beat.

    Exit codes:
        0    a tour was found
        1    none was found
        2    bad input
        130  interrupted (Ctrl-C)
        143  terminated (SIGTERM)
    """
    from tominpmp.cell.running import run_tour

    return run_tour(scenario, args)
