"""A planning problem: robot, start, goal, scene; checked when it is made."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import field, replace
from functools import cached_property, partial
from typing import Annotated, TypeAlias

import numpy as np

from tominpmp.arrays import Array, Converted, Record, default, frozen_array, record
from tominpmp.checks import JointsLike, instance, non_negative, of_type
from tominpmp.collision.checker import CollisionChecker, Contact, enclosure
from tominpmp.collision.query import ROUNDING
from tominpmp.constraints.base import USABLE
from tominpmp.constraints.contradiction import contradiction
from tominpmp.constraints.path import PathConstraint, checked
from tominpmp.description.inertials import singular_directions
from tominpmp.description.joint_table import example_values
from tominpmp.description.model import sticks
from tominpmp.dynamics import RobotDynamics
from tominpmp.exceptions import (
    ProblemError,
    brief,
    counted,
    enumerated,
    naming,
    warn_caller,
)
from tominpmp.goals.base import Goal
from tominpmp.goals.joints import joint_vector
from tominpmp.goals.sets import passed, restricted
from tominpmp.goals.turns import MOST_WAYS
from tominpmp.kinematics import RobotKinematics, units_of
from tominpmp.motion.trajectory import Trajectory
from tominpmp.motion_limits import MotionLimits, kinds_of
from tominpmp.notebook import card, skeletons, table
from tominpmp.problem.joint_limits import control_bounds, durations_alone
from tominpmp.problem.segments import (
    SOME_GOAL,
    Constraints,
    Limits,
    Pairs,
    Segment,
    check_names,
    checked_segments,
    known_names,
)
from tominpmp.problem.state_checks import SNAP, onto_limits, unheld
from tominpmp.robot.robot import Robot, datasheet_hint
from tominpmp.scene.scene import Scene, SceneLike, as_scene

# Largest number of combinations of alternative goals over several segments, which are
# planned one by one, and of combinations of equivalent joint angles over the segments.
MOST_ALTERNATIVES, MOST_TURNS = 256, 16
# The field of a problem that holds the start or the goal.
FIELDS = {"start": "q_start", "goal": "goal"}
# Farthest way that a joint is assumed to need for a change of its velocity [rad or m].
FARTHEST = 1e4


LoadedRobot: TypeAlias = Annotated[Robot, of_type(Robot, "a Robot (see load_robot)")]
Margin: TypeAlias = Annotated[float, partial(non_negative, unit="m")]
Choice: TypeAlias = Annotated[bool, of_type(bool, "True, False or None")]
Segments: TypeAlias = Annotated[Sequence[Segment], checked_segments]


@record
class Problem(Record):
    """Bring a robot from a state to a goal in minimum time.

    Starts and goals that exceed a position or velocity limit by no more than rounding
    are moved onto the limit, with a warning. The excess may be 1e-4 rad or m, rad/s or
    m/s, or a hundredth of the range between the limits where the range is narrow.

    Attributes:
        robot: The robot.
        q_start: Joint positions at the start, shape (n,) [rad or m]; or by joint name.
        goal: The goal at the end of the motion; omitted for a problem with segments,
            where it is the goal of the last segment.
        scene: The obstacles: a Scene, or a list of obstacles.
        margin: Distance that the links keep from obstacles, and several robots from
            each other [m].
        v_start: Joint velocities at the start, shape (n,) [rad/s or m/s], or by joint
            name, with joints not named at rest; None for a start at rest.
        motion_limits: Limits in addition to the robot's description, if any. Limits
            that they omit are taken from the robot: ``robot.motion_limits``.
        constraints: Constraints at all times: ``ToolSpeed``, ``KeepUpright``, ...
        self_collision: Whether the links also keep clear of each other and of bodies
            fixed to the base, without a margin; None stands for True. False is for
            robots whose description is wrong about their shapes.
        segments: Phases of the motion, each with a goal, constraints and limits, see
            :class:`Segment`; empty for a motion to one goal.
        may_touch: Pairs of names of links and obstacles that may touch.
        a_start: Joint accelerations at the start, shape (n,) [rad/s^2 or m/s^2], or by
            joint name, with joints not named at zero; None for zero. A motion has
            them where its accelerations may not jump, that is, with limits of jerk or
            torque rate; elsewhere they are without effect.

    Raises:
        ProblemError: If a value is wrong: the message names the joint, the value and
            the expected value.
        FrameNotFound: If a frame of a goal or constraint is not part of the robot.
        JointNotFound: If a joint of a goal or constraint is not part of the robot.
        SceneError: If there are obstacles, and the moving links have no geometry.
    """

    robot: LoadedRobot
    q_start: Converted[JointsLike, Array]
    goal: Goal = default(None)
    scene: SceneLike = field(default_factory=lambda: default(Scene()))
    margin: Margin = 0.0
    v_start: Converted[JointsLike | None, Array] = default(None)
    motion_limits: Limits | None = None
    self_collision: Choice | None = None
    constraints: Constraints = default(())
    segments: Segments = ()
    may_touch: Pairs = ()
    a_start: Converted[JointsLike | None, Array] = default(None)

    def __post_init__(self) -> None:
        """Check all values that can be checked without planning."""
        super().__post_init__()
        # Joints that a goal does not name stay at the start, which may have been moved
        # onto limits.
        snapped = self._snap_start()
        self._take_segments()
        instance(self.goal, Goal, "goal", f"{SOME_GOAL}, or at least one segment")
        self._keep(goal=self.goal.resolved(self.robot, self.q_start))
        names, limits = self.robot.joint_names, self.robot.motion_limits
        if self.motion_limits is not None:
            limits = self.motion_limits.over(limits, names)
        self._keep(motion_limits=limits)
        check_names(self.may_touch, known_names(self.robot, self.scene))
        if not self.segments:
            _check_controls(self.robot, limits)
            self.goal.validate(self.robot)
        several = bool(self.segments)
        self._keep(constraints=checked(self.constraints, self.robot, several))
        snapped += self._slow_start()
        if self.segments:
            phases, snapped_goals = self._phases
            self._keep(segments=self._aiming_at([phase.goal for phase in phases]))
            self._keep(goal=self.segments[-1].goal)
        else:
            _check_start(self, None, known=False)
            snapped_goals = self._take_goal(self.goal)
        for message in (*snapped, *snapped_goals):
            warn_caller(message)

    def __repr__(self) -> str:
        """Show robot, goal and further settings on one line."""
        robot = f"{brief(self.robot.name)} with {counted(self.robot.n, 'joint')}"
        scene, segments = len(self.scene), len(self.segments)
        more = f", {counted(scene, 'obstacle')}" if scene else ""
        more += f", margin {self.margin:g} m" if self.margin else ""
        more += ", motion limits" if self.motion_limits is not None else ""
        more += f", {counted(segments, 'segment')}" if segments else ""
        return f"<Problem of {robot}: {brief(self.goal)}{more}>"

    def _repr_html_(self) -> str:
        """Show stick figures at the start and the goal, and a table, in notebooks."""
        robot, ends = self.robot, [self.goal.configuration, self.q_start]
        arms = [sticks(robot.model, robot.expand(q)) for q in ends if q is not None]
        rows = [("robot", robot.name), ("goal", brief(self.goal))]
        rows += [("scene", brief(self.scene)), ("margin", f"{self.margin:g} m")]
        rows += [("constraint", brief(item)) for item in self.constraints]
        picture = skeletons("start" + ", and goal in grey" * (len(arms) > 1), arms)
        return card("Problem", picture, table((), rows))

    @cached_property
    def checker(self) -> CollisionChecker:
        """Collision checker: distances of the links to obstacles and each other."""
        own = self.self_collision is not False
        may_touch = frozenset(map(frozenset, self.may_touch))
        robot, scene = self.robot, self.scene.sorted
        return CollisionChecker(robot, scene, self_collision=own, may_touch=may_touch)

    @cached_property
    def margins(self) -> Array:
        """Margin of each collision pair of the checker, zero between links [m]."""
        return self.checker.margins(self.margin)

    @cached_property
    def ready_constraints(self) -> tuple[PathConstraint, ...]:
        """The constraints, ready to be evaluated."""
        return tuple(item.on(self.robot) for item in self.constraints)

    @property
    def x_start(self) -> Array:
        """State at the start, positions and velocities, shape (2n,)."""
        return np.concatenate([self.q_start, self.v_start])

    @property
    def phases(self) -> tuple[Problem, ...]:
        """The problems of the segments, in order; the problem itself without segments.

        Each has the robot, the scene and the limits of its segment, and the goal of its
        segment: a via point that is passed, or a goal at which the arm stops. The start
        of a segment is only known if the goal before it is a configuration; otherwise
        ``q_start`` is the start of the whole problem, or the last known configuration.
        """
        return self._phases[0] if self.segments else (self,)

    @cached_property
    def _phases(self) -> tuple[tuple[Problem, ...], list[str]]:
        """The problems of the segments, and warnings."""
        phases, messages = list[Problem](), list[str]()
        q = self.q_start
        for k, segment in enumerate(self.segments):
            with naming(f"segment {k + 1} of {len(self.segments)}", f"segments[{k}]"):
                phase, more = self._phase(segment, k, q)
            q = q if phase.goal.configuration is None else phase.goal.configuration
            phases.append(phase)
            messages += [f"segment {k + 1}: {text}" for text in more]
        return tuple(phases), messages

    def _phase(
        self, segment: Segment, number: int, q_start: Array
    ) -> tuple[Problem, list[str]]:
        """The problem of one segment, and the warnings of its goal."""
        with naming("payload", "payload"):
            robot = segment.robot(self.robot)
        limits = self.motion_limits
        if segment.motion_limits is not None:
            limits = segment.motion_limits.over(limits, robot.joint_names)
        _check_controls(robot, limits)
        scene = self.scene if segment.scene is None else segment.scene
        constraints = checked(segment.constraints, robot, several=True)
        same = robot is self.robot and scene is self.scene and not segment.may_touch
        if same:
            _ = self.checker, self.margins  # the copy shares them
        phase = self._altered(
            *("ready_constraints", "_phases"),
            *(() if same else ("checker", "margins")),
            robot=robot,
            q_start=q_start,
            v_start=self.v_start if number == 0 else frozen_array(0.0 * q_start),
            a_start=self.a_start if number == 0 else frozen_array(0.0 * q_start),
            scene=scene,
            motion_limits=limits,
            constraints=self.constraints + constraints,
            may_touch=(*self.may_touch, *segment.may_touch),
            segments=(),
        )
        check_names(segment.may_touch, known_names(robot, scene))
        last = number == len(self.segments) - 1
        goal = segment.goal if last else segment.goal_on_the_way()
        with naming("goal", "goal"):
            goal.validate(robot)
        before = self.segments[number - 1] if number else None
        if before is None or before.goal.configuration is not None:
            _check_start(phase, before, known=same and number > 0)
        rests, former = goal is segment.goal, before.goal if before else None
        return phase, phase._take_goal(segment.goal, former, rests)

    def _take_segments(self) -> None:
        """Check the segments, and take the goal of the last one for the problem."""
        if not self.segments:
            return
        if self.goal is not None and self.goal is not self.segments[-1].goal:
            raise ProblemError(
                "goal and segments are given, expected one or the other: the last "
                "segment's goal is the goal of the problem",
                "goal",
            )
        segments = list[Segment]()
        for k, segment in enumerate(self.segments):
            # Joints that a goal does not name stay where the goal before leaves them.
            before = segments[-1].goal.configuration if segments else self.q_start
            with naming(f"segment {k + 1} of {len(self.segments)}", f"segments[{k}]"):
                segments.append(segment.resolved(self.robot, before))
        self._keep(segments=tuple(segments), goal=segments[-1].goal)

    def _take_goal(
        self, goal: Goal, before: Goal | None = None, rests: bool = True
    ) -> list[str]:
        """Check a goal and keep it, with its nearest joint angles; returns warnings.

        Args:
            goal: The goal.
            before: The goal of the segment before; None for the first segment.
            rests: Whether the arm meets the goal itself; otherwise it passes there.
        """
        wrapped = self._wrapped(goal, before)
        checked_goal, messages = _check_goal(self, wrapped, rests)
        self._keep(goal=checked_goal if rests else passed(checked_goal))
        return messages

    def _wrapped(self, goal: Goal, before: Goal | None, rivals: int = 1) -> Goal:
        """A goal with the joint angles that the joints reach with the least way.

        The way counts from the start; or, where a joint moves at the start or the end,
        from the position at which its initial velocity has become its final velocity.

        Args:
            goal: The goal.
            before: The goal of the segment before, which may have turned any joint in
                either direction; None for the first segment.
            rivals: Number of goals of the set that the goal belongs to.
        """
        if not goal.turning and goal.choices[0] is not goal:
            rivals = len(goal.choices)
            choices = [self._wrapped(each, before, rivals) for each in goal.choices]
            return restricted(goal, choices)
        robot, near, v = self.robot, self.q_start, self.v_start
        v = v if before is None else before.final_velocity(robot.n)
        angles = np.flatnonzero(goal.angles(robot))
        change = goal.final_velocity(robot.n) - v
        if np.any(change[angles]):
            seconds = durations_alone(robot, self.motion_limits, near, np.abs(change))
            way = np.clip((v + 0.5 * change) * seconds, -FARTHEST, FARTHEST)
            lower, upper = robot.limits.position_lower, robot.limits.position_upper
            near = np.clip(near + way, lower, upper)
        # An obstacle may block the way in one direction.
        most = max(max(MOST_WAYS, 1 + angles.size) // rivals, 2)
        if before is not None:
            v, most = np.ones_like(v), 1 + 2 * angles.size
        return goal.wrapped(robot, near, v, most)

    def _snap_start(self) -> list[str]:
        """Move the start onto limits that it exceeds by rounding; returns warnings."""
        robot = self.robot
        q = joint_vector(robot, self.q_start, "q_start")
        v = joint_vector(robot, self.v_start, "v_start", "velocity")
        a = joint_vector(robot, self.a_start, "a_start", "acceleration")
        q, of_q = onto_limits(robot, "position", q, "q_start")
        v, of_v = onto_limits(robot, "velocity", v, "v_start")
        self._keep(q_start=frozen_array(q), v_start=frozen_array(v))
        self._keep(a_start=frozen_array(a))
        return of_q + of_v

    def _slow_start(self) -> list[str]:
        """Slow the start down to limits of speed; returns warnings.

        The start may be a state of a planned motion, which exceeds them slightly
        between the rows of its program.
        """
        messages = list[str]()
        for item in self.ready_constraints:
            if item.order != 1 or item.window is not None:
                continue
            state, limit = (self.q_start, self.v_start), item.largest
            speed = item.measure(*state, np.zeros(0))
            if limit < speed <= (1.0 + USABLE) * limit:
                messages.append(f"v_start was slowed down: {item.lack(*state, 0.0)}")
                self._keep(v_start=frozen_array(limit / speed * self.v_start))
        return messages

    @property
    def alternatives(self) -> tuple[Problem, ...]:
        """Alternative problems: one for each combination of alternative goals.

        Raises:
            ProblemError: If the goals of the segments have too many combinations.
        """
        if not self.segments:
            return tuple(self._with_goal(goal) for goal in self.goal.alternatives)
        goals = [phase.goal for phase in self.phases]
        each = [(goal,) if goal.turning else goal.choices for goal in goals]
        count = math.prod(map(len, each))
        if count > MOST_ALTERNATIVES:
            raise ProblemError(
                f"segments: their goals can be chosen in {count} ways, expected no "
                f"more than {MOST_ALTERNATIVES}",
                "segments",
            )
        ways = [
            way
            for chosen in itertools.product(*each)
            for way in self._turns(chosen, max(MOST_TURNS // count, 1))
        ]
        return tuple(map(self._with_goals, ways)) if len(ways) > 1 else (self,)

    def _turns(self, goals: Sequence[Goal], most: int) -> list[list[Goal]]:
        """Choices of equivalent joint angles for the goals of all segments.

        The nearest ones come first, then those that change the way of one segment: the
        later segments take the nearest turns from there. The first changes of all
        segments come before the second ones.
        """
        kinematics, still = RobotKinematics(self.robot), 0.0 * self.q_start
        each = [goal.alternatives for goal in goals]
        changes = [(i, k) for k, turns in enumerate(each) for i in range(1, len(turns))]
        ways = [[turns[0] for turns in each]]
        for i, k in sorted(changes)[: most - 1]:
            way, q = [*ways[0][:k], each[k][i]], each[k][i].configuration
            for goal, usual in zip(goals[k + 1 :], ways[0][k + 1 :], strict=True):
                way.append(usual if q is None else goal.nearest(kinematics, q, still))
                q = way[-1].configuration if usual.configuration is not None else q
            ways.append(way)
        return ways

    def alternative_of(self, trajectory: Trajectory) -> Problem:
        """The problem with the alternative goals that a motion meets or comes nearest.

        Args:
            trajectory: The motion.
        """
        instance(trajectory, Trajectory, "trajectory")
        if not self.segments:
            return self.alternative_at(trajectory.q[-1], trajectory.v[-1])
        ends = trajectory(np.array(trajectory.segment_ends))
        goals = [
            phase.goal.nearest(RobotKinematics(phase.robot), q, v)
            for phase, q, v in zip(self.phases, ends.q, ends.v, strict=True)
        ]
        return self._with_goals(goals)

    def _with_goals(self, goals: Sequence[Goal]) -> Problem:
        """The problem with one goal for each segment; the goals were checked before."""
        parts, q = list[Problem](), self.q_start
        for phase, goal in zip(self.phases, goals, strict=True):
            parts.append(phase._altered(goal=goal, q_start=q))
            q = q if goal.configuration is None else goal.configuration
        return self._with_goal(goals[-1])._altered(
            _phases=(tuple(parts), []), segments=self._aiming_at(goals)
        )

    def _aiming_at(self, goals: Sequence[Goal]) -> tuple[Segment, ...]:
        """The segments with other goals, which were checked before."""
        each = zip(self.segments, goals, strict=True)
        return tuple(segment._altered(goal=goal.stopped) for segment, goal in each)

    def alternative_at(self, q: Array, v: Array) -> Problem:
        """The problem with the alternative goal that is nearest to a final state.

        Args:
            q: Final configuration, shape (n,) [rad or m].
            v: Final velocity, shape (n,) [rad/s or m/s].
        """
        return self._with_goal(self.goal.nearest(RobotKinematics(self.robot), q, v))

    def with_ends(self, q_start: Array, goal: Goal, where: str = "") -> Problem:
        """The same problem from another start at rest to another goal, both checked.

        Args:
            q_start: Positions at the start, shape (n,) [rad or m].
            goal: The goal.
            where: Prefix of warnings.

        Raises:
            ProblemError: If the start or the goal is wrong.
        """
        instance(goal, Goal, "goal", "a goal")
        _ = self.checker, self.margins, self.ready_constraints  # the copy shares them
        other = self._altered(q_start=q_start, v_start=None, a_start=None)
        snapped = other._snap_start()
        goal = goal.resolved(self.robot, other.q_start)
        goal.validate(self.robot)
        _check_start(other, None, known=False)
        for message in (*snapped, *other._take_goal(goal)):
            warn_caller(where + message)
        return other

    def _with_goal(self, goal: Goal) -> Problem:
        """The same problem with another goal, which was checked before."""
        if goal is self.goal:
            return self
        _ = self.checker  # the copy shares it
        return self._altered(goal=goal)

    def with_scene(self, scene: Scene) -> Problem:
        """The same problem with other obstacles, without a check of start and goal."""
        stale, other = ("checker", "margins", "_phases"), as_scene(scene, "scene")
        return self._altered(*stale, scene=other)


def _check_controls(robot: Robot, limits: MotionLimits | None) -> None:
    """Check that a kinematic robot has acceleration limits, and no torque limits.

    Args:
        robot: The robot.
        limits: Motion limits in addition to the limits of its description.

    Raises:
        ProblemError: Naming all joints without an acceleration limit, or the torque
            limits that are set.
    """
    if not robot.kinematic:
        return
    limits = limits or MotionLimits()
    kinds = kinds_of(limits).items()
    wrong = [k for k, kind in kinds if kind.of_torques and kind in limits._bounded]
    wrong += ["effort_scale"] if limits.effort_scale < 1.0 else []
    if wrong:
        raise ProblemError(
            f"motion_limits: {', '.join(wrong)} is given, expected none: a kinematic "
            "robot has no torques",
            "motion_limits",
        )
    _, most = control_bounds(robot, limits)
    joints = [robot.joint_names[i] for i in np.flatnonzero(np.isinf(most))]
    if joints:
        raise ProblemError(
            f"motion_limits: no acceleration limit for {', '.join(joints)}, and a "
            f"kinematic robot needs one: give acceleration={example_values(joints)}, "
            "as MotionLimits or a joint_limits.yaml have it, or load a description "
            "with its dynamics, without kinematic=True"
            f"{datasheet_hint(robot, joints[0])}",
            "motion_limits",
        )


# -- checks of starts and goals that need no planning ----------------------------------


def _check_start(problem: Problem, before: Segment | None, known: bool) -> None:
    """Check that the arm may begin a problem, or a segment, in its state at the start.

    Args:
        problem: The problem.
        before: The segment before, whose end is the start; None for the first one.
        known: Whether the robot and the obstacles are those of the segment before,
            whose goal was checked for collisions and a regular mass matrix.

    Raises:
        ProblemError: If the state is in collision, or exceeds a limit.
    """
    robot, q = problem.robot, problem.q_start
    if not known:
        _check_clear(problem, q, "start", None if before else 0.0)
        _check_mass(problem, q, "start")
    passing = before is not None and not before.stop
    _check_state(problem, q, problem.v_start, "start", passing=passing)
    limits = problem.motion_limits
    if limits is None or not limits.continuous:
        return
    most = limits.by_joint("acceleration", robot.joint_names)
    # The start may be a state of a planned motion, which may exceed limits slightly.
    for i in np.flatnonzero(np.abs(problem.a_start) > (1.0 + USABLE) * most).tolist():
        unit = f"{units_of(robot)[i]}/s^2"
        raise ProblemError(
            f"a_start: joint {robot.joint_names[i]!r} is {problem.a_start[i]:.10g} "
            f"{unit}, outside its acceleration limits [{-most[i]:.10g}, "
            f"{most[i]:.10g}] {unit}",
            "a_start",
        )


def _check_goal(problem: Problem, goal: Goal, rests: bool) -> tuple[Goal, list[str]]:
    """Check a goal, which was validated against the robot.

    Args:
        problem: The problem.
        goal: The goal.
        rests: Whether the arm comes to rest at the goal.

    Returns:
        The goal, moved onto limits that it exceeds by rounding and without
        alternatives that fail a check, and warnings.

    Raises:
        ProblemError: If the goal fails a check, or all of its alternatives do.
    """
    if goal.alternatives[0] is not goal:
        return _check_any(problem, goal, rests)
    robot = problem.robot
    if goal.configuration is not None:
        v = goal.final_velocity(robot.n)
        q, of_q = onto_limits(robot, "position", goal.configuration, "goal.q")
        v, of_v = onto_limits(robot, "velocity", v, "goal.v")
        _check_clear(problem, q, "goal", None)
        _check_mass(problem, q, "goal")
        if rests and not np.any(v) and (fault := unheld(robot, q)):
            raise ProblemError(f"goal: {fault}", "goal")
        _check_state(problem, q, v, "goal")
        return goal.with_state(q, v) if of_q or of_v else goal, of_q + of_v
    messages = []
    for item in goal.members:
        q, name = item.positions(robot), "goal.q with its tolerance"
        messages += onto_limits(robot, "position", q, name)[1]
        _check_reach(problem, item)
        _check_link(problem, item)
    lower, upper = goal.joint_ranges(robot)
    for i in np.flatnonzero(lower > upper + ROUNDING).tolist():
        joint = robot.joint_names[i]
        said = f"{lower[i]:.6g} at least and {upper[i]:.6g} at most [rad or m]"
        raise ProblemError(f"goal: joint {joint!r} is to be {said}", "goal")
    return goal, messages


def _check_any(problem: Problem, goal: Goal, rests: bool) -> tuple[Goal, list[str]]:
    """Drop alternatives that fail a check, if at least one alternative passes.

    Each dropped alternative gets a warning, except equivalent joint angles: they
    differ from the caller's goal by whole turns only.

    Raises:
        ProblemError: If no alternative passes.
    """
    goals = goal.choices
    valid, messages = list[Goal](), list[str]()
    faults = dict[int, ProblemError]()
    for number, alternative in enumerate(goals, 1):
        try:
            checked, snapped = _check_goal(problem, alternative, rests)
        except ProblemError as error:
            faults[number] = error
        else:
            valid.append(checked)
            messages += snapped
    if goal.turning:
        if not valid:
            raise faults[1]
        return restricted(goal, valid), list(dict.fromkeys(messages))
    faulty = [f"goal {k} of {len(goals)}: {fault}" for k, fault in faults.items()]
    if not valid:
        raise ProblemError("; ".join(faulty), "goal")
    messages += [f"{text}; it is left out" for text in faulty]
    return restricted(goal, valid), messages


def _check_clear(problem: Problem, q: Array, which: str, time: float | None) -> None:
    """Check that the configuration at the "start" or the "goal" is collision-free.

    Args:
        problem: The problem.
        q: The configuration, shape (n,).
        which: "start" or "goal".
        time: Time at which the arm is there [s]; None if it is not known yet:
            moving obstacles may be elsewhere then.

    Raises:
        ProblemError: If it is in collision, naming the pairs, the deepest one first.
    """
    checker, contacts = problem.checker, dict[str, Contact]()
    if checker.hulls_clear(q):
        return
    # The checker decomposes meshes into convex pieces for the margins of the pairs.
    known = time is not None or not checker.moving
    if known and checker.is_free(q, problem.margins, time or 0.0):
        return
    each = checker.contacts(q, problem.margins, time)
    for contact in itertools.takewhile(lambda item: item.lack > ROUNDING, each):
        contacts.setdefault(contact.pair, contact)  # of several pieces the deepest
    if not contacts:
        return
    found = enumerated([*contacts.values()])
    own = any(item.own and item.distance < 0.0 for item in contacts.values())
    advice = _advice_on_links(problem, q) if own else ""
    raise ProblemError(
        f"{which} in collision: {found} at q = {np.round(q, 4).tolist()}{advice}",
        FIELDS[which],
    )


def _advice_on_links(problem: Problem, q: Array) -> str:
    """Advice on an overlap of two links that the robot description may allow."""
    meshes = replace(problem.checker, scene=Scene(), geometry="mesh")
    cause = " they overlap as described, not only in their convex pieces;"
    if meshes.is_free(q):
        cause = " their meshes do not, only the convex pieces that stand for them;"
    return (
        f":{cause} links that may touch belong among the disable_collisions of an "
        "SRDF, and self_collision=False lets all of them touch"
    )


def _check_state(
    problem: Problem, q: Array, v: Array, which: str, *, passing: bool = False
) -> None:
    """Check that constraints hold at a state, and that no joint leaves its range.

    A joint that moves at a position limit is outside its range before or after: at
    a goal neither is allowed, at a start it may come from outside.

    Args:
        problem: The problem.
        q: Positions, shape (n,).
        v: Velocities, shape (n,).
        which: "start" or "goal".
        passing: Whether the arm passes the configuration at an unknown velocity:
            then only constraints on the configuration are checked.

    Raises:
        ProblemError: If a constraint is violated by more than rounding, or, at a
            start, by more than a motion may violate it between two rows.
    """
    robot = problem.robot
    limits = robot.limits
    outward = np.where(q >= limits.position_upper, v, 0.0)
    outward -= np.where(q <= limits.position_lower, v, 0.0)
    wrong = outward if which == "start" else np.abs(outward)
    # A slower joint stops within rounding of its limit.
    for i in np.flatnonzero(wrong > math.sqrt(SNAP)).tolist():
        unit = units_of(robot)[i]
        way = "leaves" if outward[i] > 0.0 else "enters"
        raise ProblemError(
            f"{which}: joint {robot.joint_names[i]!r} {way} its range there: "
            f"it has {v[i]:.4g} {unit}/s at its limit of {q[i]:.4g} {unit}",
            FIELDS[which],
        )
    for item in problem.ready_constraints:
        begin, end = item.during or (0.0, math.inf)
        # The arrival time at a goal is not known yet.
        holds = begin <= 0.0 if which == "start" else math.isinf(end)
        if not holds or (passing and item.order > 0):
            continue
        # A state of a planned motion may exceed it between two rows, by a share of
        # its scale; a slack counts in units of the scale, and at least of 1.
        slack = USABLE * min(item.scale, 1.0) if which == "start" else ROUNDING
        if lack := item.lack(q, v, slack):
            why = contradiction(item, problem.ready_constraints, robot, q)
            raise ProblemError(f"{which}: {lack}{why}", FIELDS[which])


def _check_mass(problem: Problem, q: Array, which: str) -> None:
    """Check that the mass matrix is regular, so that accelerations are bounded.

    Args:
        problem: The problem.
        q: The configuration, shape (n,).
        which: "start" or "goal".

    Raises:
        ProblemError: Naming the joints that can move without any inertia.
    """
    robot = problem.robot
    if robot.kinematic:
        return
    mass = RobotDynamics(robot).mass(np.asarray(q)[None])[0]
    light = np.flatnonzero(singular_directions(mass)).tolist()
    if light:
        joints = [robot.joint_names[i] for i in light]
        raise ProblemError(
            f"{which}: {' and '.join(joints)} can move without any inertia there, "
            "so that any torque would accelerate them without bound: give "
            f"armature={example_values(joints)} [kg m^2 or kg], or lock one",
            FIELDS[which],
        )


def _check_link(problem: Problem, goal: Goal) -> None:
    """Check that the link at the goal's frame has an orientation without collision.

    Raises:
        ProblemError: If the link overlaps an obstacle in every orientation.
    """
    ball, frame = goal.ball, goal.frame_name
    if ball is None or frame is None or not len(problem.checker.scene):
        return
    found = enclosure(problem.checker, frame, ball.centre, ball.radius)
    if found is not None:
        raise ProblemError(
            f"goal: {np.round(ball.centre, 4).tolist()} is {found.lack:.4g} m deep "
            f"in obstacle {found.obstacle!r}, and link {found.link!r} with frame "
            f"{frame!r} there overlaps it in every orientation",
            "goal",
        )


def _check_reach(problem: Problem, goal: Goal) -> None:
    """Check that the goal's frame can come as far, and be as fast, as it is to be.

    Raises:
        ProblemError: If the goal is out of reach, or its velocity beyond a limit.
    """
    target, frame = goal.nearest_point(), goal.frame_name
    given = getattr(goal, "v", None)
    v = 0.0 if given is None else float(np.linalg.norm(given))
    for limited, top in filter(None, (c.top_speed for c in problem.ready_constraints)):
        if limited == frame and v > top * (1.0 + ROUNDING):
            raise ProblemError(
                f"goal: the speed of frame {frame} is {v:.4g} m/s, {v - top:.2g} "
                f"m/s more than its limit {top:.4g} m/s",
                "goal",
            )
    if target is None or frame is None:
        return
    reach = RobotKinematics(problem.robot).reach(frame)
    distance = math.hypot(*target)  # does not overflow
    if distance > reach * (1.0 + 1e-9):
        raise ProblemError(
            f"goal: {np.round(target, 4).tolist()} is {distance:.4g} m from the "
            f"base, and frame {frame!r} reaches {reach:.4g} m at most: "
            f"outside reach by {distance - reach:.4g} m",
            "goal",
        )
