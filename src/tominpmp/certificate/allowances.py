"""What a promise is held against: a controller's clock, and bounds on all motions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tominpmp.certificate.certificate import Certificate
from tominpmp.motion.trajectory import Trajectory
from tominpmp.options import FEWEST_PERIODS

# Periods of a segment are counted up to this share of one, and joints that are no
# faster are at rest [rad/s or m/s].
SAME = 1e-6


def clock_share(trajectory: Trajectory, period: float) -> float:
    """Share of its duration that rounding to whole periods may have cost a motion.

    Each segment is rounded by itself, by less than a period; from one rest to the next
    all is lost where that takes no more periods than any motion on a clock.

    Args:
        trajectory: The motion.
        period: The period [s].
    """
    if not trajectory.duration:
        return 0.0
    ends = trajectory.segment_ends
    ends = trajectory.t[-1:] if ends is None else ends
    lengths = np.diff(ends, prepend=0.0)
    speeds = np.abs(trajectory.v[np.searchsorted(trajectory.t, ends)])
    rests = np.all(speeds <= SAME, axis=1)
    run = np.cumsum(rests) - rests
    few = np.bincount(run, lengths) <= (FEWEST_PERIODS + SAME) * period
    lost = np.where(few[run], lengths, np.minimum(lengths, period))
    return float(lost.sum() / trajectory.duration)


def with_bound(
    found: Certificate, duration: float, bound: float, reason: str
) -> Certificate:
    """The certificate of an admissible motion with what is known of all motions.

    Where none is faster by more than small changes may promise, a promise of first
    order that is larger does not count.

    Args:
        found: The certificate.
        duration: Of the motion [s].
        bound: No motion takes less [s].
        reason: Why.
    """
    if found.ok or bound < (1.0 - found.tolerance) * duration:
        return found
    message = (
        f"No motion takes less than {bound:.4g} s ({reason}), and this one takes "
        f"{duration:.4g} s. {found.message}"
    )
    return replace(found, ok=True, message=message)
