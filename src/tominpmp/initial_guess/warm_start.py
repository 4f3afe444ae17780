"""Warm starts: a former motion as the guess for a similar problem.

The guess begins where the former motion passes closest to the new start. Each segment
is bent to its new ends by a cubic polynomial that takes up the differences in position
and velocity, so that its torques change little. A motion of one segment
that fits the transcription is adopted exactly, interval by interval.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from tominpmp.arrays import Array
from tominpmp.checks import instance
from tominpmp.exceptions import ProblemError, ScenarioError
from tominpmp.initial_guess.guess import SAMPLES, TOO_FAST, Guess
from tominpmp.motion.samples import Samples
from tominpmp.motion.trajectory import Trajectory
from tominpmp.problem.joint_limits import joint_limits
from tominpmp.problem.problem import Problem
from tominpmp.problem.segments import spans_of
from tominpmp.transcription.bspline import BSplineTranscription
from tominpmp.transcription.curve import nodes_of
from tominpmp.transcription.grid import interval_shares
from tominpmp.transcription.layout import (
    LIFTED,
    QUADRATIC,
    SHORTEST,
    Gridded,
    Layout,
)
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.verification.stages import checked_in_segments

# The guess begins at a later state of the motion if that is closer to the new start, by
# this factor, than both ends of the motion, and the motion leads closer to the goal.
CLOSER = 0.5
# Weight of differences in velocity, as a share of the duration.
SPEED_WEIGHT = 0.1
# Least duration of a segment [s].
LEAST_DURATION = 1e-9
# A grid with more than this multiple of the requested intervals is not adopted.
FINEST = 4


@dataclass(frozen=True, eq=False, kw_only=True)
class WarmStart(Guess):
    """A former motion, bent to new ends.

    Attributes:
        motion: The former motion from the new start on, slowed down if it was far too
            fast for the limits.
        begins: Times of the motion at which the segments begin [s], shape (k,).
        bend: Curve of time added to the positions, a cubic polynomial on each segment,
            which leads to the new ends; None if the ends are those of the motion.
        limits: Lower and upper position limits, shape (n,) each.
    """

    motion: Trajectory
    begins: Array
    bend: CubicHermiteSpline | None
    limits: tuple[Array, Array]

    def position(self, times: Array) -> Array:
        """Configurations at times, shape (k, n)."""
        k = np.searchsorted(self.inner_ends, times)
        since = times - np.concatenate([[0.0], self.inner_ends])[k]
        there = np.clip(self.begins[k] + since, 0.0, self.motion.duration)
        added = 0.0 if self.bend is None else self.bend(times)
        return np.asarray(np.clip(self.motion(there, 0) + added, *self.limits))

    @property
    def continuous(self) -> bool:
        """Whether its accelerations count as continuous: those of degrees 3 and 5."""
        return self.motion.inverse_dynamics is not None and self.motion.degree > 2

    def whole(self, system: ProblemFunctions) -> Trajectory | None:
        """The rest of the former motion; None if the guess was bent.

        Torques follow from the inverse dynamics of the new problem, unless the motion
        is defined by its torques.
        """
        if self.bend is not None:
            return None
        if self.motion.inverse_dynamics is None:
            return self.motion
        inverses = tuple(part.motor_dynamics.inverse for part in system.segments)
        return self.motion.with_torques(inverses[0], inverses if system.parts else ())

    def iterate(
        self, system: ProblemFunctions, intervals: int, kind: str, degree: int
    ) -> tuple[Gridded, Array]:
        """Transcription of a degree, and the motion as its iterate.

        A motion of the same degree keeps its nodes if it has at least the requested
        number of intervals, as a coarser grid would lose its refinement, or if its
        accelerations jump at them: the longest intervals are then halved, if necessary.
        So does a motion with states and torques as unknowns. Motions with far more
        nodes, or with nodes too close to each other, and all others are interpolated on
        the usual grid.

        Args:
            system: Functions of the problem.
            intervals: Number of intervals that is requested.
            kind: Kind of the usual grid.
            degree: Degree of the transcription, see
                :class:`~tominpmp.transcription.layout.Layout`.
        """
        T, eta = self.duration, np.array([self.duration])
        h = np.diff(self.motion.t)
        kept = degree in (LIFTED, self.motion.degree)
        kept = kept and (degree <= QUADRATIC or h.size >= intervals)
        if kept and h.size <= FINEST * intervals and h.min() >= SHORTEST * h.mean():
            while h.size < intervals:
                longest = int(np.argmax(h))
                h[longest] *= 0.5
                h = np.insert(h, longest, h[longest])
            shares = h[:, None] / T
        else:
            shares = interval_shares(kind, intervals, sudden=system.sudden)
        of = Layout(degree, shares, eta, ()).transcription(system)
        if isinstance(of, BSplineTranscription):
            return of, of.within_limits(of.interpolated(eta, self.position))
        if self.bend is not None:
            return of, of.start(self.position, T, eta)
        times = T * nodes_of(of.shares[:, 0])
        return of, of.through(self.motion, times, eta)

    def torque_iterate(self, system: ProblemFunctions, shares: Array) -> Array:
        """Initial iterate of the shooting methods: torques and duration."""
        ends = self.duration * nodes_of(shares[:, 0])
        state = self.motion(0.5 * (ends[1:] + ends[:-1]))
        z = system.torque_shares(system.net_torque(state.u, state.v)).ravel()
        return np.concatenate([z, [self.duration / shares.sum()]])


def warm_start(system: ProblemFunctions, motion: Trajectory | Samples) -> WarmStart:
    """A former motion as a guess.

    Args:
        system: Functions of the problem to be warm-started.
        motion: The motion, of the same joints.

    Returns:
        The guess.

    Raises:
        ProblemError: If the motion has other joints, or the argument is no motion.
    """
    trajectory = _slowed_down(system, former_motion(system.problem, motion))
    problem, limits = system.problem, system.problem.robot.limits
    # Torques are not needed, and the inverse dynamics may be a function of the caller.
    plain = _rest(system, replace(trajectory, inverse_dynamics=None))
    begins, arrivals, _ = np.array(spans_of(plain, problem.segments)).T
    # A segment whose goal is met from its beginning has zero duration.
    durations = np.maximum(arrivals - begins, LEAST_DURATION)
    ends = np.cumsum(durations)
    former = plain(np.append(0.0, arrivals))
    goals = [part.final_configuration for part in system.segments]
    speeds = [part.final_velocity for part in system.segments]
    p = _missing([problem.q_start, *goals], former.q)
    s = _missing([problem.v_start, *speeds], former.v)
    # Smaller differences are rounding.
    same = np.all(np.abs([p, s * durations.max()]) <= 1e-9)
    times = np.linspace(0.0, ends[-1], SAMPLES)
    guess = WarmStart(
        "former motion",
        times,
        np.tile(problem.q_start, (SAMPLES, 1)),
        False,
        inner_ends=ends[:-1],
        solved=bool(np.all(np.abs(p) <= 1e-9)),
        motion=replace(plain, inverse_dynamics=trajectory.inverse_dynamics),
        begins=begins,
        bend=None if same else CubicHermiteSpline(np.append(0.0, ends), p, s),
        limits=(limits.position_lower, limits.position_upper),
    )
    return replace(guess, q=guess.position(times))


def _missing(wanted: Sequence[Array | None], found: Array) -> Array:
    """Differences of wanted rows from those found, zero where none is wanted."""
    pairs = zip(wanted, found, strict=True)
    return np.array([0.0 * row if item is None else item - row for item, row in pairs])


def former_motion(problem: Problem, motion: Trajectory | Samples) -> Trajectory:
    """A former motion, checked, with the ends of the segments of a problem.

    Without recorded ends, the segments end where the motion meets the goals of the
    problem, or is nearest to them.

    Raises:
        ProblemError: If the motion has other joints or values that are not finite, or
            the argument is no motion.
    """
    expected = "a Solution with a motion, a Trajectory or Samples"
    instance(motion, (Trajectory, Samples), "start", expected)
    try:
        return checked_in_segments(problem, motion)
    except (ProblemError, ScenarioError) as error:
        raise ProblemError(f"start: {error}", "start") from error


def _slowed_down(system: ProblemFunctions, motion: Trajectory) -> Trajectory:
    """A motion, slowed down to its limits if it is far too fast for them.

    The limits are those of speeds and accelerations. Torques that are constant on each
    interval would move the arm elsewhere at another pace.
    """
    inverse, a, ends = motion.inverse_dynamics, motion.a, motion.segment_ends
    plain = replace(motion, inverse_dynamics=None)
    state, factor = plain(np.linspace(0.0, motion.duration, SAMPLES)), 1.0
    values = {"v": state.v, "a": state.a}
    for item in joint_limits(system.problem.robot, system.motion_limits):
        if item.kind.quantity in values:
            share = np.max(np.abs(values[item.kind.quantity]) / item.upper)
            factor = max(factor, float(share) ** (1.0 / item.kind.order))
    if inverse is None or factor <= TOO_FAST:
        return motion
    slow = replace(
        motion,
        t=factor * motion.t,
        v=motion.v / factor,
        a=None if a is None else a / factor**2,
        segment_ends=None if ends is None else factor * ends,
    )
    return slow.with_torques(inverse, motion.segment_dynamics)


def _rest(system: ProblemFunctions, motion: Trajectory) -> Trajectory:
    """A motion from the state on that is closest to the new start.

    It is the whole motion unless the motion is much closer there than at its beginning
    and at its first goal, and meets this goal much better than the new start does.
    """
    problem, part = system.problem, system.segments[0]
    T, entry = spans_of(motion, problem.segments)[0].arrival, 0.0

    def distance(times: Array) -> Array:
        state = motion(times)
        off = np.abs(state.v - problem.v_start)
        apart = np.abs(state.q - problem.q_start) + SPEED_WEIGHT * T * off
        return np.asarray(np.max(apart / system.step_scale, axis=-1))

    def to_go(q: Array) -> float:
        left, _ = part.problem.goal.place_residual(part.kinematics, q)
        return float(np.max(np.abs(left), initial=0.0))

    low, high = 0.0, T
    while high - low > 1e-12 * T:
        times = np.linspace(low, high, SAMPLES)
        best = int(np.argmin(distance(times)))
        low, high = times[max(best - 1, 0)], times[min(best + 1, SAMPLES - 1)]
        entry = times[best]
    begin = motion._at_nodes(np.array([entry]))
    first, closest, last = distance(np.array([0.0, *begin, T]))
    leads_on = to_go(motion(T).q) <= CLOSER * to_go(problem.q_start)
    if closest >= CLOSER * min(first, last) or not leads_on:
        return motion
    return motion._on_nodes(np.append(begin, motion.t[motion.t > begin]))
