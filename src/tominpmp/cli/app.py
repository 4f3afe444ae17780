"""The commands."""

from __future__ import annotations

from importlib import metadata
from typing import Annotated

import typer

from tominpmp.cli import aims
from tominpmp.cli import arguments as a
from tominpmp.cli.request import MotionRequest, OutputRequest, RobotRequest
from tominpmp.cli.terminal import guarded
from tominpmp.cli.usage import Command, Commands

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

PLAN_HELP = (
    "Plan the fastest motion from a start to a goal and write it to a file.\n\n"
    "The motion keeps the limits of positions, velocities and torques of the robot and "
    "stays clear of the obstacles. It begins and ends at rest unless a velocity is "
    "given. Lists of numbers may be separated by spaces or commas. Robot, start, goal "
    "and obstacles may also come from a scenario file (.toml), or start, goal and "
    "obstacles from files of MoveIt (--scene, --request)."
)

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


@app.command(
    cls=Command,
    help=PLAN_HELP,
    short_help="Plan the fastest motion to a goal and write it to a file.",
    epilog=f"{EXAMPLES}\n{EXIT_CODES}",
)
def plan(
    robot: a.PlannedRobot,
    start: a.Start = None,
    goal: a.Goal = None,
    goal_position: a.GoalPosition = None,
    goal_pose: a.GoalPose = None,
    start_velocity: a.StartVelocity = None,
    goal_velocity: a.GoalVelocity = None,
    degrees: a.Degrees = False,
    request: a.MoveItRequest = None,
    scene: a.MoveItScene = None,
    obstacle: a.Obstacles = None,
    margin: a.Margin = None,
    package_dir: a.PackageDirs = None,
    srdf: a.Srdf = None,
    group: aims.Group = None,
    limits: aims.Limits = None,
    lock: a.Locks = None,
    gravity: a.Gravity = None,
    effort: a.Effort = None,
    velocity: a.Velocity = None,
    damping: a.Damping = None,
    armature: a.Armature = None,
    friction: a.Friction = None,
    joint_limits: a.JointLimitsFile = None,
    motion_limits: aims.MotionLimitsFile = None,
    method: a.Method = None,
    intervals: a.Intervals = None,
    smoothing: a.Smoothing = None,
    starts: a.Starts = None,
    seed: a.Seed = None,
    max_time: a.MaxTime = None,
    max_iterations: a.MaxIterations = None,
    control: aims.Control = None,
    refine: aims.Refine = None,
    processes: aims.Processes = None,
    objective: aims.Objective = None,
    slack: aims.Slack = None,
    control_period: aims.ControlPeriod = None,
    start_from: aims.StartFrom = None,
    lp_solver: a.LpSolver = None,
    output: a.MotionFile = None,
    no_output: a.NoOutput = False,
    dt: a.Dt = None,
    with_effort: aims.WithEffort = False,
    ros_message: aims.RosMessage = None,
    plot: a.Plot = None,
    html: a.Html = None,
    certificate: aims.CertificatePlot = None,
    save_scenario: a.SaveScenario = None,
    json: a.Json = False,
    quiet: a.Quiet = False,
    verbose: a.Verbose = False,
    debug: a.Debug = False,
) -> None:
    """Plan a motion; the help has a text of its own."""
    robot_request = RobotRequest(
        robot=robot,
        package_dirs=package_dir or (),
        srdf=srdf,
        group=group,
        limits=limits,
        locks=lock or (),
        gravity=gravity,
        effort=effort,
        velocity=velocity,
        damping=damping,
        armature=armature,
        friction=friction,
        joint_limits=joint_limits,
    )
    motion_request = MotionRequest(
        start=start,
        goal=goal,
        goal_position=goal_position,
        goal_pose=goal_pose,
        start_velocity=start_velocity,
        goal_velocity=goal_velocity,
        obstacles=obstacle or (),
        scene=scene,
        request=request,
        margin=margin,
        degrees=degrees,
        former=start_from,
        motion_limits=motion_limits,
    )
    options = {
        "method": method,
        "intervals": intervals,
        "smoothing": smoothing,
        "starts": starts,
        "seed": seed,
        "max_planning_time": max_time,
        "max_iterations": max_iterations,
        "control": control,
        "refine": refine,
        "processes": processes,
        "objective": objective,
        "slack": slack,
        "control_period": control_period,
        "lp_solver": lp_solver,
    }
    output_request = OutputRequest(
        motion=output,
        write=not no_output,
        dt=dt,
        with_effort=with_effort,
        message=ros_message,
        plot=plot,
        page=html,
        certificate=certificate,
        scenario=save_scenario,
        json=json,
        quiet=quiet,
        verbose=verbose,
    )
    with guarded(debug):
        from tominpmp.cli.planning import run_plan

        code = run_plan(robot_request, motion_request, options, output_request)
    raise typer.Exit(code)


