"""The commands, their help and their exit codes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from tominpmp.cli.completion import robots as complete_robot
from tominpmp.cli.front import COMMANDS, EXAMPLES, new_app
from tominpmp.cli.option_fields import command
from tominpmp.cli.options import (
    AppOptions,
    BatchOptions,
    LimitOptions,
    PlannerOptions,
    PlanOptions,
    PlayOptions,
    ProblemArguments,
    ProblemOptions,
    ReplayOptions,
    ReportOptions,
    RobotOptions,
    ToleranceOptions,
    TourOptions,
    VerifyOptions,
)

EXIT_CODES = """\b
Exit codes:
  0    a motion was planned, and its file holds it
  1    no motion was found, or the file, as it is read, does not solve the problem
  2    bad input
  130  interrupted (Ctrl-C); a motion that was found by then is written
  143  terminated (SIGTERM); likewise
"""

VERIFY_CODES = """\b
Exit codes:
  0    the motion solves the problem
  1    it does not
  2    bad input
"""

BATCH_CODES = """\b
Exit codes:
  0    all have a motion
  1    some have none: they are named
  2    bad input
  130  interrupted (Ctrl-C); results that were kept are taken by the next run
  143  terminated (SIGTERM); likewise
"""

TOUR_CODES = """\b
Exit codes:
  0    a tour was found
  1    none was found
  2    bad input
  130  interrupted (Ctrl-C)
  143  terminated (SIGTERM)
