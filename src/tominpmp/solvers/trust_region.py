"""Trust region: how far a linearisation is trusted."""

from __future__ import annotations

from dataclasses import dataclass

# Steps are taken when they bring this share of the predicted reduction (Fletcher,
# 1987).
ACCEPT = 0.1
# Share of the predicted reduction that is aimed for, and how fast the radius follows.
# Found on the random goals of benchmarks/random_goals.py: with the error of a
# linearisation quadratic in the radius, it leads to the radius that loses half.
AIM = 0.5
GROWTH = 2.5
SHRINK = 0.5


@dataclass(frozen=True)
class TrustRegion:
    """Trust region radius, as a share of the initial one.

    Attributes:
        radius: The share.
        smallest: Below this the iteration has stalled.
        largest: It grows no further.
    """

    radius: float = 1.0
    smallest: float = 1e-6
    largest: float = 5.0

    def after(self, ratio: float, damping: float) -> TrustRegion:
        """Radius for the next iteration.

        From the ratio of actual and predicted reduction of the whole step, and the
        share of the step that was taken after a line search.
        """
        if damping < 1.0:
            factor = max(damping, 0.3)
        else:
            # The loss 1 - ratio is proportional to the radius.
            factor = min(max(AIM / max(1.0 - ratio, 1e-3), SHRINK), GROWTH)
        radius = min(self.radius * factor, self.largest)
        return TrustRegion(radius, self.smallest, self.largest)

    @property
    def exhausted(self) -> bool:
        """Whether the radius is too small to get anywhere."""
        return self.radius < self.smallest
