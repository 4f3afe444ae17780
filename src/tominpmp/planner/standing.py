"""Starts that satisfy the goal already: nothing has to move, and no search is needed.

The motion takes no time and has a single node. If segments have a dwell, or an earliest
time of arrival, the arm stands still until these have passed.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from tominpmp.dynamics import RobotDynamics
from tominpmp.kinematics import RobotKinematics
from tominpmp.motion.trajectory import Trajectory
from tominpmp.options import Options
from tominpmp.planner.conclusion import STANDS, without_search
from tominpmp.problem.problem import Problem
from tominpmp.problem.segments import Segment, arrival_window
from tominpmp.problem.state_checks import unheld
from tominpmp.solution import Solution
from tominpmp.transcription.grid import ROUNDING, at_ticks, whole_periods


def standing(problem: Problem, options: Options) -> Solution | None:
    """The motion of an arm that stands at all of its goals from the beginning.

    Args:
        problem: The problem.
        options: Options of the plan; goals may be missed by their ``feasibility``.

    Returns:
        A verified motion, which no other motion can beat; None if the start does not
        satisfy all goals, or the arm cannot rest there against gravity, or not for the
        required time.
    """
    begin = time.perf_counter()
    motion = _motion(problem, options)
    if motion is None:
        return None
    T, reason = motion.duration, "the start already satisfies the goal"
    if T > 0.0:
        reason = "the dwells and the times of arrival that segments require"
    message = f"T = {T:.4g} s. {STANDS}"
    return without_search(problem, options, motion, message, reason, begin)


def _motion(problem: Problem, options: Options) -> Trajectory | None:
    """A motion at rest at the start; None if a goal is not met there, or met late."""
    robot, period, q = problem.robot, options.control_period, problem.q_start
    v, limits = problem.v_start, problem.phases[0].motion_limits
    nodes, ends, now = [0.0], [], 0.0
    # A goal at just this distance is met, however the distance is rounded.
    tolerance = options.feasibility * (1.0 + ROUNDING)
    jumps = limits is None or not limits.continuous
    if not jumps and np.any(np.abs(problem.a_start) > tolerance):
        return None
    segments = problem.segments or (Segment(problem.goal),)
    for phase, segment in zip(problem.phases, segments, strict=True):
        misses = phase.goal.misses(RobotKinematics(phase.robot), q, v)
        if any(miss.amount > tolerance for miss in misses):
            return None
        if phase.goal.fixes_velocity and not np.any(v) and unheld(phase.robot, q):
            return None
        earliest, latest = arrival_window(segment)
        arrival = max(now, whole_periods(earliest, period))
        if arrival > latest:
            return None
        now = arrival + whole_periods(segment.dwell, period)
        nodes += [arrival, now]
        ends.append(now)
    if now > 0.0 and np.any(v):
        return None
    if period is not None:
        nodes, ends = at_ticks(nodes, period).tolist(), at_ticks(ends, period).tolist()
    t = np.unique(nodes)
    q, v, a = (np.tile(row, (t.size, 1)) for row in (q, v, np.zeros(robot.n)))
    dynamics = tuple(RobotDynamics(phase.robot).inverse for phase in problem.phases)
    marks = np.array(ends) if problem.segments else None
    motion = Trajectory(robot.joint_names, t, q, v, u=a, a=a, segment_ends=marks)
    motion = motion.with_torques(dynamics[0], dynamics if problem.segments else ())
    # Joints without a motor exert no torque, and a motion of zero duration needs no
    # torque of them.
    lower, upper = robot.limits.effort_lower, robot.limits.effort_upper
    return replace(motion, u=np.where(lower == upper, lower, motion.u))
