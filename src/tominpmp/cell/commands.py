"""The commands ``batch`` and ``tour``: what can be said to them.

Only what is light is imported here, as the help is made of it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from tominpmp.cell.options import BatchOptions, TourOptions
from tominpmp.cli.option_fields import given
from tominpmp.cli.options import PlannerOptions

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
