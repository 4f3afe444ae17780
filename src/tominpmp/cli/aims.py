"""Options for what a plan aims at, and for the motion that it begins with."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from tominpmp.cli.arguments import PLANNING, _option

StartFrom = Annotated[
    Path | None,
    _option(
        PLANNING,
        "--start-from",
        "Motion of a former plan to begin with, for a problem that is much like its "
        "own: .csv, .npz, .yaml or .json.",
        "FILE",
    ),
]
Objective = Annotated[
    str | None,
    _option(
        PLANNING,
        "--objective",
        "What to look for: time (the fastest motion) or feasible (the first motion "
        "that keeps all constraints). Default: time.",
        "NAME",
    ),
]
Slack = Annotated[
    float | None,
    _option(
        PLANNING,
        "--slack",
        "Share of the duration to give away for quiet torques, 0.01 say.",
        "SHARE",
    ),
]
