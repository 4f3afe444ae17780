"""The commands ``batch`` and ``tour``: arguments, options and help texts.

Only light modules are imported here, as each call of the help imports this module.
"""

from __future__ import annotations

from pathlib import Path

from tominpmp.cell.options import BatchOptions, TourOptions
from tominpmp.cli.option_fields import typed_values
from tominpmp.cli.options import PlannerOptions


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
