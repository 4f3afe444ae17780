"""What the linear program about a motion gives."""

from __future__ import annotations

from dataclasses import dataclass

from tominpmp.arrays import Array
from tominpmp.certificate.limit_rows import LimitRows
from tominpmp.certificate.multipliers import Multipliers


@dataclass(frozen=True, eq=False)
class DualSolution:
    """Costates and multipliers that the linear program gives for a motion.

    Attributes:
        costates: Derivatives of the duration by the states just before the nodes 1 to
            N, shape (N, 2 n).
        jumps: By how much costates fall at these nodes, where a limit on the state
            holds, shape (N, 2 n).
        pushes: By how much they fall inside the intervals, at the places nearest to
            where a limit on the state holds: k / PLACES of an interval, shape
            (N, PLACES, 2 n).
        switching: Derivative of the Hamiltonian by the torques, mean over each
            interval, in shares of the torque limits, shape (N, n).
        hamiltonian: Mean of the Hamiltonian over each interval, shape (N,).
        multipliers: Of the limits.
        promise: Reduction of the duration to first order, as a share of it.
        state_scale: Changes of the state that the trust region allows, shape (2 n,).
        rows: The limits that are rows, with their multipliers in shares of the
            duration, positive where the upper side holds.
    """

    costates: Array
    jumps: Array
    pushes: Array
    switching: Array
    hamiltonian: Array
    multipliers: Multipliers
    promise: float
    state_scale: Array
    rows: tuple[tuple[LimitRows, Array], ...]
