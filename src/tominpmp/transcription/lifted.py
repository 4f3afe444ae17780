"""Motions whose states and torques are unknowns: states at instants, and defects."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.dynamics import Dynamics, ForwardJacobians
from tominpmp.transcription.instants import Instants
from tominpmp.transcription.integrator import (
    DefectJacobians,
    Stage,
    differentiate_defects,
    evaluate_defects,
    solve_inner_stage,
    stage_weights,
    stage_weights_by_share,
)


@dataclass(frozen=True, eq=False)
class LiftedMotion:
    """States and torques of an iterate, which need not be a motion yet.

    Attributes:
        dynamics: Equations of motion.
        x: States at the nodes, shape (N + 1, 2n).
        u: Torques of the intervals, shape (N, n) [N m or N].
        h: Lengths of the intervals [s], shape (N,).
    """

    dynamics: Dynamics
    x: Array
    u: Array
    h: Array
    finite: bool = True

    @cached_property
    def stage(self) -> Stage:
        """Inner stages of the steps."""
        return solve_inner_stage(self.dynamics, self.x[:-1], self.x[1:], self.u, self.h)

    @cached_property
    def defects(self) -> Array:
        """Defects of the steps, shape (N, 2n)."""
        return evaluate_defects(
            self.dynamics, self.x[:-1], self.x[1:], self.u, self.h, self.stage.x
        )

    @cached_property
    def derivatives(self) -> DefectJacobians:
        """Derivatives of defects and inner stages."""
        return differentiate_defects(
            self.dynamics, self.x[:-1], self.x[1:], self.u, self.h, self.stage.x
        )

    def states(self, at: Instants) -> Array:
        """States at instants, shape (m, 2n)."""
        return self._weighted(stage_weights(at.share), at.interval)

    def rates(self, at: Instants) -> Array:
        """Derivatives by time of the states at instants, shape (m, 2n)."""
        by_share = self._weighted(stage_weights_by_share(at.share), at.interval)
        return by_share / self.h[at.interval, None]

    def _weighted(self, weights: Array, k: IntArray) -> Array:
        x = weights[:, :1] * self.x[k] + weights[:, 2:] * self.x[k + 1]
        if np.any(weights[:, 1]):
            x = x + weights[:, 1:2] * self.stage.x[k]
        return np.asarray(x)

    def slopes(self, at: Instants) -> ForwardJacobians:
        """Derivatives of the states at instants, and theirs."""
        return self.dynamics.forward_jacobians(self.states(at), self.u[at.interval])
