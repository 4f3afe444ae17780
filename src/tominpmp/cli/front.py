r"""Plan time-optimal motions of robot arms from their URDF.

Options:
  --version             Show the version and exit.
  --install-completion  Install completion for the current shell.
  --show-completion     Show completion for the current shell.
  --help, -h            Show this message and exit.

Commands:
  plan    Plan the fastest motion to a goal and write it to a file.
  batch   Plan many scenarios and keep the results in a folder.
  verify  Judge a motion from a file, of any planner.
  replay  Replay a motion in MuJoCo, or find the torque reserve that it needs.
  play    Show a motion from a file in the browser.
  app     Open a page in the browser that plans motions while goals are dragged.
  tour    Plan a tour over stations, in the order that takes least time.
  info    Show the joints, limits and frames of a robot.
  robots  List the robots known by name.

Examples:
  tominpmp info panda
  tominpmp plan planar3r --start 0.5 1.7 -1.7 --goal 2 -1 0.5
  tominpmp plan planar3r --start start --goal-position tip 4 1 0 \
      --obstacle sphere:O:r=0.8:at=4,0,0 --html motion.html
  tominpmp plan panda --lock panda_finger_joint1=0.04 --start default \
      --goal panda_joint1=90,panda_joint4=-60 --degrees -o motion.npz --dt 0.001
  tominpmp plan scenario.toml -o motion.yaml --dt 0.01
  tominpmp plan scenario.toml -o goal.yaml --control-period 0.004 \
      --ros-message FollowJointTrajectory
  tominpmp verify scenario.toml motion.yaml
  tominpmp plan panda --scene scene.yaml --request request.yaml
"""

# The text above is the help of ``tominpmp`` without a command, and is written by hand:
# importing the parser of the commands would take most of the time. A command is
# imported when it is run or its help is shown.

from __future__ import annotations

from importlib.util import find_spec

# The function of each command; commands of an add-on need its package.
COMMANDS = {
    "plan": "tominpmp.cli.commands:plan",
    "batch": "tominpmp.cell.commands:batch",
    "verify": "tominpmp.cli.commands:verify",
    "replay": "tominpmp.physics.commands:replay",
    "play": "tominpmp.cli.commands:play",
    "app": "tominpmp.app.commands:app",
    "tour": "tominpmp.cell.commands:tour",
    "info": "tominpmp.cli.commands:info",
    "robots": "tominpmp.cli.commands:robots",
}
# The end of the help.
EXAMPLES = "Examples:" + (__doc__ or "").partition("Examples:")[2].rstrip()


def commands() -> dict[str, str]:
    """Functions of the commands whose package is installed, by their names."""
    return {
        name: path
        for name, path in COMMANDS.items()
        if find_spec(".".join(path.split(".")[:2])) is not None
    }


def front_page() -> str:
    """The help text, with the installed commands only."""
    missing = COMMANDS.keys() - commands().keys()
    lines = [
        line
        for line in (__doc__ or "").rstrip().splitlines()
        if not (line.startswith("  ") and line.split()[0] in missing)
    ]
    return "\n".join(("Usage: tominpmp [OPTIONS] COMMAND [ARGS]...\n", *lines))
