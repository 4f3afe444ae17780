"""Arcs as a transcription, so that reports and certificates read them like any other.

The rows are the goal, the entries of arcs on which a joint is held at its speed limit,
and the limits that the motion comes near to.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.interpolate import BarycentricInterpolator

from tominpmp.arrays import Array
from tominpmp.exact.held_joints import FOLLOWS, HOLDS, differentiate_rates
from tominpmp.exact.radau import NODES
from tominpmp.exact.shooting import ArcProgram, Shot
from tominpmp.motion.trajectory import Trajectory
from tominpmp.transcription.base import Linearization, StepBounds, Variation
from tominpmp.transcription.rows import Rows

# Kinds of rows in their order: equations, bounds of the goal, and watched limits.
EQUATIONS = ("goal", "speed")
LIMITS = ("position", "velocity", "torque", "clearance")
# The torque of a held joint changes all the time: a step is cut this often for it.
CUTS = 4
# Lengths change by this share of the duration and of the trust region at most.
LENGTH_STEP = 0.3
NOT_INTEGRATED = 1e3
# Steps shorter than this share of the duration are left out: nothing moves in them.
VANISHED = 1e-9


class ArcTranscription:
    """A problem in the lengths of arcs and torques between their limits.

    Attributes:
        program: The program; its unknowns are those of the transcription.
        rows: What the rows are.
    """

    def __init__(self, program: ArcProgram, shot: Shot) -> None:
        self.program = program
        goals, watched = shot.seeds.shape[0], program.watched.kind  # sorted
        counts = [goals, shot.equal.size - goals, shot.room.size - watched.size]
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
    def size(self) -> int:
        """Number of unknowns."""
        return self.program.size

    @property
    def cost(self) -> Array:
        """Gradient of the duration."""
        count = self.program.arcs.count
        return np.where(np.arange(self.size) < count, self.program.duration, 0.0)

    def evaluate(self, z: Array, room: float = np.inf) -> Array:
        """Row values."""
        shot = self.program.shoot(z)
        if shot is None:
            return np.full(self.rows.size, -NOT_INTEGRATED)
        return np.concatenate([shot.equal, shot.room])

    def linearize(self, z: Array, values: Array, steps: StepBounds) -> Linearization:
        """Jacobian of all rows."""
        shot = self.program.shoot(z)
        if shot is None:
            none = np.zeros(0, dtype=np.int64)
            return Linearization(none, sp.csr_matrix((0, self.size)))
        matrix = sp.csr_matrix(np.vstack([shot.by_equal, shot.by_room]))
        return Linearization(np.arange(self.rows.size), matrix)

    def step_bounds(self, z: Array, radius: float) -> StepBounds:
        """Trust region within the torque limits, and lengths that stay positive."""
        count = self.program.arcs.count
        lengths, levels = z[:count], z[count:]
        reach, length = 2.0 * min(radius, 1.0), LENGTH_STEP * min(radius, 1.0)
        lower = np.concatenate(
            [-np.minimum(lengths, length), np.clip(-1.0 - levels, -reach, 0.0)]
        )
        upper = np.concatenate(
            [np.full(count, length), np.clip(1.0 - levels, 0.0, reach)]
        )
        return StepBounds(lower, upper)

    def attention(self, steps: StepBounds) -> float:
        """All rows matter."""
        return np.inf

    def near(self, z: Array) -> ArcTranscription:
        """The same."""
        return self

    def variation(self, z: Array) -> Variation:
        """Jumps of the torques from arc to arc, in full ranges."""
        arcs = self.program.unpack(z)
        jumps = 0.5 * np.diff(arcs.levels, axis=0)
        column = np.full(arcs.free.shape, -1)
        column[arcs.free] = arcs.count + np.arange(int(arcs.free.sum()))
        matrix = sp.lil_matrix((jumps.size, self.size))
        for row, (k, j) in enumerate(np.ndindex(*jumps.shape)):
            for arc, sign in ((k, -0.5), (k + 1, 0.5)):
                if column[arc, j] >= 0:
                    matrix[row, column[arc, j]] = sign
        matrix = matrix.tocsr()
        return Variation(matrix, jumps.ravel() - matrix @ z)

    def curvature(self, z: Array, multipliers: Array) -> sp.csr_matrix | None:
        """None is known."""
        return None

    def time_scale(self, z: Array, factor: float) -> Array:
        """The same torques on longer arcs."""
        out = z.copy()
        out[: self.program.arcs.count] *= factor
        return out

    def slower(self, z: Array, factor: float, values: Array) -> tuple[Array, Array]:
        """The same torques on longer arcs, which take another path."""
        z = self.time_scale(z, factor)
        return z, self.evaluate(z)

    def trajectory(self, z: Array) -> Trajectory:
        """The motion of an iterate, with nodes at the ends of all steps."""
        program, system = self.program, self.program.system
        shot = program.shoot(z)
        if shot is None:
            raise ValueError("the motion cannot be integrated")
        motion, arcs, n = shot.motion, program.unpack(z), system.n
        of = program.arc_of_step
        u = system.effort_middle + system.effort_half * arcs.levels[of]
        follows = arcs.follows[of]
        modes = HOLDS * (arcs.held[of] != 0) + FOLLOWS * follows
        steps = np.flatnonzero(motion.h > VANISHED * motion.h.sum())
        x, h = motion.x, motion.h
        pieces = []
        known, ticks = np.append(0.0, NODES), np.arange(1, 2 * CUTS + 1) / (2 * CUTS)
        for i in steps.tolist():
            if not modes[i].any():
                pieces.append((x[i + 1 : i + 2], u[i : i + 1], h[i : i + 1]))
                continue
            # Through the start and the stages of the step.
            points = np.vstack([x[i], motion.stages[i]])
            inside = BarycentricInterpolator(known, points)(ticks)
            middle, ends = inside[::2], inside[1::2]
            same_u, same = np.tile(u[i], (CUTS, 1)), np.tile(modes[i], (CUTS, 1))
            rates = differentiate_rates(system.dynamics, middle, same_u, same)
            torque = np.where(follows[i], rates.tau, same_u)
            pieces.append((ends, torque, np.full(CUTS, h[i] / CUTS)))
        ends, torque, h = map(np.concatenate, zip(*pieces, strict=True))
        states, torque = np.vstack([x[:1], ends]), torque + system.resistance
        t = np.concatenate([[0.0], np.cumsum(h)])
        return Trajectory(
            joint_names=system.problem.robot.joint_names,
            t=t,
            q=states[:, :n],
            v=states[:, n:],
            u=np.concatenate([torque, torque[-1:]]),
            holding=system.dynamics.inverse,
        )
