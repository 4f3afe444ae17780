"""Segments: the phases of a motion, each with a goal, constraints and limits.

A motion of several segments is a multi-phase problem: it is planned as a whole, with a
duration for each segment, and stops at the end of a segment only if the segment asks
for it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, NamedTuple, TypeAlias

import numpy as np

from tominpmp.arrays import Array, Converted, Record, default, pair_or_nan, record
from tominpmp.checks import Seconds, flag, instance, of_type, wrong
from tominpmp.constraints.path import PathConstraint
from tominpmp.exceptions import ProblemError, brief, closest, shortened
from tominpmp.goals.base import Goal
from tominpmp.goals.sets import passed
from tominpmp.motion.trajectory import Trajectory
from tominpmp.motion_limits import MotionLimits
from tominpmp.robot.payload import Payload
from tominpmp.robot.robot import Robot
from tominpmp.scene.scene import Scene, SceneOrNone

# Description of valid goals, in messages.
SOME_GOAL = "a JointGoal, PositionGoal, PoseGoal or another goal"
# A larger number of segments is rejected as a mistake.
MOST_SEGMENTS = 100
# Tolerance of rest [rad or m, rad/s or m/s], and of the equality of times [s].
SAME = 1e-9


def _checked_arrival(value: object, name: str) -> tuple[float, float]:
    """Check a caller's earliest and latest arrival time."""
    earliest, latest = pair_or_nan(value)
    if not (0.0 <= earliest < np.inf and earliest <= latest and latest > 0.0):
        expected = "the earliest and the latest time [s], in order"
        raise wrong(value, name, f"{expected}; the latest may be infinite")
    return earliest, latest


def checked_pairs(
    value: object,
    name: str,
    expected: str = 'pairs of names, as [("hand", "box")]',
) -> tuple[tuple[str, str], ...]:
    """Check a caller's pairs of names.

    Raises:
        ProblemError: If the value is not a list of pairs of names.
    """
    if isinstance(value, str) or not isinstance(value, Sequence):
        raise wrong(value, name, expected)
    for pair in value:
        valid = isinstance(pair, list | tuple) and len(pair) == 2
        valid = valid and all(isinstance(body, str) and body for body in pair)
        if not valid or pair[0] == pair[1]:
            twice = ", the same name twice" if valid else ""
            raise ProblemError(
                f"{name} holds {brief(pair)}{twice}, expected {expected}", name
            )
    return tuple((str(first), str(second)) for first, second in value)


SomeGoal: TypeAlias = Annotated[Goal, of_type(Goal, SOME_GOAL)]
Constraints: TypeAlias = Converted[Sequence[PathConstraint], tuple[PathConstraint, ...]]
Limits: TypeAlias = Annotated[
    MotionLimits, of_type(MotionLimits, "MotionLimits or None")
]
Load: TypeAlias = Annotated[Payload, of_type(Payload, "Payload or None")]
Pairs: TypeAlias = Annotated[Sequence[tuple[str, str]], checked_pairs]
Flag: TypeAlias = Annotated[bool, flag]
Arrival: TypeAlias = Annotated[tuple[float, float], _checked_arrival]


