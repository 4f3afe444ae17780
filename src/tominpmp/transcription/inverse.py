"""Inverse dynamics: torque limits as rows on an exact double integrator.

The unknowns are the points of a quadratic spline and the lengths of its intervals (see
:mod:`tominpmp.transcription.spline`); torques at both ends of every interval follow
from the inverse dynamics. This is the paper's state-dependent control limit (its
section 4) for the control v = acceleration: u_l <= u(q, v, a) <= u_u.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array
from tominpmp.constraints import JointLimit, Partials, States
from tominpmp.motion.trajectory import Trajectory
from tominpmp.transcription.base import Hull, StepBounds, Variation
from tominpmp.transcription.curve import CurveTranscription
from tominpmp.transcription.instants import Instants
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.segmented import trajectory_of_segments
from tominpmp.transcription.spline import (
    Spline,
    SplineDerivatives,
    differentiate,
    jumps_by_length,
)
from tominpmp.transcription.spline_rows import (
    ByPoints,
    jumps_by_points,
    pull_back,
    speed_values,
    speeds_by_points,
    states_at,
)

# Lengths of intervals change by this share at most in one step.
LENGTH_STEP = 0.3
# Where constraints are looked at to begin with: those on accelerations, which jump at
# the nodes, and the others.
JUMPING, SMOOTH = (0.0, 1.0), (0.5, 1.0)


@dataclass(frozen=True)
class SplineMotion(Spline):
    """A quadratic spline of an iterate, with what is asked for more than once.

    Attributes:
        shares: Lengths of the intervals by the last unknowns, shape (N, m).
    """

    shares: Array

    finite = True

    @cached_property
    def derivatives(self) -> SplineDerivatives:
        """Derivatives by points and lengths."""
        return differentiate(self)


class InverseTranscription(CurveTranscription[SplineMotion]):
    """A problem in the points of a spline.

    The unknowns are stacked as z = (points, final velocity, lengths): N points of n
    joints, of which the first is the start and the last the final configuration; the
    lengths are h = H eta with a matrix H of shares, of one column (uniform scaling of a
    given grid) or more.

    Attributes:
        system: The functions of the problem.
        shares: H, shape (N, m): lengths of the intervals [s] per unit of eta.
        duration: Duration that scales the rows of velocities [s].
        acceleration_range: What the full torque range of each joint can bring about,
            shape (n,), which controls are measured in; None before a motion was looked
            at.
        segment_ends: Number of intervals up to the end of each segment; None for one.
    """

    inspected = ((0.1, 0.2, 0.275, 0.35, 0.425, 0.5, 0.575, 0.65, 0.725, 0.8, 0.9),)

    def __init__(
        self,
        system: ProblemFunctions,
        shares: Array,
        duration: float,
        acceleration_range: Array | None = None,
        segment_ends: tuple[int, ...] | None = None,
    ) -> None:
        self.system, self.shares, self.duration = system, shares, duration
        self.segment_ends = segment_ends
        self.acceleration_range = acceleration_range
        self._N, self._m = int(shares.shape[0]), int(shares.shape[1])
        self._n = system.n

    # -- unknowns ----------------------------------------------------------------------

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return self._N * self._n + self._n + self._m

    def pack(self, points: Array, v_end: Array, eta: Array) -> Array:
        """Stack points, of which the last is the final configuration, into z."""
        return np.concatenate([points.ravel(), v_end, eta])

    def start(self, position: Callable[[Array], Array], duration: float) -> Array:
        """Iterate for a guess.

        Args:
            position: Configurations at times, shape (k,) to (k, n).
            duration: T of the iterate [s]; the guess is sampled over its own duration,
                which the first argument of the constructor gave.
        """
        guessed = self.duration
        share = self.shares.sum(axis=1)
        nodes = np.concatenate([[0.0], np.cumsum(share)]) / share.sum()
        q = position(nodes * guessed)
        middle = position(0.5 * (nodes[1:] + nodes[:-1]) * guessed)
        # The parabolas through nodes and middles: where these are far from short
        # intervals, their own points would ask for torques beyond all bounds there.
        limits = self.system.problem.robot.limits
        points = 2.0 * middle - 0.5 * (q[1:] + q[:-1])
        points = np.clip(points, limits.position_lower, limits.position_upper)
        points[0], points[-1] = q[0], q[-1]
        v_end = self.system.final_velocity
        v_end = np.zeros(self._n) if v_end is None else v_end
        eta = np.full(self._m, duration / share.sum())
        return self.pack(points, v_end, eta)

    def motion(self, z: Array) -> SplineMotion:
        """Spline of an iterate."""
        N, n = self._N, self._n
        points = z[: N * n].reshape(N, n).copy()
        v_end, h = z[N * n : N * n + n], self.shares @ z[-self._m :]
        v_start = self.system.v_start
        ends = np.stack([self.system.problem.q_start, points[-1]])
        points[0] += 0.5 * h[0] * v_start
        points[-1] -= 0.5 * h[-1] * v_end
        return SplineMotion(points, h, ends, np.stack([v_start, v_end]), self.shares)

    def step_bounds(self, z: Array, radius: float) -> StepBounds:
        """Trust region within position limits, fixed ends and positive lengths."""
        system, N, n, m = self.system, self._N, self._n, self._m
        limits = system.problem.robot.limits
        box = np.broadcast_to(radius * system.step_scale, (N, n))
        points = z[: N * n].reshape(N, n)
        lower = np.maximum(-box, np.minimum(limits.position_lower - points, 0.0))
        upper = np.minimum(box, np.maximum(limits.position_upper - points, 0.0))
        lower[0] = upper[0] = 0.0
        if system.final_configuration is not None:
            lower[-1] = upper[-1] = 0.0
        v_box = np.zeros(n)
        v_end = z[N * n : N * n + n]
        if system.final_velocity is None:
            duration = float(self.cost @ z)
            v_box = 10.0 * radius * system.step_scale / duration
        v_lower = np.maximum(-v_box, np.minimum(-limits.velocity - v_end, 0.0))
        v_upper = np.minimum(v_box, np.maximum(limits.velocity - v_end, 0.0))
        length = min(LENGTH_STEP, radius) * z[-m:]
        return StepBounds(
            np.concatenate([lower.ravel(), v_lower, -length]),
            np.concatenate([upper.ravel(), v_upper, length]),
        )

    # -- states ------------------------------------------------------------------------

    @property
    def goal_scale(self) -> Array | None:
        """None for a configuration, which is a bound."""
        return (
            None if self.system.final_configuration is not None else super().goal_scale
        )

    def instants(self, order: int, field: str) -> Instants:
        """Both ends of every interval for what jumps; else their middles and ends."""
        if order < 2:
            return Instants.spread(self._N, SMOOTH)
        every = np.arange(self._N)
        return Instants(np.tile(every, 2), np.repeat(JUMPING, self._N))

    def states(self, motion: SplineMotion, at: Instants, order: int) -> States:
        """States at instants."""
        found = states_at(motion, at)
        return found._replace(t=found.t + self.delays[at.interval])

    def pull_back(
        self, motion: SplineMotion, at: Instants, partials: Partials
    ) -> sp.csr_matrix:
        """Derivatives by the unknowns from those by the states."""
        return pull_back(motion, motion.derivatives, at, partials, self.shares)

    def hull(
        self, limit: JointLimit, within: tuple[int, int] | None = None
    ) -> Hull[SplineMotion] | None:
        """Positions are held by the points, velocities by the nodes between them."""
        if limit.order == 0:
            return EndPoints(self, limit)
        return Speeds(self, limit) if limit.order == 1 else None

    @property
    def point_unknowns(self) -> int:
        """All but the final velocity and the lengths."""
        return self._N * self._n

    # -- the rest of the interface -----------------------------------------------------

    def scaled_at(self, z: Array) -> InverseTranscription:
        """The same with the range of accelerations at a motion.

        The full range of a joint's acceleration is what its full torque range can bring
        about for an interval against its own inertia and friction, averaged over the
        motion.
        """
        spline = self.motion(z)
        at = self.instants(2, "")
        _, q, v, a, _ = self.states(spline, at, 2)
        by = self.system.dynamics.inverse_jacobians(q, v, a)
        mass = np.einsum("mii->mi", by.tau_a)
        drag = np.abs(np.einsum("mii->mi", by.tau_v)) * spline.h[at.interval, None]
        mean = np.mean(mass + drag, axis=0) / self.system.effort_half
        scale = 2.0 / np.maximum(mean, 1e-12)
        return InverseTranscription(
            self.system, self.shares, self.duration, scale, self.segment_ends
        )

    def variation(self, z: Array) -> Variation:
        """Jumps of the accelerations between intervals, in full ranges."""
        spline, scale = self.motion(z), self.acceleration_range
        if scale is None:
            scale = np.ones(self._n)
        jumps = jumps_by_points(spline.h, scale)
        by_eta = np.zeros((len(jumps.data), self._m))
        if self._m > 1:
            # Lengths that change by themselves must not seem to change nothing.
            by_eta = jumps_by_length(spline, self.shares) / scale[:, None]
            by_eta = by_eta.reshape(-1, self._m)
        by_velocity = np.zeros((len(by_eta), self._n))
        matrix = jumps.by_unknowns(by_velocity, by_eta, self._N)
        offset = (np.diff(spline.a, axis=0) / scale).ravel() - matrix @ z
        return Variation(matrix, offset)

    @property
    def torque_sequence(self) -> sp.csr_matrix:
        """Mean torques of the intervals, from those at both ends of them."""
        return sp.csr_matrix(
            sp.diags([0.5, 0.5], [0, self._N], shape=(self._N, 2 * self._N))
        )

    def stretch(self, z: Array, factor: float) -> Array:
        """The same points, traversed slower."""
        out = z.copy()
        out[-self._m :] *= factor
        return out

    def trajectory(self, z: Array) -> Trajectory:
        """The motion of an iterate; its torque follows from the inverse dynamics."""
        spline = self.motion(z)
        q, v, a = spline.q, spline.v, spline.a
        motion = Trajectory(
            joint_names=self.system.problem.robot.joint_names,
            t=np.concatenate([[0.0], np.cumsum(spline.h)]),
            q=q,
            v=v,
            u=0.0 * q,
            a=a,
        ).with_torques(self.system.motor_dynamics.inverse)
        return trajectory_of_segments(self, motion)


class EndPoints(Hull[SplineMotion]):
    """Positions of the points that hang on the velocities at the ends.

    The others are unknowns, whose bounds keep the limits: the curve lies in the convex
    hull of all points.
    """

    def __init__(self, of: InverseTranscription, limit: JointLimit) -> None:
        system = of.system
        v_end = system.final_velocity
        moving = bool(np.any(system.v_start)) or v_end is None or bool(np.any(v_end))
        self._of, self._limit = of, limit
        self._points = np.array([0, of.intervals - 1] if moving else [], dtype=np.int64)
        self.lower = np.tile(limit.lower / limit.scale, self._points.size)
        self.upper = np.tile(limit.upper / limit.scale, self._points.size)

    def values(self, motion: SplineMotion) -> Array:
        """Positions over their scale."""
        limit = self._limit
        points = motion.points[self._points][:, limit.joints]
        return np.asarray(points / limit.scale).ravel()

    def jacobian(self, motion: SplineMotion) -> sp.csr_matrix:
        """By the unknowns."""
        limit, of = self._limit, self._of
        places = (self._points[:, None] * of.system.n + limit.joints).reshape(-1, 1)
        scale = np.tile(1.0 / limit.scale, self._points.size)
        found = ByPoints(scale[:, None], places)
        ends = found.through_ends(motion, of.shares)
        return found.by_unknowns(*ends, of.intervals)


class Speeds(Hull[SplineMotion]):
    """Speeds at the inner nodes, between which they are linear.

    |v_k| <= v_max times h_{k-1} + h_k is linear in points and lengths.
    """

    def __init__(self, of: InverseTranscription, limit: JointLimit) -> None:
        self._of, self._limit = of, limit
        self._unit = of.duration / of.intervals
        size = 2 * (of.intervals - 1) * limit.count
        self.lower, self.upper = np.full(size, -np.inf), np.zeros(size)
        self._by_points = speeds_by_points(
            limit.upper, limit.joints, self._unit, of.intervals, of.system.n
        )
        lengths = -0.5 / self._unit * (of.shares[:-1] + of.shares[1:])
        self._by_lengths = np.tile(np.repeat(lengths, limit.count, axis=0), (2, 1))

    def values(self, motion: SplineMotion) -> Array:
        """Speeds beyond their limits, either way."""
        limit = self._limit
        return speed_values(motion, limit.upper, limit.joints, self._unit)

    def jacobian(self, motion: SplineMotion) -> sp.csr_matrix:
        """By the unknowns."""
        of = self._of
        by_velocity, by_lengths = self._by_points.through_ends(motion, of.shares)
        by_lengths += self._by_lengths
        return self._by_points.by_unknowns(by_velocity, by_lengths, of.intervals)
