"""Motions integrated forward from torques: states at instants, and derivatives."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.dynamics import Dynamics
from tominpmp.transcription.instants import Instants
from tominpmp.transcription.integrator import (
    DefectJacobians,
    Rollout,
    Sensitivities,
    compose_steps,
    differentiate_defects,
    stage_weights,
    stage_weights_by_share,
)


@dataclass(frozen=True, eq=False)
class Shot:
    """A motion integrated forward.

    Attributes:
        dynamics: Equations of motion.
        rollout: The motion, step by step.
        u: Torques of the intervals, shape (N, n) [N m or N].
        h: Lengths of the intervals [s], shape (N,).
    """

    dynamics: Dynamics
    rollout: Rollout
    u: Array
    h: Array

    @property
    def finite(self) -> bool:
        """Whether it could be integrated to its end."""
        return self.rollout.finite

    @property
    def x(self) -> Array:
        """States at the nodes, shape (N + 1, 2n)."""
        return self.rollout.nodes

    @property
    def substeps(self) -> int:
        """Steps of an interval."""
        return self.rollout.substeps

    @cached_property
    def defects(self) -> DefectJacobians:
        """Derivatives of the steps, and of their inner stages."""
        steps = self.rollout
        x = steps.x
        return differentiate_defects(
            self.dynamics, x[:-1], x[1:], steps.u, steps.h, steps.inner
        )

    @cached_property
    def sensitivities(self) -> Sensitivities:
        """Derivatives of each step; by the length of its interval."""
        by = compose_steps(self.defects, 1)
        return by._replace(c=by.c / self.substeps)

    def steps(self, at: Instants) -> tuple[IntArray, Array]:
        """Steps that instants are in, and where in them, shape (m,) each."""
        place = at.share * self.substeps
        inside = np.clip(np.ceil(place) - 1, 0, self.substeps - 1).astype(np.int64)
        return at.interval * self.substeps + inside, place - inside

    def states(self, at: Instants) -> Array:
        """States at instants, shape (m, 2n)."""
        step, share = self.steps(at)
        return self._weighted(stage_weights(share), step)

    def rates(self, at: Instants) -> Array:
        """Derivatives by time of the states at instants, shape (m, 2n)."""
        step, share = self.steps(at)
        by_share = self._weighted(stage_weights_by_share(share), step)
        return by_share / self.rollout.h[step, None]

    def _weighted(self, weights: Array, step: IntArray) -> Array:
        steps = self.rollout
        x = weights[:, :1] * steps.x[step] + weights[:, 2:] * steps.x[step + 1]
        return np.asarray(x + weights[:, 1:2] * steps.inner[step])
