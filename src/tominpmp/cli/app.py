"""The commands, their help and their exit codes."""

from __future__ import annotations

from importlib import metadata
from pathlib import Path
from typing import Annotated, Any

import typer

from tominpmp.cli.option_fields import command
from tominpmp.cli.options import (
    LimitOptions,
    PlannerOptions,
    PlanOptions,
    PlayOptions,
    ProblemArguments,
    ProblemOptions,
    ReportOptions,
    RobotOptions,
    ToleranceOptions,
    VerifyOptions,
)
from tominpmp.cli.usage import Commands

# A line that begins with \b keeps a paragraph from being wrapped.
EXAMPLES = """\b
Examples:
  tominpmp info panda
  tominpmp plan planar3r --start 0.5 1.7 -1.7 --goal 2 -1 0.5
  tominpmp plan planar3r --start start --goal-position tip 4 1 0 \\
      --obstacle sphere:O:r=0.8:at=4,0,0 --html motion.html
  tominpmp plan panda --lock panda_finger_joint1=0.04 --start default \\
      --goal panda_joint1=90,panda_joint4=-60 --degrees -o motion.npz --dt 0.001
  tominpmp plan scenario.toml -o motion.yaml --dt 0.01
  tominpmp plan scenario.toml -o goal.yaml --control-period 0.004 \\
      --ros-message FollowJointTrajectory
  tominpmp verify scenario.toml motion.yaml
  tominpmp plan panda --scene scene.yaml --request request.yaml
"""

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

app = typer.Typer(
    cls=Commands,
    subcommand_metavar="COMMAND [ARGS]...",
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={
        "help_option_names": ["-h", "--help"],
        "max_content_width": 100,
    },
)


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"tominpmp {metadata.version('tominpmp')}")
        raise typer.Exit


@app.callback(invoke_without_command=True, epilog=EXAMPLES)
def tominpmp(
    context: typer.Context,
    version: Annotated[
        bool,
        typer.Option(
            "--version",
            help="Show the version and exit.",
            callback=_print_version,
            is_eager=True,
        ),
    ] = False,
) -> None:
    """Plan time-optimal motions of robot arms from their URDF."""
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


def _argument(metavar: str, text: str) -> Any:
    return typer.Argument(metavar=metavar, help=text, show_default=False)


ROBOT = "Name of a robot (tominpmp robots lists them) or path of a URDF file"
RobotName = Annotated[str, _argument("ROBOT", f"{ROBOT}.")]
PlannedRobot = Annotated[
    str,
    _argument(
        "ROBOT",
        f"{ROBOT}; or a scenario file (.toml), which holds robot, start, goal, scene "
        "and options.",
    ),
]
JudgedProblem = Annotated[
    str,
    _argument(
        "SCENARIO",
        "Scenario file (.toml); or a robot, with --scene and --request, or with "
        "--start and a goal.",
    ),
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
    short_help="Plan the fastest motion to a goal and write it to a file.",
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
    short_help="Judge a motion from a file, whoever planned it.",
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


@command(app, short_help="Show a motion from a file in the browser.")
def play(motion: RecordedMotion, args: PlayOptions) -> None:
    """Show a motion in the browser, or write a page that plays it without network."""
    from tominpmp.cli.play import run_play

    typer.echo(f"page  {run_play(motion, args)}")


@command(app, short_help="Show the joints, limits and frames of a robot.")
def info(robot: RobotName, changes: RobotOptions, report: ReportOptions) -> None:
    """Show the joints of a robot with their limits, its frames and group states."""
    from tominpmp.cli.info import run_info

    run_info(robot, changes, report.json)


@command(app, short_help="List the robots known by name.")
def robots() -> None:
    """List the robots known by name: bundled ones, and those of example-robot-data."""
    from tominpmp.description.files import robot_names

    typer.echo("\n".join(robot_names()))


def main() -> None:
    """Run the command line and leave with its exit code."""
    app(prog_name="tominpmp")
