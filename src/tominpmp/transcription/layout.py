"""Layouts: the parameterisation of a motion as data, from which it can be refined.

A spline on a grid is also a spline on any grid that contains its nodes: splitting
intervals leaves a motion unchanged up to rounding, and lets the optimisation make it
faster where its accelerations change. A layout consists of a few arrays, so that it can
be stored with a motion or sent to another process, unlike a program.

The intervals to halve are chosen by the jumps of the controls, or by unused torque.
Constant accelerations leave a part of the torque range unused, as torques change while
accelerations are constant. A torque that saturates in an interval reaches its limit at
one end of it only, and stays below the limit elsewhere. The shorter the interval, the
smaller the unused torque.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.linalg import block_diag

from tominpmp.arrays import Array, BoolArray, IntArray
from tominpmp.motion.samples import multiples
from tominpmp.motion.trajectory import Trajectory
from tominpmp.problem.segments import Segment, Span, spans_of
from tominpmp.transcription.bspline import BSplineTranscription, InverseTranscription
from tominpmp.transcription.collocation import CollocationTranscription
from tominpmp.transcription.curve import nodes_of
from tominpmp.transcription.grid import ROUNDING, at_ticks, knots_near
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import NonlinearProgram

Gridded = BSplineTranscription | CollocationTranscription
# Codes of parameterisations in Layout.degree: states with constant torques, and splines
# of constant accelerations.
LIFTED, QUADRATIC = CollocationTranscription.degree, 2
# Intervals shorter than this share of the mean are not taken over into a grid, and
# those shorter than this share of T are not halved.
SHORTEST = 1e-3
# Most intervals of a grid after halving; on a clock of a segment, unless its motion has
# more.
MOST_INTERVALS = 300
# The intervals to halve hold this share of the sum of all losses. The loss of an
# interval is its length times the largest jump of the controls, or of their slopes,
# around it, or times its unused torque.
HALVED_SHARE = 0.95
# A finer grid gains nothing on an interval in which a limiting joint, one that
# determines T, is at its speed limit throughout. A joint counts as limiting if it is at
# its speed limit for the share LIMITING of T; other joints may reach theirs only to
# support its motion elsewhere.
LIMITING = 0.4
# Speeds and torques beyond this share of their limits count as being at them.
AT_LIMIT = 0.99
# If constant accelerations leave more than this mean share of the half range of
# saturated torques unused, intervals are chosen by the unused torque instead of the
# jumps.
MUCH_MISSING = 1e-2


@dataclass(frozen=True, eq=False)
class Layout:
    """The grid of a motion and the degree of its parameterisation.

    Attributes:
        degree: Degree of the position splines: 2 for constant accelerations; 0 for
            states and constant torques.
        shares: Lengths of the intervals by the last unknowns, shape (N, m).
        eta: The last unknowns, which are the durations, shape (m,).
        segment_ends: Number of intervals up to the end of each segment.
        breaks: Nodes, as the number of intervals before each, at which the derivative
            one order below the highest may jump.
    """

    degree: int
    shares: Array
    eta: Array
    segment_ends: tuple[int, ...]
    breaks: tuple[int, ...] = ()

    @classmethod
    def of(cls, transcription: Gridded, z: Array) -> Layout:
        """Layout of an iterate."""
        shares = transcription.shares
        eta = np.array(z[z.size - shares.shape[1] :])
        ends, breaks = transcription.segment_ends, transcription.breaks
        return cls(transcription.degree, shares, eta, ends, breaks)

    @classmethod
    def of_motion(
        cls, motion: Trajectory, segments: Sequence[Segment] = ()
    ) -> Layout | None:
        """Layout of a motion whose torques follow from the inverse dynamics.

        None for other motions, whose nodes are not the nodes of a grid.

        Args:
            motion: The motion.
            segments: The segments of its problem; empty for a problem without segments.
        """
        if motion.inverse_dynamics is None:
            return None
        lengths = []
        for begin, arrival, _ in spans_of(motion, segments):
            moving = (motion.t >= begin) & (motion.t <= arrival)
            lengths.append(np.diff(motion.t[moving]))
        shares = block_diag(*(part[:, None] for part in lengths)) / motion.duration
        ends = tuple(np.cumsum([part.size for part in lengths]).tolist())
        eta = np.full(len(lengths), motion.duration)
        return cls(motion.degree, shares, eta, ends)

    @classmethod
    def of_torques(cls, motion: Trajectory) -> Layout:
        """Layout with states and torques for a motion with piecewise constant torques.

        Nodes very close to their neighbours, such as reversals of joints with dry
        friction, are left out.
        """
        h = np.diff(motion.t)
        apart = np.minimum(h[:-1], h[1:]) >= SHORTEST * h.mean()
        lengths = np.diff(motion.t[np.concatenate([[True], apart, [True]])])
        T = motion.duration
        return cls(LIFTED, lengths[:, None] / T, np.array([T]), (lengths.size,))

    @classmethod
    def on_clock(
        cls,
        motion: Trajectory,
        spans: Sequence[Span],
        period: float,
        periods: Sequence[int],
        halvings: int,
    ) -> Layout:
        """Layout of a motion with its nodes moved to ticks of a clock, without dwells.

        Args:
            motion: The motion.
            spans: When its segments begin, meet their goals, and end.
            period: The period [s].
            periods: Number of periods of each segment.
            halvings: How often its intervals are halved, up to :data:`MOST_INTERVALS`
                in each segment.
        """
        knots, ends = np.zeros(1, dtype=np.int64), []
        for (begin, arrival, _), count in zip(spans, periods, strict=True):
            nodes = motion.t[(motion.t >= begin) & (motion.t <= arrival)]
            intervals = nodes.size - 1
            finer = min(2**halvings * intervals, max(intervals, MOST_INTERVALS))
            knots = np.append(knots, knots[-1] + knots_near(nodes, count, finer)[1:])
            ends.append(knots.size - 1)
        degree = QUADRATIC if motion.inverse_dynamics is None else motion.degree
        shares = np.diff(knots)[:, None] / knots[-1]
        return cls(degree, shares, multiples(knots[-1:], period), tuple(ends))

    def halved(self, split: BoolArray) -> Layout:
        """The layout with some of its intervals halved.

        Parts of the motion with separate durations keep them.

        Args:
            split: Whether to halve each interval, shape (N,).
        """
        parts: IntArray = 1 + split.astype(np.int64)
        before = np.concatenate([[0], np.cumsum(parts)])
        return replace(
            self,
            shares=np.repeat(self.shares / parts[:, None], parts, axis=0),
            segment_ends=tuple(before[list(self.segment_ends)].tolist()),
            breaks=tuple(before[list(self.breaks)].tolist()),
        )

    def with_intervals(self, count: int) -> Layout:
        """The layout with its longest intervals halved, until it has ``count``."""
        missing = count - len(self.shares)
        if missing <= 0:
            return self
        split = np.zeros(len(self.shares), dtype=bool)
        longest = np.argsort(-(self.shares @ self.eta), kind="stable")
        split[longest[:missing]] = True
        return self.halved(split).with_intervals(count)

    def transcription(self, system: ProblemFunctions) -> Gridded:
        """The parameterisation, for the functions of a problem."""
        duration, ends = float(np.sum(self.shares @ self.eta)), self.segment_ends
        if self.degree == LIFTED:
            return CollocationTranscription(system, self.shares, duration)
        if self.degree == QUADRATIC:
            return InverseTranscription(system, self.shares, duration, ends)
        return BSplineTranscription(
            system, self.shares, self.degree, ends, breaks=self.breaks
        )

    def represented(
        self,
        system: ProblemFunctions,
        motion: Trajectory,
        spans: Sequence[Span] | None = None,
        *,
        within: bool = False,
    ) -> tuple[NonlinearProgram, Array]:
        """The program of the layout, and the motion as an iterate of it.

        The motion is unchanged if it was found with this parameterisation, or on a grid
        whose nodes are a subset of the nodes here. If it is a spline, each segment may
        be scaled to another duration.

        Args:
            system: The functions of the problem that the motion solves.
            motion: The motion.
            spans: Times at which its segments begin, reach their goals, and end; None
                derives them from the dwells of the problem.
            within: Whether to clip control points to the position limits, which may be
                necessary if the motion is not a spline on this grid.
        """
        marks = motion.segment_ends
        passed = motion.q[-1:] if marks is None else motion(marks, 0)
        of, eta = self.transcription(system.passing(passed)), self.eta
        t = nodes_of(self.shares @ eta)
        if isinstance(of, BSplineTranscription):
            spans = spans or spans_of(motion, system.problem.segments)
            begins, arrivals, _ = np.array(spans).T
            ends, moving = t[[0, *self.segment_ends]], nodes_of(arrivals - begins)
            dwelt = begins - moving[:-1]

            def position(times: Array) -> Array:
                before = dwelt[np.searchsorted(ends[1:-1], times)]
                return motion(np.interp(times, ends, moving) + before, 0)

            z = of.interpolated(eta, position)
            z = of.within_limits(z) if within else z
        else:
            end = motion.duration
            z = of.through(lambda times: motion(np.minimum(times, end)), t, eta)
        return NonlinearProgram.of(of).at(z), z


def split_intervals(of: Gridded, z: Array, split: BoolArray) -> tuple[Gridded, Array]:
    """Halve intervals without changing the motion.

    Args:
        of: The parameterisation.
        z: An iterate of it.
        split: Whether to halve each interval, shape (N,).

    Returns:
        The parameterisation on the new grid, and the iterate.
    """
    layout = Layout.of(of, z)
    finer = layout.halved(split).transcription(of.system)
    if isinstance(of, BSplineTranscription):
        assert isinstance(finer, BSplineTranscription)  # noqa: S101
        return finer, finer.interpolated(layout.eta, of.motion(z).positions)
    assert isinstance(finer, CollocationTranscription)  # noqa: S101
    x, u, h = of.split(z)
    t, halved = nodes_of(h), np.flatnonzero(split)
    inside = of.trajectory(z)(0.5 * (t[halved] + t[halved + 1]))
    states = np.insert(x, halved + 1, np.hstack([inside.q, inside.v]), axis=0)
    return finer, finer.pack(states, np.repeat(u, 1 + split, axis=0), layout.eta)


def on_ticks(motion: Trajectory, period: float) -> Trajectory:
    """A motion with its nodes rounded to ticks, exact to the last bit.

    A motion with nodes between the ticks is returned unchanged.
    """
    t, ends = at_ticks(motion.t, period), motion.segment_ends
    if not np.allclose(t, motion.t, 0.0, ROUNDING * period):
        return motion
    ends = None if ends is None else at_ticks(ends, period)
    return replace(motion, t=t, segment_ends=ends)


def intervals_to_halve(of: Gridded, z: Array) -> BoolArray:
    """Whether to halve each interval, (N,): the intervals with most of the losses.

    Where torques limit constant accelerations, the intervals with saturated torques are
    halved: the jumps of the halves are no smaller, but they use more of the torque.

    Args:
        of: The parameterisation.
        z: An iterate of it.
    """
    h = of.motion(z).h
    losses = _unused_torques(of, z, h)
    if losses is None:
        losses = _jumps(of, z, h)
    losses[h < SHORTEST * h.sum()] = 0.0
    order = np.argsort(-losses, kind="stable")
    before = np.cumsum(losses[order]) - losses[order]
    split = np.zeros(h.size, dtype=bool)
    split[order] = (losses[order] > 0.0) & (before < HALVED_SHARE * losses.sum())
    split[order[max(MOST_INTERVALS - h.size, 0) :]] = False
    return split


def _unused_torques(of: Gridded, z: Array, h: Array) -> Array | None:
    """Unused torque times interval length, shape (N,); None if small.

    For each interval, it is the largest over all joints of the mean unused torque of a
    saturated joint, as a share of the half range, and of the jump of a torque around
    the interval, weighted by the share of the interval in T.
    """
    if not isinstance(of, InverseTranscription):
        return None
    at = of.instants(2, "")  # the beginnings of all intervals, then their ends
    _, q, v, a, _ = of.states(of.motion(z), at, 2)
    torques = np.empty_like(a)
    for part, (first, last) in zip(of.system.segments, of.segments, strict=True):
        mine = (at.interval >= first) & (at.interval < last)
        torques[mine] = part.torque(q[mine], v[mine], a[mine])
    begin, end = torques.reshape(2, h.size, -1)
    at_limit = np.maximum(np.abs(begin), np.abs(end)) > AT_LIMIT
    missing = np.where(at_limit, 0.5 * np.abs(end - begin), 0.0)
    # Where a torque switches inside an interval, it is between its limits on all of it.
    # The switching function is zero there: the loss is of the second order in length.
    around = np.pad(0.5 * (begin + end), ((1, 1), (0, 0)), mode="edge")
    jumps = 0.5 * np.abs(around[2:] - around[:-2])
    missing = np.maximum(missing, jumps * (h / h.sum())[:, None])
    unused = h * np.max(missing, axis=1)
    return unused if unused.sum() > MUCH_MISSING * h.sum() else None


def _jumps(of: Gridded, z: Array, h: Array) -> Array:
    """Largest jump of the controls, or of their slopes, around each interval, (N,).

    It is multiplied by the length, and zero where limiting speeds saturate.
    """
    jumps = np.abs(of.scaled_at(z).variation(z).at(z))
    N, more = of.intervals, max(of.degree - 3, 0)
    # The jumps are between N intervals, or between N control points and a few more.
    jumps = np.max(jumps.reshape(N - 1 + more, -1), axis=1, initial=0.0)
    losses = h * np.max(sliding_window_view(np.pad(jumps, 1), 2 + more), axis=1)
    limits = of.system.problem.robot.limits
    at_limit = np.abs(of.trajectory(z).v) > AT_LIMIT * limits.velocity
    if at_limit.shape[0] == h.size + 1:  # without dwells, nodes match intervals
        at_limit = at_limit[1:] & at_limit[:-1]
        limiting = h @ at_limit > LIMITING * h.sum()
        losses[np.any(at_limit[:, limiting], axis=1)] = 0.0
    return np.asarray(losses)
