"""What places are worth to a motion: those of its goal, its obstacles and its base.

A goal that is moved one way is the same as a robot that is moved the other way before
it. So both, and what gravity and constraints have to do with the base, come from the
values of a robot whose base stands a little elsewhere, with the motion of its joints as
it is; contacts give the rest by their normals.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array, IntArray
from tominpmp.certificate.active_limits import Motion
from tominpmp.certificate.dual_solution import DualSolution
from tominpmp.certificate.multipliers import GOAL
from tominpmp.kinematics import RobotKinematics, prismatic_joints
from tominpmp.robot import Robot
from tominpmp.sensitivities.records import Sensitivity
from tominpmp.sensitivities.torques import TorqueWeights

# Displacements of differences [m, rad], and changes of gravity, as a share of it.
STEP, GRAVITY_STEP = 1e-6, 1e-4
# Multipliers below this change nothing [1/m].
NOTHING = 1e-9


@dataclass(frozen=True, eq=False)
class PlaceValues:
    """Reads what places are worth from the multipliers of a motion.

    Attributes:
        motion: The motion.
        found: Its multipliers.
        torques: What torques are worth.
        number: Which segment it is, from 1; None where there is one only.
    """

    motion: Motion
    found: DualSolution
    torques: TorqueWeights
    number: int | None = None

    def records(self) -> Iterator[Sensitivity]:
        """Records of the goal and of the obstacles."""
        yield from self._goal_joints()
        problem = self.motion.task.problem
        if problem.goal.configuration is None:
            place = -self._base_of_goal[:3]
            name = problem.goal.frame_name
            subject = "goal" if name is None else f"frame {name}"
            yield _place("goal", self._of_segment(subject), place)
        for item in problem.scene:
            place = self.contacts.get(item.name, np.zeros(6))[:3]
            yield _place("obstacle", item.name, place)

    def _of_segment(self, subject: str) -> str:
        """What a goal is about, with the segment that it ends."""
        return subject if self.number is None else f"{subject} of segment {self.number}"

    # -- the goal ----------------------------------------------------------------------

    @cached_property
    def _of_goal(self) -> Array:
        """Multipliers of the rows of the goal, positive at the upper side."""
        given = self.found.multipliers
        own = np.flatnonzero(given.of(GOAL))
        out = np.zeros(int(given.subject[own].max(initial=-1)) + 1)
        signs = np.where(given.upper[own], 1.0, -1.0)
        np.add.at(out, given.subject[own], signs * given.value[own])
        return out

    def _goal_joints(self) -> Iterator[Sensitivity]:
        """A configuration to end at, joint by joint."""
        problem = self.motion.task.problem
        q = problem.goal.configuration
        if q is None:
            return
        units = np.where(prismatic_joints(problem.robot), "m", "rad").tolist()
        for joint, name in enumerate(problem.robot.joint_names):
            value = 0.0 - float(self._of_goal[joint])
            yield Sensitivity(
                "goal",
                name,
                self._of_segment(name),
                value,
                f"1/{units[joint]}",
                float(q[joint]),
                units[joint],
            )

    def _goal_value(self, robot: Robot) -> Array:
        changes, kinematics = self.motion.changes, RobotKinematics(robot)
        node = self.motion.span[1]
        q, v = changes.q[node], changes.v[node]
        task = self.motion.task
        goal = task.problem.goal.nearest(task.kinematics, q, v)
        return goal.residual(kinematics, q, v).value

    @cached_property
    def _base_of_goal(self) -> Array:
        """Share of T by the base, as far as the goal has to do with it, shape (6,)."""
        y = self._of_goal
        if self.motion.task.problem.goal.configuration is not None or not y.size:
            return np.zeros(6)
        return np.array(
            [
                y @ (self._goal_value(after) - self._goal_value(before)) / (2.0 * STEP)
                for before, after in self._moved_robots
            ]
        )

    # -- contacts ----------------------------------------------------------------------

    @cached_property
    def contacts(self) -> dict[str, Array]:
        """Share of T by displacements of obstacles by name.

        Three translations [1/m] and three rotations about the origin of the world
        [1/rad], shape (6,) each.
        """
        problem, changes = self.motion.task.problem, self.motion.changes
        checker = problem.checker
        out: dict[str, Array] = {}
        for rows, y in self.found.rows:
            worth = y / np.broadcast_to(np.asarray(rows.unit), y.shape)
            held = (rows.subject < checker.obstacle_pairs) & (worth > NOTHING)
            if rows.kind != "clearance" or not held.any():
                continue
            pair, time = rows.subject[held], rows.at.kept(held).times(changes)
            q = self.motion.trajectory(time).q
            normal, point = checker.witnesses(q, pair, time)
            # An obstacle that goes along the normal gives room.
            twist = np.hstack([normal, np.cross(point, normal)])
            twist *= -worth[held, None]
            for name, row in zip(_others(checker.pairs, pair), twist, strict=True):
                out[name] = out.get(name, np.zeros(6)) + row
        return out

    # -- the base ----------------------------------------------------------------------

    @cached_property
    def _moved_robots(self) -> list[tuple[Robot, Robot]]:
        """The robot with its base a little before and after, along six coordinates."""
        robot = self.motion.task.problem.robot
        return [
            (_displaced(robot, -STEP * axis), _displaced(robot, STEP * axis))
            for axis in np.eye(6)
        ]

    @cached_property
    def base(self) -> Array:
        """Share of T by a displacement of the base, shape (6,) [1/m, 1/rad]."""
        out = self._base_of_goal - sum(self.contacts.values(), np.zeros(6))
        robot = self.motion.task.problem.robot
        # In the axes of the base it is gravity that turns.
        out[3:] += np.cross(self.torques.by_gravity(robot), robot.gravity)
        for index, (before, after) in enumerate(self._moved_robots):
            out[index] += (self._asked(after) - self._asked(before)) / (2.0 * STEP)
        return np.asarray(out)

    def by_gravity(self) -> float:
        """Share of T by a share of gravity that constraints cost, as loads do."""
        robot = self.motion.task.problem.robot
        if not np.any(robot.gravity) or not self._constrained:
            return 0.0
        less, more = (
            self._asked(robot.with_changes(gravity=robot.gravity * (1.0 + step)))
            for step in (-GRAVITY_STEP, GRAVITY_STEP)
        )
        return (more - less) / (2.0 * GRAVITY_STEP)

    @cached_property
    def _constrained(self) -> list[tuple[int, Array, IntArray, Array]]:
        """Constraints with the times, components and multipliers of their rows."""
        names = {item.name for item in self.motion.task.problem.constraints}
        found, changes = [], self.motion.changes
        for rows, y in self.found.rows:
            if rows.kind not in names or rows.component is None:
                continue
            held = np.abs(y) > NOTHING
            time = rows.at.kept(held).inside.times(changes)
            for index in np.unique(rows.subject[held]).tolist():
                own = rows.subject[held] == index
                which = rows.component[held][own]
                found.append((index, time[own], which, y[held][own]))
        return found

    def _asked(self, robot: Robot) -> float:
        """Values of the constraints for another robot, weighted by multipliers."""
        total = 0.0
        for index, times, which, y in self._constrained:
            item = self.motion.task.problem.constraints[index].on(robot)
            state = self.motion.trajectory(times)
            values = item.value_rows(state.q, state.v, state.a)
            total += float(y @ values[np.arange(y.size), which])
        return total


def _displaced(robot: Robot, twist: Array) -> Robot:
    """The robot with its base moved by a small twist in the world, without shapes."""
    model = robot.model.copy()
    move = pin.SE3(pin.exp3(twist[3:]), twist[:3])
    for joint in range(1, model.njoints):
        if model.parents[joint] == 0:
            model.jointPlacements[joint] = move * model.jointPlacements[joint]
    for frame in model.frames:
        if frame.parentJoint == 0:
            frame.placement = move * frame.placement
    return replace(robot, model=model)


def _others(pairs: tuple[tuple[str, str], ...], which: IntArray) -> list[str]:
    return [pairs[index][1] for index in which.tolist()]


def _place(kind: str, subject: str, gradient: Array) -> Sensitivity:
    length = float(np.linalg.norm(gradient))
    return Sensitivity(kind, None, subject, length, "1/m", vector=gradient)
