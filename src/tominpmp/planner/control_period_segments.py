"""Motions of one or more segments, and the clock of a controller.

Each segment takes a whole number of periods, and so does each stay, which is as long as
was asked for or longer by less than a period. On these knots the motion is stretched as
one, as that of a single segment is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tominpmp.arrays import Array
from tominpmp.certificate.stays import with_stays
from tominpmp.initial_guess.segments import SegmentedGuess, solved_guess
from tominpmp.initial_guess.warm_start import WarmStart, warm_start
from tominpmp.motion.trajectory import Trajectory
from tominpmp.options import FEWEST_PERIODS
from tominpmp.problem import Problem
from tominpmp.problem.segments import Segment, Span, spans_of
from tominpmp.transcription.bspline import BSplineTranscription
from tominpmp.transcription.grid import Ticks, at_ticks, ticks_of, whole_periods
from tominpmp.transcription.inverse import InverseTranscription
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import TRACE, NonlinearProgram


@dataclass(frozen=True, eq=False)
class Course:
    """A motion without a clock that is to be brought to one.

    Attributes:
        problem: What it solves, with stays of whole periods.
        asked: The segments as they were asked for; empty where there is one.
        motion: The motion.
        spans: When its segments begin, meet their goals, and end.
        period: The period [s].
    """

    problem: Problem
    asked: Sequence[Segment]
    motion: Trajectory
    spans: list[Span]
    period: float

    @classmethod
    def of(cls, problem: Problem, motion: Trajectory, period: float) -> Course:
        """A motion of a problem, and the period that it is brought to [s]."""
        asked = problem.segments
        stays = [whole_periods(segment.dwell, period) for segment in asked]
        chosen = with_stays(problem.alternative_of(motion), stays)
        return cls(chosen, asked, motion, spans_of(motion, asked), period)

    @property
    def segments(self) -> Sequence[Segment]:
        """The segments; one where the problem has none."""
        return self.problem.segments or (Segment(self.problem.goal),)

    @cached_property
    def system(self) -> ProblemFunctions:
        """The functions of the problem."""
        return ProblemFunctions.of(self.problem)

    @property
    def nodes(self) -> list[Array]:
        """Nodes of the motion on each segment, without its stay [s]."""
        t = self.motion.t
        return [t[(t >= begin) & (t <= arrival)] for begin, arrival, _ in self.spans]

    @property
    def intervals(self) -> int:
        """Number of intervals of the motion, without its stays."""
        return sum(nodes.size - 1 for nodes in self.nodes)

    def guess(self, motion: Trajectory) -> WarmStart | SegmentedGuess:
        """A motion of the problem as a guess."""
        if self.asked:
            return solved_guess("clock", motion, self.asked)
        return warm_start(self.system, motion)

    @property
    def periods(self) -> tuple[int, ...]:
        """Periods of the segments in which they are no faster than the motion.

        One that takes as long as it does since it may not arrive earlier takes as many
        as that asks for.
        """
        found = []
        for span, segment in zip(self.spans, self.segments, strict=True):
            earliest = 0.0 if segment.arrival is None else segment.arrival[0]
            waits = span.arrival <= (1.0 + TRACE) * earliest
            moving = 0.0 if waits else span.arrival - span.begin
            found.append(ticks_of(moving, self.period))
        return self.on_time(found)

    def on_time(self, periods: Sequence[int]) -> tuple[int, ...]:
        """Periods of the segments, no fewer than they need and within their windows.

        Args:
            periods: How many are wanted.
        """
        found: list[int] = []
        now = since = 0
        for count, segment in zip(periods, self.segments, strict=True):
            tick, rests = now + count, len(found) == len(periods) - 1 or segment.stop
            if segment.arrival is not None:
                earliest, latest = segment.arrival
                tick = max(tick, ticks_of(earliest, self.period))
                if latest < np.inf:
                    tick = min(tick, -ticks_of(-latest, self.period))
            # What is passed needs no more than one, but from rest to rest there are
            # some.
            fewest = max(FEWEST_PERIODS - since, 1) if rests else 1
            found.append(max(tick - now, fewest))
            since = 0 if rests else since + found[-1]
            now += found[-1] + ticks_of(segment.dwell, self.period)
        return tuple(found)

    def knots(
        self,
        periods: Sequence[int],
        intervals: int,
        guess: WarmStart | SegmentedGuess,
    ) -> Knots:
        """Knots near the nodes of the motion.

        Args:
            periods: Number of periods of each segment, without its stay.
            intervals: Number of intervals that are wanted at least.
            guess: What is brought to them.
        """
        knots, ends = np.zeros(1, dtype=np.int64), []
        for nodes, count in zip(self.nodes, periods, strict=True):
            wanted = -(-intervals * (nodes.size - 1) // self.intervals)
            own = Ticks.near(self.period, count, nodes - nodes[0], wanted).knots
            knots = np.concatenate([knots, knots[-1] + own[1:]])
            ends.append(knots.size - 1)
        ticks = Ticks(self.period, knots)
        return Knots(ticks, tuple(ends), guess, self.motion.degree)


@dataclass(frozen=True, eq=False)
class Knots:
    """Knots on a clock, and a motion that is brought to them.

    Attributes:
        ticks: The knots, without the stays.
        ends: Number of intervals up to the end of each segment, shape (k,).
        guess: The motion, without the stays.
        degree: Of its positions between the knots.
    """

    ticks: Ticks
    ends: tuple[int, ...]
    guess: WarmStart | SegmentedGuess
    degree: int

    def program(self, system: ProblemFunctions) -> tuple[NonlinearProgram, Array]:
        """Program on the knots, and an iterate near to the motion."""
        if isinstance(self.guess, WarmStart):
            return self.guess.clocked_program(system, self.ticks)
        T, shares, ends = self.ticks.duration, self.ticks.shares, self.ends
        guess, own = self.guess, self.ticks.times[[0, *ends]]
        former = np.append(0.0, guess.ends)

        def position(times: Array) -> Array:
            return guess.position(np.interp(times, own, former))

        if self.degree > 2:
            spline = BSplineTranscription(system, shares, self.degree, ends)
            z = spline.interpolated(np.array([T]), position)
            program = NonlinearProgram.of(spline).at(z)
        else:
            steps = InverseTranscription(system, shares, T, ends)
            z = steps.start(position, T, np.array([T]))
            program = NonlinearProgram.of(steps).at(z)
        return replace(program, least_duration=T), z

    def timed(self, motion: Trajectory) -> Trajectory:
        """A motion with its stays, its nodes on the ticks to the last bit."""
        t, ends = at_ticks(motion.t, self.ticks.period), motion.segment_ends
        if ends is not None:
            ends = t[np.searchsorted(motion.t, ends)]
        return replace(motion, t=t, segment_ends=ends)