@record
class Segment(Record):
    """A phase of a motion: a goal, and the constraints and limits on the way to it.

    Attributes:
        goal: The goal at the end of the segment. A goal before the last one is a via
            point, passed at any velocity unless it gives one or ``stop`` is set; at the
            last goal the arm stops unless the goal gives a velocity.
        constraints: Constraints on the segment, in addition to the constraints of the
            problem.
        motion_limits: Limits on the segment; limits that they omit are taken from the
            problem.
        payload: Payload on the segment, in addition to the payload of the robot: picked
            up at the start of the segment and put down at its end, if the next segment
            does not carry it.
        scene: The obstacles during the segment, a Scene or a list of obstacles; None
            for the scene of the problem.
        may_touch: Pairs of names of links, payloads and obstacles that may touch, for
            example the payload and the table from which it is lifted.
        stop: Whether the arm is at rest at the end of the segment.
        dwell: Least time at rest at the end of the segment [s]; a dwell above zero
            implies a stop. On the clock of a controller the dwell takes whole periods.
        arrival: Earliest and latest time at which the goal is met, from the start of
            the motion [s]; the latest may be infinite. None leaves the time open.

    Raises:
        ProblemError: If a value is wrong.
    """

    goal: SomeGoal
    constraints: Constraints = default(())
    motion_limits: Limits | None = None
    payload: Load | None = None
    scene: SceneOrNone = default(None)
    may_touch: Pairs = ()
    stop: Flag = False
    dwell: Seconds = 0.0
    arrival: Arrival | None = None

    _owner = "segment."

    def __post_init__(self) -> None:
        """Check the values that need no robot."""
        super().__post_init__()
        self._keep(stop=self.stop or self.dwell > 0.0)
        if isinstance(self.constraints, list):  # which can be changed
            self._keep(constraints=tuple(self.constraints))
        if self.stop and self.goal.ends_moving:
            field = "dwell" if self.dwell else "stop"
            message = f"segment.{field} stops the arm, and its goal asks for a velocity"
            raise ProblemError(message, f"segment.{field}")

    def resolved(self, robot: Robot, before: Array | None = None) -> Segment:
        """The segment with values by joint name put into the order of the robot.

        Args:
            robot: The robot.
            before: Positions of the joints that the goal does not name, shape (n,);
                None if they are not known.
        """
        goal = self.goal.resolved(instance(robot, Robot, "robot"), before)
        return self if goal is self.goal else replace(self, goal=goal)

    def goal_on_the_way(self) -> Goal:
        """The goal of a segment before the last: a via point, unless the arm stops."""
        return self.goal if self.stop else passed(self.goal)

    def robot(self, robot: Robot) -> Robot:
        """The robot with the payload of the segment."""
        instance(robot, Robot, "robot")
        return robot if self.payload is None else robot.with_payload(self.payload)


def arrival_window(segment: Segment) -> tuple[float, float]:
    """Earliest and latest arrival at the goal of a segment [s]; 0 and inf if free."""
    return segment.arrival or (0.0, np.inf)


def _check_arrivals(segments: Sequence[Segment]) -> None:
    """Check that no latest arrival precedes the earliest end of an earlier segment.

    Raises:
        ProblemError: If a latest arrival cannot be met.
    """
    reached, first = 0.0, 0
    for k, segment in enumerate(segments):
        earliest, latest = arrival_window(segment)
        if latest < reached:
            raise ProblemError(
                f"segment {k + 1} is to be reached by {latest:g} s, and segment "
                f"{first + 1} does not end before {reached:g} s",
                f"segments[{k}].arrival",
            )
        if earliest > reached:
            first = k
        reached = max(earliest, reached) + segment.dwell


def checked_segments(value: Any, name: str = "segments") -> tuple[Segment, ...]:
    """Check a caller's segments.

    Raises:
        ProblemError: If the value is not a list of segments, holds too many segments,
            or a latest arrival cannot be met.
    """
    expected = f"a list of Segment, one for each goal, {MOST_SEGMENTS} at most"
    if isinstance(value, str) or not isinstance(value, Sequence):
        raise wrong(value, name, expected)
    if len(value) > MOST_SEGMENTS:
        message = f"{name} has {len(value)} items, expected {expected}"
        raise ProblemError(message, name)
    for k, item in enumerate(value):
        instance(item, Segment, f"{name}[{k}]")
    _check_arrivals(value)
    return tuple(value)


def known_names(robot: Robot, scene: Scene) -> set[str]:
    """Names that a pair of bodies may have: links with a shape, and obstacles."""
    links = {
        robot.model.frames[item.parentFrame].name
        for item in robot.collision_model.geometryObjects
    }
    return links | {item.name for item in scene.obstacles}


def check_names(pairs: Sequence[tuple[str, str]], known: set[str]) -> None:
    """Check that pairs name bodies among those with known names.

    Raises:
        ProblemError: If a name is neither a link nor an obstacle.
    """
    names = sorted(known)
    for pair in pairs:
        for body in pair:
            if body not in known:
                raise ProblemError(
                    f"may_touch: {brief(body)} is neither a link with a shape nor an "
                    f"obstacle{closest(body, names)}; there are: "
                    f"{shortened(', '.join(names))}",
                    "may_touch",
                )


