"""Records of an optimality certificate and of the active limits of a motion."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from tominpmp.arrays import FrozenArray, FrozenFlags, Record
from tominpmp.exceptions import BRIEF, shortened


@dataclass(frozen=True, eq=False)
class ActiveLimit(Record):
    """A limit that is active during a part of a motion.

    Attributes:
        kind: "effort", "velocity", "position", "acceleration", "jerk", "effort rate",
            "effort over speed", "clearance", "arrival", or the name of a constraint.
        name: Name of the joint, of the pair ("link and obstacle"), of the segment, or
            of the subject of the constraint.
        begin: Beginnings of the intervals on which the limit is active [s], shape (m,).
        end: Ends of the intervals [s], shape (m,).
        multiplier: Time gained per time and unit by which the limit is relaxed, shape
            (m,). The unit is a share of the limit; rad or m for positions, m for
            clearances, s for arrivals, and the unit of the quantity for constraints.
        upper: Whether the upper limit is active, otherwise the lower, shape (m,).
    """

    kind: str
    name: str
    begin: FrozenArray
    end: FrozenArray
    multiplier: FrozenArray
    upper: FrozenFlags


@dataclass(frozen=True, eq=False)
class Certificate(Record):
    """How well a motion satisfies the first-order conditions of time-optimality.

    The defaults are those of a motion whose conditions cannot be evaluated.

    Attributes:
        joint_names: Names of the joints, in column order.
        ok: Whether the motion satisfies the conditions, within the tolerance.
        message: The result, in words: how well the conditions are satisfied, or which
            condition fails at which time.
        t: Nodes at which the motion was examined [s], shape (N + 1,).
        costates: Derivatives of the duration with respect to (q, v) [s/rad or s/m,
            s^2/rad or s^2/m], just after the start and just before the other nodes,
            shape (N + 1, 2 n). For several segments the first row repeats the second.
        switching: Switching functions: derivatives of the Hamiltonian with respect to
            the torques, each in units of half its range, mean over the intervals, shape
            (N, n).
        hamiltonian: H, mean over the intervals, shape (N,); 0 at the optimum.
        obeys: Whether the torques obey their switching functions, shape (N, n).
        active: Active limits of the motion.
        hamiltonian_deviation: Largest difference of H from its mean, relative to the
            cost of time, which is 1.
        hamiltonian_mean_deviation: Mean difference of H from its mean, over time.
        sign_share: Share of the time, mean over the joints with a motor, in which the
            torque obeys its switching function: the torque is at the limit that the
            sign requires, the switching function is zero, or their product gains no
            more than the tolerance.
        saturated_share: Share of the time in which an actuator is saturated.
        active_share: Share of the time in which a limit of any kind is active.
        complementarity: Sum of multiplier times slack over all limits, as a share of T.
        stationarity: Predicted reduction of T by changes within a unit trust region, to
            first order and as a share of T: the complementarity, and the gain that only
            the trust region bounds.
        grid_gain: Predicted reduction if torques may also switch within the intervals.
        costate_error: Largest difference between the costates and the adjoint equation,
            integrated over each interval, relative to the largest costate; None for
            several segments, where limits on accelerations or torque rates enter the
            adjoint equation, and where the conditions cannot be evaluated.
        tolerance: Upper bound of ``stationarity``, with the share of T that rounding to
            a clock may have cost.
        seconds: Computation time [s].
    """

    joint_names: tuple[str, ...]
    ok: bool
    message: str
    t: FrozenArray
    costates: FrozenArray
    switching: FrozenArray
    hamiltonian: FrozenArray
    obeys: FrozenFlags
    active: tuple[ActiveLimit, ...] = ()
    hamiltonian_deviation: float = math.inf
    hamiltonian_mean_deviation: float = math.inf
    sign_share: float = 0.0
    saturated_share: float = 0.0
    active_share: float = 0.0
    complementarity: float = math.inf
    stationarity: float = math.inf
    grid_gain: float = math.inf
    costate_error: float | None = None
    tolerance: float = 0.0
    seconds: float = 0.0

    def __bool__(self) -> bool:
        """Whether the motion satisfies the conditions."""
        return self.ok

    def __repr__(self) -> str:
        """Show the result on one line."""
        verdict = "ok" if self.ok else "not ok"
        return f"<Certificate {verdict}: {shortened(self.message, 2 * BRIEF)}>"


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
