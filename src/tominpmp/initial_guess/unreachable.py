"""Goals that no configuration was found to reach, or to rest in: the likely reason."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tominpmp.arrays import Array
from tominpmp.constraints.path import PathConstraint
from tominpmp.exceptions import ProblemError
from tominpmp.goals.frames import PositionGoal
from tominpmp.initial_guess.constrained import constraints_of
from tominpmp.initial_guess.guess import KINEMATIC_STARTS
from tominpmp.initial_guess.inverse_kinematics import REACHED, GoalSearch, Target
from tominpmp.initial_guess.path import PLACES
from tominpmp.problem.problem import Problem
from tominpmp.problem.state_checks import unheld
from tominpmp.transcription.problem_functions import ProblemFunctions


def unreachable(
    system: ProblemFunctions,
    rng: np.random.Generator,
    beyond: Sequence[PathConstraint] = (),
    where: str = "",
) -> ProblemError:
    """Error for a goal that no configuration was found to reach.

    Its reason is, in this order, collision, gravity, a constraint, or the distance to
    the goal.

    Args:
        system: Functions of the problem, or of a segment from its start.
        rng: Random numbers.
        beyond: Constraints on positions that hold from the goal on.
        where: Prefix of the message: the segment.
    """
    target = Target(system, system.problem.goal, beyond=beyond)
    ik = target.configurations(2 * KINEMATIC_STARTS, rng)
    if reason := _why_unusable(target, ik) or _against_constraints(target, rng):
        return ProblemError(f"{where}goal: {reason}", "goal")
    frame = target.goal.frame_name
    verb = "reaches it" if frame is None else f"brings frame {frame!r} there"
    return ProblemError(
        f"{where}goal: no configuration within the position limits {verb}; the nearest "
        f"one found misses it by {target.miss(ik.nearest)}",
        "goal",
    )


def hindrance(problem: Problem) -> str:
    """Why no motion may reach the goal, in a clause; empty without a likely reason.

    It holds for the configurations that were found to reach the goals and the points of
    tool paths, which may not be all that there are.
    """
    q = problem.q_start
    for number, phase in enumerate(problem.phases, 1):
        where = f"on segment {number}, " if problem.segments else ""
        goals = phase.goal.alternatives
        if goals[1:]:
            each = [hindrance(phase._altered(goal=goal, q_start=q)) for goal in goals]
            return where + "; ".join(dict.fromkeys(each)) if all(each) else ""
        system = ProblemFunctions.of(phase._altered(q_start=q))
        target, end = Target(system, phase.goal), phase.goal.configuration
        reason = _lost_path(system)
        if end is None and not reason:
            ik = target.configurations(KINEMATIC_STARTS, np.random.default_rng(0))
            unusable = _why_unusable(target, ik)
            reason = unusable and f"goal: {unusable}"
        if reason:
            return where + reason
        if end is None:
            end, missing = target.solve(q)
            if missing > REACHED:
                return ""
        q = end
    return ""


def _why_unusable(target: Target, ik: GoalSearch) -> str:
    """Why no configuration found for a goal can be its end; empty if one can."""
    if not ik.free:
        return _collision(target.system, ik.blocked) if ik.blocked else ""
    faults = [unheld(target.system.problem.robot, q) for q in ik.free]
    if not (target.rests and all(faults)):
        return ""
    return (
        f"the arm cannot rest in any of the {len(faults)} configurations found to "
        f"reach it: at q = {np.round(ik.free[0], 4).tolist()}, {faults[0]}"
    )


def _lost_path(system: ProblemFunctions) -> str:
    """How far a frame can follow its path from the start, in a clause.

    Inverse kinematics leads it from point to point. Empty if it reaches the last point,
    or no frame has to follow a path.
    """
    problem, kinematics = system.problem, system.kinematics
    for item in constraints_of(system, 0):
        if item.guide is None:
            continue
        (frame, between), q = item.guide, problem.q_start
        end, last = problem.goal.configuration, problem.goal.nearest_point()
        if end is not None:
            last = np.array(kinematics.placement(end, frame).translation)
        if last is None or frame != (problem.goal.frame_name or frame):
            continue
        first = np.array(kinematics.placement(q, frame).translation)
        points = between(first, last, PLACES + 1)
        for k, point in enumerate(points[1:]):
            target = Target(system, PositionGoal(frame, point), keep_clear=True)
            q_next, missing = target.solve(q)
            if missing > REACHED:
                alone, missing = replace(target, keep_clear=False).solve(q)
                why = "no configuration was found within the position limits"
                contact = problem.checker.closest(alone, problem.margins)
                if missing <= REACHED and contact is not None:
                    why = f"{contact.pair} collide"
                at = np.round(points[k], 4).tolist()
                return (
                    f"frame {frame!r} can be led along its path as far as {at} m, "
                    f"beyond which {why}; another path or start may help"
                )
            q = q_next
    return ""


def _collision(system: ProblemFunctions, blocked: Sequence[Array]) -> str:
    """The collision of configurations that reach a goal, as a sentence.

    It names the deepest contact of the configuration whose overlap is smallest.
    """
    problem = system.problem
    contacts = [(problem.checker.closest(q, problem.margins, None), q) for q in blocked]
    contact, q = max(
        ((contact, q) for contact, q in contacts if contact is not None),
        key=lambda pair: pair[0].distance - pair[0].margin,
    )
    return (
        f"all {len(blocked)} configurations found to reach it are in collision: in the "
        f"one that overlaps least, {contact.pair} lack {contact.lack:.4g} m of "
        f"clearance, at q = {np.round(q, 4).tolist()}"
    )


def _against_constraints(target: Target, rng: np.random.Generator) -> str:
    """The constraint that configurations reaching a goal violate, as a sentence.

    It names the worst constraint of the configuration that violates constraints least.
    Empty if there are no constraints, or no configuration reaches the goal.
    """
    items = target.constraints
    if not items:
        return ""
    ik = replace(target, goal_only=True).configurations(2 * KINEMATIC_STARTS, rng)
    reached = [*ik.free, *ik.blocked]
    if not reached:
        return ""

    def sizes(q: Array) -> list[float]:
        return [np.abs(item.excess_at_rest(q[None])[0]).max() for item in items]

    q = min(reached, key=lambda q: max(sizes(q)))
    item, rest = items[int(np.argmax(sizes(q)))], np.zeros_like(q)
    # For loads this is the reason why they are not held.
    why = item.lack(q, rest, 0.0).removeprefix(f"the {item.name} ")
    return (
        f"no configuration was found that reaches it and keeps the {item.name}: in the "
        f"nearest one it {why or 'is beyond its limit'}, at q = "
        f"{np.round(q, 4).tolist()}"
    )
