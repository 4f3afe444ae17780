"""The commands of the core: arguments, options and help texts.

A function returns the exit code, or None for 0. Modules that take long to import are
imported inside the functions, so that help and errors about options appear at once.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from tominpmp.cli.option_fields import GeneralOptions, sources, supported, typed_values
from tominpmp.cli.options import (
    PlannerOptions,
    PlanOptions,
    PlayOptions,
    ProblemOptions,
    ReportOptions,
    RobotOptions,
    ToleranceOptions,
    VerifyOptions,
)
from tominpmp.cli.terminal import NO_PLAN, PLANNED, say

# An argument with completion of names of robots and of files that hold a robot.
Source = Annotated[str, Parameter(**supported(completer=sources))]


def plan(
    robot: Source,
    /,
    *,
    problem: ProblemOptions = ProblemOptions(),
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
        0    a motion was planned, and the file as read back solves the problem
        1    no motion was found, or the file as read back does not solve
             the problem
        2    bad input
        74   the report cannot be written to standard output
        129  the terminal was closed (SIGHUP); a motion that was found by then is
             written
        130  interrupted (Ctrl-C); likewise
        143  terminated (SIGTERM); likewise

    Args:
        robot: Name of a robot (tominpmp robots lists them) or path of a URDF file; or a
            scenario file (.toml), which holds robot, start, goal, scene and options.
        problem: Options of the problem.
        options: Options of the planner.
        args: Options of the command.
    """
    from tominpmp.cli.plan import run_plan

    return run_plan(robot, problem, typed_values(options), args)


def verify(
    scenario: Source,
    motion: Path,
    /,
    *,
    changes: ProblemOptions = ProblemOptions(),
    tolerances: ToleranceOptions = ToleranceOptions(),
    args: VerifyOptions = VerifyOptions(),
) -> int:
    """Judge a motion: does it reach the goal, keep all limits and stay clear?

    The motion may come from any planner; the problem comes from a scenario file,
    from a robot and files of MoveIt, or from the options. Each violation is listed
    with its joint or pair, time and amount.

    Exit codes:
        0    the motion solves the problem
        1    the motion does not solve the problem
        2    bad input
        74   the report cannot be written to standard output
        129  the terminal was closed (SIGHUP)
        130  interrupted (Ctrl-C)
        143  terminated (SIGTERM)

    Args:
        scenario: Scenario file (.toml); or a robot, with --scene and --request, or with
            --start and a goal.
        motion: File with a motion: .csv or .npz, as tominpmp plan writes it, or a ROS 2
            message or bag with a JointTrajectory (.yaml, .json, .mcap).
        changes: Options of the problem.
        tolerances: Options of the judgement.
        args: Options of the command.
    """
    from tominpmp.cli.problem import load_problem
    from tominpmp.cli.report import check_data, check_text, json_text
    from tominpmp.files.export_check import check_file

    problem, options = load_problem(scenario, changes, typed_values(tolerances))
    allowed, how = options.tolerances, args.interpolation
    judgement = check_file(problem, motion, tolerances=allowed, interpolation=how)
    say(json_text(check_data(judgement)) if args.json else check_text(judgement))
    return PLANNED if judgement.ok else NO_PLAN


def play(motion: Path, /, *, args: PlayOptions) -> None:
    """Show a motion in the browser, or write a page that plays it without network.

    Args:
        motion: File with a motion: .csv or .npz, as tominpmp plan writes it, or a ROS 2
            message or bag with a JointTrajectory (.yaml, .json, .mcap).
        args: Options of the command.
    """
    from tominpmp.cli.output_files import PAGE_ENDINGS, check_target
    from tominpmp.cli.problem import load_scene
    from tominpmp.files.export import load_motion
    from tominpmp.goals.joints import JointRegionGoal
    from tominpmp.motion.joining import join
    from tominpmp.problem.problem import Problem
    from tominpmp.viz.playback import play

    check_target(args.output, "--output", PAGE_ENDINGS)
    samples = load_motion(motion)
    arm, scene = load_scene(args)
    trajectory = join(samples, arm, motion).trajectory
    # The ends are not checked, and the obstacles come last: a motion is shown even if
    # it begins or ends beyond limits, or in an obstacle.
    q = trajectory.q[0].clip(arm.limits.position_lower, arm.limits.position_upper)
    alone = Problem(arm, q, JointRegionGoal(q), self_collision=False)
    problem = alone.with_scene(scene)
    say(f"page  {Path(play(problem, trajectory, path=args.output))}")


def info(
    robot: Source,
    /,
    *,
    changes: RobotOptions = RobotOptions(),
    args: ReportOptions = ReportOptions(),
) -> None:
    """Show the joints of a robot with their limits, its frames and group states.

    Args:
        robot: Name of a robot (tominpmp robots lists them) or path of a URDF file; or a
            scenario file (.toml).
        changes: Options of the robot.
        args: Options of the command.
    """
    from tominpmp.cli.problem import load_changed_robot
    from tominpmp.cli.report import json_text, robot_data, robot_text

    data = robot_data(load_changed_robot(robot, changes))
    say(json_text(data) if args.json else robot_text(data))


def robots(*, args: GeneralOptions = GeneralOptions()) -> None:
    """List the robots known by name: bundled ones, and those of example-robot-data.

    Arms come first, then robots that walk or fly, and robots with many limbs.
    """
    from tominpmp.description.files import manipulators_first, robot_names

    say("\n".join(manipulators_first(robot_names())))
