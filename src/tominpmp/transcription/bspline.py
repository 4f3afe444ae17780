r"""Smooth motions: B-splines of higher degree on a fixed grid of shares of T.

Degree 3 has continuous, piecewise linear accelerations (the paper's quasi-linear
control), degree 5 smooth ones. The unknowns are the control points C and the duration
T: with constant matrices B_d of basis functions,

.. math:: q = B_0 C, \quad \dot q = B_1 C / T, \quad \ddot q = B_2 C / T^2,

so that torque rates, jerks and accelerations can be limited (paper, section 4: the
torque becomes a state and its rate the control). Speeds, accelerations and jerks stay
in the convex hull of the control points of the derivatives: their limits hold at every
time. Control points at the ends are eliminated: they follow from the given states.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from weakref import WeakKeyDictionary

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import spsolve

from tominpmp.arrays import Array
from tominpmp.constraints import JointLimit, Partials, States
from tominpmp.linear_programs.compressed import Compressed
from tominpmp.motion.trajectory import Trajectory
from tominpmp.transcription.base import Hull, Variation
from tominpmp.transcription.bspline_basis import (
    Basis,
    Elimination,
    by_points,
    of_each_joint,
    places,
)
from tominpmp.transcription.control_points import (
    TORQUE_SHARES,
    ControlPointTranscription,
)
from tominpmp.transcription.instants import Instants
from tominpmp.transcription.problem_functions import ProblemFunctions

DEGREES = {"linear": 3, "spline": 5}
# Instants of each interval at which other constraints than torques are looked at to
# begin with.
SHARES = (0.5, 1.0)
# A torque rate is taken over this share of an interval, at both of its ends; a hair
# inside, so that both instants are of the same interval.
RATE_SHARES = (0.0, 0.05, 0.95, 1.0 - 1e-9)


@dataclass(frozen=True, eq=False)
class BSplineMotion:
    """A B-spline of an iterate.

    Attributes:
        points: Control points, shape (M, n).
        T: Duration [s].
        h: Lengths of the intervals [s], shape (N,).
    """

    points: Array
    T: float
    h: Array
    finite: bool = True


class BSplineTranscription(ControlPointTranscription[BSplineMotion]):
    """A problem in the control points of a B-spline and T.

    Attributes:
        system: The functions of the problem.
        shares: Shares of T that the intervals take, shape (N, 1).
        degree: Degree of the spline.
        acceleration_range: What the full torque range of each joint brings about, shape
            (n,), which controls are measured in; None before a motion was looked at.
    """

    def __init__(
        self,
        system: ProblemFunctions,
        shares: Array,
        degree: int,
        acceleration_range: Array | None = None,
    ) -> None:
        self.system, self.shares, self.degree = system, shares, degree
        self.acceleration_range = acceleration_range
        self._nodes = np.concatenate([[0.0], np.cumsum(shares[:, 0])])
        self._nodes /= self._nodes[-1]
        self._h = np.diff(self._nodes)
        self._n = system.n
        self.basis = Basis.on(self._nodes, degree)
        ends = Elimination.of(system, self.basis)
        self._weights: WeakKeyDictionary[Instants, dict[int, Array]]
        self._weights = WeakKeyDictionary()
        self.map, self.offset = ends.matrix, ends.offset
        self.free, self.fixed_end = ends.free, ends.fixed_end

    # -- unknowns ----------------------------------------------------------------------

    @property
    def cost(self) -> Array:
        """Gradient of the duration."""
        cost = np.zeros(self.size)
        cost[-1] = 1.0
        return cost

    def start(
        self, position: Callable[[Array], Array], guessed: float, duration: float
    ) -> Array:
        """Iterate for a guess: control points on the path at the Greville abscissae."""
        points = position(self.basis.greville * guessed)
        return self.unknowns(points, np.array([duration]))

    def fitted(self, times: Array, q: Array, duration: float) -> Array:
        """Iterate that is nearest to positions at shares of T, in least squares."""
        design = sp.kron(self.basis.at(times), sp.identity(self._n), format="csr")
        free = (design @ self.map)[:, :-1]
        rest = q.ravel() - design @ (self.offset + self.map[:, -1:] @ [duration])
        points = spsolve((free.T @ free).tocsc(), free.T @ rest).reshape(-1, self._n)
        limits = self.system.problem.robot.limits
        points = np.clip(points, limits.position_lower, limits.position_upper)
        return np.append(points.ravel(), duration)

    # -- states ------------------------------------------------------------------------

    def motion(self, z: Array) -> BSplineMotion:
        """Spline of an iterate."""
        T = float(z[-1])
        return BSplineMotion(self.points(z), T, self._h * T)

    def instants(self, order: int, field: str) -> Instants:
        """Nodes and middles for torques; middles and ends, or pairs for rates."""
        N = self.intervals
        if order >= 3:
            return Instants.spread(N, RATE_SHARES)
        return self._torque_instants if order == 2 else self._middles_and_ends

    @cached_property
    def _torque_instants(self) -> Instants:
        N = self.intervals
        return Instants.spread(N, TORQUE_SHARES).joined(Instants.end(N))

    @cached_property
    def _middles_and_ends(self) -> Instants:
        starts = np.concatenate([np.arange(self.intervals)] * len(SHARES))
        return Instants(starts, np.repeat(SHARES, self.intervals))

    @cached_property
    def _at_nodes(self) -> Instants:
        N = self.intervals
        return Instants(np.append(np.arange(N), N - 1), np.append(np.zeros(N), 1.0))

    def _weights_at(self, at: Instants, order: int) -> Array:
        """Weights of control points at instants, remembered as long as these."""
        known = self._weights.setdefault(at, {})
        if order not in known:
            times = self.shares_of(at)
            known[order] = self.basis.weights(times, at.interval, order)
        return known[order]

    def shares_of(self, at: Instants) -> Array:
        """Instants as shares of T, shape (m,)."""
        return np.asarray(self._nodes[at.interval] + at.share * self._h[at.interval])

    def states(self, motion: BSplineMotion, at: Instants, order: int) -> States:
        """States at instants."""
        times, T = self.shares_of(at), motion.T
        none = np.zeros((0, self._n))
        parts = [none, none, none]
        points = motion.points[places(at.interval, self.degree + 1)]
        for k in range(min(order, 2) + 1):
            weights = self._weights_at(at, k)
            parts[k] = np.einsum("mk,mkn->mn", weights, points) / T**k
        return States(times * T, *parts)

    def pull_back(
        self, motion: BSplineMotion, at: Instants, partials: Partials
    ) -> sp.csr_matrix:
        """Derivatives by the unknowns from those by the states."""
        T, which = motion.T, partials.at
        by_time = np.zeros(which.size)
        first, parts = at.interval[which], []
        points = motion.points[places(first, self.degree + 1)]
        for order, part in enumerate((partials.by_q, partials.by_v, partials.by_a)):
            if part is None:
                continue
            weights = self._weights_at(at, order)[which]
            scaled = part / T**order
            parts.append((weights, scaled))
            if order:
                here = np.einsum("mk,mkn->mn", weights, points)
                by_time -= order * np.einsum("kj,kj->k", scaled, here) / T
        if partials.by_t is not None:
            by_time += partials.by_t * self.shares_of(at)[which]
        found, which = by_points(first, parts, self._n)
        return self.by_unknowns(found, which, by_time[:, None])

    def hull(
        self, limit: JointLimit, within: tuple[int, int] | None = None
    ) -> Hull[BSplineMotion] | None:
        """Derivatives are in the convex hull of their control points."""
        return DerivativeHull(self, limit)

    # -- the rest of the interface -----------------------------------------------------

    def scaled_at(self, z: Array) -> BSplineTranscription:
        """The same with the range of accelerations at a motion."""
        scaled = copy(self)  # what is known of the grid holds there too
        scaled.acceleration_range = self.full_range(z)
        return scaled

    def variation(self, z: Array) -> Variation:
        """Jumps between the control points of the jerk, in full torque ranges."""
        T, scale = z[-1], self.acceleration_range
        if scale is None:
            scale = np.ones(self._n)
        by_unknowns, known = self._jumps
        # As accelerations, over the interval that such a jump lasts.
        factor = float(np.mean(self._h)) / T**2 / scale
        factors = np.tile(factor, known.size // self._n)
        scaled = factors[by_unknowns.lines] * by_unknowns.data
        matrix = by_unknowns._replace(data=scaled).rows()
        return Variation(matrix, factors * known)

    @cached_property
    def _jumps(self) -> tuple[Compressed, Array]:
        """Jumps of the jerk's control points, by the unknowns, and those for none."""
        jerk = self.basis.bands(3)
        after = np.pad(jerk[1:], ((0, 0), (1, 0)))
        before = np.pad(jerk[:-1], ((0, 0), (0, 1)))
        jumps, points = of_each_joint(after - before, np.arange(self._n), self._n)
        matrix = self.by_unknowns(jumps, points, np.zeros((len(jumps), 1)))
        known = np.einsum("kw,kw->k", jumps, self.offset[points])
        return Compressed.of(matrix), known

    def sequence_times(self, z: Array) -> Array:
        """Instants of that sequence as shares of T: nodes and middles."""
        return self.shares_of(self.instants(2, ""))

    def trajectory(self, z: Array) -> Trajectory:
        """The motion of an iterate; its torque follows from the inverse dynamics."""
        _, q, v, a, _ = self.states(self.motion(z), self._at_nodes, 2)
        return Trajectory(
            joint_names=self.system.problem.robot.joint_names,
            t=self._nodes * z[-1],
            q=q,
            v=v,
            u=0.0 * q,
            a=a if self.degree > 3 else None,
        ).with_torques(self.system.motor_dynamics.inverse)


class DerivativeHull(Hull[BSplineMotion]):
    """Control points of a derivative over its limit; scaled by T to its order."""

    def __init__(self, of: BSplineTranscription, limit: JointLimit) -> None:
        self._of, self._order = of, limit.order
        bands, joints = of.basis.bands(limit.order), limit.joints
        self._by_points, self._points = of_each_joint(bands, joints, of.system.n)
        self._by_points /= np.tile(limit.scale, len(bands))[:, None]
        self._matrix = Compressed.of_table(
            self._by_points, self._points, of.offset.size
        ).rows()
        self.lower = np.tile(limit.lower / limit.scale, len(bands))
        self.upper = np.tile(limit.upper / limit.scale, len(bands))

    def values(self, motion: BSplineMotion) -> Array:
        """Control points of the derivative."""
        points = self._matrix @ motion.points.ravel()
        return np.asarray(points) / motion.T**self._order

    def jacobian(self, motion: BSplineMotion) -> sp.csr_matrix:
        """By the unknowns."""
        by_time = -self._order * self.values(motion) / motion.T
        by_points = self._by_points / motion.T**self._order
        return self._of.by_unknowns(by_points, self._points, by_time[:, None])
