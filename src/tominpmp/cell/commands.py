"""The commands ``batch`` and ``tour``: arguments, options and help texts.

Only light modules are imported here, as each call of the help imports this module.
"""

from __future__ import annotations

from dataclasses import field
from pathlib import Path

from tominpmp.cli.option_fields import options, typed_values
from tominpmp.cli.options import (
    OUTPUT_FILE,
    PLANNING,
    QUIET,
    VERBOSE,
    PlannerOptions,
    ReportOptions,
)


@options("Output")
class BatchOptions(ReportOptions):
    """Where a batch is planned, and where its results go.

    Attributes:
        output (FOLDER): Folder for the results, an NPZ file each; problems whose
            results a former run has left there are not planned again.
        workers (N): Number of problems planned at once. Default: the number of cores.
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
class TourOptions(ReportOptions):
    """Files that a tour is written to, and its report.

    Attributes:
        output (FILE): Write the whole cycle there: .csv, .npz, or a ROS 2 message
            (.yaml, .json, or .mcap for a bag); replaced if it exists; or - for standard
            output.
        dt (SECONDS): Time between the rows. Default: the nodes of the motions.
        plot (FILE): Draw a Gantt chart: .png, .pdf or .svg.
        html (FILE): Write a page that plays the cycle: .html.
        max_time (SECONDS): Time limit of the planning.
        verbose: Show the log too.
    """

    output: str | None = field(default=None, metadata=OUTPUT_FILE)
    dt: float | None = None
    plot: Path | None = None
    html: Path | None = None
    max_time: float | None = field(default=None, metadata=PLANNING)
    verbose: bool = field(default=False, metadata=VERBOSE)


def batch(
    source: Path,
    /,
    *,
    planning: PlannerOptions = PlannerOptions(),
    args: BatchOptions = BatchOptions(),
) -> int:
    """Plan many scenarios, several at once, and keep the results in a folder.

    Each result is a file (.npz) with the problem, the motion, its duration, bounds
    and verdicts. An interrupted batch resumes where it stopped. A broken scenario is
    reported by its name, and the others are planned.

    Exit codes:
        0    every scenario has a motion
        1    some scenarios have no motion: they are named
        2    bad input
        74   the report cannot be written to standard output
        129  the terminal was closed (SIGHUP); the next run takes over the results
             that were written
        130  interrupted (Ctrl-C); likewise
        143  terminated (SIGTERM); likewise

    Args:
        source: Folder with scenario files (.toml), or a file with a list of them:
            problems = ['a.toml', 'cells/*.toml'].
        planning: Options of the planner.
        args: Options of the command.
    """
    from tominpmp.cell.running import run_batch

    return run_batch(source, typed_values(planning), args)


def tour(scenario: Path, /, *, args: TourOptions = TourOptions()) -> int:
    """Plan the order of the stations of a scenario file, and the motions between them.

    The file has a list of [[stations]] in place of a goal. The cycle begins at the
    start and ends there, too, unless its table [tour] says otherwise; all motions
    are verified. The report lists when the arm is at which station, and a lower
    bound of the cycle time over all orders.

    Exit codes:
        0    a tour was found, and its file passed the check
        1    no tour was found, or its file failed the check
        2    bad input
        74   the report cannot be written to standard output
        129  the terminal was closed (SIGHUP)
        130  interrupted (Ctrl-C)
        143  terminated (SIGTERM)

    Args:
        scenario: Scenario file (.toml) with stations.
        args: Options of the command.
    """
    from tominpmp.cell.running import run_tour

    return run_tour(scenario, args)
