"""Limits of a motion as linear rows on its small changes."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array, IntArray
from tominpmp.certificate.friction import friction_along
from tominpmp.certificate.limit_rows import LimitRows
from tominpmp.certificate.perturbations import (
    JUST_INSIDE,
    Linearised,
    Perturbations,
    Shape,
    blocks,
    certificate_grid,
)
from tominpmp.certificate.task import Task
from tominpmp.dynamics import InverseJacobians
from tominpmp.motion.trajectory import State, Trajectory

# Instants of an interval at which its mean torque is taken, where nodes were joined.
SAMPLES = 8
# Accelerations that jump by less than this share of the largest one are continuous.
SAME = 1e-6


@dataclass(frozen=True, eq=False)
class Motion:
    """A motion at the ends of the intervals of a grid, where its limits are rows.

    Attributes:
        task: Dynamics and limits.
        trajectory: The motion.
        changes: Its small changes.
        a: Accelerations just after the beginnings and before the ends of the intervals,
            shape (N, 2, n).
        u: Torques there, shape (N, 2, n).
        parts: Derivatives of the torques there, 2 N rows.
        load: Mean torque of each interval as a share of its limits, shape (N, n).
        within: First interval of what the task holds on, and the one after its last;
            None for all.
        sections: The same motion on each of its segments, with the task there; empty
            where there is one.
    """

    task: Task
    trajectory: Trajectory
    changes: Perturbations
    a: Array
    u: Array
    parts: InverseJacobians
    load: Array
    within: tuple[int, int] | None = None
    sections: tuple[Motion, ...] = ()

    @classmethod
    def of(cls, task: Task, trajectory: Trajectory) -> Motion:
        """Look at a motion on a grid that suits it."""
        t, joined = certificate_grid(trajectory)
        n, h = trajectory.n, np.diff(t)
        times = t[:-1, None] + h[:, None] * np.array([JUST_INSIDE, 1.0 - JUST_INSIDE])
        ends = trajectory(times.ravel())
        a = ends.a
        if trajectory.inverse_dynamics is None:
            x = np.concatenate([ends.q, ends.v], axis=1)
            dry = friction_along(task.problem.robot, trajectory, times.ravel())
            a = task.dynamics.forward(x, ends.u - dry)[:, n:]
        tasks = [Task.of(phase) for phase in task.problem.phases]
        spans = _spans(t, trajectory)
        parts = _jacobians(tasks, spans, ends, a)
        a, u = a.reshape(-1, 2, n), ends.u.reshape(-1, 2, n)
        mean = u.mean(axis=1)
        if joined:
            inside = (np.arange(SAMPLES) + 0.5) / SAMPLES
            times = t[:-1, None] + h[:, None] * inside
            mean = trajectory(times.ravel()).u.reshape(-1, SAMPLES, n).mean(axis=1)
        nodes = trajectory(t)
        shape = _shape(task, trajectory, a, joined)
        changes = Perturbations(t, nodes.q, nodes.v, shape)
        whole = cls(task, trajectory, changes, a, u, parts, task.share_of_effort(mean))
        if trajectory.segment_ends is None:
            return whole
        sections = [
            replace(whole, task=one, load=one.share_of_effort(mean), within=span)
            for one, span in zip(tasks, spans, strict=True)
        ]
        load = np.vstack([one.load[slice(*one.span)] for one in sections])
        return replace(whole, load=load, sections=tuple(sections))

    @property
    def segments(self) -> tuple[Motion, ...]:
        """The motion on each of its segments; itself where there is one."""
        return self.sections or (self,)

    @property
    def span(self) -> tuple[int, int]:
        """First interval of what the task holds on, and the one after its last."""
        return self.within or (0, self.changes.N)

    def own(self, every: Iterable[LimitRows]) -> list[LimitRows]:
        """Those of some rows that are within."""
        first, end = self.span
        found = []
        for rows in every:
            mine = (rows.interval >= first) & (rows.interval < end)
            found.append(rows if mine.all() else rows.kept(np.flatnonzero(mine)))
        return [rows for rows in found if rows.lower.size]

    @property
    def pairs(self) -> list[tuple[str, str]]:
        """Names of the pairs of bodies, of one segment after the other."""
        every = (one.task.problem.checker.pairs for one in self.segments)
        return [pair for pairs in every for pair in pairs]

    @property
    def constraints(self) -> list[Any]:
        """Constraints on the way, of one segment after the other."""
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

    # -- torques -----------------------------------------------------------------------

    def _torque(self, end: int) -> Linearised:
        """Changes of the torques at one end of the intervals [N m or N]."""
        changes, parts, n = self.changes, self.parts, self.changes.n
        rows = slice(end * n, (changes.N + end) * n)
        matrix = (
            blocks(parts.tau_q[end::2]) @ changes.positions[rows]
            + blocks(parts.tau_v[end::2]) @ changes.velocities[rows]
            + blocks(parts.tau_a[end::2]) @ changes.accelerations(end)
        )
        return changes.fixed(matrix)

    def _mean_torque(self) -> Linearised:
        return _mean(self._torque(0), self._torque(1))

    def _rows(
        self,
        kind: str,
        change: Linearised,
        lower: Array,
        upper: Array,
        share: float = 0.5,
        mean: bool = False,
    ) -> LimitRows:
        """Rows of all joints on all intervals."""
        N, n = self.changes.N, self.changes.n
        return LimitRows(
            kind,
            change,
            np.minimum(np.broadcast_to(lower, (N, n)), 0.0).ravel(),
            np.maximum(np.broadcast_to(upper, (N, n)), 0.0).ravel(),
            np.repeat(np.arange(N), n),
            np.tile(np.arange(n), N),
            share,
            mean,
        )

    def _as_loads(self, torque: Linearised) -> Linearised:
        scale = np.tile(1.0 / self.task.effort_half, self.changes.N)
        return torque.after(sp.diags(scale).tocsr())

    def efforts(self) -> list[LimitRows]:
        """Torques, as shares of their limits."""
        N, n = self.changes.N, self.changes.n
        driven, out = self.driven, []
        every = np.arange(N * n).reshape(N, n)
        if driven.size < n:
            # What has no motor obeys its equation of motion in the mean.
            mean = self._as_loads(self._mean_torque())
            none = np.zeros(1)
            rows = self._rows("passive", mean, none, none, mean=True)
            passive = np.setdiff1d(np.arange(n), driven)
            out.append(rows.kept(every[:, passive].ravel()))
        if self.changes.shape == "torques":
            mean = self._as_loads(self._mean_torque())
            rows = self._rows(
                "effort", mean, -1.0 - self.load, 1.0 - self.load, mean=True
            )
            return [*out, rows.kept(every[:, driven].ravel())]
        loads = self.loads
        for end in (0, 1):
            rows = self._rows(
                "effort",
                self._as_loads(self._torque(end)),
                -1.0 - loads[:, end],
                1.0 - loads[:, end],
                float(end),
            )
            chosen = every[:, driven]
            if end == 1 and self.changes.shape == "ramps" and self.within is None:
                chosen = chosen[-1:]  # the others begin the next interval
            out.append(rows.kept(chosen.ravel()))
        return out

    # -- what else motors and controllers limit ----------------------------------------

    def declared(self) -> list[LimitRows]:
        """What motors and controllers limit beside torques: rates, jerks, power."""
        limits = self.task.problem.motion_limits
        if limits is None:
            return []
        names = self.task.problem.robot.joint_names
        out = self._over_speed()
        rate = limits.by_joint("effort_rate", names)
        if np.any(np.isfinite(rate)):
            torques = self._torque(0), self._torque(1)
            out.append(self._slopes("effort rate", *torques, self.u, rate))
        jerk = limits.by_joint("jerk", names)
        if np.any(np.isfinite(jerk)):
            changes = self.changes
            begin, end = (changes.fixed(changes.accelerations(k)) for k in (0, 1))
            out.append(self._slopes("jerk", begin, end, self.a, jerk))
        return out

    def _slopes(
        self,
        kind: str,
        begin: Linearised,
        end: Linearised,
        values: Array,
        limit: Array,
    ) -> LimitRows:
        """Slopes over time, as shares of limits.

        What is continuous has one over each interval: those between the middles of
        intervals would leave half of the first interval free, and with it the height
        of all that follows.

        Args:
            kind: Name of the rows.
            begin: Changes at the beginnings of the intervals.
            end: Those at their ends.
            values: What is there now, shape (N, 2, n).
            limit: Of the slope, by joint, shape (n,).
        """
        changes, h = self.changes, self.changes.h
        if changes.shape == "ramps":
            found = (values[:, 1] - values[:, 0]) / h[:, None]
            change = changes.rises(begin, end, found)
        else:
            mean = values.mean(axis=1)
            found = np.diff(mean, axis=0) / (0.5 * (h[1:] + h[:-1]))[:, None]
            change = changes.differences(_mean(begin, end), mean)
        return _shares(kind, change, found, limit, np.arange(len(found)), changes.n)

    def _over_speed(self) -> list[LimitRows]:
        limits, changes = self.task.problem.motion_limits, self.changes
        curves = {} if limits is None else (limits.effort_curves or {})
        names, N, n = self.task.problem.robot.joint_names, changes.N, changes.n
        half, out = self.task.effort_half, []
        for name, curve in sorted(curves.items()):
            joint = names.index(name)
            own = np.arange(N) * n + joint
            for end in (0, 1):
                node = slice(end, N + end)
                most, slope = curve(changes.v[node, joint])
                slope = slope * np.sign(changes.v[node, joint])
                speeds = changes.velocities[(np.arange(N) + end) * n + joint]
                torque = self._torque(end).matrix[own]
                for sign in (1.0, -1.0):
                    matrix = sign * torque - sp.diags(slope) @ speeds
                    room = most - sign * self.u[:, end, joint]
                    out.append(
                        LimitRows(
                            "effort over speed",
                            changes.fixed(matrix / half[joint]),
                            np.full(N, -np.inf),
                            np.maximum(room / half[joint], 0.0),
                            np.arange(N),
                            np.full(N, joint),
                            float(end),
                        )
                    )
        return out


def _mean(begin: Linearised, end: Linearised) -> Linearised:
    """Mean of both ends of intervals."""
    half = 0.5 * sp.identity(begin.matrix.shape[0], format="csr")
    return (begin + end).after(half)


def _spans(t: Array, trajectory: Trajectory) -> list[tuple[int, int]]:
    """First interval of each segment on a grid, and the one after its last."""
    if trajectory.segment_ends is None:
        return [(0, t.size - 1)]
    places = np.searchsorted(t, trajectory.segment_ends).tolist()
    return list(itertools.pairwise([0, *places]))


def _jacobians(
    tasks: Sequence[Task], spans: Sequence[tuple[int, int]], ends: State, a: Array
) -> InverseJacobians:
    """Derivatives of the torques at both ends of all intervals, 2 N rows."""
    found = []
    for task, (first, end) in zip(tasks, spans, strict=True):
        rows = slice(2 * first, 2 * end)
        found.append(
            task.dynamics.inverse_jacobians(ends.q[rows], ends.v[rows], a[rows])
        )
    if len(found) == 1:
        return found[0]
    return InverseJacobians(*(np.vstack(parts) for parts in zip(*found, strict=True)))


def _shape(task: Task, trajectory: Trajectory, a: Array, joined: bool) -> Shape:
    """What is constant on the intervals of a motion."""
    limits = task.problem.motion_limits
    if limits is not None and limits.continuous:
        return "ramps"
    if trajectory.inverse_dynamics is None or joined:
        return "torques"
    largest = float(np.max(np.abs(a), initial=0.0))
    jump = float(np.max(np.abs(a[1:, 0] - a[:-1, 1]), initial=0.0))
    return "ramps" if jump <= SAME * largest else "steps"


def _shares(
    kind: str,
    change: Linearised,
    found: Array,
    limit: Array,
    interval: IntArray,
    n: int,
) -> LimitRows:
    """Rows of some joints on some intervals, as shares of finite limits."""
    rows = interval.size * n
    scale = np.tile(np.where(np.isfinite(limit), 1.0 / limit, 1.0), interval.size)
    share = found.ravel() * scale
    out = LimitRows(
        kind,
        change.after(sp.diags(scale).tocsr()),
        np.minimum(-1.0 - share, 0.0),
        np.maximum(1.0 - share, 0.0),
        np.repeat(interval, n),
        np.tile(np.arange(n), interval.size),
    )
    limited = np.tile(np.isfinite(limit), interval.size)
    return out.kept(np.flatnonzero(limited[:rows]))