@dataclass(frozen=True, eq=False)
class SegmentOfMotion(Record):
    """One segment of a motion.

    Attributes:
        goal: The goal at the end of the segment; None where the segments of the problem
            are not known.
        begin: Time at which the segment begins [s].
        arrival: Time at which the goal is met [s].
        end: Time at which the segment ends, after the dwell [s].
        trajectory: The motion during the segment, from time 0.
    """

    goal: Goal | None
    begin: float
    arrival: float
    end: float
    trajectory: Trajectory

    @property
    def duration(self) -> float:
        """Duration of the segment, dwell included [s]."""
        return self.end - self.begin

    @property
    def stay(self) -> float:
        """Dwell at the end of the segment [s]."""
        return self.end - self.arrival


class Span(NamedTuple):
    """Times at which a segment of a motion begins, meets its goal, and ends [s].

    Attributes:
        begin: Time at which the segment begins.
        arrival: Time at which the goal is met and the dwell begins.
        end: Time at which the segment ends.
    """

    begin: float
    arrival: float
    end: float


def spans_of(motion: Trajectory, segments: Sequence[Segment]) -> list[Span]:
    """Times at which the segments of a motion begin, meet their goals, and end.

    Args:
        motion: The motion.
        segments: The segments of the problem; empty where they are not known.
    """
    ends = motion._ends.tolist()
    arrivals = ends
    if segments:
        each = zip(segments, [0.0, *ends], ends, strict=False)
        arrivals = [_arrival(motion, segment, *span) for segment, *span in each]
    return [*map(Span, [0.0, *ends[:-1]], arrivals, ends)]


def _arrival(motion: Trajectory, segment: Segment, begin: float, end: float) -> float:
    """Time at which a motion meets the goal of a segment, before its dwell [s].

    The arrival is the first node from which the arm rests to the end, for at least the
    dwell: on the clock of a controller the rest takes whole periods. If the arm rests
    there before the earliest arrival, the arrival is the first node after that time.
    """
    if segment.dwell == 0.0:
        return end
    first, last = np.searchsorted(motion.t, [begin, end]).tolist()
    rows = slice(first, last + 1)
    t, off = motion.t[rows], np.abs(motion.q[rows] - motion.q[last])
    moves = np.any(np.maximum(off, np.abs(motion.v[rows])) > SAME, axis=1)
    rests = np.logical_and.accumulate(~moves[::-1])[::-1]
    earliest, _ = arrival_window(segment)
    latest = max(end - segment.dwell, begin)
    arrived = rests & (t >= earliest - SAME) & (t <= latest + SAME)
    return float(t[arrived][0]) if np.any(arrived) else latest


def segments_of(
    motion: Trajectory, segments: Sequence[Segment]
) -> tuple[SegmentOfMotion, ...]:
    """Split a motion into its segments.

    Args:
        motion: The motion.
        segments: The segments of the problem; empty where they are not known.
    """
    spans = spans_of(motion, segments)
    goals: Sequence[Goal | None] = [segment.goal for segment in segments]
    goals = goals or [None] * len(spans)
    return tuple(
        SegmentOfMotion(goal, *span, _section(motion, number, span.begin, span.end))
        for number, (goal, span) in enumerate(zip(goals, spans, strict=True))
    )


def _section(motion: Trajectory, number: int, begin: float, end: float) -> Trajectory:
    """Section of a motion between two times, as a motion from time 0."""
    if motion.segment_ends is None:
        return motion
    first, last = np.searchsorted(motion.t, [begin, end]).tolist()
    rows = slice(first, last + 1)
    u = np.array(motion.u[rows])
    each = motion.segment_dynamics
    inverse = each[number] if each else motion.inverse_dynamics
    # Accelerations for each node, or for each interval.
    behind = last + 1 if motion.degree == 5 else last
    a = None if motion.a is None else motion.a[first:behind]
    if last < motion.t.size - 1 and inverse is not None:
        before = motion(np.nextafter(motion.t[last], 0.0)).a
        u[-1] = inverse(motion.q[last][None], motion.v[last][None], before[None])[0]
    t, q, v = motion.t[rows] - begin, motion.q[rows], motion.v[rows]
    alone = replace(motion, segment_ends=None, segment_dynamics=())
    return replace(alone, t=t, q=q, v=v, u=u, a=a, inverse_dynamics=inverse)
