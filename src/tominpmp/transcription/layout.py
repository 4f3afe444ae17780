"""Layouts: the parameterisation of a motion, from which a finer grid can continue.

A spline on a grid is a spline on any grid that contains its nodes: splitting intervals
leaves a motion unchanged, to the last bits, and lets it become faster where its
accelerations bend. A layout is a few arrays, so that it can be kept with a motion, or
sent from one process to another, which a program cannot.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tominpmp.arrays import Array, BoolArray, IntArray
from tominpmp.motion.trajectory import Trajectory
from tominpmp.problem.segments import Segment, spans_of
from tominpmp.transcription.bspline import BSplineTranscription
from tominpmp.transcription.collocation import CollocationTranscription
from tominpmp.transcription.controls import net_torque
from tominpmp.transcription.curve import nodes_of
from tominpmp.transcription.inverse import InverseTranscription
from tominpmp.transcription.problem_functions import ProblemFunctions

Gridded = BSplineTranscription | CollocationTranscription
# Degrees of states and constant torques, and of constant accelerations.
LIFTED, QUADRATIC = 0, 2


@dataclass(frozen=True, eq=False)
class Layout:
    """The grid of a motion and the degree of its parameterisation.

    Attributes:
        degree: Degree of the splines of its positions; 2 for constant accelerations,
            and 0 for states and constant torques.
        shares: Lengths of the intervals by the last unknowns, shape (N, m).
        eta: The last unknowns, the durations, shape (m,).
        segment_ends: Number of intervals up to the end of each segment.
    """

    degree: int
    shares: Array
    eta: Array
    segment_ends: tuple[int, ...]

    @classmethod
    def of(cls, transcription: object, z: Array) -> Layout | None:
        """Layout of an iterate; None where only torques are parameterised."""
        if not isinstance(transcription, Gridded):
            return None
        degree = LIFTED
        if isinstance(transcription, BSplineTranscription):
            degree = transcription.degree
        shares = transcription.shares
        eta = np.array(z[z.size - shares.shape[1] :])
        return cls(degree, shares, eta, transcription.segment_ends)

    @classmethod
    def of_motion(
        cls, motion: Trajectory, segments: Sequence[Segment] = ()
    ) -> Layout | None:
        """Layout of a motion whose torques follow from the inverse dynamics.

        None for other motions: their nodes are not the nodes of a grid.

        Args:
            motion: The motion.
            segments: The segments of its problem; empty for one.
        """
        if motion.inverse_dynamics is None:
            return None
        lengths = []
        for begin, arrival, _ in spans_of(motion, segments):
            moving = (motion.t >= begin) & (motion.t <= arrival)
            lengths.append(np.diff(motion.t[moving]))
        counts = [part.size for part in lengths]
        segment, T = np.repeat(np.arange(len(counts)), counts), motion.duration
        shares = np.zeros((segment.size, len(counts)))
        shares[np.arange(segment.size), segment] = np.concatenate(lengths) / T
        ends = tuple(np.cumsum(counts).tolist())
        return cls(motion.degree, shares, np.full(len(counts), T), ends)

    def transcription(self, system: ProblemFunctions) -> Gridded:
        """The parameterisation, for the functions of a problem."""
        duration, ends = float(np.sum(self.shares @ self.eta)), self.segment_ends
        if self.degree == LIFTED:
            return CollocationTranscription(system, self.shares, duration)
        if self.degree == QUADRATIC:
            return InverseTranscription(system, self.shares, duration, ends)
        return BSplineTranscription(system, self.shares, self.degree, ends)

    def represented(
        self, system: ProblemFunctions, motion: Trajectory
    ) -> tuple[Gridded, Array]:
        """The parameterisation, and a motion found with it as its iterate.

        Args:
            system: The functions of the problem that the motion solves.
            motion: The motion.
        """
        of, eta = self.transcription(system), self.eta
        t = nodes_of(self.shares @ eta)
        if isinstance(of, BSplineTranscription):
            # A dwell follows the interval that ends at its node.
            delays, plain = of.delays, replace(motion, inverse_dynamics=None)

            def position(times: Array) -> Array:
                interval = np.searchsorted(t[1:-1], times)
                return plain(times + delays[interval]).q

            return of, of.interpolated(eta, position)
        nodes, middle = (
            motion(np.minimum(t, motion.duration)),
            motion(0.5 * (t[1:] + t[:-1])),
        )
        u = net_torque(system, middle.u, middle.v)
        return of, of.pack(np.hstack([nodes.q, nodes.v]), u, eta)


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
    # Parts of the motion that had durations of their own keep them.
    shares = np.repeat(layout.shares / parts[:, None], parts, axis=0)
    ends = tuple(np.cumsum(parts)[np.array(layout.segment_ends) - 1].tolist())
    finer = replace(layout, shares=shares, segment_ends=ends).transcription(of.system)
    if isinstance(of, BSplineTranscription):
        assert isinstance(finer, BSplineTranscription)  # noqa: S101
        return finer, finer.interpolated(layout.eta, of.motion(z).positions)
    assert isinstance(finer, CollocationTranscription)  # noqa: S101
    x, u, h = of.split(z)
    first = np.cumsum(parts) - parts
    t = nodes_of(h)
    states = np.empty((finer.intervals + 1, x.shape[1]))
    states[first], states[-1] = x[:-1], x[-1]
    halved = np.flatnonzero(split)
    inside = of.trajectory(z)(0.5 * (t[halved] + t[halved + 1]))
    states[first[halved] + 1] = np.hstack([inside.q, inside.v])
    return finer, finer.pack(states, np.repeat(u, parts, axis=0), layout.eta)
