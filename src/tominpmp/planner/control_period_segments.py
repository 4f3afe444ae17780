"""Motions of several segments on the clock of a controller.

Each segment takes a whole number of periods, and so does each stay, which is as long as
was asked for or longer by less than a period. On these knots the motion is stretched as
one, as that of a single segment is.
"""

from __future__ import annotations

import copy
import logging
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.initial_guess.segments import SegmentedGuess, solved_guess
from tominpmp.options import FEWEST_PERIODS, Options
from tominpmp.planner.control_period_outcome import Clocked
from tominpmp.problem import Problem
from tominpmp.sampling import multiples
from tominpmp.solvers.iterate import SlpResult
from tominpmp.solvers.rounds import FAR
from tominpmp.status import STOPPED, Status
from tominpmp.stopping import Deadline
from tominpmp.trajectory import Trajectory
from tominpmp.transcription.bspline_segments import SegmentedBSpline
from tominpmp.transcription.inverse import InverseTranscription
from tominpmp.transcription.layout import interpolated
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import NonlinearProgram
from tominpmp.transcription.ticks import Ticks, ticks_of
from tominpmp.verification.verification import verify

logger = logging.getLogger(__name__)

# Durations that are tried, and by how much longer the next is where nothing tells.
TRIES, LONGER = 12, (0.0, 0.0, 0.005, 0.01, 0.02, 0.04)

Found = tuple[NonlinearProgram, Array | None, SlpResult]


@dataclass(frozen=True, eq=False)
class SegmentTicks:
    """Knots of several segments, and a motion that is brought to them.

    Attributes:
        ticks: The knots, without the stays.
        ends: Number of intervals up to the end of each segment, shape (k,).
        guess: The motion, without the stays.
        degree: Of its positions between the knots.
    """

    ticks: Ticks
    ends: tuple[int, ...]
    guess: SegmentedGuess
    degree: int

    @classmethod
    def near(
        cls,
        period: float,
        guess: SegmentedGuess,
        nodes: Array,
        factor: float,
        degree: int,
    ) -> SegmentTicks:
        """Knots near the nodes of a motion that is slower by a factor.

        Args:
            period: The period [s].
            guess: The motion, without the stays.
            nodes: Its nodes [s], shape (N + 1,), the ends of the segments among them.
            factor: How much slower, at least.
            degree: Of its positions between the knots.
        """
        knots, ends = np.zeros(1, dtype=np.int64), []
        for begin, end in zip(np.append(0.0, guess.ends), guess.ends, strict=False):
            count = max(ticks_of(factor * (end - begin), period), FEWEST_PERIODS)
            own = nodes[(nodes >= begin - 1e-12) & (nodes <= end + 1e-12)] - begin
            part = Ticks.near(period, count, own, own.size - 1)
            knots = np.concatenate([knots, knots[-1] + part.knots[1:]])
            ends.append(knots.size - 1)
        return cls(Ticks(period, knots), tuple(ends), guess, degree)

    def position(self, times: Array) -> Array:
        """Configurations of the motion at times on these knots [s], shape (k, n)."""
        own = self.ticks.times[[0, *self.ends]]
        former = np.append(0.0, self.guess.ends)
        return self.guess.position(np.interp(times, own, former))

    def clocked_program(
        self, system: ProblemFunctions, ticks: Ticks
    ) -> tuple[NonlinearProgram, Array]:
        """Program on the knots, and an iterate near to the motion."""
        T, shares = ticks.duration, ticks.shares
        if self.degree > 2:
            spline = SegmentedBSpline(system, shares, self.degree, self.ends)
            z = interpolated(spline, np.array([T]), self.position)
            program = NonlinearProgram.of(spline).at(z)
        else:
            steps = InverseTranscription(system, shares, T, segment_ends=self.ends)
            z = steps.start(self.position, T)
            program = NonlinearProgram.of(steps).at(z)
        return replace(program, least_duration=T), z

    def timed(self, motion: Trajectory) -> Trajectory:
        """A motion with its stays, its nodes on the ticks to the last bit."""
        period, ends = self.ticks.period, motion.segment_ends
        assert ends is not None  # noqa: S101
        knots: IntArray = np.rint(motion.t / period).astype(np.int64)
        at = np.searchsorted(motion.t, ends)
        t = multiples(knots, period)
        return replace(motion, t=t, segment_ends=t[at])


Solve = Callable[[ProblemFunctions, Options, SegmentTicks, Ticks], Found]


def bring_segments(
    problem: Problem,
    options: Options,
    motion: Trajectory,
    solve: Solve,
    deadline: Deadline,
) -> Clocked:
    """Look for a motion on the clock near one without.

    Args:
        problem: A problem of several segments.
        options: Options of the plan, with the period.
        motion: Its motion.
        solve: Looks for a motion on given knots.
        deadline: When to stop.
    """
    period = options.control_period
    assert period is not None  # noqa: S101
    chosen = _rounded(problem.alternative_of(motion), period)
    system = ProblemFunctions.of(chosen)
    guess = solved_guess("clock", motion, problem.segments)
    nodes, degree = _nodes(motion, problem), motion.degree
    last, factor, fruitless = Clocked(Status.INFEASIBLE), 1.0, 0
    for _ in range(TRIES):
        knots = SegmentTicks.near(period, guess, nodes, factor, degree)
        program, z, result = solve(system, options, knots, knots.ticks)
        history = (*last.history, *result.history)
        last = replace(last, status=result.status, history=history)
        logger.info("%s: %s", knots.ticks, result.status.value)
        if z is not None:
            found = knots.timed(program.trajectory(z))
            judged = verify(problem, found, options.tolerances)
            last = replace(last, verification=judged)
            if judged.ok:
                return replace(last, trajectory=found)
            last = replace(last, status=Status.UNVERIFIED)
        if result.status in STOPPED or deadline.due:
            stopped = result.status if result.status in STOPPED else Status.TIME_LIMIT
            return replace(last, status=stopped)
        reached = result.iterate
        needed = float(program.timed(reached.z)[-1]) / knots.ticks.duration
        if reached.violation <= FAR and needed > 1.0:
            factor *= needed
            continue
        more = LONGER[min(fruitless, len(LONGER) - 1)]
        factor *= 1.0 + max(more, 1.0 / knots.ticks.count)
        fruitless += 1
    return last


def _rounded(problem: Problem, period: float) -> Problem:
    """A problem whose stays are whole numbers of periods."""
    rounded: Problem = copy.copy(problem)
    counts = np.array([ticks_of(item.dwell, period) for item in problem.segments])
    stays = multiples(counts, period).tolist()
    segments = tuple(
        replace(segment, dwell=stay)
        for segment, stay in zip(problem.segments, stays, strict=True)
    )
    object.__setattr__(rounded, "segments", segments)
    return rounded


def _nodes(motion: Trajectory, problem: Problem) -> Array:
    """Nodes of a motion without its stays [s]."""
    assert motion.segment_ends is not None  # noqa: S101
    t = np.array(motion.t)
    ends = zip(motion.segment_ends.tolist(), problem.segments, strict=True)
    for end, segment in reversed(list(ends)):
        t[motion.t >= end - 1e-12] -= segment.dwell
    return np.unique(np.round(t, 12))
