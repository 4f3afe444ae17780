"""Options of the commands ``batch`` and ``tour``."""

from __future__ import annotations

from dataclasses import field
from pathlib import Path

from tominpmp.cli.option_fields import options
from tominpmp.cli.options import OUTPUT_FILE, PLANNING, QUIET, VERBOSE, ReportOptions


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
