"""What splines share as transcriptions: how near a step brings clearances."""

from __future__ import annotations

from abc import abstractmethod

import numpy as np

from tominpmp.transcription.base import M, StepBounds, Transcription

# Clearances beyond this, in shares of the reach per rad of trust region, are no rows of
# the linear program: a step that uses them up all the same is cut short by the merit.
ATTENTION = 0.07
# However far it reaches; beyond this clearances are not exact.
MAX_ATTENTION = 0.05


class CurveTranscription(Transcription[M]):
    """A transcription whose first unknowns are points of the curve."""

    @property
    @abstractmethod
    def point_unknowns(self) -> int:
        """Number of the unknowns that are positions of points."""

    def attention(self, steps: StepBounds) -> float:
        """What a step of the points can use up."""
        radius = float(np.max(steps.upper[: self.point_unknowns], initial=0.0))
        return min(ATTENTION * radius, MAX_ATTENTION)

    @property
    def cutoff(self) -> float:
        """Clearances beyond this are not exact."""
        return MAX_ATTENTION

    @property
    def moving_attention(self) -> float:
        """Obstacles come closer as time goes by."""
        return MAX_ATTENTION
