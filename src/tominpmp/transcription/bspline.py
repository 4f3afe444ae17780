r"""B-splines of degree 2, 3 or 5, with one duration or a duration for each segment.

Accelerations are constant with degree 2 (:class:`InverseTranscription`), continuous and
piecewise linear with degree 3 (the paper's quasi-linear control), and smooth with
degree 5. The unknowns are the control points C and the durations eta. With the matrices
B_d of the basis functions and their derivatives on a grid with a single duration T,

.. math:: q = B_0 C, \quad \dot q = B_1 C / T, \quad \ddot q = B_2 C / T^2,

so that torque rates, jerks and accelerations can be limited (paper, section 4: the
torque becomes a state and its rate the control). Positions, speeds, accelerations and
jerks stay in the convex hull of the control points of these derivatives, so that their
limits hold at all times. The control points at the ends follow from the given states,
and are eliminated. A motion of several segments is one spline, whose derivatives are
continuous where segments meet; its knots move with the durations.
"""

from __future__ import annotations

from copy import copy
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import spsolve

from tominpmp.arrays import Array, BoolArray, IntArray
from tominpmp.constraints.base import Partials, States
from tominpmp.constraints.joint_limits import JointLimit
from tominpmp.motion.trajectory import Trajectory
from tominpmp.transcription.base import HullRows, StepBounds, Transcription, Variation
from tominpmp.transcription.curve import (
    KnotVector,
    PositionFunction,
    SplineMotion,
    clamped,
    nodes_of,
    places,
    rows_of_table,
)
from tominpmp.transcription.instants import Instants
from tominpmp.transcription.problem_functions import ProblemFunctions

DEGREES = {"linear": 3, "spline": 5}
# Shares of each interval at which constraints have initial rows, other than torques.
SHARES = (0.5, 1.0)
# Shares at which torques have initial rows; the end of the last interval is added.
TORQUE_SHARES = (0.0, 0.5)
# Shares at which torques are inspected between these rows: the torques of fast wrists
# rise and fall by half of their range within a quarter of an interval.
SIXTEENTHS = tuple((np.arange(16) / 16).tolist())
INSPECTED = SIXTEENTHS[1:8], SIXTEENTHS[9:]
# Pairs of shares between which torque rates are taken, at both ends of an interval. The
# last is slightly below 1, so that both instants of its pair are in the same interval.
RATE_SHARES = (0.0, 0.05, 0.95, 1.0 - 1e-9)
# Clearances beyond this, in shares of the reach per rad of the trust region radius, are
# left out of the linear program; the merit function shortens a step that nevertheless
# uses one up.
ATTENTION = 0.07
# Upper bound of this margin for any trust region; larger clearances are not exact.
MAX_ATTENTION = 0.05


class ControlPointMap(NamedTuple):
    """Map from the unknowns to the coordinates of the control points.

    It is affine but for an acceleration at the start, which adds the product of two
    spans of knots.

    Attributes:
        column: Index of the unknown that is added to each coordinate, shape (M n,); -1
            for fixed coordinates.
        offset: Coordinates relative to the start if all unknowns are zero, shape
            (M n,).
        slopes: Derivatives of the coordinates by the durations at a start without
            acceleration, shape (M n, m).
        bend: Coordinates per product of the spans, shape (M n,).
        spans: Derivatives of the spans by the durations, shape (2, m).
        moving: Coordinates that change with the durations, shape (M n,).
    """

    column: IntArray
    offset: Array
    slopes: Array
    bend: Array
    spans: Array
    moving: BoolArray

    def fixed(self, eta: Array) -> Array:
        """Coordinates if all unknowns but the durations are zero, shape (M n,)."""
        first, second = self.spans @ eta
        return np.asarray(
            self.offset + self.slopes @ eta + self.bend * (first * second)
        )

    def by_durations(self, eta: Array) -> Array:
        """Derivatives of the coordinates by the durations, shape (M n, m)."""
        first, second = self.spans @ eta
        along = first * self.spans[1] + second * self.spans[0]
        return np.asarray(self.slopes + self.bend[:, None] * along)


