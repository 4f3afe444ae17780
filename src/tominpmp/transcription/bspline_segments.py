r"""B-splines over several segments, whose durations are unknowns of their own.

The spline runs through all segments, so that its derivatives are continuous where they
meet; its knots move with the durations. What moving knots change in the bases is taken
by central differences, which are exact to ten digits and cost as much as the bases.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array, IntArray
from tominpmp.constraints import JointLimit, Partials, States
from tominpmp.motion.trajectory import Trajectory
from tominpmp.transcription.base import Hull, Variation
from tominpmp.transcription.bspline import RATE_SHARES, SHARES
from tominpmp.transcription.bspline_basis import (
    Basis,
    Elimination,
    by_points,
    places,
)
from tominpmp.transcription.control_points import (
    TORQUE_SHARES,
    ControlPointTranscription,
)
from tominpmp.transcription.instants import Instants
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.segmented import trajectory_of_segments

# Step of the central differences, as a share of the durations.
DIFFERENCE = 1e-5


@dataclass(frozen=True, eq=False)
class SegmentedCurve:
    """A B-spline of an iterate, on knots of its own.

    Attributes:
        points: Control points, shape (M, n).
        eta: Durations by which the shares are multiplied, shape (m,).
        shares: Lengths of the intervals by eta, shape (N, m).
        degree: Degree of the spline.
        breaks: Numbers of intervals before nodes that are knots twice, so that the
            derivative below the highest may jump there.
    """

    points: Array
    eta: Array
    shares: Array
    degree: int
    breaks: tuple[int, ...] = ()
    finite: bool = True
    _known: dict[tuple[Instants, int], Array] = field(
        default_factory=dict, repr=False, init=False
    )

    @cached_property
    def h(self) -> Array:
        """Lengths of the intervals [s], shape (N,)."""
        return np.asarray(self.shares @ self.eta)

    @cached_property
    def basis(self) -> Basis:
        """The basis on the knots of the iterate [s]."""
        return Basis.on(with_breaks(self.nodes, self.breaks), self.degree)

    @cached_property
    def first(self) -> IntArray:
        """Number of the first control point that each interval depends on."""
        return first_points(self.h.size, self.breaks)

    @cached_property
    def neighbours(self) -> list[tuple[SegmentedCurve, SegmentedCurve, float]]:
        """For each duration: the curve with less and more of it, and what lies between.

        Their control points are the same.
        """
        out = []
        for j in range(self.eta.size):
            step = np.zeros(self.eta.size)
            step[j] = DIFFERENCE * self.eta[j]
            less, more = (replace(self, eta=self.eta + s) for s in (-step, step))
            out.append((less, more, 2.0 * float(step[j])))
        return out

    @cached_property
    def nodes(self) -> Array:
        """Times of the nodes [s], shape (N + 1,)."""
        return np.concatenate([[0.0], np.cumsum(self.h)])

    def derivative(self, order: int) -> Array:
        """Control points of a derivative, shape (M - order, n)."""
        known = self._derivatives
        if order not in known:
            before = np.diff(self.derivative(order - 1), axis=0)
            known[order] = self.basis.slopes(order)[:, None] * before
        return known[order]

    @cached_property
    def _derivatives(self) -> dict[int, Array]:
        """Those that were asked for: they are, again and again."""
        return {0: self.points}

    def weights(self, at: Instants, order: int) -> Array:
        """Weights of the control points that matter in a derivative, (m, p + 1)."""
        known = self._known.get((at, order))
        if known is None:
            first = self.first[at.interval]
            known = self.basis.weights(self._times(at), first, order)
            self._known[at, order] = known
        return known

    def values(self, at: Instants, order: int) -> Array:
        """A derivative at instants, shape (m, n)."""
        first = self.first[at.interval]
        functions = self.basis.functions(self._times(at), first, order)
        points = self.derivative(order)[places(first, functions.shape[1])]
        return np.asarray(np.einsum("mk,mkn->mn", functions, points))

    def _times(self, at: Instants) -> Array:
        """Instants without what is waited [s], shape (m,)."""
        return np.asarray(self.nodes[at.interval] + at.share * self.h[at.interval])

    def changes(self, at: Instants, order: int) -> Array:
        """How a derivative changes with the durations, shape (number, m, n)."""
        return np.stack(
            [
                (more.values(at, order) - less.values(at, order)) / span
                for less, more, span in self.neighbours
            ]
        )


class SegmentedBSpline(ControlPointTranscription[SegmentedCurve]):
    """A problem of several segments in the control points of a B-spline.

    The unknowns are z = (free control points, durations).

    Attributes:
        system: The functions of the problem.
        shares: Lengths of the intervals by the durations, shape (N, m).
        degree: Degree of the spline.
        segment_ends: Number of intervals up to the end of each segment.
        acceleration_range: What the full torque range of each joint brings about, shape
            (n,), which controls are measured in; None before a motion was looked at.
        breaks: Numbers of intervals before nodes at which the derivative below the
            highest may jump: accelerations of degree 3.
    """

    segment_ends: tuple[int, ...]

    def __init__(
        self,
        system: ProblemFunctions,
        shares: Array,
        degree: int,
        segment_ends: tuple[int, ...],
        acceleration_range: Array | None = None,
        breaks: tuple[int, ...] = (),
    ) -> None:
        self.system, self.shares, self.degree = system, shares, degree
        self.segment_ends, self.acceleration_range = segment_ends, acceleration_range
        self.breaks = breaks
        self._n, self._m = system.n, int(shares.shape[1])
        # What is eliminated at the ends is linear in the durations, as the knots are.
        each = [Elimination.of(system, self._basis_of(column)) for column in shares.T]
        free = each[0].matrix[:, :-1]
        self.map = sp.csr_matrix(sp.hstack([free, *(e.matrix[:, -1:] for e in each)]))
        self.offset, self.free = each[0].offset, each[0].free
        self.fixed_end = each[0].fixed_end

    def _basis_of(self, h: Array) -> Basis:
        nodes = np.concatenate([[0.0], np.cumsum(h)])
        return Basis.on(with_breaks(nodes, self.breaks), self.degree)

    # -- unknowns ----------------------------------------------------------------------

    def start(self, position: Callable[[Array], Array], eta: Array) -> Array:
        """Iterate for a guess: control points on the path at the Greville abscissae.

        Args:
            position: Configurations at shares of the grid's own duration.
            eta: Durations, shape (m,).
        """
        whole = self._basis_of(self.shares.sum(axis=1))
        return self.unknowns(position(whole.greville / whole.knots[-1]), eta)

    # -- states ------------------------------------------------------------------------

    def motion(self, z: Array) -> SegmentedCurve:
        """Spline of an iterate."""
        eta = z[-self._m :]
        return SegmentedCurve(
            self.points(z), eta, self.shares, self.degree, self.breaks
        )

    def instants(self, order: int, field: str) -> Instants:
        """Nodes and middles for torques; middles and ends, or pairs for rates."""
        N = self.intervals
        if order >= 3:
            return Instants.spread(N, RATE_SHARES)
        if order == 2:
            return Instants.spread(N, TORQUE_SHARES).joined(Instants.end(N))
        return Instants.spread(N, SHARES)

    def states(self, motion: SegmentedCurve, at: Instants, order: int) -> States:
        """States at instants."""
        none = np.zeros((0, self._n))
        parts = [none, none, none]
        for k in range(min(order, 2) + 1):
            parts[k] = motion.values(at, k)
        return States(at.times(motion.h) + self.delays[at.interval], *parts)

    def pull_back(
        self, motion: SegmentedCurve, at: Instants, partials: Partials
    ) -> sp.csr_matrix:
        """Derivatives by the unknowns from those by the states."""
        which, parts = partials.at, []
        by_eta = np.zeros((which.size, self._m))
        for order, part in enumerate((partials.by_q, partials.by_v, partials.by_a)):
            if part is None:
                continue
            parts.append((motion.weights(at, order)[which], part))
            change = motion.changes(at, order)[:, which]
            by_eta += np.einsum("mkj,kj->km", change, part)
        if partials.by_t is not None:
            over = at.over(which, self.intervals) @ self.shares
            by_eta += partials.by_t[:, None] * over
        first = motion.first[at.interval[which]]
        return self.by_unknowns(*by_points(first, parts, self._n), by_eta)

    def mapped(self, by_points: sp.csr_matrix, by_eta: Array) -> sp.csr_matrix:
        """Derivatives by the unknowns from those by points and durations alone."""
        empty = sp.csr_matrix((by_eta.shape[0], self.size - self._m))
        own = sp.hstack([empty, sp.csr_matrix(by_eta)])
        return sp.csr_matrix(by_points @ self.map + own)

    def hull(
        self, limit: JointLimit, within: tuple[int, int] | None = None
    ) -> Hull[SegmentedCurve] | None:
        """Derivatives are in the convex hull of their control points."""
        return SegmentedHull(self, limit, within)

    # -- the rest of the interface -----------------------------------------------------

    def scaled_at(self, z: Array) -> SegmentedBSpline:
        """The same with the range of accelerations at a motion."""
        scale, ends = self.full_range(z), self.segment_ends
        return SegmentedBSpline(
            self.system, self.shares, self.degree, ends, scale, self.breaks
        )

    def variation(self, z: Array) -> Variation:
        """Jumps between the control points of the jerk, in full torque ranges."""
        curve, scale = self.motion(z), self.acceleration_range
        if scale is None:
            scale = np.ones(self._n)

        jerk = curve.basis.derivative(3)
        count = jerk.shape[0]
        step = sp.diags([-1.0, 1.0], [0, 1], shape=(count - 1, count))

        def jumps(of: SegmentedCurve) -> Array:
            # As accelerations, over a mean interval.
            found = float(np.mean(of.h)) * np.diff(of.derivative(3), axis=0)
            return (found / scale).ravel()

        values, lasting = jumps(curve), float(np.mean(curve.h))
        by_eta = np.stack(
            [
                (jumps(more) - jumps(less)) / span
                for less, more, span in curve.neighbours
            ],
            axis=1,
        )
        by_points = sp.kron(
            lasting * (step @ jerk), sp.diags(1.0 / scale), format="csr"
        )
        full = self.mapped(by_points, by_eta)
        return Variation(full, values - np.asarray(full @ z))

    def trajectory(self, z: Array) -> Trajectory:
        """The motion of an iterate; its torque follows from the inverse dynamics."""
        N, curve = self.intervals, self.motion(z)
        nodes = Instants(np.append(np.arange(N), N - 1), np.append(np.zeros(N), 1.0))
        _, q, v, a, _ = self.states(curve, nodes, 2)
        inverse = self.system.motor_dynamics.inverse
        motion = Trajectory(
            joint_names=self.system.problem.robot.joint_names,
            t=np.concatenate([[0.0], np.cumsum(curve.h)]),
            q=q,
            v=v,
            u=0.0 * q,
            a=a if self.degree > 3 else None,
        ).with_torques(inverse)
        return trajectory_of_segments(self, motion)


def with_breaks(nodes: Array, breaks: tuple[int, ...]) -> Array:
    """Nodes, some of them twice."""
    return np.insert(nodes, breaks, nodes[list(breaks)]) if breaks else nodes


def first_points(intervals: int, breaks: tuple[int, ...]) -> IntArray:
    """Number of the first control point that each interval depends on, shape (N,)."""
    every = np.arange(intervals)
    return every + np.searchsorted(breaks, every, side="right")


class SegmentedHull(Hull[SegmentedCurve]):
    """Control points of a derivative over its limit.

    On a segment, these are the ones that any of its intervals depends on.
    """

    def __init__(
        self, of: SegmentedBSpline, limit: JointLimit, within: tuple[int, int] | None
    ) -> None:
        self._of, self._limit = of, limit
        first, end = within or (0, of.intervals)
        intervals = first_points(of.intervals, of.breaks)
        degree = of.degree - limit.order
        point = np.arange(intervals[-1] + 1 + degree)
        begins = np.searchsorted(intervals, point - degree)
        ends = np.searchsorted(intervals, point, side="right")
        self._points = np.flatnonzero((begins < end) & (ends > first))
        self.lower = np.tile(limit.lower / limit.scale, self._points.size)
        self.upper = np.tile(limit.upper / limit.scale, self._points.size)

    def _matrix(self, curve: SegmentedCurve) -> sp.csr_matrix:
        limit = self._limit
        select = sp.csr_matrix(
            (1.0 / limit.scale, (np.arange(limit.joints.size), limit.joints)),
            shape=(limit.joints.size, self._of.system.n),
        )
        points = curve.basis.derivative(limit.order)[self._points]
        return sp.kron(points, select, format="csr")

    def values(self, motion: SegmentedCurve) -> Array:
        """Control points of the derivative."""
        limit = self._limit
        points = motion.derivative(limit.order)[self._points]
        return np.asarray(points[:, limit.joints] / limit.scale).ravel()

    def jacobian(self, motion: SegmentedCurve) -> sp.csr_matrix:
        """By the unknowns."""
        by_eta = np.stack(
            [
                (self.values(more) - self.values(less)) / span
                for less, more, span in motion.neighbours
            ],
            axis=1,
        )
        return self._of.mapped(self._matrix(motion), by_eta)
