"""Diagnosis of failed plans: an explanation in words why no motion was found.

The motion with the smallest constraint violations is examined: its violations are the
smallest known relaxation of the problem. A search that ended by itself ("infeasible")
is distinguished from a search that was cut short ("gave up").
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np

from tominpmp.arrays import Array
from tominpmp.dynamics import RobotDynamics
from tominpmp.kinematics import RobotKinematics
from tominpmp.motion.trajectory import Trajectory
from tominpmp.motion_limits import EFFORT, joint_kinds
from tominpmp.options import Tolerances
from tominpmp.problem.controls import effort_range
from tominpmp.problem.problem import Problem
from tominpmp.status import IterationRecord, Status
from tominpmp.verification.limit_violations import LimitViolation
from tominpmp.verification.polynomials import Pieces
from tominpmp.verification.replay import TIME_STEP, Replay, planned, torque_pieces
from tominpmp.verification.stages import Stage, stages_of
from tominpmp.verification.verification import judge

# Descriptions of searches that were cut short.
GAVE_UP = {
    Status.TIME_LIMIT: "Gave up when the planning time was used up",
    Status.ITERATION_LIMIT: "Gave up at the iteration limit",
    Status.INTERRUPTED: "Interrupted",
    Status.STALLED: "Gave up when the iteration made no more progress",
    Status.NUMERICAL_FAILURE: "Gave up as the linear programs could not be solved",
}
# Largest number of violations in a message.
MOST = 3
# Tolerances beyond which a deviation of an infeasible motion is a violation.
STRICT = Tolerances(goal=1e-4, speed=1e-3, limits=1e-3, contact=1e-5)
# Violation of a margin above which a pair counts as too close in the motion from an
# initial guess [m].
RESIDUE = 1e-5
# Largest number of instants at which an infeasible motion is examined.
MOST_INSTANTS = 1000


class Attempt(Protocol):
    """Result of the iteration from one initial guess."""

    @property
    def trajectory(self) -> Trajectory:
        """The best motion of the iteration."""

    @property
    def violations(self) -> Mapping[str, float]:
        """Largest constraint violation by kind of row."""

    @property
    def history(self) -> Sequence[IterationRecord]:
        """A record for each iteration."""


def explain(
    problem: Problem,
    outcomes: Sequence[Attempt],
    status: Status,
) -> str:
    """Explain why no motion was found.

    Args:
        problem: The problem.
        outcomes: Results from the initial guesses, all infeasible.
        status: Status at the end of planning.

    Returns:
        One or two sentences: how the search ended, the violated constraints, and the
        relaxation that the best motion needs.
    """
    if not outcomes:
        ended = GAVE_UP.get(status)
        return f"{ended}: no motion was found." if ended else status.value
    iterations = sum(len(outcome.history) for outcome in outcomes)
    effort = f"{_count(len(outcomes), 'start')} and {_count(iterations, 'iteration')}"
    best = min(outcomes, key=lambda item: max(item.violations.values(), default=0.0))
    violations = _violations_of(problem, best.trajectory)
    begin = f"{GAVE_UP.get(status, status.value.rstrip('.'))} after {effort}"
    if not violations:
        return f"{begin}; the best motion is within 0.1 % of the limits."
    everywhere = _everywhere(problem, outcomes, violations)
    stages = stages_of(problem, best.trajectory)
    clauses = [
        item.place
        + _clause(stages[(item.segment or 1) - 1], best.trajectory, item)
        + (" from every start tried" if item.name in everywhere else "")
        for item in violations
    ]
    needed = _joined([_relaxation(item) for item in violations])
    return (
        f"{begin}: {'; '.join(clauses)}. The nearest motion found would need {needed}."
    )


def _violations_of(problem: Problem, trajectory: Trajectory) -> list[LimitViolation]:
    """The largest violations of a planned motion, in units of their tolerances."""
    torque = torque_pieces(problem.robot, trajectory)
    motion, stages = _sampled(trajectory, torque), stages_of(problem, trajectory)
    checkers = [stage.problem.checker for stage in stages]
    items = judge(stages, motion, torque, STRICT, checkers).violations
    units = {"goal": STRICT.goal, "speed": STRICT.speed, "clearance": STRICT.contact}
    worst = sorted(items, key=lambda x: -x.share / units.get(x.kind, STRICT.limits))
    return worst[:MOST]


def _sampled(trajectory: Trajectory, torque: Pieces | None = None) -> Replay:
    """A planned motion, sampled at the instants that an explanation examines."""
    time_step = max(TIME_STEP, trajectory.duration / MOST_INSTANTS)
    return planned(trajectory, time_step, torque)


def _everywhere(
    problem: Problem,
    outcomes: Sequence[Attempt],
    violations: Sequence[LimitViolation],
) -> set[str]:
    """Names of the pairs that are too close in the motions from all initial guesses.

    Empty for a single guess, and for several segments, whose pairs may differ.
    """
    names = {item.name for item in violations if item.kind == "clearance"}
    if not names or len(outcomes) < 2 or problem.segments:
        return set()
    checker = problem.checker
    for outcome in outcomes:
        motion = _sampled(outcome.trajectory)
        clearance = checker.distances(motion.q, problem.margins + RESIDUE, motion.t)
        clearance -= problem.margins
        lack = -np.min(clearance, axis=0)
        pairs = zip(checker.pairs, lack.tolist(), strict=True)
        names &= {" and ".join(pair) for pair, amount in pairs if amount > RESIDUE}
    return names


def _clause(stage: Stage, trajectory: Trajectory, item: LimitViolation) -> str:
    """A violation in words, with the reason where it is known."""
    problem = stage.problem
    if item.kind == "goal":
        return _of_goal(problem, item)
    if item.kind == EFFORT.name:
        first, last = trajectory(np.array([stage.begin, stage.end])).q
        return _of_effort(problem, first, last, item)
    if item.kind == "clearance":
        return _of_clearance(problem, item)
    return item.clause


def _of_goal(problem: Problem, item: LimitViolation) -> str:
    """Clause on a goal: it is out of reach, or the motion stops short of it."""
    goal = problem.goal
    point = goal.nearest_point()
    if point is not None:
        reach = RobotKinematics(problem.robot).reach(goal.frame_name)
        if np.linalg.norm(point) > reach:
            beyond = float(np.linalg.norm(point)) - reach
            return f"goal outside reach by {beyond:.3g} m"
    return f"{item.name} comes no nearer to its goal than {item.amount:.3g} {item.unit}"


def _of_effort(
    problem: Problem, first: Array, last: Array, item: LimitViolation
) -> str:
    """Clause on a torque: the weight at the goal, dry friction, or a peak torque.

    Args:
        problem: The problem of the segment.
        first: Configuration at the start of the segment, shape (n,).
        last: Configuration at the end of the segment, shape (n,).
        item: The violation of the torque limit.
    """
    robot, goal = problem.robot, problem.goal
    i = robot.joint_names.index(item.name)
    end = last if goal.configuration is None else goal.configuration
    rest = np.zeros((2, robot.n))
    torques = RobotDynamics(robot).inverse(np.stack([first, end]), rest, rest)
    leaving, holding = torques[:, i].tolist()
    middle, half = (part[i] for part in effort_range(robot, problem.motion_limits))
    low, high = middle - half, middle + half
    if goal.fixes_velocity and not np.any(goal.final_velocity(robot.n)):
        excess = max(holding - high, low - holding)
        if excess > STRICT.limits * max(high - low, 1e-12):
            bound = high if holding > high else low
            return (
                f"joint {item.name} cannot hold its weight at the goal: "
                f"{abs(holding):.3g} {item.unit} needed, {abs(bound):.3g} allowed"
            )
    travel, friction = float(last[i] - first[i]), float(robot.friction[i])
    # Breakaway torque: gravity and friction against the direction of travel.
    needed = leaving + float(np.sign(travel)) * friction
    if travel != 0.0 and friction != 0.0 and not low < needed < high:
        return (
            f"joint {item.name} cannot overcome its dry friction of "
            f"{friction:.3g} {item.unit}: {needed:.3g} {item.unit} needed to "
            f"move, [{low:.3g}, {high:.3g}] allowed"
        )
    limits = problem.motion_limits
    if limits is not None and item.name in (limits.effort_curves or {}):
        return item.clause  # the limit depends on the speed
    bound = max(abs(low), abs(high))
    return (
        f"joint {item.name} would need {bound + item.amount:.3g} {item.unit} at "
        f"{item.time:.2f} s, {bound:.3g} allowed"
    )


def _of_clearance(problem: Problem, item: LimitViolation) -> str:
    """Clause on a pair that is too close, with its distance and its margin."""
    pairs = [" and ".join(pair) for pair in problem.checker.pairs]
    margin = float(problem.margins[pairs.index(item.name)])
    distance = margin - item.amount
    if distance < 0.0:
        return f"links {item.name} overlap by {_length(-distance)} at {item.time:.2f} s"
    return (
        f"links {item.name} are {_length(distance)} apart at {item.time:.2f} s, less "
        f"than the margin {_length(margin)}"
    )


def _relaxation(item: LimitViolation) -> str:
    """The relaxation of a constraint that would remove a violation, in words."""
    amount = f"{item.amount:.3g} {item.unit}"
    if item.kind == "goal":
        return f"a goal {amount} nearer"
    if item.kind == "speed":
        return f"{amount} of speed at the end"
    if item.kind == "arrival":
        side = "later" if item.name == "late" else "earlier"
        return f"an arrival {amount} {side}"
    if item.kind == "clearance":
        return f"{_length(item.amount)} more clearance between {item.name}"
    if item.kind not in joint_kinds():
        return f"{amount} more {item.kind}"
    return f"{amount} more {item.kind} of joint {item.name}"


def _length(value: float) -> str:
    """A length in words, in centimetres below one metre."""
    return f"{100.0 * value:.2g} cm" if abs(value) < 1.0 else f"{value:.3g} m"


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" + ("" if number == 1 else "s")


def _joined(parts: Sequence[str]) -> str:
    if len(parts) < 2:
        return "".join(parts)
    return f"{', '.join(parts[:-1])} and {parts[-1]}"
