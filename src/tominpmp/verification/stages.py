"""Segments of a motion, each judged as a motion of its own.

A segment has a robot with its load, a scene, limits, and a goal at its end. The replay
is a single one, from the start of the first segment to the end of the last.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from tominpmp.arrays import Array
from tominpmp.dynamics import RobotDynamics
from tominpmp.kinematics import RobotKinematics
from tominpmp.motion.extrema import least_between
from tominpmp.motion.trajectory import Trajectory
from tominpmp.options import Tolerances
from tominpmp.problem.segments import SAME, spans_of
from tominpmp.verification.limit_violations import LimitViolation
from tominpmp.verification.polynomials import Pieces
from tominpmp.verification.replay import TIME_STEP, Replay

if TYPE_CHECKING:
    from tominpmp.problem.problem import Problem

# Largest number of instants among which ends of recorded segments are searched.
MOST_LOOKS = 20_000
# A goal is met where its residual is below this share of the tolerance.
MET = 1e-3


@dataclass(frozen=True, eq=False)
class Stage:
    """One segment of a motion.

    Attributes:
        number: Its number, from 0.
        count: Number of segments of the motion.
        problem: Its problem.
        begin: Time of its beginning [s].
        reached: Time at which its goal is met, before its dwell [s].
        end: Time of its end, after its dwell [s].
        arrival: Earliest and latest time at which the goal is to be met [s]; None for
            any time.
    """

    number: int
    count: int
    problem: Problem
    begin: float
    reached: float
    end: float
    arrival: tuple[float, float] | None = None

    @property
    def timeliness(self) -> list[LimitViolation]:
        """Deviation from its arrival times; empty without arrival times."""
        if self.arrival is None:
            return []
        (earliest, latest), reached = self.arrival, self.reached
        late = max(reached - latest, earliest - reached)
        side = "late" if reached - latest >= earliest - reached else "early"
        wrong = late > TIME_STEP
        return [LimitViolation("arrival", side, reached, late, "s", late, wrong)]

    def named(self, item: LimitViolation) -> LimitViolation:
        """A violation with number and times of the segment, if there are several."""
        if self.count == 1:
            return item
        return replace(item, segment=self.number + 1, span=(self.begin, self.end))

    def part(self, replay: Replay, torque: Pieces) -> tuple[Replay, Pieces]:
        """Its rows of a replay, empty if that ended before it, and its torques."""
        if self.count == 1:
            return replay, torque
        part = replay.between(self.begin, self.end)
        complete = bool(part.t.size) and part.t[-1] == self.end
        first, behind = np.searchsorted(torque.t, [self.begin, self.end]).tolist()
        pieces = replace(
            torque,
            t=torque.t[first : behind + 1],
            coefficients=torque.coefficients[first:behind],
        )
        u = np.array(part.u)
        if self.begin == self.end:
            # A segment without duration has the torques that hold the arm.
            u = RobotDynamics(self.problem.robot).inverse(part.q, part.v, 0.0 * part.v)
        elif complete:
            # The row of a node has the torque just after it, on the next segment.
            u[-1] = pieces.ends()[-1, 1]
        return replace(part, u=u, complete=complete), pieces


def stages_of(problem: Problem, trajectory: Trajectory) -> tuple[Stage, ...]:
    """The segments of a motion; a single one without the times of all their ends.

    Args:
        problem: The problem.
        trajectory: The motion, with the times at which its segments end.
    """
    phases, segments, T = problem.phases, problem.segments, trajectory.duration
    ends = trajectory.segment_ends
    if ends is None or len(ends) != len(segments):
        return (Stage(0, 1, problem, 0.0, T, T),)
    each = zip(phases, segments, spans_of(trajectory, segments), strict=True)
    return tuple(
        Stage(k, len(phases), phase, *span, segment.arrival)
        for k, (phase, segment, span) in enumerate(each)
    )


def with_segments(
    problem: Problem, trajectory: Trajectory, tolerances: Tolerances
) -> Trajectory:
    """A motion with the times at which its segments end, and the load of each.

    A recorded motion has these times at best up to the time between two rows. Its
    segments end where it first meets their goals, one after the other, or comes nearest
    to them: near the recorded times, if there are any.
    """
    phases = problem.phases
    if not problem.segments:
        return replace(trajectory, segment_ends=None, segment_dynamics=())
    given = trajectory.segment_ends
    known = given is not None and len(given) == len(phases)
    if known and trajectory.segment_dynamics:
        return trajectory
    ends = _found(problem, trajectory, tolerances, given if known else None)
    found = replace(_with_nodes(trajectory, ends), segment_ends=ends)
    if trajectory.inverse_dynamics is None:
        return found
    dynamics = tuple(RobotDynamics(phase.robot).inverse for phase in phases)
    return found.with_torques(dynamics[0], dynamics)


def _found(
    problem: Problem, motion: Trajectory, tolerances: Tolerances, about: Array | None
) -> Array:
    """Times at which the segments of a recorded motion end [s], shape (k,).

    Args:
        problem: The problem.
        motion: The motion.
        tolerances: Tolerances of the goals.
        about: Recorded times, at nodes [s], shape (k,); None without them.
    """
    plain, T = replace(motion, inverse_dynamics=None), motion.duration
    step = max(TIME_STEP, T / MOST_LOOKS)
    times = np.unique(np.concatenate([np.arange(0.0, T, step), motion.t]))
    ends: list[float] = []
    first, last = 0, times.size - 1
    each = zip(problem.phases[:-1], problem.segments[:-1], strict=True)
    for number, (phase, segment) in enumerate(each):
        begin, behind = first, last + 1
        if about is not None:
            # The row before the recorded first row of the next segment.
            row = max(int(np.searchsorted(motion.t, about[number])) - 1, 0)
            earliest = motion.t[row] - segment.dwell
            begin = max(first, int(np.searchsorted(times, earliest - step)))
            behind = max(int(np.searchsorted(times, about[number])) + 1, begin + 1)
        missed = partial(_missed, plain, phase, tolerances)
        met = _first_met(missed, times[begin:behind])
        if segment.stop and segment.arrival is not None:
            # The goal may be met before its earliest time, and until then.
            allowed = segment.arrival[0]
            if met < allowed <= T and next(missed(np.array([allowed]))) <= MET:
                met = allowed
        end = met
        if segment.dwell > 0.0:
            later = np.searchsorted(times, met + segment.dwell - SAME)
            end = float(times[min(int(later), last)])
            if about is not None and _rests(plain, end, about[number]):
                end = float(about[number])  # a longer dwell
        first = min(int(np.searchsorted(times, end)), last)
        ends.append(end)
    return np.array([*ends, T])


def _missed(
    motion: Trajectory, phase: Problem, tolerances: Tolerances, times: Array
) -> Iterator[float]:
    """Residuals of a goal at times of a motion, in units of the tolerances."""
    kinematics, state = RobotKinematics(phase.robot), motion(times)
    units = tolerances.goal, tolerances.speed
    for q, v in zip(state.q, state.v, strict=True):
        misses = phase.goal.nearest(kinematics, q, v).misses(kinematics, q, v)
        yield max((miss.amount / units[miss.moving] for miss in misses), default=0.0)


def _rests(motion: Trajectory, begin: float, end: float) -> bool:
    """Whether the arm rests between two times."""
    if begin > end:
        return False
    state = motion(np.array([begin, end]))
    off = np.maximum(np.abs(state.q[1] - state.q[0]), np.abs(state.v[1]))
    return bool(np.all(off <= SAME))


def _first_met(missed: Callable[[Array], Iterator[float]], times: Array) -> float:
    """First time at which a goal is met, or time of its least residual [s]."""
    best, least = 0, np.inf
    for k, off in enumerate(missed(times)):
        nearer = off < least
        if nearer:
            best, least = k, off
        # The tolerance is reached before the goal: the end is at the least residual.
        if least <= MET or (least <= 1.0 and not nearer):
            break
    if least <= MET:
        return float(times[best])
    low, high = times[max(best - 1, 0)], times[min(best + 1, times.size - 1)]
    time, off = least_between(lambda near: np.array([*missed(near)]), low, high)
    return time if off < least else float(times[best])


def _with_nodes(motion: Trajectory, times: Array) -> Trajectory:
    """The motion with further nodes, at given times [s]."""
    t = np.unique(np.concatenate([motion.t, times]))
    node = np.searchsorted(motion.t, t, side="right") - 1
    state = replace(motion, inverse_dynamics=None)(t)
    every = motion(t).u if motion.inverse_dynamics is not None else motion.u[node]
    a = motion.a
    if a is not None and len(a) == motion.t.size:
        a = state.a
    elif a is not None:
        a = a[node[:-1]]
    u = np.vstack([every[:-1], motion.u[-1:]])
    return replace(motion, t=t, q=state.q, v=state.v, u=u, a=a)


def arrival(
    stage: Stage, replay: Replay, tolerances: Tolerances
) -> list[LimitViolation]:
    """Largest deviations of place and velocity from the goal of a segment.

    At its end and before its dwell; no deviation of velocity if the goal has none.
    """
    rows = [replay.t.size - 1]
    if stage.reached < stage.end:
        rows.append(int(np.argmin(np.abs(replay.t - stage.reached))))
    goal, kinematics = stage.problem.goal, RobotKinematics(stage.problem.robot)
    misses = [
        miss
        for q, v in zip(replay.q[rows], replay.v[rows], strict=True)
        for miss in goal.nearest(kinematics, q, v).misses(kinematics, q, v)
    ]
    time, found = replay.duration, []
    for kind, tolerance in (("goal", tolerances.goal), ("speed", tolerances.speed)):
        mine = [miss for miss in misses if miss.moving is (kind == "speed")]
        if mine:
            miss = max(mine, key=lambda miss: miss.amount)
            amount = miss.amount if replay.complete else np.inf
            missed = not amount <= tolerance
            item = kind, miss.name, time, amount, miss.unit, amount, missed
            found.append(LimitViolation(*item))
    return found
