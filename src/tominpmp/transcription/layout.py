"""Layouts: how a motion was parameterised, to take it up again on a finer grid.

Splines of a grid are splines of any grid that has its nodes and more: splitting
intervals leaves a motion as it is, to the last bits, and gives it room to become faster
where its accelerations bend. A layout is a few arrays, so that it can be kept with a
motion, or sent from one process to another, where a program could not.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse.linalg import spsolve

from tominpmp.arrays import Array, BoolArray, IntArray
from tominpmp.motion.trajectory import Trajectory
from tominpmp.problem.segments import Segment, spans_of
from tominpmp.transcription.bspline import BSplineTranscription
from tominpmp.transcription.bspline_basis import Basis
from tominpmp.transcription.bspline_segments import SegmentedBSpline
from tominpmp.transcription.collocation import CollocationTranscription
from tominpmp.transcription.controls import net_torque
from tominpmp.transcription.inverse import InverseTranscription
from tominpmp.transcription.problem_functions import ProblemFunctions

Gridded = (
    InverseTranscription
    | CollocationTranscription
    | BSplineTranscription
    | SegmentedBSpline
)
ControlPoints = BSplineTranscription | SegmentedBSpline
# Degrees of what is no spline in control points.
LIFTED, QUADRATIC = 0, 2


@dataclass(frozen=True, eq=False)
class Layout:
    """The grid of a motion and what runs on it.

    Attributes:
        degree: Of the splines of its positions; 2 for constant accelerations, and 0 for
            states and constant torques.
        shares: Lengths of the intervals by the last unknowns, shape (N, m).
        eta: These unknowns, shape (m,).
        segment_ends: Number of intervals up to the end of each segment; None for one.
    """

    degree: int
    shares: Array
    eta: Array
    segment_ends: tuple[int, ...] | None = None

    @classmethod
    def of(cls, transcription: object, z: Array) -> Layout | None:
        """Layout of an iterate; None where torques are all that is parameterised."""
        if not isinstance(transcription, Gridded):
            return None
        degree = LIFTED
        if isinstance(transcription, InverseTranscription):
            degree = QUADRATIC
        elif not isinstance(transcription, CollocationTranscription):
            degree = transcription.degree
        shares = transcription.shares
        eta = np.array(z[z.size - shares.shape[1] :])
        return cls(degree, shares, eta, transcription.segment_ends)

    @classmethod
    def of_motion(cls, motion: Trajectory) -> Layout | None:
        """Layout of a motion whose torques follow from it, of one segment.

        None for others: their nodes are not those of intervals.
        """
        if motion.inverse_dynamics is None or motion.segment_ends is not None:
            return None
        shares = np.diff(motion.t)[:, None] / motion.duration
        return cls(motion.degree, shares, np.array([motion.duration]))

    @classmethod
    def of_segments(
        cls, motion: Trajectory, segments: Sequence[Segment]
    ) -> Layout | None:
        """Layout of a motion of several segments whose torques follow from it.

        Args:
            motion: The motion.
            segments: What was asked of them.
        """
        if motion.inverse_dynamics is None or motion.segment_ends is None:
            return None
        lengths = []
        for begin, arrival, _ in spans_of(motion, segments):
            moving = (motion.t >= begin) & (motion.t <= arrival)
            lengths.append(np.diff(motion.t[moving]))
        counts = [part.size for part in lengths]
        shares = np.zeros((sum(counts), len(counts)))
        segment = np.repeat(np.arange(len(counts)), counts)
        shares[np.arange(segment.size), segment] = np.concatenate(lengths)
        ends = tuple(np.cumsum(counts).tolist())
        return cls(motion.degree, shares, np.ones(len(counts)), ends)

    def transcription(self, system: ProblemFunctions) -> Gridded:
        """The parameterisation, for the functions of a problem."""
        duration = float(np.sum(self.shares @ self.eta))
        if self.degree == LIFTED:
            return CollocationTranscription(system, self.shares, duration)
        if self.degree == QUADRATIC:
            return InverseTranscription(
                system, self.shares, duration, segment_ends=self.segment_ends
            )
        if self.segment_ends is None:
            return BSplineTranscription(system, self.shares, self.degree)
        return SegmentedBSpline(system, self.shares, self.degree, self.segment_ends)

    def taken_up(
        self, system: ProblemFunctions, motion: Trajectory
    ) -> tuple[Gridded, Array]:
        """The parameterisation, and a motion that was made with it as its iterate.

        Args:
            system: The functions of the problem that the motion solves.
            motion: The motion.
        """
        of, eta, plain = self.transcription(system), self.eta, _plain(motion)
        h = self.shares @ eta
        t = np.concatenate([[0.0], np.cumsum(h)])
        # A motion that stays somewhere does so after the interval that ends there.
        delays = np.append(of.delays, of.delays[-1])
        if isinstance(of, ControlPoints):

            def position(times: Array) -> Array:
                interval = np.searchsorted(t[1:-1], times)
                return plain(times + delays[interval]).q

            return of, interpolated(of, eta, position)
        state = plain(np.minimum(t + delays, motion.duration))
        if isinstance(of, InverseTranscription):
            points = state.q[:-1] + 0.5 * h[:, None] * state.v[:-1]
            points[0], points[-1] = state.q[0], state.q[-1]
            return of, of.pack(points, state.v[-1], eta)
        middle = motion(0.5 * (t[1:] + t[:-1]))
        u = net_torque(system, middle.u, middle.v)
        return of, of.pack(np.hstack([state.q, state.v]), u, eta)


def _plain(motion: Trajectory) -> Trajectory:
    """A motion whose torques nobody asks for."""
    return replace(motion, inverse_dynamics=None)


def interpolated(
    of: ControlPoints, eta: Array, position: Callable[[Array], Array]
) -> Array:
    """Iterate of the spline that goes through positions at the Greville abscissae.

    Args:
        of: The parameterisation.
        eta: Its durations, shape (m,).
        position: Configurations at times, shape (k,) to (k, n); they are met at all
            times if they are those of such a spline.
    """
    nodes = np.concatenate([[0.0], np.cumsum(of.shares @ eta)])
    basis = Basis.on(nodes, of.degree)
    sites = basis.greville
    points = spsolve(basis.at(sites).tocsc(), position(sites))
    return of.unknowns(np.reshape(points, (basis.count, -1)), eta)


def split_intervals(of: Gridded, z: Array, split: BoolArray) -> tuple[Gridded, Array]:
    """Halve intervals, without a change of the motion.

    Args:
        of: The parameterisation.
        z: An iterate of it.
        split: Which intervals to halve, shape (N,).

    Returns:
        The parameterisation on the new grid, and the iterate.
    """
    parts: IntArray = 1 + split.astype(np.int64)
    layout = Layout.of(of, z)
    assert layout is not None  # noqa: S101
    # Whatever could stretch by itself still can.
    shares = np.repeat(layout.shares / parts[:, None], parts, axis=0)
    ends = layout.segment_ends
    if ends is not None:
        ends = tuple(np.cumsum(parts)[np.array(ends) - 1].tolist())
    finer = replace(layout, shares=shares, segment_ends=ends).transcription(of.system)
    if isinstance(of, InverseTranscription):
        assert isinstance(finer, InverseTranscription)  # noqa: S101
        return finer, _split_quadratic(of, z, parts, finer)
    if isinstance(of, CollocationTranscription):
        assert isinstance(finer, CollocationTranscription)  # noqa: S101
        return finer, _split_states(of, z, parts, finer)
    assert isinstance(finer, ControlPoints)  # noqa: S101
    nodes = np.concatenate([[0.0], np.cumsum(of.shares @ layout.eta)])
    basis, points = Basis.on(nodes, of.degree), of.points(z)
    return finer, interpolated(finer, layout.eta, lambda t: basis.at(t) @ points)


def _split_quadratic(
    of: InverseTranscription, z: Array, parts: IntArray, finer: InverseTranscription
) -> Array:
    spline = of.motion(z)
    index = np.repeat(np.arange(parts.size), parts)
    second = np.concatenate([[False], index[1:] == index[:-1]])
    halved = parts[index] == 2
    # De Casteljau: the middle points of the halves lie halfway to the ends.
    ends = np.where(second[:, None], spline.q[1:][index], spline.q[:-1][index])
    points = spline.points[index]
    points = np.where(halved[:, None], 0.5 * (points + ends), points)
    points[0], points[-1] = spline.q_ends  # as the transcription packs them
    return finer.pack(points, spline.v_ends[1], z[z.size - of.shares.shape[1] :])


def _split_states(
    of: CollocationTranscription,
    z: Array,
    parts: IntArray,
    finer: CollocationTranscription,
) -> Array:
    x, u, h = of.split(z)
    first = np.cumsum(parts) - parts
    t = np.concatenate([[0.0], np.cumsum(h)])
    states = np.empty((finer.intervals + 1, x.shape[1]))
    states[first], states[-1] = x[:-1], x[-1]
    halved = np.flatnonzero(parts == 2)
    inside = of.trajectory(z)(0.5 * (t[halved] + t[halved + 1]))
    states[first[halved] + 1] = np.hstack([inside.q, inside.v])
    eta = z[z.size - of.shares.shape[1] :]
    return finer.pack(states, np.repeat(u, parts, axis=0), eta)