"""

app = new_app()


def _argument(metavar: str, text: str, complete: Any = None) -> Any:
    return typer.Argument(
        metavar=metavar, help=text, show_default=False, autocompletion=complete
    )


ROBOT = "Name of a robot (tominpmp robots lists them) or path of a URDF file"
FirstRobot = Annotated[str, _argument("[ROBOT]", f"{ROBOT}.", complete_robot)]
RobotName = Annotated[str, _argument("ROBOT", f"{ROBOT}.", complete_robot)]
PlannedRobot = Annotated[
    str,
    _argument(
        "ROBOT",
        f"{ROBOT}; or a scenario file (.toml), which holds robot, start, goal, scene "
        "and options.",
        complete_robot,
    ),
]
JudgedProblem = Annotated[
    str,
    _argument(
        "SCENARIO",
        "Scenario file (.toml); or a robot, with --scene and --request, or with "
        "--start and a goal.",
        complete_robot,
    ),
]
BatchSource = Annotated[
    Path,
    _argument(
        "SOURCE",
        "Folder with scenario files (.toml), or a file with a list of them: "
        "problems = ['a.toml', 'cells/*.toml'].",
    ),
]
TourScenario = Annotated[
    Path, _argument("SCENARIO", "Scenario file (.toml) with stations.")
]
RecordedMotion = Annotated[
    Path,
    _argument(
        "MOTION",
        "File with a motion: .csv or .npz, as tominpmp plan writes it, or a ROS 2 "
        "message or bag with a JointTrajectory (.yaml, .json, .mcap).",
    ),
]


@command(
    app,
    short_help=COMMANDS["plan"],
    epilog=f"{EXAMPLES}\n{EXIT_CODES}",
)
def plan(
    robot: PlannedRobot,
    problem: ProblemOptions,
    limits: LimitOptions,
    options: PlannerOptions,
    args: PlanOptions,
) -> int:
    """Plan the fastest motion from a start to a goal and write it to a file.

    The motion keeps the limits of positions, velocities and torques of the robot and
    stays clear of the obstacles. It begins and ends at rest unless a velocity is given.
    Lists of numbers may be separated by spaces or commas. Robot, start, goal and
    obstacles may also come from a scenario file (.toml), or start, goal and obstacles
    from files of MoveIt (--scene, --request).
    """
    from tominpmp.cli.plan import run_plan

    return run_plan(ProblemArguments(robot, problem, limits), options, args)


@command(
    app,
    short_help=COMMANDS["batch"],
    epilog=BATCH_CODES,
)
def batch(source: BatchSource, options: PlannerOptions, args: BatchOptions) -> int:
    """Plan many scenarios, several at once, and keep the results in a folder.

    Each result is a file (.npz) with the problem, the motion, its time and what was
    found of it. A batch that was interrupted goes on where it was. A scenario that is
    broken is named, and the others are planned.
    """
    from tominpmp.cli.batch import run_batch

    return run_batch(source, options, args)


@command(
    app,
    short_help=COMMANDS["verify"],
    epilog=VERIFY_CODES,
)
def verify(
    problem: JudgedProblem,
    motion: RecordedMotion,
    changes: ProblemOptions,
    limits: LimitOptions,
    tolerances: ToleranceOptions,
    args: VerifyOptions,
) -> int:
    """Judge a motion: does it reach the goal, keep all limits and stay clear?

    The motion may come from any planner; the problem is that of a scenario file, or of
    a robot and files of MoveIt, or of the options. Whatever the motion breaks is listed
    with joint or pair, time and amount.
    """
    from tominpmp.cli.verify import run_verify

    return run_verify(
        ProblemArguments(problem, changes, limits), motion, tolerances, args
    )


@command(app, short_help=COMMANDS["replay"], epilog=VERIFY_CODES)
def replay(
    problem: JudgedProblem,
    motion: Annotated[
        Path | None, _argument("MOTION", "File with the motion, as for verify.")
    ] = None,
    *,
    changes: ProblemOptions,
    limits: LimitOptions,
    args: ReplayOptions,
) -> int:
    """Replay a motion in MuJoCo: by its torques alone, and with a feedback.

    MuJoCo comes with the extra "mujoco". With --robustness, motions are planned with
    several torque reserves instead, and each is tried with random loads, friction,
    delays and noise.
    """
    from tominpmp.cli.replay import run_replay

    return run_replay(ProblemArguments(problem, changes, limits), motion, args)


@command(app, short_help=COMMANDS["play"])
def play(motion: RecordedMotion, args: PlayOptions) -> None:
    """Show a motion in the browser, or write a page that plays it without network."""
    from tominpmp.cli.play import run_play

    typer.echo(f"page  {run_play(motion, args)}")


@command(app, name="app", short_help=COMMANDS["app"])
def live(args: AppOptions, robot: FirstRobot = "panda") -> None:
    """Open a page on which a motion is planned while its goal is dragged.

    Start, goal, points on the way and obstacles have handles, limits have sliders; the
    page shows the duration, how near it is to what is possible, and what holds the
    motion back, and gives it out as a file and as lines of Python.
    """
    from tominpmp.cli.live import run_app

    run_app(robot, args)


@command(app, short_help=COMMANDS["tour"], epilog=TOUR_CODES)
def tour(scenario: TourScenario, args: TourOptions) -> int:
    """Plan the order of the stations of a scenario file, and the motions between them.

    The file has a list of [[stations]] in place of a goal. The cycle begins at the
    start and ends there, too, unless its table [tour] says otherwise; all motions are
    verified. The report tells when the arm is where, and what no order can beat.
    """
    from tominpmp.cli.tour import run_tour

    return run_tour(scenario, args)


@command(app, short_help=COMMANDS["info"])
def info(robot: RobotName, changes: RobotOptions, report: ReportOptions) -> None:
    """Show the joints of a robot with their limits, its frames and group states."""
    from tominpmp.cli.info import run_info

    run_info(robot, changes, report.json)


@command(app, short_help=COMMANDS["robots"])
def robots() -> None:
    """List the robots known by name: bundled ones, and those of example-robot-data.

    Arms come first, then what walks, flies or has many limbs.
    """
    from tominpmp.description.files import manipulators_first, robot_names

    typer.echo("\n".join(manipulators_first(robot_names())))


def main() -> None:
    """Run the command line and leave with its exit code."""
    app(prog_name="tominpmp")
