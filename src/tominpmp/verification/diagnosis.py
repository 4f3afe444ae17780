"""Diagnosis of failed plans: an explanation in words why no motion was found.

A reason that the stages of the plan know comes first. Without one, the motion with the
smallest constraint violations is examined: its violations are the smallest known
relaxation of the problem. A search that ended by itself, for which the problem seems
infeasible, is distinguished from a search that was cut short.
"""

from __future__ import annotations

import numpy as np

from tominpmp.dynamics import RobotDynamics
from tominpmp.exceptions import counted
from tominpmp.motion.trajectory import Trajectory
from tominpmp.motion_limits import EFFORT
from tominpmp.options import Tolerances
from tominpmp.problem.joint_limits import effort_range
from tominpmp.problem.problem import Problem
from tominpmp.status import STOPPED, Status
from tominpmp.verification.limit_violations import LimitViolation
from tominpmp.verification.replay import TIME_STEP, planned, torque_pieces
from tominpmp.verification.stages import Stage, stages_of
from tominpmp.verification.verification import judge

# Descriptions of searches that were cut short.
CUT_SHORT = {
    Status.TIME_LIMIT: "The planning time was used up",
    Status.ITERATION_LIMIT: "The iteration limit was reached",
    Status.INTERRUPTED: "The planning was interrupted",
    Status.STALLED: "The iteration made no more progress",
    Status.NUMERICAL_FAILURE: "The linear programs could not be solved",
}
# Largest number of violations in a message.
MOST = 3
# What may help against a violation, by its kind; a wider limit against the others.
HELP = {
    "goal": "a goal that leaves more freedom, or more starts",
    "speed": "another velocity at the goal",
    "arrival": "another time of arrival",
    "clearance": "more clearance there, a smaller margin, or more starts",
    "position": "wider position limits",
    EFFORT.name: "stronger motors, or less load or friction",
}
# Tolerances beyond which a deviation of an infeasible motion is a violation.
STRICT = Tolerances(goal=1e-4, speed=1e-3, limits=1e-3, contact=1e-5)
# Largest number of instants at which an infeasible motion is examined.
MOST_INSTANTS = 1000


def explain(
    problem: Problem,
    motion: Trajectory | None,
    status: Status,
    tried: tuple[int, int],
    reason: str = "",
) -> str:
    """Explain why no motion was found.

    Args:
        problem: The problem.
        motion: The motion with the smallest violations; None without one.
        status: Status at the end of planning.
        tried: Numbers of starts and iterations.
        reason: Clause on what is in the way; empty if this is not known.

    Returns:
        One to three sentences: how the search ended, and the reason; or else the
        violations of the motion, and what may help against the largest one.
    """
    ended = CUT_SHORT.get(status, status.value.rstrip("."))
    starts, _ = tried
    if motion is None and not reason:
        if not starts and (many := len(problem.alternatives)) > 1:
            ended += f" before the first start to any of {many} combinations of goals"
        return f"{ended}: no motion was found." if status in CUT_SHORT else status.value
    if starts:
        ended += " after " + " and ".join(map(counted, tried, ("start", "iteration")))
    if reason or motion is None:
        return f"{ended}: {reason}."
    violations = _violations_of(problem, motion)
    if not violations:
        return f"{ended}; the best motion is within 0.1 % of the limits."
    stages = stages_of(problem, motion)
    clauses = [
        item.place + _clause(stages[(item.segment or 1) - 1], motion, item)
        for item in violations
    ]
    said = f"{ended}. In the nearest motion found, {'; '.join(clauses)}."
    if status in STOPPED and starts == 1:
        return said  # the iteration from the first start might still have succeeded
    kind = violations[0].kind
    return f"{said} What may help: {HELP.get(kind, f'a wider limit of the {kind}')}."


def _violations_of(problem: Problem, trajectory: Trajectory) -> list[LimitViolation]:
    """The largest violations of a planned motion, in units of their tolerances."""
    torque = torque_pieces(problem.robot, trajectory)
    time_step = max(TIME_STEP, trajectory.duration / MOST_INSTANTS)
    motion = planned(trajectory, time_step, torque)
    stages = stages_of(problem, trajectory)
    checkers = [stage.problem.checker for stage in stages]
    items = judge(stages, motion, torque, STRICT, checkers).violations
    units = {"goal": STRICT.goal, "speed": STRICT.speed, "clearance": STRICT.contact}
    worst = sorted(items, key=lambda x: -x.share / units.get(x.kind, STRICT.limits))
    return worst[:MOST]


def _clause(stage: Stage, motion: Trajectory, item: LimitViolation) -> str:
    """A violation in words; torques with the torque needed, and with dry friction."""
    robot, limits = stage.problem.robot, stage.problem.motion_limits
    curves = {} if limits is None else limits.effort_curves or {}
    if item.kind != EFFORT.name:
        return item.clause
    i = robot.joint_names.index(item.name)
    first, last = motion(np.array([stage.begin, stage.end]), 0)
    middle, half = (part[i] for part in effort_range(robot, limits))
    low, high = middle - half, middle + half
    friction, way, rest = robot.friction[i], np.sign(last - first), 0.0 * first
    # Breakaway torque: gravity and friction against the direction of travel.
    state = (row[None] for row in (first, rest, rest, way))
    needed = RobotDynamics(robot).inverse_along(*state)[0, i]
    if way[i] != 0.0 and friction != 0.0 and not low < needed < high:
        return (
            f"joint {item.name} cannot overcome its dry friction of "
            f"{friction:.3g} {item.unit}: {needed:.3g} {item.unit} needed to "
            f"move, [{low:.3g}, {high:.3g}] allowed"
        )
    if item.name in curves or low != -high:
        return item.clause  # the limit depends on the speed, or on the direction
    return (
        f"joint {item.name} would need {high + item.amount:.3g} {item.unit} at "
        f"{item.time:.2f} s, {high:.3g} allowed"
    )
