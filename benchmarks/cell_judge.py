"""Judging the motion of a cell, without the library: a separate program.

    python benchmarks/cell_judge.py CASE.json MOTION.npz

It reads the specification (``CASE.json``) and the motion planned for it
(``MOTION.npz``), prints its findings as JSON, and exits with 1 if it refutes the
motion. No code of the library is imported: the arms are built from their URDF files by
Pinocchio, links are the triangle meshes of the descriptions; dry friction, payloads,
the placements of the bases and moving obstacles are computed here.

A motion is refuted if

- it does not begin at the start, or has a jump in position or velocity;
- its torques differ from the inverse dynamics of the movement (by 1e-5 of their range),
  with dry friction against the movement to a tenth of a microsecond, or, if the torques
  are given, do not lead along the movement;
- torques integrated from the start, with a feedback of at most 0.2 % of their range,
  miss the goal, or deviate from their movement by more than 1 mrad;
- a limit of position, velocity or torque, or a specified limit of acceleration or jerk,
  is exceeded by more than 0.5 %;
- links come closer to an obstacle or to links of the same or another arm than the
  margin, by exact distances every millisecond, and denser where clearance is small.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.integrate import solve_ivp

if not __package__:  # run as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.cell_arms import inverse, read_member
from benchmarks.cell_clearance import Cell, read_obstacle
from benchmarks.cell_dynamics import Plant
from benchmarks.cell_movement import Movement, read_movement
from benchmarks.exact_geometry import Array
from benchmarks.verdicts import judge_named

GOAL, SPEED, LIMIT = 1.1e-3, 1.1e-2, 5.5e-3
TORQUE = 1e-5  # of the range: tolerated difference of torques from the inverse dynamics
JUMP = 1e-6  # of positions and velocities at the nodes
DEVIATION = 1e-3  # [rad or m] from the movement
FEEDBACK = 2e-3  # of the range of the torque
RATE = 30.0  # of that feedback [1/s]
TIME_STEP = 1e-3


class Judge:
    """Findings on one motion.

    Attributes:
        faults: Reasons that refute it, in short sentences.
        figures: Measured values.
    """

    def __init__(self, case: Mapping[str, Any], movement: Movement) -> None:
        self.case, self.movement = case, movement
        self.members = [read_member(x, case["gravity"]) for x in case["arms"]]
        self.faults: list[str] = []
        self.figures: dict[str, float] = {"T": float(movement.t[-1])}
        stack = [member.arm.model for member in self.members]
        self.low, self.high = np.hstack([m.position_limits() for m in self.members])
        self.speed = np.concatenate([m.velocityLimit for m in stack])
        self.effort = np.concatenate([m.effortLimit for m in stack])
        self.plant = Plant(self.members, movement)

    def check(self, ok: bool, sentence: str) -> None:
        """Note a fault; NaN makes ``ok`` false."""
        if not ok:
            self.faults.append(sentence)

    def run(self) -> None:
        """Make all checks."""
        self.ends_and_jumps()
        self.limits_and_torques()
        t, q, v = self.replay()
        self.goal(q[-1], v[-1])
        self.clearance(t, q)

    def ends_and_jumps(self) -> None:
        """Check the start, and the continuity of the pieces."""
        move, case = self.movement, self.case
        off = np.abs(move.q[0] - np.array(case["q_start"])).max()
        slow = np.abs(move.v[0] - np.array(case["v_start"])).max()
        self.check(off < 1e-6 and slow < 1e-5, f"start: {off:.1e} {slow:.1e} off")
        worst = 0.0
        for k in range(len(move.t) - 1):
            q, v, _, _ = move.between(k, np.array([0.0, 1.0]))
            worst = max(
                worst,
                np.abs(q[0] - move.q[k]).max(),
                np.abs(q[1] - move.q[k + 1]).max(),
                np.abs(v[0] - move.v[k]).max() * 0.1,
                np.abs(v[1] - move.v[k + 1]).max() * 0.1,
            )
        self.figures["jump"] = float(worst)
        self.check(worst < JUMP, f"jump of {worst:.1e} at a node")

    def limits_and_torques(self) -> None:
        """Check limits at ten instants of each piece, and torques of the movement."""
        move = self.movement
        s = np.concatenate([[0.0], (np.arange(10) + 0.5) / 10.0, [1.0]])
        excess = dict.fromkeys(
            ("position", "velocity", "effort", "acceleration", "jerk", "torque"), -1.0
        )
        for k in move.pieces:
            q, v, a, jerk = move.state(k, s)
            u = move.torque(k, s)
            width = np.where(np.isfinite(self.high - self.low), self.high - self.low, 1)
            worst = {
                "position": np.maximum(q - self.high, self.low - q) / width,
                "velocity": np.abs(v) / self.speed - 1.0,
                "effort": 0.5 * (np.abs(u) / self.effort - 1.0),
            }
            for name, values in (("acceleration", a), ("jerk", jerk)):
                limit = self.case.get(name)
                if limit is not None:
                    worst[name] = np.abs(values) / np.array(limit) - 1.0
            if not move.held:
                worst["torque"] = self._residual(k, s, (q, v, a), u) / self.effort
            for name, values in worst.items():
                excess[name] = max(excess[name], float(np.max(values)))
        self.figures |= {f"{name}_excess": value for name, value in excess.items()}
        for name, value in excess.items():
            most = TORQUE if name == "torque" else LIMIT
            self.check(value <= most, f"{name} off by {value:.2e}")

    def _residual(
        self, p: int, s: Array, state: tuple[Array, Array, Array], u: Array
    ) -> Array:
        """Given torque minus required torque."""
        need = inverse(self.members, *state)
        return np.asarray(np.abs(u - need - self.plant.dry(p, s, state, u)))

    def replay(self) -> tuple[Array, Array, Array]:
        """Integrate the torques from the start, with little feedback."""
        move = self.movement
        n = move.q.shape[1]
        x = np.concatenate([self.case["q_start"], self.case["v_start"]])
        times, states, trace = [np.zeros(1)], [x], np.zeros(n)
        for k in move.pieces:
            begin, end = move.breaks[k], move.breaks[k + 1]
            h = end - begin

            def parts(
                t: float, x: Array, k: int = k, begin: float = begin, h: float = h
            ):
                s = np.array([np.clip((t - begin) / h, 0.0, 1.0)])
                q, v, a, _ = move.state(k, s)
                pull = RATE * (RATE * (q[0] - x[:n]) + 2 * (v[0] - x[n:]))
                u = move.torque(k, s)
                # The sign of dry friction is that of the movement, which makes the
                # integrated functions smooth; the feedback compensates for the
                # difference.
                left = u - self.plant.dry(k, s, (q, v, a), u)
                return left[0], pull, v[0]

            def slope(t: float, x: Array) -> Array:
                left, pull, planned = parts(t, x)
                return np.concatenate(
                    [x[n:], self.plant.forward(x, left, pull, planned)]
                )

            steps = max(1, int(np.ceil(h / TIME_STEP - 1e-9)))
            ticks = np.linspace(begin, end, steps + 1)[1:]
            out = solve_ivp(
                slope, (begin, end), x, "LSODA", ticks, rtol=1e-9, atol=1e-10
            )
            if not out.success or not np.all(np.isfinite(out.y)):
                self.check(False, f"replay ended at {begin:.4f} s: {out.message}")
                break
            x = out.y[:, -1]
            times.append(out.t)
            states.extend(out.y.T)
            _, pull, _ = parts(float(ticks[-1]), x)
            trace = np.maximum(trace, np.abs(self.plant.mass_times(x[:n], pull)))
        t, path = np.concatenate(times), np.array(states)
        share = float(np.max(trace / (2.0 * self.effort)))
        self.figures["feedback"] = share
        self.check(share <= FEEDBACK, f"feedback of {share:.1e} of the range")
        k = np.clip(np.searchsorted(move.t, t, side="right") - 1, 0, len(move.t) - 2)
        s = (t - move.t[k]) / np.diff(move.t)[k]
        plan = np.array(
            [
                move.between(int(i), np.array([z]))[0][0]
                for i, z in zip(k, s, strict=True)
            ]
        )
        away = float(np.abs(path[:, :n] - plan).max())
        self.figures["deviation"] = away
        # Between the nodes given torques deviate somewhat from the polynomials.
        near = away <= DEVIATION or move.held
        self.check(near, f"replay leaves the movement by {away:.1e}")
        return t, path[:, :n], path[:, n:]

    def goal(self, q: Array, v: Array) -> None:
        """Check that the replay ends at the goal."""
        goal = self.case["goal"]
        if goal["kind"] == "joint":
            off = float(np.abs(q - np.array(goal["q"])).max())
            speed = float(np.abs(v - np.array(goal["v"])).max())
        else:
            member = self.members[0]
            model, data = member.arm.model, member.arm.model.createData()
            pin.framesForwardKinematics(
                model, data, member.configuration(q[: member.n])
            )
            place = member.base * data.oMf[model.getFrameId(goal["frame"])]
            off = float(np.linalg.norm(place.translation - np.array(goal["position"])))
            speed = float(np.abs(v).max())
        self.figures |= {"goal_error": off, "goal_speed": speed}
        self.check(off <= GOAL, f"goal missed by {off:.1e}")
        self.check(speed <= SPEED, f"{speed:.1e} too fast at the goal")

    def clearance(self, t: Array, q: Array) -> None:
        """Check the exact distances to obstacles and between links."""
        obstacles = [read_obstacle(item) for item in self.case["obstacles"]]
        cell = Cell(self.members, obstacles, self.case["margin"])
        if not len(cell._pairs):
            return
        keep = np.concatenate([[True], np.diff(t) > 1e-9])
        t, q = t[keep], q[keep]
        found = cell.at(t).closest(q)
        self.figures["clearance"] = float(found.distance)
        names = f"{found.first} and {found.second} at {t[found.sample]:.4f} s"
        # The margin may be violated by 0.01 mm, but no bodies may touch.
        least = -1e-5 if self.case["margin"] > 1e-5 else 0.0
        text = f"room of {found.distance * 1e3:.4f} mm between {names}"
        self.check(found.distance > least, text)
        if found.distance > 2e-3:
            return
        # Where clearance is small, inspect twenty times as densely.
        k = found.sample
        first, last = max(k - 3, 0), min(k + 3, len(t) - 1)
        near = np.linspace(t[first], t[last], 121)
        dense = np.array([np.interp(near, t, column) for column in q.T]).T
        found = cell.at(near).closest(dense)
        text = f"room of {found.distance * 1e3:.4f} mm between samples of {names}"
        self.check(found.distance > 2.0 * least, text)


def main() -> int:
    """Judge the motion named on the command line."""
    return judge_named(__doc__, lambda case, path: Judge(case, read_movement(path)))


if __name__ == "__main__":
    sys.exit(main())
