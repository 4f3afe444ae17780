"""Conclusion of a plan: the best candidate becomes a solution with a message."""

from __future__ import annotations

import contextlib
import time
from dataclasses import replace

import numpy as np

from tominpmp.bounds.result import LowerBound
from tominpmp.initial_guess.unreachable import hindrance
from tominpmp.kinematics import units_of
from tominpmp.motion.measures import SATURATED, acceleration_remark
from tominpmp.motion.trajectory import Trajectory
from tominpmp.motion_limits import EFFORT
from tominpmp.options import Options
from tominpmp.planner.automatic_options import SHOOTING
from tominpmp.planner.candidate import Candidate, best_of
from tominpmp.planner.plan_state import PlanState
from tominpmp.problem.joint_limits import effort_range
from tominpmp.problem.problem import Problem
from tominpmp.solution import Solution
from tominpmp.status import STOPPED, Status
from tominpmp.stopping import Stop
from tominpmp.verification.diagnosis import CUT_SHORT, explain
from tominpmp.verification.verification import verify

# Shape of the accelerations on an interval, by their degree.
ACCELERATIONS = ("constant", "linear", "quadratic", "cubic")
# The message names a joint as saturated if its effort is at the share SATURATED of its
# limit for the share MOSTLY of the motion, and dry friction takes as much of it.
MOSTLY = 0.5
# Sentence on motions of arms that stand at their goals already.
STANDS = "The start already satisfies the goal: nothing has to move."
# Shorter durations are printed with significant digits instead of decimals [s].
BRIEF_TIME = 0.01


def conclude(state: PlanState, status: Status | None) -> Solution:
    """Turn the best candidate into a solution.

    Args:
        state: The plan.
        status: How planning was stopped; None if the schedule is exhausted.
    """
    best = best_of(state.candidates)
    confirmed = best is not None and best.confirmed
    reason = "" if confirmed else state.impossible or _reason(state)
    ended = Status.INFEASIBLE if best is None else best.status
    if status in STOPPED:
        ended = status
    elif best is not None and best.refuted:
        ended = Status.UNVERIFIED
    message = _message(state, ended, best, reason)
    if not reason:
        message += _advice(state, ended, best)
    solution = Solution(
        state.problem,
        state.options,
        ended,
        message,
        feasible=confirmed,
        trajectory=None,
        history=tuple(state.history),
        planning_time=state.seconds,
    )
    if best is None:
        return solution
    return replace(
        solution,
        lower_bound=state.lower_bound(state.problem),
        trajectory=best.trajectory,
        initial=best.initial,
        violations=best.violations,
        verification=best.verification,
    )


def without_search(
    problem: Problem,
    options: Options,
    motion: Trajectory,
    message: str,
    reason: str,
    begin: float,
) -> Solution | None:
    """The solution of a motion that needs no search, as it attains a lower bound.

    Args:
        problem: The problem.
        options: Options of the plan.
        motion: The motion.
        message: Sentences on the motion, after the one of the status.
        reason: Why no motion is faster.
        begin: Beginning of the planning, by ``time.perf_counter`` [s].

    Returns:
        The solution; None if its replay breaks a limit.
    """
    replay = verify(problem, motion, options.tolerances)
    if not replay.ok:
        return None
    return Solution(
        problem,
        options,
        Status.CONVERGED,
        f"{Status.CONVERGED.value} {message}",
        True,
        motion,
        planning_time=time.perf_counter() - begin,
        verification=replay,
        lower_bound=LowerBound(motion.duration, reason),
    )


def with_remarks(solution: Solution, state: PlanState) -> Solution:
    """A solution with remarks on its motion in its message.

    The remarks say which joints end full turns from the given angles, that the grid was
    not refined although options ask for it, that the motion was planned without limits
    of accelerations, and which links touch although an SRDF excludes their collision.
    """
    if not solution.success or solution.trajectory is None:
        return solution
    options = solution.options
    remarks = [_turned(solution.problem, solution.trajectory)]
    if options.refine == "grid" and options.method in SHOOTING:
        remarks.append(f"Its grid was not refined: method {options.method!r} keeps it.")
    if STANDS not in solution.message:
        remarks.append(acceleration_remark(solution.problem, solution.trajectory))
    if solution.verification is not None:
        with state.saving(), contextlib.suppress(Stop):
            remarks += map(str, solution.verification.touches)
    new = [remark for remark in remarks if remark not in solution.message]
    return replace(solution, message=" ".join([solution.message, *new]).rstrip())


def _turned(problem: Problem, motion: Trajectory) -> str:
    """The joints that end full turns from the angles of their goals, as a sentence.

    Empty without turned joints.
    """
    angles = []
    for number, phase in enumerate(problem.alternative_of(motion).phases, 1):
        where = f" of segment {number}" if problem.segments else ""
        for joint, count in phase.goal.turns(phase.robot).items():
            size = "a turn" if abs(count) == 1 else f"{abs(count)} turns"
            side = "above" if count > 0 else "below"
            angles.append(f"{joint} {size} {side} the number given{where}")
    return f"As angles: {', '.join(angles)}." if angles else ""