@app.command(
    cls=Command,
    short_help="Judge a motion from a file, whoever planned it.",
    epilog=VERIFY_CODES,
)
def verify(
    problem: a.JudgedProblem,
    motion: a.RecordedMotion,
    request: a.MoveItRequest = None,
    scene: a.MoveItScene = None,
    margin: a.Margin = None,
    package_dir: a.PackageDirs = None,
    srdf: a.Srdf = None,
    group: aims.Group = None,
    limits: aims.Limits = None,
    lock: a.Locks = None,
    joint_limits: a.JointLimitsFile = None,
    interpolation: aims.InterpolationRule = None,
    json: a.Json = False,
    debug: a.Debug = False,
) -> None:
    """Judge a motion: does it reach the goal, keep all limits and stay clear?

    The motion may come from any planner; the problem is that of a scenario file, or of
    a robot and files of MoveIt. Whatever the motion breaks is listed with joint or
    pair, time and amount.
    """
    robot_request = RobotRequest(
        robot=problem,
        package_dirs=package_dir or (),
        srdf=srdf,
        group=group,
        limits=limits,
        locks=lock or (),
        joint_limits=joint_limits,
    )
    motion_request = MotionRequest(scene=scene, request=request, margin=margin)
    with guarded(debug):
        from tominpmp.cli.verifying import run_verify

        code = run_verify(robot_request, motion_request, motion, json, interpolation)
    raise typer.Exit(code)


@app.command(cls=Command, short_help="Show a motion from a file in the browser.")
def play(
    motion: a.RecordedMotion,
    robot: a.MovingRobot,
    scene: a.MoveItScene = None,
    obstacle: a.Obstacles = None,
    package_dir: a.PackageDirs = None,
    srdf: a.Srdf = None,
    group: aims.Group = None,
    limits: aims.Limits = None,
    lock: a.Locks = None,
    output: a.Page = None,
    debug: a.Debug = False,
) -> None:
    """Show a motion in the browser, or write a page that plays it without network."""
    request = RobotRequest(
        robot=robot,
        package_dirs=package_dir or (),
        srdf=srdf,
        group=group,
        limits=limits,
        locks=lock or (),
    )
    surroundings = MotionRequest(obstacles=obstacle or (), scene=scene)
    with guarded(debug):
        from tominpmp.cli.playing import run_play

        page = run_play(motion, request, surroundings, output)
        typer.echo(f"page  {page}")


@app.command(cls=Command, short_help="Show the joints, limits and frames of a robot.")
def info(
    robot: a.RobotName,
    package_dir: a.PackageDirs = None,
    srdf: a.Srdf = None,
    group: aims.Group = None,
    limits: aims.Limits = None,
    lock: a.Locks = None,
    gravity: a.Gravity = None,
    effort: a.Effort = None,
    velocity: a.Velocity = None,
    damping: a.Damping = None,
    armature: a.Armature = None,
    friction: a.Friction = None,
    joint_limits: a.JointLimitsFile = None,
    json: a.Json = False,
    debug: a.Debug = False,
) -> None:
    """Show the joints of a robot with their limits, its frames and group states."""
    request = RobotRequest(
        robot=robot,
        package_dirs=package_dir or (),
        srdf=srdf,
        group=group,
        limits=limits,
        locks=lock or (),
        gravity=gravity,
        effort=effort,
        velocity=velocity,
        damping=damping,
        armature=armature,
        friction=friction,
        joint_limits=joint_limits,
    )
    with guarded(debug):
        from tominpmp.cli.listing import run_info

        run_info(request, json)


@app.command(cls=Command, short_help="List the robots known by name.")
def robots(debug: a.Debug = False) -> None:
    """List the robots known by name: bundled ones, and those of example-robot-data."""
    with guarded(debug):
        from tominpmp.description.files import robot_names

        typer.echo("\n".join(robot_names()))


def main() -> None:
    """Run the command line and leave with its exit code."""
    app(prog_name="tominpmp")
