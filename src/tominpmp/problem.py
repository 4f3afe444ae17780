"""A planning problem: robot, start, goal, scene; checked when it is made."""

from __future__ import annotations

import copy
import itertools
import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from tominpmp.arrays import Array, Record, frozen_array, real_array, real_number
from tominpmp.collision import CollisionChecker, enclosure
from tominpmp.constraints.path import PathConstraint, checked
from tominpmp.dynamics import RobotDynamics
from tominpmp.exceptions import ProblemError, TominpmpWarning, brief
from tominpmp.goals import AnyGoal, Goal, PassedGoal, passed
from tominpmp.kinematics import RobotKinematics, prismatic_joints
from tominpmp.motion_limits import MotionLimits
from tominpmp.robot import Robot
from tominpmp.scene import Scene
from tominpmp.segments import Segment, check_names, checked_pairs, checked_segments
from tominpmp.trajectory import Trajectory

# A start or goal that is this little outside a limit is taken to be on it (positions in
# rad or m, velocities in rad/s or m/s): encoders and files round.
SNAP = 1e-6
# More choices of goals than this are not tried one by one.
MOST_ALTERNATIVES = 256
UNITS = {"position": ("rad", "m"), "velocity": ("rad/s", "m/s"), "effort": ("N m", "N")}


