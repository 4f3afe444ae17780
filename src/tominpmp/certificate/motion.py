"""A motion on the grid of its certificate."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.certificate.perturbations import (
    JUST_INSIDE,
    Instants,
    Perturbations,
    Shape,
    certificate_grid,
)
from tominpmp.certificate.task import Task
from tominpmp.dynamics import InverseJacobians
from tominpmp.motion.trajectory import Trajectory

# Instants of an interval over which its mean torque is taken, where nodes were merged.
SAMPLES = 8
# Accelerations that jump by less than this share of the largest one are continuous.
SAME = 1e-6


class MotionStates(NamedTuple):
    """A motion at some instants.

    Attributes:
        at: The instants, m of them.
        q: Positions, shape (m, n) [rad or m].
        v: Velocities, shape (m, n).
        a: Accelerations, shape (m, n).
        u: Torques, shape (m, n) [N m or N].
    """

    at: Instants
    q: Array
    v: Array
    a: Array
    u: Array

    def kept(self, which: IntArray) -> MotionStates:
        """Some of the instants."""
        return MotionStates(self.at.kept(which), *(part[which] for part in self[1:]))


@dataclass(frozen=True, eq=False)
class Motion:
    """A motion at the ends of the intervals of a grid, where its limits are rows.

    Attributes:
        task: Dynamics and limits.
        trajectory: The motion.
        changes: Its small changes.
        a: Accelerations just after the beginnings and before the ends of the intervals,
            shape (N, 2, n).
        u: Torques at these instants, shape (N, 2, n).
        parts: Derivatives of the torques at these instants, 2 N rows.
        load: Mean torque of each interval as a share of its limits, shape (N, n).
        span: First interval of the task, and the one after its last.
        sections: The same motion on each of its segments, with the task there; empty
            for one segment.
        number: Number of the segment, from 0; None for one segment.
    """

    task: Task
    trajectory: Trajectory
    changes: Perturbations
    a: Array
    u: Array
    parts: InverseJacobians
    load: Array
    span: tuple[int, int]
    sections: tuple[Motion, ...] = ()
    number: int | None = None

    @classmethod
    def of(cls, task: Task, trajectory: Trajectory) -> Motion:
        """Put a motion on a grid that suits it."""
        t, joined = certificate_grid(trajectory)
        n, h = trajectory.n, np.diff(t)
        times = t[:-1, None] + h[:, None] * np.array([JUST_INSIDE, 1.0 - JUST_INSIDE])
        ends = trajectory(times.ravel())
        a = ends.a
        if trajectory.inverse_dynamics is None:
            x = np.concatenate([ends.q, ends.v], axis=1)
            dry = task.problem.robot.friction * trajectory.turns.at(times.ravel())
            a = task.dynamics.forward(x, ends.u - dry)[:, n:]
        tasks = [Task.of(phase) for phase in task.problem.phases]
        places = [0, t.size - 1]
        if trajectory.segment_ends is not None:
            places = [0, *np.searchsorted(t, trajectory.segment_ends).tolist()]
        spans = list(itertools.pairwise(places))
        found = []
        for one, (first, end) in zip(tasks, spans, strict=True):
            rows = slice(2 * first, 2 * end)
            states = ends.q[rows], ends.v[rows], a[rows]
            found.append(one.dynamics.inverse_jacobians(*states))
        parts = InverseJacobians(*map(np.vstack, zip(*found, strict=True)))
        a, u = a.reshape(-1, 2, n), ends.u.reshape(-1, 2, n)
        mean = u.mean(axis=1)
        if joined:
            inside = (np.arange(SAMPLES) + 0.5) / SAMPLES
            times = t[:-1, None] + h[:, None] * inside
            mean = trajectory(times.ravel()).u.reshape(-1, SAMPLES, n).mean(axis=1)
        nodes = trajectory(t)
        shape = _shape(task, trajectory, a, joined)
        changes = Perturbations(t, nodes.q, nodes.v, shape)
        load = task.share_of_effort(mean)
        whole = cls(task, trajectory, changes, a, u, parts, load, (0, changes.N))
        if trajectory.segment_ends is None:
            return whole
        each = ((one, one.share_of_effort(mean)) for one in tasks)
        sections = tuple(
            replace(whole, task=one, load=load, span=spans[number], number=number)
            for number, (one, load) in enumerate(each)
        )
        load = np.vstack([one.load[slice(*one.span)] for one in sections])
        return replace(whole, load=load, sections=sections)

    @property
    def segments(self) -> tuple[Motion, ...]:
        """The motion on each of its segments; the motion itself for one segment."""
        return self.sections or (self,)

    @property
    def constraints(self) -> list[Any]:
        """Constraints along the motion, of one segment after the other."""
        every = (one.task.problem.constraints for one in self.segments)
        return [item for items in every for item in items]

    @property
    def loads(self) -> Array:
        """Torques at both ends as shares of their limits, shape (N, 2, n)."""
        if self.sections:
            return np.vstack([one.loads[slice(*one.span)] for one in self.sections])
        return self.task.share_of_effort(self.u)

    @property
    def driven(self) -> IntArray:
        """Joints with a motor."""
        limits = self.task.problem.robot.limits
        return np.flatnonzero(limits.effort_upper > limits.effort_lower)

    @property
    def intervals(self) -> IntArray:
        """Indices of the intervals of its span."""
        return np.arange(*self.span)

    # -- states ------------------------------------------------------------------------

    def ends(self, interval: IntArray, end: int) -> MotionStates:
        """The motion at the beginnings (0) or ends (1) of some intervals."""
        at = Instants(interval, np.full(interval.size, float(end)))
        q, v = self.changes.q[interval + end], self.changes.v[interval + end]
        return MotionStates(at, q, v, self.a[interval, end], self.u[interval, end])

    def states(self, at: Instants) -> MotionStates:
        """The motion at instants."""
        found = self.trajectory(self.changes.times(at))
        return MotionStates(at, found.q, found.v, found.a, found.u)


def _shape(task: Task, trajectory: Trajectory, a: Array, joined: bool) -> Shape:
    """The quantity that is constant on the intervals of a motion."""
    limits = task.problem.motion_limits
    if limits is not None and limits.continuous:
        return "ramps"
    if trajectory.inverse_dynamics is None or joined:
        return "torques"
    largest = float(np.max(np.abs(a), initial=0.0))
    jump = float(np.max(np.abs(a[1:, 0] - a[:-1, 1]), initial=0.0))
    return "ramps" if jump <= SAME * largest else "steps"
