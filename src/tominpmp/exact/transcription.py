"""Solved arcs with the interface of other programs, for the records of plans.

The rows are the goal, the speeds at the entries of arcs on which a joint is held at its
speed limit, and the limits to which the margin of the motion is small.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import BarycentricInterpolator

from tominpmp.arrays import Array
from tominpmp.exact.held_joints import differentiate_rates
from tominpmp.exact.radau import NODES
from tominpmp.exact.shooting import ArcProgram, Shot
from tominpmp.motion.trajectory import Trajectory
from tominpmp.transcription.base import NOT_INTEGRATED
from tominpmp.transcription.rows import Rows

# Names of the kinds of rows: equations first, then "goal region", then watched limits.
EQUATIONS = ("goal", "speed")
LIMITS = ("position", "velocity", "torque", "clearance")
# Number of parts of a step with a held joint, whose torque changes during the step.
CUTS = 4
# Steps shorter than this share of the duration are left out of the motion.
VANISHED = 1e-9


class ArcTranscription:
    """The program of arcs with the interface of :class:`ProgramInterface`.

    Attributes:
        program: The program, which has the same unknowns.
        rows: Bounds, kinds and groups of the rows.
    """

    def __init__(self, program: ArcProgram, shot: Shot) -> None:
        self.program = program
        watched = program.watched.kind  # sorted
        entries = int(program.arcs.entries.sum())
        counts = [shot.equal.size - entries, entries, shot.margin.size - watched.size]
        counts += np.bincount(watched, minlength=len(LIMITS)).tolist()
        names = (*EQUATIONS, "goal region", *LIMITS)
        parts = []
        for name, count in zip(names, counts, strict=True):
            most = np.full(count, 0.0 if name in EQUATIONS else np.inf)
            group = np.zeros(count, dtype=np.int64)
            if count:
                parts.append((name, np.zeros(count), most, group))
        self.rows = Rows.stack(parts)

    @property
    def cost(self) -> Array:
        """Gradient of the duration."""
        count = self.program.arcs.count
        return np.where(
            np.arange(self.program.size) < count, self.program.duration, 0.0
        )

    def evaluate(self, z: Array, attention: float = np.inf) -> Array:
        """Row values."""
        shot = self.program.shoot(z)
        if shot is None:
            return np.full(self.rows.size, -NOT_INTEGRATED)
        return np.concatenate([shot.equal, shot.margin])

    def time_scale(self, z: Array, factor: float) -> Array:
        """Iterate with the same torques on longer arcs."""
        out = z.copy()
        out[: self.program.arcs.count] *= factor
        return out

    def trajectory(self, z: Array) -> Trajectory:
        """The motion of an iterate, with nodes at the ends of all steps."""
        program, system = self.program, self.program.system
        shot = program.shoot(z)
        if shot is None:
            raise ValueError("the motion cannot be integrated")
        motion, arcs, n = shot.motion, program.unpack(z), system.n
        u = system.effort_middle + system.effort_half * arcs.levels[program.arc_of_step]
        steps = np.flatnonzero(motion.h > VANISHED * motion.h.sum())
        parts = np.where(program.modes.any(axis=1), CUTS, 1)
        of = np.repeat(steps, parts[steps])
        parts, part = parts[of], np.arange(of.size) - np.searchsorted(of, of)
        # Collocation polynomials through the starts and the stages of the steps.
        known, ticks = np.append(0.0, NODES), np.arange(1, 2 * CUTS + 1) / (2 * CUTS)
        points = np.concatenate([motion.x[None, :-1], np.swapaxes(motion.stages, 0, 1)])
        inside = BarycentricInterpolator(known, points)(ticks)
        middle = inside[CUTS // parts * (2 * part + 1) - 1, of]
        ends = inside[CUTS // parts * (2 * part + 2) - 1, of]
        held = differentiate_rates(system.dynamics, middle, u[of], program.modes[of])
        torque = np.where(program.follows[of], held.tau, u[of]) + system.resistance
        states = np.vstack([motion.x[:1], ends])
        t = np.append(0.0, np.cumsum(motion.h[of] / parts))
        return Trajectory(
            joint_names=system.problem.robot.joint_names,
            t=t,
            q=states[:, :n],
            v=states[:, n:],
            u=np.concatenate([torque, torque[-1:]]),
            holding=system.dynamics.inverse,
        )