def _advice(state: PlanState, status: Status, best: Candidate | None) -> str:
    """Advice if a method has found no motion, or time or iterations were used up.

    Methods whose torques are constant over an interval need short intervals if the arm
    leaves its path without feedback.
    """
    options, advice = state.options, ""
    if best is not None and not best.confirmed:
        if status is Status.ITERATION_LIMIT:
            reached = f"max_iterations = {options.max_iterations} was reached"
            advice = f" {reached}; a larger number allows more iterations a start."
        elif status is not Status.INTERRUPTED and options.method != "inverse":
            longest = float(np.max(np.diff(best.trajectory.t)))
            advice = (
                f" Method {options.method!r} keeps torques for up to {longest:.3g} s, "
                "in which errors may grow: more intervals make it shorter, and method "
                "'inverse', for robots with all motors, does not depend on it."
            )
    if status is Status.TIME_LIMIT:
        advice += f" {state.time_advice}."
        if best is not None:
            advice += _saturated(state.problem, best.trajectory)
    return advice


def _saturated(problem: Problem, motion: Trajectory) -> str:
    """The joint whose weak motor is saturated for most of a motion, as a sentence.

    Motors of time-optimal motions are often saturated. A saturated motor that spends
    most of its effort on dry friction, however, slows all other joints down.

    Empty without a saturated joint.
    """
    robot = problem.robot
    middle, half = effort_range(robot, problem.motion_limits)
    strength = half - np.abs(middle)
    share = robot.friction / np.maximum(strength, 1e-12)
    weak = (share >= MOSTLY) & (share <= 1.0)
    often = np.where(weak, np.mean(np.abs(motion.u) >= SATURATED * strength, axis=0), 0)
    most = int(np.argmax(often))
    if often[most] < MOSTLY:
        return ""
    name = robot.joint_names[most]
    unit = units_of(robot, EFFORT)[most]
    return (
        f" Joint {name} is at its effort limit of {strength[most]:.3g} {unit} for "
        f"{often[most]:.0%} of the motion, {robot.friction[most]:.3g} {unit} of which "
        "its dry friction takes: if it need not move, lock it (locked_joints)."
    )


def _scope(options: Options, motion: Trajectory) -> str:
    """The class of motions among which a motion is optimal if its grid is not refined.

    A finer grid, or controls of a higher degree, may allow a faster motion. Empty for a
    refined grid.
    """
    if options.refine is not None and options.method not in SHOOTING:
        return ""
    controls = "constant torques"
    if motion.inverse_dynamics is not None:
        controls = f"{ACCELERATIONS[motion.degree - 2]} accelerations"
    return f" among piecewise {controls} on {len(motion.t) - 1} intervals"


def _message(
    state: PlanState, status: Status, best: Candidate | None, reason: str
) -> str:
    """Message of a solution: its status, and its duration or its violations."""
    if best is not None and best.confirmed:
        T = best.trajectory.duration
        said = status.value
        if status is Status.CONVERGED:
            said = f"{said[:-1]}{_scope(state.options, best.trajectory)}."
        sentence = (
            f"{said} T = {T:.3g} s" if T < BRIEF_TIME else f"{said} T = {T:.4f} s"
        )
        gap = state.lower_bound(state.problem).comparison(T)
        if gap:
            sentence = f"{sentence}, {gap}"
        return f"{sentence}. {best.remark}".rstrip()
    if best is None or reason or not best.feasible:
        return state.impossible or _why_not_found(state, status, reason)
    if best.verification is None:
        return f"{status.value} There was no time to verify the motion that was found."
    ended = CUT_SHORT[status] if status in STOPPED else status.value[:-1]
    return f"{ended}: {best.verification.message}"


def _reason(state: PlanState) -> str:
    """Why a plan has found no motion, in a clause; empty without a known reason."""
    with contextlib.suppress(Stop), state.saving():
        return state.searches.impasse or hindrance(state.problem)
    return ""


def _why_not_found(state: PlanState, status: Status, reason: str) -> str:
    """Why a plan has found no motion, in sentences."""
    coarse = [item.candidate(status) for item in state.fallbacks[:1]]
    tried = state.start + 1, len(state.history)
    best = best_of([*coarse, *state.candidates])
    motion = None if best is None else best.trajectory
    try:
        return explain(state.problem, motion, status, tried, reason)
    except Stop:
        assert best is not None  # noqa: S101
        # There is no time to examine the motion: its program knows the violations.
        kinds = best.violations
        worst = max(kinds, key=kinds.__getitem__, default="limit")
        reason = f"the nearest motion found has its largest violation in the {worst}"
        return explain(state.problem, None, status, tried, reason)
