"""Where a problem comes from: a scenario, files of MoveIt, or the command line."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

from tominpmp.cli.request import MotionRequest, RobotRequest, make_options
from tominpmp.exceptions import OptionsError, ProblemError
from tominpmp.options import Options
from tominpmp.problem import Problem
from tominpmp.robot import read_source
from tominpmp.scenario.motion_limits import load_motion_limits
from tominpmp.scenario.moveit import load_moveit, request_locks
from tominpmp.scenario.scenario import load_scenario
from tominpmp.scene import Scene

# What the command line may say beside a file that holds the whole problem.
KEPT = ("robot", "margin", "former", "motion_limits")


def load_problem(
    robot: RobotRequest, motion: MotionRequest, options: Mapping[str, Any]
) -> tuple[Problem, Options]:
    """Load or make the problem that was asked for, and the options to plan it with.

    Args:
        robot: The robot, or a scenario file.
        motion: Start, goal and obstacles.
        options: Options of the planner that go before those of a scenario; None where
            nothing is said.

    Raises:
        TominpmpError: If anything given is wrong or contradicts something else.
    """
    if robot.is_scenario:
        _refuse("a scenario file", robot, motion, keep=KEPT)
        scenario = load_scenario(robot.robot)
        problem = scenario.problem
        if motion.margin is not None:
            problem = replace(problem, margin=motion.margin)
        problem = _limited(problem, motion)
        given = {k: v for k, v in options.items() if v is not None}
        return problem, replace(scenario.options, **given)
    chosen = make_options(options)
    if motion.request is None:
        return motion.problem(robot.load()), chosen
    if motion.scene is None:
        raise ProblemError("--request needs a --scene that it belongs to", "scene")
    own = [f.name for f in fields(robot) if f.name != "group"]
    keep = ("scene", "request", *KEPT, *own)
    _refuse("--request", robot, motion, keep=keep)
    source = read_source(robot.robot, robot.package_dirs, robot.srdf)
    arm = robot.load(request_locks(source, motion.request))
    margin = 0.0 if motion.margin is None else motion.margin
    problem = load_moveit(arm, motion.scene, motion.request, margin=margin)
    return _limited(problem, motion), chosen


def _limited(problem: Problem, motion: MotionRequest) -> Problem:
    """The problem with the motion limits of the command line, if there are any."""
    if motion.motion_limits is None:
        return problem
    limits = load_motion_limits(motion.motion_limits, problem.robot)
    limits = limits.over(problem.motion_limits, problem.robot.joint_names)
    return replace(problem, motion_limits=limits)


def load_scene(robot: RobotRequest, motion: MotionRequest) -> tuple[Any, Scene]:
    """Load a robot and the obstacles around it, from a scenario or the command line.

    Raises:
        TominpmpError: If anything given is wrong or contradicts something else.
    """
    if robot.is_scenario:
        _refuse("a scenario file", robot, motion, keep=("robot",))
        problem = load_scenario(robot.robot).problem
        return problem.robot, problem.scene
    arm = robot.load()
    return arm, motion.obstacles_around(arm)


def _refuse(
    what: str, robot: RobotRequest, motion: MotionRequest, keep: tuple[str, ...]
) -> None:
    """Refuse options that say again, or otherwise, what a file says."""
    for request in (robot, motion):
        for field in fields(request):
            value = getattr(request, field.name)
            if field.name not in keep and value not in (None, (), [], False):
                option = {
                    "locks": "lock",
                    "obstacles": "obstacle",
                    "package_dirs": "package-dir",
                }.get(field.name, field.name.replace("_", "-"))
                raise OptionsError(
                    f"--{option} contradicts {what}, which holds the whole problem",
                    field.name,
                )
