r"""Lower bounds on the duration of any motion that solves a problem.

What is bounded is every motion, not the one found: obstacles, detours and constraints
are ignored, so that the bound holds whatever path there is. Rigorous are

- limits of speed, acceleration and jerk, joint by joint; and no frame moves faster than
  its joints carry it;
- one joint (:mod:`~tominpmp.bounds.single_joint`): the minimum time itself, with all
  that bounds its acceleration, in gravity by a computation in its phase plane;
- two joints (:mod:`~tominpmp.bounds.two_joints`): intervals that enclose both momenta;
- energy, with rotor inertia at every joint: with :math:`w = \sqrt{v^T M v}`, the work
  of the torques gives :math:`\dot w \le \sup_q |u - g|_{M^{-1}}`, in which no Coriolis
  force appears, as it does no work; see :mod:`~tominpmp.bounds.inertia`.

Assumed are the robot's dynamics as they are replayed, torques within the share of their
limits and below their curves over speed, payloads as part of the robot, and, where
accelerations may not jump, that a motion begins and ends without acceleration. Motions
that use the tolerance of the verification can be shorter by as much.
"""

from __future__ import annotations

import contextlib
import math

import numpy as np

from tominpmp.arrays import Array
from tominpmp.bounds.bang_bang import least_time
from tominpmp.bounds.frames import frame_bounds, tool_speed_bounds
from tominpmp.bounds.inertia import EnergyBounds, energy_bounds
from tominpmp.bounds.joint_limits import JointReach, jerk_limited_time
from tominpmp.bounds.result import LowerBound
from tominpmp.bounds.single_joint import single_joint_time
from tominpmp.bounds.two_joints import TwoJoints
from tominpmp.bounds.two_joints_time import LAST_STRIDE, two_joints_time
from tominpmp.checks import instance, number
from tominpmp.goals import Goal
from tominpmp.kinematics import prismatic_joints
from tominpmp.problem import Problem
from tominpmp.stopping import Stop

__all__ = ["LowerBound", "lower_bound"]


def lower_bound(
    problem: Problem, *, quick: bool = False, known: float = math.inf
) -> LowerBound:
    """Find a time that no motion which solves a problem can beat.

    Args:
        problem: The problem.
        quick: Whether to leave out what takes longer than some hundredths of a second:
            an arm with two joints has a weaker bound then.
        known: Duration of a motion that solves it, if there is one [s]: what only a
            longer time could tell is not computed.

    Returns:
        The largest bound that was found.

    Raises:
        ProblemError: If the known duration is no time.
    """
    instance(problem, Problem, "problem")
    longest = number(known, "known", "seconds > 0", above=0.0, infinite=True)
    if problem.segments:
        return _of_segments(problem)
    start = problem.v_start
    goals = problem.goal.alternatives
    return min(
        (_of_goal(problem, goal, start, quick=quick, known=longest) for goal in goals),
        key=lambda bound: bound.T,
    )


def _of_segments(problem: Problem) -> LowerBound:
    """What holds on each segment between two configurations, and all stays.

    Where the speed at the end of a segment is not given, it may be any.
    """
    total = stays = 0.0
    v: Array | None = problem.v_start
    known = True
    for phase, segment in zip(problem.phases, problem.segments, strict=True):
        stays += segment.dwell
        if known:
            total += min(
                _of_goal(phase, g, v, False).T for g in phase.goal.alternatives
            )
        known = phase.goal.configuration is not None
        v = None
        if phase.goal.fixes_velocity:
            v = phase.goal.final_velocity(phase.robot.n)
    same = all(phase.robot is problem.robot for phase in problem.phases) and all(
        segment.motion_limits is None for segment in problem.segments
    )
    if same:
        last = problem.phases[-1].goal.alternatives
        whole = (_of_goal(problem, goal, problem.v_start) for goal in last)
        total = max(total, min(bound.T for bound in whole))
    return LowerBound(
        total + stays, "what joints can do on each segment, and all stays"
    )


def _of_goal(
    problem: Problem,
    goal: Goal,
    start: Array | None,
    smooth_ends: bool = True,
    *,
    quick: bool = True,
    known: float = math.inf,
) -> LowerBound:
    """The best bound for one goal.

    Args:
        problem: The problem.
        goal: One of its goals.
        start: Velocities at the start, shape (n,); None if they may be any.
        smooth_ends: Whether accelerations that may not jump begin and end with zero.
        quick: Whether to leave out what takes long.
        known: Duration of a motion, if there is one [s].
    """
    q = goal.configuration
    given = start is not None and goal.fixes_velocity
    if q is not None and given and start is not None:
        ends = np.stack([start, goal.final_velocity(problem.robot.n)])
        bounds = _joint_bounds(problem, q, ends, smooth_ends, (quick, known))
    else:
        bounds = _range_bounds(problem, goal, start, smooth_ends)
    bounds += tool_speed_bounds(problem, goal)
    nothing = LowerBound(0.0, "no bound is known for a goal of this kind")
    return max(bounds, key=lambda bound: bound.T, default=nothing)


# -- configurations --------------------------------------------------------------------


