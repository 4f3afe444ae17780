"""Allowances for a predicted gain: a controller's clock, and bounds on all motions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tominpmp.certificate.certificate import Certificate
from tominpmp.motion.trajectory import Trajectory
from tominpmp.options import FEWEST_PERIODS

# Rounding of the number of periods of a segment, and largest speed of a joint at rest
# [rad/s or m/s].
SAME = 1e-6


def clock_share(trajectory: Trajectory, period: float) -> float:
    """Share of its duration that rounding to whole periods may have cost a motion.

    Each segment is rounded by itself, by less than a period. A part of the motion from
    rest to rest that takes no more periods than the fewest of any motion on a clock may
    be rounding as a whole.

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
    """The certificate of an admissible motion with a lower bound on T.

    Where the bound shows that no motion is faster by more than the tolerance, a larger
    predicted gain of first order does not count.

    Args:
        found: The certificate.
        duration: Duration of the motion [s].
        bound: Lower bound on the duration of all motions [s].
        reason: Reason of the bound, in words.
    """
    if found.ok or bound < (1.0 - found.tolerance) * duration:
        return found
    message = (
        f"No motion takes less than {bound:.4g} s ({reason}), and this one takes "
        f"{duration:.4g} s. {found.message}"
    )
    return replace(found, ok=True, message=message)