class BSplineTranscription(Transcription[SplineMotion]):
    """A problem in z = (free control points relative to the start, durations).

    Attributes:
        system: The functions of the problem.
        shares: Lengths of the intervals by the durations, shape (N, m).
        degree: Degree of the spline.
        segment_ends: Number of intervals up to the end of each segment.
        breaks: Nodes, as the number of intervals before each, at which the derivative
            one order below the highest may jump: the acceleration for degree 3.
        knots_by_durations: Derivatives of the knots by the durations, shape (K, m).
        near: Durations near each control point, see ``SplineMotion``, shape (M, w).
        point_map: Map from the unknowns to the control points.
        point_unknowns: Number of unknowns without the durations.
        acceleration_range: Acceleration that the full torque range of each joint gives,
            shape (n,), the unit of the controls; ones until it is taken from a motion.
    """

    inspected: tuple[tuple[float, ...], ...] = INSPECTED
    highest_order = 3
    moving_attention = MAX_ATTENTION
    cutoff = MAX_ATTENTION

    def __init__(
        self,
        system: ProblemFunctions,
        shares: Array,
        degree: int,
        segment_ends: tuple[int, ...] = (),
        *,
        breaks: tuple[int, ...] = (),
    ) -> None:
        super().__init__(system, shares, segment_ends)
        self.degree, self.breaks = degree, breaks
        self._base = system.problem.q_start
        self.acceleration_range = np.ones(self._n)
        self.knots_by_durations = clamped(shares, degree, breaks)
        self.near = _durations_near(self.knots_by_durations, degree)
        self.point_map = self._eliminated()
        self.point_unknowns = int(self.point_map.column.max()) + 1
        self.size = self.point_unknowns + self._m
        # With a single duration the proportions of the knots are constant.
        self._knots = KnotVector(shares[:, 0], degree, breaks) if self._m == 1 else None

    # -- unknowns ----------------------------------------------------------------------

    def _eliminated(self) -> ControlPointMap:
        """Eliminate the control points at the ends, which follow from given states.

        At a known velocity v the second point from an end is C_0 + v T dt / p; the
        third point follows if the acceleration must not jump, and so is that of the
        problem at the start, and zero at the end.
        """
        system, p, t = self.system, self.degree, self.knots_by_durations
        M = len(t) - p - 1
        goal, v_end = system.final_configuration, system.final_velocity
        outer = system.segments[0], system.segments[-1]
        known, last = (2 if p == 2 or part.sudden else 3 for part in outer)
        # Above degree 3 a motion cannot jump to the zero acceleration of a dwell.
        if p > 3 and any(segment.dwell for segment in system.problem.segments[-1:]):
            last = 3
        if v_end is None:
            last = int(goal is not None)
        inner = M - known - last
        column: IntArray = np.full(M, -1)
        offset, slopes = np.zeros((M, self._n)), np.zeros((M, self._n, self._m))
        bend, spans = np.zeros((M, self._n)), t[p + 1 : p + 3] - t[p]
        bend[2:known] = system.problem.a_start / (p * (p - 1))
        column[known : known + inner] = np.arange(inner)
        slopes[:known] = system.problem.v_start[:, None] * _reach(t, p, known)
        if goal is not None:
            offset[M - last :] = goal - self._base
        else:
            # A free final configuration moves all points that depend on it.
            column[M - last :] = inner
        if v_end is not None:
            back = _reach((t[-1] - t)[::-1], p, last)[::-1]
            slopes[M - last :] = -v_end[:, None] * back
        columns = self._n * column[:, None] + np.arange(self._n)
        columns = np.where(column[:, None] >= 0, columns, -1).ravel()
        by_eta, bends = slopes.reshape(-1, self._m), bend.ravel()
        moving = np.any(by_eta, axis=1) | (bends != 0.0)
        return ControlPointMap(columns, offset.ravel(), by_eta, bends, spans, moving)

    def by_unknowns(
        self,
        eta: Array,
        by_points: Array,
        points: IntArray,
        by_durations: Array,
        near: IntArray,
    ) -> sp.csr_matrix:
        """Derivatives by the unknowns from those by control points and by durations.

        Args:
            eta: Durations, shape (m,).
            by_points: Derivatives by coordinates of control points, shape (k, w).
            points: Indices of these coordinates, ascending, shape (k, w).
            by_durations: Derivatives by the durations alone, shape (k, d).
            near: Indices of these durations, ascending, shape (k, d).
        """
        mapping = self.point_map
        if np.any(mapping.moving):
            slopes = mapping.by_durations(eta)[points[:, :, None], near[:, None]]
            by_durations = by_durations + np.einsum("kw,kwd->kd", by_points, slopes)
        columns = mapping.column[points], self.point_unknowns + near
        matrix = rows_of_table(
            np.concatenate([by_points, by_durations], axis=1),
            np.concatenate(columns, axis=1),
            self.size,
        )
        matrix.sum_duplicates()  # coordinates may share an unknown
        return matrix

    def of_joints(
        self,
        eta: Array,
        bands: Array,
        first: IntArray,
        joints: IntArray,
        by_durations: Array,
    ) -> sp.csr_matrix:
        """Derivatives by the unknowns of rows that hold for each of some joints.

        Args:
            eta: Durations, shape (m,).
            bands: Derivatives by coordinates of w neighbouring control points, shape
                (r, k, w).
            first: The first of these control points, shape (r,).
            joints: The joints, shape (k,).
            by_durations: Derivatives by the durations near these control points, shape
                (r, k, d).
        """
        coordinate = self._n * first[:, None] + joints
        points = coordinate.reshape(-1, 1) + self._n * np.arange(bands.shape[2])
        near = np.repeat(self.near[first], joints.size, axis=0)
        by_points = bands.reshape(points.shape)
        by_durations = by_durations.reshape(near.shape)
        return self.by_unknowns(eta, by_points, points, by_durations, near)

    def unknowns(self, points: Array, eta: Array) -> Array:
        """Unknowns whose control points are nearest to given control points.

        Coordinates that share an unknown get the mean of their given values.

        Args:
            points: Control points, shape (M, n).
            eta: Durations, shape (m,).
        """
        mapping, moved = self.point_map, self.point_map.column >= 0
        target = (points - self._base).ravel() - mapping.fixed(eta)
        target = target[moved]
        column, size = mapping.column[moved], self.point_unknowns
        sums = np.bincount(column, target, minlength=size)
        return np.concatenate([sums / np.bincount(column, minlength=size), eta])

    def start(self, position: PositionFunction, guessed: float, eta: Array) -> Array:
        """Iterate for a guess: control points on the path at the Greville abscissae.

        Args:
            position: Configurations at times, shape (k,) to (k, n).
            guessed: Duration of the guess [s].
            eta: Durations of the iterate, shape (m,).
        """
        knots = self._knots_for(np.ones(self._m))
        return self.unknowns(position(guessed * knots.greville / knots.knots[-1]), eta)

    def interpolated(self, eta: Array, position: PositionFunction) -> Array:
        """Iterate that goes through positions at the Greville abscissae.

        Args:
            eta: Durations, shape (m,).
            position: Configurations at times [s], shape (k,) to (k, n); a spline on
                this grid is reproduced exactly.
        """
        knots = self._knots_for(eta)
        sites = knots.greville
        points = spsolve(knots.design(sites).tocsc(), position(sites * eta[-1]))
        return self.unknowns(np.reshape(points, (knots.count, -1)), eta)

    def within_limits(self, z: Array) -> Array:
        """An iterate with its free control points brought within position limits."""
        limits, count = self.system.problem.robot.limits, self.point_unknowns
        points = z[:count].reshape(-1, self._n) + self._base
        points = np.clip(points, limits.position_lower, limits.position_upper)
        return np.concatenate([(points - self._base).ravel(), z[count:]])

    def steps(self, z: Array, radius: float) -> tuple[Array, Array]:
        """Steps of the control points within position limits, shorter for small T."""
        limits = self.system.problem.robot.limits
        points = z[: self.point_unknowns].reshape(-1, self._n) + self._base
        radius *= self.units(z)[-1]
        box = np.broadcast_to(radius * self.system.step_scale, points.shape)
        lower = np.maximum(-box, np.minimum(limits.position_lower - points, 0.0))
        upper = np.minimum(box, np.maximum(limits.position_upper - points, 0.0))
        return lower, upper

    # -- states ------------------------------------------------------------------------

    def motion(self, z: Array) -> SplineMotion:
        """Spline of an iterate."""
        eta = z[self.point_unknowns :]
        mapping, moved = self.point_map, self.point_map.column >= 0
        coordinates = mapping.fixed(eta)
        coordinates[moved] += z[mapping.column[moved]]
        points, knots = coordinates.reshape(-1, self._n), self._knots_for(eta)
        return SplineMotion(points, self._base, eta, self.shares, knots, self.near)

    def _knots_for(self, eta: Array) -> KnotVector:
        """Knots in units of the last duration."""
        if self._knots is not None:
            return self._knots
        return KnotVector(self.shares @ (eta / eta[-1]), self.degree, self.breaks)

    def instants(self, order: int, field: str) -> Instants:
        """Nodes and middles for torques, pairs for rates, else middles and ends."""
        N = self.intervals
        if order >= 3:
            return Instants.spread(N, RATE_SHARES)
        return self._torque_instants if order == 2 else Instants.spread(N, SHARES)

    @cached_property
    def _torque_instants(self) -> Instants:
        N = self.intervals
        return Instants.spread(N, TORQUE_SHARES).joined(Instants.end(N))

    def states(self, motion: SplineMotion, at: Instants, order: int) -> States:
        """States at instants."""
        empty = np.zeros((0, self._n))
        parts = (motion.values(at, k) if k <= order else empty for k in range(3))
        return States(at.times(motion.h) + self.delays[at.interval], *parts)

    def pull_back(
        self, motion: SplineMotion, at: Instants, partials: Partials
    ) -> sp.csr_matrix:
        """Derivatives by the unknowns from derivatives by the states."""
        which, n, width = partials.at, self._n, self.degree + 1
        by_points = np.zeros((which.size, width, n))
        first = motion.knots.first[at.interval[which]]
        near = self.near[first]
        by_durations = np.zeros(near.shape)
        for order, part in enumerate((partials.by_q, partials.by_v, partials.by_a)):
            if part is None:
                continue
            weights = motion.knots.weights(at, order)[which]
            by_points += weights[:, :, None] * (part / motion.unit**order)[:, None]
            if order or self._m > 1:
                value = partial(SplineMotion.values, at=at, order=order, which=which)
                changes = motion.by_durations(value, order, near)
                by_durations += np.einsum("knd,kn->kd", changes, part)
        if partials.by_t is not None:
            # Real time depends on all durations.
            by_time = partials.by_t[:, None] * at.times(self.shares)[which]
            known = np.take_along_axis(by_time, near, axis=1)
            np.put_along_axis(by_time, near, known + by_durations, axis=1)
            by_durations, near = by_time, places(0 * first, self._m)
        points = places(n * first, width * n)
        return self.by_unknowns(
            motion.eta, by_points.reshape(points.shape), points, by_durations, near
        )

    def hull(
        self, limit: JointLimit, name: str, within: tuple[int, int] | None = None
    ) -> HullRows[SplineMotion] | None:
        """Bounds on the control points of a derivative, in whose hull it stays.

        On a segment, there are rows for the control points on which any of its
        intervals depends. For positions, there are rows only for the points that depend
        on velocities at the ends: all other points are unknowns, whose bounds keep the
        limits.
        """
        order, scale = limit.order, limit.scale
        first, end = within or (0, self.intervals)
        begins = self._knots_for(np.ones(self._m)).first
        points = np.arange(begins[first], begins[end - 1] + self.degree - order + 1)
        if order == 0:
            moving = np.any(self.point_map.moving.reshape(-1, self._n), axis=1)
            points = points[moving[points]]
        times = 1, points.size
        limits = limit.lower / scale, limit.upper / scale
        bounds = np.tile(limits[0], times), np.tile(limits[1], times)

        def of_motion(motion: SplineMotion) -> Array:
            found = motion.derivative(order)[points]
            return np.asarray(found[:, limit.of_joints] / scale)

        def by_unknowns(motion: SplineMotion) -> sp.csr_matrix:
            bands = motion.knots.bands(order)[points, None] / scale[:, None]
            bands /= motion.unit**order
            by_eta = motion.by_durations(of_motion, order, self.near[points])
            return self.of_joints(motion.eta, bands, points, limit.of_joints, by_eta)

        return HullRows(name, bounds, of_motion, by_unknowns)

    def units(self, z: Array) -> Array:
        """Units of steps in programs: the displacement at 10 rad/s^2 within T.

        Durations have its root as unit, which is T in units of 0.3 s. Both are at most
        1. In rad and s, hardly a program of a motion within 20 ms meets the tolerances
        of the solvers.
        """
        unit = np.clip(10.0 * (self.cost @ z) ** 2, 1e-6, 1.0)
        return np.repeat([unit, np.sqrt(unit)], [self.point_unknowns, self._m])

    def attention(self, steps: StepBounds) -> float:
        """Clearance that a step of the control points can use up, over the reach."""
        radius = float(np.max(steps.upper[: self.point_unknowns], initial=0.0))
        return min(ATTENTION * radius, self.cutoff)

    # -- the rest of the interface -----------------------------------------------------

    def scaled_at(self, z: Array) -> BSplineTranscription:
        """The transcription with the range of accelerations of an iterate's motion."""
        scaled = copy(self)  # cached values of the grid stay valid
        motion, at = self.motion(z), self._torque_instants
        _, q, v, a, _ = self.states(motion, at, 2)
        by = self.system.dynamics.inverse_jacobians(q, v, a)
        inertia = np.abs(np.einsum("mii->mi", by.tau_a))
        if self.degree == 2:
            # An acceleration over an interval changes the speed, and so the friction.
            drag = np.abs(np.einsum("mii->mi", by.tau_v))
            inertia += drag * motion.h[at.interval, None]
        full = 2.0 * self.system.effort_half
        scaled.acceleration_range = full / np.maximum(inertia.mean(axis=0), 1e-12)
        return scaled

    def variation(self, z: Array) -> Variation:
        """Jumps of the highest derivative, up to jerks, in full torque ranges.

        Jumps between control points of the jerk are multiplied by the mean interval
        beside them, and so count as accelerations: with the mean of all intervals,
        jumps on short intervals at both ends would weigh more than the duration.
        """
        motion, order = self.motion(z), min(self.degree, 3)
        scale = self.acceleration_range

        def spans(of: SplineMotion) -> Array:
            if order < 3:
                return np.ones((1, 1))
            slopes = of.knots.slopes(order)
            steps = np.divide(of.unit, slopes, np.zeros_like(slopes), where=slopes != 0)
            return 0.5 * (steps[1:, None] + steps[:-1, None])

        def jumps(of: SplineMotion) -> Array:
            return np.asarray(spans(of) * np.diff(of.derivative(order), axis=0) / scale)

        rows = motion.knots.bands(order) / motion.unit**order
        after = np.pad(rows[1:], ((0, 0), (1, 0)))
        between = after - np.pad(rows[:-1], ((0, 0), (0, 1)))
        between *= spans(motion)
        joints, first = np.arange(self._n), np.arange(len(between))
        by_eta = np.zeros((first.size, joints.size, self.near.shape[1]))
        if self._m > 1:
            # The jumps depend on the ratios of the durations, too.
            by_eta = motion.by_durations(jumps, 2, self.near[first])
        between = between[:, None] / scale[:, None]
        matrix = self.of_joints(motion.eta, between, first, joints, by_eta)
        return Variation(matrix, jumps(motion).ravel() - matrix @ z)

    @property
    def torque_sequence(self) -> sp.csr_matrix:
        """Identity: torques at nodes and middles, in the order of their rows."""
        return sp.csr_matrix(sp.identity(self._torque_instants.size))

    def time_scale(self, z: Array, factor: float) -> Array:
        """The same control points with longer durations."""
        out = z.copy()
        out[self.point_unknowns :] *= factor
        return out

    def trajectory(self, z: Array) -> Trajectory:
        """The motion of an iterate; its torques follow from the inverse dynamics.

        The torques of each segment are those for its load. The motion includes the
        dwells at the ends of segments.
        """
        motion, N, segments = self.motion(z), self.intervals, self.system.segments
        _, q, v, a, _ = self.states(motion, Instants.nodes(N), 2)
        dwells = np.array([part.dwell for part in self.system.problem.segments])
        ends, stays = np.array(self.segment_ends)[: dwells.size], dwells > 0.0
        at = ends[stays]
        # The node of a dwell is repeated at the end of the dwell.
        node = np.insert(np.arange(N + 1), at + 1, at)
        dwelt = np.cumsum(np.insert(np.zeros(N + 1), at + 1, dwells[stays]))
        t, still = nodes_of(motion.h)[node] + dwelt, np.isin(node, at)[:, None]
        accelerations = {2: np.insert(motion.derivative(2), at, 0.0, axis=0), 3: None}
        inverses = tuple(part.motor_dynamics.inverse for part in segments)
        segmented = dwells.size > 0
        return Trajectory(
            joint_names=self.system.problem.robot.joint_names,
            t=t,
            q=q[node],
            v=np.where(still, 0.0, v[node]),
            u=0.0 * q[node],
            a=accelerations.get(self.degree, np.where(still, 0.0, a[node])),
            segment_ends=t[ends + np.cumsum(stays)] if segmented else None,
        ).with_torques(inverses[0], inverses if segmented else ())


