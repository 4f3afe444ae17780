"""What limits of joints, clearances and other constraints are worth to a motion."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tominpmp.arrays import Array, BoolArray
from tominpmp.certificate.active_limits import Motion
from tominpmp.certificate.dual_solution import DualSolution
from tominpmp.certificate.limit_rows import LimitRows
from tominpmp.kinematics import prismatic_joints
from tominpmp.sensitivities.records import Sensitivity

# Limits beyond those of a robot's description, with their units.
DECLARED = {"acceleration": "s^2", "jerk": "s^3"}


@dataclass(frozen=True, eq=False)
class LimitValues:
    """Reads records from the multipliers of a motion.

    Attributes:
        motion: The motion.
        found: Its multipliers.
    """

    motion: Motion
    found: DualSolution

    def records(self) -> Iterator[Sensitivity]:
        """Records of all limits."""
        yield from self._of_joints()
        yield from self._positions()
        yield from self._clearances()
        yield from self._constraints()

    @cached_property
    def _sliding(self) -> BoolArray:
        return prismatic_joints(self.motion.task.problem.robot)

    def _place_unit(self, joint: int) -> str:
        return "m" if self._sliding[joint] else "rad"

    def _force_unit(self, joint: int) -> str:
        return "N" if self._sliding[joint] else "N m"

    # -- shares of limits --------------------------------------------------------------

    def _used(self, kind: str) -> Array:
        """What a share of a limit is worth by joint, shape (n,).

        A multiplier counts by the share of the limit that the motion uses, so that time
        scaling, which changes what is used, holds for the sums however near the
        optimum the motion is.
        """
        given = self.found.multipliers
        own = np.flatnonzero(given.of(kind))
        limits, n = self.motion.task.problem.motion_limits, self.motion.changes.n
        continuous = limits is not None and limits.continuous
        if kind == "acceleration" and continuous and own.size:
            # The first and the last one are zero whatever the limit is.
            order = np.argsort(given.subject[own], kind="stable")
            joints = np.unique(given.subject[own]).size
            by_joint = own[order].reshape(joints, -1)
            first, end = self.motion.span
            last = by_joint.shape[1] - int(end == self.motion.changes.N)
            own = by_joint[:, int(first == 0) : last].ravel()
        out = np.zeros(n)
        worth = given.value[own] * (1.0 - given.room[own])
        np.add.at(out, given.subject[own], worth)
        return out

    def _efforts(self) -> Array:
        """The same for torques, as they are: between nodes they may pass limits."""
        out = np.zeros(self.motion.changes.n)
        for rows, y in self.found.rows:
            if rows.kind == "effort":
                np.add.at(out, rows.subject, y * self._loads(rows))
        return out

    def _loads(self, rows: LimitRows) -> Array:
        """Torques of rows, as shares of their limits, shape (m,)."""
        motion = self.motion
        if rows.mean:
            return np.asarray(motion.load[rows.interval, rows.subject])
        if rows.end is not None:
            return np.asarray(motion.loads[rows.interval, rows.end, rows.subject])
        task, time = motion.task, rows.at.times(motion.changes)
        load = (motion.trajectory(time).u - task.effort_middle) / task.effort_half
        return np.asarray(load[np.arange(time.size), rows.subject])

    def _of_joints(self) -> Iterator[Sensitivity]:
        """Speeds, torques, and what motors and controllers limit beside them."""
        problem = self.motion.task.problem
        names, limits = problem.robot.joint_names, problem.robot.limits
        speeds = [self._place_unit(j) + "/s" for j in range(len(names))]
        forces = [self._force_unit(j) for j in range(len(names))]
        yield from self._shares("velocity", limits.velocity, speeds)
        effort = limits.effort_upper.copy()
        effort[np.setdiff1d(np.arange(len(names)), self.motion.driven)] = np.inf
        yield from self._shares("effort", effort, forces)
        declared = problem.motion_limits
        if declared is None:
            return
        for kind, time in DECLARED.items():
            units = [f"{self._place_unit(j)}/{time}" for j in range(len(names))]
            yield from self._shares(kind, declared.by_joint(kind, names), units)
        rates = declared.by_joint("effort_rate", names)
        yield from self._shares("effort rate", rates, [f"{unit}/s" for unit in forces])
        yield from self._curves()

    def _shares(
        self, kind: str, limit: Array, units: list[str]
    ) -> Iterator[Sensitivity]:
        names = self.motion.task.problem.robot.joint_names
        worth = self._efforts() if kind == "effort" else self._used(kind)
        for joint in np.flatnonzero(np.isfinite(limit)).tolist():
            yield Sensitivity(
                kind,
                names[joint],
                names[joint],
                0.0 - float(worth[joint]),
                limit=float(limit[joint]),
                limit_unit=units[joint],
            )

    def _curves(self) -> Iterator[Sensitivity]:
        """Torques over speed, by both axes of their curves."""
        limits = self.motion.task.problem.motion_limits
        curves = {} if limits is None else (limits.effort_curves or {})
        if not curves:
            return
        motion, changes = self.motion, self.motion.changes
        names, half = motion.trajectory.joint_names, motion.task.effort_half
        by_effort, by_speed = np.zeros(changes.n), np.zeros(changes.n)
        for rows, y in self.found.rows:
            if rows.kind != "effort over speed":
                continue
            time = rows.at.inside.times(changes)
            state, every = motion.trajectory(time), np.arange(y.size)
            u, v = state.u[every, rows.subject], state.v[every, rows.subject]
            slope = np.array(
                [
                    float(curves[names[j]](speed)[1])
                    for j, speed in zip(rows.subject.tolist(), v, strict=True)
                ]
            )
            own = half[rows.subject]
            np.add.at(by_effort, rows.subject, y * np.abs(u) / own)
            np.add.at(by_speed, rows.subject, -y * slope * np.abs(v) / own)
        for name in sorted(curves):
            joint = names.index(name)
            for kind, worth in (
                ("effort over speed", by_effort),
                ("speed of effort curve", by_speed),
            ):
                yield Sensitivity(kind, name, name, 0.0 - float(worth[joint]))

    # -- limits by their units ---------------------------------------------------------

    def _positions(self) -> Iterator[Sensitivity]:
        """Ends of the ranges of joints, each by a range that is wider there."""
        given, robot = self.found.multipliers, self.motion.task.problem.robot
        own, limits = given.of("position"), robot.limits
        for joint, name in enumerate(robot.joint_names):
            for upper, limit in (
                (True, limits.position_upper[joint]),
                (False, limits.position_lower[joint]),
            ):
                rows = own & (given.subject == joint) & (given.upper == upper)
                if not np.isfinite(limit):
                    continue
                unit = self._place_unit(joint)
                yield Sensitivity(
                    f"{'upper' if upper else 'lower'} position",
                    name,
                    name,
                    0.0 - float(given.value[rows].sum()),
                    f"1/{unit}",
                    float(limit),
                    unit,
                )

    def _clearances(self) -> Iterator[Sensitivity]:
        """Clearances by obstacle, by other links, and the margin of all of them."""
        problem, given = self.motion.task.problem, self.found.multipliers
        worth = np.zeros(len(problem.checker.pairs))
        own = given.of("clearance")
        np.add.at(worth, given.subject[own], given.value[own])
        names: dict[str, float] = {item.name: 0.0 for item in problem.scene}
        for index, (one, other) in enumerate(problem.checker.pairs):
            if index < problem.checker.obstacle_pairs:
                names[other] += float(worth[index])
            elif worth[index] > 0.0:
                pair = f"{one} and {other}"
                names[pair] = names.get(pair, 0.0) + float(worth[index])
        for name, value in names.items():
            yield Sensitivity("clearance", None, name, value, "1/m")
        margin = float(worth[problem.checker.margins(1.0) > 0.0].sum())
        if not problem.margin > 0.0:
            yield Sensitivity("margin", None, "", margin, "1/m", 0.0, "m")
            return
        share = margin * problem.margin
        yield Sensitivity("margin", None, "", share, "", problem.margin, "m")

    def _constraints(self) -> Iterator[Sensitivity]:
        """What the problem asks for along the way."""
        given, problem = self.found.multipliers, self.motion.task.problem
        for index, item in enumerate(problem.constraints):
            rows = given.of(item.name) & (given.subject == index)
            worth = float(given.value[rows].sum())
            limit, named = float(item.largest), not item.largest > 0.0
            yield Sensitivity(
                item.name,
                None,
                item.subject,
                0.0 - (worth if named else worth * limit),
                f"1/{item.unit}" if named else "",
                limit,
                item.unit,
            )
