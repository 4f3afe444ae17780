"""The command line without its commands: what ``tominpmp --help`` shows, at once.

The options of the commands are the fields of classes of the library, whose import takes
most of the time that showing the help would. So the commands are listed here by name;
a test compares what is shown with what :mod:`~tominpmp.cli.app` would.
"""

from __future__ import annotations

from importlib import metadata
from typing import Annotated

import typer

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

# The commands in their order, with what the list of them says.
COMMANDS = {
    "plan": "Plan the fastest motion to a goal and write it to a file.",
    "batch": "Plan many scenarios and keep the results in a folder.",
    "verify": "Judge a motion from a file, whoever planned it.",
    "replay": "Replay a motion in MuJoCo, or find the torque reserve that it needs.",
    "play": "Show a motion from a file in the browser.",
    "app": "Open a page in the browser where motions are planned while one drags.",
    "tour": "Plan a tour over stations, in the order that takes least time.",
    "info": "Show the joints, limits and frames of a robot.",
    "robots": "List the robots known by name.",
}
# Words after which nothing but the list of commands is asked for.
LIGHT: tuple[list[str], ...] = ([], ["-h"], ["--help"], ["--version"])


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"tominpmp {metadata.version('tominpmp')}")
        raise typer.Exit


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


def new_app() -> typer.Typer:
    """An application without commands."""
    app = typer.Typer(
        cls=Commands,
        subcommand_metavar="COMMAND [ARGS]...",
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
        context_settings={
            "help_option_names": ["-h", "--help"],
            "max_content_width": 100,
        },
    )
    app.callback(invoke_without_command=True, epilog=EXAMPLES)(tominpmp)
    return app


def front() -> typer.Typer:
    """An application with the names of the commands, to show its help."""
    app = new_app()
    for name, text in COMMANDS.items():
        app.command(name, short_help=text)(_nothing)
    return app


def _nothing() -> None:
    """What a command does that is only listed."""