@dataclass(frozen=True, eq=False)
class Problem(Record):
    """Bring a robot from a state to a goal in minimum time.

    Attributes:
        robot: The robot.
        q_start: Positions at the start, shape (n,) [rad or m].
        goal: What must hold at the end; left out where there are segments, whose last
            goal it is.
        scene: The obstacles.
        margin: Distance that the links keep from them, and several robots from each
            other [m].
        v_start: Velocities at the start, shape (n,) [rad/s or m/s]; None for rest.
        motion_limits: Limits beyond those of the robot's description, if any. Of what
            they leave out, those of the robot hold: ``robot.motion_limits``.
        constraints: What else holds at all times: ``ToolSpeed``, ``KeepUpright``, ...
        self_collision: Whether the links keep clear of each other, and of what is fixed
            to the base, too, without a margin; None for yes. False is for robots whose
            description is wrong about their shapes.
        segments: Goals that are passed one after the other, each with what holds on the
            way to it, see :class:`Segment`; empty for a motion to one goal.
        may_touch: Pairs of names of links and obstacles that may touch.

    Raises:
        ProblemError: If a value is wrong: the message names the joint, the value and
            what was expected.
        FrameNotFound: If the goal is on a frame that the robot has not.
    """

    robot: Robot
    q_start: Array
    goal: Goal = None  # type: ignore[assignment]
    scene: Scene = field(default_factory=Scene)
    margin: float = 0.0
    v_start: Array | None = None
    motion_limits: MotionLimits | None = None
    self_collision: bool | None = None
    constraints: tuple[PathConstraint, ...] = ()
    segments: Sequence[Segment] = ()
    may_touch: Sequence[tuple[str, str]] = ()

    def __post_init__(self) -> None:
        """Check everything that can be told without planning."""
        if not isinstance(self.robot, Robot):
            raise ProblemError(
                f"robot is a {type(self.robot).__name__}, expected a Robot "
                "(see load_robot)",
                "robot",
            )
        self._take_segments()
        if not isinstance(self.goal, Goal):
            raise ProblemError(
                f"goal is a {type(self.goal).__name__}, expected a JointGoal, "
                "PositionGoal, PoseGoal or another goal",
                "goal",
            )
        scene = Scene() if self.scene is None else self.scene
        if not isinstance(scene, Scene):
            raise ProblemError(
                f"scene is a {type(scene).__name__}, expected a Scene", "scene"
            )
        object.__setattr__(self, "scene", scene)
        object.__setattr__(self, "margin", self._checked_margin())
        if not isinstance(self.self_collision, bool | None):
            raise ProblemError(
                f"self_collision is {brief(self.self_collision)}, expected True, False "
                "or None",
                "self_collision",
            )
        if self.motion_limits is not None:
            if not isinstance(self.motion_limits, MotionLimits):
                raise ProblemError(
                    f"motion_limits is a {type(self.motion_limits).__name__}, expected "
                    "MotionLimits",
                    "motion_limits",
                )
            self.motion_limits.check(self.robot.joint_names)
            limits = self.motion_limits.over(
                self.robot.motion_limits, self.robot.joint_names
            )
            object.__setattr__(self, "motion_limits", limits)
        else:
            object.__setattr__(self, "motion_limits", self.robot.motion_limits)
        check_names(self.may_touch, self.robot, scene)
        if not self.segments:
            self.goal.validate(self.robot)
        object.__setattr__(self, "constraints", checked(self.constraints, self.robot))
        snapped = self._snap_start()
        self._check_clear(self.q_start, "start")
        self._check_kept(self.q_start, self.v_start, "start", "q_start")
        if self.segments:
            _, of_goal = self._phases
        else:
            goal, of_goal = self._checked_goal(self.goal)
            object.__setattr__(self, "goal", goal)
        for message in (*snapped, *of_goal):
            # Past this method and the generated __init__, to whoever makes the problem.
            warnings.warn(message, TominpmpWarning, stacklevel=3)

    def __repr__(self) -> str:
        """Robot, goal and what else there is, on one line."""
        robot = f"{brief(self.robot.name)} with {self.robot.n} joints"
        count = len(self.scene)
        more = f", {count} obstacle{'s' if count > 1 else ''}" if count else ""
        more += f", margin {self.margin:g} m" if self.margin else ""
        more += ", motion limits" if self.motion_limits is not None else ""
        more += f", {len(self.segments)} segments" if self.segments else ""
        return f"<Problem of {robot}: {brief(self.goal)}{more}>"

    @cached_property
    def checker(self) -> CollisionChecker:
        """Distances of the links to the obstacles and to each other."""
        own = self.self_collision is not False
        may_touch = frozenset(map(frozenset, self.may_touch))
        return CollisionChecker(
            self.robot, self.scene, self_collision=own, may_touch=may_touch
        )

    @cached_property
    def margins(self) -> Array:
        """Distance to keep by pair of the checker: none from other links [m]."""
        return self.checker.margins(self.margin)

    @cached_property
    def ready_constraints(self) -> tuple[PathConstraint, ...]:
        """The constraints, ready to be evaluated."""
        return tuple(item.on(self.robot) for item in self.constraints)

    @property
    def phases(self) -> tuple[Problem, ...]:
        """The problems of the segments, one after the other; itself if there are none.

        Each has the robot, the scene and the limits of its segment, and at its end the
        goal, which is passed or where the arm stops. Where it starts is only known if
        the goal before it is a configuration; else ``q_start`` is that of the whole.
        """
        return self._phases[0] if self.segments else (self,)

    @cached_property
    def _phases(self) -> tuple[tuple[Problem, ...], list[str]]:
        """The problems of the segments, and what to warn of."""
        found: list[Problem] = []
        messages: list[str] = []
        q = self.q_start
        for number, segment in enumerate(self.segments):
            try:
                phase, more = self._phase(segment, number, q)
            except ProblemError as error:
                raise ProblemError(
                    f"segment {number + 1} of {len(self.segments)}: {error}",
                    f"segments[{number}].{error.field or 'goal'}",
                ) from error
            q = q if phase.goal.configuration is None else phase.goal.configuration
            found.append(phase)
            messages += [f"segment {number + 1}: {text}" for text in more]
        return tuple(found), messages

    def _phase(
        self, segment: Segment, number: int, q_start: Array
    ) -> tuple[Problem, list[str]]:
        """The problem of one segment, and what to warn of."""
        robot = segment.robot(self.robot)
        own = segment.motion_limits
        limits = self.motion_limits
        if own is not None:
            own.check(robot.joint_names)
            limits = own if limits is None else own.over(limits, robot.joint_names)
        scene = self.scene if segment.scene is None else segment.scene
        changes = {
            "robot": robot,
            "q_start": q_start,
            "v_start": self.v_start if number == 0 else None,
            "scene": scene,
            "motion_limits": limits,
            "constraints": self.constraints + checked(segment.constraints, robot),
            "may_touch": (*self.may_touch, *segment.may_touch),
            "segments": (),
        }
        phase = copy.copy(self)
        for name, value in changes.items():
            object.__setattr__(phase, name, value)
        check_names(segment.may_touch, robot, scene)
        same = robot is self.robot and scene is self.scene and not segment.may_touch
        for name in ("checker", "margins"):
            phase.__dict__.pop(name, None)
            if same:
                phase.__dict__[name] = getattr(self, name)
        for name in ("ready_constraints", "_phases"):
            phase.__dict__.pop(name, None)
        last = number == len(self.segments) - 1
        goal = segment.goal if last else segment.goal_on_the_way()
        goal.validate(robot)
        if number and not same:
            phase._check_clear(q_start, "start")
        if number == 0:
            phase._check_kept(phase.q_start, phase.v_start, "start", "q_start")
        rests = goal is segment.goal
        checked_goal, messages = phase._checked_goal(segment.goal, rests)
        if not rests:
            checked_goal = passed(checked_goal)
        object.__setattr__(phase, "goal", checked_goal)
        return phase, messages

    def _take_segments(self) -> None:
        """Check the segments, whose last goal is that of the problem."""
        pairs = checked_pairs(self.may_touch, "may_touch")
        object.__setattr__(self, "may_touch", pairs)
        segments = checked_segments(self.segments)
        object.__setattr__(self, "segments", segments)
        if not segments:
            if self.goal is None:
                raise ProblemError(
                    "neither goal nor segments is given, expected one of them", "goal"
                )
            return
        if self.goal is not None and self.goal is not segments[-1].goal:
            raise ProblemError(
                "goal and segments are given, expected one or the other: the last "
                "segment's goal is that of the problem",
                "goal",
            )
        object.__setattr__(self, "goal", segments[-1].goal)

    def _checked_margin(self) -> float:
        try:
            margin = real_number(self.margin)
        except ValueError:
            margin = np.nan
        if not (np.isfinite(margin) and margin >= 0.0):
            raise ProblemError(
                f"margin is {brief(self.margin)}, expected a length >= 0 [m]", "margin"
            )
        return margin

    def _snap_start(self) -> list[str]:
        q = self._vector(self.q_start, "q_start")
        v = np.zeros_like(q)
        if self.v_start is not None:
            v = self._vector(self.v_start, "v_start")
        q, of_q = self._snap("position", q, "q_start")
        v, of_v = self._snap("velocity", v, "v_start")
        object.__setattr__(self, "q_start", frozen_array(q))
        object.__setattr__(self, "v_start", frozen_array(v))
        return of_q + of_v

    @property
    def alternatives(self) -> tuple[Problem, ...]:
        """Problems of which any will do: one for each alternative of the goal."""
        if not self.segments:
            return tuple(self._with_goal(goal) for goal in self.goal.alternatives)
        each = [phase.goal.alternatives for phase in self.phases]
        if math.prod(map(len, each)) == 1:
            return (self,)
        count = math.prod(map(len, each))
        if count > MOST_ALTERNATIVES:
            raise ProblemError(
                f"segments: their goals can be chosen in {count} ways, expected no "
                f"more than {MOST_ALTERNATIVES}",
                "segments",
            )
        return tuple(self._with_goals(goals) for goals in itertools.product(*each))

    def alternative_of(self, trajectory: Trajectory) -> Problem:
        """The problem with those of its goals that a motion meets, or comes nearest."""
        if not self.segments:
            return self.alternative_at(trajectory.q[-1], trajectory.v[-1])
        ends = trajectory(np.array(trajectory.segment_ends))
        goals = [
            phase.goal.nearest(RobotKinematics(phase.robot), q, v)
            for phase, q, v in zip(self.phases, ends.q, ends.v, strict=True)
        ]
        return self._with_goals(goals)

    def _with_goals(self, goals: Sequence[Goal]) -> Problem:
        """The same with one goal for each segment, which were checked before."""
        other = self._with_goal(goals[-1])
        parts = [p._with_goal(g) for p, g in zip(self.phases, goals, strict=True)]
        other = copy.copy(other)
        other.__dict__["_phases"] = tuple(parts), []
        segments = tuple(
            replace(segment, goal=goal.goal if isinstance(goal, PassedGoal) else goal)
            for segment, goal in zip(self.segments, goals, strict=True)
        )
        object.__setattr__(other, "segments", segments)
        return other

    def alternative_at(self, q: Array, v: Array) -> Problem:
        """The problem with the one of its goals that a final state is nearest to.

        Args:
            q: Final configuration, shape (n,) [rad or m].
            v: Final velocity, shape (n,).
        """
        return self._with_goal(self.goal.nearest(RobotKinematics(self.robot), q, v))

    def _with_goal(self, goal: Goal) -> Problem:
        """The same problem with another goal, which was checked before."""
        if goal is self.goal:
            return self
        _ = self.checker  # the copy shares it
        other = copy.copy(self)
        object.__setattr__(other, "goal", goal)
        return other

    def with_scene(self, scene: Scene) -> Problem:
        """The same problem among other obstacles; whether it is clear is not checked.

        Links are watched against each other as they were.
        """
        other = copy.copy(self)
        for name in ("checker", "margins"):
            other.__dict__.pop(name, None)
        object.__setattr__(other, "self_collision", self.checker.self_collision)
        object.__setattr__(other, "scene", scene)
        return other

    def _checked_goal(self, goal: Goal, rests: bool = True) -> tuple[Goal, list[str]]:
        """Check a goal that belongs to the robot; what to warn of is returned too."""
        if goal.alternatives[0] is not goal:
            return self._checked_set(goal.alternatives, rests)
        if goal.configuration is not None:
            v = goal.final_velocity(self.robot.n)
            q, of_q = self._snap("position", goal.configuration, "goal.q")
            v, of_v = self._snap("velocity", v, "goal.v")
            self._check_clear(q, "goal")
            if rests:
                self._check_hold(q, v)
            self._check_kept(q, v, "goal", "goal")
            return goal.with_state(q, v) if of_q or of_v else goal, of_q + of_v
        for item in goal.members:
            self._check_reach(item)
            self._check_room(item)
        return goal, []

    def _checked_set(
        self, goals: tuple[Goal, ...], rests: bool
    ) -> tuple[Goal, list[str]]:
        """Leave out the goals that cannot be reached, as long as there are others."""
        kept, messages, wrong = [], [], []
        for number, goal in enumerate(goals, 1):
            try:
                checked, snapped = self._checked_goal(goal, rests)
            except ProblemError as error:
                wrong.append(f"goal {number} of {len(goals)}: {error}")
            else:
                kept.append(checked)
                messages += snapped
        if not kept:
            raise ProblemError("; ".join(wrong), "goal")
        messages += [f"{text}; it is left out" for text in wrong]
        return AnyGoal(tuple(kept)), messages

    def _unit(self, quantity: str, joint: int) -> str:
        return UNITS[quantity][int(prismatic_joints(self.robot)[joint])]

    def _vector(self, value: object, name: str) -> Array:
        joints = self.robot.joint_names
        expected = f"{len(joints)} numbers, one for each of: {', '.join(joints)}"
        try:
            array = real_array(value)
        except ValueError as error:
            raise ProblemError(
                f"{name} is {brief(value)}, expected {expected}", name
            ) from error
        if array.shape != (len(joints),):
            raise ProblemError(
                f"{name} has shape {array.shape}, expected {expected}", name
            )
        for joint, number in zip(joints, array, strict=True):
            if not np.isfinite(number):
                raise ProblemError(
                    f"{name}: joint {joint!r} is {number}, expected a finite number",
                    name,
                )
        return array

    def _snap(self, quantity: str, values: Array, name: str) -> tuple[Array, list[str]]:
        """Check values against limits, and put those on them that miss by a hair.

        Returns:
            The values, and what to warn of.
        """
        snapped = []
        limits = self.robot.limits
        lower, upper = limits.position_lower, limits.position_upper
        if quantity == "velocity":
            lower, upper = -limits.velocity, limits.velocity
        clipped = np.clip(values, lower, upper)
        for i in np.flatnonzero(clipped != values).tolist():
            excess = abs(clipped[i] - values[i])
            joint, unit = self.robot.joint_names[i], self._unit(quantity, i)
            what = f"{name}: joint {joint!r} "
            bounds = f"{quantity} limits [{lower[i]:.6g}, {upper[i]:.6g}] {unit}"
            if excess > SNAP:
                raise ProblemError(
                    f"{what}is {values[i]:.6g} {unit}, outside its {bounds}", name
                )
            snapped.append(
                f"{what}is {excess:.1e} {unit} outside its {bounds} and was set to "
                "the limit"
            )
        return np.asarray(clipped), snapped

    def _check_clear(self, q: Array, which: str) -> None:
        # When it arrives is not known yet: what moves may be elsewhere by then.
        time = 0.0 if which == "start" else None
        moves = time is None and self.checker.moving
        if self.checker.hulls_clear(q):
            return
        if not moves and self.checker.is_free(q, self.margins, time or 0.0):
            return
        contact = self.checker.closest(q, self.margins, time)
        if contact is None:
            return
        margin = contact.margin
        if contact.distance >= margin - SNAP:
            return
        depth = (
            f"overlap by {-contact.distance:.4g} m"
            if contact.distance < 0.0
            else f"are {contact.distance:.4g} m apart, less than the margin "
            f"{margin:.4g} m"
        )
        pair = f"link {contact.link!r} and obstacle {contact.obstacle!r}"
        advice = ""
        if contact.own:
            pair = f"links {contact.link!r} and {contact.obstacle!r}"
            advice = self._advice_on_links(q)
        raise ProblemError(
            f"{which} in collision: {pair} {depth} at q = {np.round(q, 4).tolist()}"
            f"{advice}",
            "q_start" if which == "start" else "goal",
        )

    def _advice_on_links(self, q: Array) -> str:
        """What to do about links that are found to overlap where they may not."""
        meshes = CollisionChecker(
            self.robot, Scene(), self_collision=True, geometry="mesh"
        )
        cause = "" if meshes.is_free(q) else " their meshes overlap, too;"
        if not cause:
            cause = " their meshes do not, only the convex pieces these are taken as;"
        return (
            f":{cause} links that may touch belong among the disable_collisions of an "
            "SRDF, and self_collision=False lets all of them touch"
        )

    def _check_kept(self, q: Array, v: Array | None, which: str, name: str) -> None:
        """Check that the constraints hold at a state."""
        for item in self.ready_constraints:
            if lack := item.lack(q, np.zeros_like(q) if v is None else v, SNAP):
                raise ProblemError(f"{which}: {lack}", name)

    def _check_hold(self, q: Array, v: Array) -> None:
        """Check that the motors can hold an arm that is to come to rest."""
        if np.any(v):
            return
        tau = RobotDynamics(self.robot).inverse(q[None], v[None], v[None])[0]
        limits = self.robot.limits
        for i, joint in enumerate(self.robot.joint_names):
            low, high = limits.effort_lower[i], limits.effort_upper[i]
            slack = 1e-9 * max(1.0, abs(low), abs(high))
            if not low - slack <= tau[i] <= high + slack:
                unit = self._unit("effort", i)
                dry = self.robot.friction[i] > 0.0
                raise ProblemError(
                    f"goal: joint {joint!r} cannot hold the arm against gravity there: "
                    f"{tau[i]:.4g} {unit} needed, [{low:.4g}, {high:.4g}] allowed"
                    + (" (its dry friction is not counted on)" if dry else ""),
                    "goal",
                )

    def _check_room(self, goal: Goal) -> None:
        """Check that the frame is not to end within an obstacle, link and all."""
        ball, frame = goal.ball, goal.frame_name
        if ball is None or frame is None or not len(self.scene):
            return
        point = ball.centre
        found = enclosure(self.robot, self.scene, frame, point, ball.radius)
        if found is not None:
            raise ProblemError(
                f"goal: {np.round(point, 4).tolist()} is {found.depth:.4g} m deep in "
                f"obstacle {found.obstacle!r}, and link {found.link!r} with frame "
                f"{frame!r} there overlaps it in every orientation",
                "goal",
            )

    def _check_reach(self, goal: Goal) -> None:
        target, frame = goal.nearest_point(), goal.frame_name
        if target is None or frame is None:
            return
        reach = RobotKinematics(self.robot).reach(frame)
        distance = math.hypot(*target)  # does not overflow
        if distance > reach * (1.0 + 1e-9):
            raise ProblemError(
                f"goal: {np.round(target, 4).tolist()} is {distance:.4g} m from the "
                f"base, and frame {frame!r} reaches {reach:.4g} m at most: "
                f"outside reach by {distance - reach:.4g} m",
                "goal",
            )
