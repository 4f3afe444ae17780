"""Derivatives of a rollout over its intervals, chained from those of its steps."""

from __future__ import annotations

from tominpmp.transcription.integrator import StepJacobians, SteppedMotion


def differentiate_rollout(motion: SteppedMotion) -> StepJacobians:
    """Exact derivatives of each interval of an integrated motion."""
    by, substeps = motion.sensitivities, motion.substeps
    A, B, c = (part[::substeps].copy() for part in by)
    for s in range(1, substeps):
        step = by.A[s::substeps]
        A, B = step @ A, step @ B + by.B[s::substeps]
        c = (step @ c[..., None])[..., 0] + by.c[s::substeps]
    return StepJacobians(A, B, c)
