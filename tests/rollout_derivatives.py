"""Derivatives of a rollout by its steps, one composed with the other."""

from __future__ import annotations

from tominpmp.dynamics import Dynamics
from tominpmp.transcription.integrator import (
    Rollout,
    Sensitivities,
    compose_steps,
    differentiate_defects,
)


def differentiate_rollout(dynamics: Dynamics, motion: Rollout) -> Sensitivities:
    """Exact derivatives of each interval of an integrated motion."""
    by = differentiate_defects(
        dynamics, motion.x[:-1], motion.x[1:], motion.u, motion.h, motion.inner
    )
    return compose_steps(by, motion.substeps)