def _joint_bounds(
    problem: Problem,
    q: Array,
    ends: Array,
    smooth_ends: bool,
    effort: tuple[bool, float],
) -> list[LowerBound]:
    """Bounds between two states; velocities at both of shape (2, n).

    The effort is whether to be quick, and the duration of a motion [s].
    """
    quick, known = effort
    way = q - problem.q_start
    found = _speed_bounds(problem, np.abs(way))
    found += _limit_bounds(problem, way, ends, smooth_ends)
    positions = np.stack([problem.q_start, q])
    joints = problem.robot.joint_names
    alone = None
    with contextlib.suppress(Stop):  # what else is known is known at once
        alone = single_joint_time(problem, positions[:, 0], ends[:, 0], smooth_ends)
    if alone is not None:
        reason = f"no torque moves joint {joints[0]} there sooner"
        return [*found, LowerBound(_finite(alone), reason, joints[0])]
    energy = energy_bounds(problem.robot, problem.motion_limits)
    if energy is not None:
        found += _energy_bounds(problem, way, ends, energy)
    least = max((bound.T for bound in found), default=0.0)
    if known <= LAST_STRIDE * least:
        return found
    pair = TwoJoints.of(problem, positions, ends)
    if pair is not None:
        reason = "no torques move the two joints there sooner"
        T = two_joints_time(pair, quick=quick, least=least, known=known)
        found.append(LowerBound(T, reason))
    return found


def _finite(T: float) -> float:
    """No bound where a computation says that there is no motion at all."""
    return T if math.isfinite(T) else 0.0


def _speed_bounds(problem: Problem, way: Array) -> list[LowerBound]:
    """Bounds from the speed limits for distances to go, shape (n,)."""
    robot, found = problem.robot, []
    top = robot.limits.velocity
    units = np.where(prismatic_joints(robot), "m", "rad")
    for i in np.flatnonzero(np.isfinite(top)).tolist():
        reason = (
            f"joint {robot.joint_names[i]} has {way[i]:.4g} {units[i]} to go, at "
            f"{top[i]:.4g} {units[i]}/s at most"
        )
        T = float(way[i]) / float(top[i])
        found.append(LowerBound(T, reason, robot.joint_names[i]))
    return found


def _limit_bounds(
    problem: Problem, way: Array, ends: Array, smooth_ends: bool
) -> list[LowerBound]:
    """Bounds from limits of acceleration and jerk."""
    robot, limits, found = problem.robot, problem.motion_limits, []
    if limits is None:
        return []
    names = robot.joint_names
    most, jerk = (limits.by_joint(k, names) for k in ("acceleration", "jerk"))
    if not smooth_ends:
        jerk = np.full(robot.n, np.inf)
    units = np.where(prismatic_joints(robot), "m", "rad")
    for i in np.flatnonzero(np.isfinite(np.minimum(most, jerk))).tolist():
        top, both = float(robot.limits.velocity[i]), (float(most[i]), float(most[i]))
        T = jerk_limited_time(float(way[i]), ends[:, i], top, both, float(jerk[i]))
        parts = []
        if math.isfinite(most[i]):
            parts.append(f"accelerates by {most[i]:.4g} {units[i]}/s^2 at most")
        if math.isfinite(jerk[i]):
            parts.append(f"has a jerk of {jerk[i]:.4g} {units[i]}/s^3 at most")
        reason = f"joint {names[i]} {' and '.join(parts)}"
        found.append(LowerBound(_finite(T), reason, names[i]))
    return found


def _energy_bounds(
    problem: Problem, way: Array, ends: Array, energy: EnergyBounds
) -> list[LowerBound]:
    """Bounds from the work of the torques, joint by joint and along the way."""
    robot, found = problem.robot, []
    mass = energy.inertia_at(np.stack([problem.q_start, problem.q_start + way]))
    # Largest w = |v|_M at both ends.
    swing = np.sqrt(np.einsum("ki,kij,kj->k", ends, mass, ends))
    directions: list[tuple[Array, str | None]] = [
        (row, robot.joint_names[i]) for i, row in enumerate(np.eye(robot.n))
    ]
    along = np.mean(mass, axis=0) @ way
    if np.any(along):
        directions.append((along / np.linalg.norm(along), None))
    for direction, joint in directions:
        # A coordinate c q changes at |c v| <= |c|_(M^-1) w.
        rate = energy.rate(direction)
        distance = abs(float(direction @ way))
        top = float(np.sum(np.abs(direction) * robot.limits.velocity))
        T = least_time(
            distance,
            rate * swing,
            rate * energy.acceleration,
            rate * energy.acceleration,
            energy.drag,
            top,
        )
        where = "the arm" if joint is None else f"joint {joint}"
        found.append(LowerBound(T, f"no torques carry {where} there sooner", joint))
    return found


# -- ranges and frames -----------------------------------------------------------------


def _range_bounds(
    problem: Problem, goal: Goal, start: Array | None, smooth_ends: bool
) -> list[LowerBound]:
    """Bounds for goals that leave the configuration or a velocity open."""
    lower, upper = goal.joint_ranges(problem.robot)
    q = problem.q_start
    way = np.maximum(np.maximum(lower - q, q - upper), 0.0)
    way = np.where(np.isfinite(way), way, 0.0)
    rests = goal.fixes_velocity and not goal.ends_moving
    reach = JointReach.of(problem, start, rests, smooth_ends)
    found = _speed_bounds(problem, way)
    T, joint = reach.time(way)
    name = problem.robot.joint_names[joint]
    found.append(LowerBound(T, f"no sooner do its limits let joint {name} go", name))
    for member in goal.members:
        if member.frame_name is not None:
            found += frame_bounds(problem, member, member.frame_name, reach)
    return found
