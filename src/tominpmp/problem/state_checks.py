"""Checks of starts and goals that need no planning."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from tominpmp.arrays import Array, BoolArray
from tominpmp.collision.checker import enclosure
from tominpmp.collision.query import ROUNDING
from tominpmp.constraints.base import USABLE
from tominpmp.constraints.contradiction import contradiction
from tominpmp.description.inertials import singular_directions
from tominpmp.description.joint_table import example_values
from tominpmp.dynamics import RobotDynamics
from tominpmp.exceptions import ProblemError
from tominpmp.goals.base import Goal
from tominpmp.goals.sets import restricted
from tominpmp.kinematics import RobotKinematics, units_of
from tominpmp.motion_limits import EFFORT, joint_kinds
from tominpmp.robot.robot import Robot
from tominpmp.scene.scene import Scene

if TYPE_CHECKING:
    from tominpmp.problem.problem import Problem
    from tominpmp.problem.segments import Segment

# The field of a problem that holds the start or the goal.
FIELDS = {"start": "q_start", "goal": "goal"}
# Largest excess of a start or goal over a limit that is moved onto the limit (positions
# in rad or m, velocities in rad/s or m/s), as encoders and files round; for narrow
# limits the largest share of the range between them.
SNAP, SNAP_SHARE = 1e-4, 1e-2
# Angles that exceed a limit and this size get a hint: they are probably in degrees.
LARGE_ANGLE, IN_RADIANS = 2.0 * np.pi, "; angles are in radians, not degrees"


def check_start(problem: Problem, before: Segment | None, clear: bool) -> None:
    """Check that the arm may begin a problem, or a segment, in its state at the start.

    Args:
        problem: The problem.
        before: The segment before, whose end is the start; None for the first one.
        clear: Whether collisions at the start are ruled out already.

    Raises:
        ProblemError: If the state is in collision, or exceeds a limit.
    """
    robot, q = problem.robot, problem.q_start
    if not clear:
        _check_clear(problem, q, "start", None if before else 0.0)
    _check_mass(problem, q, "start")
    passing = before is not None and not before.stop
    _check_state(problem, q, problem.v_start, "start", passing=passing)
    limits = problem.motion_limits
    if limits is None or not limits.continuous:
        return
    most = limits.by_joint("acceleration", robot.joint_names)
    # The start may be a state of a planned motion, which may exceed limits slightly.
    for i in np.flatnonzero(np.abs(problem.a_start) > (1.0 + USABLE) * most).tolist():
        unit = f"{units_of(robot)[i]}/s^2"
        raise ProblemError(
            f"a_start: joint {robot.joint_names[i]!r} is {problem.a_start[i]:.10g} "
            f"{unit}, outside its acceleration limits [{-most[i]:.10g}, "
            f"{most[i]:.10g}] {unit}",
            "a_start",
        )


def check_goal(problem: Problem, goal: Goal, rests: bool) -> tuple[Goal, list[str]]:
    """Check a goal, which was validated against the robot.

    Args:
        problem: The problem.
        goal: The goal.
        rests: Whether the arm comes to rest at the goal.

    Returns:
        The goal, moved onto limits that it exceeds by rounding and without
        alternatives that fail a check, and warnings.

    Raises:
        ProblemError: If the goal fails a check, or all of its alternatives do.
    """
    if goal.alternatives[0] is not goal:
        return _check_any(problem, goal, rests)
    robot = problem.robot
    if goal.configuration is not None:
        v = goal.final_velocity(robot.n)
        q, of_q = onto_limits(robot, "position", goal.configuration, "goal.q")
        v, of_v = onto_limits(robot, "velocity", v, "goal.v")
        _check_clear(problem, q, "goal", None)
        _check_mass(problem, q, "goal")
        if rests and not np.any(v) and (fault := unheld(robot, q)):
            raise ProblemError(f"goal: {fault}", "goal")
        _check_state(problem, q, v, "goal")
        return goal.with_state(q, v) if of_q or of_v else goal, of_q + of_v
    messages = []
    for item in goal.members:
        q, name = item.positions(robot), "goal.q with its tolerance"
        messages += onto_limits(robot, "position", q, name)[1]
        _check_reach(problem, item)
        _check_link(problem, item)
    lower, upper = goal.joint_ranges(robot)
    for i in np.flatnonzero(lower > upper + ROUNDING).tolist():
        joint = robot.joint_names[i]
        said = f"{lower[i]:.6g} at least and {upper[i]:.6g} at most [rad or m]"
        raise ProblemError(f"goal: joint {joint!r} is to be {said}", "goal")
    return goal, messages


def _check_any(problem: Problem, goal: Goal, rests: bool) -> tuple[Goal, list[str]]:
    """Drop alternatives that fail a check, if at least one alternative passes.

    Each dropped alternative gets a warning, except equivalent joint angles: they
    differ from the caller's goal by whole turns only.

    Raises:
        ProblemError: If no alternative passes.
    """
    goals = goal.choices
    valid, messages = list[Goal](), list[str]()
    faults = dict[int, ProblemError]()
    for number, alternative in enumerate(goals, 1):
        try:
            checked, snapped = check_goal(problem, alternative, rests)
        except ProblemError as error:
            faults[number] = error
        else:
            valid.append(checked)
            messages += snapped
    if goal.turning:
        if not valid:
            raise faults[1]
        return restricted(goal, valid), list(dict.fromkeys(messages))
    faulty = [f"goal {k} of {len(goals)}: {fault}" for k, fault in faults.items()]
    if not valid:
        raise ProblemError("; ".join(faulty), "goal")
    messages += [f"{text}; it is left out" for text in faulty]
    return restricted(goal, valid), messages


def _check_clear(problem: Problem, q: Array, which: str, time: float | None) -> None:
    """Check that the configuration at the "start" or the "goal" is collision-free.

    Args:
        problem: The problem.
        q: The configuration, shape (n,).
        which: "start" or "goal".
        time: Time at which the arm is there [s]; None if it is not known yet:
            moving obstacles may be elsewhere then.

    Raises:
        ProblemError: If it is in collision, naming the deepest collision pair.
    """
    checker = problem.checker
    if checker.hulls_clear(q):
        return
    # The checker decomposes meshes into convex pieces for the margins of the pairs.
    known = time is not None or not checker.moving
    if known and checker.is_free(q, problem.margins, time or 0.0):
        return
    contact = checker.closest(q, problem.margins, time)
    if contact is None or contact.distance >= contact.margin - ROUNDING:
        return
    depth, advice = f"overlap by {-contact.distance:.4g} m", ""
    if contact.distance >= 0.0:
        apart = f"are {contact.distance:.4g} m apart"
        depth = f"{apart}, less than the margin {contact.margin:.4g} m"
    elif contact.own:
        advice = _advice_on_links(problem, q)
    raise ProblemError(
        f"{which} in collision: {contact.pair} {depth} at q = "
        f"{np.round(q, 4).tolist()}{advice}",
        FIELDS[which],
    )


def _advice_on_links(problem: Problem, q: Array) -> str:
    """Advice on an overlap of two links that the robot description may allow."""
    meshes = replace(problem.checker, scene=Scene(), geometry="mesh")
    cause = " their meshes overlap, too;"
    if meshes.is_free(q):
        cause = " their meshes do not, only the convex pieces that stand for them;"
    return (
        f":{cause} links that may touch belong among the disable_collisions of an "
        "SRDF, and self_collision=False lets all of them touch"
    )


def _check_state(
    problem: Problem, q: Array, v: Array, which: str, *, passing: bool = False
) -> None:
    """Check that constraints hold at a state, and that no joint leaves its range.

    A joint that moves at a position limit is outside its range before or after: at
    a goal neither is allowed, at a start it may come from outside.

    Args:
        problem: The problem.
        q: Positions, shape (n,).
        v: Velocities, shape (n,).
        which: "start" or "goal".
        passing: Whether the arm passes the configuration at an unknown velocity:
            then only constraints on the configuration are checked.

    Raises:
        ProblemError: If a constraint is violated by more than rounding, or, at a
            start, by more than a motion may violate it between two rows.
    """
    robot = problem.robot
    limits = robot.limits
    outward = np.where(q >= limits.position_upper, v, 0.0)
    outward -= np.where(q <= limits.position_lower, v, 0.0)
    wrong = outward if which == "start" else np.abs(outward)
    # A slower joint stops within rounding of its limit.
    for i in np.flatnonzero(wrong > math.sqrt(SNAP)).tolist():
        unit = units_of(robot)[i]
        way = "leaves" if outward[i] > 0.0 else "enters"
        raise ProblemError(
            f"{which}: joint {robot.joint_names[i]!r} {way} its range there: "
            f"it has {v[i]:.4g} {unit}/s at its limit of {q[i]:.4g} {unit}",
            FIELDS[which],
        )
    for item in problem.ready_constraints:
        begin, end = item.during or (0.0, math.inf)
        # The arrival time at a goal is not known yet.
        holds = begin <= 0.0 if which == "start" else math.isinf(end)
        if not holds or (passing and item.order > 0):
            continue
        # A state of a planned motion may exceed it between two rows, by a share of
        # its scale; a slack counts in units of the scale, and at least of 1.
        slack = USABLE * min(item.scale, 1.0) if which == "start" else ROUNDING
        if lack := item.lack(q, v, slack):
            why = contradiction(item, problem.ready_constraints, robot, q)
            raise ProblemError(f"{which}: {lack}{why}", FIELDS[which])


def _check_mass(problem: Problem, q: Array, which: str) -> None:
    """Check that the mass matrix is regular, so that accelerations are bounded.

    Args:
        problem: The problem.
        q: The configuration, shape (n,).
        which: "start" or "goal".

    Raises:
        ProblemError: Naming the joints that can move without any inertia.
    """
    robot = problem.robot
    if robot.kinematic:
        return
    mass = RobotDynamics(robot).mass(np.asarray(q)[None])[0]
    light = np.flatnonzero(singular_directions(mass)).tolist()
    if light:
        joints = [robot.joint_names[i] for i in light]
        raise ProblemError(
            f"{which}: {' and '.join(joints)} can move without any inertia there, "
            "so that any torque would accelerate them without bound: give "
            f"armature={example_values(joints)} [kg m^2 or kg], or lock one",
            FIELDS[which],
        )


def _check_link(problem: Problem, goal: Goal) -> None:
    """Check that the link at the goal's frame has an orientation without collision.

    Raises:
        ProblemError: If the link overlaps an obstacle in every orientation.
    """
    ball, frame = goal.ball, goal.frame_name
    if ball is None or frame is None or not len(problem.checker.scene):
        return
    found = enclosure(problem.checker, frame, ball.centre, ball.radius)
    if found is not None:
        raise ProblemError(
            f"goal: {np.round(ball.centre, 4).tolist()} is {found.lack:.4g} m deep "
            f"in obstacle {found.obstacle!r}, and link {found.link!r} with frame "
            f"{frame!r} there overlaps it in every orientation",
            "goal",
        )


def _check_reach(problem: Problem, goal: Goal) -> None:
    """Check that the goal's frame can come as far, and be as fast, as it is to be.

    Raises:
        ProblemError: If the goal is out of reach, or its velocity beyond a limit.
    """
    target, frame = goal.nearest_point(), goal.frame_name
    given = getattr(goal, "v", None)
    v = 0.0 if given is None else float(np.linalg.norm(given))
    for limited, top in filter(None, (c.top_speed for c in problem.ready_constraints)):
        if limited == frame and v > top * (1.0 + ROUNDING):
            raise ProblemError(
                f"goal: the speed of frame {frame} is {v:.4g} m/s, {v - top:.2g} "
                f"m/s more than its limit {top:.4g} m/s",
                "goal",
            )
    if target is None or frame is None:
        return
    reach = RobotKinematics(problem.robot).reach(frame)
    distance = math.hypot(*target)  # does not overflow
    if distance > reach * (1.0 + 1e-9):
        raise ProblemError(
            f"goal: {np.round(target, 4).tolist()} is {distance:.4g} m from the "
            f"base, and frame {frame!r} reaches {reach:.4g} m at most: "
            f"outside reach by {distance - reach:.4g} m",
            "goal",
        )


def holding(robot: Robot, q: Array) -> tuple[Array, BoolArray]:
    """Torques that hold an arm at rest, and whether each motor has them.

    Args:
        robot: The robot.
        q: Configurations, shape (m, n).

    Returns:
        Shape (m, n) each.
    """
    limits, rest = robot.limits, np.zeros_like(q)
    tau = rest if robot.kinematic else RobotDynamics(robot).inverse(q, rest, rest)
    low, high = limits.effort_lower, limits.effort_upper
    slack = 1e-9 * np.maximum(1.0, np.maximum(np.abs(low), np.abs(high)))
    return tau, (low - slack <= tau) & (tau <= high + slack) | robot.kinematic


def unheld(robot: Robot, q: Array) -> str:
    """Clause on the first motor that cannot hold the arm at rest at q; may be empty."""
    tau, held = holding(robot, q[None])
    for i in np.flatnonzero(~held[0]).tolist():
        low, high = robot.limits.effort_lower[i], robot.limits.effort_upper[i]
        dry = " (its dry friction is not counted on)" if robot.friction[i] else ""
        return (
            f"joint {robot.joint_names[i]!r} cannot hold the arm against gravity "
            f"there: {tau[0, i]:.4g} {units_of(robot, EFFORT)[i]} needed, "
            f"[{low:.4g}, {high:.4g}] allowed{dry}"
        )
    return ""


def onto_limits(
    robot: Robot, quantity: str, values: Array, name: str
) -> tuple[Array, list[str]]:
    """Check joint values against limits, and move values just outside onto the limits.

    Args:
        robot: The robot.
        quantity: "position" or "velocity".
        values: Shape (n,); NaN for joints without a value.
        name: Name of the values in messages.

    Returns:
        The values within the limits, and a warning for each value that was moved.

    Raises:
        ProblemError: If a value is outside its limits by more than rounding.
    """
    limits, snapped = robot.limits, list[str]()
    lower, upper = limits.position_lower, limits.position_upper
    if quantity == "velocity":
        lower, upper = -limits.velocity, limits.velocity
    slack = np.minimum(SNAP, SNAP_SHARE * (upper - lower))
    clipped = np.clip(values, lower, upper)
    excess = np.abs(clipped - values)
    for i in np.flatnonzero(excess > 0.0).tolist():
        unit = units_of(robot, joint_kinds()[quantity])[i]
        beyond = (
            f"{name}: joint {robot.joint_names[i]!r} is {values[i]:.10g} {unit}, "
            f"outside its {quantity} limits [{lower[i]:.10g}, {upper[i]:.10g}] {unit}"
        )
        if excess[i] > slack[i]:
            degrees = unit == "rad" and np.any(np.abs(values) > LARGE_ANGLE)
            field = name.split(" ")[0]
            raise ProblemError(beyond + (IN_RADIANS if degrees else ""), field)
        snapped.append(f"{beyond}, by {excess[i]:.1e}, and was set to the limit")
    return np.asarray(clipped), snapped
