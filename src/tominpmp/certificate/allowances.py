"""Allowances for a predicted gain: the clock of a controller, and lower bounds on T."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tominpmp.certificate.certificate import Certificate
from tominpmp.motion.trajectory import Trajectory
from tominpmp.options import FEWEST_PERIODS

# Rounding error of the number of periods of a segment, and largest speed of a joint at
# rest [rad/s or m/s].
SAME = 1e-6


def clock_share(trajectory: Trajectory, period: float) -> float:
    """Share of the duration of a motion that rounding to whole periods may have cost.

    The duration of each segment is rounded up separately, by less than a period. A part
    of the motion from rest to rest that takes no more periods than the fewest of any
    motion on a clock may be due to rounding as a whole.

    Args:
        trajectory: The motion.
        period: Period of the clock [s].
    """
    if not trajectory.duration:
        return 0.0
    ends = trajectory.segment_ends
    ends = trajectory.t[-1:] if ends is None else ends
    durations = np.diff(ends, prepend=0.0)
    speeds = np.abs(trajectory.v[np.searchsorted(trajectory.t, ends)])
    rests = np.all(speeds <= SAME, axis=1)
    part = np.cumsum(rests) - rests
    shortest = np.bincount(part, durations) <= (FEWEST_PERIODS + SAME) * period
    rounding = np.where(shortest[part], durations, np.minimum(durations, period))
    return float(rounding.sum() / trajectory.duration)


def with_bound(
    certificate: Certificate, duration: float, bound: float, reason: str
) -> Certificate:
    """The certificate of an admissible motion in view of a lower bound on T.

    If the bound shows that no motion is faster by more than the tolerance, failures of
    the first-order conditions are disregarded.

    Args:
        certificate: The certificate.
        duration: Duration of the motion [s].
        bound: Lower bound on the duration of all motions [s].
        reason: Reason of the bound, in words.
    """
    if certificate.ok or bound < (1.0 - certificate.tolerance) * duration:
        return certificate
    message = (
        f"No motion takes less than {bound:.4g} s ({reason}), and this motion takes "
        f"{duration:.4g} s. {certificate.message}"
    )
    return replace(certificate, ok=True, message=message)
