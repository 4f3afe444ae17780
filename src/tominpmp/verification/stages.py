"""Motions of several segments, taken apart for the judge.

Every segment is judged as a motion of its own, with the robot and its load, the scene
and the limits of that segment, and the goal at its end; the replay is one from the
first start to the last end.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tominpmp.arrays import Array
from tominpmp.dynamics import RobotDynamics
from tominpmp.kinematics import RobotKinematics
from tominpmp.options import Tolerances
from tominpmp.problem import Problem
from tominpmp.trajectory import Trajectory
from tominpmp.verification.plant import Plant, Slope
from tominpmp.verification.polynomials import Pieces
from tominpmp.verification.replay import TIME_STEP, Replay

# Instants of a recorded motion at which it is looked for where its segments end.
MOST_LOOKS = 20_000
# Share of what is tolerated that a goal is missed by where it counts as met.
MET = 1e-3


@dataclass(frozen=True, eq=False)
class Stage:
    """One segment of a motion.

    Attributes:
        number: Its number, from 0.
        count: How many there are.
        problem: What is asked of it.
        begin: When it begins [s].
        end: When it ends [s], with the time the arm stays there.
        dwell: How long it stays there [s].
    """

    number: int
    count: int
    problem: Problem
    begin: float
    end: float
    dwell: float

    @property
    def last(self) -> bool:
        """Whether no other follows."""
        return self.number == self.count - 1

    def of_replay(self, replay: Replay, torque: Pieces) -> Replay:
        """Its rows of a replay; none if the replay was lost before."""
        if self.count == 1:
            return replay
        t = replay.t
        mine = np.flatnonzero((t >= self.begin) & (t <= self.end))
        u = np.array(replay.u[mine])
        piece = int(np.searchsorted(torque.t, self.end)) - 1
        if mine.size and t[mine[-1]] == self.end and not self.last:
            # The row of a node is what holds just after it, on the next segment.
            u[-1] = torque.ends()[piece, 1]
        nodes = replay.nodes[np.isin(replay.nodes, mine)]
        return replace(
            replay,
            t=t[mine],
            q=replay.q[mine],
            v=replay.v[mine],
            u=u,
            nodes=np.searchsorted(mine, nodes),
            complete=bool(mine.size) and t[mine[-1]] == self.end,
        )

    def of_torque(self, torque: Pieces) -> Pieces:
        """Its pieces of the torque."""
        if self.count == 1:
            return torque
        first, behind = np.searchsorted(torque.t, [self.begin, self.end]).tolist()
        times = torque.t[first : behind + 1]
        return replace(torque, t=times, coefficients=torque.coefficients[first:behind])


def stages_of(problem: Problem, trajectory: Trajectory) -> tuple[Stage, ...]:
    """The segments of a motion.

    Args:
        problem: The problem.
        trajectory: The motion, with the times at which its segments end.
    """
    phases, segments = problem.phases, problem.segments
    if not segments or trajectory.segment_ends is None:
        return (Stage(0, 1, problem, 0.0, trajectory.duration, 0.0),)
    ends = trajectory.segment_ends.tolist()
    begins = [0.0, *ends[:-1]]
    each = zip(phases, segments, begins, ends, strict=True)
    return tuple(
        Stage(k, len(phases), phase, begin, end, segment.dwell)
        for k, (phase, segment, begin, end) in enumerate(each)
    )


def with_segments(
    problem: Problem, trajectory: Trajectory, tolerances: Tolerances
) -> Trajectory:
    """A motion with the times at which its segments end, and what it carries on each.

    A recorded motion does not tell: its segments end where it meets their goals for the
    first time, one after the other, or comes nearest.
    """
    phases = problem.phases
    if not problem.segments:
        return replace(trajectory, segment_ends=None, segment_dynamics=())
    given = trajectory.segment_ends
    if given is not None and len(given) == len(phases):
        return trajectory
    ends = _found(problem, trajectory, tolerances)
    found = replace(_with_nodes(trajectory, ends), segment_ends=ends)
    if trajectory.inverse_dynamics is None:
        return found
    dynamics = tuple(RobotDynamics(phase.robot).inverse for phase in phases)
    return found.with_torques(dynamics[0], dynamics)


def _found(problem: Problem, motion: Trajectory, tolerances: Tolerances) -> Array:
    """Times at which the segments of a motion end, as far as can be told [s]."""
    plain = replace(motion, inverse_dynamics=None)
    step = max(TIME_STEP, motion.duration / MOST_LOOKS)
    steps = np.arange(0.0, motion.duration, step)
    times = np.unique(np.concatenate([steps, motion.t]))
    state = plain(times)
    ends: list[float] = []
    first = 0
    for phase, segment in zip(problem.phases[:-1], problem.segments[:-1], strict=True):
        kinematics = RobotKinematics(phase.robot)
        best, least = first, np.inf
        for k in range(first, times.size):
            q, v = state.q[k], state.v[k]
            missed = 0.0
            for miss in phase.goal.nearest(kinematics, q, v).misses(kinematics, q, v):
                allowed = tolerances.speed if miss.moving else tolerances.goal
                missed = max(missed, miss.amount / allowed)
            nearer = missed < least
            if nearer:
                best, least = k, missed
            # What is tolerated is met before the goal is: it ends where it is nearest.
            if least <= MET or (least <= 1.0 and not nearer):
                break
        later = int(np.searchsorted(times, times[best] + segment.dwell - 1e-9))
        first = min(max(later, first + 1), times.size - 2)
        ends.append(float(times[first]))
    return np.array([*ends, motion.duration])


def _with_nodes(motion: Trajectory, times: Array) -> Trajectory:
    """The same motion with nodes at some times, besides its own."""
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


def plant_of(stages: Sequence[Stage], plants: Sequence[Plant] = ()) -> Plant:
    """What moves under the torques of a motion.

    Args:
        stages: Its segments.
        plants: One for each; empty for the robots alone.
    """
    plants = plants or [Plant(stage.problem.robot) for stage in stages]
    if len(plants) == 1:
        return plants[0]
    return PlantOfStages(plants, np.array([stage.end for stage in stages]))


class PlantOfStages(Plant):
    """The robots of the segments, one after the other, each with its load.

    Args:
        plants: One for each segment.
        ends: Times at which they end [s], shape (k,).
    """

    def __init__(self, plants: Sequence[Plant], ends: Array) -> None:
        super().__init__(plants[0].robot)
        self._plants, self._ends = tuple(plants), ends
        self._now = 0

    def load(self, begin: float, end: float, coefficients: Array) -> None:
        """Take up the torque of another piece, on the segment that it is of."""
        middle = 0.5 * (begin + end)
        self._now = int(np.searchsorted(self._ends[:-1], middle, side="right"))
        plant = self._plants[self._now]
        plant.creep = self.creep
        plant.load(begin, end, coefficients)

    def slope(self) -> Slope:
        """dx/dt of the robot of the segment."""
        slopes = [plant.slope() for plant in self._plants]
        return lambda t, x: slopes[self._now](t, x)

    def jacobian(self) -> Slope:
        """Its derivative."""
        found = [plant.jacobian() for plant in self._plants]
        return lambda t, x: found[self._now](t, x)
