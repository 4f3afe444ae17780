"""The commands of the core: what can be said to them.

A function returns the exit code, or None for 0. To show help or refuse an option,
nothing is imported here that takes long: that is done when a command runs.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from tominpmp.cli.option_fields import GeneralOptions, given, supported
from tominpmp.cli.option_fields import robots as robot_names
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
from tominpmp.cli.terminal import NO_PLAN, PLANNED, say

ROBOT = "Name of a robot (tominpmp robots lists them) or path of a URDF file"


def _completed(text: str) -> Parameter:
    """An argument that is completed by names of robots and files that hold one."""
    return Parameter(help=text, **supported(completer=robot_names))


RobotName = Annotated[str, _completed(f"{ROBOT}.")]
PlannedRobot = Annotated[
    str,
    _completed(
        f"{ROBOT}; or a scenario file (.toml), which holds robot, start, goal, scene "
        "and options."
    ),
]
JudgedProblem = Annotated[
    str,
    _completed(
        "Scenario file (.toml); or a robot, with --scene and --request, or with "
        "--start and a goal."
    ),
]
RecordedMotion = Annotated[
    Path,
    Parameter(
        help="File with a motion: .csv or .npz, as tominpmp plan writes it, or a ROS 2 "
        "message or bag with a JointTrajectory (.yaml, .json, .mcap)."
    ),
]


def plan(
    robot: PlannedRobot,
    /,
    *,
    problem: ProblemOptions = ProblemOptions(),
    limits: LimitOptions = LimitOptions(),
    options: PlannerOptions = PlannerOptions(),
    args: PlanOptions = PlanOptions(),
) -> int:
    """Plan the fastest motion from a start to a goal and write it to a file.

    The motion keeps the limits of positions, velocities and torques of the robot
    and stays clear of the obstacles. It begins and ends at rest unless a velocity
    is given. Lists of numbers may be separated by spaces or commas. Robot, start,
    goal and obstacles may also come from a scenario file (.toml), or start, goal
    and obstacles from files of MoveIt (--scene, --request).

    Exit codes:
        0    a motion was planned, and its file holds it
        1    no motion was found, or the file, as it is read, does not
             solve the problem
        2    bad input
        130  interrupted (Ctrl-C); a motion that was found by then is written
        143  terminated (SIGTERM); likewise
    """
    from tominpmp.cli.plan import run_plan

    return run_plan(
        ProblemArguments(robot, problem, given(limits)), given(options), args
    )


def verify(
    scenario: JudgedProblem,
    motion: RecordedMotion,
    /,
    *,
    changes: ProblemOptions = ProblemOptions(),
    limits: LimitOptions = LimitOptions(),
    tolerances: ToleranceOptions = ToleranceOptions(),
    args: VerifyOptions = VerifyOptions(),
) -> int:
    """Judge a motion: does it reach the goal, keep all limits and stay clear?

    The motion may come from any planner; the problem is that of a scenario file,
    or of a robot and files of MoveIt, or of the options. Whatever the motion
    breaks is listed with joint or pair, time and amount.

    Exit codes:
        0    the motion solves the problem
        1    it does not
        2    bad input
    """
    from tominpmp.cli.problem import load_problem
    from tominpmp.cli.report import check_data, check_text, json_text
    from tominpmp.files.export_check import check_file

    arguments = ProblemArguments(scenario, changes, given(limits))
    problem, options = load_problem(arguments, given(tolerances))
    joined: Any = args.interpolation
    found = check_file(
        problem, motion, tolerances=options.tolerances, interpolation=joined
    )
    say(json_text(check_data(found)) if args.json else check_text(found))
    return PLANNED if found.ok else NO_PLAN


def play(motion: RecordedMotion, /, *, args: PlayOptions) -> None:
    """Show a motion in the browser, or write a page that plays it without network."""
    from tominpmp.cli.output_files import PAGE_ENDINGS, check_target
    from tominpmp.cli.problem import load_scene
    from tominpmp.files.export import load_motion
    from tominpmp.goals.joints import JointGoal
    from tominpmp.motion.joining import join
    from tominpmp.problem.problem import Problem
    from tominpmp.viz.playback import play

    check_target(args.output, "--output", PAGE_ENDINGS)
    samples = load_motion(motion)
    arm, scene = load_scene(args)
    found = join(samples, arm, motion).trajectory
    goal = JointGoal(found.q[-1], found.v[-1], wrap=False)
    problem = Problem(arm, found.q[0], goal, scene=scene, v_start=found.v[0])
    say(f"page  {Path(play(problem, found, path=args.output))}")


def info(
    robot: RobotName,
    /,
    *,
    changes: RobotOptions = RobotOptions(),
    args: ReportOptions = ReportOptions(),
) -> None:
    """Show the joints of a robot with their limits, its frames and group states."""
    from tominpmp.cli.problem import load_changed_robot
    from tominpmp.cli.report import json_text, robot_data, robot_text

    data = robot_data(load_changed_robot(robot, changes))
    say(json_text(data) if args.json else robot_text(data))


def robots(*, args: GeneralOptions = GeneralOptions()) -> None:
    """List the robots known by name: bundled ones, and those of example-robot-data.

    Arms come first, then what walks, flies or has many limbs.
    """
    from tominpmp.description.files import manipulators_first, robot_names

    say("\n".join(manipulators_first(robot_names())))
