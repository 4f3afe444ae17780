"""Judging a file of a motion, including the constraints between start and goal.

    python benchmarks/between_judge.py CASE.json MOTION.csv

A separate program, which imports no code of the library. The arm is built from its URDF
file by Pinocchio, links are the triangle meshes of the description. It reads the
specification and the table of the motion (times, positions, velocities, accelerations,
torques), prints its findings as JSON, and exits with 1 if it refutes the motion. It
checks:

- start, intermediate goals and goal, in their order;
- positions follow from the velocities, and these from the accelerations;
- limits of positions, velocities and torques; torques are computed anew, at every
  sample and, from positions and velocities alone, halfway between samples;
- the cone of the tool, or its speed;
- distances to obstacles and between links, by exact meshes.
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

if not __package__:  # run as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.cell_arms import inverse, read_member
from benchmarks.cell_clearance import Cell, read_obstacle
from benchmarks.exact_geometry import Array
from benchmarks.verdicts import judge_named

GOAL, REST, LIMIT = 1.1e-3, 1.1e-2, 5.5e-3
TORQUE = 1e-5  # of the limit: tolerated difference of torques from the inverse dynamics
SLOW = 1e-6  # speed below which a joint rests or reverses [rad/s]
CONTACT = 1e-5  # tolerated violation of a margin [m]


class Table:
    """A motion: samples, and cubics between them.

    Attributes:
        t: Times [s], shape (m,).
        q: Positions, shape (m, n); v, a and u likewise.
    """

    def __init__(self, path: Path) -> None:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.reader(file))
        numbers = np.array(rows[1:], dtype=float)
        n = (len(rows[0]) - 1) // 4
        self.joints = [name.removeprefix("q_") for name in rows[0][1 : n + 1]]
        self.t = numbers[:, 0]
        self.q, self.v, self.a, self.u = np.split(numbers[:, 1 : 4 * n + 1], 4, axis=1)

    def at(self, time: float) -> tuple[Array, Array]:
        """Position and velocity at a time, by cubics."""
        k = int(np.clip(np.searchsorted(self.t, time) - 1, 0, len(self.t) - 2))
        h = self.t[k + 1] - self.t[k]
        s = (time - self.t[k]) / h
        q0, q1, v0, v1 = self.q[k], self.q[k + 1], self.v[k], self.v[k + 1]
        q = (1 + 2 * s) * (1 - s) ** 2 * q0 + s * s * (3 - 2 * s) * q1
        q = q + h * s * (1 - s) * ((1 - s) * v0 - s * v1)
        v = 6 * s * (1 - s) * (q1 - q0) / h
        return q, v + (1 - s) * (1 - 3 * s) * v0 + s * (3 * s - 2) * v1


class Judge:
    """Findings on one motion.

    Attributes:
        faults: Reasons that refute it, in short sentences.
        figures: Measured values.
    """

    def __init__(self, case: Mapping[str, Any], table: Table) -> None:
        self.case, self.table = case, table
        self.member = read_member(case["arms"][0], case["gravity"])
        self.model = self.member.arm.model
        self.data = self.model.createData()
        self.frame = self.model.getFrameId(case["frame"])
        self.faults: list[str] = []
        self.figures: dict[str, float] = {"T": float(table.t[-1])}
        if table.joints != list(self.member.arm.names):
            raise ValueError(f"the file is about the joints {table.joints}")

    def check(self, value: float, most: float, name: str) -> None:
        """Note a figure, and a fault if it exceeds its limit; NaN is a fault."""
        self.figures[name] = max(self.figures.get(name, -np.inf), float(value))
        if not value <= most:
            self.faults.append(f"{name} {value:.3e} > {most:.1e}")

    def run(self) -> None:
        """Make all checks."""
        table, case = self.table, self.case
        start = np.abs(table.q[0] - np.array(case["q_start"])).max()
        self.check(start, 1e-6, "start")
        self.check(np.abs(table.v[[0, -1]]).max(), REST, "speed at the ends")
        self.check(-np.diff(table.t).min(), -1e-12, "times")
        self.consistency()
        self.limits()
        self.goals()
        if case["kind"] != "via":
            self.constraint()
        self.clearance()

    def consistency(self) -> None:
        """Whether positions, velocities and accelerations are consistent."""
        t, q, v, a = self.table.t, self.table.q, self.table.v, self.table.a
        h = np.diff(t)[:, None]
        mean = np.diff(v, axis=0) / h
        low, high = np.minimum(a[1:], a[:-1]), np.maximum(a[1:], a[:-1])
        # The mean of smooth accelerations is between the values at both ends up to
        # their curvature; where accelerations jump, up to the size of the jump.
        room = 0.02 * (high - low) + 1e-3 * np.abs(a).max(axis=0) + 1e-9 / h
        off = np.maximum(low - mean, mean - high) / room
        self.check(np.percentile(off, 99.0), 1.0, "velocities off accelerations")
        # The error of the trapezoidal rule is an eighth of the jump of accelerations.
        off = np.abs(np.diff(q, axis=0) - 0.5 * h * (v[1:] + v[:-1]))
        off /= 0.126 * h**2 * (high - low + 0.01 * np.abs(a).max(axis=0)) + 1e-9
        self.check(off.max(), 1.0, "positions off velocities")

    def limits(self) -> None:
        """Limits at the samples and halfway between two."""
        table, model = self.table, self.model
        low, high = self.member.position_limits()
        width = np.where(np.isfinite(high - low), high - low, 1.0)
        halves = [self.table.at(t) for t in 0.5 * (table.t[1:] + table.t[:-1])]
        q, v = (np.array(part) for part in zip(*halves, strict=True))
        both = np.vstack([table.q, q])
        self.check(np.max(np.maximum(both - high, low - both) / width), LIMIT, "range")
        jumps, inside = self._where_they_jump()
        fastest = np.where(jumps, inside, v)
        speed = np.abs(np.vstack([table.v, fastest])) / model.velocityLimit
        self.check(speed.max() - 1.0, LIMIT, "speed over limit")
        left = table.u - inverse([self.member], table.q, table.v, table.a)
        # Dry friction opposes movement; at rest and at reversals it may be any share.
        dry, way = self.member.friction, np.sign(table.v)
        stands = np.abs(table.v) < SLOW
        low, high = np.where(stands, -dry, dry * way), np.where(stands, dry, dry * way)
        off = (left - np.clip(left, low, high)) / model.effortLimit
        self.check(np.abs(off).max(), TORQUE, "torques off movement")
        excess = 0.5 * (np.abs(table.u) / model.effortLimit - 1.0)
        self.check(excess.max(), LIMIT, "torque over limit")
        a = np.diff(table.v, axis=0) / np.diff(table.t)[:, None]
        need = inverse([self.member], q, v, a) + dry * np.sign(v)
        smooth = ~jumps & (table.v[1:] * table.v[:-1] >= 0.0)
        excess = np.where(smooth, 0.5 * (np.abs(need) / model.effortLimit - 1.0), -1.0)
        self.check(excess.max(), 2.0 * LIMIT, "torque between samples")

    def _where_they_jump(self) -> tuple[NDArray[np.bool_], Array]:
        """Times of jumps of accelerations between samples, and the velocities there.

        A cubic overshoots there; the velocity has a kink between two slopes.
        """
        t, v, a = self.table.t, self.table.v, self.table.a
        h = np.diff(t)[:, None]
        jumps = np.abs(np.diff(a, axis=0)) >= 0.05 * np.abs(a).max(axis=0)
        apart = np.where(jumps, a[:-1] - a[1:], 1.0)
        after = np.clip((np.diff(v, axis=0) - a[1:] * h) / apart, 0.0, h)
        return jumps, v[:-1] + a[:-1] * after

    def goals(self) -> None:
        """Check that the goals are reached in their order."""
        t, begin = self.table.t, 0
        for number, goal in enumerate(self.case["goals"]):
            miss = self._miss(goal)
            last = number == len(self.case["goals"]) - 1
            if last:
                self.check(miss(float(t[-1])), GOAL, f"goal {number + 1} missed by")
                break
            every = np.array([miss(float(time)) for time in t[begin:]])
            nearest, found = np.inf, begin
            lows = np.flatnonzero(
                (every <= np.append(every[1:], np.inf))
                & (every <= np.append(np.inf, every[:-1]))
            )
            for k in lows:
                first, end = max(begin + k - 1, 0), min(begin + k + 1, len(t) - 1)
                low = minimize_scalar(
                    miss,
                    bounds=(t[first], t[end]),
                    method="bounded",
                    options={"xatol": 1e-9},
                )
                if low.fun < nearest:
                    nearest, found = float(low.fun), begin + int(k)
                if nearest <= GOAL:
                    break
            self.check(nearest, GOAL, f"goal {number + 1} missed by")
            begin = found

    def _miss(self, goal: Mapping[str, Any]) -> Callable[[float], float]:
        """Distance of the motion from a goal, as a function of time."""
        if goal["kind"] == "joint":
            target = np.array(goal["q"])
            return lambda t: float(np.abs(self.table.at(t)[0] - target).max())
        position = np.array(goal["position"])
        rotation = np.array(goal["rotation"])

        def miss(t: float) -> float:
            place = self._tool(self.table.at(t)[0])
            off = float(np.linalg.norm(place.translation - position))
            if goal["kind"] == "position":
                return off
            return max(
                off, float(np.linalg.norm(pin.log3(place.rotation.T @ rotation)))
            )

        return miss

    def _tool(self, q: Array) -> pin.SE3:
        place = self.member.configuration(q)
        pin.framesForwardKinematics(self.model, self.data, place)
        return self.data.oMf[self.frame]

    def constraint(self) -> None:
        """Check the cone of the tool, or its speed, at ten instants per sample."""
        times = np.linspace(0.0, self.table.t[-1], 10 * len(self.table.t))
        if self.case["kind"] == "upright":
            axis, worst = np.array(self.case["axis"]), 0.0
            for time in times:
                turned = self._tool(self.table.at(float(time))[0]).rotation @ axis
                across = float(np.hypot(turned[0], turned[1]))
                worst = max(worst, float(np.arctan2(across, turned[2])))
            self.check(worst / self.case["tolerance"] - 1.0, LIMIT, "tilt over cone")
            return
        worst = 0.0
        for time in times:
            q, v = self.table.at(float(time))
            jacobian = pin.computeFrameJacobian(
                self.model,
                self.data,
                self.member.configuration(q),
                self.frame,
                pin.ReferenceFrame.LOCAL,
            )
            worst = max(worst, float(np.linalg.norm(jacobian[:3] @ v)))
        self.check(worst / self.case["limit"] - 1.0, LIMIT, "tool speed over limit")

    def clearance(self) -> None:
        """Check the exact distances to obstacles and between links."""
        obstacles = [read_obstacle(item) for item in self.case["obstacles"]]
        cell = Cell([self.member], obstacles, self.case["margin"])
        times = np.linspace(0.0, self.table.t[-1], 2 * len(self.table.t))
        q = np.array([self.table.at(float(time))[0] for time in times])
        found = cell.at(times).closest(q)
        self.figures["clearance"] = float(found.distance)
        if not found.distance > -CONTACT:
            self.faults.append(
                f"room of {found.distance * 1e3:.4f} mm between {found.first} and "
                f"{found.second} at {times[found.sample]:.4f} s"
            )


def main() -> int:
    """Judge the motion named on the command line."""
    return judge_named(__doc__, lambda case, path: Judge(case, Table(path)))


if __name__ == "__main__":
    sys.exit(main())
