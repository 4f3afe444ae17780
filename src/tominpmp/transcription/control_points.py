"""What transcriptions in control points share, of one duration or of several."""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array, IntArray
from tominpmp.linear_programs.compressed import Compressed
from tominpmp.transcription.base import M, StepBounds
from tominpmp.transcription.curve import CurveTranscription

# A duration changes by this share at most in one step.
LENGTH_STEP = 0.3
# Instants of each interval at which torques are looked at to begin with; those at the
# end of the last one too.
TORQUE_SHARES = (0.0, 0.5)
# Where they are looked at between these: torques of fast wrists rise and fall by half
# of their range within a quarter of an interval.
INSPECTED = (
    (0.0625, 0.125, 0.1875, 0.25, 0.3125, 0.375, 0.4375),
    (0.5625, 0.625, 0.6875, 0.75, 0.8125, 0.875, 0.9375),
)


class _Hung(NamedTuple):
    """How the coordinates of control points hang on the unknowns.

    Attributes:
        column: The unknown that each is, but for what is fixed, shape (M n,); -1 for
            none.
        slopes: How they change with the durations, shape (M n, m); None for not at all.
        alone: Whether no two of them are one unknown.
    """

    column: IntArray
    slopes: Array | None
    alone: bool


class ControlPointTranscription(CurveTranscription[M]):
    """A problem in z = (free control points, durations).

    Attributes:
        map: Control points by the unknowns, shape (points n, size).
        offset: What they are without, shape (points n,).
        free: Number of free control points.
        fixed_end: Whether the final velocity is built in.
    """

    kept = frozenset({"q"})
    inspected = INSPECTED
    highest = 3
    map: sp.csr_matrix
    offset: Array
    free: int
    fixed_end: bool

    @property
    def durations(self) -> int:
        """Number of durations."""
        return int(self.shares.shape[1])

    @property
    def point_unknowns(self) -> int:
        """All but the durations."""
        return self.free * self.system.n

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return self.point_unknowns + self.durations

    def points(self, z: Array) -> Array:
        """Control points, shape (M, n)."""
        return np.asarray(self.map @ z + self.offset).reshape(-1, self.system.n)

    def by_unknowns(
        self, by_points: Array, points: IntArray, by_durations: Array
    ) -> sp.csr_matrix:
        """Derivatives by the unknowns from those by control points and durations.

        Args:
            by_points: By coordinates of control points, shape (k, w).
            points: Which of all coordinates these are, ascending, shape (k, w).
            by_durations: By the durations alone, shape (k, m).
        """
        hung = self._hung
        if hung.slopes is not None:
            by_durations = by_durations + np.einsum(
                "kw,kwm->km", by_points, hung.slopes[points]
            )
        durations = np.arange(self.point_unknowns, self.size)
        columns = np.broadcast_to(durations, by_durations.shape)
        matrix = Compressed.of_table(
            np.concatenate([by_points, by_durations], axis=1),
            np.concatenate([hung.column[points], columns], axis=1),
            self.size,
        ).rows()
        if not hung.alone:
            matrix.sum_duplicates()
        return matrix

    @cached_property
    def _hung(self) -> _Hung:
        """How control points hang on the unknowns."""
        free = self.map[:, : self.point_unknowns].tocsr()
        moved = np.flatnonzero(np.diff(free.indptr))
        column = np.full(self.offset.size, -1)
        column[moved] = free.indices
        slopes = self.map[:, self.point_unknowns :].toarray()
        alone = bool(np.bincount(free.indices, minlength=1).max() <= 1)
        return _Hung(column, slopes if np.any(slopes) else None, alone)

    def unknowns(self, points: Array, eta: Array) -> Array:
        """Unknowns whose control points come nearest to given ones.

        Those that hang together get the mean of what is asked for.

        Args:
            points: Control points, shape (M, n).
            eta: Durations, shape (m,).
        """
        free = self.map[:, : self.point_unknowns]
        wanted = points.ravel() - self.offset - self.map[:, self.point_unknowns :] @ eta
        count = np.maximum(np.asarray(free.sum(axis=0)).ravel(), 1.0)
        return np.concatenate([np.asarray(free.T @ wanted) / count, eta])

    def step_bounds(self, z: Array, radius: float) -> StepBounds:
        """Trust region within position limits and positive durations."""
        limits = self.system.problem.robot.limits
        points = z[: self.point_unknowns].reshape(-1, self.system.n)
        box = np.broadcast_to(radius * self.system.step_scale, points.shape)
        lower = np.maximum(-box, np.minimum(limits.position_lower - points, 0.0))
        upper = np.minimum(box, np.maximum(limits.position_upper - points, 0.0))
        length = min(LENGTH_STEP, radius) * z[self.point_unknowns :]
        return StepBounds(
            np.concatenate([lower.ravel(), -length]),
            np.concatenate([upper.ravel(), length]),
        )

    @property
    def goal_scale(self) -> Array | None:
        """None for a configuration that is built in."""
        built_in = self.system.final_configuration is not None and self.fixed_end
        return None if built_in else super().goal_scale

    def full_range(self, z: Array) -> Array:
        """Accelerations that the full torque ranges bring about at a motion, (n,)."""
        _, q, v, a, _ = self.states(self.motion(z), self.instants(2, ""), 2)
        by = self.system.dynamics.inverse_jacobians(q, v, a)
        mass = np.abs(np.einsum("mii->mi", by.tau_a)).mean(axis=0)
        return np.asarray(2.0 * self.system.effort_half / np.maximum(mass, 1e-12))

    @property
    def torque_sequence(self) -> sp.csr_matrix:
        """Torques at nodes and between them, as they are rows."""
        return sp.csr_matrix(sp.identity(len(TORQUE_SHARES) * self.intervals + 1))

    def stretch(self, z: Array, factor: float) -> Array:
        """The same points, traversed slower."""
        out = z.copy()
        out[self.point_unknowns :] *= factor
        return out
