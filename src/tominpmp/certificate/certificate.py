"""Records of a certificate of the minimum principle, and of the active limits."""

from __future__ import annotations

from dataclasses import dataclass

from tominpmp.arrays import FrozenArray, FrozenFlags, Record
from tominpmp.exceptions import BRIEF, shortened


@dataclass(frozen=True, eq=False)
class ActiveLimit(Record):
    """A limit that is active in a motion for some of the time.

    Attributes:
        kind: "effort", "velocity", "position", "acceleration", "jerk", "effort rate",
            "effort over speed", "clearance" or "arrival".
        name: The joint, the pair as "one and other", or the segment.
        begin: Beginnings of the intervals on which it is active [s], shape (m,).
        end: Ends of these intervals [s], shape (m,).
        multiplier: Time gained per time and unit of the limit: its share, rad or m,
            shape (m,).
        upper: Whether the upper side is active, shape (m,).
    """

    kind: str
    name: str
    begin: FrozenArray
    end: FrozenArray
    multiplier: FrozenArray
    upper: FrozenFlags


@dataclass(frozen=True, eq=False)
class Certificate(Record):
    """How near a motion is to the first-order conditions of a time-optimal one.

    Attributes:
        joint_names: Names of the joints, in column order.
        ok: Whether the motion keeps the conditions, within the tolerance.
        message: The result, in words: how well the conditions are kept, or which of
            them fails where.
        t: Nodes at which the motion was examined [s], shape (N + 1,).
        costates: Derivatives of the duration by (q, v) [s/rad or s/m, s^2/rad or
            s^2/m], just after the start and just before the other nodes, shape
            (N + 1, 2 n).
        switching: Derivatives of the Hamiltonian by the torques, each in units of half
            its range, mean over the intervals, shape (N, n).
        hamiltonian: H, mean over the intervals, shape (N,); 0 at the optimum.
        obeys: Whether the torques obey their switching functions, shape (N, n).
        active: Active limits of the motion.
        hamiltonian_deviation: Largest difference of H to its mean, relative to the cost
            of time, which is 1.
        hamiltonian_mean_deviation: Mean of that difference over time.
        sign_share: Share of the time, mean over the joints, in which the torque obeys
            its switching function: it is at the limit that the sign asks for, or the
            switching function is zero.
        saturated_share: Share of the time in which an actuator is saturated.
        active_share: Share of the time in which a limit of any kind is active.
        complementarity: Sum of multiplier times slack over all limits, as a share of T.
        stationarity: Predicted reduction of T by changes within a unit trust region, to
            first order and as a share of T: the complementarity, and the gain that only
            the trust region bounds.
        grid_gain: Predicted reduction if torques may switch within the intervals, too.
        costate_error: Largest difference of the costates to the adjoint equation,
            integrated over each interval, relative to the largest costate; None where
            limits on accelerations or torque rates enter it.
        tolerance: Upper bound of ``stationarity``.
        seconds: Time of the computation [s].
    """

    joint_names: tuple[str, ...]
    ok: bool
    message: str
    t: FrozenArray
    costates: FrozenArray
    switching: FrozenArray
    hamiltonian: FrozenArray
    obeys: FrozenFlags
    active: tuple[ActiveLimit, ...]
    hamiltonian_deviation: float
    hamiltonian_mean_deviation: float
    sign_share: float
    saturated_share: float
    active_share: float
    complementarity: float
    stationarity: float
    grid_gain: float
    costate_error: float | None
    tolerance: float
    seconds: float

    def __bool__(self) -> bool:
        """Whether the motion keeps the conditions."""
        return self.ok

    def __repr__(self) -> str:
        """The result, on one line."""
        found = "ok" if self.ok else "not ok"
        return f"<Certificate {found}: {shortened(self.message, 2 * BRIEF)}>"