def _reach(knots: Array, degree: int, count: int) -> Array:
    """Distance of the first control points from the end, per unit of velocity there.

    Args:
        knots: Derivatives of the knots by the durations, shape (K, m).
        degree: Degree of the spline.
        count: Number of control points.

    Returns:
        Derivatives of the distances by the durations, shape (count, 1, m).
    """
    spans = (knots[degree + 1 : degree + count] - knots[1:count]) / degree
    return nodes_of(spans)[:, None]


def _durations_near(knots: Array, degree: int) -> IntArray:
    """Durations on which the spline depends where a control point is the first one.

    Args:
        knots: Derivatives of the knots by the durations, shape (K, m).
        degree: Degree of the spline.

    Returns:
        Indices of w consecutive durations for each control point, shape (M, w).
    """
    # The duration of each gap between knots; gaps between equal knots have the former.
    owner = np.maximum.accumulate(np.argmax(np.diff(knots, axis=0) > 0.0, axis=1))
    point = np.arange(len(knots) - degree - 1)
    first = owner[point + 1]
    last = owner[np.minimum(point + 2 * degree, owner.size - 1)]
    width = int(np.max(last - first)) + 1
    return places(np.minimum(first, knots.shape[1] - width), width)


class InverseTranscription(BSplineTranscription):
    r"""A problem whose unknowns are the control points of a quadratic spline.

    Torque limits are rows on an exact double integrator. Positions are quadratic
    splines in time, with constant acceleration on each interval. The control points are
    the middle Bezier points P_k of the N pieces, and the two ends of the motion. With
    the lengths h_k and s_k = h_{k-1} + h_k,

    .. math::
        v_k = 2 (P_k - P_{k-1}) / s_k, \qquad
        q_k = P_{k-1} + h_{k-1} (P_k - P_{k-1}) / s_k, \qquad
        a_k = (v_{k+1} - v_k) / h_k,

    so that the double integrator holds exactly without rows, the motion on interval k
    depends on P_{k-1}, P_k, P_{k+1} alone, the curve lies in the convex hull of the
    control points (position limits hold at all times) and speed is piecewise linear
    (speed limits hold at all times, too). Torques at both ends of every interval follow
    from the inverse dynamics. With the accelerations as controls, torque limits are the
    paper's state-dependent control limits (its section 4): u_l <= u(q, v, a) <= u_u.

    Attributes:
        duration: Duration that scales the rows of velocities [s].
    """

    inspected = ((0.1, 0.2, 0.275, 0.35, 0.425, 0.5, 0.575, 0.65, 0.725, 0.8, 0.9),)
    highest_order = 2

    def __init__(
        self,
        system: ProblemFunctions,
        shares: Array,
        duration: float,
        segment_ends: tuple[int, ...] = (),
    ) -> None:
        super().__init__(system, shares, 2, segment_ends)
        self.duration = duration

    def start(self, position: PositionFunction, guessed: float, eta: Array) -> Array:
        """Iterate for a guess: parabolas through its nodes and middles.

        Sampling the guess at the Greville abscissae instead would demand torques far
        beyond their limits on short intervals, if the samples of the guess are sparse.

        Args:
            position: Configurations at times, shape (k,) to (k, n).
            guessed: Duration of the guess [s].
            eta: Durations of the iterate, shape (m,).
        """
        nodes = nodes_of(self.shares.sum(axis=1))
        nodes = guessed * nodes / nodes[-1]
        q, middle = position(nodes), position(0.5 * (nodes[1:] + nodes[:-1]))
        limits = self.system.problem.robot.limits
        points = 2.0 * middle - 0.5 * (q[1:] + q[:-1])
        points = np.clip(points, limits.position_lower, limits.position_upper)
        v_end = self.system.final_velocity
        v_end = np.zeros(self.system.n) if v_end is None else v_end
        points[-1] = q[-1] - 0.5 * (self.shares[-1] @ eta) * v_end
        points = np.concatenate([self._base[None], points, q[-1:]])
        return self.unknowns(points, eta)

    @cached_property
    def _torque_instants(self) -> Instants:
        """Both ends of every interval, at which accelerations jump."""
        N = self.intervals
        return Instants.spread(N, (0.0,)).joined(Instants.spread(N, (1.0,)))

    @property
    def torque_sequence(self) -> sp.csr_matrix:
        """Matrix to the mean torques of intervals from the torques at their ends."""
        N = self.intervals
        return sp.csr_matrix(sp.diags([0.5, 0.5], [0, N], shape=(N, 2 * N)))

    def hull(
        self, limit: JointLimit, name: str, within: tuple[int, int] | None = None
    ) -> HullRows[SplineMotion] | None:
        """Bounds on control points for positions, on nodes for velocities."""
        if limit.order == 1:
            return self._speeds(limit, name)
        return super().hull(limit, name) if limit.order == 0 else None

    def _speeds(self, limit: JointLimit, name: str) -> HullRows[SplineMotion]:
        """Speed limits at nodes with free velocities; speeds are linear between nodes.

        |v_k| <= v_max, multiplied by h_{k-1} + h_k, is linear in control points and
        lengths.
        """
        free_end = self.system.final_velocity is None
        nodes = np.arange(1, self.intervals + free_end)
        # Derivatives by the durations of twice the time between neighbouring points.
        knots = self.knots_by_durations
        apart = (knots[3:-1] - knots[1:-3])[nodes]
        unit = 2.0 * self.duration / self.intervals
        shape = 1, 2 * nodes.size * limit.count

        def excess(motion: SplineMotion) -> Array:
            """Excess of the speeds over their limits, in both directions."""
            steps = np.diff(motion.points, axis=0)[nodes]
            ratio = 2.0 * steps[:, limit.of_joints] / limit.upper
            lasting = (apart @ motion.eta)[:, None]
            return np.stack([ratio - lasting, -ratio - lasting]) / unit

        def by_unknowns(motion: SplineMotion) -> sp.csr_matrix:
            """Jacobian of the excess of the speeds."""
            slope = 2.0 / (limit.upper * unit)
            pull = np.stack([-slope, slope], axis=1)[None].repeat(nodes.size, axis=0)
            by_eta = -np.take_along_axis(apart, self.near[nodes], axis=1) / unit
            by_eta = by_eta[:, None].repeat(limit.count, axis=1)
            rows = nodes, limit.of_joints, by_eta
            both = [self.of_joints(motion.eta, side * pull, *rows) for side in (1, -1)]
            return sp.vstack(both, format="csr")

        bounds = np.full(shape, -np.inf), np.zeros(shape)
        return HullRows(name, bounds, excess, by_unknowns)
